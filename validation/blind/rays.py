"""What rays need everywhere: keyed random numbers, Fresnel's powers, a lobe, Lambert's law; as kernels."""

from __future__ import annotations

from math import cos, exp, log, pi, sin, sqrt

import numpy as np

from validation.blind.compiled import kernel

SLOTS = 16
"""Random numbers that one event of a history may ask for; asked by name, so that others do not move."""


@kernel
def mixed(state: np.uint64) -> np.uint64:
    """A 64-bit number from another: the finaliser of splitmix64 (Steele, Lea, Flood, OOPSLA 2014)."""
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


@kernel
def key_of(seed: np.uint64, history: np.uint64) -> np.uint64:
    """The key of all random numbers of a history."""
    return mixed(mixed(seed + np.uint64(0x9E3779B97F4A7C15)) ^ (history * np.uint64(0xD1342543DE82EF95)))


@kernel
def uniform(key: np.uint64, event: int, slot: int) -> float:
    """A random number in 0 to 1, both excluded, of a history's event."""
    number = np.uint64(event * SLOTS + slot + 1)
    return (float(mixed(key + number * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(11)) + 0.5) / 9007199254740992.0


@kernel
def fresnel(cosine: float, ratio: float) -> tuple[float, float]:
    """Mean reflectance of s and p, and the cosine beyond; ratio = n behind / n before; (1, 0) in total reflection."""
    square = 1.0 - (1.0 - cosine * cosine) / (ratio * ratio)
    if square <= 0.0:
        return 1.0, 0.0
    beyond = sqrt(square)
    s = (cosine - ratio * beyond) / (cosine + ratio * beyond)
    p = (ratio * cosine - beyond) / (ratio * cosine + beyond)
    return 0.5 * (s * s + p * p), beyond


@kernel
def turned(dx: float, dy: float, dz: float, theta: float, phi: float) -> tuple[float, float, float]:
    """A direction at the angle theta from (dx, dy, dz), phi about it."""
    across = sin(theta)
    a, b, c = across * cos(phi), across * sin(phi), cos(theta)
    if abs(dz) > 0.9999999:
        return a, b * dz, c * dz
    side = sqrt(dx * dx + dy * dy)
    return (
        c * dx + (a * dx * dz - b * dy) / side,
        c * dy + (a * dy * dz + b * dx) / side,
        c * dz - a * side,
    )


@kernel
def lobe(
    sigma: float, dx: float, dy: float, dz: float, u: float, v: float, key: np.uint64, event: int
) -> tuple[float, float, float]:
    """A direction about (dx, dy, dz), which goes up: Rayleigh's law of scale sigma for the angle between them.

    What would go down is drawn again; u and v are the first draw.
    """
    attempt = 0
    while True:
        x, y, z = turned(dx, dy, dz, sigma * sqrt(-2.0 * log(u)), 2.0 * pi * v)
        if z > 0.0 or sigma == 0.0:
            return x, y, z
        attempt += 1
        u, v = uniform(key, event + 4096 * attempt, 14), uniform(key, event + 4096 * attempt, 15)


@kernel
def cosine_law(u: float, v: float) -> tuple[float, float, float]:
    """A direction into z > 0 by Lambert's law."""
    across, phi = sqrt(u), 2.0 * pi * v
    return across * cos(phi), across * sin(phi), sqrt(1.0 - u)


@kernel
def normal_number(u: float, v: float) -> float:
    """A number of Gauss's law from two uniform ones (Box and Muller)."""
    return sqrt(-2.0 * log(u)) * cos(2.0 * pi * v)


@kernel
def laplace_slope(u: float, rms: float) -> float:
    """A slope of Laplace's law."""
    scale = rms / sqrt(2.0)
    return scale * log(2.0 * u) if u < 0.5 else -scale * log(2.0 * (1.0 - u))


@kernel
def decay(loss_per_um: float, rise_per_um: float, low: float, high: float, path: float) -> float:
    """What absorption leaves of light along a path from one height (as a share of T) to another; the rise goes with
    the square of the height."""
    return exp(-path * (loss_per_um + rise_per_um * (low * low + low * high + high * high) / 3.0))


@kernel
def table_at(table: np.ndarray, place: float) -> float:
    """Linear between the equal steps of a table, place from 0 to 1."""
    at = place * (table.size - 1)
    node = min(int(at), table.size - 2)
    return float(table[node] + (at - node) * (table[node + 1] - table[node]))
