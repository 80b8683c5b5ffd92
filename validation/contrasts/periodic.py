"""What repeats too finely for blocks of pixels: an embossed texture, prisms, a moire of theirs with the camera.

    inside    an image less the mean of each block of 2 x 2 pixels: what the blocks know nothing of
    power     of its waves beyond the blocks' own frequencies, over the share of white noise that is left there,
              summed over the images of one grid: what moves with the module keeps its frequency, but for a turn

Blocks take such waves away for the most part, and in their spectra they are one line among many. An image's power is
held against its own mean in a ring of frequencies, so a wrong read noise, which raises all of them, has no vote;
neighbours whose noise is one, as in a demosaiced image, do. Of noise each sum then follows a gamma distribution whose
shape is the number of images, whatever is inside of the blocks' means, and nothing need be drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import gammaln, logsumexp  # scipy.stats takes a second to import

from validation.contrasts.chance import normal_equivalent
from validation.contrasts.places import CELL, Picture

Real = NDArray[np.float64]
Whole = NDArray[np.intp]

PERIODIC = "fine pattern"
COARSEST = 0.5 / CELL
"""Cycles per pixel along an axis, from which on blocks take frequencies for others."""
RINGS = np.array([0.25, 0.35, 0.45, 0.55, 0.75])
"""Their edges, in cycles per pixel."""
QUIET = 0.5
"""Of what white noise has: a ring's mean counts at least that, or rounding would speak where there is no noise."""
SMALLEST = 1e-300
"""Of a power: its logarithm is a number."""
LEAST = 24
"""Frequencies of a ring whose mean may stand for its noise; smaller ones are left out."""


@dataclass(frozen=True)
class Wave:
    """The frequency that stands out most, in the images of one grid."""

    length_um: float
    direction_deg: float
    """In which it repeats on the camera, from its columns (x) towards its rows (y), -90 to 90."""
    z: float
    """Normal equivalent of the chance that noise has as large a one among all frequencies."""

    @property
    def words(self) -> str:
        """For people."""
        return f"waves {self.length_um:.3g} um long, which repeat along {self.direction_deg:.0f} deg of the camera"


@dataclass(frozen=True, eq=False)
class Pattern:
    """The fine frequencies of the images of one grid."""

    shape: tuple[int, int]
    pixel_um: float
    rows: tuple[slice, ...]
    """Of each image among all rows of a residual."""
    places: tuple[Whole, ...]
    """Of these in the image, row by row."""

    @cached_property
    def frequencies(self) -> tuple[Real, Real]:
        """Cycles per pixel along rows (y), and along columns (x), of the half of a plane that tells all."""
        fy, fx = np.fft.fftfreq(self.shape[0]), np.fft.rfftfreq(self.shape[1])
        return np.asarray(fy, float)[:, None], np.asarray(fx, float)[None, :]

    @cached_property
    def rings(self) -> Whole:
        """(y, x): the ring of each frequency that votes, 0 for all others: coarse ones, and mirrored or real ones."""
        fy, fx = self.frequencies
        once = (fx > 0.0) & (fx < 0.5) | (fy > 0.0) & (fy < 0.5)
        fine = once & (np.maximum(np.abs(fy), fx) > COARSEST)
        ring = np.where(fine, np.digitize(np.hypot(fy, fx), RINGS), 0)
        return np.where(np.bincount(ring.ravel())[ring] < LEAST, 0, ring)

    @cached_property
    def share(self) -> Real:
        """(y, x): of the power of white noise, what varies inside of blocks."""
        fy, fx = self.frequencies
        return np.asarray(1.0 - (np.cos(np.pi * fy) * np.cos(np.pi * fx)) ** 2)

    def power(self, residual: Real) -> Real:
        """(y, x): of a whitened residual, summed over the images, 1 of each image where there is only noise."""
        total, ring = np.zeros(self.rings.shape), self.rings
        votes = ring > 0
        for rows, places in zip(self.rows, self.places, strict=True):
            waves = fft.rfft2(_inside(residual[rows], places, self.shape))
            power = np.divide(waves.real**2 + waves.imag**2, self.share, out=np.zeros(votes.shape), where=votes)
            mean = np.bincount(ring.ravel(), power.ravel()) / np.maximum(np.bincount(ring.ravel()), 1)
            total += power / np.maximum(mean, QUIET * len(places))[ring]
        return total

    def loudest(self, residual: Real) -> Wave:
        """The frequency with the largest power."""
        power = self.power(residual)
        at = np.unravel_index(int(np.argmax(np.where(self.rings > 0, power, -1.0))), power.shape)
        fy, fx = (float(np.broadcast_to(one, power.shape)[at]) for one in self.frequencies)
        direction = float(np.degrees(np.arctan2(fy, fx)))
        expected = _log_expected(float(power[at]), len(self.rows), int(np.count_nonzero(self.rings)))
        return Wave(self.pixel_um / float(np.hypot(fy, fx)), direction, float(normal_equivalent(expected)))


def _inside(values: Real, places: Whole, shape: tuple[int, int]) -> Real:
    """The image of these values at its used places, less the mean of each block; 0 at the others."""
    rows, columns = shape
    wide = -(-columns // CELL)
    block = places // columns // CELL * wide + places % columns // CELL
    mean = np.bincount(block, values) / np.maximum(np.bincount(block), 1)
    image = np.zeros((rows, columns))
    image.flat[places] = values - mean[block]
    return image


def _log_expected(power: float, images: int, frequencies: int) -> float:
    """Natural logarithm of how many of so many sums over images of unit exponentials are as large."""
    steps = np.arange(images)
    one = logsumexp(steps * np.log(max(power, SMALLEST)) - gammaln(steps + 1.0)) - power
    return float(np.log(frequencies) + one)


def patterns_of(pictures: Sequence[Picture]) -> tuple[Pattern, ...]:
    """Those of images, which lie one behind the other in a residual; grids whose images are too small have none."""
    alike: dict[int, list[tuple[Picture, slice]]] = {}
    start = 0
    for one in pictures:
        count = int(np.count_nonzero(one.used))
        if count:
            alike.setdefault(one.grid, []).append((one, slice(start, start + count)))
        start += count
    found = [
        Pattern(
            shape=together[0][0].used.shape,
            pixel_um=together[0][0].pixel_um,
            rows=tuple(rows for _, rows in together),
            places=tuple(np.flatnonzero(one.used) for one, _ in together),
        )
        for together in alike.values()
    ]
    return tuple(one for one in found if one.rings.any())
