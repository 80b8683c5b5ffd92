"""The lattice of chips as an image of an array shows it: its pitch in pixels, and how many chips it has each way.

Chips are bright blobs: places where a smoothed image curves downwards both ways. (The slope of a bright middle and
the edge of the array curve one way only, so they do not count; a chip with a dark centre is one blob once
smoothed.) How much to smooth is not known beforehand, so several widths are tried. The pitch is the distance of
neighbours, along rows or along columns, on which the most widths in a row agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from validation.dataset.images import Real, binned_any, binned_mean

LARGEST_PX = 192
"""Images are binned to about this before they are looked at; a pitch is many pixels."""
FAINTEST = 0.07
"""Blobs below this share of the strongest curvature are noise, ripples, or the crest of a ring."""
MOST_BLOBS = 400
TURNED = 0.12
"""Tangent of the largest rotation that is looked for."""
ALIKE = 0.1
"""Distances of neighbours are one pitch where they agree within this share."""
LEAST_SHARE, LEAST_VOTES = 0.4, 3
"""Of the blobs that have a neighbour, the share that has it at one pitch; fewer than 3 have to be all there are."""
LEAST_WIDTHS = 3
"""How many widths in a row have to agree: ripples and noise change with the width, chips stay where they are."""


@dataclass(frozen=True)
class Lattice:
    """A lattice that was found; a pitch is None where no chip has a neighbour along that axis."""

    row_pitch_px: float | None  # along y
    column_pitch_px: float | None  # along x
    rows: int  # chips along y that are seen
    columns: int  # chips along x that are seen

    @property
    def pitch_px(self) -> float:
        """The pitch along the axis with more chips, where it is seen best; the mean where both have as many."""
        down, across = self.row_pitch_px, self.column_pitch_px
        if down is None or across is None:
            return down or across or 0.0
        return (down + across) / 2.0 if self.rows == self.columns else down if self.rows > self.columns else across


def find_lattice(image: Real, used: NDArray[np.bool_] | None = None) -> Lattice | None:
    """The lattice of chips in an image (row, column), or None where none is seen.

    `used`: pixels that count. Raises InputError for an image of fewer than 16 x 16 pixels.

    Notes
    -----
    Needs chips of one pitch, at least 6 px and rotated by less than 6 deg. Large images are binned first.
    """
    if min(image.shape) < 16:
        raise InputError("image", image.shape, "at least 16 x 16 pixels")
    factor = max(1, min(round(max(image.shape) / LARGEST_PX), min(image.shape) // 16))
    known = np.ones(image.shape, np.bool_) if used is None else used
    small, seen = binned_mean(np.where(known, image, 0.0), factor), ~binned_any(~known, factor)
    if not seen.any() or np.ptp(small[seen]) <= 0.0:
        return None
    widest = min(small.shape) / 8.0
    widths = np.geomspace(1.0, widest, max(4, int(np.ceil(4.0 * np.log2(widest)))))
    blobs = [_blobs(small, seen, float(width)) for width in widths]
    down = _elected([_neighbours(places) for places in blobs])
    across = _elected([_neighbours(places[:, ::-1]) for places in blobs])
    if down is None and across is None:
        return None
    return Lattice(
        None if down is None else down.pitch_px * factor,
        None if across is None else across.pitch_px * factor,
        1 if down is None else down.chips,
        1 if across is None else across.chips,
    )


class _Found(NamedTuple):
    """What one width of smoothing says of an axis."""

    pitch_px: float
    votes: int  # pairs of neighbours at that distance
    share: float  # of all blobs' nearest neighbours along the axis
    chips: int  # along the axis

    def is_sure(self) -> bool:
        """Whether enough neighbours agree to be taken for chips."""
        return self.share >= LEAST_SHARE and (self.votes >= LEAST_VOTES or self.share > 0.9)


def _blobs(image: Real, seen: NDArray[np.bool_], width_px: float) -> Real:
    """Places (blob, 2) in px, strongest first, where the image smoothed by a Gaussian is a blob."""
    curved, strongest = _downward(_filled(image, seen, width_px), width_px)
    inner = curved[1:-1, 1:-1]
    rows, columns = inner.shape
    around = [curved[r : r + rows, c : c + columns] for r in range(3) for c in range(3) if (r, c) != (1, 1)]
    peak = (inner > np.max(around, axis=0)) & (inner > FAINTEST * strongest) & seen[1:-1, 1:-1]
    places = np.argwhere(peak) + 1
    order = np.argsort(curved[tuple(places.T)])[::-1][:MOST_BLOBS]
    return np.array([_vertex(curved, row, column) for row, column in places[order].tolist()]).reshape(-1, 2)


def _filled(image: Real, seen: NDArray[np.bool_], width_px: float) -> Real:
    """The image with what is not seen filled in from around, so that a hole makes no edge."""
    if seen.all():
        return image
    weight = _derived(seen.astype(np.float64), 2.0 * width_px, (0, 0))[0]
    around = _derived(np.where(seen, image, 0.0), 2.0 * width_px, (0, 0))[0] / np.maximum(weight, 1e-3)
    return np.where(seen, image, around)


def _downward(image: Real, width_px: float) -> tuple[Real, float]:
    """The smaller of the two downward curvatures (row, column) of the smoothed image, and the largest of all.

    0 where it does not curve downwards both ways. Along the crest of a ring it is next to nothing of the largest.
    """
    rr, rc, cc = _derived(image, width_px, (2, 0), (1, 1), (0, 2))
    root = np.sqrt(((rr - cc) / 2.0) ** 2 + rc**2)
    mean = -(rr + cc) / 2.0
    return np.maximum(mean - root, 0.0), float(np.max(mean + root))


def _derived(image: Real, width_px: float, *orders: tuple[int, int]) -> list[Real]:
    """The image under a Gaussian, derived so many times by row and by column, for each of `orders`."""
    margin = min(int(4.0 * width_px) + 1, min(image.shape))
    behind = [(margin, margin + _to_fast(size + 2 * margin)) for size in image.shape]
    padded = np.pad(image, behind, mode="symmetric")
    row = 2.0j * np.pi * np.fft.fftfreq(padded.shape[0])[:, None]
    column = 2.0j * np.pi * np.fft.rfftfreq(padded.shape[1])
    spectrum = np.fft.rfft2(padded) * np.exp(width_px**2 / 2.0 * (row**2 + column**2).real)
    inner = tuple(slice(margin, margin + size) for size in image.shape)
    return [np.fft.irfft2(spectrum * row**down * column**across, padded.shape)[inner] for down, across in orders]


def _to_fast(length: int) -> int:
    """How many more make a length that a Fourier transform takes well: of the prime factors 2, 3, 5 only."""
    return next(more for more in range(length + 1) if (30**12) % (length + more) == 0)


def _vertex(values: Real, row: int, column: int) -> tuple[float, float]:
    """The place of a local maximum between pixels, by a parabola along each axis."""
    down = _parabola(*values[row - 1 : row + 2, column].tolist())
    across = _parabola(*values[row, column - 1 : column + 2].tolist())
    return row + down, column + across


def _parabola(before: float, here: float, after: float) -> float:
    bend = before - 2.0 * here + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0


def _neighbours(places: Real) -> _Found | None:
    """The distance along the first axis that most blobs have to their nearest neighbour that way."""
    if len(places) < 2:
        return None
    down, aside = (places[None, :, axis] - places[:, None, axis] for axis in (0, 1))
    ahead = np.where((down > 0.0) & (np.abs(aside) <= TURNED * down + 1.0), down, np.inf)
    nearest = ahead.min(axis=1)
    nearest = nearest[np.isfinite(nearest) & (nearest > 4.0)]
    if not nearest.size:
        return None
    alike = np.abs(nearest[None, :] / nearest[:, None] - 1.0) <= ALIKE
    chosen = nearest[alike[int(np.argmax(alike.sum(axis=1)))]]
    pitch = float(np.median(chosen))
    partners = ((np.abs(ahead / pitch - 1.0) <= ALIKE) | (np.abs(ahead.T / pitch - 1.0) <= ALIKE)).any(axis=1)
    extent = np.ptp(places[partners, 0])
    return _Found(pitch, len(chosen), len(chosen) / nearest.size, 1 + round(float(extent) / pitch))


def _elected(found: list[_Found | None]) -> _Found | None:
    """What the longest run of widths in a row agrees on, in the words of the narrowest that is surest."""
    runs: list[list[_Found]] = [[]]
    for one in found:
        if one is None or not one.is_sure():
            runs.append([])
        elif runs[-1] and abs(one.pitch_px / runs[-1][0].pitch_px - 1.0) > ALIKE:
            runs.append([one])
        else:
            runs[-1].append(one)
    best = max(runs, key=lambda run: sum(one.share**2 for one in run))
    return max(best, key=lambda one: one.share) if len(best) >= LEAST_WIDTHS else None
