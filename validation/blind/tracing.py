"""Whole histories, laid into maps: a lone chip's light, what its module changes, one bounce; as kernels.

The first random numbers of a history are points of an additive recurrence (Roberts' golden ratio), shifted by
the seed: they fill the cube evenly. All later ones are keyed by history and event. What a module changes is the
difference between two histories with the same numbers, one in the module and one above an endless even substrate.
"""

from __future__ import annotations

from math import cos, exp, floor, pi, sin, sinh, sqrt
from typing import NamedTuple

import numpy as np

from validation.blind.chip import DX, DY, DZ, FAINT, RAY, WEIGHT, Body, X, Y, Z, next_exit
from validation.blind.compiled import kernel
from validation.blind.ground import (
    LAND_COSINE,
    LAND_WEIGHT,
    LAND_X,
    LAND_Y,
    LANDING,
    LANDINGS,
    Ground,
    fly,
    gloss_at,
    out_of_frame,
    receiver_height,
)
from validation.blind.rays import cosine_law, key_of, uniform
from validation.blind.words import Real

POINTS = 8
RIM_UM = (30.0, 70.0)


class Scratch(NamedTuple):
    """What kernels write on; they make no arrays."""

    ray: Real
    out: Real
    other: Real
    inside: Real
    at: Real
    landings: Real


def scratch() -> Scratch:
    """Of one caller."""
    ray, out, other, inside = np.zeros((4, RAY))
    return Scratch(ray, out, other, inside, np.zeros(POINTS), np.zeros((LANDINGS, LANDING)))


@kernel
def copied(ray: Real, to: Real) -> None:
    """A ray in another's place."""
    for number in range(RAY):
        to[number] = ray[number]


@kernel
def found_in(cumulative: Real, share: float) -> int:
    """The first place whose cumulative share is above `share`."""
    low, high = 0, cumulative.size - 1
    while low < high:
        middle = (low + high) // 2
        if cumulative[middle] > share:
            high = middle
        else:
            low = middle + 1
    return low


@kernel
def point(number: int, step: Real, shift: Real, found: Real) -> None:
    """The next point of the recurrence."""
    for axis in range(POINTS):
        at = shift[axis] + number * step[axis]
        found[axis] = min(max(at - floor(at), 1e-15), 1.0 - 1e-15)


@kernel
def tally(
    ground: Ground, slant: float, landings: Real, count: int, x: float, y: float, weight: float, step: float,
    light: Real,
) -> None:  # fmt: skip
    """Add landings, moved by (x, y), to maps (plane, y, x): 0 what is recorded, 1 what Lambert's law sends back."""
    size = light.shape[1]
    for number in range(count):
        column = floor((landings[number, LAND_X] + x) / step) + size // 2
        row = floor((landings[number, LAND_Y] + y) / step) + size // 2
        if not (0 <= column < size and 0 <= row < size):
            continue
        arrived, cosine = weight * landings[number, LAND_WEIGHT], landings[number, LAND_COSINE]
        if light.shape[0] == 1:
            light[0, row, column] += arrived
        else:
            light[0, row, column] += arrived * cosine**slant
            light[1, row, column] += arrived * (1.0 - gloss_at(ground, cosine) / ground.most_gloss)


@kernel
def born(body: Body, half: float, at: Real, ray: Real) -> None:
    """Light begins in a chip, its place and direction by a point, its weight 1 on average over all directions."""
    if body.sphere:
        axis, along, weight = 4, 1.0 - 2.0 * at[0], 1.0
    else:
        axis = min(int(at[0] * 6.0), 5)
        beside = 1.0 if axis >= 4 else body.beside
        solid = 1.0 - sqrt(1.0 - (beside / body.n) ** 2)
        along, weight = 1.0 - solid * (at[0] * 6.0 - axis), 3.0 * solid
    across, phi = sqrt(max(0.0, 1.0 - along * along)), 2.0 * pi * at[1]
    if axis % 2 and not body.sphere:
        along = -along
    p, q = across * cos(phi), across * sin(phi)
    ray[DX], ray[DY], ray[DZ] = (along, p, q) if axis < 2 else (q, along, p) if axis < 4 else (p, q, along)
    x, y = at[2] - 0.5, at[3] - 0.5
    if body.dipoles != 0.0:
        weight *= exp(body.dipoles * (1.0 - ray[DZ] * ray[DZ])) / body.dipoles_mean
    if body.crowding != 0.0:
        weight *= exp(-body.crowding * x) * 0.5 * body.crowding / sinh(0.5 * body.crowding)
    if body.pad > 0.0:
        near = (0.5 - x * body.pad_x) ** 2 + (0.5 - y * body.pad_y) ** 2 < body.pad * body.pad
        weight *= 0.0 if near else 1.0 / (1.0 - 0.25 * pi * body.pad * body.pad)
    ray[X], ray[Y], ray[Z] = 2.0 * half * x, 2.0 * half * y, body.low + (body.high - body.low) * at[4]
    if body.sphere and _trapped(body, ray):
        weight = 0.0
    ray[WEIGHT] = weight


@kernel
def _trapped(body: Body, ray: Real) -> bool:
    """Whether a direction never leaves a chip whose faces only mirror it."""
    if body.ripple > 0.0 or not (body.mirrored or (body.sigma == 0.0 and body.second_share == 0.0)):
        return False
    of_top, of_sides = sqrt(1.0 - 1.0 / body.n**2), sqrt(1.0 - (body.beside / body.n) ** 2)
    return bool(abs(ray[DZ]) < of_top and abs(ray[DX]) < of_sides and abs(ray[DY]) < of_sides)


@kernel
def outwards(ground: Ground, body: Body, chip: int, ray: Real) -> None:
    """A ray that left a chip, from the chip's frame to the module's; a chip that leans turns it about y."""
    if body.lean_sin != 0.0:
        x, z, dx, dz = ray[X], ray[Z], ray[DX], ray[DZ]
        ray[X], ray[Z] = x * body.lean_cos + z * body.lean_sin, max(0.0, z * body.lean_cos - x * body.lean_sin)
        ray[DX], ray[DZ] = dx * body.lean_cos + dz * body.lean_sin, dz * body.lean_cos - dx * body.lean_sin
    out_of_frame(ground, chip, ray)


@kernel
def glow(out: Real, body: Body, key: np.uint64, event: int, rim: Real) -> None:
    """Take the rim's share of an exit, which starts anew from the ring about the chip."""
    out[WEIGHT] *= 1.0 - body.rim
    u, v = uniform(key, event, 5), uniform(key, event, 6)
    radius = sqrt(RIM_UM[0] ** 2 + uniform(key, event, 7) * (RIM_UM[1] ** 2 - RIM_UM[0] ** 2))
    turn = 2.0 * pi * uniform(key, event, 8)
    rim[X], rim[Y], rim[Z] = radius * cos(turn), radius * sin(turn), body.thickness
    rim[DX], rim[DY], rim[DZ] = cosine_law(u, v)
    rim[WEIGHT] = out[WEIGHT] * body.rim / (1.0 - body.rim)


@kernel
def lone_chip(
    ground: Ground, body: Body, slant: float, seed: np.uint64, first: int, count: int, steps: Real, shift: Real,
    step: float, light: Real, scratch: Scratch,
) -> None:  # fmt: skip
    """The light of one chip at the origin before it meets the receiver twice, into `light`."""
    ray, out, rim, more, at, landings = scratch
    for history in range(first, first + count):
        point(history, steps, shift, at)
        key = key_of(seed, np.uint64(history))
        born(body, ground.halves[0], at, ray)
        event, exits, faint = 0, 0, FAINT * ray[WEIGHT]
        while ray[WEIGHT] > 0.0:
            event = next_exit(body, ground.halves[0], ray, out, key, event, True, faint)
            if event < 0:
                break
            if body.rim > 0.0:
                glow(out, body, key, event, rim)
                landed, _ = fly(ground, body, rim, key, event * 64 + 32, 0.5, 0.5, more, landings)
                tally(ground, slant, landings, landed, 0.0, 0.0, 1.0, step, light)
            outwards(ground, body, 0, out)
            u, v = (at[5] + 0.6180339887498949 * exits) % 1.0, (at[6] + 0.7548776662466927 * exits) % 1.0
            landed, _ = fly(ground, body, out, key, event * 64, max(u, 1e-15), v, more, landings)
            tally(ground, slant, landings, landed, 0.0, 0.0, 1.0, step, light)
            exits += 1


@kernel
def module_change(
    full: Ground, lone: Ground, body: Body, even: bool, power: Real, slant: float, seed: np.uint64, first: int,
    count: int, steps: Real, shift: Real, step: float, light: Real, scratch: Scratch,
) -> None:  # fmt: skip
    """What the module changes of the first light of all its chips, into `light`; even: by chips and edges alone."""
    ray, out, keep, more, at, landings = scratch
    chips = power.size
    for history in range(first, first + count):
        point(history, steps, shift, at)
        key = key_of(seed, np.uint64(history))
        chip = min(int(at[7] * chips), chips - 1)
        weight, half = chips * power[chip], full.halves[chip]
        lone.halves[0] = half
        born(body, half, at, ray)
        event, exits, faint = 0, 0, FAINT * ray[WEIGHT]
        while ray[WEIGHT] > 0.0:
            event = next_exit(body, half, ray, out, key, event, True, faint)
            if event < 0:
                break
            copied(out, keep)
            outwards(full, body, chip, out)
            u, v = (at[5] + 0.6180339887498949 * exits) % 1.0, (at[6] + 0.7548776662466927 * exits) % 1.0
            u = max(u, 1e-15)
            landed, touched = fly(full, body, out, key, event * 64, u, v, more, landings)
            exits += 1
            if even and not touched:
                continue
            tally(full, slant, landings, landed, 0.0, 0.0, weight, step, light)
            outwards(lone, body, 0, keep)
            landed, _ = fly(lone, body, keep, key, event * 64, u, v, more, landings)
            x, y = full.centres[chip, 0], full.centres[chip, 1]
            tally(full, slant, landings, landed, x, y, -weight, step, light)


@kernel
def bounce_kernel(
    plain: Ground, body: Body, slant: float, seed: np.uint64, first: int, count: int, steps: Real, shift: Real,
    step: float, light: Real, scratch: Scratch,
) -> None:  # fmt: skip
    """Where light that leaves the receiver at the origin by Lambert's law meets it again, without chips."""
    ray, _, _, more, at, landings = scratch
    for history in range(first, first + count):
        point(history, steps, shift, at)
        key = key_of(seed, np.uint64(history))
        ray[DX], ray[DY], down = cosine_law(at[0], at[1])
        ray[X], ray[Y], ray[Z], ray[DZ], ray[WEIGHT] = 0.0, 0.0, plain.distance, -down, 1.0
        landed, _ = fly(plain, body, ray, key, 0, at[2], at[3], more, landings)
        tally(plain, slant, landings, landed, 0.0, 0.0, 1.0, step, light)


@kernel
def bounce_change(
    full: Ground, plain: Ground, body: Body, even: bool, slant: float, seed: np.uint64, first: int, count: int,
    steps: Real, shift: Real, step: float, source: Real, rows: Real, columns: Real, light: Real,
    scratch: Scratch,
) -> None:  # fmt: skip
    """What the module changes of one bounce of the light `source` (y, x), into `light`.

    rows (y,), columns (y, x): cumulative shares of the source, by which places are drawn; its sum is the flux.
    """
    ray, _, keep, more, at, landings = scratch
    size = source.shape[0]
    for history in range(first, first + count):
        point(history, steps, shift, at)
        key = key_of(seed, np.uint64(history))
        row = found_in(rows, at[0])
        column = found_in(columns[row], at[1])
        before, after = rows[row - 1] if row > 0 else 0.0, rows[row]
        y = row + (at[0] - before) / max(after - before, 1e-300) - size // 2
        before, after = columns[row, column - 1] if column > 0 else 0.0, columns[row, column]
        x = column + (at[1] - before) / max(after - before, 1e-300) - size // 2
        ray[X] = min(max(x * step, -full.half), full.half)
        ray[Y] = min(max(y * step, -full.half), full.half)
        ray[DX], ray[DY], down = cosine_law(at[2], at[3])
        ray[DZ], ray[WEIGHT] = -down, 1.0
        ray[Z] = plain.distance
        copied(ray, keep)
        _on_plate(full, ray, even)
        landed, touched = fly(full, body, ray, key, 0, at[4], at[5], more, landings)
        if even and not touched:
            continue
        tally(full, slant, landings, landed, 0.0, 0.0, 1.0, step, light)
        landed, _ = fly(plain, body, keep, key, 0, at[4], at[5], more, landings)
        tally(full, slant, landings, landed, 0.0, 0.0, -1.0, step, light)


@kernel
def _on_plate(full: Ground, ray: Real, even: bool) -> None:
    """Put a ray that leaves the receiver onto the plate as it is, its direction about the plate's own normal."""
    if even:
        return
    near, x, y = 0.5, ray[X], ray[Y]
    ray[Z] = receiver_height(full, x, y)
    p = (receiver_height(full, x + near, y) - receiver_height(full, x - near, y)) / (2.0 * near)
    q = (receiver_height(full, x, y + near) - receiver_height(full, x, y - near)) / (2.0 * near)
    dx, dy, dz = ray[DX] + p * -ray[DZ], ray[DY] + q * -ray[DZ], ray[DZ] + p * ray[DX] + q * ray[DY]
    if dz < -1e-6:
        length = 1.0 / sqrt(dx * dx + dy * dy + dz * dz)
        ray[DX], ray[DY], ray[DZ] = dx * length, dy * length, dz * length
