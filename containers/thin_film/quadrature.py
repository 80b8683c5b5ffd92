"""Integrals of many functions at once, over panels that are halved where a function is narrow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

TOLERANCE = 1e-11
"""A panel is halved until its value changes by less than this, or than this share of a whole integral above 1."""

MAX_HALVINGS = 40
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def integral(density: Callable[[Real], Real], edges: Real) -> Real:
    """Integral (wavelength,) of `density` (wavelength, x) from edge to edge, panels halved until they do not change.

    A panel is done when its two halves (16 Gauss-Legendre nodes each) sum to the whole within `TOLERANCE`; the
    halves are the result. A resonance narrower than about 1e-6 of a first panel may be stepped over.

    Raises
    ------
    ValueError where a panel still changes after `MAX_HALVINGS` halvings.
    """
    low, high = edges[:-1], edges[1:]
    whole = _panel_sums(density, low, high)
    total: Real = np.zeros(len(whole))
    for _ in range(MAX_HALVINGS):
        middle = (low + high) / 2.0
        left, right = _panel_sums(density, low, middle), _panel_sums(density, middle, high)
        changed = np.abs(left + right - whole).max(axis=0)
        sums = left + right
        open_ = changed > TOLERANCE * max(1.0, float(np.abs(total + sums.sum(axis=1)).max()))
        total = total + sums[:, ~open_].sum(axis=1)
        if not open_.any():
            return total
        low, high = np.r_[low[open_], middle[open_]], np.r_[middle[open_], high[open_]]
        whole = np.concatenate([left[:, open_], right[:, open_]], axis=1)
    raise ValueError(
        f"integral still changes by {changed.max():.1e} after {MAX_HALVINGS} halvings, allowed {TOLERANCE:g}"
    )


def _panel_sums(density: Callable[[Real], Real], low: Real, high: Real) -> Real:
    """Gauss-Legendre sums (wavelength, panel)."""
    x = low[:, None] + (high - low)[:, None] * (_NODES + 1.0) / 2.0
    values = density(x.ravel())
    sums: Real = values.reshape(len(values), *x.shape) @ _WEIGHTS * (high - low) / 2.0
    return sums
