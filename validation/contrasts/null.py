"""What the contrasts do where the model is right: white noise sent through the same fit, many times.

A drawn residual is y - D (D'y + P'u), with y white noise (times a drawn variance scale; the Monte Carlo's own noise
is white with the camera's, for both are in the whitening) and u the errors of the priors; D and P are the data and
the prior rows of the fit's basis. It is never made.
Only its sums over cells are needed, and D'y: the sums are independent normal numbers, D'y follows from them but for
what varies inside of cells, which is normal with a small known covariance. So nothing is approximated, and a quarter
of the numbers is drawn. The variance scale is estimated anew from each draw's chi2, as it was from the data's. Same
seed, same null.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr  # scipy.stats takes a second to import

from validation.contrasts.chance import normal_equivalent
from validation.contrasts.families import Layout
from validation.fit.least_squares import Basis
from validation.fit.whitening import HELD_SD, SCALE_PRIOR_SD, held_scales

Real = NDArray[np.float64]
Single = NDArray[np.float32]

BATCH = 128  # draws at once
PATTERNS = 1  # beside the seed: of the numbers that are drawn for fine patterns
VANISHED = 1e-6  # share of a contrast's variance below which the fit has taken it all


@dataclass(frozen=True, eq=False)
class Variances:
    """Of all linear contrasts under the null: exact, none drawn."""

    variance: Real  # (contrast,)
    weight: Real  # 1 / variance, 0 for contrasts that the fit takes away

    @classmethod
    def of(cls, layout: Layout, projection: Basis) -> Variances:
        """The variances of a layout's contrasts after a fit."""
        pixels = layout.contrasts(layout.pixels[:, None])[:, 0]
        taken = layout.contrasts(layout.cells @ projection.data)
        variance = pixels - np.sum(taken**2, axis=1)
        kept = variance > VANISHED * pixels
        return cls(variance, np.where(kept, 1.0 / np.where(kept, variance, 1.0), 0.0))


@dataclass(frozen=True, eq=False)
class Null:
    """Energies of all groups, and the largest single places, in many draws with nothing but noise in them."""

    layout: Layout
    energies: Single  # (energy, draw)
    peaks: Single  # (place, draw): the largest square of one contrast in each shot, and in the sums over shots
    seed: int

    @property
    def draws(self) -> int:
        """How many."""
        return int(self.energies.shape[1])

    @cached_property
    def of_families(self) -> Standard:
        """How the energies of whole families are standardised."""
        return Standard.of(self.layout.family_sums @ self.energies)

    @cached_property
    def of_groups(self) -> Standard:
        """The same for each family in each shot."""
        return Standard.of(self.energies.astype(float))

    @cached_property
    def largest(self) -> Real:
        """The statistic of each draw: its largest standardised family, single place, or fine pattern.

        Of a fine pattern z is a normal number by its own chance, so that is what is drawn of it.
        """
        families = self.of_families.z(self.layout.family_sums @ self.energies).max(axis=0)
        random = np.random.Generator(np.random.SFC64((self.seed, PATTERNS)))
        patterns = random.standard_normal((len(self.layout.patterns), self.draws)).max(axis=0, initial=-np.inf)
        return np.asarray(np.maximum.reduce([families, self.peak_z(self.peaks).max(axis=0), patterns]))

    def largest_in(self, shot: str, rows: list[int]) -> Real:
        """The same over one shot, whose groups are `rows`."""
        part = Standard(self.of_groups.mean[rows], self.of_groups.freedom[rows])
        groups = part.z(self.energies[rows].astype(float)).max(axis=0)
        return np.asarray(np.maximum(groups, self.peak_z(self.peaks)[list(self.layout.places).index(shot)]))

    def peak_z(self, peaks: Real | Single) -> Real:
        """Standardised peaks (place, draw): normal equivalents of the chance that one of so many is as large."""
        count = np.array(list(self.layout.places.values()), float)[:, None]
        log_expected = np.log(2.0 * count) + log_ndtr(-np.sqrt(np.asarray(peaks, float)))
        return normal_equivalent(log_expected)


@dataclass(frozen=True, eq=False)
class Standard:
    """Brings energies to one, nearly normal scale: Wilson and Hilferty's cube root, mean and variance matched.

    Without it a family of four sectors, whose chi2 has a long tail, would drown one of a thousand blocks.
    """

    mean: Real
    freedom: Real  # of the chi2 with the same mean and variance: 2 mean^2 / variance

    @classmethod
    def of(cls, energies: Real) -> Standard:
        """From draws (energy, draw)."""
        mean, variance = energies.mean(axis=1), energies.var(axis=1)
        some = variance > 0.0
        return cls(np.where(some, mean, 1.0), np.where(some, 2.0 * mean**2 / np.where(some, variance, 1.0), 1.0))

    def z(self, energies: Real) -> Real:
        """Standardised energies (energy, draw)."""
        spread = 2.0 / (9.0 * self.freedom[:, None])
        return np.asarray((np.cbrt(energies / self.mean[:, None]) - (1.0 - spread)) / np.sqrt(spread))


_REMEMBERED: dict[str, Single] = {}
_MOST_REMEMBERED = 8
_MOST_KEPT = 64
"""Files of a folder: some 3 MB each, and a fit that is not made again never asks for its own."""


def null(
    layout: Layout,
    projection: Basis,
    weight: Real,
    draws: int = 10_000,
    seed: int = 1,
    cache: Path | None = None,
) -> Null:
    """The null of a layout after a fit; drawn once for each projection, kept in memory and under `cache`."""
    key = _key(layout, projection, draws, seed)
    file = None if cache is None else cache / f"null-{key}.npy"
    if key not in _REMEMBERED:
        shape = (len(layout.members) + len(layout.places), draws)
        drawn = None if file is None else _loaded(file, shape)
        if drawn is None:
            drawn = _draw(layout, projection, weight, draws, seed)
            if file is not None:
                _save(file, drawn)
        while len(_REMEMBERED) >= _MOST_REMEMBERED:
            _REMEMBERED.pop(next(iter(_REMEMBERED)))
        _REMEMBERED[key] = drawn
    energies, peaks = np.split(_REMEMBERED[key], [len(layout.members)])
    return Null(layout, energies, peaks, seed)


def _draw(layout: Layout, projection: Basis, weight: Real, draws: int, seed: int) -> Single:
    """(energies, then peaks; draw)."""
    random = np.random.Generator(np.random.SFC64(seed))
    machine = _Machine.of(layout, projection, weight)
    parts = [machine.drawn(random, min(BATCH, draws - first)) for first in range(0, draws, BATCH)]
    return np.concatenate(parts, axis=1)


@dataclass(frozen=True, eq=False)
class _Machine:
    """The products that draws share, in single precision."""

    layout: Layout
    weight: Single
    root_pixels: Single  # (cell, 1): square root of the pixels of each cell
    over_cells: Single  # (parameter, cell): columns of the fit along the unit vectors of the cells
    inside_cells: Single  # (parameter, direction): columns along other directions
    sums_data: Single  # (cell, parameter): C D
    prior: Single  # (prior, parameter)
    data_data: Single  # D'D
    rest: int  # directions that no cell and no column has
    freedom: float

    @classmethod
    def of(cls, layout: Layout, projection: Basis, weight: Real) -> _Machine:
        data, columns = projection.data, projection.data.T
        root = np.sqrt(layout.pixels)
        over_cells = (layout.cells @ columns.T).T / root
        within = columns - (layout.cells.T @ (over_cells / root).T).T
        size, directions = np.linalg.eigh(within @ within.T)
        some = size > 1e-12
        return cls(
            layout,
            weight=_single(weight),
            root_pixels=_single(root[:, None]),
            over_cells=_single(over_cells),
            inside_cells=_single(directions[:, some] * np.sqrt(size[some])),
            sums_data=_single(layout.cells @ data),
            prior=_single(projection.prior),
            data_data=_single(data.T @ data),
            rest=max(len(data) - len(root) - int(some.sum()), 0),
            freedom=projection.freedom,
        )

    def drawn(self, random: np.random.Generator, count: int) -> Single:
        """(energies, then peaks; draw) of `count` draws."""
        cells, inside, priors = (
            random.standard_normal((size, count), np.float32)
            for size in (len(self.root_pixels), self.inside_cells.shape[1], len(self.prior))
        )
        scale = np.exp(0.5 * SCALE_PRIOR_SD * random.standard_normal(count, np.float32))
        rest = random.chisquare(self.rest, count) if self.rest else np.zeros(count)
        data = (self.over_cells @ cells + self.inside_cells @ inside) * scale
        length2 = scale**2 * (_lengths2(cells) + _lengths2(inside) + rest)
        fitted = data + self.prior.T @ priors
        chi2 = length2 - (fitted * (2.0 * data - self.data_data @ fitted)).sum(axis=0)
        cells *= self.root_pixels * scale
        cells -= self.sums_data @ fitted
        found = np.concatenate(self.layout.energies_and_peaks(cells, self.weight))
        return (found / held_scales(chi2, self.freedom)).astype(np.float32)


def _single(array: Real) -> Single:
    return np.ascontiguousarray(array, np.float32)


def _lengths2(draws: Single) -> Single:
    """Squared length of each draw, summed by a matrix product, which keeps more digits than a running sum."""
    return np.asarray(np.ones(len(draws), np.float32) @ draws**2)


def _key(layout: Layout, projection: Basis, draws: int, seed: int) -> str:
    """A hash of all that a null depends on."""
    digest = hashlib.sha256(
        f"{draws} {seed} {SCALE_PRIOR_SD} {HELD_SD} {layout.members} {list(layout.places)}".encode()
    )
    for matrix in (layout.cells, layout.sums):
        digest.update(matrix.indptr.tobytes() + matrix.indices.tobytes())
    for spectrum in layout.spectra:
        digest.update(repr(spectrum.shape).encode() + spectrum.cells.tobytes())
    for array in (projection.data, projection.prior):
        digest.update(repr(array.shape).encode() + np.ascontiguousarray(array, np.float32).tobytes())
    return digest.hexdigest()


def _loaded(file: Path, shape: tuple[int, int]) -> Single | None:
    """What a file keeps; None where there is none, or none that is whole."""
    try:
        drawn: Single = np.load(file)
    except (OSError, EOFError, ValueError):
        return None
    return drawn if drawn.shape == shape and drawn.dtype == np.float32 else None


def _save(file: Path, drawn: Single) -> None:
    """Written whole or not at all, and not at all where the folder cannot be written; the oldest files go."""
    part = file.with_name(f"{file.name}.{np.random.default_rng().integers(1 << 62):x}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as stream:
            np.save(stream, drawn)
        part.replace(file)
        kept = sorted(file.parent.glob("null-*"), key=lambda one: one.stat().st_mtime)
        for one in kept[:-_MOST_KEPT]:
            one.unlink(missing_ok=True)
    except OSError:  # it can be drawn again
        with suppress(OSError):
            part.unlink()
