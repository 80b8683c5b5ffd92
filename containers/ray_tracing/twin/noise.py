"""The noise that Monte Carlo leaves in images of a module, told by smooth functions: enough of them, and each known.

    noise(x, y) = sum_k a_k phi_k(x, y)       cosines about the module's centre, alike under its symmetries

A field of a module is made of waves up to 10.65 / (D - T), folded by the module's symmetries, so there are more ways
for it to err than there are groups of histories (32): their products alone would call most of the noise a signal. In
functions that are orthogonal under the weight of counted light noise is nearly white; its scale the groups tell.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Real = NDArray[np.float64]

CUT = 10.65
"""Wave number times height up to which a module's field has waves."""
MOST_FUNCTIONS = 200
BEYOND = 0.5
"""Heights by which the functions' own period passes the pixels, so that they need not be flat at the edge."""
FAINT = 1e-3
"""Of the brightest pixel: where less arrives, noise is taken as there."""


@dataclass(frozen=True, eq=False)
class NoiseBasis:
    """The functions at the pixels of one image, and the factor that makes them orthogonal.

    functions : (function, pixel). factor : (function, function), lower triangle of the weighed normal matrix.
    weight : (pixel,).
    """

    functions: Real
    factor: Real
    weight: Real

    @classmethod
    def at(
        cls, x_um: Real, y_um: Real, light: Real, reach_um: float, height_um: float, *, symmetric: bool
    ) -> NoiseBasis:
        """The functions for an image.

        Parameters
        ----------
        x_um, y_um, light : (row, column), places on the receiver of the pixels, and what arrives there.
        reach_um : how far from the centre any pixel of the module's images lies, in x or in y.
        height_um : from the chips' top to the receiver.
        symmetric : whether the module has the eight symmetries of the square.
        """
        functions = _functions(x_um.ravel(), y_um.ravel(), reach_um + BEYOND * height_um, height_um, symmetric)
        weight = 1.0 / np.maximum(light.ravel(), FAINT * float(light.max()))
        normal = (functions * weight) @ functions.T
        normal += 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
        return cls(functions, np.asarray(np.linalg.cholesky(normal)), weight)

    def amplitudes(self, images: Real) -> Real:
        """Of images (..., row, column): (..., function) in the orthogonal functions."""
        pixels = images.reshape(*images.shape[:-2], -1)
        right = (pixels * self.weight) @ self.functions.T
        return np.asarray(solve_triangular(self.factor, right.reshape(-1, len(self.factor)).T, lower=True).T)


def noise_columns(deviations: Real, basis: NoiseBasis, first: NoiseBasis) -> Real:
    """Columns (function, row, column) of noise: the covariance of two pixels is the sum over them of their products.

    Parameters
    ----------
    deviations : (group, row, column), those of the groups in the image of `first`, scaled so that their products sum
        up to the covariance of their mean.
    basis : of the image whose columns are wanted: that of the same module, so column k is the same noise in both.

    Notes
    -----
    Half of a function's variance is its own as the groups show it, half is the mean over all: 32 groups tell one
    variance to 25 %, all functions together to 4 %.
    """
    own = (first.amplitudes(deviations) ** 2).sum(axis=0)
    scale = np.sqrt(0.5 * own + 0.5 * own.mean())
    transfer = solve_triangular(first.factor, basis.functions, lower=True)
    return np.asarray((scale[:, None] * transfer).reshape(-1, *deviations.shape[1:]))


def _functions(x_um: Real, y_um: Real, period_um: float, height_um: float, symmetric: bool) -> Real:
    """(function, pixel): products of cosines; with sines too where the module is not symmetric."""
    most = max(1, int(CUT * period_um / (np.pi * height_um)))
    if symmetric:
        while (most + 1) * (most + 2) // 2 > MOST_FUNCTIONS:
            most -= 1
        along_x, along_y = (_cosines(u, most, period_um) for u in (x_um, y_um))
        pairs = [(m, n) for m in range(most + 1) for n in range(m + 1)]
        return np.array([along_x[m] * along_y[n] + along_x[n] * along_y[m] for m, n in pairs])
    while (2 * most + 1) ** 2 > MOST_FUNCTIONS:
        most -= 1
    along_x, along_y = (
        np.concatenate([_cosines(u, most, period_um), _sines(u, most, period_um)]) for u in (x_um, y_um)
    )
    return np.array([one * other for one, other in product(along_x, along_y)])


def _cosines(u_um: Real, most: int, period_um: float) -> Real:
    return np.cos(np.pi / period_um * np.outer(np.arange(most + 1), u_um))


def _sines(u_um: Real, most: int, period_um: float) -> Real:
    return np.sin(np.pi / period_um * np.outer(np.arange(1, most + 1), u_um))
