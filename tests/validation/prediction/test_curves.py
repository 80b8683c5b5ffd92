"""Predictions of spectra and far fields against the workers that make them, and their derivatives."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.model import Fit, Model
from tests.validation.prediction.views import LOSS, SINGLE
from tests.validation.workers import Workers
from validation.comparing import FAR_BINS
from validation.dataset.manifest import FilmLayer, FilmSample
from validation.fit.curves import curve_of
from validation.prediction import Curve, FarView, Predictor
from validation.prediction.differences import moved_models, step_of
from validation.prediction.far_fields import _seen
from validation.prediction.spectra import film_value, stack_of, with_film_value

FILM = FilmSample(
    id="polymer.1",
    incident="air",
    exit="Si",
    layers=(
        FilmLayer(cauchy=(1.45, 0.005), thickness_nm=300.0, free={"a": (1.3, 1.6), "thickness_nm": (100.0, 500.0)}),
        FilmLayer(material="SiO2", thickness_nm=1.5),
    ),
)


def curve(quantity: Any = "R", film: FilmSample = FILM) -> Curve:
    """Ragged rows: two polarisations at other wavelengths and angles."""
    polarisation = ("s", "s", "p", "u") if quantity in ("R", "T") else ("",) * 4
    return Curve(
        film, quantity, np.array([500.0, 600.0, 500.0, 700.0]), np.array([60.0, 40.0, 60.0, 55.0]), polarisation
    )


def test_a_film_is_turned_round_for_the_workers() -> None:
    """A manifest begins with the light, a stack with the bulk."""
    stack = stack_of(FILM)
    assert (stack.inside.material, stack.outside.n) == ("Si", 1.0)
    assert [str(layer) for layer in stack.layers] == ["SiO2(1.5 nm)", "1.45+0.005/um2(300 nm)"]


@pytest.mark.parametrize("quantity", ["R", "psi", "delta"])
def test_rows_of_a_curve_are_the_instruments_readings(workers: Workers, model: Model, quantity: str) -> None:
    """Each at its own wavelength, angle and polarisation; one question for each polarisation."""
    from containers.thin_film.film_measurement import measure

    asked = curve(quantity)
    (found,) = Predictor(workers).spectra(model, [asked])
    rows = zip(asked.wavelength_nm, asked.aoi_deg, asked.polarisation, strict=True)
    expected = [measure(stack_of(FILM), quantity, wave, aoi, one or "u")[0, 0] for wave, aoi, one in rows]
    np.testing.assert_allclose(found.value, expected, rtol=1e-12)
    assert len(workers.of_kind("film")) == (3 if quantity == "R" else 1)


def test_derivatives_of_curves_are_those_of_moved_films(workers: Workers, model: Model) -> None:
    """By a thickness and a Cauchy coefficient of the film; a delta that passes 360 degrees has none of that jump."""
    predictor = Predictor(workers)
    steps = {
        f"films.{FILM.id}.layers.0.{name}": h for name, h in (("thickness_nm", 0.02), ("a", 1e-4), ("b_um2", 1e-5))
    }
    other = replace(curve(), film=FILM.model_copy(update={"id": "other"}))
    for quantity in ("R", "delta"):
        found, elsewhere = predictor.spectra(model, [curve(quantity), other], tuple(steps))
        for path, h in steps.items():
            value = film_value(FILM, path)
            ends = [with_film_value(FILM, path, value + s * h) for s in (1, -1)]
            high, low = predictor.spectra(model, [curve(quantity, film) for film in ends])
            difference = (high.value - low.value) / (2.0 * h)
            np.testing.assert_allclose(found.jacobian[path], difference, rtol=2e-2, atol=2e-3 * abs(difference).max())
            assert not elsewhere.jacobian[path].any()


def test_derivatives_of_curves_by_an_effect_are_those_of_the_model_moved(workers: Workers, model: Model) -> None:
    """A layer that was missing, thicker and thinner; curves of two angles are one question for each model."""
    path, at = "effects.film_missing_layer.thickness_nm", {"thickness_nm": 1.5, "material": "SiO2", "face": "inner"}
    limits = {path: Fit(free=True, lower=0.0, upper=10.0)}
    with_layer = model.model_copy(
        update={"effects": (AppliedEffect(name="film_missing_layer", parameters=at),), "fit": model.fit | limits}
    )
    predictor, wave = Predictor(workers), np.array([450.0, 550.0])
    curves = [
        replace(curve("psi"), wavelength_nm=wave, aoi_deg=wave * 0.0 + aoi, polarisation=("", "")) for aoi in (60, 70)
    ]
    before = len(workers.of_kind("film"))
    found = predictor.spectra(with_layer, curves, (path,))
    assert len(workers.of_kind("film")) - before == 3
    high, low = (predictor.spectra(with_layer.with_value(path, 1.5 + by), curves) for by in (0.02, -0.02))
    for one, above, below in zip(found, high, low, strict=True):
        np.testing.assert_allclose(one.jacobian[path], (above.value - below.value) / 0.04, rtol=1e-2)


def test_an_effect_is_moved_by_a_share_of_its_range_whatever_its_numbers_are_called(model: Model) -> None:
    """A user's haze with an a is no film's index, whose step is 1e-4; layers of the catalogue keep their steps."""

    def step(effect: str, name: str, upper: float) -> float:
        path = f"effects.{effect}.{name}"
        of = {"effects": (AppliedEffect(name=effect, parameters={name: 0.5 * upper}),)}
        free = {"fit": {path: Fit(free=True, lower=0.0, upper=upper)}}
        low, high = (
            one.what.leaves()[path] for one in moved_models(model.model_copy(update=of | free), path, 0.25)[::-1]
        )
        return 0.5 * (high - low)

    assert step("my_haze", "a", 1.0) == pytest.approx(0.25)
    assert step("my_film", "thickness_nm", 8.0) == pytest.approx(2.0)
    for name in ("film_missing_layer", "film_interlayer"):
        assert step(name, "thickness_nm", 8.0) == pytest.approx(0.01)
    assert step_of("films.polymer.layers.0.a", 0.25) == 1e-4
    assert step_of("environment.active_layer_depth", 0.25) == 0.2


@pytest.mark.parametrize(("at", "moved"), [(0.5, [0.75, 0.25]), (0.0, [0.0, 0.25, 0.5])], ids=["middle", "end"])
def test_what_a_sample_has_of_its_own_is_moved_there(model: Model, at: float, moved: list[float]) -> None:
    """By a share of the range that all samples have, to the inside of its end; others stay."""
    own = {name: {"my_film": {"thickness_nm": value}} for name, value in (("array", at), ("other", 0.3))}
    of = {"effects": (AppliedEffect(name="my_film", parameters={"thickness_nm": 0.0}),), "samples": own}
    limits = {"fit": {"effects.my_film.thickness_nm": Fit(free=True, lower=0.0, upper=1.0)}}
    found = moved_models(model.model_copy(update=of | limits), "samples.array.my_film.thickness_nm", 0.25)
    assert [one.what.samples["array"]["my_film"]["thickness_nm"] for one in found] == pytest.approx(moved)
    assert [one.what.samples["other"] for one in found] == [own["other"]] * len(found)
    assert sum(one.weight for one in found) == pytest.approx(0.0)


@pytest.mark.parametrize(
    "path",
    ["films.polymer.1.layers.2.thickness_nm", "films.polymer.1.layers.1.a", "films.polymer.1.colour", "films.x.a"],
)
def test_a_path_that_no_film_has_is_refused(workers: Workers, model: Model, path: str) -> None:
    """Another layer, a coefficient of a named material, nonsense, another film."""
    with pytest.raises(InputError, match="path"):
        Predictor(workers).spectra(model, [curve()], (path,))


def test_a_far_field_is_the_modules(workers: Workers, model: Model) -> None:
    """Its integral over the half space is the light on its first way to the receiver; errors and a derivative too."""
    theta, phi = (axis.ravel() for axis in np.meshgrid(np.arange(0.5, 90.0), np.arange(5.0, 360.0, 10.0)))
    predictor = Predictor(workers)
    (found,) = predictor.far_fields(model, [FarView(SINGLE, theta, phi)], (LOSS,), histories=1 << 18)
    weight = np.sin(np.radians(theta)) * np.radians(1.0) * np.radians(10.0)
    stated = workers.run(workers.of_kind("ray")[-1]).result["far_field"]["module"]["flux_ratio"]["value"]
    assert (found.value * weight).sum() == pytest.approx(stated, rel=0.02)
    assert workers.run(workers.of_kind("ray")[-1]).arrays["far_module_per_sr"].shape == FAR_BINS
    assert found.error is not None
    assert 0.0 < found.error.mean() < 0.2 * found.value.mean()
    assert (found.jacobian[LOSS] * weight).sum() < 0.0  # more loss, less light


def test_no_two_far_fields_share_random_numbers(workers: Workers, model: Model) -> None:
    """Nor do two samples of equal numbers; a moved model of a sample has the sample's own, for the difference."""
    replicate = SINGLE.model_copy(update={"id": "replicate"})
    views = [FarView(one, np.array([10.0]), np.array([0.0])) for one in (SINGLE, replicate)]
    Predictor(workers).far_fields(model, views, (LOSS,), histories=1 << 12, seed=3)
    seeds = [request.seed for request in workers.of_kind("ray")]
    one, other = set(seeds[: len(seeds) // 2]), set(seeds[len(seeds) // 2 :])
    assert len(one) == len(other) == 1
    assert one != other
    Predictor(workers).far_fields(model, views[:1], (), histories=1 << 12, seed=4)
    assert workers.of_kind("ray")[-1].seed not in one


def test_a_far_field_goes_on_to_normal_and_horizon() -> None:
    """Lambert's law in bins that are equal in cos(theta) is a straight line: it is met everywhere. With the outer
    bins' own value it was 0.8 % of the peak off at 0 and 90 deg."""
    cosines = (np.arange(64) + 0.5) / 64.0
    bins = np.repeat(cosines[:, None] / np.pi, 64, axis=1)
    answer: Any = SimpleNamespace(
        arrays={"far_module_per_sr": bins, "far_module_error_per_sr": np.full((64, 64), 0.01)}
    )
    theta = np.linspace(0.0, 90.0, 181)
    view = FarView(SINGLE, theta, np.full(181, 17.0))
    assert _seen(answer, view, "far_module_per_sr") == pytest.approx(np.cos(np.radians(theta)) / np.pi, abs=1e-12)
    error = _seen(answer, view, "far_module_error_per_sr")
    assert error[90] == pytest.approx(0.01)
    assert error[[0, -1]] == pytest.approx(
        0.01 * np.sqrt(2.5)
    )  # of 1.5 one and 0.5 of the next, which are independent


def test_films_whose_names_begin_alike_are_told_apart(workers: Workers, model: Model) -> None:
    """ "oxide-1" and "oxide-1.5": a path of one is no path of the other."""
    short, long = (FILM.model_copy(update={"id": name}) for name in ("oxide-1", "oxide-1.5"))
    path = "films.oxide-1.5.layers.0.thickness_nm"
    first, second = Predictor(workers).spectra(model, [curve(film=short), curve(film=long)], (path,))
    assert not np.any(first.jacobian[path])
    assert np.all(second.jacobian[path] != 0.0)
    one: Any = SimpleNamespace(film=short, shot=SimpleNamespace(quantity="R", bandwidth_nm=0.0), table=curve())
    assert curve_of(one, {path: 350.0}).film == short
