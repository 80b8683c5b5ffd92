"""Derivatives by what the twin cannot represent: Monte Carlo at moved models, with the same random numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import dctn

from containers.bsdf import Mirror
from containers.ray_tracing.build import array_of, scene_of
from containers.ray_tracing.monte_carlo import MonteCarlo, blocks_of
from containers.ray_tracing.predictor import _seed_of
from luxloop.effect import AppliedEffect
from luxloop.model import Fit, Model
from luxloop.model_file import find_model
from luxloop.ray import PredictionRequest
from tests.ray_scenes import within_edges
from tests.validation.workers import Workers
from validation.dataset.manifest import Sample
from validation.prediction import Anchored, Predictor, View
from validation.prediction import images as images_module

Real = NDArray[np.float64]

WALLS = "effects.edge_walls.reflectance"
RECEIVER, INDEX = "environment.receiver.reflectance", "environment.n_gan"
SAMPLE = Sample(
    id="two", layout="array", rows=1, columns=2, distance_um=180.0, width_um=40.0, spacing_um=400.0,
    thickness_um=20.0, dbr_pairs=0.0,
)  # fmt: skip
VIEW = View(SAMPLE, rows=16, columns=16, pixel_um=50.0, centre_px=(7.5, 7.5))
"""All of the module up to its walls; a pixel is 4 x 4 bins of the receiver."""
AT, HISTORIES = 0.5, 1 << 18


@pytest.fixture
def workers(tmp_path: Path) -> Workers:
    """Workers that nothing was asked yet."""
    return Workers(tmp_path)


@pytest.fixture
def model(monkeypatch: pytest.MonkeyPatch) -> Model:
    """The paper's, its module between walls whose reflectance is free; few histories."""
    monkeypatch.setattr(images_module, "DIFFERENCE_HISTORIES", HISTORIES)
    monkeypatch.setattr(images_module, "DIFFERENCE_EXITS", 1 << 15)
    walls = AppliedEffect(name="edge_walls", parameters={"reflectance": AT})
    free = {WALLS: Fit(free=True, lower=0.0, upper=0.9)}
    return find_model("paper").model_copy(update={"effects": (walls,), "fit": free})


def counted(reflectance: float, seed: int) -> Real:
    """The light of rays that land in each pixel, in 1/mm2 per flux of a chip: a count, without camera and modes."""
    environment = find_model("paper").environment
    layout = replace(array_of(environment, SAMPLE.design, 1, 2, SAMPLE.half_um), wall=Mirror(reflectance))
    of = scene_of(environment, SAMPLE.design, None, layout)
    tally = MonteCarlo(of, seed).run_to(blocks_of(HISTORIES))
    bins = within_edges(tally, of).sum(axis=0) / tally.total_histories
    assert bins.shape == (64, 64)
    pixels = bins.reshape(16, 4, 16, 4).sum(axis=(1, 3))
    return np.asarray(pixels * 2.0 / (1e-3 * VIEW.pixel_um) ** 2)


def difference(seed: int, step: float) -> Real:
    """The derivative by the walls' reflectance, of two counts with the same random numbers."""
    return (counted(AT + step, seed) - counted(AT - step, seed)) / (2.0 * step)


def asked_to_move(workers: Workers) -> list[PredictionRequest]:
    """The requests for images of moved models, each with its own Monte Carlo."""
    predictions = [one for one in workers.asked if isinstance(one, PredictionRequest)]
    return [one for one in predictions if one.anchor is not None and not one.anchor.shots]


def step_of(asked: PredictionRequest) -> float:
    """By how much the reflectance of the walls is moved to either side."""
    high, low = (float(one.effects[0].parameters["reflectance"]) for one in asked.shots)  # type: ignore[arg-type]  # a number
    assert (high + low) / 2.0 == pytest.approx(AT)
    return (high - low) / 2.0


def low_modes(image: Real) -> Real:
    """Its amplitudes in the lowest cosines between the walls, which rays determine best."""
    return np.asarray(dctn(image, norm="ortho")[:4, :4])


def test_the_derivative_by_walls_is_the_difference_of_monte_carlo_images(workers: Workers, model: Model) -> None:
    """That of a fit's predictor against two counts with its own random numbers, of walls that are no effect.

    All of the light to 1e-3, for the series mixes what is just within the walls with what is just beyond; low modes,
    in which steps of 0.02 of 0.9 have a spread of 0.07, to a third of it.
    """
    (found,) = Predictor(workers).images(model, [VIEW], (WALLS,), Anchored(model, 1, seed=3))
    by = found.jacobian_per_mm2[WALLS]
    (asked,) = asked_to_move(workers)
    assert asked.anchor is not None
    assert asked.anchor.histories == HISTORIES
    step = step_of(asked)
    expected = difference(int(_seed_of(asked.anchor, asked.shots[0])), step)
    assert by.sum() == pytest.approx(expected.sum(), rel=1e-3)
    np.testing.assert_allclose(low_modes(by), low_modes(expected), atol=0.025)


def test_the_derivative_by_walls_is_that_of_other_random_numbers_within_errors(
    workers: Workers, model: Model
) -> None:
    """Seven pairs of counts that share nothing with it say where it is, and how far it may be off."""
    (found,) = Predictor(workers).images(model, [VIEW], (WALLS,), Anchored(model, 1, seed=3))
    (asked,) = asked_to_move(workers)
    others = np.array([low_modes(difference(seed, step_of(asked))) for seed in range(10, 17)])
    error = others.std(axis=0, ddof=1) * np.sqrt(1.0 + 1.0 / 7.0)
    sigmas = (low_modes(found.jacobian_per_mm2[WALLS]) - others.mean(axis=0)) / error
    assert float(np.sqrt(np.mean(sigmas**2))) < 1.8


def test_what_the_twin_represents_is_differentiated_without_walls(workers: Workers, model: Model) -> None:
    """By a column, and by moved models: no Monte Carlo is run for these, and walls change nothing of them."""
    paths, predictor, bare = (
        (RECEIVER, INDEX),
        Predictor(workers),
        model.model_copy(update={"effects": (), "fit": {}}),
    )
    (walled,) = predictor.images(model, [VIEW], paths, Anchored(model, 1))
    assert [one.anchor.histories for one in asked_to_move(workers) if one.anchor is not None] == [0]
    (open_,) = predictor.images(bare, [VIEW], paths, Anchored(bare, 1))
    for path in paths:
        np.testing.assert_array_equal(walled.jacobian_per_mm2[path], open_.jacobian_per_mm2[path])
    assert np.abs(walled.irradiance_per_mm2 - open_.irradiance_per_mm2).max() > 0.01
