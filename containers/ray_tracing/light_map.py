"""A map of irradiance on the receiver, and its exact mean over squares: what lies between the samples.

Interpolation: cubic B-spline through the samples. It takes cubics as they are, errs by (k h)^4 / 720 for a wave k at
the step h, and is C2, so that the mean over a pixel is C3 in all that moves or scales pixels. (A local cubic with as
many taps is C1 and errs more; a bilinear one has a broken derivative.) Integrals over pixels are those of the spline.
Beyond its area, half a step around its samples, a map is continued as its own mirror image, or is dark.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from containers.checked import reals, within
from containers.compiled import kernel
from luxloop.errors import InputError

Real = NDArray[np.float64]

POLE = float(np.sqrt(3.0)) - 2.0
"""Of the recursive filter that turns samples into coefficients of a cubic B-spline."""
POLE_TERMS = 30  # POLE^30 = 7e-18
NODES_PER_SD, NODES_BEYOND = 8, 12
"""Of the coarser grid for light that was spread widely: twelve nodes on, the grid's own edge is felt by 1e-7."""


@dataclass(frozen=True, eq=False)
class LightMap:
    """Irradiance on the receiver at the points of a regular grid: smooth samples, not means over bins.

    irradiance_per_mm2 : (..., y, x), row 0 at the lowest y. origin_um : (x, y) of its first sample, relative to the
    module's centre. step_um : distance of samples along both axes. beyond : what is assumed outside of the area that
    reaches half a step beyond the outer samples: its mirror image (periodic cells, cut-outs of larger modules) or no
    light (finite modules with an open edge; the spline then falls to zero over the two steps on either side of it).
    """

    irradiance_per_mm2: Real
    origin_um: tuple[float, float]
    step_um: float
    beyond: Literal["mirror", "dark"] = "mirror"

    def __post_init__(self) -> None:
        """Refuse what is no map: wrong shape, NaN, a step of zero."""
        values = reals("irradiance_per_mm2", self.irradiance_per_mm2, "an array (..., y, x)")
        if values.ndim < 2 or min(values.shape[-2:]) < 2:
            raise InputError("irradiance_per_mm2", values.shape, "(..., y, x), two samples or more along y and x")
        if not np.isfinite(values).all():
            raise InputError("irradiance_per_mm2", float(values[~np.isfinite(values)][0]), "finite numbers")
        within("step_um", self.step_um, 0.0, 1000.0, "the distance of samples in um", above=True)
        within("origin_um", self.origin_um, -1e7, 1e7, "x and y of the first sample in um")
        if self.beyond not in ("mirror", "dark"):
            raise InputError("beyond", self.beyond, '"mirror" or "dark"')
        object.__setattr__(self, "irradiance_per_mm2", values)

    def area_um(self) -> tuple[float, float, float, float]:
        """The area covered, x0, x1, y0, y1."""
        (rows, columns), h = self.irradiance_per_mm2.shape[-2:], self.step_um
        x0, y0 = (start - h / 2 for start in self.origin_um)
        return x0, x0 + columns * h, y0, y0 + rows * h


def spline_of(light: LightMap) -> Real:
    """Coefficients (map, y, x) of the cubic B-spline through the samples, mirrored at the edge of the area.

    Notes
    -----
    E(x, y) = sum c_ji b(x - i) b(y - j) in steps; the two recursions are those of Unser, Aldroubi, Eden, IEEE Trans.
    Signal Process. 41, 821 (1993), with half-sample symmetry.
    """
    values = light.irradiance_per_mm2
    coefficients = np.array(values.reshape(-1, *values.shape[-2:]), order="C")
    _to_coefficients(coefficients)
    return coefficients


def pixel_means(light: LightMap, spline: Real, x_um: Real, y_um: Real, side_um: Real) -> Real:
    """Means of the spline over squares (..., row, column) about the points x_um, y_um (row, column).

    Notes
    -----
    The integral over a square with sides along the map's axes is exact. A pixel of side w turned by t against them
    differs from it by at most (w k)^4 sin^2(2 t) / 5760 of a wave k: 7e-7 at 45 deg for 8 um and a period of 0.2 mm.
    """
    x0, y0 = light.origin_um
    inverse = 1.0 / light.step_um
    means = np.empty((spline.shape[0], *x_um.shape))
    mirror = light.beyond == "mirror"
    _means(spline, (x_um - x0) * inverse, (y_um - y0) * inverse, side_um * inverse, mirror, means)
    return means.reshape(*light.irradiance_per_mm2.shape[:-2], *x_um.shape)


def square_means(light: LightMap, side_um: float) -> LightMap:
    """The map of the spline's means over squares of that side about each sample; of a dark map also about those
    beyond it whose squares reach its area."""
    side = side_um / light.step_um
    weight = np.empty(int(np.ceil(side)) + 5)
    first, taps = _weights(-0.5 * side, 0.5 * side, 1.0 / side, weight)
    beyond = 0 if light.beyond == "mirror" else -first
    spline = spline_of(light)
    for axis in (1, 2):
        around = [(0, 0)] * 3
        around[axis] = (beyond - first, beyond + first + taps - 1)
        seen = np.pad(spline, around, "symmetric" if light.beyond == "mirror" else "constant")
        size = spline.shape[axis] + 2 * beyond
        spline = sum(weight[tap] * seen.take(np.arange(tap, tap + size), axis) for tap in range(taps))
    means = spline.reshape(*light.irradiance_per_mm2.shape[:-2], *spline.shape[1:])
    x0, y0 = (start - beyond * light.step_um for start in light.origin_um)
    return LightMap(means, (x0, y0), light.step_um, light.beyond)


def spread(light: LightMap, sd_um: float) -> LightMap:
    """`light` convolved with a Gaussian, on a coarser grid around its area: eight points per standard deviation.

    A cubic spline through these errs by 4e-6 of it. InputError where sd is less than the map's own step.
    """
    if light.step_um > sd_um:
        raise InputError("step_um", light.step_um, f"up to the standard deviation, {sd_um:g} um", "a finer map")
    rows, columns = light.irradiance_per_mm2.shape[-2:]
    mirror = light.beyond == "mirror"
    along_y, along_x = (_spreading(n, light.step_um, sd_um, mirror) for n in (rows, columns))
    step = sd_um / NODES_PER_SD
    x0, _, y0, _ = light.area_um()
    origin = x0 - NODES_BEYOND * step, y0 - NODES_BEYOND * step
    return LightMap(along_y @ light.irradiance_per_mm2 @ along_x.T, origin, step, "mirror")


@lru_cache(maxsize=16)
def _spreading(samples: int, step_um: float, sd_um: float, mirror: bool) -> Real:
    """Matrix (node, sample) of the convolution along one axis; nodes begin before the area and end beyond it."""
    node_um = sd_um / NODES_PER_SD
    nodes = int(np.ceil(samples * step_um / node_um)) + 2 * NODES_BEYOND + 1
    node = (np.arange(nodes) - NODES_BEYOND) * node_um
    x = (np.arange(samples) + 0.5) * step_um
    weight = np.zeros((nodes, samples))
    period = 2 * samples * step_um
    copies = int(np.ceil((10.0 + NODES_BEYOND / NODES_PER_SD) * sd_um / period)) + 1 if mirror else 0
    for copy in range(-copies, copies + 1):
        for image in (x, -x) if mirror else (x,):
            weight += np.exp(-0.5 * ((node[:, None] - image - copy * period) / sd_um) ** 2)
    weight *= step_um / (sd_um * np.sqrt(2.0 * np.pi))
    weight.setflags(write=False)
    return weight


@kernel
def _to_coefficients(c: Real) -> None:
    """Replace samples (map, y, x) by coefficients: rows first along y, all x at once, then along x."""
    maps, rows, columns = c.shape
    for m in range(maps):
        for i in range(columns):
            c[m, 0, i] = _first(c[m, :, i])
        for j in range(1, rows):
            for i in range(columns):
                c[m, j, i] = 6.0 * c[m, j, i] + POLE * c[m, j - 1, i]
        for i in range(columns):
            c[m, rows - 1, i] *= POLE / (POLE - 1.0)
        for j in range(rows - 2, -1, -1):
            for i in range(columns):
                c[m, j, i] = POLE * (c[m, j + 1, i] - c[m, j, i])
        for j in range(rows):
            row = c[m, j]
            row[0] = _first(row)
            for i in range(1, columns):
                row[i] = 6.0 * row[i] + POLE * row[i - 1]
            row[columns - 1] *= POLE / (POLE - 1.0)
            for i in range(columns - 2, -1, -1):
                row[i] = POLE * (row[i + 1] - row[i])


@kernel
def _first(samples: Real) -> float:
    """First value of the forward recursion: the sum over the mirrored samples before it."""
    total, power = samples[0], POLE
    for k in range(POLE_TERMS):
        total += power * samples[mirrored(-1 - k, samples.size)]
        power *= POLE
    return 6.0 * float(total)


@kernel
def mirrored(j: int, n: int) -> int:
    """The sample that stands at j, in a row of n that is repeated as its own mirror image."""
    j %= 2 * n
    return j if j < n else 2 * n - 1 - j


@kernel
def _means(c: Real, x: Real, y: Real, side: Real, mirror: bool, means: Real) -> None:
    """Fill `means` (map, row, column): the weights of a pixel's taps are worked out once and used for all maps."""
    taps = int(np.ceil(side.max())) + 5
    wx, wy = np.empty(taps), np.empty(taps)
    for row in range(x.shape[0]):
        for column in range(x.shape[1]):
            half, per_side = 0.5 * side[row, column], 1.0 / side[row, column]
            i, nx = _weights(x[row, column] - half, x[row, column] + half, per_side, wx)
            j, ny = _weights(y[row, column] - half, y[row, column] + half, per_side, wy)
            inside = i >= 0 and j >= 0 and i + nx <= c.shape[2] and j + ny <= c.shape[1]
            for m in range(c.shape[0]):
                if inside:
                    means[m, row, column] = _sum(c, m, i, j, nx, ny, wx, wy)
                else:
                    means[m, row, column] = _sum_at_edge(c, m, i, j, nx, ny, wx, wy, mirror)


@kernel
def _sum(c: Real, m: int, i0: int, j0: int, nx: int, ny: int, wx: Real, wy: Real) -> float:
    """Weighted sum of the coefficients of map m from column i0 and row j0 on."""
    total = 0.0
    for j in range(ny):
        of_row = 0.0
        for i in range(nx):
            of_row += wx[i] * c[m, j0 + j, i0 + i]
        total += wy[j] * of_row
    return total


@kernel
def _sum_at_edge(c: Real, m: int, i0: int, j0: int, nx: int, ny: int, wx: Real, wy: Real, mirror: bool) -> float:
    """The same where taps stand beyond the map: mirrored, or nothing."""
    rows, columns = c.shape[1:]
    total = 0.0
    for j in range(ny):
        for i in range(nx):
            if mirror or (0 <= j0 + j < rows and 0 <= i0 + i < columns):
                total += wy[j] * wx[i] * c[m, mirrored(j0 + j, rows), mirrored(i0 + i, columns)]
    return total


@kernel
def _weights(a: float, b: float, per_side: float, weight: Real) -> tuple[int, int]:
    """First tap and count of taps of the mean from a to b, in steps; fills their weights; per_side = 1 / (b - a).

    What of a tap's B-spline lies below the upper end, less what lies below the lower end.
    """
    below_a, below_b = np.floor(a), np.floor(b)
    n = int(below_b - below_a)
    for tap in range(n):
        weight[tap] = per_side
    first, second, third, fourth = _shares_below(b - below_b)
    weight[n], weight[n + 1], weight[n + 2], weight[n + 3] = (
        first * per_side, second * per_side, third * per_side, fourth * per_side,
    )  # fmt: skip
    first, second, third, fourth = _shares_below(a - below_a)
    weight[0] -= first * per_side
    weight[1] -= second * per_side
    weight[2] -= third * per_side
    weight[3] -= fourth * per_side
    return int(below_a) - 1, n + 4


@kernel
def _shares_below(t: float) -> tuple[float, float, float, float]:
    """Of the B-splines of the four nodes -1, 0, 1, 2 the parts of their areas that lie below t, 0 <= t <= 1."""
    s = 1.0 - t
    t2, s2 = t * t, s * s
    inner = t * (2.0 / 3.0 + t2 * (t / 8.0 - 1.0 / 3.0))
    outer = s * (2.0 / 3.0 + s2 * (s / 8.0 - 1.0 / 3.0))
    return 1.0 - s2 * s2 / 24.0, 0.5 + inner, 0.5 - outer, t2 * t2 / 24.0
