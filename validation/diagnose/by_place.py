"""Whether a group's members follow the field, more closely than chips by chance would.

What a camera or an optic does to the field (a tap's gain, a shade, a bent image) is imitated by the powers or places
of chips, of which there are as many as the image has spots. But chips that are binned, or shaken, know nothing of
where they stand. So members are held against members with a mean that goes through each sample's field as a plane
and a bent one do (H: x, y, x y, x^2, y^2):

    m ~ N(0, s^2)       against      m ~ N(H c, s^2)

with the most likely spread s in either; the ratio of likelihoods is judged by groups made up without a mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

DRAWS, SEED = 2_000, 1
SPREADS = 80
LEAST_SEEN = 1e-9
"""Of the largest eigenvalue: below it the fit's own parameters do what members do together."""


def chance_by_place(rows: Real, residual: Real, largest: float, grids: Sequence[tuple[int, int]]) -> float:
    """The chance that members which know nothing of their places follow them as closely; 1 where none can.

    Parameters
    ----------
    rows : (member, row), whitened columns less what the fit's own parameters do; members chip by chip, row by row, in
        the order of `grids`, once for each of the effect's parameters. residual : (row,), whitened.
    largest : spread that is tried. grids : rows and columns of the chips of each sample.
    """
    size, axes = np.linalg.eigh(rows @ rows.T)
    seen = size > LEAST_SEEN * size.max(initial=0.0)
    size, axes = size[seen], axes[:, seen]
    mean = np.sqrt(size)[:, None] * (axes.T @ patterns(grids, len(rows)))
    if not mean.size:
        return 1.0
    spreads = np.concatenate([[0.0], largest * np.geomspace(1e-4, 1.0, SPREADS - 1)])
    variances = 1.0 + np.outer(spreads**2, size)
    bases = [_basis(mean / np.sqrt(variance)[:, None]) for variance in variances]
    found = (axes.T @ (rows @ residual) / np.sqrt(size))[None]
    without, ratio = _likelihoods(found, variances, bases)
    likeliest = variances[int(np.argmax(without[0]))]
    made_up = np.random.default_rng(SEED).standard_normal((DRAWS, len(size))) * np.sqrt(likeliest)
    _, ratios = _likelihoods(made_up, variances, bases)
    return float((1 + np.sum(ratios >= ratio[0])) / (1 + DRAWS))


def patterns(grids: Sequence[tuple[int, int]], members: int) -> Real:
    """(member, pattern): planes and bent ones, in each grid by itself.

    Raises ValueError where the members are no whole number of grids.
    """
    chips = sum(rows * columns for rows, columns in grids)
    if not chips or members % chips:
        raise ValueError(f"{members} members on grids of {chips} chips")
    blocks = [_of_grid(*grid) for _ in range(members // chips) for grid in grids]
    found = np.zeros((members, sum(one.shape[1] for one in blocks)))
    down = np.cumsum([0, *(one.shape[0] for one in blocks)])
    along = np.cumsum([0, *(one.shape[1] for one in blocks)])
    for block, (top, bottom), (left, right) in zip(blocks, pairwise(down), pairwise(along), strict=True):
        found[top:bottom, left:right] = block
    return found


def _of_grid(rows: int, columns: int) -> Real:
    y, x = (one.ravel() - one.mean() for one in np.indices((rows, columns)))
    found = np.column_stack([x, y, x * y, x**2, y**2])
    return np.asarray(found - found.mean(axis=0))


def _basis(columns: Real) -> Real:
    left, length, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, length > 1e-6 * length.max(initial=0.0)])


def _likelihoods(found: Real, variances: Real, bases: Sequence[Real]) -> tuple[Real, Real]:
    """ln of the likelihood without a mean, (draw, spread), and by how much a mean raises the largest, (draw,)."""
    without = -0.5 * (found**2 @ (1.0 / variances).T + np.log(variances).sum(axis=1))
    gain = [
        0.5 * np.sum((found / np.sqrt(variance) @ basis) ** 2, axis=1)
        for variance, basis in zip(variances, bases, strict=True)
    ]
    return without, np.max(without + np.column_stack(gain), axis=1) - np.max(without, axis=1)
