"""The logarithm of the Bayes factor of one more effect against none, by Laplace's approximation.

The size is as likely anywhere in the catalogue's range of the parameter (one side of off where only one exists); a
size that the data know to +- e within a range R costs ln(R / (sqrt(2 pi) e)). Of a group the spread of its members is
the one unknown: integrated over, with its members normal about off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

SHARES = np.geomspace(1e-4, 1.0, 400)
"""Of the largest spread of a group that is tried: close enough for what 25 chips know of theirs, to a tenth."""


def log_evidence(drop: float, covariance: Real, ranges: Sequence[tuple[float, float]]) -> float:
    """Of a single effect: chi2 falls by `drop`; of its parameters the covariance and the ends of their ranges."""
    _, log = np.linalg.slogdet(2.0 * np.pi * covariance)
    return 0.5 * drop + 0.5 * float(log) - float(np.sum([np.log(upper - lower) for lower, upper in ranges]))


def group_log_evidence(products: Real, gram: Real, largest: float) -> float:
    """Of a group: products (member,) of its columns with the residual, and of its columns with each other.

    Members are normal with a spread s; s is as likely anywhere from 0 to `largest`.
    """
    size, axes = np.linalg.eigh(gram)
    spreads = largest * np.concatenate([[0.0], SHARES])
    logs = logs_of_spreads(axes.T @ products, np.maximum(size, 0.0), spreads)
    peak, steps = float(logs.max()), np.diff(spreads) / largest
    heights = np.exp(logs - peak)
    return peak + float(np.log(np.sum(0.5 * steps * (heights[1:] + heights[:-1]))))


def logs_of_spreads(along: Real, size: Real, spreads: Real) -> Real:
    """ln of the likelihood ratio of each spread against none: (member,) products along the gram's axes, its sizes."""
    gain = 1.0 + np.outer(spreads**2, size)
    return np.asarray(0.5 * np.sum(spreads[:, None] ** 2 * along**2 / gain - np.log(gain), axis=1))


def drawn_back(rows: Real, residual: Real, largest: float) -> tuple[float, Real, float]:
    """The most likely spread of a group's members, the members (member,) with it, and ln of its likelihood ratio.

    `rows` (member, row): their columns, less what the fit's own parameters do; `largest`: spread that is tried.
    """
    size, axes = np.linalg.eigh(rows @ rows.T)
    size, along = np.maximum(size, 0.0), axes.T @ (rows @ residual)
    spreads = largest * SHARES
    logs = logs_of_spreads(along, size, spreads)
    best = float(spreads[int(np.argmax(logs))])
    return best, axes @ (best**2 * along / (1.0 + best**2 * size)), float(logs.max())
