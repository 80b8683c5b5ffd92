"""Direct light: stored exits of a chip, followed until they first reach the receiver, with frozen random numbers.

What the substrate and other chips do on the way is traced; what the receiver sends back by Lambert's law is not
(`closure` reckons it), nor where light comes out again that goes on inside the substrate. Reflections at the receiver
that are no Lambert scattering, a mirror's or a lobe's, are followed, and each of their arrivals counts. Everything is
arranged so that small changes of a scene make small changes of the map: the substrate's reflectance is a factor for
each bounce and not a lottery, and an arrival is shared among the four bins around it in proportion to its distance,
so that it moves from bin to bin without a jump.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Bsdf, GaussianLobe, Lambertian, Mirror, Mixture
from containers.ray_tracing.arrays import (
    ENDS,
    HALF_X,
    HALF_Y,
    ORIGIN_X,
    ORIGIN_Y,
    PERIODIC,
    RESPONSE,
    RESPONSE_AT,
    TILT_X,
    TILT_Y,
    WALLS,
    EmissionArrays,
    SceneArrays,
)
from containers.ray_tracing.exits import LANDING, Exits
from containers.ray_tracing.kernel import scratch
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.packing import scene_arrays
from containers.ray_tracing.tally import OPTICAL_EVENTS, Box, Tally, nowhere
from containers.ray_tracing.twin.direct_kernel import (
    IMAGES,
    INSIDE,
    SEEN_MORE,
    Arrivals,
    BirthArrays,
    WayArrays,
    land_direct,
    land_inside,
)
from containers.ray_tracing.twin.parallel import in_parallel
from containers.ray_tracing.twin.ways import Dark, Ways
from containers.scene import LEAST_INDEX, Array, Chip, Emission, Face, Receiver, Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]

UNKNOWN = Arrivals(np.zeros((0, 3)), np.zeros(0, np.int8))
"""Of exits that nobody has followed yet."""


@dataclass(frozen=True)
class Way:
    """A scene for direct light, and where its bins lie."""

    arrays: WayArrays
    bare: Scene | None
    """The same with chips that take all that meets them; none where the receiver sends on what arrives."""
    box: Box
    images: int
    """Of an exit, where chips shine unevenly: what the chip and its neighbours have of the square's symmetries."""

    @property
    def scene(self) -> SceneArrays:
        """The arrays of the scene."""
        return self.arrays.scene

    @cached_property
    def dark(self) -> Dark | None:
        """The arrays of `bare`."""
        return None if self.bare is None else Dark(scene_arrays(self.bare))

    def endless(self) -> Way:
        """The same chips in a cell that repeats, on a substrate that does not leak: what chips do is asked alone."""
        numbers, flags = self.scene.numbers.copy(), self.scene.flags.copy()
        numbers[[HALF_X, HALF_Y]], numbers[[ORIGIN_X, ORIGIN_Y, TILT_X, TILT_Y]] = np.inf, 0.0
        flags[[PERIODIC, WALLS]] = 1, 0
        scene = self.scene._replace(numbers=numbers, flags=flags)
        return replace(self, arrays=self.arrays._replace(scene=scene, leak_share=0.0), bare=None)


def without_loss(bsdf: Bsdf) -> tuple[Bsdf, float]:
    """A surface that scatters alike and absorbs nothing, and the reflectance that is missing.

    (bsdf, 1) for a surface whose reflectance may vary with angle.
    """
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


def dimmed(bsdf: Bsdf, by: float) -> Bsdf:
    """A surface that scatters alike and sends back so much of what it did; any whose reflectance is one number."""
    if isinstance(bsdf, Mixture):
        return replace(bsdf, parts=tuple(dimmed(part, by) for part in bsdf.parts))
    if isinstance(bsdf, Lambertian | GaussianLobe | Mirror):
        return replace(bsdf, reflectance=by * bsdf.reflectance)
    return bsdf


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
    # the chip's bottom stays as it is: what is lost there, or below a gap, decides how long a ray stays inside
    beneath = scene.chip.mirror or scene.substrate
    chip = replace(scene.chip, bottom="air_gap" if scene.chip.bottom == "air_gap" else "mirror", mirror=beneath)
    receiver = replace(scene.receiver, bsdf=Lambertian(0.0))
    black = replace(scene, chip=chip, substrate=white, receiver=receiver, leak_share=0.0, leak_um=0.0)
    arrays = scene_arrays(black)
    rest, bare = arrays, None
    if followed == Lambertian(0.0):
        bare = replace(black, chip=_taking_all(chip), emission=Emission(), receiver=Receiver(followed))
    else:
        rest = scene_arrays(replace(black, receiver=Receiver(followed)))
    square = not isinstance(scene.layout, Array) or scene.layout.rows == scene.layout.columns
    images = 1 if box.folded else len(IMAGES) if square else len(IMAGES) // 2
    return Way(WayArrays(arrays, rest, kept, scene.leak_share, box.numbers), bare, box, images)


def _taking_all(chip: Chip) -> Chip:
    """A chip of the same size that takes all that meets it."""
    index = np.full(chip.index.size, LEAST_INDEX)
    black = Lambertian(0.0)
    face = Face((black,) * index.size, (black,) * index.size)
    return Chip(chip.width_um, chip.thickness_um, index, face, face, "mirror", black)


def direct_light(
    way: Way,
    emission: EmissionArrays,
    exits: Exits,
    seed: int,
    *,
    blocks: int | None = None,
    groups: int | None = None,
    threads: int | None = None,
    known: Ways | None = None,
) -> Tally:
    """Where exits first reach the receiver, and where some go on inside the substrate; bins (group, layer, y, x).

    Parameters
    ----------
    way : `open_way` of the scene whose chips the exits are of; what lies beside a box that is no cell is dropped.
    emission : which chips shine. blocks : how many blocks of the exits, all by default.
    seed : of what happens on the way. groups : so many at the end, a divisor of the exits' own; all by default.
    known : ways of exits that are remembered; they only save time.

    Notes
    -----
    A bin holds the light around its centre, with weights that fall linearly to 0 one bin's width away. Layers are
    `ARRIVES`, where it matters `SEEN_MORE`, and of a substrate that leaks all three of `direct_kernel`.
    """
    own, blocks = exits.ends.shape[0], blocks or exits.ledger.shape[1]
    groups = groups or own
    box, tables = way.box, way.scene.surfaces.tables
    response = tables[way.scene.flags[RESPONSE_AT] :][: way.scene.flags[RESPONSE]]
    layers = INSIDE + 1 if way.arrays.leak_share else SEEN_MORE + 1 if np.any(response != 1.0) else 1
    bins = np.zeros((groups, layers, box.rows, box.columns))

    sets, births = _sets_of(exits)
    per_um = 0.0 if exits.births is None else 1.0 / exits.births.width_um
    key = np.uint64(seed ^ LANDING)
    arrivals = [[UNKNOWN] * own for _ in sets]
    if known is not None and way.dark is not None:
        how = {"blocks": blocks, "groups": own, "seed": seed, "threads": threads}
        arrivals = [known.of(way.dark, emission, one, **how) for one in sets]

    def land(together: int) -> None:
        work, lost = scratch(), nowhere()
        for one, counts, its in zip(sets, births, arrivals, strict=True):
            for group in range(together * own // groups, (together + 1) * own // groups):
                mine = slice(one.ends[group, 0], one.ends[group, blocks])
                weights = np.zeros(0, np.float32) if one.weights is None else one.weights[mine]
                born, into = BirthArrays(counts, per_um, way.images), bins[together]
                land_direct(
                    way.arrays, emission, key, group, own, one.numbers(group, range(blocks)), one.rays[mine], weights,
                    one.notes[mine], born, its[group], lost, work, into,
                )  # fmt: skip
                if way.arrays.leak_share:
                    land_inside(way.arrays, emission, one.rays[mine], weights, one.notes[mine], born, work, into)

    in_parallel(land, range(groups), threads)
    ledger = exits.ledger[:, :blocks].sum(axis=1).reshape(groups, -1, len(ENDS)).sum(axis=1)
    nothing = np.zeros((groups, len(OPTICAL_EVENTS))), np.zeros((groups, 2, 0, 0))
    return Tally(box, bins, ledger, *nothing, histories=BLOCK * blocks * own // groups)


def _sets_of(exits: Exits) -> tuple[tuple[Exits, ...], list[Real]]:
    """The sets of exits, and what each counts for (y, x) by birthplace: of an even chip's light the first tells all,
    of what unevenness adds each its share."""
    births = exits.births
    if births is None:
        return (exits,), [np.zeros((0, 0))]
    sets = (exits, *births.others)
    added: Real = (births.weights - 1.0) / len(sets)
    return sets, [1.0 + added, *(added for _ in births.others)]
