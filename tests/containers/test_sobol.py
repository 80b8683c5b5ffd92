"""Scrambled Sobol points: the published sequence, a net in every scramble, scrambles independent of each other."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from containers.ray_tracing.kernel import scramble_keys
from containers.ray_tracing.sobol import DIMENSIONS, DIRECTIONS, point

Real = NDArray[np.float64]


def plain(count: int) -> Real:
    """(count, dimension), points without any scramble, from the direction numbers alone."""
    found = np.zeros((count, DIMENSIONS), np.uint64)
    for index, bit in itertools.product(range(count), range(20)):
        if index >> bit & 1:
            found[index] ^= DIRECTIONS[:, bit]
    return found * 2.0**-32


def keys_of(seed: int, group: int) -> NDArray[np.uint64]:
    """The scramble of a group."""
    keys = np.zeros(DIMENSIONS, np.uint64)
    scramble_keys(np.uint64(seed), group, keys)
    return keys


def scrambled(count: int, seed: int = 1, group: int = 0, first: int = 0) -> Real:
    """(count, dimension) points of a group."""
    found, keys = np.zeros((count, DIMENSIONS)), keys_of(seed, group)
    for i in range(count):
        point(DIRECTIONS, np.uint64(first + i), keys, found[i])
    return found


@pytest.mark.parametrize("count", [8, 64, 1024])
def test_the_points_are_those_of_joe_and_kuo(count: int) -> None:
    """The same set as scipy's; its order is that of the Gray code."""
    expected = qmc.Sobol(DIMENSIONS, scramble=False, bits=32).random(count)
    assert np.array_equal(np.sort(plain(count), axis=0), np.sort(expected, axis=0))
    rows = {tuple(row) for row in plain(count)}
    assert rows == {tuple(row) for row in expected}


@pytest.mark.parametrize("group", [0, 1, 31])
def test_every_scramble_keeps_the_net_in_each_dimension(group: int) -> None:
    """Of 1024 points one lies in each 1024th of every axis, also in the second and the fifth thousand."""
    for first in (0, 1024, 5 * 1024):
        cells = np.floor(scrambled(1024, group=group, first=first) * 1024).astype(int)
        assert np.array_equal(np.sort(cells, axis=0), np.broadcast_to(np.arange(1024)[:, None], cells.shape))


def test_every_scramble_keeps_the_net_in_the_plane() -> None:
    """The first two dimensions are a (0, 8, 2) net: one point in each elementary interval of area 1/256."""
    for group in range(4):
        points = scrambled(256, group=group)[:, :2]
        for bits in range(9):
            cells = np.floor(points * [2.0**bits, 2.0 ** (8 - bits)]).astype(int)
            assert len({tuple(cell) for cell in cells}) == 256


def test_a_scramble_is_as_even_in_six_dimensions_as_the_sequence_itself() -> None:
    """Scrambling moves points within elementary intervals only: the same number in each of 64 boxes."""
    of_plain, of_scrambled = plain(1024), scrambled(1024, group=3)
    for points in (of_plain, of_scrambled):
        boxes = np.floor(points * 2).astype(int) @ 2 ** np.arange(6)
        assert np.array_equal(np.bincount(boxes, minlength=64), np.full(64, 16))


def test_the_number_of_a_point_decides_it() -> None:
    """Points of a second call go on where the first ended."""
    assert np.array_equal(scrambled(64)[40:], scrambled(24, first=40))


def test_scrambles_of_other_groups_and_seeds_are_independent() -> None:
    """The n-th point of many scrambles is uniform, and neighbours among the groups are not correlated."""
    for index in (0, 1, 777):
        over_groups = np.array([scrambled(1, group=group, first=index)[0] for group in range(2000)])
        assert min(stats.kstest(column, "uniform").pvalue for column in over_groups.T) > 1e-3
        correlation = np.corrcoef(np.column_stack([over_groups[:-1], over_groups[1:]]).T)
        assert np.abs(correlation - np.eye(2 * DIMENSIONS)).max() < 4.5 / np.sqrt(2000)
    assert not np.array_equal(scrambled(8, seed=1), scrambled(8, seed=2))


def test_the_spread_between_scrambles_is_the_error_of_their_mean() -> None:
    """The mean of x y z over 256 points, of 400 scrambles: unbiased, and far closer than 256 random points."""
    means = np.array([scrambled(256, group=group)[:, :3].prod(axis=1).mean() for group in range(400)])
    assert abs(means.mean() - 0.125) < 4.0 * means.std(ddof=1) / np.sqrt(400)
    random_error = np.sqrt((1 / 27 - 1 / 64) / 256)
    assert means.std(ddof=1) < random_error / 5.0
