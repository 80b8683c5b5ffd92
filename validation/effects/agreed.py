"""What two runs of Monte Carlo with other random numbers agree about: an image, its noise taken down.

    w(band) = 2 S / (S + P)    S = <a b>, the power that both have,  P = <(a^2 + b^2) / 2>, the power of one

a, b: the runs' cosine transforms, in bands of spatial frequency. w is Wiener's weight of their mean: 1 where they
are the same, 0 where they have nothing in common beyond chance. Where noise is white most of it lies in the finest
bands, and goes; of the walk inside one chip it lies in coarse ones, and only what is weaker than it goes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from scipy.special import fdtri

Real = NDArray[np.float64]

BANDS_PER_OCTAVE, COARSEST = 2, 3.0
"""Cosines with no more than 1.5 waves across the longer side are one band: a few alone cannot be told from chance."""
CHANCE = 0.02
"""Of noise alone that a band seems to have something in common: (a + b)^2 over (a - b)^2 is then F's."""


def agreed(one: Real, other: Real) -> Real:
    """The mean of two images (row, column) of the same light, weighted by where they agree; of any unit."""
    a, b = dctn(one, norm="ortho"), dctn(other, norm="ortho")
    band = bands(one.shape).ravel()
    count, common, power, both, apart = (
        np.bincount(band, of.ravel())
        for of in (np.ones(a.shape), a * b, (a**2 + b**2) / 2.0, (a + b) ** 2, (a - b) ** 2)
    )
    real = both > fdtri(np.maximum(count, 1.0), np.maximum(count, 1.0), 1.0 - CHANCE) * apart
    weight = np.divide(2.0 * common, common + power, out=np.zeros(len(count)), where=real & (power > 0.0))
    return np.asarray(idctn(weight[band].reshape(a.shape) * (a + b) / 2.0, norm="ortho"))


def bands(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """The band (row, column) of each cosine of an image: the coarsest are one, then parts of octaves."""
    rows, columns = (np.arange(count) / count for count in shape)
    radius = np.hypot(rows[:, None], columns[None, :]) * max(shape)
    return np.asarray(np.ceil(BANDS_PER_OCTAVE * np.log2(np.maximum(radius / COARSEST, 1.0))), np.int64)
