"""The verdict on what a fit has left: is it more than noise, and where.

The statistic is the largest standardised family, single place or fine pattern; its p-value is counted among draws
that went through the same fit, so it pays for all of these, for the refit, for the priors and for the variance scale.
A region's own z does not pay for the many regions there are; `chance` does, within its family. The variance scale is
one for all shots, held to what its prior allows: free, one image at ten times its noise would hide others' faults.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtri  # scipy.stats takes a second to import

from validation.contrasts.families import CELLS, Layout, layout_of
from validation.contrasts.null import Null, Variances, null
from validation.contrasts.periodic import PERIODIC, Wave
from validation.contrasts.places import picture
from validation.fit.whitening import grids_of, held_scale

if TYPE_CHECKING:
    from validation.fit.least_squares import Basis
    from validation.fit.result import Fit

Real = NDArray[np.float64]

DRAWS = 10_000
REGIONS = 20
MOST_MOVED = 0.3  # of a family's standard deviation under the null, by what the model's own error may be
LARGEST_P = 0.9999  # for its normal equivalent: that of 1 is no number


@dataclass(frozen=True)
class Region:
    """A place where the residual is not noise, or is the least like it."""

    family: str
    shot: str | None  # None: summed over all images
    words: str
    z: float  # of this region alone; its sign is that of measured minus predicted
    log_chance: (
        float  # natural logarithm of the chance that noise has as large a |z| somewhere in this family and shot
    )

    @property
    def chance(self) -> float:
        """The same as a number; 0 where it is too small for one."""
        return float(np.exp(self.log_chance))

    @property
    def place(self) -> str:
        """For people: where, and in which image."""
        return f"{self.words}, {self.shot or 'all images together'}"


@dataclass(frozen=True)
class FamilyFound:
    """One family of contrasts."""

    name: str
    energy: float  # sum of squares of its standardised contrasts
    expected: float  # the same from noise
    freedom: float  # of the chi2 that noise follows there
    z: float
    p: float


@dataclass(frozen=True)
class ShotFound:
    """One shot."""

    p: float
    p_text: str
    z: float
    chi2_per_pixel: float
    worst: Region


@dataclass(frozen=True, eq=False)
class Structure:
    """What is left."""

    p: float
    p_text: str  # "< 1/10000" where no draw was as large
    z: float  # normal equivalent of p; a lower limit where no draw was as large
    statistic: float  # the largest standardised family, single place, or fine pattern
    place: float  # of the single places the largest
    pattern: float | None  # of the fine patterns the largest; None: none can be looked for
    families: tuple[FamilyFound, ...]  # the largest first
    shots: dict[str, ShotFound]
    where: tuple[Region, ...]  # the least likely first
    variance_scale: float
    chi2: float  # of single pixels, shown but without a vote
    freedom: float
    draws: int
    seed: int
    doubts: tuple[str, ...] = ()  # why the model's own error may look like structure, or hide some


def structure(fit: Fit, draws: int = DRAWS, seed: int = 1, cache: Path | None = None) -> Structure:
    """Whether a fit has left more than noise, and where; `cache`: a folder that keeps nulls."""
    layout, projection = fit_layout(fit), fit.basis
    variances = Variances.of(layout, projection)
    drawn = null(layout, projection, variances.weight, draws, seed, cache)
    doubts = doubts_of(fit, layout, variances, drawn)
    return replace(judged(fit.residual, layout, projection, variances, drawn), doubts=doubts)


def fit_layout(fit: Fit) -> Layout:
    """The contrasts of a fit's shots."""
    images, poses = fit.problem.images, fit.poses
    grid = {index: number for number, grid in enumerate(grids_of(images)) for index in grid}
    pictures = [
        picture(image, poses[image.shot.id], fit.model.environment, grid[index]) for index, image in enumerate(images)
    ]
    return layout_of(pictures, [(curve.id, curve.axis, curve.axis_unit) for curve in fit.problem.curves])


def judged(residual: Real, layout: Layout, projection: Basis, variances: Variances, drawn: Null) -> Structure:
    """The verdict on a whitened residual against its null."""
    chi2 = float(residual @ residual)
    scale = held_scale(chi2, projection.freedom)
    cells = (layout.cells @ residual)[:, None]
    energies, peaks = (
        np.asarray(part / scale, np.float64) for part in layout.energies_and_peaks(cells, variances.weight)
    )
    local_z = np.asarray(layout.contrasts(cells)[:, 0] * np.sqrt(variances.weight / scale), np.float64)
    waves = [pattern.loudest(residual) for pattern in layout.patterns]
    regions = _regions(layout, local_z, energies, waves, drawn)
    families = _families(layout, energies, drawn)
    place, pattern = float(drawn.peak_z(peaks).max()), max((wave.z for wave in waves), default=None)
    largest = max(families[0].z, place, *(() if pattern is None else (pattern,)))
    p, p_text = counted_p(drawn.largest, largest)
    return Structure(
        p=p,
        p_text=p_text,
        z=float(-ndtri(min(p, LARGEST_P))),
        statistic=largest,
        place=place,
        pattern=pattern,
        families=families,
        shots={shot: _shot(shot, residual, energies, peaks, drawn, regions) for shot in layout.shots},
        where=tuple(regions[:REGIONS]),
        variance_scale=scale,
        chi2=chi2,
        freedom=projection.freedom,
        draws=drawn.draws,
        seed=drawn.seed,
    )


def counted_p(null_values: Real, value: float) -> tuple[float, str]:
    """(1 + b)/(1 + B), with b of B draws as large as the value, and how to print it."""
    above, draws = int(np.sum(null_values >= value)), len(null_values)
    p = (1 + above) / (1 + draws)
    return p, f"{p:.2g}" if above else f"< 1/{draws}"


def families_moved(layout: Layout, projection: Basis, drawn: Null, weight: Real, rows: Real) -> dict[str, float]:
    """How far an error (whitened rows) moves each family, in that family's standard deviations under the null."""
    left = projection.residual(rows)
    moved = layout.family_sums @ layout.energies((layout.cells @ left)[:, None], weight)[:, 0]
    spread = (layout.family_sums @ drawn.energies).std(axis=1)
    return {name: float(one / sd) for name, one, sd in zip(layout.families, moved, spread, strict=True) if sd > 0.0}


def doubts_of(fit: Fit, layout: Layout, variances: Variances, drawn: Null) -> tuple[str, ...]:
    """Why a fit is not to be trusted that has gone far from its anchor; nothing where that moves no family far."""
    moved = families_moved(layout, fit.basis, drawn, variances.weight, fit.carried)
    worst = max(moved, key=lambda name: moved[name], default=None)
    if worst is None or moved[worst] <= MOST_MOVED:
        return ()
    sentence = f"the twin's own error may move {worst} by {moved[worst]:.2g} of their spread, above {MOST_MOVED:g}"
    return (f"{sentence}: the fit is far from its anchor; calibrate first",)


def _families(layout: Layout, energies: Real, drawn: Null) -> tuple[FamilyFound, ...]:
    standard, sums = drawn.of_families, layout.family_sums @ energies
    z = standard.z(sums)[:, 0]
    null_sums = layout.family_sums @ drawn.energies
    found = [
        FamilyFound(
            name,
            float(sums[k, 0]),
            float(standard.mean[k]),
            float(standard.freedom[k]),
            float(z[k]),
            counted_p(null_sums[k], float(sums[k, 0]))[0],
        )
        for k, name in enumerate(layout.families)
    ]
    return tuple(sorted(found, key=lambda family: -family.z))


def _regions(layout: Layout, local_z: Real, energies: Real, waves: Sequence[Wave], drawn: Null) -> list[Region]:
    """The worst region of each family in each shot, the least likely first; a frequency band, or wave, is one too."""
    found = []
    for group in layout.groups:
        part = local_z[group.rows]
        worst, count = int(np.argmax(np.abs(part))), int(np.count_nonzero(part))
        if count:
            found.append(_region(group.family, group.shot, group.words(int(group.labels[worst])), part[worst], count))
    z = drawn.of_groups.z(energies)[:, 0]
    for (family, shot), value in list(zip(layout.members, z, strict=True))[len(layout.groups) :]:
        found.append(Region("spatial frequency", shot, family, float(value), float(log_ndtr(-value))))
    found += [Region(PERIODIC, None, wave.words, wave.z, float(log_ndtr(-wave.z))) for wave in waves]
    return sorted(found, key=lambda region: region.log_chance)


def _region(family: str, shot: str | None, words: str, z: float, count: int) -> Region:
    return Region(family, shot, words, float(z), min(0.0, float(np.log(2.0 * count) + log_ndtr(-abs(z)))))


def _shot(
    shot: str, residual: Real, energies: Real, peaks: Real, drawn: Null, regions: Sequence[Region]
) -> ShotFound:
    layout = drawn.layout
    rows = [k for k, (_, owner) in enumerate(layout.members) if owner == shot]
    peak = float(drawn.peak_z(peaks)[list(layout.places).index(shot), 0])
    p, text = counted_p(drawn.largest_in(shot, rows), max(float(drawn.of_groups.z(energies)[rows, 0].max()), peak))
    cells = next(group for group in layout.groups if group.shot == shot and group.family == CELLS)
    pixels = layout.cells[cells.rows].indices
    nowhere = Region(CELLS, shot, "nowhere", 0.0, 0.0)  # where the fit takes all that there is
    worst = next((region for region in regions if region.shot == shot), nowhere)
    return ShotFound(p, text, float(-ndtri(min(p, LARGEST_P))), float(np.mean(residual[pixels] ** 2)), worst)
