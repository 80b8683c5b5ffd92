"""The way of a ray inside a chip, until it leaves or ends; as kernels.

    z = T   ┌───────────────┐  top: R, T of the film
            │               │
            │   index n     │  sides: clear faces
    z = 0   └───────────────┘  bottom: substrate, mirror, or an air gap above the substrate
           -a               a

Walls that reflect specularly are mirrors of the lattice of images of the chip: between two bottom hits a ray is one
straight line through that lattice, keeping |dx|, |dy|, |dz|. Only one pair of faces can lie within the escape cone,
for n^2 >= 2; the number of wall hits until the ray leaves through it is a geometric random number. So a flight from
bottom to bottom is one step, whatever number of walls it crosses. x and y stay unfolded until the ray leaves.
"""

from __future__ import annotations

from math import ceil, exp, floor, inf, log, sqrt

import numpy as np
from numpy.typing import NDArray

from containers.compiled import borrowing_kernel, inlined_kernel
from containers.ray_tracing import arrays as of
from containers.ray_tracing.arrays import SceneArrays
from containers.ray_tracing.philox import BOTTOM as BOTTOM_KIND
from containers.ray_tracing.philox import FACE, ROULETTE, Stream, draw, follow_up
from containers.ray_tracing.surfaces import (
    ABSORBED,
    REFLECTED,
    TRANSMITTED,
    Surfaces,
    albedo,
    lobe,
    node_of,
    plain_lobe,
    scatter,
    share,
)

Real = NDArray[np.float64]

FAINT = 0.05
"""Share of the weight at which a ray came in below which roulette is played."""

LONGEST_WALK = 100_000
"""Steps: from bottom to bottom, face by face where it is plain. A way of a metre and more; with a little loss nothing
is left by then, without it what little turns light out may take for ever (`_book_rest`)."""

ENDED, OUT = range(2)
"""What became of a walk."""


@borrowing_kernel
def walk_chip(scene: SceneArrays, wave: int, ray: Real, stream: Stream, ledger: Real, trace: Real) -> int:
    """Follow a ray, position relative to the chip's centre, until it is OUT (position at the face, direction in air)
    or ENDED (booked in `ledger`). Notes in `trace` what a change of the chip can be reckoned from."""
    for i in range(of.TRACE):
        trace[i] = 0.0
    if scene.flags[of.UNFOLD]:
        return _walk_unfolded(scene, wave, ray, stream, ledger, trace)
    return _walk_plain(scene, wave, ray, stream, ledger, trace)


@borrowing_kernel
def _walk_unfolded(scene: SceneArrays, wave: int, ray: Real, stream: Stream, ledger: Real, trace: Real) -> int:
    half, top, alpha = scene.numbers[of.HALF_WIDTH], scene.numbers[of.THICKNESS], scene.numbers[of.ABSORPTION]
    rise = scene.numbers[of.ABSORPTION_RISE]
    surfaces, n = scene.surfaces, scene.numbers[of.INDEX + wave]
    n2 = n * n
    leaks = 1.0 - 1.0 / n2
    lossy, air_gap = scene.flags[of.TOP_LOSSY] == 1, scene.flags[of.AIR_GAP] == 1
    sigma, reflectance = plain_lobe(surfaces, of.BOTTOM)
    if air_gap:
        sigma = 0.0
    x, y, z, dx, dy, dz = ray[of.X], ray[of.Y], ray[of.Z], ray[of.DX], ray[of.DY], ray[of.DZ]
    weight, topped = ray[of.WEIGHT], False
    faint = FAINT * weight
    for _ in range(LONGEST_WALK):
        through_x, through_y = dx * dx > leaks, dy * dy > leaks
        steep = lossy or dz * dz > leaks
        meets_top = dz > 0.0 and steep
        if scene.flags[of.CLOSED] and not (through_x or through_y or steep):
            ledger[of.TRAPPED_END if alpha == 0.0 else of.CHIP_END] += weight
            return ENDED
        leaves_at, b = inf, 0.0
        if through_x or through_y or meets_top:
            a, b, _, _ = draw(stream, FACE, 0)
            follow_up(stream, FACE)
            if through_x:
                leaves_at = _leaves_at(surfaces, wave, n2, x, dx, half, a)
            elif through_y:
                leaves_at = _leaves_at(surfaces, wave, n2, y, dy, half, a)
        bottom_at = -z / dz if dz < 0.0 else inf
        if dz > 0.0:
            top_at = (top - z) / dz
            bottom_at = top_at + top / dz
            if abs(leaves_at) >= top_at:
                if meets_top:
                    at, above = node_of(surfaces, of.TOP_IN, wave, n2 * (1.0 - dz * dz), n2)
                    R = share(surfaces, of.TOP_IN, at, above, 0)
                    if b >= R:
                        lift = lift_of(z, dz, top_at, top)
                        left = _dim(weight, alpha * top_at + rise * lift, ledger)
                        if b < share(surfaces, of.TOP_IN, at, above, 1):
                            trace[of.PATH] += top_at
                            trace[of.LIFT] += lift
                            ray[of.WEIGHT] = left
                            x, y = x + dx * top_at, y + dy * top_at
                            _leave(ray, x, y, top, dx, dy, dz, half, n, 2, topped)
                            return OUT
                        ledger[of.DBR_END] += left
                        return ENDED
                _note_top(trace, dz, leaks)
                topped = True
        path, lift = min(abs(leaves_at), bottom_at), 0.0
        if z > 0.0 or path < bottom_at:  # from bottom to bottom it is 0
            lift = lift_of(z, dz, path, top)
        weight = _dim(weight, alpha * path + rise * lift, ledger)
        trace[of.PATH] += path
        trace[of.LIFT] += lift
        x, y = x + dx * path, y + dy * path
        if abs(leaves_at) <= bottom_at:
            if leaves_at < 0.0:
                ledger[of.DBR_END] += weight
                return ENDED
            ray[of.WEIGHT] = weight
            height = z + dz * path
            going = dz
            if height > top:
                height, going = 2.0 * top - height, -dz
            _leave(ray, x, y, height, dx, dy, going, half, n, 0 if through_x else 1, topped)
            return OUT
        trace[of.BOTTOM_HITS] += 1.0
        z, dz = 0.0, abs(dz)
        if sigma > 0.0:  # what nearly all bottoms are, without the way through `scatter`
            a, b, c, _ = draw(stream, BOTTOM_KIND, 0)
            what = REFLECTED if a < reflectance else ABSORBED
            dx, dy, dz = lobe(sigma, dx, dy, dz, b, c, stream, BOTTOM_KIND)
            follow_up(stream, BOTTOM_KIND)
        else:
            what, dx, dy, dz = _bottom(surfaces, air_gap, wave, n, dx, dy, -dz, stream)
        if what != REFLECTED:
            ledger[of.SUBSTRATE_END] += weight
            return ENDED
        if weight < faint:
            weight = _roulette(weight, faint, stream, ledger)
            if weight == 0.0:
                return ENDED
    _book_rest(scene, wave, weight, ledger)
    return ENDED


@borrowing_kernel
def book_shut_in(scene: SceneArrays, wave: int, weight: float, z: float, dz: float, ledger: Real) -> None:
    """Where light ends that goes round outside all escape cones, keeping |dz| > 0, from height z on.

    Chip and mirror share it: with e what is left after a round trip and r the mirror's reflectance, their shares are
    sums of geometric series. In a closed chip it is all the chip's, or trapped where that takes nothing.
    """
    alpha, rise, top = scene.numbers[of.ABSORPTION], scene.numbers[of.ABSORPTION_RISE], scene.numbers[of.THICKNESS]
    if scene.flags[of.CLOSED]:
        ledger[of.TRAPPED_END if alpha == 0.0 else of.CHIP_END] += weight
        return
    first = z if dz < 0.0 else 2.0 * top - z
    lift, r = lift_of(z, dz, first / abs(dz), top), albedo(scene.surfaces, of.BOTTOM, wave, 1.0)
    start, e = exp(-alpha * first / abs(dz) - rise * lift), exp(-alpha * 2.0 * top / abs(dz))
    ledger[of.CHIP_END] += weight * (1.0 - start + start * r * (1.0 - e) / (1.0 - e * r))
    ledger[of.SUBSTRATE_END] += weight * start * (1.0 - r) / (1.0 - e * r)


@borrowing_kernel
def _book_rest(scene: SceneArrays, wave: int, weight: float, ledger: Real) -> None:
    """Where light ends that has walked too long: in what takes light where it goes round, else it is trapped."""
    if scene.numbers[of.ABSORPTION] > 0.0:
        ledger[of.CHIP_END] += weight
    elif scene.flags[of.CLOSED] or albedo(scene.surfaces, of.BOTTOM, wave, 1.0) >= 1.0:
        ledger[of.TRAPPED_END] += weight
    else:
        ledger[of.SUBSTRATE_END] += weight


@inlined_kernel
def lift_of(z: float, dz: float, path: float, top: float) -> float:
    """The integral of 2 z / T - 1 along a path (um) from height z, which the top may turn back once: a rise b of the
    absorption adds b times this to the optical depth."""
    if dz > 0.0:
        to_top = (top - z) / dz
        if path > to_top:
            down = path - to_top
            return (to_top * z + down * (top - down * dz)) / top
    return path * ((2.0 * z + path * dz) / top - 1.0)


@inlined_kernel
def _dim(weight: float, depth: float, ledger: Real) -> float:
    """The weight after an optical depth in the chip's material; what it takes is booked."""
    if depth == 0.0:
        return weight
    left = weight * exp(-depth)
    ledger[of.CHIP_END] += weight - left
    return left


@inlined_kernel
def _note_top(trace: Real, cosine: float, leaks: float) -> None:
    """Note a reflection at the top; `leaks`: the square of the cosine above which it is inside the escape cone."""
    if cosine * cosine <= leaks:
        steps = of.TRACE - of.BEYOND
        trace[of.BEYOND + min(int(cosine / sqrt(leaks) * steps), steps - 1)] += 1.0
        return
    hits = int(trace[of.TOP_HITS])
    if hits < of.BEYOND - of.TOP_COSINES:
        trace[of.TOP_COSINES + hits] = cosine
    trace[of.TOP_HITS] += 1.0


@inlined_kernel
def _roulette(weight: float, faint: float, stream: Stream, ledger: Real) -> float:
    """A faint ray ends, or goes on with twice the weight of a faint one."""
    u, _, _, _ = draw(stream, ROULETTE, 0)
    follow_up(stream, ROULETTE)
    kept = 2.0 * faint if u * 2.0 * faint < weight else 0.0
    ledger[of.ROULETTE_END] += kept - weight
    return kept


@inlined_kernel
def _leaves_at(surfaces: Surfaces, wave: int, n2: float, x: float, dx: float, half: float, u: float) -> float:
    """Path to the wall hit at which a ray leaves through this pair of sides; negative: at which it is absorbed."""
    at, above = node_of(surfaces, of.SIDE_IN, wave, n2 * (1.0 - dx * dx), n2)
    R = share(surfaces, of.SIDE_IN, at, above, 0)
    until = share(surfaces, of.SIDE_IN, at, above, 1)
    if R >= 1.0:
        return inf
    hits = floor(log(u) / log(R)) if R > 0.0 else 0.0
    tile = (x + half) / (2.0 * half)
    wall = floor(tile) + 1.0 if dx > 0.0 else ceil(tile) - 1.0  # never the one at which the ray has just come in
    path = (2.0 * half * wall - half - x) / dx + hits * 2.0 * half / abs(dx)
    if until < 1.0:  # the last hit takes the ray: u is uniform between R^(hits + 1) and R^hits
        left = (u / R**hits - R) / (1.0 - R)
        if left > (until - R) / (1.0 - R):
            return -path
    return path


@inlined_kernel
def _leave(
    ray: Real,
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    half: float,
    n: float,
    axis: int,
    topped: bool,
) -> None:
    """Fold the ray back into the chip and refract it into air at a face across `axis` (2: the top)."""
    along_x, along_y = (x - half if dx > 0.0 else x + half) if axis == 0 else x, y
    if axis == 1:
        along_y = y - half if dy > 0.0 else y + half
    tile_x, tile_y = floor(along_x / (2.0 * half) + 0.5), floor(along_y / (2.0 * half) + 0.5)
    x, y = x - 2.0 * half * tile_x, y - 2.0 * half * tile_y
    if int(tile_x) & 1:
        x, dx = -x, -dx
    if int(tile_y) & 1:
        y, dy = -y, -dy
    dx, dy, dz = n * dx, n * dy, n * dz
    if axis == 0:
        x = half if dx > 0.0 else -half
        dx = sqrt(max(0.0, 1.0 - dy * dy - dz * dz)) * (1.0 if dx > 0.0 else -1.0)
    elif axis == 1:
        y = half if dy > 0.0 else -half
        dy = sqrt(max(0.0, 1.0 - dx * dx - dz * dz)) * (1.0 if dy > 0.0 else -1.0)
    else:
        dz = sqrt(max(0.0, 1.0 - dx * dx - dy * dy))
    _put(ray, x, y, z, dx, dy, dz, axis, topped)


@inlined_kernel
def _put(ray: Real, x: float, y: float, z: float, dx: float, dy: float, dz: float, axis: int, topped: bool) -> None:
    ray[of.X], ray[of.Y], ray[of.Z], ray[of.DX], ray[of.DY], ray[of.DZ] = x, y, z, dx, dy, dz
    if ray[of.EVENT] != of.AFTER_RECEIVER:
        ray[of.EVENT] = of.AFTER_TOP if topped else of.THROUGH_TOP if axis == 2 else of.FROM_SIDES


@borrowing_kernel
def _bottom(
    surfaces: Surfaces, air_gap: bool, wave: int, n: float, dx: float, dy: float, dz: float, stream: Stream
) -> tuple[int, float, float, float]:
    """ABSORBED or REFLECTED, and the direction upwards in the chip, of a ray that meets the bottom."""
    if not air_gap:
        what, dx, dy, dz = scatter(surfaces, of.BOTTOM, wave, 1.0, 1.0, dx, dy, dz, stream, BOTTOM_KIND)
        follow_up(stream, BOTTOM_KIND)
        return what, dx, dy, dz
    what, dx, dy, dz = scatter(surfaces, of.SIDE_IN, wave, n, 1.0, dx, dy, dz, stream, BOTTOM_KIND)
    follow_up(stream, BOTTOM_KIND)
    while what == TRANSMITTED:  # in the gap, between the substrate and the chip's bottom
        what, dx, dy, dz = scatter(surfaces, of.BOTTOM, wave, 1.0, 1.0, dx, dy, dz, stream, BOTTOM_KIND)
        follow_up(stream, BOTTOM_KIND)
        if what != REFLECTED:
            return ABSORBED, 0.0, 0.0, 0.0
        what, dx, dy, dz = scatter(surfaces, of.SIDE_OUT, wave, 1.0, n, dx, dy, -dz, stream, BOTTOM_KIND)
        follow_up(stream, BOTTOM_KIND)
        if what == TRANSMITTED:
            return REFLECTED, dx, dy, -dz
        if what == REFLECTED:
            what, dz = TRANSMITTED, -dz
    return what, dx, dy, dz


@borrowing_kernel
def _walk_plain(scene: SceneArrays, wave: int, ray: Real, stream: Stream, ledger: Real, trace: Real) -> int:
    """Face by face, for sides that scatter or absorb beyond the critical angle."""
    half, top, alpha = scene.numbers[of.HALF_WIDTH], scene.numbers[of.THICKNESS], scene.numbers[of.ABSORPTION]
    rise = scene.numbers[of.ABSORPTION_RISE]
    n, weight, topped = scene.numbers[of.INDEX + wave], ray[of.WEIGHT], False
    x, y, z, dx, dy, dz = ray[of.X], ray[of.Y], ray[of.Z], ray[of.DX], ray[of.DY], ray[of.DZ]
    faint, leaks, steep = FAINT * weight, 1.0 - 1.0 / (n * n), 0.0
    if scene.flags[of.SHUT] and max(dx * dx, dy * dy, dz * dz) <= leaks:
        book_shut_in(scene, wave, weight, z, dz, ledger)
        return ENDED
    for _ in range(LONGEST_WALK):
        to_x = ((half if dx > 0.0 else -half) - x) / dx if dx != 0.0 else inf
        to_y = ((half if dy > 0.0 else -half) - y) / dy if dy != 0.0 else inf
        to_z = ((top if dz > 0.0 else 0.0) - z) / dz if dz != 0.0 else inf
        path = min(to_x, to_y, to_z)
        lift = lift_of(z, dz, path, top)
        weight = _dim(weight, alpha * path + rise * lift, ledger)
        trace[of.PATH] += path
        trace[of.LIFT] += lift
        if weight < faint:
            weight = _roulette(weight, faint, stream, ledger)
            if weight == 0.0:
                return ENDED
        x, y, z = x + dx * path, y + dy * path, z + dz * path
        if path == to_z and dz < 0.0:
            z = 0.0
            trace[of.BOTTOM_HITS] += 1.0
            what, dx, dy, dz = _bottom(scene.surfaces, scene.flags[of.AIR_GAP] == 1, wave, n, dx, dy, dz, stream)
            if what != REFLECTED:
                ledger[of.SUBSTRATE_END] += weight
                return ENDED
            continue
        # the face in surface space: the ray comes along -z of it
        if path == to_z:
            axis, sign, z, steep = 2, 1.0, top, dz
            what, p, q, r = scatter(scene.surfaces, of.TOP_IN, wave, n, 1.0, dx, dy, -dz, stream, FACE)
        elif path == to_x:
            axis, sign = 0, 1.0 if dx > 0.0 else -1.0
            x = sign * half
            what, p, q, r = scatter(scene.surfaces, of.SIDE_IN, wave, n, 1.0, dy, dz, -dx * sign, stream, FACE)
        else:
            axis, sign = 1, 1.0 if dy > 0.0 else -1.0
            y = sign * half
            what, p, q, r = scatter(scene.surfaces, of.SIDE_IN, wave, n, 1.0, dz, dx, -dy * sign, stream, FACE)
        follow_up(stream, FACE)
        if what == ABSORBED:
            ledger[of.DBR_END] += weight
            return ENDED
        if axis == 2:
            dx, dy, dz = p, q, -r
        elif axis == 0:
            dx, dy, dz = -r * sign, p, q
        else:
            dx, dy, dz = q, -r * sign, p
        if what == TRANSMITTED:
            ray[of.WEIGHT] = weight
            _put(ray, x, y, z, dx, dy, dz, axis, topped)
            return OUT
        if axis == 2:
            topped = True
            _note_top(trace, steep, leaks)
    _book_rest(scene, wave, weight, ledger)
    return ENDED
