"""Light through a stack with thick layers, across which powers add instead of amplitudes.

    inside | coherent group 0 | thick layer | coherent group 1 | thick layer | ... | outside

Within a group the amplitudes interfere (`transfer_matrix.solve`). A thick layer is longer than the coherence length:
each pass of the light through it adds its intensity. Three intensities are carried, because they travel alike,
each multiplied by a product of two amplitudes:

    ss = |r_s|^2,      pp = |r_p|^2,      ps = r_p conj(r_s)

ss and pp are what a detector sees; ps keeps what is left of the phase between p and s, so that an ellipsometer on a
transparent substrate sees its depolarised sum. From the far end inwards, with P the share of power that survives
one pass of the thick layer below a group,

    R = R_group + T T' P^2 R_below / (1 - R'_group P^2 R_below)
    T = T_group P T_below / (1 - R'_group P^2 R_below)

(primes: light that meets the group from below). Source: Centurioni, Appl. Opt. 44, 7532 (2005); Byrnes,
arXiv:1603.02720, of which ps is the off-diagonal counterpart.

A thick layer in which the wave is evanescent (Re kz^2 <= 0, total reflection) is opaque: P = 0. Its power products
T T' exceed 1 and would otherwise make R up to 1.97 (GaN, 50 nm glass, GaN at 37.8 deg).
Neglected: spread of the angle in the thick layer, walk-off of the higher orders past the detector, wedge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from containers.stack import StackRows
from containers.thin_film.transfer_matrix import StackResponse, solve

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Light:
    """What comes back and what goes through, for light from the outside.

    `R`, `T` : (wavelength, polarisation s, p, u) powers. `ps` : (wavelength, u) complex, the sum of r_p conj(r_s).
    """

    R: Real
    T: Real
    ps: Complex


def flipped(rows: StackRows) -> StackRows:
    """The same stack seen the other way round: inside and outside change places."""
    return replace(
        rows,
        index=rows.index[:, ::-1],
        thickness_nm=rows.thickness_nm[::-1],
        roughness_nm=rows.roughness_nm[::-1],
        coherent=rows.coherent[::-1],
        film=rows.film[::-1],
    )


def section(rows: StackRows, first: int, last: int) -> StackRows:
    """The stack between media number `first` and `last` (0 = the inside bulk), these two taken as half spaces."""
    return replace(
        rows,
        index=rows.index[:, first : last + 1],
        thickness_nm=rows.thickness_nm[first : last - 1],
        roughness_nm=rows.roughness_nm[first:last],
        coherent=rows.coherent[first : last - 1],
        film=rows.film[first : last - 1],
    )


def respond(rows: StackRows, u: Real) -> Light:
    """Powers reflected and transmitted, and the p-s correlation reflected, for light from the outside.

    Parameters
    ----------
    rows : the stack from the inside outwards; `rows.coherent` (layer,) tells thick layers from films.
    u : (U,) or (wavelength, U), k_parallel / k0, real and >= 0.

    Returns
    -------
    `Light`. Without thick layers it is that of `solve`.
    """
    thick = [int(layer) + 1 for layer in np.flatnonzero(~rows.coherent)]
    ends = [*thick, len(rows.thickness_nm) + 1]
    group = _solve(section(rows, 0, ends[0]), u)
    R, T = _with_cross(group.R_outside, group.r_outside), group.T
    for inner, outer in pairwise(ends):
        group = _solve(section(rows, inner, outer), u)
        P = _one_pass(rows, inner, u)
        below = P**2 * R
        echoes = _geometric(_with_cross(group.R_inside, group.r_inside) * below)
        to_and_fro = group.t_outside_to_inside * group.t_inside_to_outside
        R = _with_cross(group.R_outside, group.r_outside)
        R = R + _with_cross(np.abs(to_and_fro) ** 2, to_and_fro) * below * echoes
        T = group.T * P * T * echoes[:, :2].real
    return Light(R[:, :2].real.copy(), T.copy(), R[:, 2].copy())  # views would keep all that `solve` found


def _solve(group: StackRows, u: Real) -> StackResponse:
    return solve(group.index, group.thickness_nm, group.roughness_nm, group.wavelength_nm, u)


def _with_cross(power: Real, amplitude: Complex) -> Complex:
    """ss, pp, ps as (wavelength, 3, u)."""
    cross = amplitude[:, 1] * np.conj(amplitude[:, 0])
    return np.concatenate([power, cross[:, None]], axis=1)


def _one_pass(rows: StackRows, medium: int, u: Real) -> Real:
    """Share of power (wavelength, 1, u) that one pass of a thick layer leaves: 0 where the wave is evanescent."""
    kz_squared = rows.index[:, medium, None] ** 2 - u**2 + 0j
    loss = 4.0 * np.pi * rows.thickness_nm[medium - 1] / rows.wavelength_nm[:, None] * np.sqrt(kz_squared).imag
    return np.where(kz_squared.real > 0.0, np.exp(-loss), 0.0)[:, None, :]


def _geometric(ratio: Complex) -> Complex:
    """1 + ratio + ratio^2 + ...; 0 where nothing ever leaves (ratio 1), because then nothing came in either."""
    left = 1.0 - ratio
    out = np.zeros_like(left)
    np.divide(1.0, left, out=out, where=left != 0.0)
    return out
