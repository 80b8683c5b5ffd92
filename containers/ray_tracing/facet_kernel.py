"""A ray at a rough clear face: from facet to facet until it leaves; as kernels.

    . The face is facets with Gaussian slopes; a ray meets them in proportion to the area that they show it.
    . At each it is reflected or refracted by Fresnel's law, in a direction that may lead to another facet.
    . On its way out it is free with the share 1 / (1 + Lambda) of facets that none masks (Smith), else it meets one.

Density phi(x) (c - s x)+ of the slope x (in standard deviations) along the ray, c the cosine and s the sine of its
angle, s in standard deviations too. What a ray meets is independent of what it met before; energy is kept exactly,
and so is reciprocity: the chance to go on over the area seen, Lambda / (1 + Lambda) / (cos Lambda) on the way out, is
1 / (cos (1 + Lambda)), the same as for the way back.
"""

from __future__ import annotations

from math import erfc, exp, inf, log, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from containers.compiled import borrowing_kernel, kernel

Real = NDArray[np.float64]

MOST_HITS = 256
_FARTHEST, _MOST_STEPS, _NEAR = 8.0, 100, 1e-11
_GOLDEN, _MIX_1, _MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_MIDDLE = (
    (
        2.5090809287301226727e3, 3.3430575583588128105e4, 6.7265770927008700853e4, 4.5921953931549871457e4,
        1.3731693765509461125e4, 1.9715909503065514427e3, 1.3314166789178437745e2, 3.3871328727963666080,
    ),
    (
        5.2264952788528545610e3, 2.8729085735721942674e4, 3.9307895800092710610e4, 2.1213794301586595867e4,
        5.3941960214247511077e3, 6.8718700749205790830e2, 4.2313330701600911252e1, 1.0,
    ),
)  # fmt: skip
_SIDES = (
    (
        7.74545014278341407640e-4, 2.27238449892691845833e-2, 2.41780725177450611770e-1, 1.27045825245236838258,
        3.64784832476320460504, 5.76949722146069140550, 4.63033784615654529590, 1.42343711074968357734,
    ),
    (
        1.05075007164441684324e-9, 5.47593808499534494600e-4, 1.51986665636164571966e-2, 1.48103976427480074590e-1,
        6.89767334985100004550e-1, 1.67638483018380384940, 2.05319162663775882187, 1.0,
    ),
)  # fmt: skip
_TAILS = (
    (
        2.01033439929228813265e-7, 2.71155556874348757815e-5, 1.24266094738807843860e-3, 2.65321895265761230930e-2,
        2.96560571828504891230e-1, 1.78482653991729133580, 5.46378491116411436990, 6.65790464350110377720,
    ),
    (
        2.04426310338993978564e-15, 1.42151175831644588870e-7, 1.84631831751005468180e-5, 7.86869131145613259100e-4,
        1.48753612908506148525e-2, 1.36929880922735805310e-1, 5.99832206555887937690e-1, 1.0,
    ),
)  # fmt: skip
_1, _2, _3, _4 = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)


@borrowing_kernel
def seen_below(x: float, cosine: float, sine: float) -> float:
    """Area seen of facets with slopes below x, over that of the face."""
    return cosine * 0.5 * erfc(-x / sqrt(2.0)) + sine * exp(-0.5 * x * x) / sqrt(2.0 * pi)


@borrowing_kernel
def slope_at(u: float, cosine: float, sine: float) -> float:
    """The slope, in standard deviations, below which lies the share u of the area that a ray sees.

    At normal incidence the normal quantile; else Newton's way from there, which on a nearly smooth face is short.
    """
    low, high = -_FARTHEST, _FARTHEST
    x = min(max(normal_quantile(u), low), high)
    if sine <= 0.0:
        return x
    if cosine < high * sine:
        high = max(cosine / sine, low)
        x = min(x, 0.5 * (low + high))
    wanted = u * seen_below(high, cosine, sine)
    for _ in range(_MOST_STEPS):
        excess = seen_below(x, cosine, sine) - wanted
        if excess > 0.0:
            high = x
        else:
            low = x
        rate = exp(-0.5 * x * x) / sqrt(2.0 * pi) * (cosine - sine * x)
        following = x - excess / rate if rate > 0.0 else high + 1.0
        if not low < following < high:
            following = 0.5 * (low + high)
        step, x = abs(following - x), following
        if step < _NEAR:
            break
    return x


@borrowing_kernel
def normal_quantile(u: float) -> float:
    """Where the normal distribution reaches u, to 1e-14 of the value: algorithm AS 241, PPND16 (Wichura, Appl. Stat.
    37, 477, 1988); -inf and inf at 0 and 1."""
    q = u - 0.5
    if abs(q) <= 0.425:
        r = 0.180625 - q * q
        return q * _ratio(r, _MIDDLE)
    r = min(u, 1.0 - u)
    if r <= 0.0:
        return -inf if q < 0.0 else inf
    r = sqrt(-log(r))
    x = _ratio(r - 1.6, _SIDES) if r <= 5.0 else _ratio(r - 5.0, _TAILS)
    return -x if q < 0.0 else x


@borrowing_kernel
def _ratio(r: float, both: tuple[tuple[float, ...], tuple[float, ...]]) -> float:
    """The ratio of two polynomials of the seventh degree, coefficients from the highest down."""
    above, below = both[0][0], both[1][0]
    for k in range(1, 8):
        above, below = above * r + both[0][k], below * r + both[1][k]
    return above / below


@borrowing_kernel
def unmasked(cosine: float, deviation: float) -> float:
    """Smith's G1 = 1 / (1 + Lambda) of Gaussian slopes: the share of rays at this angle that no facet masks."""
    spread = deviation * sqrt(max(0.0, 1.0 - cosine * cosine))
    if cosine > _FARTHEST * spread:
        return 1.0
    return cosine / seen_below(cosine / spread, cosine, spread) if cosine > 0.0 else 0.0


@borrowing_kernel
def fresnel(n_in: float, n_out: float, cosine: float) -> tuple[float, float]:
    """R of a clear face, mean of s and p, and the cosine beyond it (0 under total reflection)."""
    ratio = n_in / n_out
    beyond2 = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    if beyond2 <= 0.0:
        return 1.0, 0.0
    beyond = sqrt(beyond2)
    s = (n_in * cosine - n_out * beyond) / (n_in * cosine + n_out * beyond)
    p = (n_out * cosine - n_in * beyond) / (n_out * cosine + n_in * beyond)
    return 0.5 * (s * s + p * p), beyond


@borrowing_kernel
def meet_facet(
    n_in: float, n_out: float, deviation: float, x: float, y: float, z: float, u: float, v: float, w: float
) -> tuple[bool, float, float, float]:
    """Whether a ray that meets a facet goes through it, and its direction, in the frame of the side it came from.

    u and v choose the slopes along and across the ray, w between reflection and refraction.
    """
    flat = sqrt(x * x + y * y)
    ex, ey = (-x / flat, -y / flat) if flat > 0.0 else (1.0, 0.0)
    along = deviation * slope_at(u, -z, deviation * flat)
    across = deviation * slope_at(v, 1.0, 0.0)
    length = 1.0 / sqrt(1.0 + along * along + across * across)
    hx, hy, hz = -(along * ex - across * ey) * length, -(along * ey + across * ex) * length, length
    cosine = min(max(-(x * hx + y * hy + z * hz), 0.0), 1.0)
    R, beyond = fresnel(n_in, n_out, cosine)
    if w < R:
        return False, x + 2.0 * cosine * hx, y + 2.0 * cosine * hy, z + 2.0 * cosine * hz
    ratio = n_in / n_out
    by = ratio * cosine - beyond
    return True, ratio * x + by * hx, ratio * y + by * hy, ratio * z + by * hz


@kernel
def walk_many(n_in: float, n_out: float, deviation: float, theta: Real, seeds: NDArray[np.uint64], out: Real) -> None:
    """Where rays go: directions (n, 3) into `out`, in surface space; further random numbers follow from `seeds`."""
    for i in range(theta.size):
        key, hit = seeds[i], np.uint64(0)
        x, y, z = np.sin(theta[i]), 0.0, -np.cos(theta[i])
        here, there, side = n_in, n_out, 1.0
        for _ in range(MOST_HITS):
            u, v, w, e = _number(key, hit), _number(key, hit + _1), _number(key, hit + _2), _number(key, hit + _3)
            hit += _4
            through, x, y, z = meet_facet(here, there, deviation, x, y, z, u, v, w)
            if through:
                here, there, side, z = there, here, -side, -z
            if z > 0.0 and e < unmasked(z, deviation):
                break
        length = 1.0 / sqrt(x * x + y * y + z * z)
        out[i, 0], out[i, 1], out[i, 2] = x * length, y * length, side * abs(z) * length


@borrowing_kernel
def _number(key: np.uint64, count: np.uint64) -> float:
    """A number in (0, 1) for a key and a count: the mixing function of SplitMix64 (Steele, Lea, Flood, 2014)."""
    z = key + _GOLDEN * (count + _1)
    z = (z ^ (z >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    z = z ^ (z >> _31)
    return (float(z >> _11) + 0.5) * 2.0**-53
