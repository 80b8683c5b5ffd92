"""What two noisy images of the same light agree about, against that light."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from validation.effects.agreed import agreed, bands

Real = NDArray[np.float64]

SHAPE = (42, 50)


def light() -> Real:
    """Smooth, with a mean, a slope and a spot."""
    rows, columns = np.indices(SHAPE)
    return np.asarray(1.0 + 0.02 * rows + 2.0 * np.exp(-((rows - 20) ** 2 + (columns - 30) ** 2) / 50.0))


def noisy(random: np.random.Generator, sd: float) -> tuple[Real, Real]:
    """Two images of the light, each with noise of its own."""
    one, other = (light() + sd * random.standard_normal(SHAPE) for _ in range(2))
    return one, other


def test_images_without_noise_stay_as_they_are() -> None:
    """Two that are the same: every band has weight 1."""
    np.testing.assert_allclose(agreed(light(), light()), light(), rtol=1e-12)
    np.testing.assert_array_equal(agreed(np.zeros(SHAPE), np.zeros(SHAPE)), 0.0)


@pytest.mark.parametrize("sd", [0.3, 1.0, 3.0])
def test_noise_is_taken_down_and_the_light_stays(sd: float) -> None:
    """At noise six times below to twice above the spot's peak: of the noise's energy less than a tenth is left."""
    one, other = noisy(np.random.default_rng(3), sd)
    left = agreed(one, other) - light()
    mean = (one + other) / 2.0 - light()
    assert np.sum(left**2) < 0.1 * np.sum(mean**2)
    assert np.sum(left**2) < 0.1 * np.sum(light() ** 2)


def test_noise_alone_leaves_next_to_nothing() -> None:
    """Of 200 pairs of noise: 2 % of its energy in the mean, where all of it would be kept without the weights."""
    random = np.random.default_rng(5)
    shares = []
    for _ in range(200):
        one, other = random.standard_normal((2, *SHAPE))
        shares.append(np.sum(agreed(one, other) ** 2) / np.sum(((one + other) / 2.0) ** 2))
    assert np.mean(shares) < 0.02


def test_coarse_noise_seldom_passes_for_light() -> None:
    """Noise of the five coarsest bands only, as of a walk inside one chip: each passes in 2 % of the cases."""
    random, coarse = np.random.default_rng(6), bands(SHAPE) < 5
    passed = []
    for _ in range(300):
        one, other = (idctn(coarse * random.standard_normal(SHAPE), norm="ortho") for _ in range(2))
        left = dctn(agreed(one, other), norm="ortho")
        passed += [
            bool(np.any(np.abs(left[bands(SHAPE) == band]) > 1e-9)) for band in np.unique(bands(SHAPE)[coarse])
        ]
    assert 0.01 < np.mean(passed) < 0.03


def test_bands_grow_with_frequency_and_none_is_of_a_few() -> None:
    """The mean and its neighbours are band 0; every band has enough cosines to tell chance by."""
    found = bands(SHAPE)
    assert found[0, 0] == found[0, 3] == 0
    assert np.all(np.diff(found[0]) >= 0)
    assert np.all(np.diff(found[:, 0]) >= 0)
    assert np.all(np.bincount(found.ravel())[:-1] >= 5)
