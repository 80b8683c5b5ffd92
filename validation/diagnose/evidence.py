"""The logarithm of the Bayes factor of one more effect against none, by Laplace's approximation.

The size is as likely anywhere in the catalogue's range of the parameter (one side of off where only one exists); a
size that the data know to +- e within a range R costs ln(R / (sqrt(2 pi) e)). What of its normal density lies beyond
the range does not count, so one that the data do not know at all costs nothing, and brings nothing. Of a group the
spread of its members is the one unknown: integrated over, with its members normal about off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri  # scipy.stats takes a second to import

Real = NDArray[np.float64]

SHARES = np.geomspace(1e-4, 1.0, 400)
"""Of the largest spread of a group that is tried: close enough for what 25 chips know of theirs, to a tenth."""


POINTS = 4096
"""At which a density of several parameters is summed up within its range: to some thousandths."""
STEPS = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0]) % 1.0
"""From point to point, one for each parameter before the last one."""
LEAST = 1e-300
"""Of the share within the range: less cannot be told from none."""


def log_evidence(drop: float, values: Real, covariance: Real, ranges: Sequence[tuple[float, float]]) -> float:
    """Of a single effect: chi2 falls by `drop` at these values of its parameters, which lie within their ranges.

    `values` (parameter,), `covariance` (parameter, parameter), `ranges`: their ends.
    """
    _, log = np.linalg.slogdet(2.0 * np.pi * covariance)
    lower, upper = np.array(ranges).T
    inside = _inside(covariance, lower - values, upper - values)
    return 0.5 * (drop + float(log)) + float(np.log(max(inside, LEAST)) - np.sum(np.log(upper - lower)))


def _inside(covariance: Real, lower: Real, upper: Real) -> float:
    """The share of a normal density about 0 within a box, one parameter after another: exact for a single one.

    A. Genz, J. Comput. Graph. Stat. 1, 141 (1992), with the points of an additive recurrence; of more parameters than
    it has steps the ones that follow are taken at the middle of their range.
    """
    sd = np.sqrt(np.diag(covariance))
    axes = np.linalg.cholesky(covariance / np.outer(sd, sd) + 1e-12 * np.eye(len(sd)))
    count = POINTS if len(sd) > 1 else 1
    share, taken = np.ones(count), np.zeros((len(sd), count))
    for number, axis in enumerate(axes):
        along = axis[:number] @ taken[:number]
        below, above = (ndtr((end[number] / sd[number] - along) / axis[number]) for end in (lower, upper))
        share *= above - below
        point = np.arange(0.5, count) * STEPS[number] % 1.0 if number < len(STEPS) else 0.5
        taken[number] = ndtri(np.clip(below + point * (above - below), LEAST, 1.0 - 1e-16))
    return float(share.mean())


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
