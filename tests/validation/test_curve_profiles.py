"""What is left of spectra and far fields: noise looks like noise, and what is wrong is found where it is."""
# ruff: noqa: ARG002, ARG005  # what stands in for a predictor or an effect need not use all it is given

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.validation.test_fit_images import MODEL
from validation.comparing import Comparison, Solver, compared, curve_noise_shares, rows_alike
from validation.curve_profiles import curve_profiles, curve_regions, fourier
from validation.dataset.manifest import FarFieldShot, FilmLayer, FilmSample, Sample, SpectrumShot
from validation.dataset.spectra import FarFieldTable, SpectrumTable
from validation.fit import curves_of, film_parameters
from validation.measured import MeasuredFarField, MeasuredSpectrum
from validation.observed import Observed
from validation.prediction import PredictedCurve
from validation.profiles import profiles

PER_UM = np.linspace(1e3 / 700.0, 1e3 / 420.0, 121)
SIGMA = 0.002
FILM = FilmSample(
    id="film", layers=(FilmLayer(cauchy=(1.5, 0.0), thickness_nm=2000.0, free={"thickness_nm": (1900.0, 2100.0)}),)
)
SAMPLE = Sample(
    id="chip", layout="single", distance_um=180.0, width_um=40.0, spacing_um=400.0, thickness_um=20.0, dbr_pairs=0.0
)
Real = Any


def fringes(wavelength_nm: Real, thickness_um: float) -> Real:
    """Reflectance of a film of this optical thickness."""
    return 0.2 + 0.05 * np.cos(4.0 * np.pi * thickness_um * 1e3 / wavelength_nm)


class Optics:
    """Predicts fringes of the film's thickness, and Lambert's far field."""

    def spectra(self, model: Any, curves: Sequence[Any], paths: Sequence[str] = ()) -> list[PredictedCurve]:
        """Of each film; derivatives by differences."""
        found = []
        for curve in curves:
            um = curve.film.layers[0].thickness_nm * 1.5e-3
            value = fringes(curve.wavelength_nm, um)
            slope = (fringes(curve.wavelength_nm, um + 1.5e-4) - fringes(curve.wavelength_nm, um - 1.5e-4)) / 0.2
            found.append(PredictedCurve(value, dict.fromkeys(paths, slope)))
        return found

    def far_fields(self, model: Any, views: Sequence[Any], paths: Any = (), *_: Any) -> list[PredictedCurve]:
        """Of each view."""
        return [PredictedCurve(np.cos(np.radians(view.theta_deg)) / np.pi, {}) for view in views]


def spectrum(seed: int, extra: Callable[[Real, Real], Real] = lambda wave, aoi: 0.0 * wave) -> MeasuredSpectrum:
    """A noisy spectrum at two angles, with something more that no film of the model has."""
    wave, aoi = (one.ravel() for one in np.meshgrid(1e3 / PER_UM, [10.0, 50.0]))
    noise = SIGMA * np.random.default_rng(seed).standard_normal(len(wave))
    value = fringes(wave, 3.0) + extra(wave, aoi) + noise
    table = SpectrumTable(wave, aoi, ("u",) * len(wave), value, np.full(len(wave), SIGMA))
    return MeasuredSpectrum(
        SpectrumShot(id="r", kind="spectrum", film="film", quantity="R", file="r.csv"), FILM, table
    )


def far_field(seed: int, extra: Callable[[Real, Real], Real] = lambda theta, phi: 0.0 * theta) -> MeasuredFarField:
    """A noisy goniometer curve of two planes."""
    theta, phi = (one.ravel() for one in np.meshgrid(np.arange(0.0, 85.0, 2.5), [0.0, 90.0]))
    noise = 0.01 * np.random.default_rng(seed).standard_normal(len(theta))
    value = 7.0 * (np.cos(np.radians(theta)) + extra(theta, phi) + noise)
    table = FarFieldTable(theta, phi, value, np.full(len(theta), 0.07))
    return MeasuredFarField(FarFieldShot(id="g", kind="far_field", sample="chip", file="g.csv"), SAMPLE, table)


def found_of(one: MeasuredSpectrum, other: MeasuredFarField) -> Comparison:
    """Both beside the model; the film's thickness moves, the goniometer's scale too."""
    films, at = film_parameters([one])
    observed = Observed((), tuple(curves_of([one], [other])), tuple(films), at)
    return compared(MODEL, observed, Optics(), Solver(None))  # type: ignore[arg-type]


def worst(found: Comparison) -> Mapping[str, Any]:
    """The regions of curves by shot and family."""
    return {f"{one.shot}, {one.family}": one for one in curve_regions(found.fit)}


def test_noise_alone_has_power_1_and_no_region() -> None:
    """Powers have the mean of noise; over 20 draws regions with a chance below 5 % are no more than that."""
    powers, chances = [], []
    for seed in range(20):
        found = found_of(spectrum(seed), far_field(100 + seed))
        powers += [value for line in fourier(found.fit) for value in line["power"]]
        chances += [one.chance for one in curve_regions(found.fit)]
    assert np.mean(powers) == pytest.approx(1.0, abs=0.05)
    assert np.mean(np.array(powers) > 2.995732) == pytest.approx(0.05, abs=0.015)
    assert np.mean(np.array(chances) < 0.05) < 0.1


def test_a_layer_that_the_model_lacks_is_a_peak_at_its_optical_thickness() -> None:
    """At both angles; it leads the ranking, and the document tells the peak in um."""
    found = found_of(spectrum(1, lambda wave, aoi: 0.004 * np.cos(4e3 * np.pi * 5.2 / wave)), far_field(2))
    for line in found.document()["fourier"]:
        assert line["peak"]["optical_thickness_um"] == pytest.approx(5.2, abs=0.1)
        assert line["peak"]["log_chance"] < np.log(1e-4)
    first = found.regions[0]
    assert (first.shot, first.family) == ("r", "optical thickness")
    assert first.words.startswith("optical thickness 5.2")


def test_what_the_fit_moves_is_not_left_over() -> None:
    """A film that is thicker than its manifest says is fitted; no power is left at its optical thickness."""
    measured = spectrum(3)
    thin = FILM.layers[0].model_copy(update={"thickness_nm": 1995.0})
    film = FILM.model_copy(update={"layers": (thin,)})
    found = found_of(replace(measured, film=film), far_field(4))
    assert found.fit.value("films.film.layers.0.thickness_nm") == pytest.approx(2000.0, abs=0.5)
    assert max(line["peak"]["power"] for line in fourier(found.fit)) < 12.0


def test_a_band_of_wavelengths_at_one_angle_is_named() -> None:
    """Both coordinates are told, the sign is that of measured minus model, and the other shot has nothing."""
    found = found_of(spectrum(5, lambda wave, aoi: -0.004 * ((wave > 600.0) & (aoi == 50.0))), far_field(6))
    region = worst(found)["r, wavelength and angle of incidence"]
    assert region.z < -6.0
    assert region.words.endswith("50 deg")
    assert float(region.words.split("-")[0]) > 590.0
    assert worst(found)["r, angle of incidence"].words == "50 deg"
    assert all(one.chance > 1e-3 for one in worst(found).values() if one.shot == "g")


def test_a_far_field_with_a_lobe_in_one_plane_is_named() -> None:
    """By theta and phi."""
    found = found_of(spectrum(7), far_field(8, lambda theta, phi: 0.03 * ((theta > 50.0) & (phi == 90.0))))
    region = worst(found)["g, theta and phi"]
    assert region.z > 3.5
    assert region.words.startswith("theta ")
    assert region.words.endswith("phi 90 deg")


def test_curves_have_profiles_with_bands_of_noise() -> None:
    """Line by line against wavelength or theta, one against the angle; 95 % of the points lie in their band."""
    inside = []
    for seed in range(5):
        rows = curve_profiles(found_of(spectrum(20 + seed), far_field(40 + seed)).fit)
        assert [(row["shot"], row["against"], row["line"]) for row in rows] == [
            ("r", "wavelength", "10 deg"), ("r", "wavelength", "50 deg"), ("r", "angle of incidence", ""),
            ("g", "theta", "phi 0 deg"), ("g", "theta", "phi 90 deg"), ("g", "phi", ""),
        ]  # fmt: skip
        assert {row["value_unit"] for row in rows} == {"percentage points", "% of the peak"}
        inside += [abs(y) <= b for row in rows for y, b in zip(row["difference"], row["band"], strict=True)]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)
    assert profiles(found_of(spectrum(9), far_field(9)).fit)[-1]["against"] == "phi"


def test_a_noisy_prediction_of_a_far_field_is_not_trusted() -> None:
    """Where Monte Carlo errs by more than 0.3 of the measurement, with the histories that would do."""

    class Noisy(Optics):
        def far_fields(self, model: Any, views: Sequence[Any], paths: Any = (), *_: Any) -> list[PredictedCurve]:
            return [
                replace(one, error=np.full(len(one.value), 0.5 * 0.01 / np.pi))
                for one in super().far_fields(model, views)
            ]

    observed = Observed((), tuple(curves_of([], [far_field(1)])), (), {})
    found = compared(MODEL, observed, Noisy(), Solver(None))  # type: ignore[arg-type]
    assert curve_noise_shares(found.fit)["g"] == pytest.approx(0.5, rel=0.05)
    assert not found.document()["trusted"]
    assert "histories would do" in found.document()["reason"]


def test_rows_that_see_one_number_of_a_far_field_err_together() -> None:
    """Four cuts of a square module at 0.25 deg: what is summed over them has the error of one bin, and a fit that may
    have 0.3 of it by itself took it for structure in 35 % of cases at 1 %. A spectrum has no such number."""

    def goniometer(step_deg: float, *phi_deg: float) -> MeasuredFarField:
        theta, phi = (one.ravel() for one in np.meshgrid(np.arange(0.0, 85.0, step_deg), phi_deg))
        table = FarFieldTable(theta, phi, np.cos(np.radians(theta)), np.full(len(theta), 0.01))
        return MeasuredFarField(FarFieldShot(id="g", kind="far_field", sample="chip", file="g.csv"), SAMPLE, table)

    def alike(*of: MeasuredFarField) -> list[float]:
        return [rows_alike(one) for one in curves_of([spectrum(1)], of)]

    plain, coarse, dense, cuts = alike(
        goniometer(2.5, 0.0), goniometer(0.25, 0.0), goniometer(0.25, 0.0, 90.0, 180.0, 270.0)
    )
    assert plain == 1.0
    assert coarse < 1.3
    assert dense == pytest.approx(340 / 58, rel=0.1)
    assert cuts == pytest.approx(4.0 * dense)
