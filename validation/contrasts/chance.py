"""From how many of noise are as large to a normal number: what single places and fine patterns are told by."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri_exp  # scipy.stats takes a second to import

Real = NDArray[np.float64]

RARE = -20.0
"""Logarithm of an expected number, below which it is the chance itself."""


def normal_equivalent(log_expected: ArrayLike) -> Real:
    """The normal number with the chance that there is one or more where so many are expected (Poisson)."""
    log = np.asarray(log_expected, float)
    some = np.minimum(np.log(-np.expm1(-np.exp(np.maximum(log, RARE)))), -1e-300)  # always below 0
    return np.asarray(-ndtri_exp(np.where(log < RARE, log, some)))
