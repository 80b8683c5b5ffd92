"""Chips that know nothing of their places, and what only looks as if each chip had a number of its own."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from validation.diagnose.by_place import chance_by_place, patterns

Real = NDArray[np.float64]

GRIDS = [(5, 5), (5, 5), (4, 3)]
PIXELS = 20


def spots(strength: float, width: float) -> Real:
    """(chip, row): what each chip's power does to the images of these arrays, less what their gains do."""
    at = np.arange(PIXELS)
    blocks, before = [], 0
    for rows, columns in GRIDS:
        y, x = (
            np.exp(-0.5 * ((at - (np.arange(n)[:, None] + 1.0) * PIXELS / (n + 1)) / width) ** 2)
            for n in (rows, columns)
        )
        light = np.einsum("ia,jb->ijab", y, x).reshape(rows * columns, -1)
        whole = light.sum(axis=0) / np.linalg.norm(light.sum(axis=0))
        block = np.zeros((rows * columns, len(GRIDS) * PIXELS**2))
        block[:, before : before + PIXELS**2] = light - np.outer(light @ whole, whole)
        blocks.append(block)
        before += PIXELS**2
    return strength * np.concatenate(blocks)


def test_of_chips_that_know_nothing_of_their_places_as_many_follow_the_field_as_are_said_to() -> None:
    """300 groups of 5 % spread, seen with noise: 0.05 of them below 0.05, by Clopper and Pearson 0.02 to 0.10."""
    rows, random = spots(20.0, 2.0), np.random.default_rng(5)
    members = 0.05 * random.standard_normal((300, len(rows)))
    chances = [
        chance_by_place(rows, one @ rows + random.standard_normal(rows.shape[1]), 0.5, GRIDS) for one in members
    ]
    assert 6 <= np.sum(np.array(chances) < 0.05) <= 30
    assert np.sum(np.array(chances) < 0.005) <= 6


@pytest.mark.parametrize("shape", ["halves", "shade"])
def test_what_a_camera_does_to_the_field_is_no_doing_of_chips(shape: str) -> None:
    """Two taps of a sensor, or a shade towards the corners, at 20 sigma: below 0.005 whatever the noise."""
    rows, random = spots(20.0, 2.0), np.random.default_rng(6)
    blocks = []
    for n, m in GRIDS:
        y, x = (one.ravel() / (k - 1) - 0.5 for one, k in zip(np.indices((n, m)), (n, m), strict=True))
        blocks.append(np.sign(x) if shape == "halves" else x**2 + y**2)
    seen = np.concatenate(blocks) @ rows
    seen *= 20.0 / np.linalg.norm(seen)
    chances = [chance_by_place(rows, seen + random.standard_normal(rows.shape[1]), 0.5, GRIDS) for _ in range(10)]
    assert max(chances) < 0.005


def test_chips_of_which_the_data_know_nothing_follow_nothing() -> None:
    """No row is left where gains do all that powers do."""
    assert chance_by_place(np.zeros((4, 30)), np.ones(30), 0.5, [(2, 2)]) == 1.0
    assert patterns([(2, 2)], 8).shape == (8, 10)
    with pytest.raises(ValueError, match="7 members on grids of 4 chips"):
        patterns([(2, 2)], 7)
