"""Whole histories: born in a chip, followed until they end; as kernels. One call works on one group of histories.

The number of a history is (its place in the group) x groups + group, and all its random numbers follow from it, so a
run is the same however it is cut into calls and whoever computes which group.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from containers.compiled import borrowing_kernel, inlined_kernel
from containers.ray_tracing import arrays as of
from containers.ray_tracing.arrays import EmissionArrays, SceneArrays, Sinks
from containers.ray_tracing.chip import OUT, book_shut_in, walk_chip
from containers.ray_tracing.module import INTO_CHIP, clear_way, receive, walk_module
from containers.ray_tracing.philox import CHIP, EMISSION, STREAM_WORDS, Stream, draw, philox4x32, start
from containers.ray_tracing.recording import note_direction
from containers.ray_tracing.sobol import DIMENSIONS, point

Real = NDArray[np.float64]
EVENT_OF_EXIT, WAVE_OF_EXIT, WEIGHT_OF_EXIT, PLACE_OF_EXIT, EXIT = 6, 7, 8, 9, 10
"""A stored exit: position relative to the chip (um), direction, optical event, number of the wavelength, weight."""
_SOBOL_KEY = np.uint64(0xFFFFFFFF)
_GOLDEN, _ELEVEN = np.uint64(0x9E3779B97F4A7C15), np.uint64(11)


class Scratch(NamedTuple):
    """What a thread writes on while it traces; kernels make no arrays."""

    stream: Stream
    ray: Real
    trace: Real
    keys: NDArray[np.uint64]
    uniforms: Real


def scratch() -> Scratch:
    """A thread's own."""
    return Scratch(
        np.zeros(STREAM_WORDS, np.uint64),
        np.zeros(of.RAY),
        np.zeros(of.TRACE),
        np.zeros(DIMENSIONS, np.uint64),
        np.zeros(DIMENSIONS),
    )


@borrowing_kernel
def trace_group(
    scene: SceneArrays,
    emission: EmissionArrays,
    seed: np.uint64,
    group: int,
    groups: int,
    first: int,
    count: int,
    sobol: bool,
    survival: float,
    fan: int,
    directions: NDArray[np.uint64],
    sinks: Sinks,
    scratch: Scratch,
) -> None:
    """Trace histories `first` to `first + count` of a group into its sinks."""
    stream, ray, trace, keys, uniforms = scratch
    scramble_keys(seed, group, keys)
    for place in range(first, first + count):
        start(stream, seed, np.uint64(place) * np.uint64(groups) + np.uint64(group))
        wave = emit(scene, emission, stream, place, sobol, directions, keys, uniforms, ray, sinks.ledger)
        if not scene.flags[of.FROM_TOP] and walk_chip(scene, wave, ray, stream, sinks.ledger, trace) != OUT:
            continue
        leave_chip(ray, sinks)
        follow(scene, wave, ray, stream, sinks, survival, fan, trace)


@borrowing_kernel
def exits_of_group(
    scene: SceneArrays,
    emission: EmissionArrays,
    seed: np.uint64,
    group: int,
    groups: int,
    first: int,
    count: int,
    sobol: bool,
    directions: NDArray[np.uint64],
    rays: NDArray[np.float32],
    notes: NDArray[np.float32],
    ledger: Real,
    scratch: Scratch,
) -> int:
    """Follow histories of a group inside their chip only; the exits, one after the other, into `rays` (n, EXIT) and,
    where there is room, what is noted of their way, into `notes` (n, TRACE). Returns how many there are."""
    stream, ray, trace, keys, uniforms = scratch
    scramble_keys(seed, group, keys)
    found = 0
    for place in range(first, first + count):
        start(stream, seed, np.uint64(place) * np.uint64(groups) + np.uint64(group))
        wave = emit(scene, emission, stream, place, sobol, directions, keys, uniforms, ray, ledger)
        born_x, born_y = ray[of.X], ray[of.Y]
        if not scene.flags[of.FROM_TOP] and walk_chip(scene, wave, ray, stream, ledger, trace) != OUT:
            continue
        trace[of.BORN_X], trace[of.BORN_Y] = born_x, born_y
        for i in range(EVENT_OF_EXIT):
            rays[found, i] = ray[i]
        rays[found, EVENT_OF_EXIT], rays[found, WAVE_OF_EXIT] = ray[of.EVENT], wave
        rays[found, WEIGHT_OF_EXIT], rays[found, PLACE_OF_EXIT] = ray[of.WEIGHT], place - first
        ledger[of.ROULETTE_END] += rays[found, WEIGHT_OF_EXIT] - ray[of.WEIGHT]  # what single precision made of it
        for i in range(notes.shape[1]):
            notes[found, i] = trace[i]
        found += 1
    return found


@borrowing_kernel
def land_group(
    scene: SceneArrays,
    emission: EmissionArrays,
    seed: np.uint64,
    group: int,
    groups: int,
    numbers: NDArray[np.uint64],
    rays: NDArray[np.float32],
    weights: NDArray[np.float32],
    survival: float,
    fan: int,
    sinks: Sinks,
    scratch: Scratch,
) -> None:
    """Follow stored exits, of histories `numbers` (n,) of a group, from their chip until they end.

    `weights` (n,): factor on each exit's weight where the chip is another than the one it comes from; (0,): none.
    """
    stream, ray, trace, _, _ = scratch
    start(stream, seed, np.uint64(group))
    shift, _, _, _ = draw(stream, CHIP, 0)
    for number in range(rays.shape[0]):
        start(stream, seed, numbers[number] * np.uint64(groups) + np.uint64(group))
        wave = take_exit(emission, rays, weights, number, _in_turn(numbers[number], shift), ray)
        path = clear_way(scene, ray)
        leave_chip(ray, sinks)
        if path > 0.0:
            ray[of.X] += path * ray[of.DX]
            ray[of.Y] += path * ray[of.DY]
            ray[of.Z] = scene.numbers[of.DISTANCE]
            if not receive(scene, wave, ray, stream, sinks, survival, 1.0):
                continue
        follow(scene, wave, ray, stream, sinks, survival, fan, trace)


@inlined_kernel
def take_exit(
    emission: EmissionArrays,
    rays: NDArray[np.float32],
    weights: NDArray[np.float32],
    number: int,
    u: float,
    ray: Real,
) -> int:
    """Put a stored exit into `ray`, position relative to the chip that `u` chooses; the number of its wavelength."""
    for i in range(EVENT_OF_EXIT):
        ray[i] = rays[number, i]
    ray[of.EVENT] = rays[number, EVENT_OF_EXIT]
    length = 1.0 / sqrt(ray[of.DX] * ray[of.DX] + ray[of.DY] * ray[of.DY] + ray[of.DZ] * ray[of.DZ])
    ray[of.DX], ray[of.DY], ray[of.DZ] = ray[of.DX] * length, ray[of.DY] * length, ray[of.DZ] * length
    _choose_chip(emission, u, ray)
    ray[of.WEIGHT] = weight_of(rays, weights, number)
    return int(rays[number, WAVE_OF_EXIT])


@inlined_kernel
def weight_of(rays: NDArray[np.float32], weights: NDArray[np.float32], number: int) -> float:
    """Of a stored exit."""
    return float(rays[number, WEIGHT_OF_EXIT] * (weights[number] if weights.size > 0 else 1.0))


@borrowing_kernel
def follow(
    scene: SceneArrays, wave: int, ray: Real, stream: Stream, sinks: Sinks, survival: float, fan: int, trace: Real
) -> None:
    """Follow a ray outside the chips (module coordinates) until it ends."""
    while walk_module(scene, wave, ray, stream, sinks, survival, fan) == INTO_CHIP:
        if walk_chip(scene, wave, ray, stream, sinks.ledger, trace) != OUT:
            return
        leave_chip(ray, sinks)


@inlined_kernel
def leave_chip(ray: Real, sinks: Sinks) -> None:
    """From positions relative to the chip to the module's; notes the direction of light not yet back from above."""
    if sinks.directions.shape[1] > 0 and ray[of.EVENT] != of.AFTER_RECEIVER:
        note_direction(sinks.directions, 0, ray[of.DX], ray[of.DY], ray[of.DZ], ray[of.WEIGHT])
    ray[of.X] += ray[of.CHIP_X]
    ray[of.Y] += ray[of.CHIP_Y]


@borrowing_kernel
def scramble_keys(seed: np.uint64, group: int, keys: NDArray[np.uint64]) -> None:
    """The keys of a group's own Sobol sequence, (dimension,)."""
    for dimension in range(keys.size):
        keys[dimension], _, _, _ = philox4x32(np.uint64(group), np.uint64(dimension), np.uint64(0), _SOBOL_KEY, seed)


@inlined_kernel
def emit(
    scene: SceneArrays,
    emission: EmissionArrays,
    stream: Stream,
    place: int,
    sobol: bool,
    directions: NDArray[np.uint64],
    keys: NDArray[np.uint64],
    uniforms: Real,
    ray: Real,
    ledger: Real,
) -> int:
    """Begin a history: position relative to its chip, direction, chip; returns the number of its wavelength."""
    a, b, c, d = draw(stream, EMISSION, 0)
    if sobol:
        point(directions, np.uint64(place), keys, uniforms)
    else:
        uniforms[0], uniforms[1], uniforms[2], uniforms[3] = a, b, c, d
        uniforms[4], uniforms[5], _, _ = draw(stream, EMISSION, 1)
    choose, _, _, _ = draw(stream, CHIP, 0)
    wave = 0
    while wave < emission.wave_cumulative.size - 1 and choose >= emission.wave_cumulative[wave]:
        wave += 1
    _place(scene, emission, uniforms, ray)
    _choose_chip(emission, uniforms[5], ray)
    ray[of.WEIGHT], ray[of.EVENT] = 1.0, float(of.THROUGH_TOP)
    ledger[of.EMITTED] += 1.0
    if scene.flags[of.CONES]:
        _into_cones(emission, scene.numbers[of.INDEX + wave], uniforms, ray)
        _book_trapped(scene, emission, wave, stream, ray, ledger)
    return wave


@inlined_kernel
def _place(scene: SceneArrays, emission: EmissionArrays, uniforms: Real, ray: Real) -> None:
    width = 2.0 * scene.numbers[of.HALF_WIDTH]
    cosine = _quantile(emission.cosine_quantiles, uniforms[0])
    if scene.flags[of.FROM_TOP]:
        cosine = sqrt(uniforms[0])
    sine, phi = sqrt(max(0.0, 1.0 - cosine * cosine)), 2.0 * pi * uniforms[1]
    ray[of.DX], ray[of.DY], ray[of.DZ] = sine * np.cos(phi), sine * np.sin(phi), cosine
    rows = emission.row_cumulative
    row, up = _cell(rows, uniforms[3])
    column, right = _cell(emission.column_cumulative[row], uniforms[2])
    ray[of.X] = ((column + right) / (emission.column_cumulative.shape[1] - 1) - 0.5) * width
    ray[of.Y] = ((row + up) / (rows.size - 1) - 0.5) * width
    ray[of.Z] = scene.numbers[of.THICKNESS] * (
        1.0 if scene.flags[of.FROM_TOP] else _quantile(emission.height_quantiles, uniforms[4])
    )


@inlined_kernel
def _into_cones(emission: EmissionArrays, n: float, uniforms: Real, ray: Real) -> None:
    """A direction within the escape cone of one of the six faces, weighted by the emission there over its density."""
    axis = min(int(uniforms[0] * 6.0), 5)
    solid = 1.0 - sqrt(1.0 - 1.0 / (n * n))  # of a cone, over 2 pi
    along = 1.0 - solid * (uniforms[0] * 6.0 - axis)
    across, phi = sqrt(max(0.0, 1.0 - along * along)), 2.0 * pi * uniforms[1]
    if axis & 1:
        along = -along
    p, q = across * np.cos(phi), across * np.sin(phi)
    ray[of.DX], ray[of.DY], ray[of.DZ] = (along, p, q) if axis < 2 else (q, along, p) if axis < 4 else (p, q, along)
    place = (ray[of.DZ] + 1.0) * 0.5 * (emission.intensity.size - 1)
    node = min(int(place), emission.intensity.size - 2)
    here = emission.intensity[node]
    ray[of.WEIGHT] = (here + (place - node) * (emission.intensity[node + 1] - here)) * 12.0 * pi * solid


@borrowing_kernel
def _book_trapped(
    scene: SceneArrays, emission: EmissionArrays, wave: int, stream: Stream, ray: Real, ledger: Real
) -> None:
    """Where the light that is born outside all escape cones ends.

    On average over histories it is 1 - weight; each books its own along one drawn direction of such light. A closed
    chip needs none.
    """
    n, cosine = scene.numbers[of.INDEX + wave], 0.5
    if not scene.flags[of.CLOSED]:
        inside = sqrt(1.0 - 1.0 / (n * n))
        for attempt in range(2, 66):
            a, b, _, _ = draw(stream, EMISSION, attempt)
            tried = _quantile(emission.cosine_quantiles, a)
            sine, phi = sqrt(max(0.0, 1.0 - tried * tried)), 2.0 * pi * b
            if max(abs(tried), abs(sine * np.cos(phi)), abs(sine * np.sin(phi))) < inside:
                cosine = tried
                break
    book_shut_in(scene, wave, 1.0 - ray[of.WEIGHT], ray[of.Z], cosine, ledger)


@inlined_kernel
def _choose_chip(emission: EmissionArrays, u: float, ray: Real) -> None:
    """The chip of a history, in proportion to the powers."""
    chip = 0
    while chip < emission.chip_cumulative.size - 1 and u >= emission.chip_cumulative[chip]:
        chip += 1
    ray[of.CHIP_X], ray[of.CHIP_Y] = emission.centres_um[chip, 0], emission.centres_um[chip, 1]


@inlined_kernel
def _in_turn(number: np.uint64, shift: float) -> float:
    """Multiples of the golden section, mod 1: any run of numbers gives each chip its share, to a few."""
    u = shift + float((number * _GOLDEN) >> _ELEVEN) * 2.0**-53
    return u - 1.0 if u >= 1.0 else u


@inlined_kernel
def _quantile(quantiles: Real, u: float) -> float:
    """The value below which a share u lies."""
    at = u * (quantiles.size - 1)
    node = min(int(at), quantiles.size - 2)
    return float(quantiles[node] + (at - node) * (quantiles[node + 1] - quantiles[node]))


@inlined_kernel
def _cell(cumulative: Real, u: float) -> tuple[int, float]:
    """The cell in which u falls, and where in it."""
    cell = 0
    while cell < cumulative.size - 2 and u >= cumulative[cell + 1]:
        cell += 1
    return cell, (u - cumulative[cell]) / (cumulative[cell + 1] - cumulative[cell])
