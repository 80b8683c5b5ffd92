"""Light of a finite module on a grid of equal cells, and its waves; what goes beyond the grid's end comes round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from containers.scene import Array

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LEAST_CELLS = 4
"""Across a module, however narrow: light in the middle of one cell of a third of the distance is 2 % too much."""


@dataclass(frozen=True)
class Grid:
    """Cells of a module, from edge to edge, and empty ones beyond.

    shape : (y, x), cells of the module. step_um : (y, x), their sides. padded : (y, x), all cells, even numbers.
    """

    shape: tuple[int, int]
    step_um: tuple[float, float]
    padded: tuple[int, int]

    @classmethod
    def of(cls, layout: Array, step_um: float, beyond_um: float) -> Grid:
        """With steps of at most so much, and at least the module's own width, or so much more, beyond it."""
        sides = 2.0 * layout.half_y_um, 2.0 * layout.half_x_um
        rows, columns = (max(LEAST_CELLS, int(np.ceil(side / step_um - 1e-9))) for side in sides)
        steps = sides[0] / rows, sides[1] / columns
        beyond = (int(np.ceil(beyond_um / step)) for step in steps)
        padded = (count + max(count, more) for count, more in zip((rows, columns), beyond, strict=True))
        high, wide = (count + count % 2 for count in padded)
        return cls((rows, columns), steps, (high, wide))

    @property
    def centres_um(self) -> tuple[Real, Real]:
        """x and y of the module's cells."""
        y, x = (np.asarray((np.arange(n) - (n - 1) / 2.0) * d) for n, d in zip(self.shape, self.step_um, strict=True))
        return x, y

    @property
    def axes_per_um(self) -> tuple[Real, Real]:
        """ky and kx of the waves."""
        (rows, columns), (dy, dx) = self.padded, self.step_um
        per_um = np.fft.fftfreq(rows, dy), np.fft.rfftfreq(columns, dx)
        return np.asarray(2.0 * np.pi * per_um[0]), np.asarray(2.0 * np.pi * per_um[1])

    @property
    def k_per_um(self) -> Real:
        """Wave numbers (y, x)."""
        ky, kx = self.axes_per_um
        return np.asarray(np.hypot(ky[:, None], kx))

    def waves(self, light: Real) -> Complex:
        """Of light on the module's cells, or on all."""
        return np.asarray(np.fft.rfft2(light, self.padded))

    def on_module(self, waves: Complex) -> Real:
        """Light on the module's cells."""
        rows, columns = self.shape
        return np.asarray(np.fft.irfft2(waves, self.padded)[:rows, :columns])

    def kernel(self, of_r2: Real) -> Real:
        """Transform of what is given of each cell, of a kernel about the first one."""
        return np.asarray(np.fft.rfft2(of_r2).real * self.step_um[0] * self.step_um[1])

    @property
    def r2_um2(self) -> Real:
        """Squared distances of all cells from the first one, the shorter way round."""
        dy, dx = (np.fft.fftfreq(n, 1.0 / (n * step)) for n, step in zip(self.padded, self.step_um, strict=True))
        return np.asarray(np.add.outer(dy**2, dx**2))

    def sum_up(self, waves: Complex, x_um: Real, y_um: Real) -> Real:
        """Waves summed at every crossing (y, x) of the places."""
        (rows, columns), (ky, kx) = self.padded, self.axes_per_um
        x0, y0 = (centres[0] for centres in self.centres_um)
        twice = np.where((np.arange(kx.size) == 0) | (np.arange(kx.size) == columns // 2), 1.0, 2.0)
        along_x = np.exp(1j * np.outer(x_um - x0, kx)) * twice
        along_y = np.exp(1j * np.outer(y_um - y0, ky))
        return np.asarray((along_y @ waves @ along_x.T).real / (rows * columns))

    def laid(self, pieces: Real, step_um: float, layout: Array) -> Complex:
        """Waves of the light that chips put around them, each in the same pieces; what is beyond the edge is cut.

        pieces : (y, x), light of equal squares about a chip's centre. step_um : their side.
        """
        offset, (ky, kx) = _middles(len(pieces)) * step_um, self.axes_per_um
        first = [0.5 * (1 - count) * step for count, step in zip(self.shape, self.step_um, strict=True)]
        about_y, about_x = (np.exp(-1j * np.outer(k, offset - x0)) for k, x0 in zip((ky, kx), first, strict=True))
        centres, power = layout.centres_um.reshape(-1, 2), layout.power.ravel()
        found = np.zeros((ky.size, kx.size), complex)
        for y in np.unique(centres[:, 1]):  # chips in a row are summed up before the long product
            row = centres[:, 1] == y
            x = centres[row, 0]
            cut_x = [_share_within(at + offset, step_um, layout.half_x_um) for at in x]
            along_x = about_x * ((power[row] * np.exp(-1j * np.outer(kx, x))) @ np.array(cut_x))
            along_y = about_y * np.exp(-1j * ky * y)[:, None] * _share_within(y + offset, step_um, layout.half_y_um)
            real_and_imaginary = np.ascontiguousarray(along_x.T).view(float)
            found += along_y @ (pieces @ real_and_imaginary).view(complex)
        return np.asarray(found / (self.step_um[0] * self.step_um[1]))


def _share_within(at_um: Real, side_um: float, half_um: float) -> Real:
    """Of pieces along an axis, what is inside the edge."""
    return np.asarray(np.clip((half_um - np.abs(at_um)) / side_um + 0.5, 0.0, 1.0))


def _middles(count: int) -> Real:
    """Of so many equal parts about 0, in their widths."""
    return np.asarray(np.arange(count) - (count - 1) / 2.0)
