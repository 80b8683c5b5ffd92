"""What a spectrometer or an ellipsometer would read of a stack: R, T, psi, delta against wavelength and angle.

The stack is a `Stack` of named or fixed media, or any function that gives its rows for an array of wavelengths: that
is how `interlayer` adds a mixed layer and how a fit varies a dispersion formula.

Light of finite bandwidth. The instrument's line is a Gaussian of full width `bandwidth_nm` in wavelength; lamp and
detector are flat over it. What it averages are the intensities: R, T, and for an ellipsometer |r_s|^2, |r_p|^2 and
r_p conj(r_s) (Mueller elements), from which N, C, S, and then psi and delta follow. The average is a trapezoid sum
over +-5 standard deviations, dense enough for the narrowest fringe of the coherent layers and doubled until half of
its terms say the same: it errs by less than 2e-6 in R for films of 0.1 to 200 um on silicon and lines of 1 to 10 nm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.checked import wavelengths_nm, within
from containers.mixing import with_interlayer
from containers.reporting import Report, nothing
from containers.stack import StackRows, resolve
from containers.thin_film.ellipsometry import ncs_of_light, psi_delta_deg
from containers.thin_film.incoherent import Light, flipped, respond
from luxloop.errors import InputError
from luxloop.film import GRAZING_DEG
from luxloop.stack import Stack

Real = NDArray[np.float64]
RowsAt = Callable[[Real], StackRows]
"""The rows of a stack for an array of vacuum wavelengths in nm."""
Spot = tuple[tuple[float, Stack | RowsAt], ...]
"""Shares of the measured spot, of sum 1, and what lies there."""

Quantity = Literal["R", "T", "psi", "delta"]
Polarisation = Literal["s", "p", "u"]
Side = Literal["outside", "inside"]

FWHM_PER_SIGMA = 2.3548200450309493
LIGHT = ("R", "T", "ps")
"""What `Light` holds."""
LINE_SIGMAS = 5.0
"""The instrument's line is cut here: 6e-7 of its area lies beyond."""

MAX_LINE_NODES = 4001
HALVES_DIFFER = 1e-3

BLOCK = 100_000
"""Wavelengths x angles that are worked on at a time."""
HELD_BYTES = 256 << 20
"""Of the light at a line's wavelengths, for when more are put between them; what is beyond is computed again."""


def measure(
    stack: Stack | RowsAt | Spot,
    quantity: Quantity,
    wavelength_nm: ArrayLike,
    aoi_deg: ArrayLike,
    polarisation: Polarisation = "u",
    bandwidth_nm: float = 0.0,
    from_side: Side = "outside",
    report: Report = nothing,
) -> Real:
    """R or T (share of the incident power), psi or delta (degrees) as (wavelength, aoi).

    Parameters
    ----------
    stack : what is measured, from the bulk outwards; layers that are not coherent add powers. Or what lies in the
        spot, with the share of each: their intensities are added.
    quantity : "R", "T", "psi" in [0, 90] or "delta" in [0, 360); signs at the head of `ellipsometry`.
    wavelength_nm : (wavelength,), in vacuum.
    aoi_deg : (aoi,), angle of incidence in the medium that the light comes from, 0 <= aoi < 90.
    polarisation : "s", "p" or "u" = unpolarised, the mean of both; "u" for psi and delta, which need both.
    bandwidth_nm : full width at half maximum of the instrument's line, 0 = monochromatic.
    from_side : "outside" (air of a chip, where an instrument stands) or "inside".
    report : called before each block of each wavelength of the line; what it raises ends the measurement.

    Raises
    ------
    InputError for a value out of range; for psi and delta out of an absorbing medium of incidence, where incident and
    reflected waves are not separate beams.

    Notes
    -----
    R and T are specular: with rough faces what is missing is scattered. Out of an absorbing medium R = |r|^2 at the
    first face and u = Re(n) sin(aoi). Where nothing is reflected psi and delta are nan.
    """
    _one_of("quantity", quantity, Quantity)
    _one_of("polarisation", polarisation, Polarisation)
    if quantity in ("psi", "delta"):
        if polarisation != "u":
            raise InputError("polarisation", polarisation, "'u' for psi and delta", "leave it out: both are needed")
        psi, delta = psi_delta_deg(measure_ncs(stack, wavelength_nm, aoi_deg, bandwidth_nm, from_side, report))
        return psi if quantity == "psi" else delta
    light = _light(stack, wavelength_nm, aoi_deg, bandwidth_nm, from_side, report)
    power = light.R if quantity == "R" else light.T
    mean: Real = power.mean(axis=1)
    return mean if polarisation == "u" else power[:, "sp".index(polarisation)]


def measure_ncs(
    stack: Stack | RowsAt | Spot,
    wavelength_nm: ArrayLike,
    aoi_deg: ArrayLike,
    bandwidth_nm: float = 0.0,
    from_side: Side = "outside",
    report: Report = nothing,
) -> Real:
    """N, C, S of the reflected light as (3, wavelength, aoi); parameters and errors as those of `measure`."""
    return ncs_of_light(_light(stack, wavelength_nm, aoi_deg, bandwidth_nm, from_side, report, ellipsometry=True))


def interlayer(stack: Stack | RowsAt, face: int, thickness_nm: float, share_outer: float = 0.5) -> RowsAt:
    """The stack with a mixed layer at one face (`mixing.with_interlayer`), to be handed in again for another face."""
    rows_at = rows_function(stack)
    return lambda wavelength_nm: with_interlayer(rows_at(wavelength_nm), face, thickness_nm, share_outer)


def _light(
    stack: Stack | RowsAt | Spot,
    wavelength_nm: ArrayLike,
    aoi_deg: ArrayLike,
    bandwidth_nm: float,
    from_side: Side,
    report: Report,
    ellipsometry: bool = False,
) -> Light:
    """The instrument's average of the intensities."""
    if isinstance(stack, tuple):
        asked = wavelength_nm, aoi_deg, bandwidth_nm, from_side, report, ellipsometry
        parts = [_light(one, *asked) for _, one in stack]
        whole = _Sum()
        for (share, _), part in zip(stack, parts, strict=True):
            whole.add(share, part)
        return whole.light
    wavelength, sine = wavelengths_nm(wavelength_nm), np.sin(np.radians(_angles_deg(aoi_deg)))
    _one_of("from_side", from_side, Side)
    rows_at = rows_function(stack)

    def at(wave: Real) -> Light:
        rows = rows_at(wave) if from_side == "outside" else flipped(rows_at(wave))
        if ellipsometry and np.any(rows.index[:, -1].imag > 0.0):
            worst = complex(rows.index[np.argmax(rows.index[:, -1].imag), -1])
            raise InputError(from_side, worst, "k = 0 for psi and delta", "measure from a medium that is clear")
        return _by_blocks(rows, sine, report)

    if bandwidth_nm == 0.0:
        return at(wavelength)
    sigma_nm = bandwidth_nm / FWHM_PER_SIGMA
    nodes = _line_nodes(rows_at(wavelength), wavelength, bandwidth_nm)
    line = _Line(lambda offset: at(wavelength + sigma_nm * offset), nodes)
    while (differ := line.average()) > HALVES_DIFFER and 2 * line.nodes - 1 <= MAX_LINE_NODES:
        line.refine()
    if differ > HALVES_DIFFER:
        allowed = f"{MAX_LINE_NODES} wavelengths that resolve the film; half of {line.nodes} differ by {differ:.1e}"
        raise InputError("bandwidth_nm", bandwidth_nm, allowed, "ask for a narrower line")
    return line.whole


def _by_blocks(rows: StackRows, sine: Real, report: Report) -> Light:
    """The light at some wavelengths and all angles: a block of wavelengths at a time, for `solve` needs much room."""
    width = max(1, BLOCK // sine.size)
    parts = []
    for block in (slice(start, start + width) for start in range(0, rows.wavelength_nm.size, width)):
        report()
        some = replace(rows, wavelength_nm=rows.wavelength_nm[block], index=rows.index[block])
        parts.append(respond(some, some.index[:, -1].real[:, None] * sine))
    if len(parts) == 1:
        return parts[0]
    return Light(*(np.concatenate([getattr(part, name) for part in parts]) for name in LIGHT))


class _Line:
    """Averages over an instrument's Gaussian line; `at` gives the light at an offset in standard deviations."""

    def __init__(self, at: Callable[[float], Light], nodes: int) -> None:
        self._at, self._held, self._held_bytes = at, dict[float, Light](), 0
        self._offsets = self._places = np.linspace(-LINE_SIGMAS, LINE_SIGMAS, nodes)

    @property
    def nodes(self) -> int:
        """How many wavelengths it has."""
        return int(self._offsets.size)

    def average(self) -> float:
        """Set `whole`, the average over all wavelengths; by how much R or T of every second one differ from it.

        For fringes and resonances alike the error of all is about the square of that: 1e-6 for `HALVES_DIFFER`.
        """
        of_whole, of_half = _weights(self._offsets), _weights(self._offsets[::2])
        whole, half = _Sum(), _Sum()
        for number, place in enumerate(self._places):
            part = self._light(float(place))
            whole.add(of_whole[number], part)
            if number % 2 == 0:
                half.add(of_half[number // 2], part)
        self.whole, every_second = whole.light, half.light
        differ = (np.abs(getattr(self.whole, name) - getattr(every_second, name)).max() for name in ("R", "T"))
        return max(map(float, differ))

    def refine(self) -> None:
        """Put a wavelength between every two."""
        places = np.empty(2 * self.nodes - 1)
        places[::2], places[1::2] = self._places, (self._offsets[1:] + self._offsets[:-1]) / 2.0
        self._places, self._offsets = places, np.linspace(-LINE_SIGMAS, LINE_SIGMAS, places.size)

    def _light(self, place: float) -> Light:
        """The light at a place, held where there is room."""
        light = self._held.get(place)
        if light is None:
            light = self._at(place)
            size = sum(getattr(light, name).nbytes for name in LIGHT)
            if self._held_bytes + size <= HELD_BYTES:
                self._held[place], self._held_bytes = light, self._held_bytes + size
        return light


class _Sum:
    """Intensities times weights, added one after the other."""

    def __init__(self) -> None:
        self._total: list[Any] = [0.0] * len(LIGHT)

    def add(self, weight: float, light: Light) -> None:
        """One more."""
        self._total = [total + weight * getattr(light, name) for total, name in zip(self._total, LIGHT, strict=True)]

    @property
    def light(self) -> Light:
        """The sum so far."""
        return Light(*map(np.asarray, self._total))


def _weights(offsets: Real) -> Real:
    """Gaussian weights of sum 1, offsets in standard deviations."""
    weights = np.exp(-(offsets**2) / 2.0)
    return np.asarray(weights / weights.sum())


def _line_nodes(rows: StackRows, wavelength: Real, bandwidth_nm: float) -> int:
    """How many wavelengths (odd) to begin with for the instrument's Gaussian line.

    A trapezoid sum of step h (in standard deviations) errs by exp(-(2 pi / h - m phase)^2 / 2) on the m-th harmonic
    of a fringe whose phase turns by `phase` in one standard deviation; h leaves room for several harmonics.
    """
    widest = float(wavelength.min()) * FWHM_PER_SIGMA / (2.0 * LINE_SIGMAS)
    within("bandwidth_nm", bandwidth_nm, 0.0, widest, "the FWHM of the instrument's line in nm, 0 for none")
    sigma_nm = bandwidth_nm / FWHM_PER_SIGMA
    path_nm = float((rows.index[:, 1:-1].real * rows.thickness_nm * rows.coherent).sum(axis=1).max())
    phase = 4.0 * np.pi * path_nm * sigma_nm / float(wavelength.min()) ** 2
    nodes = int(np.ceil(2.0 * LINE_SIGMAS * (8.0 + 6.0 * phase) / (2.0 * np.pi))) | 1
    if nodes > MAX_LINE_NODES:
        mend = "say coherent = false for the thick layer: its fringes are averaged away"
        raise InputError("bandwidth_nm", bandwidth_nm, f"at most {MAX_LINE_NODES} nodes, here {nodes}", mend)
    return nodes


def rows_function(stack: Stack | RowsAt) -> RowsAt:
    """The rows of a stack as a function of wavelength."""
    return partial(resolve, stack) if isinstance(stack, Stack) else stack


def _angles_deg(value: ArrayLike) -> Real:
    mend = "the angle in the medium of incidence, in degrees"
    angles = np.atleast_1d(within("aoi_deg", value, 0.0, GRAZING_DEG, mend, below=True))
    if angles.ndim != 1 or not angles.size:
        raise InputError("aoi_deg", f"shape {angles.shape}", "one number or a list of numbers", mend)
    return angles


def _one_of(field: str, value: object, kind: object) -> None:
    if value not in get_args(kind):
        raise InputError(field, value, " | ".join(get_args(kind)), "one of these words")
