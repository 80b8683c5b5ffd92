"""Direct light: stored exits of a chip, followed until they first reach the receiver, with frozen random numbers.

What the substrate and other chips do on the way is traced; what the receiver sends back by Lambert's law is not
(`closure` reckons it). Reflections at the receiver that are no Lambert scattering, a mirror's or a lobe's, are followed,
and each of their arrivals counts. Everything is arranged so that small changes of a scene make small changes of the
map: the substrate's reflectance is a factor for each bounce and not a lottery, and an arrival is shared among the four
bins around it in proportion to its distance, so that it moves from bin to bin without a jump.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import floor, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Bsdf, GaussianLobe, Lambertian, Mirror, Mixture
from containers.compiled import borrowing_kernel, inlined_kernel
from containers.ray_tracing.arrays import (
    CHIP_X,
    CHIP_Y,
    DISTANCE,
    DX,
    DY,
    DZ,
    ENDS,
    EVENT,
    HALF_X,
    HALF_Y,
    ORIGIN_X,
    ORIGIN_Y,
    PERIODIC,
    RECEIVER,
    RECEIVER_END,
    RESPONSE,
    RESPONSE_AT,
    SPACING,
    TILT_X,
    TILT_Y,
    WALLS,
    WEIGHT,
    EmissionArrays,
    SceneArrays,
    Sinks,
    X,
    Y,
    Z,
)
from containers.ray_tracing.chip import OUT, walk_chip
from containers.ray_tracing.exits import LANDING, Exits
from containers.ray_tracing.kernel import (
    EVENT_OF_EXIT,
    WAVE_OF_EXIT,
    WEIGHT_OF_EXIT,
    Scratch,
    leave_chip,
    scratch,
)
from containers.ray_tracing.module import INTO_CHIP, clear_way, walk_module
from containers.ray_tracing.monte_carlo import BLOCK, usable_threads
from containers.ray_tracing.packing import scene_arrays
from containers.ray_tracing.philox import CHIP, SUBSTRATE, Stream, draw, follow_up, start
from containers.ray_tracing.philox import RECEIVER as RECEIVER_KIND
from containers.ray_tracing.surfaces import REFLECTED, albedo, scatter
from containers.ray_tracing.tally import OPTICAL_EVENTS, Box, Tally
from containers.scene import Receiver, Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]
Single = NDArray[np.float32]

FAINTEST = 1e-6
"""Share of a ray's weight below which the reflections that are followed at the receiver end."""
ARRIVES, SEEN_MORE = range(2)
"""Layers of the bins: light that arrives, and by how much more of it is recorded (`Receiver.response`)."""


class WayArrays(NamedTuple):
    """A scene for direct light, as kernels read it."""

    scene: SceneArrays
    """With a black receiver and a substrate that takes nothing."""
    receiver: SceneArrays
    """With what of the receiver is followed."""
    kept: float
    """What the substrate keeps at each bounce."""
    box: Real
    """As `Sinks.box`."""


@dataclass(frozen=True)
class Way:
    """A scene for direct light, and where its bins lie."""

    arrays: WayArrays
    box: Box

    @property
    def scene(self) -> SceneArrays:
        """The arrays of the scene."""
        return self.arrays.scene

    def endless(self) -> Way:
        """The same chips in a cell that repeats."""
        numbers, flags = self.scene.numbers.copy(), self.scene.flags.copy()
        numbers[[HALF_X, HALF_Y]], numbers[[ORIGIN_X, ORIGIN_Y, TILT_X, TILT_Y]] = np.inf, 0.0
        flags[[PERIODIC, WALLS]] = 1, 0
        scene = self.scene._replace(numbers=numbers, flags=flags)
        return replace(self, arrays=self.arrays._replace(scene=scene))


def without_loss(bsdf: Bsdf) -> tuple[Bsdf, float]:
    """A surface that scatters alike and absorbs nothing, and the reflectance that is missing; (bsdf, 1) for those whose
    reflectance varies with angle."""
    if isinstance(bsdf, Lambertian) and bsdf.transmittance == 0.0:
        return Lambertian(1.0), bsdf.reflectance
    if isinstance(bsdf, GaussianLobe | Mirror):
        return replace(bsdf, reflectance=1.0), bsdf.reflectance
    if isinstance(bsdf, Mixture):
        parts, factors = zip(*map(without_loss, bsdf.parts), strict=True)
        shares = np.array(bsdf.shares) * factors
        whole = all(isinstance(part, Lambertian | GaussianLobe | Mirror) for part in parts)
        if whole and shares.sum() > 0.0:
            return Mixture(parts, tuple(map(float, shares / shares.sum()))), float(shares.sum())
    return bsdf, 1.0


def lambertian_part(receiver: Bsdf) -> tuple[float, Bsdf]:
    """The reflectance by Lambert's law of a receiver, and the rest of it.

    InputError for a receiver that mixes Lambert's law with what is neither mirror nor lobe.
    """
    black = Lambertian(0.0)
    if isinstance(receiver, Lambertian):
        return receiver.reflectance, black
    if isinstance(receiver, Mixture):
        pairs = list(zip(receiver.parts, receiver.shares, strict=True))
        rest = [(part, share) for part, share in pairs if not isinstance(part, Lambertian)]
        diffuse = sum(share * part.reflectance for part, share in pairs if isinstance(part, Lambertian))
        if all(isinstance(part, Mirror | GaussianLobe) for part, _ in rest):
            return float(diffuse), Mixture(*map(tuple, zip(*rest, strict=True))) if rest else black
    if isinstance(receiver, Mirror | GaussianLobe):
        return 0.0, receiver
    mend = "use Monte Carlo"
    raise InputError(
        "receiver", type(receiver).__name__, "Lambertian, Mirror, GaussianLobe or a Mixture of them", mend
    )


def open_way(scene: Scene, box: Box) -> Way:
    """The arrays that direct light is traced in."""
    _, followed = lambertian_part(scene.receiver.bsdf)
    white, kept = without_loss(scene.substrate)
    # the chip's bottom stays as it is: what is lost there decides how long a ray stays inside
    chip = (
        scene.chip if scene.chip.bottom != "contact" else replace(scene.chip, bottom="mirror", mirror=scene.substrate)
    )
    black = replace(scene, chip=chip, substrate=white, receiver=replace(scene.receiver, bsdf=Lambertian(0.0)))
    arrays = scene_arrays(black)
    rest = arrays if followed == Lambertian(0.0) else scene_arrays(replace(black, receiver=Receiver(followed)))
    return Way(WayArrays(arrays, rest, kept, box.numbers), box)


def direct_light(
    way: Way,
    emission: EmissionArrays,
    exits: Exits,
    seed: int,
    *,
    blocks: int | None = None,
    groups: int | None = None,
    threads: int | None = None,
) -> Tally:
    """Where exits first reach the receiver, group by group; bins (group, layer, y, x).

    Parameters
    ----------
    way : `open_way` of a scene whose chips the exits are of; what lies beside its box, if that is no cell, is dropped.
    emission : which chips shine. blocks : how many blocks of the exits, all by default.
    seed : of what happens on the way. groups : so many at the end, a divisor of the exits' own; all by default.

    Notes
    -----
    A bin holds the light around its centre, with weights that fall linearly to 0 one bin's width away.
    """
    own, blocks = exits.ends.shape[0], blocks or exits.ledger.shape[1]
    groups = groups or own
    box, tables = way.box, way.scene.surfaces.tables
    response = tables[way.scene.flags[RESPONSE_AT] :][: way.scene.flags[RESPONSE]]
    bins = np.zeros((groups, 1 if np.all(response == 1.0) else 2, box.rows, box.columns))

    def land(together: int) -> None:
        numbers, work, lost = np.uint64(seed ^ LANDING), scratch(), nowhere()
        for group in range(together * own // groups, (together + 1) * own // groups):
            mine = slice(exits.ends[group, 0], exits.ends[group, blocks])
            weights = np.zeros(0, np.float32) if exits.weights is None else exits.weights[mine]
            first = exits.first_block * BLOCK
            land_direct(
                way.arrays,
                emission,
                numbers,
                group,
                own,
                first,
                exits.rays[mine],
                weights,
                lost,
                work,
                bins[together],
            )

    in_parallel(land, range(groups), threads)
    ledger = exits.ledger[:, :blocks].sum(axis=1).reshape(groups, -1, len(ENDS)).sum(axis=1)
    nothing = np.zeros((groups, len(OPTICAL_EVENTS))), np.zeros((groups, 2, 0, 0))
    return Tally(box, bins, ledger, *nothing, histories=BLOCK * blocks * own // groups)


def in_parallel(work: Callable[[int], None], numbers: range, threads: int | None) -> None:
    """Call `work` with each number, on several threads at once; all that may be used by default."""
    threads = threads or usable_threads()
    if threads == 1:
        for number in numbers:
            work(number)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, numbers))


def nowhere() -> Sinks:
    """Sinks that keep nothing but a ledger."""
    empty = np.zeros((2, 0, 0))
    return Sinks(empty, np.zeros(5), np.zeros(8), np.zeros(len(OPTICAL_EVENTS)), empty)


@borrowing_kernel
def land_direct(
    way: WayArrays,
    emission: EmissionArrays,
    seed: np.uint64,
    group: int,
    groups: int,
    first: int,
    rays: Single,
    weights: Single,
    sinks: Sinks,
    scratch: Scratch,
    bins: Real,
) -> None:
    """Follow exits, number `first` and on of a group, into `bins` (layer, y, x)."""
    stream, ray, trace, _, _ = scratch
    scene = way.scene
    for number in range(rays.shape[0]):
        start(stream, seed, np.uint64(first + number) * np.uint64(groups) + np.uint64(group))
        for i in range(EVENT_OF_EXIT):
            ray[i] = rays[number, i]
        ray[EVENT] = rays[number, EVENT_OF_EXIT]
        length = 1.0 / sqrt(ray[DX] * ray[DX] + ray[DY] * ray[DY] + ray[DZ] * ray[DZ])
        ray[DX], ray[DY], ray[DZ] = ray[DX] * length, ray[DY] * length, ray[DZ] * length
        chip = 0
        if emission.chip_cumulative.size > 1:
            u, _, _, _ = draw(stream, CHIP, 0)
            while chip < emission.chip_cumulative.size - 1 and u >= emission.chip_cumulative[chip]:
                chip += 1
        ray[CHIP_X], ray[CHIP_Y] = emission.centres_um[chip, 0], emission.centres_um[chip, 1]
        ray[WEIGHT] = rays[number, WEIGHT_OF_EXIT] * (weights[number] if weights.size > 0 else 1.0)
        wave, path = int(rays[number, WAVE_OF_EXIT]), clear_way(scene, ray)
        ray[X] += ray[CHIP_X] + path * ray[DX]
        ray[Y] += ray[CHIP_Y] + path * ray[DY]
        faintest = FAINTEST * ray[WEIGHT]
        if path > 0.0:
            ray[Z] = scene.numbers[DISTANCE]
        landed = path > 0.0 or reaches_receiver(scene, wave, ray, stream, sinks, trace)
        while landed:
            _arrive(way, ray, stream, bins)
            landed = _sent_on(way, wave, ray, stream, faintest) and reaches_receiver(
                scene, wave, ray, stream, sinks, trace
            )


@borrowing_kernel
def reaches_receiver(scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, trace: Real) -> bool:
    """Follow a ray outside the chips to the (black) receiver; False where it ends elsewhere."""
    while True:
        sinks.ledger[RECEIVER_END] = 0.0
        if walk_module(scene, wave, ray, stream, sinks, 0.0) != INTO_CHIP:
            return bool(sinks.ledger[RECEIVER_END] > 0.0)
        if walk_chip(scene, wave, ray, stream, sinks.ledger, trace) != OUT:
            return False
        leave_chip(ray, sinks)


@inlined_kernel
def _arrive(way: WayArrays, ray: Real, stream: Stream, bins: Real) -> None:
    """Put a ray that is at the receiver into the bins."""
    scene, x, y = way.scene, ray[X], ray[Y]
    if scene.flags[PERIODIC]:
        x -= scene.numbers[SPACING] * floor(x / scene.numbers[SPACING] + 0.5)
        y -= scene.numbers[SPACING] * floor(y / scene.numbers[SPACING] + 0.5)
    weight = ray[WEIGHT] * way.kept ** float(stream[2 + SUBSTRATE])
    _deposit(bins, 0, way.box, x, y, weight)
    if bins.shape[0] > 1:
        steps, tables = scene.flags[RESPONSE] - 1, scene.surfaces.tables
        node = min(int(ray[DZ] * steps), steps - 1)
        at = scene.flags[RESPONSE_AT] + node
        seen = tables[at] + (ray[DZ] * steps - node) * (tables[at + 1] - tables[at])
        _deposit(bins, 1, way.box, x, y, weight * (seen - 1.0))


@inlined_kernel
def _sent_on(way: WayArrays, wave: int, ray: Real, stream: Stream, faintest: float) -> bool:
    """Send a ray back by that part of the receiver which is followed; False where nothing is."""
    surfaces = way.receiver.surfaces
    kept = albedo(surfaces, RECEIVER, wave, ray[DZ])
    ray[WEIGHT] *= kept
    if ray[WEIGHT] <= faintest:
        return False
    fate, dx, dy, dz = scatter(
        surfaces, RECEIVER, wave, 1.0, 1.0, ray[DX], ray[DY], -ray[DZ], stream, RECEIVER_KIND, kept
    )
    follow_up(stream, RECEIVER_KIND)
    ray[DX], ray[DY], ray[DZ] = dx, dy, -dz
    return fate == REFLECTED


@inlined_kernel
def _deposit(bins: Real, layer: int, box: Real, x: float, y: float, weight: float) -> None:
    """Share a weight among the four bins around a place."""
    folded, cell = box[3] > 0.0, box[4] > 0.0
    if folded:
        x, y = abs(x), abs(y)
    across, along = (x - box[0]) * box[2] - 0.5, (y - box[1]) * box[2] - 0.5
    column, row = int(floor(across)), int(floor(along))
    right, up = across - column, along - row
    _, rows, columns = bins.shape
    left_at, right_at = _place(column, columns, folded, cell), _place(column + 1, columns, folded, cell)
    low_at, up_at = _place(row, rows, folded, cell), _place(row + 1, rows, folded, cell)
    if low_at >= 0:
        if left_at >= 0:
            bins[layer, low_at, left_at] += weight * (1.0 - right) * (1.0 - up)
        if right_at >= 0:
            bins[layer, low_at, right_at] += weight * right * (1.0 - up)
    if up_at >= 0:
        if left_at >= 0:
            bins[layer, up_at, left_at] += weight * (1.0 - right) * up
        if right_at >= 0:
            bins[layer, up_at, right_at] += weight * right * up


@inlined_kernel
def _place(index: int, size: int, folded: bool, cell: bool) -> int:
    """The bin that stands for one at either end's other side: its mirror image, the other end of a cell, or none."""
    if 0 <= index < size:
        return index
    if index < 0:
        return -1 - index if folded else index + size if cell else -1
    if not cell or index >= 2 * size:
        return -1
    return 2 * size - 1 - index if folded else index - size
