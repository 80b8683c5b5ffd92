"""A film without its native oxide, diagnosed with the real thin-film worker: what can be named, and what cannot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from luxloop.errors import InputError
from luxloop.model import Fit as Limits
from luxloop.model_file import find_model
from tests.validation.workers import Workers
from validation.comparing import Solver, compared
from validation.dataset.manifest import FilmLayer, FilmSample, SpectrumShot
from validation.dataset.spectra import SpectrumTable
from validation.diagnose.held_out import folds_of
from validation.diagnosing import Diagnosing
from validation.effects.known import Known, applied, with_effect
from validation.fit import curves_of, film_parameters
from validation.measured import MeasuredSpectrum
from validation.observed import Observed
from validation.prediction import Curve, Predictor

ANGLES_DEG = (55.0, 65.0, 75.0)
SIGMA_DEG = 0.05
FREE = {"thickness_nm": (20.0, 40.0), "a": (1.3, 1.6), "b_um2": (-0.05, 0.05)}
AMONG = ("film_missing_layer", "film_interface_roughness", "film_dispersion")


def film(free: dict[str, tuple[float, float]], *below: FilmLayer) -> FilmSample:
    """A polymer on silicon."""
    polymer = FilmLayer(cauchy=(1.455, 0.0066), thickness_nm=28.8, free=free)
    return FilmSample(id="polymer", exit="Si", layers=(polymer, *below))


OXIDISED = film({}, FilmLayer(material="SiO2", thickness_nm=1.5))


def observed(predictor: Predictor, free: dict[str, tuple[float, float]], truth: FilmSample = OXIDISED) -> Observed:
    """psi and delta of the film on 1.5 nm of oxide, with noise; told to be of the film on bare silicon."""
    random, wave, spectra = np.random.default_rng(3), np.arange(400.0, 801.0, 40.0), []
    for angle in ANGLES_DEG:
        for quantity in ("psi", "delta"):
            aoi, none = np.full(wave.size, angle), ("",) * wave.size
            (seen,) = predictor.spectra(find_model("paper"), [Curve(truth, quantity, wave, aoi, none)])
            value = seen.value + SIGMA_DEG * random.standard_normal(wave.size)
            name = f"{quantity}-{angle:g}"
            shot = SpectrumShot(id=name, kind="spectrum", film="polymer", quantity=quantity, file=f"{name}.csv")
            table = SpectrumTable(wave, aoi, none, value, np.full(wave.size, SIGMA_DEG))
            spectra.append(MeasuredSpectrum(shot, film(free), table))
    films, at = film_parameters(spectra)
    return Observed((), tuple(curves_of(spectra, ())), tuple(films), at)


@pytest.fixture
def workers(tmp_path: Path) -> Workers:
    """The workers in this process."""
    return Workers(tmp_path)


def engine(workers: Workers, free: dict[str, tuple[float, float]], truth: FilmSample = OXIDISED) -> Diagnosing:
    """A diagnosis of the film by a few effects."""
    predictor = Predictor(workers)
    seen, known = observed(predictor, free, truth), Known.ask(workers)
    return Diagnosing(find_model("paper"), seen, predictor, known, Solver(None), (), among=AMONG)


def test_the_layer_that_a_known_film_lacks_is_named_and_rough_faces_are_not(workers: Workers) -> None:
    """The oxide with its thickness; the error at angles left out falls, that of rough faces hardly."""
    found = engine(workers, {})
    first = found.diagnosed().steps[0]
    assert first.verdict.word == "one_effect"
    best = first.best
    assert (best.name, dict(best.shape)["material"]) == ("film_missing_layer", "SiO2")
    assert abs(best.value - 1.5) < 3.0 * best.error
    assert best.held_out is not None
    assert best.held_out.falls
    assert best.held_out_percent is not None
    rough = next(one for one in first.explanations if one.name == "film_interface_roughness")
    assert rough.held_out_percent is not None
    assert best.held_out_percent[1] < 0.2 * rough.held_out_percent[1]
    assert [name for name, _ in folds_of(first.ground.fit, "per_sample")] == ["55 deg", "65 deg", "75 deg"]


def test_words_that_the_data_cannot_tell_are_said_and_the_usual_ones_taken(workers: Workers) -> None:
    """1.5 nm below a film of nearly the same index are like 1.5 nm upon it: the oxide of silicon comes first."""
    found = engine(workers, {})
    base = found.fitted(found.model)
    added = found.refitted(base, found.spec("film_missing_layer"))
    assert dict(added.shape) == {"material": "SiO2", "face": "inner"}
    assert ("SiO2", "outer") in added.as_well


def test_where_nothing_of_the_film_is_known_no_layer_is_missed(workers: Workers) -> None:
    """Thickness and index of the film make up for the oxide: nothing is visible, and that is what is said."""
    found = engine(workers, FREE)
    diagnosis = found.diagnosed()
    assert diagnosis.verdict.word == "nothing_visible"


def test_a_thickness_that_is_held_wrong_is_told_with_what_it_would_be(workers: Workers) -> None:
    """The film is 0.6 nm thicker than the data set says: a layer is named, and that a free thickness would do."""
    thicker = film({}).layers[0].model_copy(update={"thickness_nm": 29.4})
    truth = film({}).model_copy(update={"layers": (thicker,)})
    asked = engine(workers, {}, truth)
    found = asked.diagnosed()
    assert found.set[0] == "film_missing_layer"
    (held,) = (one for one in asked.held(found) if one.path.endswith("thickness_nm"))
    assert held.value == 28.8
    assert abs(held.would_be - 29.4) < 4.0 * held.error + 0.02  # by the derivative at 28.8
    assert "is held at 28.8: 29.4" in held.words


def test_what_is_fitted_or_fits_is_not_told_as_held(workers: Workers) -> None:
    """A free thickness is taken out of all effects; where nothing is visible nothing is asked."""
    asked = engine(workers, {"thickness_nm": (20.0, 40.0)})
    assert not any(one.path.endswith("thickness_nm") for one in asked.held(asked.diagnosed()))
    asked = engine(workers, {}, film({}))
    assert asked.held(asked.diagnosed()) == []


def test_the_derivative_by_a_small_effect_is_the_one_at_its_size(workers: Workers) -> None:
    """Of thickness spread by 0.002, whose square fringes follow: 2 % of its range away it is another by a quarter."""
    predictor, path = Predictor(workers), "effects.film_thickness_spread.spread_ratio"
    spec = Known.ask(workers).spec("film_thickness_spread")
    model = with_effect(find_model("paper"), applied(spec, {"spread_ratio": 0.002}))
    model = model.model_copy(update={"fit": {path: Limits(free=True, lower=0.0, upper=0.1)}})
    wafer = FilmSample(id="wafer", exit="Al2O3", layers=(FilmLayer(material="GaN", thickness_nm=5612.0),))
    nm = np.arange(400.0, 500.0, 0.5)
    curve = Curve(wafer, "R", nm, np.zeros(nm.size), ["u"] * nm.size)
    (found,) = predictor.spectra(model, [curve], [path])
    more, less = (predictor.spectra(model.with_value(path, 0.002 + by), [curve])[0].value for by in (1e-5, -1e-5))
    fine = (more - less) / 2e-5
    assert np.linalg.norm(found.jacobian[path] - fine) < 0.005 * np.linalg.norm(fine)


def test_no_more_values_than_are_fitted_is_said(workers: Workers) -> None:
    """One reflectance and one free thickness: nothing is left that could be compared."""
    shot = SpectrumShot(id="R", kind="spectrum", film="polymer", quantity="R", file="R.csv")
    table = SpectrumTable(np.array([500.0]), np.zeros(1), ("u",), np.array([0.3]), np.array([0.01]))
    spectra = [MeasuredSpectrum(shot, film({"thickness_nm": (20.0, 40.0)}), table)]
    films, at = film_parameters(spectra)
    seen = Observed((), tuple(curves_of(spectra, ())), tuple(films), at)
    with pytest.raises(InputError, match=r"1 values in all.*more than the 1 that are fitted"):
        compared(find_model("paper"), seen, Predictor(workers), Solver(None))
