"""The share of structure that is explained, and how well it is known: against draws of a known structure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from validation.contrasts.families import CELLS, layout_of
from validation.contrasts.places import Picture
from validation.diagnose.explained import Loudest, Share

Real = NDArray[np.float64]
SIDE, CELL_COUNT, DRAWS = 16, 64, 2000
STRUCTURE = 600.0
"""Sum of the squares of what is there, in those of a contrast's noise."""


def judge(weight: float) -> Loudest:
    """Blocks of 2 x 2 pixels of one image, each of variance 4: 4 `weight` times a chi2 of 64."""
    y, x = np.indices((SIDE, SIDE)) * 25.0
    layout = layout_of([Picture("a", np.ones((SIDE, SIDE), bool), 25.0, x, y, np.zeros((1, 2)), 0)])
    weights = np.full(layout.cells.shape[0] + layout.sums.shape[0], weight)
    return Loudest(layout, weights, CELLS, 4.0 * weight * CELL_COUNT, CELL_COUNT, np.zeros(SIDE**2))


def drawn(left: float, seed: int) -> Real:
    """Residuals (draw, row): noise, and so much of the energy of the structure."""
    blocks = np.random.default_rng(0).standard_normal((SIDE // 2, SIDE // 2))
    blocks *= np.sqrt(left * STRUCTURE / 4.0 / np.sum(blocks**2))  # a sum of four pixels has the variance 4
    wave = np.repeat(np.repeat(blocks, 2, axis=0), 2, axis=1).ravel()
    return np.asarray(wave + np.random.default_rng(seed).standard_normal((DRAWS, SIDE**2)))


@pytest.mark.parametrize("weight", [0.25, 0.5])
@pytest.mark.parametrize("left", [0.25, 0.5, 0.8])
def test_a_share_scatters_as_its_error_says(left: float, weight: float) -> None:
    """With other noise in the energy that was there than in what is left, whatever the contrasts' common factor."""
    loudest = judge(weight)
    pairs = zip(drawn(1.0, 1), drawn(left, 2), strict=True)
    shares = [replace(loudest, base=before).share(after, same_noise=False) for before, after in pairs]
    as_they_scatter(shares, 1.0 - left)


@pytest.mark.parametrize("explained", [0.02, 0.2, 0.5, 0.9])
def test_with_one_noise_in_both_what_explains_little_is_known_well(explained: float) -> None:
    """What is explained stands square on what is left, as a column that was fitted does."""
    loudest, noise = judge(0.5), drawn(0.0, 4)
    names = np.random.default_rng(5).standard_normal((SIDE // 2, SIDE // 2))
    whole = drawn(1.0, 6)[0] - drawn(0.0, 6)[0]
    other = np.kron(names, np.ones((2, 2))).ravel()
    other -= whole * (whole @ other) / (whole @ whole)
    other *= np.sqrt(explained * (1.0 - explained)) * np.linalg.norm(whole) / np.linalg.norm(other)
    after = (1.0 - explained) * whole + other  # of energy 1 - explained, and square on what is taken away
    shares = [replace(loudest, base=whole + one).share(after + one, same_noise=True) for one in noise]
    as_they_scatter(shares, explained)
    apart = [replace(loudest, base=whole + one).share(after + one, same_noise=False).error for one in noise[:50]]
    assert np.mean(apart) > (2.0 if explained < 0.3 else 1.0) * np.mean([one.error for one in shares])


def as_they_scatter(shares: list[Share], explained: float) -> None:
    """Their mean is what is explained, their spread what their errors say."""
    values, errors = (np.array([getattr(one, name) for one in shares]) for name in ("value", "error"))
    assert np.mean(values) == pytest.approx(explained, abs=0.02)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(np.std(values), rel=0.06)


def test_a_variance_scale_is_taken_off_the_energy() -> None:
    """All noise twice as large: the same energy, the same share."""
    loudest = replace(judge(0.25), base=drawn(1.0, 1)[0])
    residual = drawn(0.5, 2)[0]
    assert loudest.energy(2.0 * residual, 4.0) == pytest.approx(loudest.energy(residual), rel=1e-9)
    for same in (True, False):
        doubled, one = (loudest.share(*of, same_noise=same) for of in ((2.0 * residual, 4.0), (residual,)))
        assert (doubled.value, doubled.error) == pytest.approx((one.value, one.error), rel=1e-9)


def test_where_there_was_no_structure_no_share_decides() -> None:
    """Nothing divided by nothing; else a share decides that is known to 0.15 or better."""
    assert judge(0.25).share(drawn(0.0, 1)[0], same_noise=True) == Share(0.0, np.inf)
    assert [Share(0.9, error).decides for error in (0.15, 0.16, np.inf)] == [True, False, False]
