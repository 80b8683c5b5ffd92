"""Whitening: images divided by their noise, so that what is left is white where the model is right.

The variance of a pixel is that of the PREDICTED signal, never of the data's own counts (a pixel that is low by chance
would otherwise weigh more, and bias the fit). Two parts of the noise are the same in several images: a camera's fixed
pattern (PRNU), as a share of the signal, in all of its images; and the noise of a dark, in all shots that use it. As
independent noise they would give false alarms, because they add up where images are summed. Per pixel the N images
have the covariance diag(var) + U U', one column of U for each common part. With w = x / sd and A = U / sd that is
I + A A', and its symmetric inverse root is I - A f(A'A) A' with f(m) = 1 / (1 + m + sqrt(1 + m)): no image comes
first, as in a Cholesky factor, and a residual map shows its own image as far as can be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from validation.fit.model_noise import NoiseBlock
from validation.measured import MeasuredImage

Real = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCALE_PRIOR_SD = 0.03  # of the logarithm of the variance scale: K and read noise are known to a few percent
HELD_SD = 4.0  # prior sds: noise as far from what is declared is no noise, but something that the model lacks


@dataclass(frozen=True, eq=False)
class Whitening:
    """Turns images in DN into rows of unit variance: all used pixels of image 0, then of image 1, ..."""

    used: tuple[Mask, ...]
    weight: tuple[Real, ...]  # 1 / sd, 0 where unused
    grids: tuple[Grid, ...]
    noise: tuple[NoiseBlock, ...] = ()  # of the prediction's own Monte Carlo
    curve_sigma: tuple[Real, ...] = ()  # of the rows of each curve

    @property
    def count(self) -> int:
        """How many rows there are: used pixels of all images."""
        return sum(int(mask.sum()) for mask in self.used)

    def images(self, images: Sequence[Real]) -> list[Real]:
        """Whitened images, zero where unused; each (..., row, column) with the same leading axes."""
        white = [image * weight for image, weight in zip(images, self.weight, strict=True)]
        for grid in self.grids:
            grid.take_out(white)
        return white

    def rows(self, images: Sequence[Real]) -> Real:
        """Whitened rows (..., pixel) of images (..., row, column)."""
        white = self.camera_rows(images)
        for block in self.noise:
            block.take_out(white)
        return white

    def camera_rows(self, images: Sequence[Real]) -> Real:
        """The same, by the camera's noise alone."""
        return np.concatenate(
            [image[..., mask] for image, mask in zip(self.images(images), self.used, strict=True)], axis=-1
        )

    def unfold(self, rows: Real) -> list[Real]:
        """The images that whitened rows belong to, zero where unused."""
        maps, start = [], 0
        for mask in self.used:
            image = np.zeros(mask.shape)
            stop = start + int(mask.sum())
            image[mask] = rows[start:stop]
            maps.append(image)
            start = stop
        return maps


@dataclass(frozen=True, eq=False)
class Grid:
    """Images on the same pixels of a camera, and what their noise has in common."""

    images: tuple[int, ...]
    common: Real  # A: (image, part, row, column), in standard deviations
    root: Real  # f(A'A): (part, part, row, column)

    def take_out(self, white: list[Real]) -> None:
        """Takes the likely share of the common parts out of images in place; each (..., row, column)."""
        parts = range(len(self.root))
        size = [sum(self.common[k, i] * white[image] for k, image in enumerate(self.images)) for i in parts]
        share = [sum(self.root[i, j] * size[j] for j in parts) for i in parts]
        for k, image in enumerate(self.images):
            for i in parts:
                if self.common[k, i].any():
                    white[image] -= self.common[k, i] * share[i]


def whitening(images: Sequence[MeasuredImage], signals_dn: Sequence[Real]) -> Whitening:
    """The whitening of images whose predicted signals are given; ValueError where a variance is not above zero."""
    shared = _shared_darks(images)
    weights = []
    for image, signal_dn in zip(images, signals_dn, strict=True):
        variance_dn2 = image.variance_dn2(signal_dn)
        if image.shot.dark in shared:
            variance_dn2 = variance_dn2 - image.dark_dn2
        if not np.all(variance_dn2[image.used] > 0.0):
            raise ValueError(f"variance of a used pixel: {variance_dn2[image.used].min():g} DN^2, must be above 0")
        weights.append(np.where(image.used, 1.0 / np.sqrt(np.where(image.used, variance_dn2, 1.0)), 0.0))
    grids = [_grid(grid, images, signals_dn, weights, shared) for grid in grids_of(images)]
    return Whitening(
        tuple(image.used for image in images), tuple(weights), tuple(grid for grid in grids if grid.common.size)
    )


def grids_of(images: Sequence[MeasuredImage]) -> tuple[tuple[int, ...], ...]:
    """Indices of the images that lie on the same pixels of the camera: same shape, same size of a binned pixel."""
    grids: dict[tuple[tuple[int, ...], float], list[int]] = {}
    for index, image in enumerate(images):
        grids.setdefault((image.used.shape, image.pixel_um), []).append(index)
    return tuple(tuple(grid) for grid in grids.values())


def variance_scales(chi2: Real, freedom: float, prior_sd: float = SCALE_PRIOR_SD) -> Real:
    """The most likely factors v on all variances, each for a chi2 of the data with these degrees of freedom.

    They minimise chi2 / v + freedom ln v + (ln v / prior_sd)^2, found by Newton's method (it is convex in ln v).
    """
    log_v = np.zeros_like(chi2)
    for _ in range(100):
        data = chi2 * np.exp(-log_v)
        step = (data - freedom - 2.0 * log_v / prior_sd**2) / (data + 2.0 / prior_sd**2)
        log_v += np.clip(step, -1.0, 1.0)
        if np.all(np.abs(step) < 1e-9):
            break
    return np.asarray(np.exp(log_v))


def held_scales(chi2: Real, freedom: float) -> Real:
    """The same, held to what the prior allows: what one image has too much of must not excuse what another shows."""
    most = float(np.exp(HELD_SD * SCALE_PRIOR_SD))
    return np.asarray(np.clip(variance_scales(chi2, max(freedom, 0.0)), 1.0 / most, most))


def held_scale(chi2: float, freedom: float) -> float:
    """One of them."""
    return float(held_scales(np.array([chi2]), freedom)[0])


def variance_scale(chi2: float, freedom: float) -> float:
    """The most likely factor on all variances."""
    return float(variance_scales(np.array([chi2]), max(freedom, 0.0))[0])


def _shared_darks(images: Sequence[MeasuredImage]) -> tuple[str, ...]:
    """Darks that more than one image uses."""
    darks = [image.shot.dark for image in images if image.shot.dark is not None]
    return tuple(dict.fromkeys(dark for dark in darks if darks.count(dark) > 1))


def _grid(
    grid: tuple[int, ...],
    images: Sequence[MeasuredImage],
    signals_dn: Sequence[Real],
    weights: Sequence[Real],
    shared: tuple[str, ...],
) -> Grid:
    """The common parts of one grid's noise: the fixed pattern, then one for each shared dark."""
    nothing = np.zeros(weights[grid[0]].shape)
    columns = [[images[i].prnu * np.maximum(signals_dn[i], 0.0) * weights[i] for i in grid]]
    columns += [
        [np.sqrt(images[i].dark_dn2) * weights[i] if images[i].shot.dark == dark else nothing for i in grid]
        for dark in shared
    ]
    columns = [column for column in columns if any(one.any() for one in column)]
    common = np.array(columns).reshape(len(columns), len(grid), *nothing.shape).swapaxes(0, 1)
    return Grid(grid, common, _root(np.einsum("kiyx,kjyx->yxij", common, common)))


def _root(gram: Real) -> Real:
    """f of the matrices (row, column, part, part), as (part, part, row, column)."""
    if gram.shape[-1] == 0:
        return np.zeros((0, 0, *gram.shape[:2]))
    size, axes = (gram[..., 0], np.ones_like(gram)) if gram.shape[-1] == 1 else np.linalg.eigh(gram)
    factor = 1.0 / (1.0 + size + np.sqrt(1.0 + np.maximum(size, 0.0)))
    return np.asarray(np.einsum("yxik,yxk,yxjk->ijyx", axes, factor, axes))
