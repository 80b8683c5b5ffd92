"""From noisy bins to a smooth field: the cosine series that light can have once it has crossed to the receiver.

A point of Lambertian light at height h below the receiver makes there E(r) = h^2 / (pi (r^2 + h^2)^2), whose Fourier
transform is x K1(x) with x = k h. What the bins hold beyond x = 10.65, where x K1(x) is 1e-4, is noise, and is left
out. Everything is linear in the bins, so the statistically independent groups of a tally pass through as a leading
axis, and the spread between them is the error of whatever is made of the field.

A field is a sum of products of functions along y and x, orthonormal over the box. In a periodic cell these are
1, sqrt2 cos(2 pi m x / S), sqrt2 sin(2 pi m x / S) about the chip's centre; in the finite box of a module they are
1, sqrt2 cos(pi a (x - x0) / L), which continue the box as its own mirror image and so make no jump at its edge. A
cell that is symmetric about its chip is such a box, a quarter as large.
A bin is the mean of the field over its width w, so mode k is divided by sinc(k w / 2 pi) in each direction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.checked import within
from luxloop.errors import InputError

Real = NDArray[np.float64]

CUTOFF = 1e-4
"""Amplitude x K1(x), of the mean, below which a mode is left out."""

CUTOFF_X = 10.652710526
"""Where x K1(x) falls to `CUTOFF`."""

FEWEST_MODES, MOST_MODES = 6, 64

NEARLY_ALL = 0.99
"""Of the noise: `hidden` from which on what is left of it tells too little of the error."""

TAPER_END = 1.3
"""A module's modes fade from 1 at the cut-off to 0 here, in units of the cut-off, as cos^2.

Measured on 1 to 25 Lambertian points, pitch 300 to 700 um, height 60 to 170 um, whose box ends at the module or up to
a pitch beyond: on the line through the chips a sharp cut errs by 0.06 to 0.3 %, this taper by up to 0.02 %, for 1.24
times the variance. Next to an edge that the light reaches the mirrored box errs by 2 % of the mean; padded with zeros
instead it would by 14 %.
"""

_T = np.linspace(0.0, 18.0, 361)
_COSH_T = np.cosh(_T)
_WEIGHT_T = np.where(_T == 0.0, 0.5, 1.0) * (_T[1] - _T[0]) * _COSH_T


def lambert_transform(x: ArrayLike) -> Real:
    """x K1(x), the Fourier amplitude at x = k h of a Lambertian point h below the receiver, in the shape of `x`.

    Parameters
    ----------
    x : array, any shape: wavenumber times height, 0 or from 1e-4 on; 1 at x = 0.

    Notes
    -----
    K1(x) = int_0^inf exp(-x cosh t) cosh t dt by the trapezoidal rule in steps of 0.05, which converges
    exponentially: 3e-14 of the value for x from 1e-4 to 200, 4e-6 at 600, where it is e^-600.
    """
    at = np.asarray(x, float)
    with np.errstate(under="ignore"):
        product: Real = np.atleast_1d(at) * (np.exp(-np.atleast_1d(at)[..., None] * _COSH_T) @ _WEIGHT_T)
    product[np.atleast_1d(at) == 0.0] = 1.0
    return product.reshape(at.shape)


def mode_count(height_um: float, spacing_um: float) -> int:
    """Highest cosine mode of a periodic cell that the receiver can show, 6 to 64.

    Parameters
    ----------
    height_um : from the chip's top to the receiver, D - T.
    spacing_um : the cell's width, the pitch S.

    Notes
    -----
    The smallest m with x K1(x) < 1e-4 at x = 2 pi (m + 1) height / S. Where 64 are not enough (a height below
    0.026 S) the field's `truncation` says what is missing.
    """
    _lengths(height_um=height_um, spacing_um=spacing_um)
    m = np.arange(FEWEST_MODES, MOST_MODES)
    too_few = lambert_transform(2.0 * np.pi * (m + 1) * height_um / spacing_um) >= CUTOFF
    return FEWEST_MODES + int(too_few.sum())


@dataclass(frozen=True)
class Axis:
    """One direction of a field: from where, how long, and the highest mode.

    `periodic`: a period, with cosines and sines. `even`: the upper half of a period that is its own mirror image
    about 0, cosines only. `box`: the same cosines, known between both ends only.
    """

    start_um: float
    length_um: float
    modes: int
    kind: Literal["periodic", "even", "box"]

    @property
    def wavenumber_per_um(self) -> Real:
        """Wavenumber (function,) of each function, rad/um; in a periodic axis the cosines, then the sines."""
        m = np.arange(self.modes + 1.0)
        return (
            2.0 * np.pi / self.length_um * np.r_[m, m[1:]] if self.kind == "periodic" else np.pi / self.length_um * m
        )

    @property
    def ends_um(self) -> tuple[float, float]:
        """Where the whole period, or the box, begins and ends."""
        end = self.start_um + self.length_um
        return (-end if self.kind == "even" else self.start_um), end

    def functions(self, at_um: ArrayLike) -> Real:
        """The functions (point, function) at places along the axis; InputError for places outside a box."""
        at, k = np.atleast_1d(np.asarray(at_um, float)), self.wavenumber_per_um
        if self.kind == "box":
            low, high = np.array(self.ends_um) + 1e-9 * self.length_um * np.array([-1.0, 1.0])
            within("place_um", at, low, high, "the field is known inside its box only")
        if self.kind == "periodic":
            phase = np.outer(at, k)
            cosine, sine = np.cos(phase[:, : self.modes + 1]), np.sin(phase[:, self.modes + 1 :])
            values: Real = np.sqrt(2.0) * np.concatenate([cosine, sine], axis=1)
        else:
            values = np.sqrt(2.0) * np.cos(np.outer(at - self.start_um, k))
        values[:, 0] = 1.0
        return values

    def analysis(self, bins: int) -> Real:
        """Matrix (bin, function) that takes bins to coefficients, the bin's window divided out."""
        window = np.sinc(self.wavenumber_per_um * self.length_um / bins / (2.0 * np.pi))
        matrix: Real = self.functions(_centres(self.start_um, self.start_um + self.length_um, bins)) / window / bins
        return matrix


@dataclass(frozen=True)
class Field:
    """A smooth map on the receiver, known once for each independent group; the estimate is the mean over groups.

    Attributes
    ----------
    coefficients : (group, function along y, function along x), in the field's unit.
    x, y : the axes.
    histories : histories of all groups together (of one chip, in a module).
    truncation : bound on what the modes left out add anywhere, in the field's unit.
    per_m2 : irradiance in W/m2 where the field is 1 and each chip emits 1 W.
    tallied_variance : (function along y, along x), variance of the mean of each coefficient as the bins gave it,
        before any weights; None where that is not known.
    """

    coefficients: Real
    x: Axis
    y: Axis
    histories: int
    truncation: float
    per_m2: float
    tallied_variance: Real | None = None

    def grid(self, x_um: ArrayLike, y_um: ArrayLike) -> Real:
        """Values (group, y, x) at every crossing of the given x and y, exactly from the series."""
        along_x = self.x.functions(x_um)
        return self.y.functions(y_um) @ (self.coefficients @ along_x.T)

    def line(self, x_um: ArrayLike, y_um: float = 0.0) -> Real:
        """Values (group, x) along the line y = `y_um`, exactly from the series (no bins beside the line)."""
        along_y = self.y.functions(y_um)[0] @ self.coefficients
        values: Real = along_y @ self.x.functions(x_um).T
        return values

    def at(self, points_um: ArrayLike) -> Real:
        """Values (group, point) at points (point, 2), x before y."""
        points = np.asarray(points_um, float).reshape(-1, 2)
        along_x = self.coefficients @ self.x.functions(points[:, 0]).T
        values: Real = np.einsum("py,gyp->gp", self.y.functions(points[:, 1]), along_x)
        return values

    def map(self, bins: int) -> Real:
        """Values (group, bins, bins) at the centres of equal bins over the whole box, row 0 at the lowest y."""
        return self.grid(_centres(*self.x.ends_um, bins), _centres(*self.y.ends_um, bins))

    def denoised(self) -> Self:
        """The mean field with the modes that noise made shrunk, as a field of one group: a centre for a bootstrap.

        Notes
        -----
        Modes of nearly equal |k| (rings one lowest wavenumber wide) share a factor max(0, 1 - noise / power), the
        James-Stein rule, where power is the sum of the squared means of the ring and noise the sum of their
        variances. Less rough than the mean; not unbiased, so no result is read from it.
        """
        mean = self.coefficients.mean(axis=0)
        k_x, k_y = self.x.wavenumber_per_um, self.y.wavenumber_per_um
        ring = np.rint(np.sqrt(np.add.outer(k_y**2, k_x**2)) / min(k_x[1], k_y[1])).astype(int)
        power, noise = np.bincount(ring.ravel(), mean.ravel() ** 2), np.bincount(ring.ravel(), self.variance.ravel())
        kept = beyond_noise(power, noise)
        kept[0] = 1.0
        return replace(self, coefficients=(mean * kept[ring])[None])

    @property
    def hidden(self) -> float:
        """Share of the noise, beside the mean's, that groups lost since the tally: 0 where none was, up to 1.

        Weights take it out; of a module what they err by themselves is put back (light.py).
        """
        if self.tallied_variance is None:
            return 0.0
        tallied, kept = self.tallied_variance.copy(), self.variance
        tallied[0, 0] = kept[0, 0] = 0.0
        return float(np.clip(1.0 - kept.sum() / tallied.sum(), 0.0, 1.0)) if tallied.any() else 0.0

    @property
    def unseen(self) -> float:
        """Relief, in means, that may lie in noise of which weights left next to none; 0 where they left 1 % or more.

        What is left then tells of no error: two places of the map may differ by what the tallied noise makes them.
        """
        nearly = (self.hidden - NEARLY_ALL) / (1.0 - NEARLY_ALL)
        if self.tallied_variance is None or nearly <= 0.0 or self.mean <= 0.0:
            return 0.0
        return nearly * float(np.sqrt(2.0 * (self.tallied_variance.sum() - self.tallied_variance[0, 0]))) / self.mean

    @property
    def variance(self) -> Real:
        """Of the mean over groups of each coefficient, (function along y, function along x)."""
        return _variance(self.coefficients)

    @property
    def groups(self) -> int:
        """Number of independent groups."""
        return len(self.coefficients)

    @property
    def nbytes(self) -> int:
        """In memory."""
        variance = 0 if self.tallied_variance is None else self.tallied_variance.nbytes
        return int(self.coefficients.nbytes + variance)

    @property
    def mean(self) -> float:
        """Mean over the box, in the field's unit: the light that landed, untouched by the filter."""
        return float(self.coefficients[:, 0, 0].mean())

    @property
    def mean_error(self) -> float:
        """Standard error of `mean`, from the spread between groups."""
        return float(self.coefficients[:, 0, 0].std(ddof=1) / np.sqrt(self.groups))


@dataclass(frozen=True)
class CellField(Field):
    """Relative illuminance of a periodic cell [-S/2, S/2]^2 about a chip: 1 where all emitted light lands once."""

    @property
    def spacing_um(self) -> float:
        """The pitch S."""
        low, high = self.x.ends_um
        return high - low

    @classmethod
    def from_bins(
        cls,
        bins: ArrayLike,
        histories: int,
        spacing_um: float,
        height_um: float,
        modes: int | None = None,
        *,
        folded: bool = False,
    ) -> Self:
        """The field of a tally's bins.

        Parameters
        ----------
        bins : (group, n, n) sums of landed weight over the whole cell, row 0 at the lowest y.
        histories : histories of each group.
        spacing_um : the pitch S, the width of the cell.
        height_um : from the chip's top to the receiver, D - T.
        modes : highest mode M; by default `mode_count(height_um, spacing_um)`.
        folded : the bins are exactly their own mirror images in x and in y, and a quarter of them tells all: the
            same field in less time.

        Raises
        ------
        InputError : no histories, lengths not above 0, bins that are not finite or of another shape, and fewer than
            2 M + 2 bins a side, which cannot tell the modes apart; bins called folded that are not.

        Notes
        -----
        Modes with m^2 + m'^2 <= (M + 1/2)^2 are kept: an amplitude depends on |k| alone, so the corners of the
        square hold noise only. `truncation` is the mean times the sum of x K1(x) over all modes left out, of either
        sign in both directions: what they would add if all were in phase, as they are above a point-like chip that
        sends all its light, Lambertian, from its top. A chip's width and light from lower down stay below that.
        """
        tally = _square(_tally(bins, histories))
        tally = _quarter(tally) if folded else tally
        return cls._of(tally, histories, spacing_um, height_um, modes, folded=folded)

    @classmethod
    def from_quarter(
        cls, bins: ArrayLike, histories: int, spacing_um: float, height_um: float, modes: int | None = None
    ) -> Self:
        """`from_bins` of a cell that equals its mirror images: bins (group, n / 2, n / 2) with x and y above 0."""
        return cls._of(_square(_tally(bins, histories)), histories, spacing_um, height_um, modes, folded=True)

    @classmethod
    def _of(
        cls, tally: Real, histories: int, spacing_um: float, height_um: float, modes: int | None, *, folded: bool
    ) -> Self:
        """The field of checked bins: of the whole cell, or folded, of its quarter."""
        M = mode_count(height_um, spacing_um) if modes is None else modes
        _lengths(height_um=height_um, spacing_um=spacing_um)
        if M < 1:
            raise InputError("modes", M, "1 or more", "leave it out to have it follow the design")
        half = spacing_um / 2.0
        axis = Axis(0.0, half, M, "even") if folded else Axis(-half, spacing_um, M, "periodic")
        scale = tally[0].size * (4 if folded else 1) / histories
        k = axis.wavenumber_per_um
        kept = np.add.outer(k**2, k**2) <= (2.0 * np.pi * (M + 0.5) / spacing_um) ** 2
        coefficients = _coefficients(tally, axis, axis, kept * scale)
        bound = float(coefficients[:, 0, 0].mean()) * _left_out(M, 2.0 * np.pi * height_um / spacing_um)
        return cls(
            coefficients, axis, axis, histories * len(tally), bound, 1e12 / spacing_um**2, _variance(coefficients)
        )


@dataclass(frozen=True)
class ModuleField(Field):
    """Irradiance over the finite box of a module, in 1/mm^2 per radiant flux emitted by one chip."""

    @classmethod
    def from_bins(
        cls, bins: ArrayLike, histories_per_chip: float, box_um: tuple[float, float, float, float], height_um: float
    ) -> Self:
        """The field of a tally's bins.

        Parameters
        ----------
        bins : (group, ny, nx) sums of landed weight over the box, row 0 at the lowest y.
        histories_per_chip : histories of one chip in each group.
        box_um : x0, x1, y0, y1 of the box. Light beyond it is unknown: reach at least half a pitch past the module,
            or end at the receiver's own edge.
        height_um : from the chips' top to the receiver, D - T.

        Raises
        ------
        InputError : no histories, an empty box, bins that are not finite, or too wide to resolve the cut-off.

        Notes
        -----
        Modes up to k = 10.65 / height are kept, and fade out up to `TAPER_END` times that. `truncation` is the sum
        of x K1(x) over what is left out, as an integral over k, for one chip: int x K1(x) k dk / 2 pi.
        """
        tally = _tally(bins, histories_per_chip)
        x0, x1, y0, y1 = box_um
        _lengths(box_width_um=x1 - x0, box_depth_um=y1 - y0, height_um=height_um)
        cutoff_per_um = CUTOFF_X / height_um
        last_per_um = TAPER_END * cutoff_per_um
        x, y = (Axis(a, b - a, int(last_per_um * (b - a) / np.pi), "box") for a, b in ((x0, x1), (y0, y1)))
        k = np.sqrt(np.add.outer(y.wavenumber_per_um**2, x.wavenumber_per_um**2))
        beyond = np.clip((k / cutoff_per_um - 1.0) / (TAPER_END - 1.0), 0.0, 1.0)
        bin_area_mm2 = 1e-6 * (x1 - x0) * (y1 - y0) / tally[0].size
        weight = np.cos(np.pi / 2.0 * beyond) ** 2 / (histories_per_chip * bin_area_mm2)
        coefficients = _coefficients(tally, x, y, weight)
        histories = round(histories_per_chip * len(tally))
        return cls(coefficients, x, y, histories, beyond_cutoff(height_um), 1e6, _variance(coefficients))


def beyond_cutoff(height_um: float, cutoff_x: float = CUTOFF_X) -> float:
    """What the waves of one chip beyond k = `cutoff_x` / height add anywhere at most, in 1/mm^2."""
    at = np.linspace(cutoff_x, cutoff_x + 30.0, 601)
    return float(np.sum(lambert_transform(at) * at) * 0.05 / (2.0 * np.pi)) / (1e-6 * height_um**2)


def beyond_noise(power: ArrayLike, noise: ArrayLike) -> Real:
    """Factors max(0, 1 - noise / power) that leave of each part what noise does not explain: the James-Stein rule."""
    whole = np.asarray(power, float)
    return np.clip(1.0 - np.asarray(noise, float) / np.where(whole > 0.0, whole, np.inf), 0.0, 1.0)


def _coefficients(values: Real, x: Axis, y: Axis, weight: Real) -> Real:
    """Coefficients (group, y function, x function) of bins (group, y, x), each times its weight."""
    groups, rows, columns = values.shape
    for axis, bins in ((y, rows), (x, columns)):
        needed = 2 * axis.modes + 2 if axis.kind == "periodic" else axis.modes + 1
        if bins < needed:
            raise InputError("bins", bins, f"at least {needed} along {axis.length_um:g} um", "use narrower bins")
    # one product over all rows of all groups: a stack of small products runs at half the speed
    along_x = (values.reshape(-1, columns) @ x.analysis(columns)).reshape(groups, rows, -1)
    found: Real = (np.ascontiguousarray(y.analysis(rows).T) @ along_x) * weight
    return found


def _variance(coefficients: Real) -> Real:
    """Variance of the mean over groups of each coefficient (y function, x function)."""
    return np.asarray(coefficients.var(axis=0, ddof=1) / len(coefficients))


def _quarter(tally: Real) -> Real:
    """The bins (group, n / 2, n / 2) with x and y above 0; InputError where the first group is not symmetric."""
    one, half = tally[0], len(tally[0]) // 2
    if len(one) % 2 or not (np.array_equal(one, one[::-1]) and np.array_equal(one, one[:, ::-1])):
        raise InputError("folded", True, "bins that equal their mirror images, an even number a side", "say False")
    return np.ascontiguousarray(tally[:, half:, half:])


def _centres(low: float, high: float, count: int) -> Real:
    """Centres (count,) of equal intervals."""
    return low + (np.arange(count) + 0.5) * (high - low) / count


@lru_cache(256)
def _left_out(modes: int, x_per_mode: float) -> float:
    """Sum of x K1(x) over the lattice of modes outside the disc; to 1e-4 of it, with many modes to 2 %."""
    reach = modes + 1 + int(np.ceil(12.0 / x_per_mode))
    if modes > 20:  # so dense a lattice that it is an integral over rings
        x = np.linspace((modes + 0.5) * x_per_mode, reach * x_per_mode, 401)
        return float(np.trapezoid(lambert_transform(x) * x, x) * 2.0 * np.pi / x_per_mode**2)
    m = np.arange(-reach, reach + 1)
    times = np.bincount(np.add.outer(m**2, m**2).ravel())
    squares = np.flatnonzero(times)
    squares = squares[(squares > (modes + 0.5) ** 2) & (squares <= reach**2)]
    return float(lambert_transform(np.sqrt(squares) * x_per_mode) @ times[squares])


def _tally(bins: ArrayLike, histories: float) -> Real:
    """Bins as (group, y, x), checked."""
    tally = np.asarray(bins, float)
    if tally.ndim != 3 or len(tally) < 2 or not tally.size:
        raise InputError("bins", tally.shape, "(group, y, x), two groups or more", "an error needs groups to compare")
    if not np.isfinite(tally.sum()):
        raise InputError("bins", "nan or infinite", "finite sums of weights", "the trace that filled them is broken")
    if histories <= 0:
        raise InputError("histories", histories, "1 or more histories a group", "trace some light first")
    return tally


def _square(tally: Real) -> Real:
    """A tally (group, n, n), checked."""
    if tally.shape[1] != tally.shape[2]:
        raise InputError("bins", tally.shape, "(group, n, n)", "as many rows as columns over the cell")
    return tally


def _lengths(**lengths_um: float) -> None:
    """InputError for a length that is not above 0."""
    for name, value in lengths_um.items():
        if not 0.0 < value < np.inf:
            raise InputError(name, value, "above 0 um", "the receiver lies above the chip's top")
