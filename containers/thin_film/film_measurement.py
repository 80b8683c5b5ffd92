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
from itertools import zip_longest
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.checked import wavelengths_nm, within
from containers.stack import StackRows, resolve
from containers.thin_film.ellipsometry import ncs_of_light, psi_delta_deg
from containers.thin_film.incoherent import Light, flipped, respond
from luxloop.errors import InputError
from luxloop.stack import Stack

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Spot = tuple[tuple[float, Stack], ...]
"""Shares of the measured spot, of sum 1, and what lies there."""
RowsAt = Callable[[Real], StackRows]
"""The rows of a stack for an array of vacuum wavelengths in nm."""

Quantity = Literal["R", "T", "psi", "delta"]
Polarisation = Literal["s", "p", "u"]
Side = Literal["outside", "inside"]

FWHM_PER_SIGMA = 2.3548200450309493
LINE_SIGMAS = 5.0
"""The instrument's line is cut here: 6e-7 of its area lies beyond."""

MAX_LINE_NODES = 4001
HALVES_DIFFER = 1e-3


def measure(
    stack: Stack | RowsAt | Spot,
    quantity: Quantity,
    wavelength_nm: ArrayLike,
    aoi_deg: ArrayLike,
    polarisation: Polarisation = "u",
    bandwidth_nm: float = 0.0,
    from_side: Side = "outside",
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
        psi, delta = psi_delta_deg(measure_ncs(stack, wavelength_nm, aoi_deg, bandwidth_nm, from_side))
        return psi if quantity == "psi" else delta
    light = _light(stack, wavelength_nm, aoi_deg, bandwidth_nm, from_side)
    power = light.R if quantity == "R" else light.T
    mean: Real = power.mean(axis=1)
    return mean if polarisation == "u" else power[:, "sp".index(polarisation)]


def measure_ncs(
    stack: Stack | RowsAt | Spot,
    wavelength_nm: ArrayLike,
    aoi_deg: ArrayLike,
    bandwidth_nm: float = 0.0,
    from_side: Side = "outside",
) -> Real:
    """N, C, S of the reflected light as (3, wavelength, aoi); parameters and errors as those of `measure`."""
    return ncs_of_light(_light(stack, wavelength_nm, aoi_deg, bandwidth_nm, from_side, ellipsometry=True))


def bruggeman(index_a: ArrayLike, index_b: ArrayLike, share_b: float = 0.5) -> Complex:
    """Index n + ik of a fine mixture of two media, `share_b` of the volume being b.

    The root with Im e >= 0 of (1 - f)(e_a - e)/(e_a + 2e) + f (e_b - e)/(e_b + 2e) = 0, e = n^2, f = share_b; the
    other root, -e_a e_b / 2e, has Im e <= 0. InputError for a share outside 0 to 1, and for what is no index. For
    grains far below the wavelength. Source: Bruggeman, Ann. Phys. 416, 636 (1935).
    """
    within("share_b", share_b, 0.0, 1.0, "the share of the volume that is b")
    e_a, e_b = (_index(field, n) ** 2 for field, n in (("index_a", index_a), ("index_b", index_b)))
    half = ((2.0 - 3.0 * share_b) * e_a + (3.0 * share_b - 1.0) * e_b) / 4.0
    root = np.sqrt(half**2 + e_a * e_b / 2.0)
    plus = (root.imag > 0.0) | ((root.imag == 0.0) & (root.real >= 0.0))
    mixed: Complex = np.sqrt(half + np.where(plus, root, -root))
    return mixed.real + 1j * np.maximum(mixed.imag, 0.0)  # rounding may leave k = -1e-16


def interlayer(stack: Stack | RowsAt, face: int, thickness_nm: float, share_outer: float = 0.5) -> RowsAt:
    """The stack with a mixed layer of both neighbours at one face, as rows: roughness as ellipsometry models it.

    Parameters
    ----------
    stack : what it is added to; the result can be handed in again, for a second face further inside.
    face : 0 is the face of the inside bulk, the number of layers that of the outermost layer.
    thickness_nm : of the mixed layer, about 2 to 3 rms heights. What it is made of is taken from the two neighbours:
        a face becomes rough, no material is added.
    share_outer : volume share of the outer neighbour (`bruggeman`).

    Raises
    ------
    InputError for a value out of range; for a face that the stack does not have, when the rows are asked for.
    """
    within("share_outer", share_outer, 0.0, 1.0, "the share of the volume that is the outer neighbour")
    within("thickness_nm", thickness_nm, 0.0, 1e9, "the thickness of the mixed layer in nm")
    rows_at = rows_function(stack)

    def with_interlayer(wavelength_nm: Real) -> StackRows:
        rows = rows_at(wavelength_nm)
        faces = range(len(rows.thickness_nm) + 1)
        if face not in faces:
            raise InputError("face", face, f"0 to {faces[-1]}, counted from the inside", "name a face of the stack")
        mixed = bruggeman(rows.index[:, face], rows.index[:, face + 1], share_outer)
        left = np.array([np.inf, *rows.thickness_nm, np.inf])  # the half spaces give without becoming thinner
        left[face : face + 2] -= thickness_nm * np.array([1.0 - share_outer, share_outer])
        if left.min() < 0.0:
            raise InputError("thickness_nm", thickness_nm, "no more than its neighbours can give", "make it thinner")
        return replace(
            rows,
            index=np.insert(rows.index, face + 1, mixed, axis=1),
            thickness_nm=np.insert(left[1:-1], face, thickness_nm),
            roughness_nm=np.insert(rows.roughness_nm, face + 1, 0.0),
            coherent=np.insert(rows.coherent, face, True),
        )

    return with_interlayer


def _light(
    stack: Stack | RowsAt | Spot,
    wavelength_nm: ArrayLike,
    aoi_deg: ArrayLike,
    bandwidth_nm: float,
    from_side: Side,
    ellipsometry: bool = False,
) -> Light:
    """The instrument's average of the intensities."""
    if isinstance(stack, tuple):
        parts = [_light(one, wavelength_nm, aoi_deg, bandwidth_nm, from_side, ellipsometry) for _, one in stack]
        return _sum(parts, np.array([share for share, _ in stack]))
    wavelength, sine = wavelengths_nm(wavelength_nm), np.sin(np.radians(_angles_deg(aoi_deg)))
    _one_of("from_side", from_side, Side)
    rows_at = rows_function(stack)

    def at(wave: Real) -> Light:
        rows = rows_at(wave) if from_side == "outside" else flipped(rows_at(wave))
        if ellipsometry and np.any(rows.index[:, -1].imag > 0.0):
            worst = complex(rows.index[np.argmax(rows.index[:, -1].imag), -1])
            raise InputError(from_side, worst, "k = 0 for psi and delta", "measure from a medium that is clear")
        return respond(rows, rows.index[:, -1].real[:, None] * sine)

    if bandwidth_nm == 0.0:
        return at(wavelength)
    sigma_nm = bandwidth_nm / FWHM_PER_SIGMA
    offsets = np.linspace(-LINE_SIGMAS, LINE_SIGMAS, _line_nodes(rows_at(wavelength), wavelength, bandwidth_nm))
    parts = [at(wavelength + sigma_nm * offset) for offset in offsets]
    while (differ := _halves_differ(parts, offsets)) > HALVES_DIFFER and 2 * offsets.size - 1 <= MAX_LINE_NODES:
        between = (offsets[1:] + offsets[:-1]) / 2.0
        new = [at(wavelength + sigma_nm * offset) for offset in between]
        parts = [part for pair in zip_longest(parts, new) for part in pair if part is not None]
        offsets = np.linspace(-LINE_SIGMAS, LINE_SIGMAS, 2 * offsets.size - 1)
    if differ > HALVES_DIFFER:
        allowed = f"{MAX_LINE_NODES} wavelengths that resolve the film; half of {offsets.size} differ by {differ:.1e}"
        raise InputError("bandwidth_nm", bandwidth_nm, allowed, "ask for a narrower line")
    return _averaged(parts, offsets)


def _halves_differ(parts: list[Light], offsets: Real) -> float:
    """By how much R or T of every second wavelength of a line differ from those of all.

    For fringes and resonances alike the error of all is about the square of that: 1e-6 for `HALVES_DIFFER`.
    """
    whole, half = _averaged(parts, offsets), _averaged(parts[::2], offsets[::2])
    return max(float(np.abs(whole.R - half.R).max()), float(np.abs(whole.T - half.T).max()))


def _averaged(parts: list[Light], offsets: Real) -> Light:
    """The average of intensities with Gaussian weights, offsets in standard deviations."""
    weights = np.exp(-(offsets**2) / 2.0)
    return _sum(parts, weights / weights.sum())


def _sum(parts: list[Light], weights: Real) -> Light:
    """Intensities times weights, added."""
    fields = ([getattr(part, name) for part in parts] for name in ("R", "T", "ps"))
    return Light(*(np.asarray(sum(w * value for w, value in zip(weights, of, strict=True))) for of in fields))


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
    angles = np.atleast_1d(within("aoi_deg", value, 0.0, 90.0, mend, below=True))
    if angles.ndim != 1 or not angles.size:
        raise InputError("aoi_deg", f"shape {angles.shape}", "one number or a list of numbers", mend)
    return angles


def _index(field: str, value: ArrayLike) -> Complex:
    index = np.asarray(value, complex)
    if not (np.isfinite(index) & (index.real > 0.0) & (index.imag >= 0.0)).all():
        raise InputError(field, value, "n > 0 and k >= 0, as n + ik", "give k with a plus sign")
    return index


def _one_of(field: str, value: object, kind: object) -> None:
    if value not in get_args(kind):
        raise InputError(field, value, " | ".join(get_args(kind)), "one of these words")
