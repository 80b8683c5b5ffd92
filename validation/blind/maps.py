"""Maps of light on the receiver: a square grid about the module's centre, from tallies to smooth samples.

A chip's light at the receiver, H above it, has few waves k beyond k H = 12: what tallies hold there is noise, and is
left out. But the light of a side face begins with a kink above that face, so about a chip all up to k H = 30 is kept
(measured on the paper's chip with 5.5 pairs: cut at 12, light errs by 0.37 of the declared camera's noise in pixels
within 40 um of its centre and by 0.13 up to 100 um; cut at 30, by 0.06 and by less than can be seen). What bins take
of the waves that are kept is given back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from validation.blind.words import Real

BINS_PER_HEIGHT = 20.0
FAR, NEAR = (12.0, 6.0), (30.0, 12.0)
"""k H up to which all is kept, and how much further until nothing is: far from chips, and about one."""
ABOUT = (0.7, 1.3)
"""Distances over H from a chip's centre, from the one to the other of which one goes over into the other."""
MOST_BINS = 4096


@dataclass(frozen=True)
class Grid:
    """Bins of a map: `size` along either axis, centred on the module; sample j is the middle of bin j."""

    size: int
    step_um: float
    height_um: float
    """H, of the chips' tops below the receiver."""

    @property
    def at_um(self) -> Real:
        """Places of samples along an axis."""
        return np.asarray((np.arange(self.size) - self.size // 2 + 0.5) * self.step_um, np.float64)

    def inside(self, half_um: float) -> Real:
        """(y, x), the share of each bin that lies in a module."""
        one = np.clip((half_um - np.abs(self.at_um)) / self.step_um + 0.5, 0.0, 1.0)
        return np.outer(one, one)

    def twice(self) -> Grid:
        """As wide as places of this grid can lie apart: on it nothing comes round to the other side."""
        return Grid(2 * self.size, self.step_um, self.height_um)

    def waves(self) -> tuple[Real, Real]:
        """k along y (y, 1) and along x (x,), as `scipy.fft.rfft2` has them."""
        along = (fft.fftfreq(self.size)[:, None], fft.rfftfreq(self.size))
        y, x = (np.asarray(2.0 * np.pi / self.step_um * one, np.float64) for one in along)
        return y, x


def grid_for(height_um: float, reach_um: float) -> Grid:
    """A grid that reaches so far; ValueError where that would take too many bins."""
    step = height_um / BINS_PER_HEIGHT
    size = 2 * fft.next_fast_len(int(np.ceil(reach_um / step)) + 1, real=True)
    if size > MOST_BINS:
        raise ValueError(f"module_half_um: {reach_um:g} um to cover at {height_um:g} um height: up to "
                         f"{MOST_BINS / 2 * step:g} um is needed")  # fmt: skip
    return Grid(size, step, height_um)


def smooth(tally: Real, grid: Grid) -> Real:
    """Tallied flux (..., y, x) as smooth samples of flux per um^2."""
    return _kept(tally, grid, *FAR)


def smooth_about_chip(tally: Real, grid: Grid) -> Real:
    """The same of the light of a chip at the origin."""
    distance = np.hypot(grid.at_um[:, None], grid.at_um) / grid.height_um
    near = _step((ABOUT[1] - distance) / (ABOUT[1] - ABOUT[0]))
    return near * _kept(tally, grid, *NEAR) + (1.0 - near) * _kept(tally, grid, *FAR)


def _kept(tally: Real, grid: Grid, last: float, further: float) -> Real:
    y, x = grid.waves()
    keep = _step((last + further - np.sqrt(y**2 + x**2) * grid.height_um) / further)
    bins = np.sinc(y * grid.step_um / (2.0 * np.pi)) * np.sinc(x * grid.step_um / (2.0 * np.pi))
    return np.asarray(fft.irfft2(fft.rfft2(tally) * (keep / bins / grid.step_um**2), tally.shape[-2:]))


def _step(place: Real) -> Real:
    """From 0 at 0 to 1 at 1, smoothly."""
    at = np.clip(place, 0.0, 1.0)
    return np.asarray(at**2 * (3.0 - 2.0 * at))


def symmetric(tally: Real) -> Real:
    """The mean over the eight symmetries of the square, of maps (plane, y, x)."""
    even = tally + tally[:, ::-1]
    even = even + even[:, :, ::-1]
    return np.asarray((even + even.transpose(0, 2, 1)) / 8.0)


def mirrored(tally: Real) -> Real:
    """The mean of maps (plane, y, x) and their mirror images in y."""
    return np.asarray((tally + tally[:, ::-1]) / 2.0)


def turned(light: Real, grid: Grid, angle_rad: float) -> Real:
    """Smooth maps (plane, y, x) turned about the origin, x towards y."""
    y, x = grid.at_um[:, None] / grid.step_um, grid.at_um / grid.step_um
    cos, sin, middle = np.cos(angle_rad), np.sin(angle_rad), grid.size // 2 - 0.5
    at = [y * cos - x * sin + middle, x * cos + y * sin + middle]
    return np.stack([ndimage.map_coordinates(one, at, order=5, mode="nearest") for one in light])


def laid(light: Real, grid: Grid, places_um: Real, power: Real) -> Real:
    """A chip's smooth map (plane, y, x) laid at places (chip, 2), x and y, times its powers."""
    y, x = grid.waves()
    phases = np.zeros((grid.size, x.size), np.complex128)
    for (at_x, at_y), strength in zip(places_um, power, strict=True):
        phases += strength * np.exp(-1j * y * at_y) * np.exp(-1j * x * at_x)
    return np.asarray(fft.irfft2(fft.rfft2(light) * phases, light.shape[-2:]))


def transform_of_kernel(kernel: Real, grid: Grid) -> Real:
    """The transform of tallied kernels (plane, y, x) about the origin, of flux 1 put in at a point."""
    y, x = grid.waves()
    half_bin = np.exp(1j * (y + x) * (grid.size // 2 - 0.5) * grid.step_um)
    bins = np.sinc(y * grid.step_um / (2.0 * np.pi)) * np.sinc(x * grid.step_um / (2.0 * np.pi))
    return np.asarray((fft.rfft2(kernel) * half_bin / bins).real)


def convolved(light: Real, transform: Real) -> Real:
    """Samples (y, x) under kernels (plane, y, x) given by their transforms on a grid twice as wide."""
    rows, columns = light.shape
    wide = (2 * rows, 2 * columns)
    return np.asarray(fft.irfft2(fft.rfft2(light, wide) * transform, wide)[..., :rows, :columns])


def cumulative(source: Real) -> tuple[Real, Real]:
    """Cumulative shares of rows (y,), and within each row (y, x), of a source that is nowhere below 0."""
    columns = np.cumsum(source, axis=1)
    rows = np.cumsum(columns[:, -1])
    return rows / rows[-1], columns / np.maximum(columns[:, -1:], 1e-300)


def recurrence(dimensions: int, seed: Sequence[int]) -> tuple[Real, Real]:
    """Steps of an even recurrence in so many dimensions (Roberts 2018), and a shift drawn by a seed."""
    golden = 2.0
    for _ in range(64):
        golden = (1.0 + golden) ** (1.0 / (dimensions + 1))
    return golden ** -np.arange(1.0, dimensions + 1.0), np.random.default_rng(tuple(seed)).random(dimensions)
