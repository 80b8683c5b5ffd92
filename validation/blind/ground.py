"""The way of a ray between the chips, the substrate, the receiver and the module's edge; as kernels.

z = D(x, y)  ───────────────────────── receiver: landings are written down, what it mirrors goes on
                     air
z = T          ┌────┐    ┌────┐
z = 0    ──────┴────┴────┴────┴─────── substrate: its reflectance has a pattern
         |<- half ->|<- half ->|       module's edge: open, or a white frame
"""

from __future__ import annotations

from math import floor, sqrt
from typing import NamedTuple

import numpy as np

from validation.blind.chip import DX, DY, DZ, FAINT, WEIGHT, Body, X, Y, Z, enters, next_exit
from validation.blind.compiled import kernel
from validation.blind.rays import cosine_law, lobe, normal_number, uniform
from validation.blind.words import Real

PLATE_UM = 500.0
"""Bows, saddles, slopes and rims are told by their size at this distance; beyond it they go on no more."""
RING_UM = (30.0, 90.0)
LAND_X, LAND_Y, LAND_WEIGHT, LAND_COSINE, LANDING = range(5)
LANDINGS = 8
NEAR_UM = 1e-9
MOST_EVENTS = 500
NOTHING, EDGE, PANE = -1, -2, -3


class Ground(NamedTuple):
    """Everything of a module but the inside of its chips."""

    distance: float
    tilt_x: float
    tilt_y: float
    bow: float
    saddle: float
    """Of the receiver's height, relative."""
    reflectance: float
    sigma: float
    second_share: float
    second_sigma: float
    """Of the substrate: its two lobes, in rad."""
    joints: float
    """Width in um of black lines between chips."""
    ring: float
    slope: float
    rim: float
    """What the substrate reflects less: about chips, along x, outwards."""
    leak_share: float
    leak: float
    half: float
    """Of the module, in um; endless for a lone chip."""
    frame: float
    """Reflectance of Lambertian walls at the edge."""
    pane: float
    pane_x: float
    """Share that a pane at x reflects."""
    gloss: float
    """Reflectance of the receiver's face at normal incidence."""
    most_gloss: float
    pitch: float
    turn_cos: float
    turn_sin: float
    """Of all chips, in their plane."""
    rows: int
    columns: int
    centres: Real
    """(chip, 2), x and y."""
    halves: Real
    """(chip,), half the side of each."""


@kernel
def receiver_height(ground: Ground, x: float, y: float) -> float:
    """z of the receiver."""
    if ground.tilt_x == 0.0 and ground.tilt_y == 0.0 and ground.bow == 0.0 and ground.saddle == 0.0:
        return ground.distance
    cx, cy = min(max(x, -PLATE_UM), PLATE_UM), min(max(y, -PLATE_UM), PLATE_UM)
    square = PLATE_UM * PLATE_UM
    rise = ground.tilt_x * x + ground.tilt_y * y + ground.bow * min(1.0, (x * x + y * y) / square)
    return ground.distance * (1.0 + rise + ground.saddle * (cx * cx - cy * cy) / square)


@kernel
def _to_receiver(ground: Ground, ray: Real) -> float:
    """The path of a ray that goes up to the receiver; a bent one is met after a few steps."""
    path: float = (ground.distance - ray[Z]) / ray[DZ]
    if ground.tilt_x == 0.0 and ground.tilt_y == 0.0 and ground.bow == 0.0 and ground.saddle == 0.0:
        return max(0.0, path)
    for _ in range(12):
        path = (receiver_height(ground, ray[X] + path * ray[DX], ray[Y] + path * ray[DY]) - ray[Z]) / ray[DZ]
    return max(0.0, path)


@kernel
def brightness(ground: Ground, x: float, y: float) -> float:
    """Reflectance of the substrate at a place."""
    found = ground.reflectance
    if ground.slope > 0.0:
        found *= 1.0 - ground.slope * 1e-3 * (min(max(x, -PLATE_UM), PLATE_UM) + PLATE_UM)
    if ground.rim > 0.0:
        found *= 1.0 - ground.rim * min(1.0, (x * x + y * y) / (PLATE_UM * PLATE_UM))
    if ground.joints > 0.0:
        for place, count in ((x, ground.columns), (y, ground.rows)):
            from_line = place / ground.pitch + 0.5 * count
            if abs(from_line - floor(from_line + 0.5)) * ground.pitch < 0.5 * ground.joints:
                return 0.0
    if ground.ring > 0.0:
        column = min(max(floor(x / ground.pitch + 0.5 * ground.columns), 0), ground.columns - 1)
        row = min(max(floor(y / ground.pitch + 0.5 * ground.rows), 0), ground.rows - 1)
        dx = x - ground.centres[int(row) * ground.columns + int(column), 0]
        dy = y - ground.centres[int(row) * ground.columns + int(column), 1]
        if RING_UM[0] ** 2 < dx * dx + dy * dy < RING_UM[1] ** 2:
            found *= 1.0 - ground.ring
    return found


@kernel
def _find_chip(ground: Ground, top: float, ray: Real, path: float) -> tuple[float, int, int]:
    """The first chip that a ray meets within a path: how far, which one, and by which face; else NOTHING."""
    x, y, z, dx, dy, dz = ray[X], ray[Y], ray[Z], ray[DX], ray[DY], ray[DZ]
    begin, end = 0.0, path
    if dz > 0.0:
        if z >= top:
            return path, NOTHING, 0
        end = min(path, (top - z) / dz)
    elif z >= top:
        begin = (top - z) / dz if dz < 0.0 else path
        if begin >= path:
            return path, NOTHING, 0
    from_above = dz < 0.0 and z >= top
    reach = 0.75 * ground.pitch  # a chip and its displacement stay within
    x0, x1, y0, y1 = x + dx * begin, x + dx * end, y + dy * begin, y + dy * end
    origin_x, origin_y = 0.5 * (ground.columns - 1), 0.5 * (ground.rows - 1)
    first_column = int(max(0.0, floor((min(x0, x1) - reach) / ground.pitch + origin_x) + 1.0))
    last_column = int(min(ground.columns - 1.0, floor((max(x0, x1) + reach) / ground.pitch + origin_x)))
    first_row = int(max(0.0, floor((min(y0, y1) - reach) / ground.pitch + origin_y) + 1.0))
    last_row = int(min(ground.rows - 1.0, floor((max(y0, y1) + reach) / ground.pitch + origin_y)))
    cos, sin = ground.turn_cos, ground.turn_sin
    a, b = dx * cos + dy * sin, dy * cos - dx * sin
    over_a, over_b = 1.0 / a if a != 0.0 else 1e300, 1.0 / b if b != 0.0 else 1e300
    found, which, face = path, NOTHING, 0
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            chip = row * ground.columns + column
            u, v = x - ground.centres[chip, 0], y - ground.centres[chip, 1]
            u, v = u * cos + v * sin, v * cos - u * sin
            half = ground.halves[chip]
            p, q, r, s = (-half - u) * over_a, (half - u) * over_a, (-half - v) * over_b, (half - v) * over_b
            enter_u, enter_v = min(p, q), min(r, s)
            enter = max(enter_u, enter_v, begin)
            if min(max(p, q), max(r, s), end) - enter <= NEAR_UM or enter >= found:
                continue
            if enter > begin + NEAR_UM or (enter > begin and from_above):
                found, which, face = enter, chip, 0 if enter_u >= enter_v else 1
            elif from_above:
                found, which, face = begin, chip, 2
    return found, which, face


@kernel
def fly(
    ground: Ground, body: Body, ray: Real, key: np.uint64, event: int, u: float, v: float,
    out: Real, landings: Real,
) -> tuple[int, bool]:  # fmt: skip
    """Follow a ray outside the chips until it is lost or taken by the receiver.

    Its landings go to `landings` (n, LANDING). Returns how many there are, and whether it met anything that a lone
    even substrate lacks: a chip, an edge or a pane. u, v: the draw for the lobe of the substrate that comes first.
    """
    count, touched, fresh = 0, False, True
    for _ in range(MOST_EVENTS):
        event += 1
        if ray[WEIGHT] <= 0.0 or ray[DZ] == 0.0:
            break
        path = _to_receiver(ground, ray) if ray[DZ] > 0.0 else -ray[Z] / ray[DZ]
        path, chip, face = _find_chip(ground, body.thickness, ray, path)
        path, chip = _outer(ground, ray, path, chip)
        for axis in range(3):
            ray[X + axis] += path * ray[DX + axis]
        if chip != NOTHING:
            touched = True
            if chip == EDGE:
                if not _framed(ground, ray, key, event):
                    break
            elif chip == PANE:
                if uniform(key, event, 7) < ground.pane:
                    ray[DX] = -ray[DX]
                ray[X] += NEAR_UM * 10.0 * (1.0 if ray[DX] > 0.0 else -1.0)
            else:
                event = _at_chip(ground, body, ray, chip, face, key, event, out)
                if event < 0:
                    break
        elif ray[DZ] > 0.0:
            cosine = ray[DZ]
            _land(landings, count, ray, cosine)
            count += 1
            mirrored = gloss_at(ground, cosine)
            if mirrored <= 0.0 or count == LANDINGS or ray[WEIGHT] * mirrored < 1e-4:
                break
            ray[WEIGHT] *= mirrored
            ray[DZ] = -cosine
        else:
            ray[Z] = 0.0
            _substrate(ground, ray, key, event, u if fresh else -1.0, v)
            fresh = False
    return count, touched


@kernel
def _land(landings: Real, count: int, ray: Real, cosine: float) -> None:
    landings[count, LAND_X], landings[count, LAND_Y] = ray[X], ray[Y]
    landings[count, LAND_WEIGHT], landings[count, LAND_COSINE] = ray[WEIGHT], cosine


@kernel
def gloss_at(ground: Ground, cosine: float) -> float:
    """What the receiver's face mirrors (Schlick), no more than it sends back at all."""
    if ground.gloss == 0.0:
        return 0.0
    return min(ground.most_gloss, ground.gloss + (1.0 - ground.gloss) * (1.0 - cosine) ** 5)


@kernel
def _outer(ground: Ground, ray: Real, path: float, chip: int) -> tuple[float, int]:
    """A pane or the module's edge, where the ray meets it before the path ends."""
    x, y = ray[X] + path * ray[DX], ray[Y] + path * ray[DY]
    if ground.pane > 0.0 and (ray[X] - ground.pane_x) * (x - ground.pane_x) < 0.0:
        path, chip = (ground.pane_x - ray[X]) / ray[DX], PANE
        x, y = ground.pane_x, ray[Y] + path * ray[DY]
    half = ground.half
    if abs(x) <= half and abs(y) <= half:
        return path, chip
    to_x = ((half if ray[DX] > 0.0 else -half) - ray[X]) / ray[DX] if ray[DX] != 0.0 else 1e300
    to_y = ((half if ray[DY] > 0.0 else -half) - ray[Y]) / ray[DY] if ray[DY] != 0.0 else 1e300
    return max(0.0, min(to_x, to_y)), EDGE


@kernel
def _framed(ground: Ground, ray: Real, key: np.uint64, event: int) -> bool:
    """Send back by Lambert's law what a frame reflects; False where the edge is open or took the light."""
    if ground.frame == 0.0:
        return False
    if ray[Z] <= 0.0 or ray[Z] >= receiver_height(ground, ray[X], ray[Y]):
        return False
    ray[WEIGHT] *= ground.frame
    p, q, r = cosine_law(uniform(key, event, 8), uniform(key, event, 9))
    half = ground.half
    if abs(ray[X]) >= abs(ray[Y]):
        sign = 1.0 if ray[X] > 0.0 else -1.0
        ray[X] = sign * (half - NEAR_UM)
        ray[DX], ray[DY], ray[DZ] = -sign * r, p, q
    else:
        sign = 1.0 if ray[Y] > 0.0 else -1.0
        ray[Y] = sign * (half - NEAR_UM)
        ray[DX], ray[DY], ray[DZ] = p, -sign * r, q
    return True


@kernel
def _at_chip(
    ground: Ground, body: Body, ray: Real, chip: int, face: int, key: np.uint64, event: int, out: Real
) -> int:
    """What a chip does to a ray that meets it, until the ray is outside again; the event there, or -1."""
    cos, sin = ground.turn_cos, ground.turn_sin
    half = ground.halves[chip]
    x, y = ray[X] - ground.centres[chip, 0], ray[Y] - ground.centres[chip, 1]
    ray[X], ray[Y] = x * cos + y * sin, y * cos - x * sin
    ray[DX], ray[DY] = ray[DX] * cos + ray[DY] * sin, ray[DY] * cos - ray[DX] * sin
    if face == 2:
        ray[Z] = body.thickness
    else:
        ray[X + face] = -half if ray[DX + face] > 0.0 else half
        ray[X + 1 - face] = min(max(ray[X + 1 - face], -half), half)
    if enters(body, ray, face, key, event):
        event = next_exit(body, half, ray, out, key, event, False, FAINT * ray[WEIGHT])
        if event < 0:
            return -1
        for number in range(WEIGHT + 1):
            ray[number] = out[number]
    out_of_frame(ground, chip, ray)
    return event


@kernel
def out_of_frame(ground: Ground, chip: int, ray: Real) -> None:
    """From a chip's frame to the module's."""
    cos, sin = ground.turn_cos, ground.turn_sin
    x, y, dx, dy = ray[X], ray[Y], ray[DX], ray[DY]
    ray[X] = ground.centres[chip, 0] + (x * cos - y * sin)
    ray[Y] = ground.centres[chip, 1] + (y * cos + x * sin)
    ray[DX], ray[DY] = dx * cos - dy * sin, dy * cos + dx * sin


@kernel
def _substrate(ground: Ground, ray: Real, key: np.uint64, event: int, u: float, v: float) -> None:
    """Reflect a ray at the substrate; u below 0: draw for the lobe."""
    if ground.leak_share > 0.0 and uniform(key, event, 10) < ground.leak_share:
        scale = ground.leak * sqrt(-2.0 * np.log(uniform(key, event, 11)))  # K0: Gaussians of exponential variance
        ray[X] += scale * normal_number(uniform(key, event, 12), uniform(key, event, 13))
        ray[Y] += scale * normal_number(uniform(key, event, 12), (uniform(key, event, 13) + 0.25) % 1.0)
        ray[DX], ray[DY], ray[DZ] = cosine_law(uniform(key, event, 0), uniform(key, event, 1))
        return
    ray[WEIGHT] *= brightness(ground, ray[X], ray[Y])
    sigma = ground.sigma
    if ground.second_share > 0.0 and uniform(key, event, 3) < ground.second_share:
        sigma = ground.second_sigma
    if u < 0.0:
        u, v = uniform(key, event, 1), uniform(key, event, 2)
    ray[DX], ray[DY], ray[DZ] = lobe(sigma, ray[DX], ray[DY], -ray[DZ], u, v, key, event)
