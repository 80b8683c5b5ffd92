"""The powers of a stack at so many wavelengths and nodes that neither the line nor the angles are undersampled.

Wavelengths. The line is sampled uniformly over peak +- 2.5 FWHM. A trapezoid sum of step h (in standard deviations)
errs by exp(-(2 pi / h - m phase)^2 / 2) on the m-th harmonic of a fringe whose phase turns by `phase` in one standard
deviation; at the start h leaves room for three harmonics of the stack's full optical path (without it the samples may
keep step with the fringes, as 61 of them do with those of 30 um of AlN, and nothing would show). From there on the
sum over all samples is held against that over every second one; where they differ by more than the tolerance, samples
are put between (2n - 1).

Nodes. The table is linear between nodes, in the place of `nodes.Axis`. Linear interpolation errs by f'' h^2 / 8, a
quarter of what a node differs from the line through its neighbours. Where this, times `MARGIN`, exceeds the tolerance
for a line-averaged power of one polarisation (T, R from both sides), the cell's parts are halved and the new nodes
held against their neighbours in turn, until none is above it.

Both end at the tolerance, or at `MAX_VALUES` wavelengths x nodes. What remains is returned with the values. It was
held against direct computation at random u (tests, and `benchmarks/film_tables.py`): it is an estimate, right within
a factor of 2 where the dips are resolved.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.compiled import kernel
from containers.reporting import Report, nothing
from containers.stack import StackRows, resolve
from containers.thin_film import lossless
from containers.thin_film.nodes import Axis, first_axis
from containers.thin_film.transfer_matrix import solve
from luxloop.errors import InputError
from luxloop.film import HALF_SPAN_FWHM, MAX_VALUES, Grid, Spectrum
from luxloop.stack import Stack

Real = NDArray[np.float64]
Single = NDArray[np.float32]
Floats = NDArray[Any]
LOSSES = ("S_R", "S_T", "A")
LOSS_NAMES = tuple(f"{name}_{side}" for side in ("inside", "outside") for name in LOSSES)
FWHM_TO_SIGMA = 1.0 / (2.0 * np.sqrt(2.0 * np.log(2.0)))
MAX_HALF_SPACE_K = 0.01
MARGIN = 1.5
"""For stacks that absorb or scatter: their dips bend more between the nodes than at them.

Of 200 random stacks 9 err by more than is stated with 1.0, one of them 2.7 times; with 1.5 three, by up to 1.6.
"""
_HARMONICS = 3
_TAIL_RAD = 6.0  # exp(-6^2 / 2) = 1.5e-8
_BLOCK = 100_000  # wavelengths x nodes that are worked on at a time


@dataclass(frozen=True)
class Samples:
    """Powers of a stack, every array (..., wavelength, polarisation, node)."""

    rows: StackRows
    weight: Real
    """(wavelength,), spectral weights of sum 1."""
    axis: Axis
    T: Real
    """(wavelength, polarisation, node)"""
    lost: Single
    """(loss, wavelength, polarisation, node), losses as in `LOSS_NAMES`; (0, ...) for a smooth, lossless stack."""
    excess: float

    @property
    def values(self) -> int:
        """Wavelengths x nodes."""
        return int(self.T.shape[0] * self.T.shape[2])


@dataclass(frozen=True)
class Errors:
    """The largest errors that remain, as power ratios."""

    average_ratio: float
    """Of the line average of one polarisation: of the nodes or of the wavelengths, whichever is larger."""
    single_ratio: float
    """Of one wavelength and polarisation between the nodes. Above 0.05 dips are missed, and it is a lower bound."""


def refined(stack: Stack, spectrum: Spectrum, grid: Grid, report: Report = nothing) -> tuple[Samples, Errors]:
    """The powers of a coherent stack, and how far a table of them is wrong; scheme: at the head of this module.

    Parameters
    ----------
    report : called before each pass, and within it before each block.

    Raises
    ------
    InputError as `table.film_table`; what the report raises.
    """
    samples, resolved = _start(stack, spectrum, grid, report)
    margin = MARGIN if len(samples.lost) else 1.0
    while True:
        report()
        mean = _compared(samples, samples.weight)
        line = _line_error(samples, mean) if resolved else _spread(samples)
        if line > grid.tolerance_ratio and resolved and 2 * samples.values <= MAX_VALUES:
            samples = _finer_line(samples, stack, spectrum, report)
            continue
        parts = interpolation_error(mean, samples.axis) * margin
        cells = np.maximum.reduceat(parts, samples.axis.first[:-1])
        split = _worst_that_fit(cells, samples, grid.tolerance_ratio)
        if not split.any():
            return samples, Errors(max(line, float(cells.max())), margin * _single_error(samples))
        samples = _finer_nodes(samples, split, report)


def sampled(spectrum: Spectrum, wavelengths: int) -> tuple[Real, Real]:
    """Wavelengths (nm) uniform over peak +- 2.5 FWHM, and Gaussian weights of sum 1; one: the peak alone."""
    if wavelengths == 1:
        return np.array([spectrum.peak_nm]), np.ones(1)
    half = HALF_SPAN_FWHM * spectrum.fwhm_nm
    wavelength = np.linspace(spectrum.peak_nm - half, spectrum.peak_nm + half, wavelengths)
    weight = np.exp(-0.5 * ((wavelength - spectrum.peak_nm) / (spectrum.fwhm_nm * FWHM_TO_SIGMA)) ** 2)
    return wavelength, weight / weight.sum()


def _start(stack: Stack, spectrum: Spectrum, grid: Grid, report: Report) -> tuple[Samples, bool]:
    """Enough wavelengths for the optical path, enough nodes for the phase; whether the wavelengths fitted."""
    wavelength, weight = sampled(spectrum, grid.wavelengths)
    rows = _bulk_without_k(resolve(stack, wavelength))
    wavelengths = grid.wavelengths
    needed = _needed_wavelengths(rows, spectrum) if wavelengths > 1 else 1
    most = MAX_VALUES // (grid.shared_nodes + grid.dense_nodes)
    while wavelengths < needed and 2 * wavelengths - 1 <= most:
        wavelengths = 2 * wavelengths - 1
    if wavelengths > grid.wavelengths:
        wavelength, weight = sampled(spectrum, wavelengths)
        rows = _bulk_without_k(resolve(stack, wavelength))
    axis = first_axis(rows, grid, int(np.argmax(weight)), MAX_VALUES // wavelengths)
    samples = Samples(rows, weight, axis, *_powers(rows, axis.u, lossless.applies(rows), report))
    return samples, wavelengths >= needed


def _needed_wavelengths(rows: StackRows, spectrum: Spectrum) -> int:
    """How many samples of the line leave room for the harmonics of the stack's fringes."""
    path_nm = float((rows.index[:, 1:-1].real * rows.thickness_nm).sum(axis=1).max())
    phase = 4.0 * np.pi * path_nm * spectrum.fwhm_nm * FWHM_TO_SIGMA / spectrum.peak_nm**2
    span = 2.0 * HALF_SPAN_FWHM / FWHM_TO_SIGMA
    return 1 + int(np.ceil(span * (_TAIL_RAD + _HARMONICS * phase) / (2.0 * np.pi)))


def _bulk_without_k(rows: StackRows) -> StackRows:
    for side, column in (("inside", 0), ("outside", -1)):
        k = float(rows.index[:, column].imag.max())
        if k > MAX_HALF_SPACE_K:
            raise InputError(side, f"k = {k:g}", f"k up to {MAX_HALF_SPACE_K:g} in a table", "make it a thick layer")
    if not rows.coherent.all():
        raise InputError("coherent", False, "coherent layers in a table", "use the incoherent film measurement")
    index = rows.index.copy()
    index[:, [0, -1]] = index[:, [0, -1]].real
    return replace(rows, index=index)


def _finer_line(samples: Samples, stack: Stack, spectrum: Spectrum, report: Report) -> Samples:
    """With a wavelength between every two."""
    wavelength, weight = sampled(spectrum, 2 * samples.weight.size - 1)
    rows = _bulk_without_k(resolve(stack, wavelength))
    between = replace(rows, wavelength_nm=rows.wavelength_nm[1::2], index=rows.index[1::2])
    T, lost, excess = _powers(between, samples.axis.u, not len(samples.lost), report)
    new = np.arange(wavelength.size) % 2 == 1
    T, lost = _merged(samples.T, T, new, 0), _merged(samples.lost, lost, new, 1)
    return Samples(rows, weight, samples.axis, T, lost, max(samples.excess, excess))


def _finer_nodes(samples: Samples, split: NDArray[np.bool_], report: Report) -> Samples:
    """With the parts of some cells (cell,) halved."""
    axis = samples.axis.split(split)
    new = ~np.isin(axis.place, samples.axis.place)  # fractions of two: equal or not
    T, lost, excess = _powers(samples.rows, axis.u[new], not len(samples.lost), report)
    T, lost = _merged(samples.T, T, new, -1), _merged(samples.lost, lost, new, -1)
    return replace(samples, axis=axis, T=T, lost=lost, excess=max(samples.excess, excess))


def _merged(old: Floats, new: Floats, is_new: NDArray[np.bool_], axis: int) -> Floats:
    """Old and new values put among each other along an axis."""
    shape = list(old.shape)
    shape[axis] = is_new.size
    both = np.empty_like(old, shape=shape)
    view = np.moveaxis(both, axis, 0)
    view[is_new], view[~is_new] = np.moveaxis(new, axis, 0), np.moveaxis(old, axis, 0)
    return both


def _powers(rows: StackRows, u: Real, smooth: bool, report: Report) -> tuple[Real, Single, float]:
    """T (wavelength, polarisation, u), the losses (6 or 0, ...), and the excess, block by block."""
    if smooth:
        T = np.zeros((rows.wavelength_nm.size, 2, u.size))
        lit = int(np.searchsorted(u, rows.index[:, [0, -1]].real.min(axis=1).max()))
        np.subtract(1.0, lossless.stack_reflectance(rows, u[:lit]), out=T[..., :lit])
        return T, np.empty((0, *T.shape), np.float32), 0.0
    T = np.empty((rows.wavelength_nm.size, 2, u.size))
    lost, excess = np.empty((len(LOSS_NAMES), *T.shape), np.float32), 0.0
    width = max(1, _BLOCK // rows.wavelength_nm.size)
    for block in (slice(a, a + width) for a in range(0, u.size, width)):
        report()
        response = solve(rows.index, rows.thickness_nm, rows.roughness_nm, rows.wavelength_nm, u[block])
        T[..., block] = np.minimum(response.T_inside, response.T_outside)
        for number, name in enumerate(LOSS_NAMES):
            lost[number][..., block] = _rounded_down(getattr(response, name))
        excess = max(excess, response.excess)
    return T, lost, excess


def _rounded_down(values: Real) -> Single:
    """The next float32 that is not above, so that the remainder R cannot become negative."""
    single = values.astype(np.float32)
    return np.where(single > values, np.nextafter(single, np.float32(0.0)), single)


def _compared(samples: Samples, weight: Real, step: int = 1) -> Real:
    """Line averages whose error counts, (power, polarisation, node): T and, unless it is 1 - T, R from both sides."""
    T = np.tensordot(weight, samples.T[::step], axes=1)[None]
    if not len(samples.lost):
        return T
    lost = np.stack([np.tensordot(weight, loss[::step], axes=1) for loss in samples.lost])
    return np.concatenate([T, 1.0 - T - lost[:3].sum(axis=0), 1.0 - T - lost[3:].sum(axis=0)])


def _line_error(samples: Samples, mean: Real) -> float:
    """By how much the average over every second wavelength differs."""
    if samples.weight.size == 1:
        return 0.0
    weight = samples.weight[::2] / samples.weight[::2].sum()
    return float(np.abs(_compared(samples, weight, step=2) - mean).max())


def _spread(samples: Samples) -> float:
    """The most that an average over unresolved fringes can be wrong: by all that the powers vary along the line."""
    low, high = np.inf, -np.inf
    for powers in _each_wavelength(samples):
        low, high = np.minimum(low, powers.min(axis=1)), np.maximum(high, powers.max(axis=1))
    return float(np.max(high - low))


def _single_error(samples: Samples) -> float:
    return max(float(interpolation_error(powers, samples.axis).max()) for powers in _each_wavelength(samples))


def _each_wavelength(samples: Samples) -> Iterator[Real]:
    """The powers of `_compared` without the average, (power, some wavelengths, polarisation, node)."""
    width = max(1, _BLOCK // samples.T.shape[2])
    for start in range(0, samples.weight.size, width):
        T, lost = samples.T[start : start + width], samples.lost[:, start : start + width]
        if not len(lost):
            yield T[None]
        else:
            yield np.stack([T, 1.0 - T - lost[:3].sum(axis=0), 1.0 - T - lost[3:].sum(axis=0)])


def interpolation_error(values: Real, axis: Axis) -> Real:
    """(part,), largest |f''| h^2 / 8 of values (..., node), f'' the larger of both ends of a part.

    At a break the scale of the axis changes: a change of slope is no curvature there.
    """
    h = np.diff(axis.place)
    curved = 2.0 / (h[1:] + h[:-1])
    curved[axis.break_nodes[axis.break_nodes < h.size] - 1] = 0.0
    bend = np.zeros(axis.place.size)
    _bends(np.ascontiguousarray(values).reshape(-1, bend.size), curved / h[:-1], curved / h[1:], bend)
    return np.asarray(np.maximum(bend[1:], bend[:-1]) * h**2 / 8.0)


@kernel
def _bends(values: Real, before: Real, after: Real, bend: Real) -> None:
    """Raise `bend` (node,) to |f''| at the inner nodes of values (row, node)."""
    for row in range(values.shape[0]):
        f = values[row]
        for i in range(before.size):
            second = after[i] * (f[i + 2] - f[i + 1]) - before[i] * (f[i + 1] - f[i])
            bend[i + 1] = max(bend[i + 1], abs(second))


def _worst_that_fit(cells: Real, samples: Samples, tolerance: float) -> NDArray[np.bool_]:
    """Which cells (cell,) are to be split: those above the tolerance, the worst first, as far as there is room."""
    order = np.argsort(-cells)
    order = order[cells[order] > tolerance]
    room = MAX_VALUES // samples.weight.size - samples.T.shape[2]
    split = np.zeros(cells.size, bool)
    split[order[np.cumsum(samples.axis.parts[order]) <= room]] = True
    return split
