"""The logarithm of the Bayes factor of one more effect against none, by Laplace's approximation.

The size is as likely anywhere in the catalogue's range of the parameter (one side of off where only one exists); a
size that the data know to +- e within a range R costs ln(R / (sqrt(2 pi) e)). Of a group the spread of its members is
the one unknown: integrated over, with its members normal about off.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


def log_evidence(drop: float, known: Iterable[tuple[float, float, float]]) -> float:
    """Of a single effect: chi2 falls by `drop`; of each of its parameters error, lower and upper end of its range."""
    costs = [np.log((upper - lower) / (np.sqrt(2.0 * np.pi) * error)) for error, lower, upper in known]
    return 0.5 * drop - float(np.sum(costs))


def group_log_evidence(products: Real, gram: Real, largest: float, points: int = 60) -> float:
    """Of a group: products (member,) of its columns with the residual, and of its columns with each other.

    Members are normal with a spread s; s is as likely anywhere from 0 to `largest`.
    """
    size, axes = np.linalg.eigh(gram)
    logs = logs_of_spreads(axes.T @ products, np.maximum(size, 0.0), largest * (np.arange(points) + 0.5) / points)
    peak = float(logs.max())
    return peak + float(np.log(np.mean(np.exp(logs - peak))))


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
    spreads = largest * np.geomspace(1e-4, 1.0, 400)
    logs = logs_of_spreads(along, size, spreads)
    best = float(spreads[int(np.argmax(logs))])
    return best, axes @ (best**2 * along / (1.0 + best**2 * size)), float(logs.max())
