"""What two runs of Monte Carlo with other random numbers agree about: an image, its noise taken down.

    w(band) = 2 S / (S + P)    S = <a b>, the power that both have,  P = <(a^2 + b^2) / 2>, the power of one

a, b: the runs' cosine transforms, in bands of spatial frequency. w is Wiener's weight of their mean: 1 where they
are the same, 0 where they have nothing in common beyond chance. What light does is smooth, and a difference of two
runs is mostly noise of the finest bands, so that little of it stays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

Real = NDArray[np.float64]

BANDS_PER_OCTAVE = 2
CHANCE = 2.0
"""Standard deviations of <a b> of noise below which a band has nothing in common."""


def agreed(one: Real, other: Real) -> Real:
    """The mean of two images (row, column) of the same light, weighted by where they agree; of any unit."""
    a, b = dctn(one, norm="ortho"), dctn(other, norm="ortho")
    band = bands(one.shape).ravel()
    count, common, power, noise = (
        np.bincount(band, of.ravel()) for of in (np.ones(a.shape), a * b, (a**2 + b**2) / 2.0, (a - b) ** 2 / 2.0)
    )
    real = common * np.sqrt(count) > CHANCE * noise  # sd of the sum of a b, where both are noise: noise / sqrt(count)
    weight = np.divide(2.0 * common, common + power, out=np.zeros(len(count)), where=real & (power > 0.0))
    return np.asarray(idctn(weight[band].reshape(a.shape) * (a + b) / 2.0, norm="ortho"))


def bands(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """The band (row, column) of each cosine of an image: the mean is one of its own, then parts of octaves."""
    rows, columns = (np.arange(count) / count for count in shape)
    radius = np.hypot(rows[:, None], columns[None, :]) * max(shape)
    number = np.ceil(BANDS_PER_OCTAVE * np.log2(np.maximum(radius, 0.5)) + BANDS_PER_OCTAVE)
    return np.asarray(number, np.int64)
