"""Powers that a stack of layers between the chip and air reflects and passes on, by characteristic matrices.

    [B, C] = M_1 M_2 ... M_n [1, y_air],  M = [[cos d, i sin d / y], [i y sin d, cos d]],  r = (y_0 B - C)/(y_0 B + C)

with tilted admittances y = N cos(theta) for s, N / cos(theta) for p, N = n - i k (Macleod, Thin-Film Filters).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from validation.blind.words import Real

Complex = NDArray[np.complex128]
Layer = tuple[Complex, float]
"""Index n - i k at each wavelength, thickness in nm."""

NODES, BEYOND_NODES = 769, 257


@dataclass(frozen=True, eq=False)
class Film:
    """Means over the line and over s and p; between nodes powers are linear."""

    inside: Real
    """R from inside the chip, at equal steps of the cosine in air, 0 to 1."""
    outside: Real
    """R from the air, at the same cosines."""
    passed: Real
    """T, the same from both sides."""
    beyond: Real
    """R from inside, beyond the critical angle, at equal steps of sqrt((u^2 - 1) / (n^2 - 1)), u = n sin(theta)."""


def film(layers: Sequence[Layer], index: float, wavelength_nm: Real, weight: Real) -> Film:
    """The film of layers, from the chip outwards, on a chip of an index.

    Parameters
    ----------
    wavelength_nm, weight : (line,), the weights of sum 1.
    """
    cosine = np.linspace(0.0, 1.0, NODES)
    u = np.sqrt(1.0 - cosine**2)
    u[0] = 1.0 - 1e-12  # at grazing the admittance of p is endless
    inside, passed = _mean(_powers(layers, index, 1.0, u, wavelength_nm), weight)
    outside, beyond = inside.copy(), np.ones(BEYOND_NODES)
    if any(np.any(n.imag) for n, _ in layers):
        outside, _ = _mean(_powers(layers[::-1], 1.0, index, u, wavelength_nm), weight)
        steep = np.sqrt(1.0 + np.linspace(0.0, 1.0, BEYOND_NODES) ** 2 * (index**2 - 1.0))
        steep[0], steep[-1] = 1.0 + 1e-12, index * (1.0 - 1e-12)
        beyond, _ = _mean(_powers(layers, index, 1.0, steep, wavelength_nm), weight)
    for table in (inside, outside):
        table[0] = 1.0
    passed[0] = 0.0
    return Film(inside, outside, passed, beyond)


def _mean(powers: tuple[Real, Real], weight: Real) -> tuple[Real, Real]:
    R, T = (np.clip(np.tensordot(weight, one.mean(axis=0), axes=1), 0.0, 1.0) for one in powers)
    return R, T


def _powers(layers: Sequence[Layer], n_in: float, n_out: float, u: Real, wavelength_nm: Real) -> tuple[Real, Real]:
    """R and T, each (s and p, wavelength, u), u = k_parallel / k_0."""
    first, last = (_cosine(np.full(wavelength_nm.size, n, np.complex128), u) for n in (n_in, n_out))
    R, T = np.empty((2, 2, wavelength_nm.size, u.size))
    for p in (0, 1):
        y_in, y_out = (_admittance(n, c, p) for n, c in ((n_in, first), (n_out, last)))
        B, C = np.ones_like(y_out), y_out
        for n, thickness_nm in reversed(layers):
            cosine = _cosine(n, u)
            phase = (2.0 * np.pi * thickness_nm / wavelength_nm * n)[:, None] * cosine
            y, cos, sin = _admittance(n[:, None], cosine, p), np.cos(phase), 1j * np.sin(phase)
            B, C = cos * B + sin / y * C, y * sin * B + cos * C
        R[p] = np.abs((y_in * B - C) / (y_in * B + C)) ** 2
        T[p] = 4.0 * y_in.real * y_out.real / np.abs(y_in * B + C) ** 2
    return R, T


def _cosine(n: Complex, u: Real) -> Complex:
    """(wavelength, u); beyond the critical angle the wave decays outwards."""
    root = np.sqrt(1.0 - (u / n[:, None]) ** 2 + 0j)
    return np.where(root.imag > 0.0, -root, root)


def _admittance(n: Complex | float, cosine: Complex, p: int) -> Complex:
    return n / cosine if p else n * cosine
