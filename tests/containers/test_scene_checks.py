"""What is said of a scene's surfaces before they are traced."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.bsdf import (
    Bsdf,
    Coated,
    Fresnel,
    GaussianLobe,
    Lambertian,
    Mirror,
    Mixture,
    SpecularTable,
    Tabulated,
    direction_of,
    one_way_share,
    symmetrised,
    tabulate,
    transmission_defect,
)
from containers.bsdf.surface import Deltas
from containers.bsdf.tabulated import tabulate_intensity
from containers.ray_tracing.build import cell_of, scene_of
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.simulation import simulate_scene
from containers.scene import Array, Face, Scene
from containers.scene_checks import ONE_WAY_TOLERANCE, TRANSMISSION_TOLERANCE, scene_warnings
from containers.simulate_text import as_text
from containers.stack import dbr_of
from containers.thin_film.surface import film_bsdf
from containers.thin_film.table import FilmTable, film_table
from luxloop.computation import Progress
from luxloop.design import Design
from luxloop.errors import InputError
from luxloop.film import Grid
from luxloop.model import Environment
from luxloop.ray import RayRequest
from luxloop.stack import Medium
from tests.films import dispersive, film
from tests.ray_scenes import chip, scene

DEG = np.pi / 180.0
Real = NDArray[np.float64]
DESIGN = Design(distance_um=180.0, width_um=28.0, spacing_um=500.0, thickness_um=35.0, dbr_pairs=0.0)


def axes(step_deg: float) -> tuple[Real, Real, Real]:
    """Nodes at the centres of equal rings, the rings, sectors as wide."""
    edges = np.linspace(0.0, np.pi / 2, round(90.0 / step_deg) + 1)
    return (edges[1:] + edges[:-1]) / 2.0, edges, np.linspace(0.0, np.pi, 2 * edges.size - 1)


@cache
def one_way(reflectance: float = 0.3, sigma_deg: float = 15.0) -> Tabulated:
    """A Gaussian lobe as a table, which no definition excuses."""
    return tabulate(GaussianLobe(reflectance, sigma_deg * DEG), *axes(5.0))


def reciprocal(sigma_deg: float, step_deg: float) -> Tabulated:
    """f = c exp(-|k_out - k_mirror|^2 / 2 s^2) of the directions along the surface, the same from either end."""
    s, fine = np.sin(sigma_deg * DEG), axes(0.25)

    def intensity(theta_in: float, direction: Real) -> Real:
        x, y, z = np.moveaxis(direction, -1, 0)
        near = np.exp(-((x - np.sin(theta_in)) ** 2 + y**2) / (2.0 * s * s))
        return np.asarray(0.3 / (2.0 * np.pi * s * s) * near * np.maximum(z, 0.0))

    nodes, edges, sectors = axes(step_deg)
    theta, phi = fine[0][:, None], (fine[2][1:] + fine[2][:-1]) / 2.0
    solid_angle = np.sin(theta) * (0.25 * DEG) * 2.0 * (sectors[-1] / phi.size)
    kept = np.array([(intensity(float(angle), direction_of(theta, phi)) * solid_angle).sum() for angle in nodes])
    nothing = np.zeros_like(nodes)
    return tabulate_intensity(intensity, kept, Deltas(nothing, nothing), 1.0, (nodes, edges, sectors))


# One-way light


def test_nothing_is_said_of_ordinary_scenes() -> None:
    """Lambert, lobe, mirror, Fresnel and film: reciprocal, or excused."""
    for spectrum in ("averaged", "sampled"):
        environment = Environment(spectrum=spectrum, chip_bottom="mirror")
        design = DESIGN.model_copy(update={"dbr_pairs": 5.5})
        assert scene_warnings(scene_of(environment, design, film(5.5), cell_of(environment, design))) == ()
    assert scene_warnings(scene(substrate=Mixture((GaussianLobe(0.9, 0.1), Mirror(0.9)), (0.5, 0.5)))) == ()
    assert scene_warnings(scene(substrate=Coated(Fresnel(1.0, 1.5), GaussianLobe(0.9, 0.1)))) == ()


def test_the_share_of_one_way_light_is_what_it_is_called() -> None:
    """Two rings that exchange light at 3 to 1: |3 - 1| / (3 + 1) of what goes between them, nothing within them."""
    edges = np.array([0.0, np.pi / 4, np.pi / 2])  # equal in sin^2
    values = np.array([[1.0, 3.0], [1.0, 1.0]])[None, None, :, :, None] / (8.0 * np.pi)
    table = Tabulated(values, (edges[1:] + edges[:-1]) / 2.0, edges, np.array([0.0, np.pi]))
    assert one_way_share(table) == pytest.approx(0.5 * 4.0 / 6.0, abs=1e-12)
    assert one_way_share(symmetrised(table)) == pytest.approx(0.0, abs=1e-12)
    assert one_way_share(Lambertian(0.5)) == pytest.approx(0.0, abs=1e-12)
    assert one_way_share(Mirror(0.5)) == 0.0


def test_a_table_that_leans_to_one_side_is_one_way() -> None:
    """Light turned to the left by one quarter: what comes back the same way is turned away from where it came."""
    sectors = np.linspace(0.0, 2.0 * np.pi, 5)
    left = np.array([0.0, 1.0, 0.0, 0.0]) * np.ones((1, 1, 2, 2, 1)) / np.pi
    table = Tabulated(left, np.array([0.4, 1.2]), np.array([0.0, 0.8, np.pi / 2]), sectors)
    assert one_way_share(table) == pytest.approx(1.0)
    assert one_way_share(symmetrised(table)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("sigma_deg", "step_deg"), [(5.0, 5.0), (5.0, 2.0), (20.0, 5.0), (40.0, 2.0)])
def test_cells_alone_do_not_make_a_table_one_way(sigma_deg: float, step_deg: float) -> None:
    """A reciprocal lobe stays below the tolerance, be it no wider than a cell; the Gaussian one is above it."""
    assert one_way_share(reciprocal(sigma_deg, step_deg)) < ONE_WAY_TOLERANCE / 2.0
    assert one_way_share(tabulate(GaussianLobe(0.3, sigma_deg * DEG), *axes(step_deg))) > 2.0 * ONE_WAY_TOLERANCE


PLACES: dict[str, Any] = {
    "substrate": lambda table: scene(substrate=table),
    "receiver": lambda table: replace(scene(), receiver=replace(scene().receiver, bsdf=table)),
    "chip.mirror": lambda table: scene({"bottom": "mirror", "mirror": table}),
    "wall": lambda table: scene(layout=Array.regular(1, 1, 500.0, wall=table)),
    "chip.top.outside": lambda table: scene({"top": Face(chip().top.inside, (with_delta(table),))}),
    "chip.sides.inside": lambda table: scene(
        {"sides": Face((with_delta(table, inside=True),), chip().sides.outside)}
    ),
}


def with_delta(table: Tabulated, inside: bool = False) -> Tabulated:
    """The table as one side of a face between the chip and air."""
    n = float(chip().index[0])
    return replace(table, index_ratio=n if inside else 1.0 / n)


@pytest.mark.parametrize("place", list(PLACES))
def test_a_one_way_table_is_named_wherever_it_lies(place: str) -> None:
    """Surface, measured share, tolerance and mend, in one sentence."""
    share = 100.0 * one_way_share(one_way())
    (first, *_) = [
        line for line in scene_warnings(PLACES[place](one_way())) if line.startswith(f"{place}: the table")
    ]
    for words in (f"{share:.2g} %", "2 %", "reciprocity", "symmetrised"):
        assert words in first
    mended = scene_warnings(PLACES[place](symmetrised(one_way(0.02))))
    assert not any(line.startswith(f"{place}: the table") for line in mended)


def test_parts_and_coats_are_looked_into() -> None:
    """A table in a mixture has its number; a coat over Lambert's law is no longer reciprocal, and says so."""
    mixture = Mixture((Lambertian(0.9), GaussianLobe(0.9, 0.1), one_way()), (0.4, 0.3, 0.3))
    (warning,) = scene_warnings(scene(substrate=mixture))
    assert warning.startswith("substrate, part 3: the table")
    (warning,) = scene_warnings(scene(substrate=Coated(Fresnel(1.0, 1.5), mixture.parts[0])))
    assert warning.startswith("substrate: the coated surface")
    assert "tabulate it, then" in warning
    even = SpecularTable(np.array([0.0]), np.array([0.04]), np.array([0.96]))
    assert scene_warnings(scene(substrate=Coated(even, Lambertian(0.9)))) == ()


def test_a_surface_met_in_two_places_is_named_once() -> None:
    """The same table at the substrate and at the chip's bottom: one sentence."""
    both = scene({"bottom": "mirror", "mirror": one_way()}, substrate=one_way())
    assert [line.split(":")[0] for line in scene_warnings(both)] == ["substrate"]


# Energy


def test_a_table_that_creates_energy_is_refused_by_name() -> None:
    """Changed after it was made: surface, row and angle are named before a ray is traced, a coat hides nothing."""
    table = symmetrised(one_way(0.02))
    hot = replace(table)
    hot.values[0, 0, 1] *= 1000.0
    coat = SpecularTable(np.array([0.0]), np.array([0.9]), np.array([0.1]))
    for bsdf in (hot, Mixture((hot,), (0.5,)), Coated(coat, hot)):
        with pytest.raises(InputError, match=r"substrate.*theta_in 7\.500 deg"):
            scene_warnings(scene(substrate=bsdf))


# Films


def both_sides(table: FilmTable, spectrum: Literal["averaged", "sampled"] = "averaged") -> tuple[Face, Scene]:
    """A film's faces in a scene."""
    environment = Environment(spectrum=spectrum, indices="dispersive" if np.ptp(table.n_inside) else "fixed")
    design = DESIGN.model_copy(update={"dbr_pairs": 5.5})
    made = scene_of(environment, design, table, cell_of(environment, design))
    return made.chip.top, made


def absorbing(pairs: float, roughness_nm: float) -> FilmTable:
    """The paper's DBR with k 0.01 in every layer, and rough."""
    stack = dbr_of(Environment(), pairs)
    layers = tuple(
        layer.model_copy(update={"medium": Medium(n=layer.medium.n, k=0.01), "roughness_nm": roughness_nm})
        for layer in stack.layers
    )
    return film_table(stack.model_copy(update={"layers": layers}), grid=Grid(wavelengths=11))


FILMS: dict[str, Any] = {
    "0.5 pairs": lambda: film(0.5),
    "9.5 pairs": lambda: film(9.5),
    "5.5 pairs, rough": lambda: film(5.5, 5.0),
    "5.5 pairs, absorbing": lambda: absorbing(5.5, 0.0),
    "9.5 pairs, absorbing and rough": lambda: absorbing(9.5, 5.0),
}


@pytest.mark.parametrize("name", list(FILMS))
def test_our_films_send_the_same_both_ways(name: str) -> None:
    """T from GaN = T from air, at any angle within a fifth of the tolerance, where R differs too."""
    table = FILMS[name]()
    theta = np.linspace(0.0, np.pi / 2, 777)
    face, made = both_sides(table)
    assert transmission_defect(face.outside[0], face.inside[0], theta) < TRANSMISSION_TOLERANCE / 5.0
    assert transmission_defect(face.inside[0], face.outside[0], theta) < TRANSMISSION_TOLERANCE / 5.0
    surfaces = [film_bsdf(table, side) for side in ("outside", "inside")]
    assert transmission_defect(surfaces[0], surfaces[1], theta) < TRANSMISSION_TOLERANCE / 5.0
    assert scene_warnings(made) == ()


@pytest.mark.parametrize("spectrum", ["averaged", "sampled"])
def test_dispersion_does_not_make_a_film_one_way(spectrum: Literal["averaged", "sampled"]) -> None:
    """A mean over wavelengths at equal angles in GaN once was 0.11 off the mean at equal angles in air."""
    face, made = both_sides(dispersive(), spectrum)
    for outside, inside in zip(face.outside, face.inside, strict=True):
        assert transmission_defect(outside, inside, outside.theta_in_rad) < 1e-6  # type: ignore[attr-defined]
    assert scene_warnings(made) == ()


def test_a_face_that_lets_more_in_than_out_is_named() -> None:
    """T of 5.5 pairs outside, of 4.5 inside: the face, the difference, the mend."""
    sides = film_bsdf(film(5.5), "outside"), film_bsdf(film(4.5), "inside")
    wrong = scene({"top": Face((sides[1],), (sides[0],))})
    (warning,) = scene_warnings(wrong)
    assert warning.startswith("chip.top: T from outside and from inside differ by up to 0.")
    assert "0.001" in warning
    assert "one stack" in warning
    other = Face((Fresnel(2.5, 1.0),), (Fresnel(1.0, 2.4),))
    with pytest.raises(InputError, match="index_ratio"):
        scene_warnings(scene({"sides": other}))


# In the answer


def answered(substrate: Bsdf) -> dict[str, Any]:
    """The document of a scene with another substrate, by a few histories."""
    request = RayRequest(environment=Environment(), design=DESIGN, histories=1)
    made = scene_of(request.environment, DESIGN, None, cell_of(request.environment, DESIGN))
    return simulate_scene(request, replace(made, substrate=substrate), None, ExitSource(), Progress())[0]


def test_an_answer_carries_the_warnings_of_its_scene() -> None:
    """A one-way substrate is traced all the same, its ledger closed; a person reads the sentence; else none."""
    result = answered(one_way())
    assert abs(result["ledger_defect"]) < 1e-12
    assert result["warnings"] == list(scene_warnings(scene(substrate=one_way())))
    about = {
        "design": DESIGN.model_dump(), "array": None, "model": {"name": "clear_chip"}, "target_error_points": None,
        "compute_s": 0.1,
    }  # fmt: skip
    assert f"WARNING: {result['warnings'][0]}" in as_text(result | about)
    assert answered(Lambertian(0.9))["warnings"] == []
