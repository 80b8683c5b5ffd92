"""What is recorded of light at the receiver: its bin, its direction, its optical event; as kernels.

     half        half + pad     the module's edge, and the pad beyond it
    ──┤╌╌╌╌╌╌╌╌╌╌╌╌┤
      open:  what crossed the edge, where it would have met the receiver's plane
      walls: r x the mirror image, and (1 - r^2) x that

What lies in the pad belongs to no result. It makes the map go on smoothly beyond the edge, which a low-pass filter
needs: with a source's light S beside a wall at h there is S(x) + r S(2h - x) on both sides of it.
"""

from __future__ import annotations

from math import floor, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from containers.compiled import borrowing_kernel, inlined_kernel
from containers.ray_tracing import arrays as of
from containers.ray_tracing.arrays import SceneArrays, Sinks
from containers.ray_tracing.philox import PLATE, Stream, draw, follow_up
from containers.ray_tracing.quick import cos_sin_turn, minus_log
from containers.ray_tracing.surfaces import albedo

Real = NDArray[np.float64]


@inlined_kernel
def record_arrival(scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, weight: float) -> None:
    """Record that a weight arrives where the ray meets the receiver: its optical event, its direction, its bin."""
    numbers = scene.numbers
    x, y, dx, dy, dz = ray[of.X], ray[of.Y], ray[of.DX], ray[of.DY], ray[of.DZ]
    event = int(ray[of.EVENT])
    sinks.arrivals[event] += weight
    later = 1 if event == of.AFTER_RECEIVER else 0
    if later == 0 and sinks.directions.shape[1] > 0:
        note_direction(sinks.directions, 1, dx, dy, dz, weight)
    if numbers[of.SPREAD_SHARE] > 0.0:
        a, b, c, _ = draw(stream, PLATE, 0)
        follow_up(stream, PLATE)
        if a < numbers[of.SPREAD_SHARE]:
            shift = numbers[of.SPREAD_SIGMA] * sqrt(2.0 * minus_log(b))
            across, along = cos_sin_turn(c)
            x, y = x + shift * across, y + shift * along
    weight *= recorded_share(scene, _incidence(scene, dx, dy, dz))
    if scene.flags[of.PERIODIC]:
        x -= numbers[of.SPACING] * floor(x / numbers[of.SPACING] + 0.5)
        y -= numbers[of.SPACING] * floor(y / numbers[of.SPACING] + 0.5)
    if scene.flags[of.WALLS]:
        _record_between_walls(scene, wave, sinks, later, x, y, weight)
    else:
        _record(sinks, later, x, y, weight)


@inlined_kernel
def record_beyond(scene: SceneArrays, ray: Real, sinks: Sinks, weight: float) -> None:
    """Record where a ray that is lost beyond the edge would have met the receiver's plane.

    The map then goes on smoothly, which a low-pass filter needs; what lies beyond the edge belongs to no result. The
    plate ends at the edge: it spreads what arrives within the module only.
    """
    numbers, dx, dy = scene.numbers, ray[of.DX], ray[of.DY]
    distance, tilt_x, tilt_y = numbers[of.DISTANCE], numbers[of.TILT_X], numbers[of.TILT_Y]
    rise = ray[of.DZ] - distance * (tilt_x * dx + tilt_y * dy)
    if rise <= 0.0:
        return
    path = (distance * (1.0 + tilt_x * ray[of.X] + tilt_y * ray[of.Y]) - ray[of.Z]) / rise
    weight *= (1.0 - numbers[of.SPREAD_SHARE]) * recorded_share(scene, _incidence(scene, dx, dy, ray[of.DZ]))
    later = 0 if ray[of.EVENT] < of.AFTER_RECEIVER else 1
    _record(sinks, later, ray[of.X] + dx * path, ray[of.Y] + dy * path, weight)


@borrowing_kernel
def _record_between_walls(
    scene: SceneArrays, wave: int, sinks: Sinks, later: int, x: float, y: float, weight: float
) -> None:
    """Record light in a plate that ends at walls: each sends back r of what reaches it there.

    Beyond a wall the map goes on smoothly as r times its mirror image, and 1 - r^2 of what would have gone on: where
    r is 0 that is an open edge, where it is 1 a mirror.
    """
    half_x, half_y, r = scene.numbers[of.HALF_X], scene.numbers[of.HALF_Y], walls_albedo(scene, wave)
    if abs(x) > half_x or abs(y) > half_y:
        _record(sinks, later, x, y, weight * (1.0 - r * r))
        x, walls_x = _between(x, half_x)
        y, walls_y = _between(y, half_y)
        weight *= r ** (walls_x + walls_y)
    if weight > 0.0:
        for i in range(-1, 2):
            for j in range(-1, 2):
                at_x, at_y = 2.0 * i * half_x + (-x if i else x), 2.0 * j * half_y + (-y if j else y)
                _record(sinks, later, at_x, at_y, weight * r ** (abs(i) + abs(j)))


@inlined_kernel
def walls_albedo(scene: SceneArrays, wave: int) -> float:
    """Reflectance of the walls at the module's edge; an open edge has none."""
    return float(albedo(scene.surfaces, of.EDGE, wave, 1.0)) if scene.flags[of.WALLS] else 0.0


@inlined_kernel
def _incidence(scene: SceneArrays, dx: float, dy: float, dz: float) -> float:
    """Cosine of a direction to the receiver's normal."""
    numbers = scene.numbers
    slope_x, slope_y = numbers[of.DISTANCE] * numbers[of.TILT_X], numbers[of.DISTANCE] * numbers[of.TILT_Y]
    if slope_x == 0.0 and slope_y == 0.0:
        return dz
    return float((dz - slope_x * dx - slope_y * dy) / sqrt(1.0 + slope_x * slope_x + slope_y * slope_y))


@inlined_kernel
def _between(x: float, half: float) -> tuple[float, float]:
    """Where walls at +-half fold a place to, and how many of them it takes."""
    turns = (x + half) / (4.0 * half)
    return half * (1.0 - abs(4.0 * (turns - floor(turns)) - 2.0)), abs(floor(2.0 * turns))


@inlined_kernel
def recorded_share(scene: SceneArrays, cosine: float) -> float:
    """Weight of recorded light at a cosine of incidence."""
    steps, tables = scene.flags[of.RESPONSE] - 1, scene.surfaces.tables
    node = min(int(cosine * steps), steps - 1)
    at = scene.flags[of.RESPONSE_AT] + node
    return float(tables[at] + (cosine * steps - node) * (tables[at + 1] - tables[at]))


@inlined_kernel
def _record(sinks: Sinks, later: int, x: float, y: float, weight: float) -> None:
    """Add a weight to the bin at a place on the receiver."""
    box = sinks.box
    if box[3] > 0.0:
        x, y = abs(x), abs(y)
    column, row = int((x - box[0]) * box[2] + 1.0) - 1, int((y - box[1]) * box[2] + 1.0) - 1  # floor, from -1 on
    _, rows, columns = sinks.bins.shape
    if box[4] > 0.0:  # a cell: what lies on its rim belongs to it
        column, row = min(max(column, 0), columns - 1), min(max(row, 0), rows - 1)
    if 0 <= column < columns and 0 <= row < rows:
        sinks.bins[later, row, column] += weight


@inlined_kernel
def note_direction(directions: Real, which: int, dx: float, dy: float, dz: float, weight: float) -> None:
    """Add a weight to the histogram of directions."""
    _, cosines, azimuths = directions.shape
    ring = min(int((dz + 1.0) * 0.5 * cosines), cosines - 1)
    turn = np.arctan2(dy, dx) / (2.0 * pi)
    sector = min(int((turn - floor(turn)) * azimuths), azimuths - 1)
    directions[which, ring, sector] += weight
