"""Amplitudes of one plane wave in a stack: wave numbers, faces, and Airy's recursion through them.

Equations and signs: head of `transfer_matrix`. Media are numbered from the inside bulk outwards; direction `d` is 0
for light from the outside, 1 from the inside.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from containers.compiled import kernel

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_KZ_SQUARED_MIN = 1e-11
"""Least |kz^2 / n^2| of a layer: at u = n exactly the waves to and fro are the same function."""


@kernel
def wave_numbers(index: Complex, thickness: Real, k0: float, u: float, kz: Complex, phase: Complex) -> None:
    """Fill kz (in units of k0) of every medium and exp(i kz k0 d) of every layer."""
    last = index.size - 1
    for j in range(last + 1):
        if 2 < j < last and index[j] == index[j - 2] and thickness[j - 1] == thickness[j - 3]:
            kz[j], phase[j] = kz[j - 2], phase[j - 2]  # a periodic stack needs two of each
            continue
        n2 = index[j] * index[j]
        kz2 = n2 - u * u
        if 0 < j < last and abs2(kz2) < _KZ_SQUARED_MIN**2 * abs2(n2):
            kz2 = _KZ_SQUARED_MIN * n2
        root = np.sqrt(kz2)
        kz[j] = -root if root.imag < 0.0 else root
        phase[j] = np.exp(1j * kz[j] * k0 * thickness[j - 1]) if 0 < j < last else 1.0


@kernel
def face_amplitudes(y: Complex, kz: Complex, rough: Real, k0: float, graded: bool, face: Complex, lost: Real) -> None:
    """Fill r, t of every face, `face[0]` for light from the outside and `face[1]` from the inside; same for `lost`.

    `lost` holds the single-face scattered powers (reflected, transmitted) of a wave of unit amplitude.
    """
    for j in range(rough.size):
        both = y[j] + y[j + 1]
        r = (y[j] - y[j + 1]) * inverse(both) if both != 0.0 else 0.0j
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
                lost[d, j, 0] = max(0.0, y[i].real * abs2(r_d) * (1.0 - abs2(by_r)))
                lost[d, j, 1] = max(0.0, y[o].real * abs2(t_d) * (1.0 - abs2(by_t)))
                r_d, t_d = r_d * by_r, t_d * by_t
            face[d, j, 0], face[d, j, 1] = r_d, t_d


@kernel
def airy(d: int, face: Complex, phase: Complex, rho: Complex, q: Complex) -> None:
    """Fill rho, the reflection amplitude just before each face, and q, that just after it; beyond the far end 0.

    Faces are counted from the side of incidence: `d` = 1 from the inside, 0 from the outside.
    """
    faces = face.shape[1]
    beyond = 0.0j
    rho[faces] = beyond
    for j in range(faces - 1, -1, -1):
        f = j if d else faces - 1 - j
        m = f + 1 if d else f
        q[j] = beyond * phase[m] * phase[m]
        through = face[d, f, 1] * face[1 - d, f, 1]
        beyond = face[d, f, 0] + through * q[j] * inverse(1.0 - face[1 - d, f, 0] * q[j])
        rho[j] = beyond


@kernel
def abs2(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


@kernel
def inverse(z: complex) -> complex:
    """1 / z without the scaling of the general complex division: no amplitude here comes near 1e154."""
    return z.conjugate() * (1.0 / abs2(z))
