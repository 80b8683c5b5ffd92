"""A film as a surface: its powers are those of an independent program, its scatter goes where it should."""

from __future__ import annotations

import numpy as np
import pytest

from containers.bsdf import direction_of
from containers.thin_film.scatter import AbcSpectrum
from containers.thin_film.surface import averaging_loss, film_bsdf
from containers.thin_film.table import Side, film_table
from luxloop.film import Grid
from luxloop.stack import Medium, Stack
from tests.films import DEG, dispersive, film, line_average, tmm_powers


@pytest.mark.parametrize("angle_deg", [10.0, 22.0, 23.5, 23.69])
def test_film_surface_is_the_line_average_of_the_independent_program(angle_deg: float) -> None:
    """From GaN up to just below the critical angle: R and T to 1e-4, with fixed indices and with dispersion."""
    for table in (film(), dispersive()):
        deltas = film_bsdf(table, "inside").deltas(angle_deg * DEG)
        if table is film() or angle_deg < 23.6:  # the peak's own critical angle
            assert list(map(float, deltas)) == pytest.approx(line_average(table, "inside", angle_deg), abs=1e-4)


def test_averaging_loss_names_what_dispersion_moves_to_reflection() -> None:
    """Beyond the peak's critical angle longer wavelengths still get out: the surface reflects them, by so much."""
    surface, lost = film_bsdf(dispersive(), "inside"), averaging_loss(dispersive(), "inside")
    critical = np.degrees(np.arcsin(1.0 / surface.index_ratio))
    for beyond in (0.01, 0.1, 0.3):
        moved = line_average(dispersive(), "inside", critical + beyond)[1]
        assert 0.0 < moved <= lost["dispersion_ratio"] + 1e-6
    assert lost["dispersion_ratio"] < 0.2
    assert "dispersion_ratio" not in averaging_loss(film(), "inside")


def test_averaging_loss_of_a_bare_face_is_half_of_what_s_and_p_differ() -> None:
    """Fresnel in angles from air: max (R_s - R_p) / 2; nothing for wavelengths where the index does not change."""
    table = film_table(Stack(inside=Medium(n=2.4869), layers=(), outside=Medium(n=1.0)), grid=Grid(wavelengths=11))
    i = np.linspace(0.01, 89.99, 20_000) * DEG
    t = np.arcsin(np.sin(i) / 2.4869)
    R_s, R_p = (np.sin(i - t) / np.sin(i + t)) ** 2, (np.tan(i - t) / np.tan(i + t)) ** 2
    lost = averaging_loss(table, "outside")
    assert lost["polarisation_ratio"] == pytest.approx((R_s - R_p).max() / 2, abs=1e-3)
    assert lost["wavelength_ratio"] < 1e-12
    assert set(lost) == {"polarisation_ratio", "wavelength_ratio"}


def test_averaging_loss_holds_what_the_line_hides() -> None:
    """At 20 deg from GaN no wavelength differs from the mean of the line by more than is said; one by a third."""
    lost, seen = averaging_loss(film(), "inside")["wavelength_ratio"], film().weight > 0.01 * film().weight.max()
    R = np.array([tmm_powers(film(), "inside", float(nm), 20.0) for nm in film().wavelength_nm])[..., 0]
    off = np.abs(R - film().weight @ R)[seen].max()
    assert lost / 3.0 < off <= lost + 1e-9


@pytest.mark.parametrize("side", ["inside", "outside"])
def test_scatter_of_a_film_goes_about_its_specular_directions(side: Side) -> None:
    """Radiance scattered up is largest at the mirror angle, down at the angle of Snell's law, at azimuth 0."""
    surface = film_bsdf(film(2.5, 3.0), side, AbcSpectrum(correlation_length_nm=1500.0))
    theta = np.arange(1.0, 89.0, 2.0)  # the middle of the cells
    ratio = 2.4869 if side == "inside" else 1 / 2.4869
    incidence = 14.0 if side == "inside" else 34.0
    snell = float(np.degrees(np.arcsin(ratio * np.sin(incidence * DEG))))
    up = surface.evaluate(incidence * DEG, direction_of(theta * DEG, 0.01))
    down = surface.evaluate(incidence * DEG, direction_of((180.0 - theta) * DEG, 0.01))
    assert theta[int(up.argmax())] == pytest.approx(incidence, abs=1.6)
    assert theta[int(down.argmax())] == pytest.approx(snell, abs=1.6)


@pytest.mark.parametrize("side", ["inside", "outside"])
def test_film_surface_keeps_the_golden_reflectance(side: Side) -> None:
    """Averaged R of the 5.5-pair film at 0 and 20 (GaN) or 60 deg (air), to the golden table's 2e-4."""
    surface = film_bsdf(film(), side)
    angles, golden = (
        ([0.0, 20.0, 30.0], [0.638402, 0.516240, 1.0]) if side == "inside" else ([0.0, 60.0], [0.638402, 0.506273])
    )
    assert surface.deltas(np.array(angles) * DEG).mirror == pytest.approx(golden, abs=2e-4)
    assert surface.albedo(np.linspace(0, np.pi / 2, 50)) == pytest.approx(np.ones(50), abs=1e-9)


def test_rough_film_surface_books_all_scatter() -> None:
    """With the faces' spectrum the surface keeps R + T + S_R + S_T = 1 and samples it; without, scatter is lost."""
    table = film(5.5, 5.0)
    surface = film_bsdf(table, "inside", AbcSpectrum(correlation_length_nm=200.0))
    angles = np.array([0.0, 10.0, 40.0, 80.0]) * DEG
    assert surface.albedo(angles) == pytest.approx(np.ones(4), abs=1e-6)
    assert np.all(film_bsdf(table, "inside").albedo(angles) < 0.995)
    sample = surface.sample(np.random.default_rng(1).random((2000, 3)), 0.0)
    assert sample.weight == pytest.approx(np.ones(2000), abs=1e-6)
    assert np.any(np.abs(sample.direction[:, 0]) > 0.1)
