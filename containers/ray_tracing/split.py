"""Expected-value splitting in the chip where light is born: an alternative to `kernel.trace_group`, for comparison.

On each flight from bottom to bottom in an escape cone w P is followed at once and w (1 - P) stays in the chip, where
the analog walk lets all of w out with probability P; faint parts play roulette. The gain: benchmarks/ray_gains.py.
"""

from __future__ import annotations

from math import copysign, floor, inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.compiled import borrowing_kernel, inlined_kernel
from containers.ray_tracing import arrays as of
from containers.ray_tracing.chip import (
    LONGEST_WALK,
    _book_rest,
    _bottom,
    _dim,
    _leave,
    _leaves_at,
    _roulette,
    lift_of,
)
from containers.ray_tracing.kernel import Scratch, emit, follow, leave_chip, scramble_keys, scratch
from containers.ray_tracing.monte_carlo import MonteCarlo
from containers.ray_tracing.philox import FACE, Stream, draw, follow_up, start
from containers.ray_tracing.sobol import DIRECTIONS
from containers.ray_tracing.surfaces import REFLECTED, Surfaces, node_of, share
from containers.scene import Scene
from luxloop.errors import InputError

FAINT = 0.2  # of the weight at birth, below which roulette is played: dearer to follow than in the analog walk


class SplitMonteCarlo(MonteCarlo):
    """`MonteCarlo` whose source chips split; InputError for a scene where they cannot."""

    def __init__(self, scene: Scene, seed: int, **options: Any) -> None:
        super().__init__(scene, seed, **options)
        flags = self.arrays.flags
        if not flags[of.UNFOLD] or flags[of.TOP_LOSSY] or flags[of.FROM_TOP]:
            raise InputError("scene", "its chip", "clear sides, a lossless top, light born inside", "use MonteCarlo")

    def _trace(self, count: int, group: int) -> None:
        tally = self.tally
        split_group(
            self.arrays, self._emission, np.uint64(self.seed), group, tally.groups, tally.histories, count,
            self._sobol, self._survival, DIRECTIONS, tally.sinks(group), scratch(),
        )  # fmt: skip


@borrowing_kernel
def split_group(
    scene: of.SceneArrays, emission: of.EmissionArrays, seed: np.uint64, group: int, groups: int, first: int,
    count: int, sobol: bool, survival: float, directions: NDArray[np.uint64], sinks: of.Sinks, scratch: Scratch,
) -> None:  # fmt: skip
    """`kernel.trace_group`, by splitting."""
    stream, ray, trace, keys, uniforms = scratch
    scramble_keys(seed, group, keys)
    for place in range(first, first + count):
        start(stream, seed, np.uint64(place) * np.uint64(groups) + np.uint64(group))
        wave = emit(scene, emission, stream, place, sobol, directions, keys, uniforms, ray, sinks.ledger)
        _split_history(scene, wave, ray, stream, sinks, survival, trace)


@borrowing_kernel
def _split_history(
    scene: of.SceneArrays, wave: int, ray: of.Real, stream: Stream, sinks: of.Sinks, survival: float, trace: of.Real
) -> None:
    """Walk in the source chip, flight by flight (`chip._walk_unfolded`), and follow what leaves on each of them."""
    top, alpha, n = scene.numbers[of.THICKNESS], scene.numbers[of.ABSORPTION], scene.numbers[of.INDEX + wave]
    half, ledger, surfaces, n2 = scene.numbers[of.HALF_WIDTH], sinks.ledger, scene.surfaces, n * n
    rise = scene.numbers[of.ABSORPTION_RISE]
    x, y, z, dx, dy, dz = ray[of.X], ray[of.Y], ray[of.Z], ray[of.DX], ray[of.DY], ray[of.DZ]
    chip_x, chip_y, weight, topped = ray[of.CHIP_X], ray[of.CHIP_Y], ray[of.WEIGHT], False
    faint, leaks = FAINT * weight, 1.0 - 1.0 / n2
    for _ in range(LONGEST_WALK):
        a, b, _, _ = draw(stream, FACE, 0)
        follow_up(stream, FACE)
        top_at, bottom_at = ((top - z) / dz, (2.0 * top - z) / dz) if dz > 0.0 else (inf, -z / dz)
        axis, stays, at = 0 if dx * dx > leaks else 1 if dy * dy > leaks else 2, 1.0, inf
        meets_top = axis == 2 and dz > 0.0 and dz * dz > leaks
        if axis < 2:
            along, going = (x, dx) if axis == 0 else (y, dy)
            stays, at = _by_sides(surfaces, wave, n2, along, going, half, bottom_at, a)
        elif meets_top:
            node, above = node_of(surfaces, of.TOP_IN, wave, n2 * (1.0 - dz * dz), n2)
            stays = share(surfaces, of.TOP_IN, node, above, 0)
            taken = stays + b * (1.0 - stays) >= share(surfaces, of.TOP_IN, node, above, 1)
            at = -top_at if taken else top_at
        elif scene.flags[of.CLOSED] and dz * dz <= leaks:
            ledger[of.TRAPPED_END if alpha == 0.0 else of.CHIP_END] += weight
            return
        leaving = 0.0
        if stays < 1.0:
            depth = alpha * abs(at) + rise * lift_of(z, dz, abs(at), top)
            leaving = _dim(weight * (1.0 - stays), depth, ledger)
        leaving = _roulette(leaving, faint, stream, ledger) if 0.0 < leaving < faint else leaving
        if leaving > 0.0 and at < 0.0:
            ledger[of.DBR_END] += leaving
        elif leaving > 0.0:
            height, going = (2.0 * top - z - dz * at, -dz) if at > top_at else (z + dz * at, dz)
            ray[of.WEIGHT], ray[of.CHIP_X], ray[of.CHIP_Y] = leaving, chip_x, chip_y
            ray[of.EVENT] = float(of.THROUGH_TOP)
            _leave(ray, x + dx * at, y + dy * at, height, dx, dy, going, half, n, axis, topped or at > top_at)
            leave_chip(ray, sinks)
            follow(scene, wave, ray, stream, sinks, survival, 1, trace)
        depth = alpha * bottom_at + rise * lift_of(z, dz, bottom_at, top)
        weight, topped = _dim(weight * stays, depth, ledger), topped or dz > 0.0
        x, y, z = x + dx * bottom_at, y + dy * bottom_at, 0.0
        what, dx, dy, dz = _bottom(surfaces, scene.flags[of.AIR_GAP] == 1, wave, n, dx, dy, -abs(dz), stream)
        if what != REFLECTED:
            ledger[of.SUBSTRATE_END] += weight
            return
        weight = _roulette(weight, faint, stream, ledger) if 0.0 < weight < faint else weight
        if weight == 0.0:
            return
    _book_rest(scene, wave, weight, ledger)


@inlined_kernel
def _by_sides(
    surfaces: Surfaces, wave: int, n2: float, x: float, dx: float, half: float, bottom_at: float, u: float
) -> tuple[float, float]:
    """Share that no wall of this pair lets out before the bottom, and where the rest leaves (`chip._leaves_at`)."""
    node, above = node_of(surfaces, of.SIDE_IN, wave, n2 * (1.0 - dx * dx), n2)
    hits = abs(floor((x + dx * bottom_at + half) / (2.0 * half)) - floor((x + half) / (2.0 * half)))
    stays = share(surfaces, of.SIDE_IN, node, above, 0) ** hits
    at = _leaves_at(surfaces, wave, n2, x, dx, half, stays + (1.0 - stays) * u) if stays < 1.0 else inf
    return stays, copysign(min(abs(at), bottom_at), at)
