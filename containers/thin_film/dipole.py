"""Light of a dipole inside a stack: where it goes, and how much of it there is.

    inside | ... films below ... | emitting layer, dipole at depth z | ... films above ... | outside

Method of source terms: the dipole is two waves, up and down, in each of s and p; the films above and below reflect
them with r_u and r_d as seen from the emitting layer. With k_z = k0 n cos(theta) there, A = r_u exp(2 i k_z z_u) and
B = r_d exp(2 i k_z z_d), the power to the outside per solid angle in the emitting layer is

    dP/dOmega = a^2 T_u |1 +- B|^2 / |1 - A B|^2

    horizontal dipole, all azimuths (c-plane InGaN wells):    s  a^2 = 3/16pi (+)    p  a^2 = 3/16pi cos^2 theta (-)
    vertical dipole:                                                                 p  a^2 = 3/8pi  sin^2 theta (+)

Unit of power: what the dipole emits in a boundless medium of the same index. The signs belong to r_p of the magnetic
field (that of `transfer_matrix`). Where n of the outside is larger than that of the emitting layer, waves that are
evanescent in the layer carry power too; they are counted. The total power (Purcell factor: guided, absorbed and
evanescent light included) is the integral of the field that returns to the dipole, with v = u / n, c^2 = 1 - v^2:

    F_vertical = 1 + 3/2 Re Int v^3/c (A_p + B_p + 2 A_p B_p) / (1 - A_p B_p) dv
    F_horizontal = 1 + 3/4 Re Int v/c [(A_s + B_s + 2 A_s B_s) / (1 - A_s B_s)
                                       + c^2 (2 A_p B_p - A_p - B_p) / (1 - A_p B_p)] dv

taken along the ray arg u = -20 deg instead of the real axis. A passive stack has no poles between the two (guided
modes lie on or above the real axis), so the integral is the same, and its integrand smooth: no mode is missed.

Sources: Benisty, Stanley and Mayer, JOSA A 15, 1192 (1998); Lukosz and Kunz, JOSA 67, 1607 (1977). Neglected: light
that an emitting layer absorbs again (it must be clear), saturation, the finite line (average over wavelengths).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from containers.checked import reals, wavelengths_nm, within
from containers.stack import StackRows
from containers.thin_film.film_measurement import RowsAt, rows_function
from containers.thin_film.incoherent import flipped, section
from containers.thin_film.quadrature import integral
from containers.thin_film.transfer_matrix import solve
from luxloop.errors import InputError
from luxloop.stack import Stack
from luxloop.words import Words

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Orientation = Literal["horizontal", "vertical", "isotropic"]
Side = Literal["outside", "inside"]
SolidAngle = Literal["emitter", "outer"]

RAY_ANGLE_RAD = float(np.radians(20.0))
MIN_DISTANCE_NM = 0.015
"""Of a dipole from a face: rounding then errs by 2e-6, nearer by more; and no medium has an index so near."""


class Emitter(Words):
    """Where the dipoles sit: a layer of the stack (1 = next to the inside bulk), the depth from its inner face.

    Over `active_nm`, centred at `depth_nm`, they are spread evenly (a quantum well, or a stack of them).
    """

    layer: int = Field(ge=1)
    depth_nm: Annotated[float, Field(gt=0.0)]
    active_nm: Annotated[float, Field(ge=0.0)] = 0.0
    orientation: Orientation = "horizontal"


@dataclass(frozen=True)
class _Cavity:
    """The emitting layer between what lies below and what lies above, both seen from the layer ("outside")."""

    below: StackRows
    above: StackRows
    wavelength_nm: Real
    index: Real
    thickness_nm: float
    depths_nm: Real
    weights: Real
    vertical: float

    @property
    def k0_per_nm(self) -> Real:
        return 2.0 * np.pi / self.wavelength_nm[:, None]


def radiant_intensity(
    stack: Stack | RowsAt,
    emitter: Emitter,
    wavelength_nm: ArrayLike,
    theta_rad: ArrayLike,
    side: Side = "outside",
    per: SolidAngle = "emitter",
) -> Real:
    """Power per steradian that leaves the stack to one side, as (wavelength, polarisation s, p, theta).

    Parameters
    ----------
    stack : coherent layers only; the emitting layer must not absorb. Scattered light of rough faces is not followed.
    wavelength_nm : (wavelength,), in vacuum.
    theta_rad : (theta,) from the normal, 0 to pi/2, in the emitting layer or in the medium of that side (`per`).
    per : "emitter" = per solid angle in the emitting layer; "outer" = in the medium where the light arrives.

    Raises
    ------
    InputError for a value out of range, and where the medium of that side absorbs: nothing arrives far away.

    Notes
    -----
    Equation, unit of power, source: head of this module. n^2 cos(theta) dOmega is the same in the layer and outside.
    """
    cavity = _cavity(stack, emitter, wavelength_nm)
    theta = np.atleast_1d(within("theta_rad", theta_rad, 0.0, np.pi / 2, "angles from the normal, in radians"))
    if per not in get_args(SolidAngle):
        raise InputError("per", per, " | ".join(get_args(SolidAngle)), "the medium that solid angles are counted in")
    n, n_o = cavity.index[:, None], _outer_index(cavity, side)
    if per == "emitter":
        return _intensity(cavity, n * np.sin(theta), side)
    u = n_o * np.sin(theta)
    stretch = n_o * _normal(n_o, u).real / (n * np.abs(_kz(cavity, u)))
    per_outer: Real = _intensity(cavity, u, side) * stretch[:, None]
    return per_outer


def outward_power(stack: Stack | RowsAt, emitter: Emitter, wavelength_nm: ArrayLike, side: Side = "outside") -> Real:
    """Power that leaves the stack to one side, as (wavelength,): `radiant_intensity` over all directions.

    Parameters, unit and errors as those of `radiant_intensity`; error below 1e-9.
    """
    cavity = _cavity(stack, emitter, wavelength_nm)
    outer = _outer_index(cavity, side)
    media = [cavity.below.index.real, cavity.above.index.real, cavity.index[:, None]]
    kinks = np.sort(np.minimum(np.concatenate([np.zeros_like(outer), outer, *media], axis=1), outer), axis=1)
    kinks = kinks[:, np.r_[True, np.any(np.diff(kinks) > 1e-9, axis=0)]]

    def density(x: Real) -> Real:
        """dP / dx, x running by 1 from kink to kink, slowly near each of them, where square roots begin."""
        piece = np.minimum(x.astype(int), kinks.shape[1] - 2)
        low, high, turn = kinks[:, piece], kinks[:, piece + 1], np.pi * (x - piece)
        u = low + (high - low) * np.sin(turn / 2) ** 2
        du_dx = (high - low) * np.sin(turn) * np.pi / 2
        per_u: Real = 2 * np.pi * u / (cavity.index[:, None] * np.abs(_kz(cavity, u)))
        per_x: Real = _intensity(cavity, u, side).sum(axis=1) * per_u * du_dx
        return per_x

    return integral(density, np.arange(0.0, kinks.shape[1] - 0.75, 0.25))


def total_power(
    stack: Stack | RowsAt, emitter: Emitter, wavelength_nm: ArrayLike, ray_angle_rad: float = RAY_ANGLE_RAD
) -> Real:
    """All power that the dipole gives off (Purcell factor), as (wavelength,); 1 in a boundless medium.

    Parameters as those of `radiant_intensity`. `ray_angle_rad` turns the path of integration below the real axis;
    the result does not depend on it. Error below 1e-9 of the power, where the dipole is 1 nm or further from the
    layer's faces; nearer it grows, to 2e-6 at `MIN_DISTANCE_NM`.

    Raises
    ------
    InputError for a value out of range, and for rough faces (their scattered light is not followed).
    """
    cavity = _cavity(stack, emitter, wavelength_nm)
    rough = max(float(half.roughness_nm.max()) for half in (cavity.below, cavity.above))
    if rough > 0.0:
        raise InputError("roughness_nm", rough, "0 for the total power", "use interlayer() for roughness")
    largest = min(50.0, max(float(h.index.real.max()) for h in (cavity.below, cavity.above)))
    nearest = float(min(cavity.depths_nm.min(), cavity.thickness_nm - cavity.depths_nm.max()))
    if nearest < MIN_DISTANCE_NM:
        allowed = f"dipoles {MIN_DISTANCE_NM:g} nm or further from the faces, here {nearest:.2g} nm"
        mend = "nearer than an atom is large media have no index: take a thicker layer, or a smaller active_nm"
        raise InputError("depth_nm", emitter.depth_nm, allowed, mend)
    within("ray_angle_rad", ray_angle_rad, 0.01, 0.75, "the default is 0.35")
    last = 2.0 * largest + 20.0 / (float(cavity.k0_per_nm.min()) * nearest * np.cos(ray_angle_rad))
    tail = np.geomspace(2.0 * largest, last, 2 + int(np.log2(last / largest)))
    edges = np.concatenate([np.linspace(0.0, 2.0 * largest, 9)[:-1], tail])

    turn = np.exp(-1j * ray_angle_rad)
    return 1.0 + integral(lambda t: (_returning(cavity, t * turn) * turn).real, edges)


def line_average(values: ArrayLike, weights: ArrayLike) -> Real:
    """`values` (wavelength, ...) averaged over an emission line, as (...); `weights` (wavelength,), any scale."""
    weight = reals("weights", weights)
    if weight.ndim != 1 or np.any(weight < 0.0) or not np.isfinite(weight.sum()) or weight.sum() <= 0.0:
        raise InputError("weights", weights, "one finite number >= 0 per wavelength, not all 0", "the spectrum")
    mean: Real = np.tensordot(weight / weight.sum(), np.asarray(values, float), axes=1)
    return mean


def _cavity(stack: Stack | RowsAt, emitter: Emitter, wavelength_nm: ArrayLike) -> _Cavity:
    """The stack split at the emitting layer, and the depths over which the dipoles are spread."""
    wavelength = wavelengths_nm(wavelength_nm)
    rows = rows_function(stack)(wavelength)
    m, layers = emitter.layer, len(rows.thickness_nm)
    if m > layers:
        raise InputError("layer", m, f"1 to {layers}", "the emitting layer must be a layer of the stack")
    if not rows.coherent.all():
        raise InputError("coherent", False, "True in every layer", "take the thick layer as the half space")
    if np.any(rows.index[:, m].imag > 0.0):
        raise InputError("k", complex(rows.index[0, m]), "0 in the emitting layer", "its absorption is not modelled")
    thickness, half = float(rows.thickness_nm[m - 1]), emitter.active_nm / 2.0
    if not (half <= emitter.depth_nm <= thickness - half and 0.0 < emitter.depth_nm < thickness):
        raise InputError("depth_nm", emitter.depth_nm, f"the active layer within 0 to {thickness:g} nm", "move it")
    count = 1 if half == 0.0 else 12 + int(4.0 * np.pi * half * float((rows.index[:, m].real / wavelength).max()))
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return _Cavity(
        below=section(rows, 0, m),
        above=flipped(section(rows, m, layers + 1)),
        wavelength_nm=wavelength,
        index=rows.index[:, m].real,
        thickness_nm=thickness,
        depths_nm=emitter.depth_nm + half * nodes,
        weights=weights / 2.0,
        vertical={"horizontal": 0.0, "vertical": 1.0, "isotropic": 1.0 / 3.0}[emitter.orientation],
    )


def _outer_index(cavity: _Cavity, side: Side) -> Real:
    """Index (wavelength, 1) of the half space of one side, which must not absorb."""
    if side not in get_args(Side):
        raise InputError("side", side, " | ".join(get_args(Side)), "where the light arrives")
    index = (cavity.above if side == "outside" else cavity.below).index[:, :1]
    if np.any(index.imag > 0.0):
        raise InputError(side, complex(index[0, 0]), "k = 0 where light is to arrive", "ask for the clear side")
    return index.real


def _kz(cavity: _Cavity, u: Complex | Real) -> Complex:
    """k_z / k0 in the emitting layer; kept off 0, where the waves up and down are the same."""
    return _normal(cavity.index[:, None], u)


def _normal(n: Complex | Real, u: Complex | Real) -> Complex:
    squared = n**2 - u**2 + 0j
    kz: Complex = np.sqrt(np.where(np.abs(squared) < 1e-14, 1e-14, squared))
    return kz


def _intensity(cavity: _Cavity, u: Real, side: Side) -> Real:
    """Power to one side per solid angle in the emitting layer (|cos| beyond its index): (wavelength, s p, u)."""
    near, far = (cavity.above, cavity.below) if side == "outside" else (cavity.below, cavity.above)
    to, fro = (
        solve(half.index, half.thickness_nm, half.roughness_nm, cavity.wavelength_nm, u) for half in (near, far)
    )
    kz = _kz(cavity, u)
    n, n_o = cavity.index[:, None], near.index[:, :1]
    kz_o = _normal(n_o, u)
    t_s, t_p = to.t_outside_to_inside[:, 0], to.t_outside_to_inside[:, 1] * n_o / n
    pass_s = np.abs(t_s) ** 2 * kz_o.real / np.abs(kz)
    pass_p = np.abs(t_p) ** 2 * (kz_o / n_o**2).real / np.abs(kz / n**2)
    sine2, cosine2 = (u / n) ** 2, np.abs(kz / n) ** 2
    out = np.zeros((len(n), 2, u.shape[-1]))
    for depth, weight in zip(cavity.depths_nm, cavity.weights, strict=True):
        z_near = cavity.thickness_nm - depth if side == "outside" else depth
        way = np.exp(1j * cavity.k0_per_nm * kz * z_near)[:, None]
        back = np.exp(2j * cavity.k0_per_nm * kz * (cavity.thickness_nm - z_near))[:, None] * fro.r_outside
        gain = np.abs(way / (1.0 - to.r_outside * way**2 * back)) ** 2 * weight * 3.0 / (16.0 * np.pi)
        flat, upright = gain * (1.0 - cavity.vertical), 2.0 * gain * cavity.vertical
        out[:, 0] += flat[:, 0] * np.abs(1.0 + back[:, 0]) ** 2 * pass_s
        out[:, 1] += flat[:, 1] * cosine2 * np.abs(1.0 - back[:, 1]) ** 2 * pass_p
        out[:, 1] += upright[:, 1] * sine2 * np.abs(1.0 + back[:, 1]) ** 2 * pass_p
    return out


def _returning(cavity: _Cavity, u: Complex) -> Complex:
    """Integrand of the total power minus 1, as (wavelength, u), per du with u complex."""
    k0, kz, n = cavity.k0_per_nm, _kz(cavity, u), cavity.index[:, None]
    r_u, r_d = (_reflection(half, k0, u) for half in (cavity.above, cavity.below))
    v, c = u / n, kz / n
    total = np.zeros_like(kz)
    for depth, weight in zip(cavity.depths_nm, cavity.weights, strict=True):
        A = r_u * np.exp(2j * k0 * kz * (cavity.thickness_nm - depth))
        B = r_d * np.exp(2j * k0 * kz * depth)
        s, p = (A * B) * 2.0 / (1.0 - A * B), (A + B) / (1.0 - A * B)
        horizontal = 0.75 * v / c * (s[0] + p[0] + c**2 * (s[1] - p[1]))
        vertical = 1.5 * v**3 / c * (s[1] + p[1])
        total += weight * ((1.0 - cavity.vertical) * horizontal + cavity.vertical * vertical)
    return total / n


def _reflection(half: StackRows, k0: Real, u: Complex) -> Complex:
    """r_s, r_p (polarisation, wavelength, u) from the emitting layer, at complex u, which `solve` does not take."""
    kz = np.sqrt(half.index[:, :, None] ** 2 - u**2)
    both = []
    for y in (kz, kz / half.index[:, :, None] ** 2):
        r = np.zeros_like(kz[:, 0])
        for j in range(kz.shape[1] - 1):
            face = (y[:, j + 1] - y[:, j]) / (y[:, j + 1] + y[:, j])
            if j > 0:
                r = r * np.exp(2j * k0 * kz[:, j] * half.thickness_nm[j - 1])
            r = (face + r) / (1.0 + face * r)
        both.append(r)
    return np.stack(both)
