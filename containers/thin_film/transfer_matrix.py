"""Reflection and transmission of a coherent stack of plane layers: any absorption, any angle, rough faces.

    inside (0) | layer 1 | ... | layer M | outside (M+1)          z and the + direction point outwards
             face 0    face 1  ...     face M

Time factor exp(-i omega t), index n + ik, kz = sqrt(n^2 - u^2) in units of k0 with Im kz >= 0, u = k_parallel / k0.
With the tilted admittance y = kz (s) or kz / n^2 (p) one face has

    r_ij = (y_i - y_j) / (y_i + y_j),      t_ij = 2 y_i / (y_i + y_j),      power flux Re[y (a - b) conj(a + b)]

where a and b, the amplitudes to and fro, are those of E for s and of H for p. So r_p = -r_s at normal incidence: the
convention of Azzam and Bashara, in which rho = r_p / r_s, and of `coh_tmm` in tmm (whose `ellips` then turns the
sign: its Delta is the phase of -r_p / r_s). Returned transmission amplitudes are those of E for both polarisations,
t_p = t_H n_i / n_j, again as in tmm.

The stack is summed from its far end by Airy's recursion, rho_j = r + t t' q / (1 - r' q), q = rho_{j+1} exp(2 i phi):
every exponential decays, so opaque layers and evanescent gaps neither overflow nor lose digits.

Rough faces (rms height s, Debye-Waller): r_ij exp(-2 kz_i^2 s^2), r_ji exp(-2 kz_j^2 s^2), both t
exp(-(kz_i - kz_j)^2 s^2 / 2), kz complex. Source: Katsidis and Siapkas, Appl. Opt. 41, 3978 (2002).

The budget R + T + S_R + S_T + A = 1 is counted where the power goes. A is what the coherent field loses between the
faces (Poynting flux into each layer minus flux out of it: never negative, zero without absorption). S is what it
loses at the faces (zero without roughness): the scattered power. It is divided into the halves S_R and S_T as are
the single-face terms r^2 (1 - exp(-(2 k s)^2)) and t^2 (1 - exp(-((k_i - k_j) s)^2)), summed over the faces with the
intensities of the waves that meet them.
Neglected: what becomes of scattered light inside the stack (further interference, absorption, trapping).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.checked import NANOMETRES, within
from containers.compiled import kernel
from containers.thin_film.power_budget import close_budget, fill_budget
from containers.thin_film.waves import airy, face_amplitudes, wave_numbers
from luxloop.errors import InputError

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
RoughnessModel = Literal["debye_waller", "nevot_croce"]

POLARISATIONS = ("s", "p")
MAX_PHASE_RAD = 1e9
"""Largest |n| k0 d of a layer: its phase is then known to about 2e-7 rad."""
MAX_U, MAX_INDEX = 1e6, 1e12
"""Beyond these squares of amplitudes leave the range of floats."""
MAX_EXCESS = {"debye_waller": 1e-2, "nevot_croce": 1e-9}
"""Largest power a roughness model may create; the graded one has no scatter channel to take an error."""


@dataclass(frozen=True)
class StackResponse:
    """What a stack does to light from either side; all arrays (wavelength, polarisation, u), polarisation s, p.

    `R_outside` is the share of the power coming from the outside that is reflected, `T_outside` the share that it
    sends to the inside, and so on; per side R + T + S_R + S_T + A = 1. S_R is scattered back to the side of
    incidence, S_T to the other one.

    Where u lies beyond the index of the side of incidence no power can be sent in. The budget then reads R = 1, which
    is the limit of grazing incidence; the amplitudes keep their (evanescent) meaning.

    Where the medium of incidence absorbs, R = |r|^2 and T are taken at the face, relative to the incident wave alone,
    and A = 1 - R - T: it holds scatter and the interference of the incident with the reflected wave, is no loss, and
    may be negative. It is also the rest of the budget under `nevot_croce`.

    `excess` is the largest power that the roughness model has created anywhere: 0 without roughness, and no lossless
    stack is known where it is not 0, but at a metal face kz - kz' is nearly imaginary and the factor on t above 1.
    Such a budget has S = 0, and the created power is taken out of A (it was counted there), or where A is too small
    out of all entries in proportion.
    """

    r_outside: Complex
    r_inside: Complex
    t_outside_to_inside: Complex
    t_inside_to_outside: Complex
    R_outside: Real
    T_outside: Real
    S_R_outside: Real
    S_T_outside: Real
    A_outside: Real
    R_inside: Real
    T_inside: Real
    S_R_inside: Real
    S_T_inside: Real
    A_inside: Real
    excess: float

    @property
    def T(self) -> Real:  # noqa: N802  # the symbol of the field
        """Transmitted power, the same from both sides between half spaces without absorption; else `T_outside`."""
        return self.T_outside


def solve(
    index: ArrayLike,
    thickness_nm: ArrayLike,
    roughness_nm: ArrayLike,
    wavelength_nm: ArrayLike,
    u: ArrayLike,
    roughness_model: RoughnessModel = "debye_waller",
) -> StackResponse:
    """Amplitudes and powers of a coherent stack, seen from both sides, for every wavelength, polarisation and u.

    Parameters
    ----------
    index : (wavelength, M + 2) complex, n + ik from the inside bulk outwards; (M + 2,) where it does not change.
    thickness_nm : (M,), layers from the inside outwards.
    roughness_nm : (M + 1,) rms height of each face from the inside outwards; or one number for all.
    wavelength_nm : (wavelength,), in vacuum.
    u : (U,) or (wavelength, U), k_parallel / k0 = n sin(theta) of either half space, real and >= 0.
    roughness_model : "debye_waller", or "nevot_croce" (graded faces: r exp(-2 kz_i kz_j s^2), t
        exp(+(kz_i - kz_j)^2 s^2 / 2), no scatter) for spectra only.

    Raises
    ------
    InputError for a value out of range, and where the roughness model creates more power than `MAX_EXCESS`.

    Notes
    -----
    Equations, signs, sources and what is neglected: at the head of this module.
    """
    wavelength = _vector("wavelength_nm", wavelength_nm, *NANOMETRES, "the vacuum wavelength in nm")
    thickness = _vector("thickness_nm", thickness_nm, 0.0, np.inf, "thicknesses in nm, 0 or more")
    layers = thickness.size
    n = _indices(index, wavelength.size, layers + 2)
    _check_phase(n, thickness, wavelength)
    rough = _of_shape("roughness_nm", roughness_nm, 1e9, (layers + 1,), "the rms height of each face in nm")
    nodes = _of_shape("u", u, MAX_U, (wavelength.size, *np.shape(u)[-1:]), "n sin(theta) at each node")
    if roughness_model not in MAX_EXCESS:
        raise InputError("roughness_model", roughness_model, " or ".join(MAX_EXCESS), "debye_waller is the default")
    graded = roughness_model == "nevot_croce"
    shape = (wavelength.size, 2, nodes.shape[-1])
    amplitude = np.empty((4, *shape), complex)
    power = np.empty((10, *shape))
    excess = _solve(n, thickness, rough, wavelength, nodes, graded, amplitude, power)
    if not excess <= MAX_EXCESS[roughness_model]:
        raise InputError(
            "roughness_nm",
            float(rough.max()),
            f"roughness for which {roughness_model} sums to at most 1 + {MAX_EXCESS[roughness_model]:g}, "
            f"here 1 + {excess:.2g}",
            "use debye_waller" if graded else "the model does not hold at this metal face: use a smaller roughness",
        )
    if not np.isfinite(power).all():
        field, value = ("roughness_nm", float(rough.max())) if rough.any() else ("index", list(n[0]))
        mend = "the stack as it stands overflows: use a smaller roughness, indices nearer to 1"
        raise InputError(field, value, "values for which all powers are finite", mend)
    fields: list[Any] = [*amplitude, *power, float(excess)]
    return StackResponse(*fields)


def _vector(field: str, value: ArrayLike, least: float, most: float, mend: str) -> Real:
    array = np.array(within(field, value, least, most, mend), order="C")  # a read-only array would be another type
    if array.ndim != 1:
        raise InputError(field, f"{array.ndim} dimensions", "1 dimension", mend)
    return array


def _of_shape(field: str, value: ArrayLike, most: float, shape: tuple[int, ...], mend: str) -> Real:
    array = within(field, value, 0.0, most, mend)
    try:
        return np.array(np.broadcast_to(array, shape), order="C")
    except ValueError as error:
        raise InputError(field, f"shape {array.shape}", f"a shape that becomes {shape}", mend) from error


def _indices(index: ArrayLike, wavelengths: int, media: int) -> Complex:
    array = np.asarray(index, complex)
    if array.ndim not in (1, 2) or array.shape[-1] != media or (array.ndim == 2 and len(array) != wavelengths):
        allowed = f"shape ({wavelengths}, {media}) or ({media},), layers and two half spaces"
        raise InputError("index", f"shape {array.shape}", allowed, "one index for each medium, from the inside out")
    size = np.abs(array)
    good = (array.real > 0.0) & (array.imag >= 0.0) & (size >= 1.0 / MAX_INDEX) & (size <= MAX_INDEX)
    if not good.all():
        allowed = f"n > 0 and k >= 0, as n + ik, of modulus {1.0 / MAX_INDEX:g} to {MAX_INDEX:g}"
        raise InputError("index", complex(array[~good][0]), allowed, "give k with a plus sign")
    return np.array(np.broadcast_to(array, (wavelengths, media)), order="C")


def _check_phase(n: Complex, thickness: Real, wavelength: Real) -> None:
    """InputError for a layer so thick that its phase, known to 16 digits, has none left for the interference."""
    phase = 2.0 * np.pi * (np.abs(n[:, 1:-1]) * thickness).max(axis=1, initial=0.0) / wavelength
    if not phase.max(initial=0.0) <= MAX_PHASE_RAD:
        most = MAX_PHASE_RAD * float((wavelength / np.abs(n).max(axis=1)).min()) / (2.0 * np.pi)
        allowed = f"at most {most:.2g} nm, beyond which rounding decides the interference"
        mend = "call the layer incoherent, or a half space"
        raise InputError("thickness_nm", float(thickness.max()), allowed, mend)


@kernel
def _solve(
    index: Complex,
    thickness: Real,
    rough: Real,
    wavelength: Real,
    u: Real,
    graded: bool,
    amplitude: Complex,
    power: Real,
) -> float:
    """Fill `amplitude` and `power` in the order of `StackResponse`; returns the largest power created."""
    media = index.shape[1]
    kz, y, phase = np.empty(media, np.complex128), np.empty(media, np.complex128), np.empty(media, np.complex128)
    face, lost = np.empty((2, media - 1, 2), np.complex128), np.zeros((2, media - 1, 2))
    rho, q = np.empty(media, np.complex128), np.empty(media, np.complex128)
    budget = np.empty(5)
    worst = 0.0
    for w in range(wavelength.size):
        n, k0 = index[w], 2.0 * np.pi / wavelength[w]
        by_n2 = 1.0 / (n * n)
        for i in range(u.shape[1]):
            wave_numbers(n, thickness, k0, u[w, i], kz, phase)
            for p in range(2):
                y[:] = kz * by_n2 if p else kz
                to_e = n[0] / n[-1] if p else 1.0 + 0.0j
                face_amplitudes(y, kz, rough, k0, graded, face, lost)
                for side in range(2):  # 0: light from the outside, 1: from the inside
                    start = 0 if side else media - 1
                    airy(side, face, phase, rho, q)
                    t = fill_budget(side, n, y, face, lost, phase, rho, q, rough, budget)
                    created = close_budget(y[start].real, n[start].imag > 0.0, graded, budget)
                    worst = max(worst, created)
                    amplitude[side, w, p, i] = rho[0]
                    amplitude[2 + side, w, p, i] = t * to_e if side else t / to_e
                    power[5 * side : 5 * side + 5, w, p, i] = budget
    return worst
