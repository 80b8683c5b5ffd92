"""The way of a ray inside a chip, face by face, from one exit to the next; as kernels.

    z = T   ┌───────────────┐  top: powers of the film
            │   index n     │  sides: Fresnel against air or resin, rippled or partly of metal
    z = 0   └───────────────┘  bottom: a mirror, or the substrate's lobe
          -W/2      0      W/2

Positions are relative to the chip's centre. Nothing is unfolded or kept: each face is met as it comes.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from validation.blind.compiled import kernel
from validation.blind.rays import decay, fresnel, laplace_slope, lobe, table_at, uniform
from validation.blind.words import Real

X, Y, Z, DX, DY, DZ, WEIGHT, RAY = range(8)
FAINT = 0.02
"""Below this share of its first weight light in a chip goes on by chance."""
MOST_FACES = 200_000
METAL = 0.85
FACETS = 8


class Body(NamedTuple):
    """A chip: what it is made of and how it shines; the side comes with each chip."""

    thickness: float
    n: float
    beside: float
    """Index that the side faces meet."""
    loss: float
    """Absorption in 1/um at the bottom."""
    rise: float
    """What it has more at the top."""
    mirrored: bool
    """Bottom: a mirror, else the substrate itself."""
    reflectance: float
    """Of the bottom."""
    sigma: float
    second_share: float
    second_sigma: float
    """Of the substrate's lobes, for a bottom in contact."""
    ripple: float
    """Rms slope of the side faces."""
    metal: float
    """Share of the face at +x that is a mirror."""
    low: float
    high: float
    """The emitting layer, in um."""
    dipoles: float
    dipoles_mean: float
    """a of exp(a sin^2 theta), and that law's mean over directions."""
    crowding: float
    pad: float
    """Radius of a dark quarter disc over W."""
    pad_x: float
    pad_y: float
    """Its corner, +-1."""
    sphere: bool
    """Light is born into all directions, not into the escape cones alone."""
    lean_cos: float
    lean_sin: float
    rim: float
    """Share of the light that comes out of a ring about the chip."""
    inside: Real
    passed: Real
    beyond: Real
    outside: Real
    """The film's powers, see `film.Film`."""


@kernel
def next_exit(
    body: Body, half: float, ray: Real, out: Real, key: np.uint64, event: int, split: bool, faint: float
) -> int:
    """Go on inside the chip to the next exit and write it to `out`; the event there, or -1 where the ray has ended.

    split: the light is divided at faces, what stays inside stays in `ray`; else it goes either way by chance.
    faint: weight below which it goes on by chance.
    """
    top, index = body.thickness, body.n
    for _ in range(MOST_FACES):
        weight = ray[WEIGHT]
        if weight < faint or weight <= 0.0:
            if weight <= 0.0 or uniform(key, event, 0) * faint > weight:
                return -1
            ray[WEIGHT] = faint
        dx, dy, dz = ray[DX], ray[DY], ray[DZ]
        to_x = ((half if dx > 0.0 else -half) - ray[X]) / dx if dx != 0.0 else 1e300
        to_y = ((half if dy > 0.0 else -half) - ray[Y]) / dy if dy != 0.0 else 1e300
        to_z = ((top if dz > 0.0 else 0.0) - ray[Z]) / dz if dz != 0.0 else 1e300
        path = max(0.0, min(to_x, to_y, to_z))
        low = ray[Z] / top
        ray[X] += path * dx
        ray[Y] += path * dy
        ray[Z] = min(max(ray[Z] + path * dz, 0.0), top)
        ray[WEIGHT] *= decay(body.loss, body.rise, low, ray[Z] / top, path)
        event += 1
        if to_z <= to_x and to_z <= to_y:
            if dz < 0.0:
                ray[Z] = 0.0
                _bottom(body, ray, key, event)
                continue
            ray[Z] = top
            if _top(body, ray, out, key, event, split):
                return event
            continue
        along_x = to_x <= to_y
        if along_x:
            ray[X] = half if dx > 0.0 else -half
        else:
            ray[Y] = half if dy > 0.0 else -half
        if _side(body, ray, out, key, event, split, along_x, index):
            return event
    return -1


@kernel
def _bottom(body: Body, ray: Real, key: np.uint64, event: int) -> None:
    ray[WEIGHT] *= body.reflectance
    if body.mirrored:
        ray[DZ] = -ray[DZ]
        return
    sigma = body.sigma
    if body.second_share > 0.0 and uniform(key, event, 3) < body.second_share:
        sigma = body.second_sigma
    u, v = uniform(key, event, 1), uniform(key, event, 2)
    ray[DX], ray[DY], ray[DZ] = lobe(sigma, ray[DX], ray[DY], -ray[DZ], u, v, key, event)


@kernel
def _top(body: Body, ray: Real, out: Real, key: np.uint64, event: int, split: bool) -> bool:
    """Whether there is light outside; it then is in `out`."""
    cosine, index = ray[DZ], body.n
    square = 1.0 - index * index * (1.0 - cosine * cosine)
    if square <= 0.0:
        ray[WEIGHT] *= table_at(body.beyond, sqrt(min(1.0, -square / (index * index - 1.0))))
        ray[DZ] = -cosine
        return False
    in_air = sqrt(square)
    return _shared(ray, out, key, event, split, table_at(body.inside, in_air), table_at(body.passed, in_air),
                   index * ray[DX], index * ray[DY], in_air, 2)  # fmt: skip


@kernel
def _side(
    body: Body, ray: Real, out: Real, key: np.uint64, event: int, split: bool, along_x: bool, index: float
) -> bool:
    """The same at a side face."""
    normal, across = (ray[DX], ray[DY]) if along_x else (ray[DY], ray[DX])
    if body.ripple > 0.0:
        return _rippled_side(body, ray, out, key, event, along_x)
    R, cosine = fresnel(abs(normal), body.beside / index)
    T = 1.0 - R
    if along_x and normal > 0.0 and body.metal > 0.0:
        R, T = body.metal * METAL + (1.0 - body.metal) * R, (1.0 - body.metal) * T
    scale = index / body.beside
    cosine = cosine if normal > 0.0 else -cosine
    if along_x:
        return _shared(ray, out, key, event, split, R, T, cosine, across * scale, ray[DZ] * scale, 0)
    return _shared(ray, out, key, event, split, R, T, across * scale, cosine, ray[DZ] * scale, 1)


@kernel
def _shared(
    ray: Real, out: Real, key: np.uint64, event: int, split: bool,
    R: float, T: float, dx: float, dy: float, dz: float, axis: int,
) -> bool:  # fmt: skip
    """Divide a ray at a face into what is reflected along an axis and what leaves into (dx, dy, dz)."""
    weight = ray[WEIGHT]
    leaves = T > 0.0
    if not split and leaves:
        weight *= R + T
        leaves = uniform(key, event, 4) * (R + T) < T
        R, T = (0.0, 1.0) if leaves else (1.0, 0.0)
    if leaves:
        length = 1.0 / sqrt(dx * dx + dy * dy + dz * dz)
        out[X], out[Y], out[Z] = ray[X], ray[Y], ray[Z]
        out[DX], out[DY], out[DZ], out[WEIGHT] = dx * length, dy * length, dz * length, weight * T
    ray[WEIGHT] = weight * R
    ray[DX + axis] = -ray[DX + axis]
    return leaves


@kernel
def _rippled_side(body: Body, ray: Real, out: Real, key: np.uint64, event: int, along_x: bool) -> bool:
    """A side face of upright ripples: a facet as it is seen is drawn, then met by chance, again where it sends on."""
    normal, across = (ray[DX], ray[DY]) if along_x else (ray[DY], ray[DX])
    sign = 1.0 if normal > 0.0 else -1.0
    dn, dt, dz = normal * sign, across, ray[DZ]
    for facet in range(FACETS):
        slope = 0.0
        widest = 4.0 * body.ripple
        for attempt in range(8):
            tried = laplace_slope(uniform(key, event + 8192 * (facet + 1), 2 * attempt), body.ripple)
            chance = (dn + tried * dt) / (dn + widest * abs(dt) + 1e-12)
            if abs(tried) < widest and uniform(key, event + 8192 * (facet + 1), 2 * attempt + 1) < chance:
                slope = tried
                break
        length = 1.0 / sqrt(1.0 + slope * slope)
        mn, mt = length, slope * length
        cosine = dn * mn + dt * mt
        if cosine <= 0.0:
            mn, mt, cosine = 1.0, 0.0, dn
        R, onward = fresnel(cosine, body.beside / body.n)
        if uniform(key, event + facet, 5) < R:
            dn, dt = dn - 2.0 * cosine * mn, dt - 2.0 * cosine * mt
            if dn < 0.0:
                break
            continue
        scale = body.n / body.beside
        un = scale * (dn - cosine * mn) + onward * mn
        if un <= 0.0:
            continue
        ut = scale * (dt - cosine * mt) + onward * mt
        for number in range(Z + 1):
            out[number] = ray[number]
        out[DX], out[DY] = (un * sign, ut) if along_x else (ut, un * sign)
        out[DZ], out[WEIGHT], ray[WEIGHT] = scale * dz, ray[WEIGHT], 0.0
        return True
    dn = -abs(dn)
    ray[DX], ray[DY] = (dn * sign, dt) if along_x else (dt, dn * sign)
    return False


@kernel
def enters(body: Body, ray: Real, face: int, key: np.uint64, event: int) -> bool:
    """Whether a ray that meets a chip from outside goes into it; else it is reflected, or absorbed by the film.

    face: 0 along x, 1 along y, 2 from above. A rippled face is met as an even one.
    """
    cosine, index = abs(ray[DX + face]), body.n
    u = uniform(key, event, 6)
    if face == 2:
        R, T = table_at(body.outside, cosine), table_at(body.passed, cosine)
        around = 1.0
    else:
        around = body.beside
        R, _ = fresnel(cosine, index / around)
        T = 1.0 - R
        if face == 0 and ray[DX] < 0.0 and body.metal > 0.0:
            R, T = body.metal * METAL + (1.0 - body.metal) * R, (1.0 - body.metal) * T
    sign = 1.0 if ray[DX + face] > 0.0 else -1.0
    if u >= T:
        ray[DX + face] = -ray[DX + face]
        if u >= T + R:
            ray[WEIGHT] = 0.0
        return False
    beyond = sqrt(1.0 - (1.0 - cosine * cosine) * (around / index) ** 2)
    for number in range(DX, DZ + 1):
        ray[number] *= around / index
    ray[DX + face] = sign * beyond
    return True
