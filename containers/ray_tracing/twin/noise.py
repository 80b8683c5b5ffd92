"""The noise that Monte Carlo leaves in images of a module, told by smooth functions: enough of them, and each known.

    noise(x, y) = sqrt(light(x, y)) sum_k a_k c_k(x, y)      cosines about the module's centre, with its symmetries

A field of a module is made of waves up to 14 / (D - T), folded by the module's symmetries, so there are more ways
for it to err than there are groups of histories (32): their products alone would call most of the noise a signal. In
these functions, made orthogonal under the weight of counted light, noise is uncorrelated; its spectrum the groups
tell: low waves have less of it, for places of emission and directions are drawn evenly (Sobol). How its strength
changes from the module's centre outwards is more than the light's root says; that, too, the groups tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

CUT = 1.3 * 10.65
"""Wave number times height up to which a module's field has waves, the taper of its modes included."""
MOST_FUNCTIONS = 200
"""Of a symmetric module, which has no more, and of any where many pixels are looked at."""
MOST_OF_ANY, MOST_VALUES = 1000, 1 << 24
"""Of a module without the symmetries, as long as functions times pixels are not more than so many values: 200 of its
961 left out half of the noise (5 x 5 chips)."""
BEYOND = 0.5
"""Heights by which the functions' own period passes the pixels, so that they need not be flat at the edge."""
NEIGHBOURS = 4
"""On either side of a function, in the order of wave numbers, whose variance is taken to be alike."""
ALIKE = 1e-3
"""A function of which less is left beside wider waves says nothing of its own at these pixels."""
POWERS = (0, 1, 2)
"""Of the square of the distance from the centre, by which the strength of noise changes beside the light's root."""
STRENGTH = (0.25, 4.0)
"""At least and at most, of what the functions alone say."""
ROWS_AT_ONCE = 64
FAINT = 1e-3
"""Of the brightest pixel: where less arrives, noise is taken as there."""


@dataclass(frozen=True, eq=False)
class NoiseBasis:
    """The functions at the pixels of one image, and the factor that makes them orthogonal.

    functions : (function, pixel). factor : (function, function), lower triangle of the weighed normal matrix; of an
        image whose functions are `like` another's, that of the other.
    weight : (pixel,). told : their numbers among all.
    outwards : (term, pixel), powers of the distance from the module's centre.
    """

    functions: Real
    factor: Real
    weight: Real
    told: NDArray[np.intp]
    outwards: Real

    @classmethod
    def at(
        cls,
        x_um: Real,
        y_um: Real,
        light: Real,
        reach_um: float,
        height_um: float,
        *,
        symmetric: bool,
        most: int = MOST_FUNCTIONS,
        like: NoiseBasis | None = None,
    ) -> NoiseBasis:
        """The functions for an image.

        Parameters
        ----------
        x_um, y_um, light : (row, column), places on the receiver of the pixels, and what arrives there.
        reach_um : how far from the centre any pixel of the module's images lies, in x or in y.
        height_um : from the chips' top to the receiver.
        symmetric : whether the module has the eight symmetries of the square.
        most : functions, the widest waves.
        like : of another image of the same module, whose functions are taken.
        """
        variance = np.maximum(light.ravel(), FAINT * float(light.max()))
        period_um = reach_um + BEYOND * height_um
        functions = _functions(x_um.ravel(), y_um.ravel(), period_um, height_um, symmetric, most)
        if like is None:
            triangle = _triangle(functions.T)
            left = np.abs(np.diagonal(triangle))  # of a function, beside those before it
            told = np.flatnonzero(left > ALIKE * np.linalg.norm(functions, axis=1)[: left.size])
            factor = (triangle if told.size == len(functions) else _triangle(triangle[:, told])).T
        else:
            told, factor = like.told, like.factor
        outwards = np.array([((x_um**2 + y_um**2).ravel() / reach_um**2) ** power for power in POWERS])
        return cls(functions[told] * np.sqrt(variance), factor, 1.0 / variance, told, outwards)

    def amplitudes(self, images: Real) -> Real:
        """Of images (..., row, column): (..., function) in the orthogonal functions."""
        pixels = images.reshape(*images.shape[:-2], -1)
        right = (pixels * self.weight) @ self.functions.T
        return solved(self.factor, right.reshape(-1, len(self.factor)).T).T


def noise_columns(deviations: Real, basis: NoiseBasis, first: NoiseBasis) -> Real:
    """Columns (function, row, column) of noise: the covariance of two pixels is the sum over them of their products.

    Parameters
    ----------
    deviations : (group, row, column), those of the groups in the image of `first`, scaled so that their products sum
        up to the covariance of their mean.
    basis : of the image whose columns are wanted: that of the same module, so column k is the same noise in both.

    Notes
    -----
    32 groups tell the variance of one function to 25 %; functions of nearly one wave number share theirs, so that it
    is known to 8 %.
    """
    own = (first.amplitudes(deviations) ** 2).sum(axis=0)
    near = np.abs(np.subtract.outer(np.arange(own.size), np.arange(own.size))) <= NEIGHBOURS
    scale = np.sqrt(near @ own / near.sum(axis=1))
    in_first = scale[:, None] * solved(first.factor, first.functions)
    wanted = in_first if basis is first else scale[:, None] * solved(first.factor, basis.functions)
    strength = _strength(deviations.reshape(len(deviations), -1), in_first, first.outwards)
    return np.asarray(
        (wanted * np.sqrt(np.clip(strength @ basis.outwards, *STRENGTH))).reshape(-1, *deviations.shape[1:])
    )


def _strength(deviations: Real, columns: Real, outwards: Real) -> Real:
    """(term,): how many times the told variance that of the groups is, from the centre outwards.

    deviations (group, pixel), columns (function, pixel), outwards (term, pixel).
    """
    seen, told = (deviations**2).sum(axis=0), np.maximum((columns**2).sum(axis=0), 1e-300)
    found = np.linalg.lstsq(outwards.T, seen / told, rcond=None)[0]
    return np.asarray(found)


def most_functions(pixels: int, *, symmetric: bool) -> int:
    """How many functions at most tell the noise of images of so many pixels together."""
    return MOST_FUNCTIONS if symmetric else max(MOST_FUNCTIONS, min(MOST_OF_ANY, MOST_VALUES // max(pixels, 1)))


def _functions(x_um: Real, y_um: Real, period_um: float, height_um: float, symmetric: bool, count: int) -> Real:
    """(function, pixel), widest waves first.

    Products of cosines, alike in x and y; of cosines and sines where the module is not symmetric.
    """
    most = max(1, int(CUT * period_um / (np.pi * height_um)))
    along = [_waves(u, most, period_um, sines=not symmetric) for u in (x_um, y_um)]
    waves = np.r_[np.arange(most + 1), np.arange(1, most + 1) if not symmetric else []]
    places = [(m, n) for m in range(len(waves)) for n in range(m + 1 if symmetric else len(waves))]
    places = sorted(places, key=lambda p: float(np.hypot(waves[p[0]], waves[p[1]])))[:count]
    found = [along[0][m] * along[1][n] + (along[0][n] * along[1][m] if symmetric else 0.0) for m, n in places]
    return np.array(found)


def solved(factor: Real, right: Real) -> Real:
    """x (function, any) of factor x = right, of a lower triangle; by blocks, so that nearly all of it is products."""
    found = np.array(right)
    for start in range(0, len(factor), ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE)
        found[rows] -= factor[rows, :start] @ found[:start]
        found[rows] = np.linalg.solve(factor[rows, rows], found[rows])
    return found


def _triangle(columns: Real) -> Real:
    """R of the decomposition of columns (any, function)."""
    return np.asarray(np.linalg.qr(columns, mode="r"))


def _waves(u_um: Real, most: int, period_um: float, *, sines: bool) -> Real:
    """Cosines, then sines where they are wanted, at places along an axis: (wave, pixel)."""
    phase = np.pi / period_um * np.outer(np.arange(most + 1), u_um)
    return np.concatenate([np.cos(phase), np.sin(phase[1:])]) if sines else np.cos(phase)
