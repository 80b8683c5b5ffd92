"""What chips do to light that the receiver sends back: they stand in its way, and give some of it back elsewhere.

Measured with a few frozen rays: Lambert light starts all over the cell at the receiver and is followed until it is
back there, once with the chips and once, with the same random numbers, without. A ray that meets no chip counts
nothing, so half of them are aimed at the surroundings of the chip, with less weight. They give the correction dT of
the round trip of `closure` between the lowest waves of the cell,

    dT_ab = mean over rays of  w f_a(place with chips) f_b(start) - w' f_a(place without) f_b(start).
"""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from containers.compiled import borrowing_kernel
from containers.ray_tracing.arrays import (
    DISTANCE,
    DX,
    DY,
    DZ,
    EVENT,
    HALF_WIDTH,
    SPACING,
    SUBSTRATE,
    THICKNESS,
    THROUGH_TOP,
    WEIGHT,
    EmissionArrays,
    Sinks,
    X,
    Y,
    Z,
)
from containers.ray_tracing.field import Axis
from containers.ray_tracing.kernel import Scratch, scratch
from containers.ray_tracing.philox import CHIP, EMISSION, draw, start
from containers.ray_tracing.philox import SUBSTRATE as SUBSTRATE_KIND
from containers.ray_tracing.surfaces import REFLECTED, scatter
from containers.ray_tracing.tally import nowhere
from containers.ray_tracing.twin.direct import Way
from containers.ray_tracing.twin.direct_kernel import WayArrays, reaches_receiver
from containers.ray_tracing.twin.parallel import in_parallel
from containers.scene import Scene

Real = NDArray[np.float64]

RAYS = 65536
MOST_PERIODS = 3
"""Per cell, of the waves between which chips are seen to send light."""
NEAR = 3.0
"""Half of the rays is aimed at a square of W + NEAR x T on the substrate."""
TOUCHED = 1e-6
"""Difference (um, or of weights) beyond which a ray has met a chip; below it is rounding."""
_PARTS = 16
_STEPS = 0.7548776662466927, 0.5698402909980532
"""Of the places, in periods: the additive recurrence of Roberts' R2 sequence."""


def correction(
    way: Way,
    emission: EmissionArrays,
    x: Axis,
    y: Axis,
    *,
    rays: int = RAYS,
    seed: int = 1,
    threads: int | None = None,
) -> Real:
    """dT (function, function) between the functions (y, x) of a cell, y first, that the two axes have.

    Parameters
    ----------
    way : of the scene; the chips of a finite module are taken as part of an endless one. emission : of wavelengths.
    x, y : axes of the cell with few modes (`low_axis`). rays : how many. seed : of their frozen numbers.

    Notes
    -----
    Where both axes are `even`, what chips send from even to odd waves is 0 by symmetry and not asked for, and dT is
    averaged over the exchange of x and y.
    """
    arrays, found = way.endless().arrays, np.zeros((rays, 8))

    def part(number: int) -> None:
        own = slice(rays * number // _PARTS, rays * (number + 1) // _PARTS)
        there_and_back(arrays, emission, np.uint64(seed), own.start, found[own], nowhere(), scratch())

    in_parallel(part, range(_PARTS), threads)
    found = found[np.abs(found[:, 2:5] - found[:, 5:]).max(axis=1) > TOUCHED]
    start_at, without, with_chips = (_functions(x, y, found[:, i : i + 2]) for i in (0, 2, 5))
    moved = found[:, 7:] * with_chips - found[:, 4:5] * without
    dT = moved.T @ start_at / rays
    if x.kind == "even":
        n = x.modes + 1
        dT = dT.reshape(n, n, n, n)
        dT = ((dT + dT.transpose(1, 0, 3, 2)) / 2.0).reshape(n * n, n * n)
    return np.asarray(dT)


def periods_seen(scene: Scene) -> int:
    """How many periods per cell matter: with so many, Lambert's law from a chip's top still makes a wave of 0.1."""
    return int(np.clip(3.2 * scene.layout.spacing_um / (2.0 * pi * scene.height_um), 1.0, MOST_PERIODS))


def low_axis(axis: Axis, periods: int) -> Axis:
    """The same axis with the functions of up to `periods` periods per cell only."""
    return replace(axis, modes=min(axis.modes, periods))


def _functions(x: Axis, y: Axis, places: Real) -> Real:
    """(place, y function and x function)."""
    along_x, along_y = x.functions(places[:, 0]), y.functions(places[:, 1])
    return np.asarray((along_y[:, :, None] * along_x[:, None, :]).reshape(len(places), -1))


@borrowing_kernel
def there_and_back(
    way: WayArrays, emission: EmissionArrays, seed: np.uint64, first: int, found: Real, sinks: Sinks, scratch: Scratch
) -> None:
    """Rays number `first` and on into `found` (n, 8): start (x, y), end (x, y, weight) without chips, and with them.

    `sinks` stay empty but for the ledger.
    """
    stream, ray, trace, _, _ = scratch
    scene = way.scene
    spacing, distance = scene.numbers[SPACING], scene.numbers[DISTANCE]
    near = min(spacing, 2.0 * scene.numbers[HALF_WIDTH] + NEAR * scene.numbers[THICKNESS])
    for i in range(found.shape[0]):
        number = first + i
        start(stream, seed, np.uint64(number))
        a, b, _, _ = draw(stream, EMISSION, 0)
        u, _, _, _ = draw(stream, CHIP, 0)
        wave = 0
        while wave < emission.wave_cumulative.size - 1 and u >= emission.wave_cumulative[wave]:
            wave += 1
        sine, dz = sqrt(a), -sqrt(1.0 - a)
        dx, dy = sine * np.cos(2.0 * pi * b), sine * np.sin(2.0 * pi * b)
        side = near if number & 1 else spacing
        x = ((0.5 + number * _STEPS[0]) % 1.0 - 0.5) * side
        y = ((0.5 + number * _STEPS[1]) % 1.0 - 0.5) * side
        weight = 1.0
        if max(abs(x), abs(y)) < near / 2.0:
            weight = 2.0 / (1.0 + (spacing / near) ** 2)
        elif near < spacing:
            weight = 2.0
        x, y = x + distance * dx / dz, y + distance * dy / dz
        found[i, 0], found[i, 1] = x, y
        fate, p, q, r = scatter(scene.surfaces, SUBSTRATE, wave, 1.0, 1.0, dx, dy, dz, stream, SUBSTRATE_KIND)
        if fate == REFLECTED:
            found[i, 2] = x + distance * (p / r - dx / dz)
            found[i, 3] = y + distance * (q / r - dy / dz)
            found[i, 4] = weight * way.kept
        ray[X], ray[Y], ray[Z], ray[DX], ray[DY], ray[DZ] = x, y, distance, dx, dy, dz
        ray[WEIGHT], ray[EVENT] = 1.0, float(THROUGH_TOP)
        if reaches_receiver(scene, wave, ray, stream, sinks, trace):
            found[i, 5], found[i, 6] = ray[X], ray[Y]
            found[i, 7] = weight * ray[WEIGHT] * way.kept ** float(stream[2 + SUBSTRATE_KIND])
        for j in (0, 1, 2, 3, 5, 6):  # back into the cell
            found[i, j] -= spacing * np.floor(found[i, j] / spacing + 0.5)
