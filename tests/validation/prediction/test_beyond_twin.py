"""Derivatives by what the twin cannot represent: Monte Carlo at moved models, with the same random numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

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
CUTOFF_X = 10.652710526
"""x K1(x), which a Lambertian point has left of a wave k at x = k height, is 1e-4 there."""


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


def counted(reflectance: float, seed: int, smooth: bool = False) -> Real:
    """The light of rays that land in each pixel, in 1/mm2 per flux of a chip: a count, without camera and modes.

    `smooth`: of the count on all of the map, its pad beyond the walls too, the waves that light can have.
    """
    environment = find_model("paper").environment
    layout = replace(array_of(environment, SAMPLE.design, 1, 2, SAMPLE.half_um()), wall=Mirror(reflectance))
    of = scene_of(environment, SAMPLE.design, None, layout)
    tally = MonteCarlo(of, seed).run_to(blocks_of(HISTORIES))
    if smooth:
        tally.bins[:, 0] = low_pass(tally.cell_bins(), tally.box.step_um, CUTOFF_X / of.height_um)
        tally.bins[:, 1] = 0.0
    bins = within_edges(tally, of).sum(axis=0) / tally.total_histories
    assert bins.shape == (64, 64)
    pixels = bins.reshape(16, 4, 16, 4).sum(axis=(1, 3))
    return np.asarray(pixels * 2.0 / (1e-3 * VIEW.pixel_um) ** 2)


def low_pass(bins: Real, step_um: float, cutoff_per_um: float) -> Real:
    """The bins (group, y, x) by their cosines up to a cut-off, fading to nothing at 1.3 of it, as cos^2."""
    k = [np.pi * np.arange(n) / (n * step_um) for n in bins.shape[1:]]
    beyond = (np.hypot(k[0][:, None], k[1]) / cutoff_per_um - 1.0) / 0.3
    fading = np.cos(np.pi / 2.0 * np.clip(beyond, 0.0, 1.0)) ** 2
    return np.asarray(idctn(dctn(bins, axes=(1, 2), norm="ortho") * fading, axes=(1, 2), norm="ortho"))


def difference(seed: int, step: float, smooth: bool = False) -> Real:
    """The derivative by the walls' reflectance, of two counts with the same random numbers."""
    return (counted(AT + step, seed, smooth) - counted(AT - step, seed, smooth)) / (2.0 * step)


def asked_to_move(workers: Workers) -> list[PredictionRequest]:
    """The requests for images of moved models: those with so many exits."""
    predictions = [one for one in workers.asked if isinstance(one, PredictionRequest)]
    return [one for one in predictions if one.exit_histories == images_module.DIFFERENCE_EXITS]


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

    A map goes on beyond walls, and its low-pass mixes what is just within with what is just beyond: of the light
    between the walls that is noise of 4e-4 to 1.5e-3 of the derivative (which has 5e-3 itself). With the same
    low-pass of the counts nothing is left but the spline between the map's points, 6e-4 of the brightest pixel.
    """
    (found,) = Predictor(workers).images(model, [VIEW], (WALLS,), Anchored(model, 1, seed=3))
    by = found.jacobian_per_mm2[WALLS]
    (asked,) = asked_to_move(workers)
    assert asked.anchor is not None
    assert asked.anchor.histories == HISTORIES
    step = step_of(asked)
    seed = int(_seed_of(asked.anchor, asked.shots[0]))
    expected = difference(seed, step, smooth=True)
    assert by.sum() == pytest.approx(expected.sum(), rel=1e-5)
    np.testing.assert_allclose(by, expected, atol=1e-3 * np.abs(expected).max())
    np.testing.assert_allclose(low_modes(by), low_modes(difference(seed, step)), atol=0.025)


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
