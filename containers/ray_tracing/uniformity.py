"""How even the light is: Eq. 8 of the paper and the figures of displays, each with its standard error.

Uniformities are in [0, 1]; percent is for print.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import gcd

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.estimate import Estimate, Ratio, ratio_estimate, ratio_estimates
from containers.ray_tracing.field import Axis, Field
from luxloop.errors import InputError
from luxloop.photometry import luminous_efficacy_lm_per_w

Real = NDArray[np.float64]
Points = tuple[tuple[float, float], ...]

LINE_POINTS = 401
CUT_POINTS = 401
"""Of the cut line that a step leaves; here, and not with `outcome`, for an auditor has no numba to trace with."""
AREA_POINTS, FEWEST_A_PITCH = 64, 8
"""Of the area, along an axis: where they tell the field's waves apart, and give each pitch so many; else more."""

_EDGE, _HALF = 0.8, 0.4
MEASUREMENT_POINTS: dict[int, Points] = {
    5: ((0.0, 0.0), *((x, y) for y in (-_EDGE, _EDGE) for x in (-_EDGE, _EDGE))),
    9: tuple((x, y) for y in (-_EDGE, 0.0, _EDGE) for x in (-_EDGE, 0.0, _EDGE)),
    13: (
        *((x, y) for y in (-_EDGE, 0.0, _EDGE) for x in (-_EDGE, 0.0, _EDGE)),
        *((x, y) for y in (-_HALF, _HALF) for x in (-_HALF, _HALF)),
    ),
    25: tuple((x, y) for y in (-_EDGE, -_HALF, 0.0, _HALF, _EDGE) for x in (-_EDGE, -_HALF, 0.0, _HALF, _EDGE)),
}
"""Where luminance is read, x and y in half widths of the area: this program's choice, since data sheets differ. The
outermost points lie 10 % of the width inside the edges; the 13 add the middles of the quadrants to the 9."""


@dataclass(frozen=True)
class Region:
    """Where a field is judged: the line of Eq. 8, the area, a chip's centre and the point between four chips.

    Attributes
    ----------
    line_um, line_y_um : x of the line's points, and its y.
    half_width_um : half widths (x, y) of the area about (0, 0).
    chip_um, gap_um : (x, y) of a chip's centre and of the point half a pitch from it in x and in y.
    periodic : the area is a whole period, its two edges are one.
    text : which line and area, for print.
    pitches : how many pitches (x, y) the chips take.
    """

    line_um: Real
    line_y_um: float
    half_width_um: tuple[float, float]
    chip_um: tuple[float, float]
    gap_um: tuple[float, float]
    periodic: bool
    text: str
    pitches: tuple[int, int] = (1, 1)

    def area_um(self, field: Field) -> tuple[Real, Real]:
        """x and y of the lines for a field: in a cell through chip and corners, in a module amid equal patches.

        Notes
        -----
        On lines as far apart as a wave is long that wave is constant, and would count as light. The 64 of a module
        lie at 64 / gcd(64, pitches) places of a pitch; where that is too few, a pitch has an odd number of its own,
        so that lines go through chips.
        """
        x, y = (
            self._across(half, pitches, axis)
            for half, pitches, axis in zip(self.half_width_um, self.pitches, (field.x, field.y), strict=True)
        )
        return x, y

    def _across(self, half_um: float, pitches: int, axis: Axis) -> Real:
        """The lines' places along an axis."""
        waves = half_um * float(axis.wavenumber_per_um.max()) / np.pi / pitches  # the shortest, in a pitch
        least, count = max(waves + 1e-6, FEWEST_A_PITCH), AREA_POINTS
        if count < pitches * FEWEST_A_PITCH or count // gcd(count, pitches) <= least:
            count = 2 * round(waves) + 2 if self.periodic else pitches * (int(least) + 1 | 1)
        across = (np.arange(count) + (0.0 if self.periodic else 0.5)) * 2.0 / count - 1.0
        return np.asarray(across * half_um)

    def measurement_points_um(self, count: int) -> Real:
        """Points (count, 2) at which 5, 9, 13 or 25 readings are taken, x before y."""
        return np.array(MEASUREMENT_POINTS[count]) * self.half_width_um


def cell_region(spacing_um: float) -> Region:
    """The cell of an endless array: the line y = 0 through the chips' centres over one whole pitch, 401 points."""
    half = spacing_um / 2.0
    return Region(
        np.linspace(-half, half, LINE_POINTS), 0.0, (half, half), (0.0, 0.0), (half, half), True,
        f"line through the chip centres, y = 0, over one pitch of {spacing_um:g} um; area: one pitch squared",
    )  # fmt: skip


def array_region(
    rows: int, columns: int, spacing_um: float, half_um: tuple[float, float] = (np.inf, np.inf)
) -> Region:
    """A finite array about (0, 0): the chip row nearest the centre, the middle half of its length, 401 points.

    Parameters
    ----------
    half_um : half widths (x, y) of the receiver; line, area and the point between chips end where it does.

    Notes
    -----
    With an odd number of rows that row is y = 0, else the one half a pitch above 0. The area is the whole array,
    columns x rows pitches; the chip is the one nearest the centre (above and right of it), and the point between
    chips lies below and left of that chip.
    """
    if rows < 1 or columns < 1 or not spacing_um > 0.0:
        raise InputError("array", (rows, columns, spacing_um), "1 or more rows and columns, a pitch above 0 um")
    patch = columns * spacing_um / 2.0, rows * spacing_um / 2.0
    area = min(patch[0], half_um[0]), min(patch[1], half_um[1])
    reach = min(patch[0] / 2.0, half_um[0])
    chip = tuple(0.0 if count % 2 else spacing_um / 2.0 for count in (columns, rows))
    gap = tuple(max(at - spacing_um / 2.0, -half) for at, half in zip(chip, half_um, strict=True))
    pitches = f"{columns} x {rows} pitches of {spacing_um:g} um"
    return Region(
        np.linspace(-reach, reach, LINE_POINTS), chip[1], area, (chip[0], chip[1]), (gap[0], gap[1]), False,
        f"chip row y = {chip[1]:g} um, |x| <= {reach:g} um; area: {pitches}"
        + ("" if area == patch else f", of which the receiver has {2 * area[0]:g} x {2 * area[1]:g} um"),
        (columns, rows),
    )  # fmt: skip


@dataclass(frozen=True)
class Metrics:
    """What is said of one field; `SENTENCES` explains each number."""

    uniformity: Estimate
    uniformity_2d: Estimate
    percentile_ratio: Estimate
    coefficient_of_variation: Estimate
    uniformity_5: Estimate
    uniformity_9: Estimate
    uniformity_13: Estimate
    uniformity_25: Estimate
    hot_spot_ratio: Estimate
    mean_illuminance_lx: Estimate
    optical_efficiency: Estimate | None
    region: str


SENTENCES = {
    "uniformity": "Smallest over largest illuminance on the line through the chips (Eq. 8).",
    "uniformity_2d": "Smallest over largest illuminance on 64 x 64 points of the area, or more.",
    "percentile_ratio": "1st over 99th percentile of the illuminance on the same points.",
    "coefficient_of_variation": "Standard deviation over mean of the illuminance on the same points.",
    "uniformity_5": "Smallest over largest of 5 readings: the centre, and four 10 % inside the edges.",
    "uniformity_9": "Smallest over largest of 9 readings: 3 x 3, the outer ones 10 % inside the edges.",
    "uniformity_13": "Smallest over largest of 13 readings: the 9, and the middles of the quadrants.",
    "uniformity_25": "Smallest over largest of 25 readings: 5 x 5, the outer ones 10 % inside the edges.",
    "hot_spot_ratio": "Illuminance above a chip's centre over that midway between four chips.",
    "mean_illuminance_lx": "Mean illuminance that arrives at the receiver over the area, lx.",
    "optical_efficiency": "Light that the receiver takes per light emitted, from the ledger.",
    "region": "The line and the area on which the numbers were found.",
}
"""What each number of `Metrics` is, in a sentence."""


def smallest_over_largest(values: Real) -> tuple[Real, Real]:
    """Minimum and maximum (draw,) of values (draw, ...)."""
    flat = values.reshape(len(values), -1)
    return flat.min(axis=1), flat.max(axis=1)


def percentile_1_over_99(values: Real) -> tuple[Real, Real]:
    """1st and 99th percentile (draw,) of values (draw, ...), the nearest rank that leaves 1 % beyond it."""
    flat = values.reshape(len(values), -1)
    low = int(0.01 * flat.shape[1])
    high = flat.shape[1] - 1 - low
    ranked = np.partition(flat, (low, high), axis=1)  # a third of the time of sorting, with numpy 2.4
    return ranked[:, low], ranked[:, high]


def deviation_over_mean(values: Real) -> tuple[Real, Real]:
    """Standard deviation and mean (draw,) of values (draw, ...)."""
    flat = values.reshape(len(values), -1)
    mean = flat.mean(axis=1)
    deviation = flat - mean[:, None]
    return np.sqrt(np.einsum("dp,dp->d", deviation, deviation) / flat.shape[1]), mean


def first_over_second(values: Real) -> tuple[Real, Real]:
    """The two columns of values (draw, 2)."""
    return values[:, 0], values[:, 1]


def uniformity(field: Field, region: Region) -> Estimate:
    """Eq. 8: smallest over largest illuminance on the region's line, bias taken off, with its standard error.

    Raises
    ------
    InputError : no light on the line, or a minimum below 0: too few histories to say anything.

    Notes
    -----
    benchmarks/uniformity_estimators.py, 600 tallies each of ten cases (ring; extrema at centre and corner; nearly
    flat; folded or not; standard errors of 0.5 to 2.2 points): the mean error is below 0.2 standard errors, and 94.5
    to 97.8 % of the 95 % intervals hold the truth. Where weights may have hidden relief the error says so and
    the runs are longer: what is measured of that is in docs/decisions/0025-relief-that-noise-hides.md.
    """
    lines = field.line(region.line_um, region.line_y_um)
    mean = lines.mean(axis=0)
    if not (mean.max() > 0.0 and mean.min() >= 0.0):
        raise InputError(
            "histories", field.histories, f"enough that no illuminance is below 0 (here {mean.min():.3g})",
            "more histories",
        )  # fmt: skip
    centre = field.denoised().line(region.line_um, region.line_y_um)[0]
    return _share(ratio_estimate(smallest_over_largest, lines, centre, field.truncation, field.hidden, field.unseen))


def metrics_of(
    field: Field,
    region: Region,
    *,
    flux_per_chip_w: float,
    peak_nm: float,
    fwhm_nm: float,
    optical_efficiency: Estimate | None = None,
) -> Metrics:
    """All numbers of a field.

    Parameters
    ----------
    field : of a periodic cell or a module.
    region : `cell_region` or `array_region`, to suit.
    flux_per_chip_w : radiant flux that one chip emits.
    peak_nm, fwhm_nm : its Gaussian spectrum.
    optical_efficiency : passed through from the ledger.

    Raises
    ------
    InputError : as `uniformity`.

    Notes
    -----
    Only Eq. 8 refuses a minimum below 0; the other uniformities are then given as 0, with their errors.
    """
    efficacy = luminous_efficacy_lm_per_w(peak_nm, fwhm_nm)
    points = {f"uniformity_{count}": _at_points(field, region, count) for count in MEASUREMENT_POINTS}
    hot_spot = _of_points(field, np.array([region.chip_um, region.gap_um]), first_over_second)
    return Metrics(
        uniformity=uniformity(field, region),
        **_of_area(field, region, flux_per_chip_w * efficacy * field.per_m2),
        **points,
        hot_spot_ratio=hot_spot,
        optical_efficiency=optical_efficiency,
        region=region.text,
    )


def _of_area(field: Field, region: Region, lx: float) -> dict[str, Estimate]:
    """The numbers of the area's points; `lx` is the illuminance where the field is 1."""
    x_um, y_um = region.area_um(field)
    ratios: dict[str, Ratio] = {
        "uniformity_2d": smallest_over_largest,
        "percentile_ratio": percentile_1_over_99,
        "coefficient_of_variation": deviation_over_mean,
    }
    maps = field.grid(x_um, y_um)
    found = ratio_estimates(
        ratios, maps, field.denoised().grid(x_um, y_um)[0], field.truncation, field.hidden, field.unseen
    )
    variation = found["coefficient_of_variation"]
    found = {name: _share(one) for name, one in found.items()}
    found["coefficient_of_variation"] = replace(variation, value=max(variation.value, 0.0))
    means = maps.mean(axis=(1, 2)) * lx
    error = float(means.std(ddof=1) / np.sqrt(field.groups))
    found["mean_illuminance_lx"] = Estimate(float(means.mean()), error, 0.0, field.groups)
    return found


def _at_points(field: Field, region: Region, count: int) -> Estimate:
    """Smallest over largest of some readings."""
    return _share(_of_points(field, region.measurement_points_um(count), smallest_over_largest))


def _of_points(field: Field, points_um: Real, ratio: Ratio) -> Estimate:
    """A ratio of the values at points (point, 2)."""
    centre = field.denoised().at(points_um)[0]
    return ratio_estimate(ratio, field.at(points_um), centre, field.truncation, field.hidden, field.unseen)


def _share(found: Estimate) -> Estimate:
    """A smallest over largest: where noise left it below 0 or above 1, it is 0 or 1."""
    return replace(found, value=min(max(found.value, 0.0), 1.0))
