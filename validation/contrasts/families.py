"""Families of contrasts: sums of a whitened residual over blocks, rings and sectors, and its power per frequency.

    cells     blocks of 2 x 2 used pixels of an image, pairs of rows of a curve: each used pixel in one cell
    sums      of cells: blocks of 4, 8, 16, rings about the nearest chip, azimuth sectors, rings about the module's
              centre, rows and columns of the camera (by twos); and each of these summed over all images in which it
              is the same place
    power     of the map of cells of an image, in rings of spatial frequency

All of these are made of cells, so a residual, measured or drawn, is needed by its cells only. A single pixel has no
vote, for a wrong read noise would speak there first, but in what repeats from pixel to pixel (`periodic`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft, sparse

from validation.contrasts.periodic import Pattern, patterns_of
from validation.contrasts.places import CELL, Picture, from_nearest_um

Real = NDArray[np.float64]
Whole = NDArray[np.intp]
Array = NDArray[np.floating]

BLOCKS = (2, 4, 8, 16)
CELLS, CHIP_RINGS, AZIMUTH, FIELD = "blocks of 2", "distance from the chip", "azimuth", "field radius"
ROWS, COLUMNS = "rows of the camera", "columns of the camera"
RING_UM = 50.0
RINGS = np.array([0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 1e9])  # edges, in ring widths
SECTORS = 16
FIELD_RINGS = 8
BANDS = np.array([0.5, 1.5, 2.5, 3.5, 5.5, 8.5, 12.5, 18.5, 26.5, 38.5, 54.5, 1e9])  # edges, cycles per image


@dataclass(frozen=True, eq=False)
class Group:
    """The contrasts of one family in one shot, or summed over shots (shot None); rows of the vector of contrasts."""

    family: str
    shot: str | None
    rows: slice
    labels: Whole
    words: Callable[[int], str]  # the region that a label stands for


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The power of one image in rings of spatial frequency."""

    shot: str
    shape: tuple[int, int]  # of the map of cells
    cells: Whole  # where in that map the image's cells are
    rows: slice  # of those cells among all cells
    bands: Array  # (band, coefficient): 1 or 2 where a coefficient counts, 2 for its mirror
    families: tuple[str, ...]  # by band

    def power(self, cells: Array) -> Array:
        """(band, draw) from sums over cells (cell, draw)."""
        maps = np.zeros((self.shape[0] * self.shape[1], cells.shape[1]), cells.dtype)
        maps[self.cells] = cells[self.rows]
        spectrum = fft.rfft2(maps.reshape(*self.shape, -1), axes=(0, 1))
        power = spectrum.real**2 + spectrum.imag**2
        return np.asarray(self.bands @ power.reshape(-1, cells.shape[1]))


@dataclass(frozen=True, eq=False)
class Layout:
    """All contrasts of a set of shots."""

    shots: tuple[str, ...]
    cells: sparse.csr_array  # (cell, row)
    sums: sparse.csr_array  # (sum, cell)
    groups: tuple[Group, ...]
    spectra: tuple[Spectrum, ...]
    patterns: tuple[Pattern, ...] = ()
    """Of single pixels, which these contrasts know nothing of."""

    @cached_property
    def members(self) -> tuple[tuple[str, str | None], ...]:
        """(family, shot) of each energy: groups, then bands of spectra."""
        groups = [(group.family, group.shot) for group in self.groups]
        bands = [(family, spectrum.shot) for spectrum in self.spectra for family in spectrum.families]
        return (*groups, *bands)

    @cached_property
    def families(self) -> tuple[str, ...]:
        """Names of the families, in order."""
        return tuple(dict.fromkeys(family for family, _ in self.members))

    @cached_property
    def family_sums(self) -> Real:
        """(family, energy): 1 where an energy belongs to a family."""
        return np.array([[float(family == name) for family, _ in self.members] for name in self.families])

    @cached_property
    def pixels(self) -> Real:
        """How many rows each cell has."""
        return np.asarray(np.diff(self.cells.indptr), np.float64)

    def contrasts(self, cells: Array) -> Array:
        """All linear contrasts (contrast, draw) from sums over cells (cell, draw)."""
        return np.concatenate([cells, self.sums @ cells])

    @cached_property
    def places(self) -> dict[str | None, int]:
        """How many linear contrasts each shot has, and all shots summed (None), in the order of `peaks`."""
        counts = dict.fromkeys((group.shot for group in self.groups), 0)
        for group in self.groups:
            counts[group.shot] += len(group.labels)
        return counts

    def energies(self, cells: Array, weight: Array) -> Array:
        """(energy, draw): sums of squares of contrasts times their weight by group, then powers by band."""
        return self.energies_and_peaks(cells, weight)[0]

    def energies_and_peaks(self, cells: Array, weight: Array) -> tuple[Array, Array]:
        """The energies, and the largest single square (place, draw) of each of `places`."""
        squares = self.contrasts(cells) ** 2 * weight[:, None]
        parts = [squares[group.rows].sum(axis=0) for group in self.groups]
        powers = [spectrum.power(cells) for spectrum in self.spectra]
        energies = np.concatenate([np.array(parts).reshape(len(parts), -1), *powers])
        of_place: dict[str | None, list[Array]] = {place: [] for place in self.places}
        for group in self.groups:
            of_place[group.shot].append(squares[group.rows].max(axis=0))
        peaks = [np.max(of_groups, axis=0) for of_groups in of_place.values()]
        return energies, np.array(peaks).reshape(len(peaks), -1)


@dataclass(frozen=True, eq=False)
class _Labelled:
    """Things (rows, or cells) under labels."""

    family: str
    shot: str | None
    things: Whole
    labels: Whole
    words: Callable[[int], str]


def layout_of(pictures: Sequence[Picture], curves: Sequence[tuple[str, Real, str]] = ()) -> Layout:
    """The contrasts of images, then of curves, each (id, axis of its rows, unit of that axis)."""
    labelled, start = [], 0
    for one in pictures:
        y, x = np.nonzero(one.used)
        labels = y // CELL * _across(one) + x // CELL
        labelled.append(_Labelled(CELLS, one.id, start + np.arange(len(y)), labels, _block_words(one, CELL)))
        start += len(y)
    for name, axis, unit in curves:
        rows = np.arange(len(axis))
        labelled.append(_Labelled(CELLS, name, start + rows, rows // CELL, _curve_words(axis, unit, CELL)))
        start += len(axis)
    cells, groups = _collect(labelled, start, 0)
    of_pictures = list(zip(pictures, groups, strict=False))
    further = [sums for one, group in of_pictures for sums in _of_picture(one, group)]
    for (_, axis, unit), group in zip(curves, groups[len(pictures) :], strict=True):
        for size in BLOCKS[1:]:
            labels, words = group.labels // (size // CELL), _curve_words(axis, unit, size)
            further.append(_Labelled(f"blocks of {size}", group.shot, _things(group), labels, words))
    further += list(_over_images(pictures, further, groups))
    sums, more = _collect(further, cells.shape[0], cells.shape[0])
    spectra = tuple(_spectrum(one, group) for one, group in of_pictures)
    shots = tuple([one.id for one in pictures] + [name for name, *_ in curves])
    return Layout(shots, cells, sums, (*groups, *more), spectra, patterns_of(pictures))


def _of_picture(one: Picture, cells: Group) -> Iterable[_Labelled]:
    """The sums of an image: each is a label for every cell."""
    things = _things(cells)
    for size in BLOCKS[1:]:
        times, wide = size // CELL, -(-one.used.shape[1] // size)
        labels = cells.labels // _across(one) // times * wide + cells.labels % _across(one) // times
        yield _Labelled(f"blocks of {size}", one.id, things, labels, _block_words(one, size))
    x_um, y_um = _of_cells(one, one.x_um), _of_cells(one, one.y_um)
    width_um = _ring_width_um(one)
    ring = np.digitize(from_nearest_um(x_um, y_um, one.chips_um) / width_um, RINGS) - 1
    yield _Labelled(CHIP_RINGS, one.id, things, ring, _ring_words(width_um))
    sector = np.floor(np.degrees(np.arctan2(y_um, x_um)) / (360.0 / SECTORS)).astype(np.intp) % SECTORS
    yield _Labelled(AZIMUTH, one.id, things, sector, _sector_words)
    if len(one.chips_um) > 1:  # about a single chip these are the rings above
        step_um = float(np.hypot(*one.used.shape)) * one.pixel_um / 2.0 / FIELD_RINGS
        field = np.minimum(np.hypot(x_um, y_um) / step_um, FIELD_RINGS - 1)
        yield _Labelled(FIELD, one.id, things, field.astype(np.intp), _field_words(step_um))
    row, column = np.divmod(cells.labels, _across(one))
    yield _Labelled(ROWS, one.id, things, row, _line_words("rows", one.used.shape[0]))
    yield _Labelled(COLUMNS, one.id, things, column, _line_words("columns", one.used.shape[1]))


def _over_images(
    pictures: Sequence[Picture], sums: Sequence[_Labelled], cells: Sequence[Group]
) -> Iterable[_Labelled]:
    """Everything summed over the images in which it is the same place: blocks and lines of the camera, rings of the
    module."""
    groups = [_Labelled(CELLS, one.shot, _things(one), one.labels, one.words) for one in cells]
    for family in (CELLS, *(f"blocks of {size}" for size in BLOCKS[1:]), CHIP_RINGS, AZIMUTH, FIELD, ROWS, COLUMNS):
        of_family = {one.shot: one for one in (*groups, *sums) if one.family == family}
        alike: dict[object, list[_Labelled]] = {}
        for one in pictures:
            same = {CHIP_RINGS: _ring_width_um(one), AZIMUTH: 0, FIELD: (one.used.shape, one.pixel_um)}.get(
                family, one.grid
            )
            alike.setdefault(same, []).extend([of_family[one.id]] if one.id in of_family else [])
        for together in alike.values():
            if len(together) > 1:
                things = np.concatenate([one.things for one in together])
                labels = np.concatenate([one.labels for one in together])
                yield _Labelled(f"{family}, all images", None, things, labels, together[0].words)


def _things(group: Group) -> Whole:
    return np.arange(group.rows.start, group.rows.stop)


def _across(one: Picture) -> int:
    """Cells in a row of an image."""
    return int(-(-one.used.shape[1] // CELL))


def _ring_width_um(one: Picture) -> float:
    return max(RING_UM, CELL * one.pixel_um)


def _of_cells(one: Picture, values: Real) -> Real:
    """Means over the used pixels of each cell of values (row, column)."""
    y, x = np.nonzero(one.used)
    _, cell, count = np.unique(y // CELL * _across(one) + x // CELL, return_inverse=True, return_counts=True)
    return np.asarray(np.bincount(cell, values[one.used]) / count)


def _collect(labelled: Sequence[_Labelled], columns: int, first_row: int) -> tuple[sparse.csr_array, list[Group]]:
    """One sparse matrix that sums things under each label, and the groups of its rows (counted from `first_row`)."""
    groups, row_parts, column_parts, row = [], [], [], 0
    for one in labelled:
        labels, which = np.unique(one.labels, return_inverse=True)
        groups.append(
            Group(one.family, one.shot, slice(first_row + row, first_row + row + len(labels)), labels, one.words)
        )
        row_parts.append(row + which)
        column_parts.append(one.things)
        row += len(labels)
    rows = np.concatenate(row_parts) if row_parts else np.zeros(0, np.intp)
    things = np.concatenate(column_parts) if column_parts else np.zeros(0, np.intp)
    matrix = sparse.csr_array((np.ones(len(rows), np.float32), (rows, things)), shape=(row, columns))
    return matrix, groups


def _spectrum(one: Picture, cells: Group) -> Spectrum:
    shape = (-(-one.used.shape[0] // CELL), -(-one.used.shape[1] // CELL))
    side_mm = max(shape) * CELL * one.pixel_um / 1000.0
    per_image_y = np.fft.fftfreq(shape[0])[:, None] * max(shape)
    per_image_x = np.fft.rfftfreq(shape[1])[None, :] * max(shape)
    band = np.digitize(np.hypot(per_image_y, per_image_x), BANDS) - 1
    twice = np.full(band.shape, 2.0)
    twice[:, 0] = 1.0  # rfft keeps one of each pair of mirrored columns
    if shape[1] % 2 == 0:
        twice[:, -1] = 1.0
    present = [number for number in np.unique(band) if number >= 0]
    bands = np.array([np.where(band == number, twice, 0.0).ravel() for number in present], np.float32)
    return Spectrum(
        one.id, shape, cells.labels, cells.rows, bands, tuple(_band_words(number, side_mm) for number in present)
    )


def _block_words(one: Picture, size: int) -> Callable[[int], str]:
    height, width = one.used.shape
    wide = -(-width // size)

    def words(label: int) -> str:
        row, column = label // wide * size, label % wide * size
        return f"rows {row}-{min(row + size, height) - 1}, columns {column}-{min(column + size, width) - 1}"

    return words


def _line_words(what: str, count: int) -> Callable[[int], str]:
    return lambda label: f"{what} {label * CELL}-{min((label + 1) * CELL, count) - 1}"


def _curve_words(axis: Real, unit: str, size: int) -> Callable[[int], str]:
    def words(label: int) -> str:
        part = axis[label * size : (label + 1) * size]
        return f"{part.min():g}-{part.max():g} {unit}"

    return words


def _ring_words(width_um: float) -> Callable[[int], str]:
    def words(label: int) -> str:
        if label + 2 == len(RINGS):
            return f"beyond {RINGS[label] * width_um:g} um from the nearest chip"
        return f"{RINGS[label] * width_um:g}-{RINGS[label + 1] * width_um:g} um from the nearest chip"

    return words


def _sector_words(label: int) -> str:
    step_deg = 360.0 / SECTORS
    return f"azimuth {label * step_deg:g}-{(label + 1) * step_deg:g} deg about the module's centre"


def _field_words(step_um: float) -> Callable[[int], str]:
    def words(label: int) -> str:
        return f"{label * step_um / 1000.0:.2f}-{(label + 1) * step_um / 1000.0:.2f} mm from the module's centre"

    return words


def _band_words(number: int, side_mm: float) -> str:
    if number + 2 == len(BANDS):
        return f"spatial frequency above {BANDS[number] / side_mm:.3g} per mm"
    return f"spatial frequency {BANDS[number] / side_mm:.3g}-{BANDS[number + 1] / side_mm:.3g} per mm"
