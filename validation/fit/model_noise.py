"""The noise that Monte Carlo left in a prediction, taken into the whitening: what it dominates is weighed down.

The rows of a module's images, once the camera's noise is unit and white, have the covariance I + M'M, with M the
columns that tell the Monte Carlo's noise (each times a unit normal number). Its symmetric inverse root is
I - M' f(MM') M with f(m) = 1 / (1 + m + sqrt(1 + m)), as for the camera's fixed pattern: no pixel comes first. So
chi2, covariances and every test of what is left hold with the noise of the model as with that of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from validation.fit.whitening import Whitening

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NoiseBlock:
    """Rows whose prediction errs together: those of one module, or of all that a camera's pattern ties."""

    rows: NDArray[np.intp]
    columns: Real  # M: (column, row), in standard deviations of the camera's noise
    root: Real  # f(MM'): (column, column)

    @classmethod
    def of(cls, rows: NDArray[np.intp], columns: Real) -> NoiseBlock:
        """The block of some columns (column, row)."""
        size, axes = np.linalg.eigh(columns @ columns.T)
        size = np.maximum(size, 0.0)
        return cls(rows, columns, (axes / (1.0 + size + np.sqrt(1.0 + size))) @ axes.T)

    def take_out(self, white: Real) -> None:
        """Takes the likely share of the noise out of rows (..., row) in place."""
        part = white[..., self.rows]
        white[..., self.rows] = part - ((part @ self.columns.T) @ self.root) @ self.columns


def noise_blocks(white: Whitening, runs: Sequence[str], noise_dn: Sequence[Real | None]) -> tuple[NoiseBlock, ...]:
    """The blocks of images whose noise is told.

    Parameters
    ----------
    white : of the camera alone.
    runs : of each image, by whose histories it is seen: equal for images of one module, or of several alike.
    noise_dn : (function, row, column) of each image, None where there is no Monte Carlo.
    """
    found = []
    for run in dict.fromkeys(name for name, one in zip(runs, noise_dn, strict=True) if one is not None):
        own = [one if name == run else None for name, one in zip(runs, noise_dn, strict=True)]
        count = max(len(one) for one in own if one is not None)
        images = []
        for one, used in zip(own, white.used, strict=True):
            images.append(np.zeros((count if white.grids or one is not None else 0, *used.shape)))
            if one is not None:
                images[-1][: len(one)] = one
        found.append(_block_columns(white, images, count))
    if white.grids and found:  # the camera's pattern ties all images
        return (NoiseBlock.of(np.arange(white.count), np.concatenate([columns for _, columns in found])),)
    return tuple(NoiseBlock.of(rows, columns) for rows, columns in found)


def told_variance(white: Whitening) -> Real:
    """(row,) of the images: variance of the Monte Carlo's noise, in that of the camera's noise."""
    variance = np.zeros(white.count)
    for block in white.noise:
        variance[block.rows] += np.sum(block.columns**2, axis=0)
    return variance


def noise_shares(white: Whitening) -> list[float]:
    """Rms over the used pixels of each image of the same, 0 for one without any; what a camera's pattern ties to
    others has a part of theirs."""
    parts = np.split(told_variance(white), np.cumsum([int(used.sum()) for used in white.used])[:-1])
    return [float(np.sqrt(part.mean())) if part.size else 0.0 for part in parts]


def noise_share(white: Whitening) -> float:
    """Rms over all pixels of the Monte Carlo's noise, in standard deviations of the camera's."""
    total = sum(float(np.sum(block.columns**2)) for block in white.noise)
    return float(np.sqrt(total / white.count)) if white.count else 0.0


def _block_columns(white: Whitening, images: Sequence[Real], count: int) -> tuple[NDArray[np.intp], Real]:
    """Numbers of the rows, and whitened columns there, of images (column, row, column); some have no columns."""
    if white.grids:
        return np.arange(white.count), white.camera_rows(images)
    ends = np.cumsum([0, *(int(used.sum()) for used in white.used)])
    seen = [number for number, image in enumerate(images) if len(image) == count]
    rows = np.concatenate([np.arange(ends[number], ends[number + 1]) for number in seen])
    return rows, np.concatenate([(images[n] * white.weight[n])[:, white.used[n]] for n in seen], axis=1)
