"""A film without its native oxide, diagnosed with the real thin-film worker: what can be named, and what cannot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from luxloop.model_file import find_model
from tests.validation.workers import Workers
from validation.comparing import Solver
from validation.dataset.manifest import FilmLayer, FilmSample, SpectrumShot
from validation.dataset.spectra import SpectrumTable
from validation.diagnose.held_out import folds_of
from validation.diagnosing import Diagnosing
from validation.effects.known import Known
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


def observed(predictor: Predictor, free: dict[str, tuple[float, float]]) -> Observed:
    """psi and delta of the film on 1.5 nm of oxide, with noise; told to be of the film on bare silicon."""
    random, wave, spectra = np.random.default_rng(3), np.arange(400.0, 801.0, 40.0), []
    truth = film({}, FilmLayer(material="SiO2", thickness_nm=1.5))
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


def engine(workers: Workers, free: dict[str, tuple[float, float]]) -> Diagnosing:
    """A diagnosis of the film by a few effects."""
    predictor = Predictor(workers)
    seen, known = observed(predictor, free), Known.ask(workers)
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
