"""Where the power of one plane wave in a stack goes: R, T, scattered back and onward, absorbed.

What is counted, and how scattered power is divided: head of `transfer_matrix`. `d` as in `waves`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from containers.compiled import kernel
from containers.thin_film.waves import abs2, inverse

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@kernel
def fill_budget(
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
        there = face[d, f, 1] * a * inverse(1.0 - face[1 - d, f, 0] * q[j])
        if rough[f] > 0.0:
            scattered += flux(y[m0], a, rho[j]) - flux(y[m], there, q[j])
            to, fro = abs2(a), abs2(there * q[j])
            back += to * lost[d, f, 0] + fro * lost[1 - d, f, 1]
            onward += to * lost[d, f, 1] + fro * lost[1 - d, f, 0]
        a = there * phase[m]
        if index[m].imag > 0.0:  # in the far half space nothing comes back, and both fluxes are the same
            absorbed += flux(y[m], there, q[j]) - flux(y[m], a, rho[j + 1])
    share = back / (back + onward) if back + onward > 0.0 else 0.5
    budget[0], budget[1], budget[4] = abs2(rho[0]) * y[first].real, abs2(a) * y[last].real, absorbed
    budget[2], budget[3] = share * scattered, (1.0 - share) * scattered
    return a


@kernel
def close_budget(incident: float, absorbing: bool, graded: bool, budget: Real) -> float:
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
def flux(y: complex, to: complex, ratio: complex) -> float:
    """Power flux along + of a wave `to` and its companion `ratio * to` the other way."""
    along: float = (y * (1.0 - ratio) * np.conj(1.0 + ratio)).real
    return along * abs2(to)
