"""Direct light as kernels: exits followed to the receiver, their arrivals shared among the bins around them."""

from __future__ import annotations

from math import floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from containers.compiled import borrowing_kernel, inlined_kernel
from containers.ray_tracing.arrays import (
    BORN_X,
    BORN_Y,
    CHIP_X,
    CHIP_Y,
    DBR_END,
    DISTANCE,
    DX,
    DY,
    DZ,
    PERIODIC,
    RECEIVER,
    RECEIVER_END,
    SPACING,
    WEIGHT,
    EmissionArrays,
    SceneArrays,
    Sinks,
    X,
    Y,
    Z,
)
from containers.ray_tracing.chip import OUT, walk_chip
from containers.ray_tracing.kernel import Scratch, leave_chip, take_exit, weight_of
from containers.ray_tracing.module import INTO_CHIP, clear_way, walk_module, way_down
from containers.ray_tracing.philox import RECEIVER as RECEIVER_KIND
from containers.ray_tracing.philox import SUBSTRATE, Stream, follow_up, start
from containers.ray_tracing.recording import recorded_share
from containers.ray_tracing.surfaces import REFLECTED, albedo, scatter

Real = NDArray[np.float64]
Single = NDArray[np.float32]

IMAGES = tuple((x, y, swapped) for swapped in (False, True) for x in (1.0, -1.0) for y in (1.0, -1.0))
"""The symmetries of the square: signs of x and y, and whether they are exchanged; the first four are those of a
rectangle, the first one that of anything."""
ALONE, LOST, MOST_BOUNCES = -1, -2, 127
"""What else becomes of an exit than some bounces and the receiver: it meets a chip, bounces more often, or loses
weight on its way, so that it is followed by itself; or it ends elsewhere."""
ARRIVES, SEEN_MORE, INSIDE = range(3)
"""Layers of the bins: light that arrives, and by how much more of it is recorded (`Receiver.response`); and, on a
substrate that leaks, light that goes on inside it, where it does."""
FAINTEST = 1e-6
"""Share of a ray's weight below which the reflections that are followed at the receiver end."""


class WayArrays(NamedTuple):
    """A scene for direct light, as kernels read it."""

    scene: SceneArrays
    """With a black receiver and a substrate that takes nothing and does not leak."""
    receiver: SceneArrays
    """With what of the receiver is followed."""
    kept: float
    """What the substrate keeps at each bounce, of what does not leak."""
    leak_share: float
    """Share of the light at the substrate that goes on inside it."""
    box: Real
    """As `Sinks.box`."""


class BirthArrays(NamedTuple):
    """What an exit counts for by where its light was born."""

    weights: Real
    """(y, x), of equal cells of the chip's area; (0, 0): each counts 1."""
    per_um: float
    """One over the chip's width."""
    images: int
    """Of `IMAGES`, so many that each exit stands for."""


class Arrivals(NamedTuple):
    """Where exits, of weights from 0, first come to the receiver before they meet a chip; (0,): nobody has looked."""

    places: Real
    """(exit, 3): x and y in um, cosine to the receiver."""
    bounces: NDArray[np.int8]
    """(exit,) at the substrate until then; or `ALONE`, or `LOST`."""


@borrowing_kernel
def walk_ways(
    dark: SceneArrays,
    emission: EmissionArrays,
    seed: np.uint64,
    group: int,
    groups: int,
    numbers: NDArray[np.uint64],
    rays: Single,
    weights: Single,
    arrivals: Arrivals,
    sinks: Sinks,
    scratch: Scratch,
) -> None:
    """Follow exits, of histories `numbers` (n,) of a group, to the receiver or to chips, which take what comes."""
    stream, ray, trace, _, _ = scratch
    for number in range(rays.shape[0]):
        start(stream, seed, numbers[number] * np.uint64(groups) + np.uint64(group))
        wave = take_exit(emission, rays, weights, number, 0.0, ray)
        ray[WEIGHT], sinks.ledger[DBR_END] = 1.0, 0.0
        if _lands(dark, wave, ray, stream, sinks, trace):
            bounces = stream[2 + SUBSTRATE]
            arrivals.places[number, 0], arrivals.places[number, 1] = ray[X], ray[Y]
            arrivals.places[number, 2] = ray[DZ]
            arrivals.bounces[number] = bounces if bounces <= MOST_BOUNCES and ray[WEIGHT] == 1.0 else ALONE
        else:
            arrivals.bounces[number] = ALONE if sinks.ledger[DBR_END] > 0.0 else LOST


@borrowing_kernel
def land_direct(
    way: WayArrays,
    emission: EmissionArrays,
    seed: np.uint64,
    group: int,
    groups: int,
    numbers: NDArray[np.uint64],
    rays: Single,
    weights: Single,
    notes: Single,
    births: BirthArrays,
    arrivals: Arrivals,
    sinks: Sinks,
    scratch: Scratch,
    bins: Real,
) -> None:
    """Follow exits, of histories `numbers` (n,) of a group, into `bins` (layer, y, x).

    `weights`, `notes`: as `Exits` has them, none where they are empty; notes are read where births have weights.
    """
    stream, ray, trace, _, _ = scratch
    scene, known = way.scene, arrivals.bounces.size > 0
    for number in range(rays.shape[0]):
        if known and arrivals.bounces[number] >= 0:
            ray[X], ray[Y], ray[DZ] = arrivals.places[number]
            ray[WEIGHT] = weight_of(rays, weights, number)
            _arrive(way, ray, arrivals.bounces[number], births, notes, number, bins)
            continue
        if known and arrivals.bounces[number] == LOST:
            continue
        start(stream, seed, numbers[number] * np.uint64(groups) + np.uint64(group))
        wave = take_exit(emission, rays, weights, number, 0.0, ray)
        faintest = FAINTEST * ray[WEIGHT]
        landed = _lands(scene, wave, ray, stream, sinks, trace)
        while landed:
            _arrive(way, ray, stream[2 + SUBSTRATE], births, notes, number, bins)
            landed = _sent_on(way, wave, ray, stream, faintest)
            if landed and way.leak_share > 0.0:
                _go_inside(way, ray, stream[2 + SUBSTRATE], births, notes, number, bins)
            landed = landed and reaches_receiver(scene, wave, ray, stream, sinks, trace)


@borrowing_kernel
def land_inside(
    way: WayArrays,
    emission: EmissionArrays,
    rays: Single,
    weights: Single,
    notes: Single,
    births: BirthArrays,
    scratch: Scratch,
    bins: Real,
) -> None:
    """Put what goes on inside the substrate of exits that first meet it into `bins`; parameters as `land_direct`'s.

    No walls stand in the way: who has them knows no twin.
    """
    _, ray, _, _, _ = scratch
    for number in range(rays.shape[0]):
        take_exit(emission, rays, weights, number, 0.0, ray)
        ray[X] += ray[CHIP_X]
        ray[Y] += ray[CHIP_Y]
        _go_inside(way, ray, 0, births, notes, number, bins)


@inlined_kernel
def _lands(scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, trace: Real) -> bool:
    """Follow an exit, as it was taken, to the (black) receiver; False where it ends elsewhere."""
    path = clear_way(scene, ray)
    ray[X] += ray[CHIP_X] + path * ray[DX]
    ray[Y] += ray[CHIP_Y] + path * ray[DY]
    if path > 0.0:
        ray[Z] = scene.numbers[DISTANCE]
        return True
    return reaches_receiver(scene, wave, ray, stream, sinks, trace)


@borrowing_kernel
def reaches_receiver(scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, trace: Real) -> bool:
    """Follow a ray outside the chips to the (black) receiver; False where it ends elsewhere."""
    while True:
        sinks.ledger[RECEIVER_END] = 0.0
        if walk_module(scene, wave, ray, stream, sinks, 0.0, 1) != INTO_CHIP:
            return bool(sinks.ledger[RECEIVER_END] > 0.0)
        if walk_chip(scene, wave, ray, stream, sinks.ledger, trace) != OUT:
            return False
        leave_chip(ray, sinks)


@inlined_kernel
def _arrive(
    way: WayArrays, ray: Real, bounces: int, births: BirthArrays, notes: Single, number: int, bins: Real
) -> None:
    """Put a ray that is at the receiver into the bins."""
    weight = ray[WEIGHT] * _kept_after(way, bounces)
    _share_out(way, ray[X], ray[Y], ARRIVES, weight, births, notes, number, bins)
    if bins.shape[0] > 1:
        more = weight * (recorded_share(way.scene, ray[DZ]) - 1.0)
        _share_out(way, ray[X], ray[Y], SEEN_MORE, more, births, notes, number, bins)


@borrowing_kernel
def _go_inside(
    way: WayArrays, ray: Real, bounces: int, births: BirthArrays, notes: Single, number: int, bins: Real
) -> None:
    """Put what goes on inside the substrate of a ray on its way there into the bins; nothing if it meets a chip."""
    path = way_down(way.scene, ray)
    if path > 0.0:
        x, y = ray[X] + path * ray[DX], ray[Y] + path * ray[DY]
        weight = ray[WEIGHT] * _kept_after(way, bounces) * way.leak_share
        _share_out(way, x, y, INSIDE, weight, births, notes, number, bins)


@inlined_kernel
def _kept_after(way: WayArrays, bounces: int) -> float:
    """What is left of a ray after some bounces at the substrate."""
    if bounces == 0:
        return 1.0
    once = way.kept * (1.0 - way.leak_share)
    return once if bounces == 1 else once ** float(bounces)  # of most there is one: no power


@inlined_kernel
def _share_out(
    way: WayArrays, x: float, y: float, layer: int, weight: float,
    births: BirthArrays, notes: Single, number: int, bins: Real,
) -> None:  # fmt: skip
    """Put a weight, or its images by birthplace, into a layer of the bins; in a cell that repeats, into the cell."""
    scene = way.scene
    if scene.flags[PERIODIC]:
        x -= scene.numbers[SPACING] * floor(x / scene.numbers[SPACING] + 0.5)
        y -= scene.numbers[SPACING] * floor(y / scene.numbers[SPACING] + 0.5)
    rows, columns = births.weights.shape
    if rows == 0:
        _deposit(bins, layer, way.box, x, y, weight)
        return
    born_x, born_y = notes[number, BORN_X] * births.per_um, notes[number, BORN_Y] * births.per_um
    for image in range(births.images):
        to_x, to_y, swapped = IMAGES[image]
        column = min(max(int(((born_y if swapped else born_x) * to_x + 0.5) * columns), 0), columns - 1)
        row = min(max(int(((born_x if swapped else born_y) * to_y + 0.5) * rows), 0), rows - 1)
        share = births.weights[row, column] / births.images * weight
        _deposit(bins, layer, way.box, (y if swapped else x) * to_x, (x if swapped else y) * to_y, share)


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
    column, row = floor(across), floor(along)
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
