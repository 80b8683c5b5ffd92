"""The way of a ray outside the chips: to the receiver, the substrate, a chip or the edge; as kernels.

z = D  ─────────────────────────────────── receiver: every arrival is recorded
          what starts at the substrate or at a chip goes up, past the other chips
z = T        ┌────┐ <- chips are looked for below T only, cell by cell of the lattice
z = 0  ──────┴────┴─────────────────────── substrate
"""

from __future__ import annotations

from math import floor, inf, sqrt

import numpy as np
from numpy.typing import NDArray

from containers.compiled import borrowing_kernel, inlined_kernel
from containers.ray_tracing import arrays as of
from containers.ray_tracing.arrays import SceneArrays, Sinks
from containers.ray_tracing.philox import EDGE as EDGE_KIND
from containers.ray_tracing.philox import ENTRY, LEAK, ROULETTE, Stream, draw, follow_up
from containers.ray_tracing.philox import RECEIVER as RECEIVER_KIND
from containers.ray_tracing.philox import SUBSTRATE as SUBSTRATE_KIND
from containers.ray_tracing.quick import cos_sin_turn, minus_log
from containers.ray_tracing.recording import record_arrival, record_beyond, walls_albedo
from containers.ray_tracing.surfaces import ABSORBED, REFLECTED, TRANSMITTED, albedo, lobe, plain_lobe, scatter

Real = NDArray[np.float64]

LIGHT = 0.05
"""Below this weight only as much is sent on as in nature: roulette with the albedo itself."""

LOST, INTO_CHIP = range(2)
"""What became of a walk."""
_NOTHING, _RECEIVER, _SUBSTRATE, _EDGE_X, _EDGE_Y, _CHIP_X, _CHIP_Y, _CHIP_TOP = range(8)
_TOUCH_UM = 1e-9
"""A chip is met where at least this much of the ray lies in it: a ray that leaves a face does not meet it again."""


@borrowing_kernel
def walk_module(
    scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, survival: float, fan: int
) -> int:
    """Follow a ray (module coordinates, outside all chips) until it goes INTO_CHIP (then relative to its centre) or
    is LOST. What the receiver sends back goes on with probability `survival`, its weight raised to match; first light
    that the substrate scatters is recorded as the mean of `fan` directions, one of which goes on."""
    recorded = 1.0
    while True:
        what, path = _next(scene, ray)
        dx, dy, dz = ray[of.DX], ray[of.DY], ray[of.DZ]
        ray[of.X] += dx * path
        ray[of.Y] += dy * path
        ray[of.Z] += dz * path
        weight = ray[of.WEIGHT]
        if what == _RECEIVER:
            if not receive(scene, wave, ray, stream, sinks, survival, recorded):
                return LOST
            recorded = 1.0
        elif what == _SUBSTRATE:
            if scene.numbers[of.LEAK_SHARE] > 0.0 and _leaks(scene, ray, stream):
                recorded = 1.0
                if not _comes_back(scene, wave, ray, sinks):
                    return LOST
                continue
            surfaces = scene.surfaces
            recorded = _record_fan(scene, wave, ray, stream, sinks, fan)
            fate, dx, dy, dz = scatter(surfaces, of.SUBSTRATE, wave, 1.0, 1.0, dx, dy, dz, stream, SUBSTRATE_KIND)
            follow_up(stream, SUBSTRATE_KIND)
            if fate != REFLECTED:
                sinks.ledger[of.SUBSTRATE_END] += weight
                return LOST
            ray[of.Z], ray[of.DX], ray[of.DY], ray[of.DZ] = 0.0, dx, dy, dz
        elif what >= _CHIP_X:
            recorded = 1.0
            fate = _enter(scene, wave, ray, stream, what)
            if fate == TRANSMITTED:
                return INTO_CHIP
            if fate == ABSORBED:
                sinks.ledger[of.DBR_END] += weight
                return LOST
        elif not _edge(scene, wave, ray, stream, sinks, what):
            sinks.ledger[of.EDGE_END] += weight
            return LOST
        else:
            recorded = 1.0


@borrowing_kernel
def _leaks(scene: SceneArrays, ray: Real, stream: Stream) -> bool:
    """Whether a ray at the substrate goes on inside it; if so it is put where it comes out, by Lambert's law.

    The place is displaced with the density exp(-r / L) / (2 pi L^2): r is L times a sum of two exponential numbers.
    A chip that stands there is passed, and the substrate goes on beyond the edge of a finite module.
    """
    a, b, c, d = draw(stream, LEAK, 0)
    if a >= scene.numbers[of.LEAK_SHARE]:
        follow_up(stream, LEAK)
        return False
    across, along = cos_sin_turn(d)
    shift = scene.numbers[of.LEAK_LENGTH] * minus_log(b * c)
    a, b, _, _ = draw(stream, LEAK, 1)
    follow_up(stream, LEAK)
    ray[of.X], ray[of.Y], ray[of.Z] = ray[of.X] + shift * across, ray[of.Y] + shift * along, 0.0
    across, along = cos_sin_turn(b)
    sine = sqrt(a)
    ray[of.DX], ray[of.DY], ray[of.DZ] = sine * across, sine * along, sqrt(1.0 - a)
    return True


@borrowing_kernel
def _comes_back(scene: SceneArrays, wave: int, ray: Real, sinks: Sinks) -> bool:
    """Whether a ray that comes out of the substrate may still be recorded; what is beyond the edge may not.

    The substrate goes on beyond the edge, the receiver does not. A wall lets through what it does not reflect, from
    either side: it takes r of a ray that comes out behind it.
    """
    numbers, x, y = scene.numbers, ray[of.X], ray[of.Y]
    if abs(x) <= numbers[of.HALF_X] and abs(y) <= numbers[of.HALF_Y]:
        return True
    kept = 1.0 - walls_albedo(scene, wave)
    sinks.ledger[of.EDGE_END] += ray[of.WEIGHT] * (1.0 - kept)
    ray[of.WEIGHT] *= kept
    dx, dy, distance = ray[of.DX], ray[of.DY], numbers[of.DISTANCE]
    rise = ray[of.DZ] - distance * (numbers[of.TILT_X] * dx + numbers[of.TILT_Y] * dy)
    path = distance * (1.0 + numbers[of.TILT_X] * x + numbers[of.TILT_Y] * y) / rise if rise > 0.0 else inf
    if abs(x + dx * path) <= numbers[of.HALF_X] and abs(y + dy * path) <= numbers[of.HALF_Y]:
        return True
    record_beyond(scene, ray, sinks, ray[of.WEIGHT] * kept)
    sinks.ledger[of.EDGE_END] += ray[of.WEIGHT]
    return False


@borrowing_kernel
def _record_fan(scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, fan: int) -> float:
    """Record what first light would leave on the receiver in all directions of a fan but the one that it takes.

    Where it takes its draw (u, v) of the substrate's lobe, the others are those of a lattice shifted by it,
    (u + j / fan, v + 5 j / fan) mod 1: each is as likely, together they are spread evenly. Those that reach the
    receiver on their way are recorded with 1 / fan of the light; returned is the share left to record for the one
    that goes on, where it reaches the receiver next. If a chip or an edge comes first, it stands for all like it.
    """
    sigma, reflectance = plain_lobe(scene.surfaces, of.SUBSTRATE)
    if fan < 2 or sigma == 0.0 or ray[of.EVENT] == of.AFTER_RECEIVER:
        return 1.0
    x, y, z, dx, dy, dz = ray[of.X], ray[of.Y], ray[of.Z], ray[of.DX], ray[of.DY], ray[of.DZ]
    _, u, v, _ = draw(stream, SUBSTRATE_KIND, 0)
    weight = ray[of.WEIGHT] * reflectance / fan
    ray[of.Z] = 0.0
    for j in range(1, fan):
        p, q = u + j / fan, v + 5.0 * j / fan
        ray[of.DX], ray[of.DY], ray[of.DZ] = lobe(
            sigma, dx, dy, -dz, p - floor(p), q - floor(q), stream, SUBSTRATE_KIND
        )
        what, path = _next(scene, ray)
        if what == _RECEIVER:
            ray[of.X], ray[of.Y] = x + path * ray[of.DX], y + path * ray[of.DY]
            record_arrival(scene, wave, ray, stream, sinks, weight)
            ray[of.X], ray[of.Y] = x, y
    ray[of.Z], ray[of.DX], ray[of.DY], ray[of.DZ] = z, dx, dy, dz
    return 1.0 / fan


@inlined_kernel
def _next(scene: SceneArrays, ray: Real) -> tuple[int, float]:
    """What a ray meets next, and the path to it; where it meets a chip, CHIP_X and CHIP_Y of the ray name it."""
    numbers = scene.numbers
    x, y, z, dx, dy, dz = ray[of.X], ray[of.Y], ray[of.Z], ray[of.DX], ray[of.DY], ray[of.DZ]
    top = numbers[of.THICKNESS]
    tilt_x, tilt_y = numbers[of.TILT_X], numbers[of.TILT_Y]
    distance = numbers[of.DISTANCE]
    rise = dz - distance * (tilt_x * dx + tilt_y * dy)
    what, path = _NOTHING, inf
    if rise > 0.0:
        what, path = _RECEIVER, max(0.0, (distance * (1.0 + tilt_x * x + tilt_y * y) - z) / rise)
    if dz < 0.0 and -z / dz < path:
        what, path = _SUBSTRATE, -z / dz
    if not scene.flags[of.PERIODIC]:
        to_x = ((numbers[of.HALF_X] if dx > 0.0 else -numbers[of.HALF_X]) - x) / dx if dx != 0.0 else inf
        to_y = ((numbers[of.HALF_Y] if dy > 0.0 else -numbers[of.HALF_Y]) - y) / dy if dy != 0.0 else inf
        if to_x < path:
            what, path = _EDGE_X, to_x
        if to_y < path:
            what, path = _EDGE_Y, to_y
    begin, end = 0.0, path
    if dz > 0.0:
        if z >= top:
            return what, path
        end = min(path, (top - z) / dz)
    elif z > top:
        if dz == 0.0:
            return what, path
        begin = (top - z) / dz
        if begin >= path:
            return what, path
    chip, chip_path = _find_chip(scene, ray, begin, end, dz < 0.0 and z >= top)
    if chip != _NOTHING:
        return chip, chip_path
    return what, path


@inlined_kernel
def _find_chip(scene: SceneArrays, ray: Real, begin: float, end: float, from_above: bool) -> tuple[int, float]:
    """The first chip that a ray meets between two paths, both below z = T; cell by cell of the lattice."""
    numbers = scene.numbers
    spacing, half = numbers[of.SPACING], numbers[of.HALF_WIDTH]
    x, y, dx, dy = ray[of.X] - numbers[of.ORIGIN_X], ray[of.Y] - numbers[of.ORIGIN_Y], ray[of.DX], ray[of.DY]
    inverse_x, inverse_y = 1.0 / dx if dx != 0.0 else 1e300, 1.0 / dy if dy != 0.0 else 1e300
    column, row = floor((x + dx * begin) / spacing + 0.5), floor((y + dy * begin) / spacing + 0.5)
    periodic = scene.flags[of.PERIODIC] == 1
    rows, columns = scene.flags[of.ROWS], scene.flags[of.COLUMNS]
    here = begin
    while True:
        if periodic or (0.0 <= column < columns and 0.0 <= row < rows):
            offset_x, offset_y = 0.0, 0.0
            if not periodic:
                at = scene.flags[of.OFFSETS_AT] + 2 * (int(row) * columns + int(column))
                offset_x, offset_y = scene.surfaces.tables[at], scene.surfaces.tables[at + 1]
            centre_x, centre_y = column * spacing + offset_x, row * spacing + offset_y
            a, b = (centre_x - half - x) * inverse_x, (centre_x + half - x) * inverse_x
            c, d = (centre_y - half - y) * inverse_y, (centre_y + half - y) * inverse_y
            enter_x, enter_y = min(a, b), min(c, d)
            enter = max(enter_x, enter_y, begin)
            if min(max(a, b), max(c, d), end) - enter > _TOUCH_UM and (enter > begin or from_above):
                ray[of.CHIP_X], ray[of.CHIP_Y] = centre_x + numbers[of.ORIGIN_X], centre_y + numbers[of.ORIGIN_Y]
                if enter == begin:
                    return _CHIP_TOP, enter
                return (_CHIP_X, enter) if enter == enter_x else (_CHIP_Y, enter)
        to_x = ((column + (0.5 if dx >= 0.0 else -0.5)) * spacing - x) * inverse_x
        to_y = ((row + (0.5 if dy >= 0.0 else -0.5)) * spacing - y) * inverse_y
        here = min(to_x, to_y)
        if here >= end or here >= 1e299:
            return _NOTHING, inf
        if to_x <= to_y:
            column += 1.0 if dx > 0.0 else -1.0
        else:
            row += 1.0 if dy > 0.0 else -1.0


@borrowing_kernel
def _enter(scene: SceneArrays, wave: int, ray: Real, stream: Stream, face: int) -> int:
    """What becomes of a ray at a chip's face: TRANSMITTED into it (position then relative to it), or REFLECTED."""
    n = scene.numbers[of.INDEX + wave]
    dx, dy, dz = ray[of.DX], ray[of.DY], ray[of.DZ]
    if face == _CHIP_TOP:
        ray[of.Z] = scene.numbers[of.THICKNESS]
        fate, dx, dy, dz = scatter(scene.surfaces, of.TOP_OUT, wave, 1.0, n, dx, dy, dz, stream, ENTRY)
    elif face == _CHIP_X:
        sign = 1.0 if dx > 0.0 else -1.0
        ray[of.X] = ray[of.CHIP_X] - sign * scene.numbers[of.HALF_WIDTH]
        fate, dy, dz, out = scatter(scene.surfaces, of.SIDE_OUT, wave, 1.0, n, dy, dz, -dx * sign, stream, ENTRY)
        dx = -out * sign
    else:
        sign = 1.0 if dy > 0.0 else -1.0
        ray[of.Y] = ray[of.CHIP_Y] - sign * scene.numbers[of.HALF_WIDTH]
        fate, dz, dx, out = scatter(scene.surfaces, of.SIDE_OUT, wave, 1.0, n, dz, dx, -dy * sign, stream, ENTRY)
        dy = -out * sign
    follow_up(stream, ENTRY)
    ray[of.DX], ray[of.DY], ray[of.DZ] = dx, dy, dz
    if fate == TRANSMITTED:
        ray[of.X] -= ray[of.CHIP_X]
        ray[of.Y] -= ray[of.CHIP_Y]
        half = scene.numbers[of.HALF_WIDTH]
        if face == _CHIP_X:  # exactly on the face, wherever the chip stands
            ray[of.X] = -half if dx > 0.0 else half
        elif face == _CHIP_Y:
            ray[of.Y] = -half if dy > 0.0 else half
    return fate


@borrowing_kernel
def _edge(scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, what: int) -> bool:
    """Reflect a ray at a wall at the module's edge; False where it is lost there, and recorded beyond."""
    dx, dy, dz = ray[of.DX], ray[of.DY], ray[of.DZ]
    if not scene.flags[of.WALLS]:
        record_beyond(scene, ray, sinks, ray[of.WEIGHT])
        return False
    if what == _EDGE_X:
        sign = 1.0 if dx > 0.0 else -1.0
        ray[of.X] = sign * scene.numbers[of.HALF_X]
        fate, dy, dz, out = scatter(scene.surfaces, of.EDGE, wave, 1.0, 1.0, dy, dz, -dx * sign, stream, EDGE_KIND)
        dx = -out * sign
    else:
        sign = 1.0 if dy > 0.0 else -1.0
        ray[of.Y] = sign * scene.numbers[of.HALF_Y]
        fate, dz, dx, out = scatter(scene.surfaces, of.EDGE, wave, 1.0, 1.0, dz, dx, -dy * sign, stream, EDGE_KIND)
        dy = -out * sign
    follow_up(stream, EDGE_KIND)
    if fate != REFLECTED:
        record_beyond(scene, ray, sinks, ray[of.WEIGHT] * (1.0 + walls_albedo(scene, wave)))
        return False
    ray[of.DX], ray[of.DY], ray[of.DZ] = dx, dy, dz
    return True


@inlined_kernel
def clear_way(scene: SceneArrays, ray: Real) -> float:
    """Path to the receiver of a ray that leaves a chip upwards and cannot meet another one on its way; else 0.

    What most stored exits do: the neighbours' near faces are a spacing less half a width away.
    """
    numbers, dz = scene.numbers, ray[of.DZ]
    if dz <= 0.0 or not scene.flags[of.PERIODIC] or numbers[of.TILT_X] != 0.0 or numbers[of.TILT_Y] != 0.0:
        return 0.0
    to_top = max(0.0, numbers[of.THICKNESS] - ray[of.Z]) / dz
    reach = numbers[of.SPACING] - numbers[of.HALF_WIDTH] - _TOUCH_UM
    if abs(ray[of.X] + ray[of.DX] * to_top) >= reach or abs(ray[of.Y] + ray[of.DY] * to_top) >= reach:
        return 0.0
    return float((numbers[of.DISTANCE] - ray[of.Z]) / dz)


@borrowing_kernel
def way_down(scene: SceneArrays, ray: Real) -> float:
    """Path to the substrate of a ray (module coordinates) that meets it before anything else; else 0."""
    if ray[of.DZ] >= 0.0:
        return 0.0
    what, path = _next(scene, ray)
    return path if what == _SUBSTRATE else 0.0


@inlined_kernel
def receive(
    scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, survival: float, recorded: float
) -> bool:
    """Record `recorded` of an arrival at the receiver, send back what it reflects; False where the ray ends."""
    numbers = scene.numbers
    if scene.flags[of.PERIODIC]:  # back into the cell around a chip
        ray[of.X] -= numbers[of.SPACING] * floor(ray[of.X] / numbers[of.SPACING] + 0.5)
        ray[of.Y] -= numbers[of.SPACING] * floor(ray[of.Y] / numbers[of.SPACING] + 0.5)
    else:
        ray[of.Z] = numbers[of.DISTANCE] * (1.0 + numbers[of.TILT_X] * ray[of.X] + numbers[of.TILT_Y] * ray[of.Y])
    record_arrival(scene, wave, ray, stream, sinks, ray[of.WEIGHT] * recorded)
    ray[of.EVENT] = of.AFTER_RECEIVER
    tilted = numbers[of.TILT_X] != 0.0 or numbers[of.TILT_Y] != 0.0
    return _send_back(scene, wave, ray, stream, sinks, survival, tilted)


@inlined_kernel
def _send_back(
    scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, survival: float, tilted: bool
) -> bool:
    """What the receiver keeps and what it sends back; roulette with its book-keeping."""
    numbers, weight = scene.numbers, ray[of.WEIGHT]
    dx, dy, dz = ray[of.DX], ray[of.DY], ray[of.DZ]
    p, q, r = dx, dy, -dz  # in the receiver's surface space, z downwards
    mx, my, mz = 0.0, 0.0, 1.0
    if tilted:
        mx, my = -numbers[of.DISTANCE] * numbers[of.TILT_X], -numbers[of.DISTANCE] * numbers[of.TILT_Y]
        mz = 1.0 / sqrt(1.0 + mx * mx + my * my)
        mx, my = mx * mz, my * mz
        a = 1.0 / (1.0 + mz)
        p = dx * (1.0 - mx * mx * a) - dy * mx * my * a - dz * mx
        q = -dx * mx * my * a + dy * (1.0 - my * my * a) - dz * my
        r = -(dx * mx + dy * my + dz * mz)
    kept = albedo(scene.surfaces, of.RECEIVER, wave, r)
    sinks.ledger[of.RECEIVER_END] += weight * (1.0 - kept)
    if kept == 0.0:
        return False
    # weights stay at 1 or below, else a bright receiver would give them an infinite variance
    chance = max(survival, min(1.0, weight * kept)) if weight > LIGHT else kept
    if chance < 1.0:
        u, _, _, _ = draw(stream, ROULETTE, 0)
        follow_up(stream, ROULETTE)
        if u >= chance:
            sinks.ledger[of.ROULETTE_END] -= weight * kept
            return False
    fate, p, q, r = scatter(scene.surfaces, of.RECEIVER, wave, 1.0, 1.0, p, q, r, stream, RECEIVER_KIND, kept)
    follow_up(stream, RECEIVER_KIND)
    ray[of.WEIGHT] = weight * kept / chance
    sinks.ledger[of.ROULETTE_END] += weight * kept / chance - weight * kept
    if fate != REFLECTED:  # through the plate
        sinks.ledger[of.RECEIVER_END] += ray[of.WEIGHT]
        return False
    ray[of.DX], ray[of.DY], ray[of.DZ] = p, q, -r
    if tilted:
        a = 1.0 / (1.0 + mz)
        ray[of.DX] = p * (1.0 - mx * mx * a) - q * mx * my * a - r * mx
        ray[of.DY] = -p * mx * my * a + q * (1.0 - my * my * a) - r * my
        ray[of.DZ] = -p * mx - q * my - r * mz
    return True
