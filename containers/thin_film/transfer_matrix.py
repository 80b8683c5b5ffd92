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
exp(-(kz_i - kz_j)^2 s^2 / 2), kz complex. Source: Filinski, Katsidis and Siapkas, Appl. Opt. 41, 3978 (2002).

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

from containers.compiled import kernel
from luxloop.errors import InputError

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
RoughnessModel = Literal["debye_waller", "nevot_croce"]

POLARISATIONS = ("s", "p")
MAX_EXCESS = {"debye_waller": 1e-2, "nevot_croce": 1e-9}
"""Largest power a roughness model may create; the graded one has no scatter channel to take an error."""

_KZ_SQUARED_MIN = 1e-11
"""Least |kz^2 / n^2| of a layer: at u = n exactly the waves to and fro are the same function."""


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
    wavelength = _vector("wavelength_nm", wavelength_nm, least=0.0, strict=True)
    thickness = _vector("thickness_nm", thickness_nm, least=0.0)
    layers = thickness.size
    n = _indices(index, wavelength.size, layers + 2)
    rough = _vector("roughness_nm", np.broadcast_to(np.asarray(roughness_nm, float), (layers + 1,)), least=0.0)
    nodes = _vector("u", u, least=0.0, dims=(1, 2))
    nodes = np.array(np.broadcast_to(nodes, (wavelength.size, nodes.shape[-1])), order="C")
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
    fields: list[Any] = [*amplitude, *power, float(excess)]
    return StackResponse(*fields)


def _vector(name: str, value: ArrayLike, least: float, strict: bool = False, dims: tuple[int, ...] = (1,)) -> Real:
    array = np.array(value, dtype=float, order="C")  # a copy: a read-only array would be another type to compile for
    allowed = f"finite numbers {'>' if strict else '>='} {least:g}"
    if array.ndim not in dims:
        raise InputError(name, f"{array.ndim} dimensions", f"{' or '.join(map(str, dims))} dimensions")
    bad = ~np.isfinite(array) | (array < least) | (strict & (array == least))
    if bad.any():
        raise InputError(name, float(array[bad][0]), allowed)
    return array


def _indices(index: ArrayLike, wavelengths: int, media: int) -> Complex:
    array = np.asarray(index, complex)
    if array.ndim not in (1, 2) or array.shape[-1] != media or (array.ndim == 2 and len(array) != wavelengths):
        raise InputError(
            "index", f"shape {array.shape}", f"shape ({wavelengths}, {media}), layers and two half spaces"
        )
    bad = ~np.isfinite(array) | (array.real <= 0) | (array.imag < 0)
    if bad.any():
        raise InputError("index", complex(array[bad][0]), "n > 0 and k >= 0, as n + ik", "give k with a plus sign")
    return np.array(np.broadcast_to(array, (wavelengths, media)), order="C")


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
            _wave_numbers(n, thickness, k0, u[w, i], kz, phase)
            for p in range(2):
                y[:] = kz * by_n2 if p else kz
                to_e = n[0] / n[-1] if p else 1.0 + 0.0j
                _faces(y, kz, rough, k0, graded, face, lost)
                for side in range(2):  # 0: light from the outside, 1: from the inside
                    start = 0 if side else media - 1
                    _airy(side, face, phase, rho, q)
                    t = _budget(side, n, y, face, lost, phase, rho, q, rough, budget)
                    created = _close(y[start].real, n[start].imag > 0.0, graded, budget)
                    worst = max(worst, created)
                    amplitude[side, w, p, i] = rho[0]
                    amplitude[2 + side, w, p, i] = t * to_e if side else t / to_e
                    power[5 * side : 5 * side + 5, w, p, i] = budget
    return worst


@kernel
def _wave_numbers(index: Complex, thickness: Real, k0: float, u: float, kz: Complex, phase: Complex) -> None:
    """Fill kz (in units of k0) of every medium and exp(i kz k0 d) of every layer."""
    last = index.size - 1
    for j in range(last + 1):
        if 2 < j < last and index[j] == index[j - 2] and thickness[j - 1] == thickness[j - 3]:
            kz[j], phase[j] = kz[j - 2], phase[j - 2]  # a periodic stack needs two of each
            continue
        n2 = index[j] * index[j]
        kz2 = n2 - u * u
        if 0 < j < last and _abs2(kz2) < _KZ_SQUARED_MIN**2 * _abs2(n2):
            kz2 = _KZ_SQUARED_MIN * n2
        root = np.sqrt(kz2)
        kz[j] = -root if root.imag < 0.0 else root
        phase[j] = np.exp(1j * kz[j] * k0 * thickness[j - 1]) if 0 < j < last else 1.0


@kernel
def _faces(y: Complex, kz: Complex, rough: Real, k0: float, graded: bool, face: Complex, lost: Real) -> None:
    """Fill r, t of every face, `face[0]` for light from the outside and `face[1]` from the inside; same for `lost`.

    `lost` holds the single-face scattered powers (reflected, transmitted) of a wave of unit amplitude.
    """
    for j in range(rough.size):
        both = y[j] + y[j + 1]
        r = (y[j] - y[j + 1]) * _inverse(both) if both != 0.0 else 0.0j
        s2 = (rough[j] * k0) ** 2
        for d in range(2):
            i, o = (j, j + 1) if d else (j + 1, j)
            r_d = r if d else -r
            t_d = 1.0 + r_d
            if s2 > 0.0 and graded:
                r_d *= np.exp(-2.0 * kz[i] * kz[o] * s2)
                t_d *= np.exp((kz[i] - kz[o]) ** 2 * s2 / 2.0)
            elif s2 > 0.0:
                by_r, by_t = np.exp(-2.0 * kz[i] * kz[i] * s2), np.exp(-((kz[i] - kz[o]) ** 2) * s2 / 2.0)
                lost[d, j, 0] = max(0.0, y[i].real * _abs2(r_d) * (1.0 - _abs2(by_r)))
                lost[d, j, 1] = max(0.0, y[o].real * _abs2(t_d) * (1.0 - _abs2(by_t)))
                r_d, t_d = r_d * by_r, t_d * by_t
            face[d, j, 0], face[d, j, 1] = r_d, t_d


@kernel
def _airy(d: int, face: Complex, phase: Complex, rho: Complex, q: Complex) -> None:
    """Fill rho, the reflection amplitude just before each face, and q, that just after it (far end: 0).

    Faces are counted from the side of incidence: `d` = 1 from the inside, 0 from the outside.
    """
    faces = face.shape[1]
    beyond = 0.0j
    for j in range(faces - 1, -1, -1):
        f = j if d else faces - 1 - j
        m = f + 1 if d else f
        q[j] = beyond * phase[m] * phase[m]
        through = face[d, f, 1] * face[1 - d, f, 1]
        beyond = face[d, f, 0] + through * q[j] * _inverse(1.0 - face[1 - d, f, 0] * q[j])
        rho[j] = beyond


@kernel
def _budget(
    d: int,
    index: Complex,
    y: Complex,
    face: Complex,
    lost: Real,
    phase: Complex,
    rho: Complex,
    q: Complex,
    rough: Real,
    budget: Real,
) -> complex:
    """Fill R, T, S_R, S_T, A (powers in units of the incident amplitude) for light from one side; returns t.

    S_R and S_T are S times the shares of the single-face terms of all waves that meet a face.
    """
    faces = face.shape[1]
    first, last = (0, faces) if d else (faces, 0)
    scattered, absorbed, back, onward = 0.0, 0.0, 0.0, 0.0
    a = 1.0 + 0.0j
    for j in range(faces):
        f = j if d else faces - 1 - j
        m, m0 = (f + 1, f) if d else (f, f + 1)
        there = face[d, f, 1] * a * _inverse(1.0 - face[1 - d, f, 0] * q[j])
        if rough[f] > 0.0:
            scattered += _flux(y[m0], a, rho[j]) - _flux(y[m], there, q[j])
            to, fro = _abs2(a), _abs2(there * q[j])
            back += to * lost[d, f, 0] + fro * lost[1 - d, f, 1]
            onward += to * lost[d, f, 1] + fro * lost[1 - d, f, 0]
        a = there * phase[m]
        if index[m].imag > 0.0 and m != last:
            absorbed += _flux(y[m], there, q[j]) - _flux(y[m], a, rho[j + 1])
    share = back / (back + onward) if back + onward > 0.0 else 0.5
    budget[0], budget[1], budget[4] = _abs2(rho[0]) * y[first].real, _abs2(a) * y[last].real, absorbed
    budget[2], budget[3] = share * scattered, (1.0 - share) * scattered
    return a


@kernel
def _close(incident: float, absorbing: bool, graded: bool, budget: Real) -> float:
    """Turn powers into shares of the incident power that sum to 1; returns the power that the model has created."""
    if incident <= 0.0:
        budget[:] = 0.0
        budget[0] = 1.0
        return 0.0
    budget /= incident
    if absorbing or graded:
        budget[2] = budget[3] = 0.0
        budget[4] = 1.0 - budget[0] - budget[1]
        return 0.0 if absorbing else max(0.0, -budget[4])
    created: float = -(budget[2] + budget[3])
    if created <= 0.0:
        return 0.0
    budget[2] = budget[3] = 0.0
    if budget[4] >= created:
        budget[4] -= created
    else:
        budget /= 1.0 + created
    return created


@kernel
def _flux(y: complex, to: complex, ratio: complex) -> float:
    """Power flux along + of a wave `to` and its companion `ratio * to` the other way."""
    along: float = (y * (1.0 - ratio) * np.conj(1.0 + ratio)).real
    return along * _abs2(to)


@kernel
def _abs2(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


@kernel
def _inverse(z: complex) -> complex:
    """1 / z without the scaling of the general complex division: no amplitude here comes near 1e154."""
    return z.conjugate() * (1.0 / _abs2(z))
