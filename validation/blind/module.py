"""The light of modules: a chip's own light laid at all chips, what the module changes of it, and all bounces.

    E = sum of chips + change + rho (K * w E + change of a bounce)        w: 1 within the module, 0 beyond its edge

A chip's light (`tracing.lone_chip`) and the kernel K of one bounce are traced above an endless even substrate;
both changes are traced as differences between the module and that, with the same random numbers: of a module with
nothing but chips only rays that meet another chip or the edge count.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

import numpy as np

from validation.blind import maps, tracing
from validation.blind.chip import Body
from validation.blind.ground import Ground
from validation.blind.kinds import acting
from validation.blind.optics import image_of
from validation.blind.scenes import (
    FILMS,
    LEFT_AND_RIGHT,
    LOPSIDED_CHIPS,
    LOPSIDED_GROUND,
    OF_SEVERAL,
    UNEVEN_GROUND,
    Layout,
    There,
    bare,
    body_of,
    ground_of,
    layout_of,
    lone,
)
from validation.blind.words import Camera, Hidden, Pose, Real, Sample, Surroundings, within

SETTLED, SETTLING = 1e-7, 1e-4
"""Of the brightest place: by which light with all its bounces may still move, at last and on the way there."""
CHANGE = 2e-4
"""Of all light: below that the next pass of the bounces is the last."""
MOST_PASSES = 8
FEWER, SINGLE = 4, 16
"""A chip's own light takes most histories; of these one in so many is traced again for what its module changes: fewer
for a single chip, where few rays come back to it and nothing else is there."""
CHIP, KERNEL, FIRST, BOUNCE = range(4)
"""What a seed is drawn for."""
PER_UM2 = 1e6
"""Of 1/mm^2."""


def light_of(
    surroundings: Surroundings,
    samples: Sequence[Sample],
    camera: Camera,
    poses: Sequence[Pose],
    hidden: Sequence[Hidden] = (),
    *,
    seed: int,
    histories: int,
    heard: Callable[[int, int], None] | None = None,
) -> list[Real]:
    """Images (row, column) in 1/mm^2 per flux of one chip; see `validation.blind.light`."""
    there = acting(hidden)
    within("seed", seed, 0, 2**62)
    within("histories", histories, 1, 10**11)
    if len(poses) != len(samples):
        raise ValueError(f"poses: {len(poses)} for {len(samples)} samples: as many are needed")
    tracer = Tracer(surroundings, samples, there, seed, int(histories))
    images = []
    for number, (sample, pose) in enumerate(zip(samples, poses, strict=True)):
        light, grid = tracer.light(sample)
        images.append(image_of(light * PER_UM2, grid, sample.module_half_um, camera, pose, there))
        if heard is not None:
            heard(number + 1, len(samples))
    return images


class Tracer:
    """Traces samples; what they share is traced once."""

    def __init__(
        self, surroundings: Surroundings, samples: Sequence[Sample], there: There, seed: int, histories: int
    ) -> None:
        self._surroundings, self._there = surroundings, there
        self._seed, self._histories = seed, histories
        self._samples = samples
        self._kept: dict[Hashable, Real] = {}
        self._bodies: dict[Hashable, Body] = {}
        self._planes = 2 if there.keys() & {"slant_response", "glossy_receiver"} else 1
        self._slant = 2.0 * there["slant_response"].amount if "slant_response" in there else 0.0

    def light(self, sample: Sample) -> tuple[Real, maps.Grid]:
        """What the receiver of a sample records, (y, x) per um^2 and flux of one chip, and where."""
        grid = self._grid(sample)
        layout = layout_of(sample, self._there)
        ground = ground_of(self._surroundings, sample, layout, self._there)
        first, body = self._of_chips(sample, layout, ground, grid)
        first = first + self._change_of_first(sample, layout, ground, body, grid)
        return self._with_bounces(sample, ground, body, grid, first)[0], grid

    def _grid(self, sample: Sample) -> maps.Grid:
        alike = [one for one in self._samples if one.height_um == sample.height_um]
        return maps.grid_for(sample.height_um, max(one.module_half_um + one.reach_um for one in alike))

    def _of_chips(self, sample: Sample, layout: Layout, ground: Ground, grid: maps.Grid) -> tuple[Real, Body]:
        """The first light of all chips, each as if it stood alone."""
        total = np.zeros((self._planes, grid.size, grid.size))
        wedge = "growth_wedge" in self._there and sample.dbr_pairs > 0.0
        kinds = [(float(x) if wedge else 0.0, float(half)) for (x, _), half in
                 zip(layout.centres_um, layout.halves_um, strict=True)]  # fmt: skip
        for x_um, half in dict.fromkeys(kinds):
            chosen = np.array([kind == (x_um, half) for kind in kinds])
            light = self._lone(sample, ground, grid, x_um, half)
            total += maps.laid(light, grid, layout.centres_um[chosen], layout.power[chosen])
        return total, self._body(sample, self._there, 0.0)

    def _body(self, sample: Sample, there: There, x_um: float) -> Body:
        films = tuple(sorted(name for name in there if name in FILMS))
        key = (sample.dbr_pairs, sample.thickness_um, bool(there), films, x_um)
        if key not in self._bodies:
            self._bodies[key] = body_of(self._surroundings, sample, there, x_um)
        return self._bodies[key]

    def _lone(self, sample: Sample, ground: Ground, grid: maps.Grid, x_um: float, half: float) -> Real:
        """Smooth map (plane, y, x) of one chip's first light.

        Where it lacks the symmetries of the square, or is born another way, it is the symmetric light of the plain
        chip and the difference that the hidden thing makes, so that noise goes with the difference.
        """
        key = (grid, sample.distance_um, sample.dbr_pairs, sample.thickness_um, x_um, half)
        if key in self._kept:
            return self._kept[key]
        body, above = self._body(sample, self._there, x_um), lone(ground._replace(turn_cos=1.0, turn_sin=0.0), half)
        plain = self._body(sample, {}, 0.0)
        lopsided = self._there.keys() & LOPSIDED_CHIPS
        if not lopsided and body.sphere == plain.sphere:
            found = maps.symmetric(self._traced_alone(body, above, grid))
        else:
            flat = lone(ground_of(self._surroundings, sample, layout_of(sample, {}), {}), half)
            flat = flat._replace(distance=above.distance)
            base = self._traced_alone(plain, flat, grid)
            alike = plain._replace(sphere=body.sphere)
            other = base if alike.sphere == plain.sphere else self._traced_alone(alike, flat, grid)
            change = self._traced_alone(body, above, grid) - other
            if not lopsided:
                change = maps.symmetric(change)
            elif lopsided <= LEFT_AND_RIGHT:
                change = maps.mirrored(change)
            found = maps.symmetric(base) + change
        found = maps.smooth_about_chip(found, grid)
        if ground.turn_sin != 0.0:
            found = maps.turned(found, grid, float(np.arctan2(ground.turn_sin, ground.turn_cos)))
        self._kept[key] = found
        return found

    def _traced_alone(self, body: Body, ground: Ground, grid: maps.Grid) -> Real:
        tally = np.zeros((self._planes, grid.size, grid.size))
        steps, shift = maps.recurrence(tracing.POINTS, (self._seed, CHIP))
        count = self._histories
        tracing.lone_chip(
            ground, body, self._slant, np.uint64(self._seed * 8 + CHIP), 0, count, steps, shift, grid.step_um, tally,
            tracing.scratch(),
        )  # fmt: skip
        return tally / count

    def _change_of_first(
        self, sample: Sample, layout: Layout, ground: Ground, body: Body, grid: maps.Grid
    ) -> Real | float:
        """What the module makes of its chips' first light, smooth."""
        even = not self._there.keys() & UNEVEN_GROUND
        if sample.chips == 1 and even:
            return 0.0
        count = max(1, self._histories // FEWER)
        steps, shift = maps.recurrence(tracing.POINTS, (self._seed, FIRST))

        def traced(layout: Layout, ground: Ground, body: Body, even: bool) -> Real:
            tally = np.zeros((self._planes, grid.size, grid.size))
            tracing.module_change(
                ground, lone(ground, float(layout.halves_um[0])), body, even, layout.power, self._slant,
                np.uint64(self._seed * 8 + FIRST), 0, count, steps, shift, grid.step_um, tally, tracing.scratch(),
            )  # fmt: skip
            return tally / count

        found = traced(layout, ground, body, even)
        if self._symmetric(sample):
            return maps.smooth(maps.symmetric(found), grid)
        if sample.rows == sample.columns:
            flat, plain = self._plain(sample, ground)
            base = traced(layout_of(sample, {}), flat, plain, True)
            found = maps.symmetric(base) + found - base
        return maps.smooth(found, grid)

    def _plain(self, sample: Sample, ground: Ground) -> tuple[Ground, Body]:
        """The sample with nothing hidden but its distance: its changes are symmetric, and share random numbers."""
        flat = ground_of(self._surroundings, sample, layout_of(sample, {}), {})
        return flat._replace(distance=ground.distance), self._body(sample, {}, 0.0)

    def _symmetric(self, sample: Sample) -> bool:
        """Whether the module has the symmetries of the square."""
        lopsided = LOPSIDED_CHIPS | LOPSIDED_GROUND | (OF_SEVERAL if sample.chips > 1 else set())
        return sample.rows == sample.columns and not self._there.keys() & lopsided

    def _kernel(self, ground: Ground, body: Body, grid: maps.Grid) -> Real:
        """The transform (plane, ky, kx) of what one bounce makes of light at a point, per flux that bounces.

        On a grid twice as wide: on that of the module light from one side comes round to the other (0.16 % of an
        image's mean, 1 % of its rim).
        """
        key = ("kernel", grid, ground.distance)
        if key not in self._kept:
            wide, count = grid.twice(), max(1, self._histories // FEWER)
            tally = np.zeros((self._planes, wide.size, wide.size))
            steps, shift = maps.recurrence(tracing.POINTS, (self._seed, KERNEL))
            tracing.bounce_kernel(
                bare(ground), body, self._slant, np.uint64(self._seed * 8 + KERNEL), 0, count, steps, shift,
                grid.step_um, tally, tracing.scratch(),
            )  # fmt: skip
            self._kept[key] = maps.transform_of_kernel(maps.symmetric(tally) / count, wide)
        return self._kept[key]

    def _with_bounces(self, sample: Sample, ground: Ground, body: Body, grid: maps.Grid, first: Real) -> Real:
        """All light (plane, y, x) from the first."""
        reflectance = self._surroundings.receiver_reflectance
        inside = grid.inside(sample.module_half_um)
        transform = self._kernel(ground, body, grid)
        change, total = np.zeros_like(first), first
        last = reflectance == 0.0
        for number in range(MOST_PASSES):
            close = SETTLED if last else SETTLING
            total = _settled(first + change, total[-1], close, reflectance, inside, transform)
            if last:
                break
            alone = sample.chips == 1 and not self._there.keys() & UNEVEN_GROUND
            count = self._histories // ((SINGLE if alone else FEWER) * (1 if number else 4))
            before, change = change, self._change_of_bounce(sample, ground, body, grid, total[-1] * inside, count)
            last = number > 0 and abs(change - before).sum() < CHANGE * abs(total).sum()
            last = last or number == MOST_PASSES - 2
        return total

    def _change_of_bounce(
        self, sample: Sample, ground: Ground, body: Body, grid: maps.Grid, light: Real, count: int
    ) -> Real:
        """What the module changes of one bounce of the light (y, x) that the receiver sends back."""
        source, count = np.maximum(light, 0.0), max(1, count)
        rows, columns = maps.cumulative(source)
        steps, shift = maps.recurrence(tracing.POINTS, (self._seed, BOUNCE))

        def traced(ground: Ground, body: Body, even: bool) -> Real:
            tally = np.zeros((self._planes, grid.size, grid.size))
            tracing.bounce_change(
                ground, bare(ground), body, even, self._slant, np.uint64(self._seed * 8 + BOUNCE), 0, count, steps,
                shift, grid.step_um, source, rows, columns, tally, tracing.scratch(),
            )  # fmt: skip
            return tally / count

        found = traced(ground, body, not self._there.keys() & UNEVEN_GROUND)
        if self._symmetric(sample):
            found = maps.symmetric(found)
        elif sample.rows == sample.columns:
            base = traced(*self._plain(sample, ground), True)
            found = maps.symmetric(base) + found - base
        flux = source.sum() * grid.step_um**2 * self._surroundings.receiver_reflectance
        return maps.smooth(found * flux, grid)


def _settled(first: Real, source: Real, close: float, reflectance: float, inside: Real, transform: Real) -> Real:
    """First light with all its bounces on an even substrate (plane, y, x); `source`: near what comes back of it."""
    if reflectance == 0.0:
        return first
    for _ in range(200):
        following = first[-1] + reflectance * maps.convolved(source * inside, transform[-1])
        moved = float(np.abs(following - source).max())
        source = following
        if moved < close * float(source.max()):
            break
    return first + reflectance * maps.convolved(source * inside, transform)
