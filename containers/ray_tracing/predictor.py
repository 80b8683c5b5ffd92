"""From a request for predictions to its answer: scenes of the shots, the anchor, images, Jacobian. No clock, no bus.

An answer is a function of its request alone, an image one of its shot and anchor alone. Walks inside chips are those
of the content-addressed `ExitSource`: of the anchor's chip, whose exits are reweighted for a wanted chip near it, or
of the wanted chip itself, whose exits are reweighted for the chips that a column moves it to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from containers.acting import Effects
from containers.effect import Real
from containers.ray_tracing.build import cell_of, scene_of
from containers.ray_tracing.camera import ambient, seen_px
from containers.ray_tracing.exit_source import BATCH, ExitSource
from containers.ray_tracing.exits import Exits, scene_key
from containers.ray_tracing.field import ModuleField
from containers.ray_tracing.field_source import HELD_BYTES, FieldSource
from containers.ray_tracing.kept import Kept
from containers.ray_tracing.light import unweighed
from containers.ray_tracing.monte_carlo import BLOCK, blocks_of
from containers.ray_tracing.outcome import Arrays, Document
from containers.ray_tracing.several_tops import scenes_of, with_tops
from containers.ray_tracing.simulation import layout_of, refuse_other_film, solver_of
from containers.ray_tracing.tally import GROUPS
from containers.ray_tracing.twin.columns import CAMERA_COLUMNS, COLUMNS, CameraColumn, Column
from containers.ray_tracing.twin.module import Lights, open_array
from containers.ray_tracing.twin.noise import MOST_FUNCTIONS
from containers.ray_tracing.twin.prediction import (
    Anchor,
    Shot,
    jacobian,
    named,
    refuse_several_sizes,
    stencil_of,
    twin_views,
)
from containers.ray_tracing.twin.supply import Supply
from containers.scene import Array, Cell, Scene
from containers.thin_film.table import FilmTable
from luxloop.camera import Camera
from luxloop.computation import Progress
from luxloop.effect import did_you_mean, refuse_twice
from luxloop.errors import InputError
from luxloop.process import usable_cores
from luxloop.ray import AnchorRequest, Film, Module, PredictionRequest, RayRequest, ShotRequest
from luxloop.words import sha256_of

MOST_VALUES = 1 << 25
"""Of an answer: the pixels of all shots, once for images, twin's images, each column, and each function of noise."""
MOST_CHIPS = 2_500
"""Of a module: its image takes 2.4 s (5 x 5: 20 ms), and within an image nobody listens for a cancel."""
FEWER, ENOUGH, OTHER_RUN = 8, 4_000_000, 0x2545F4914F
"""Of differences about an anchor: times fewer histories, but no fewer than these; what turns its seed."""
SHADOW_RAYS = 4096
SLOPE_STEP = 1e-4
"""Of the full scale: by which a signal is moved to find the slope of a sensor's effects."""
UNEVEN_HISTORIES, UNEVEN_ABOUT = 1 << 19, 1 << 21
"""Whose exits tell what unevenness adds; at an anchor. To a single chip's image a dark corner of 0.2 added 3 times
the variance of a run of a million histories with 131,072 of them, and 0.5 % rms with 524,288."""
RUN_STEPS = 20
"""What a run of Monte Carlo counts for in the progress; an image of the twin counts 1."""


class Means(Protocol):
    """What a request names and does not bring."""

    def film(self, film: Film) -> FilmTable:
        """The table of that hash."""

    def effects(self, module: Module) -> Effects:
        """The effects of a module and its camera, ready to act."""


class Predictor:
    """What predicts images for a worker; `source` has the stored chip exits, `fields` those by Monte Carlo."""

    def __init__(self, source: ExitSource, threads: int | None = None, fields: FieldSource | None = None) -> None:
        self._source, self._threads = source, threads or usable_cores()
        self._anchors = Kept[Anchor](HELD_BYTES, lambda one: one.nbytes)
        self._fields = fields or FieldSource()  # one run serves any camera
        self._lights = Lights()  # of the twin's chips: what only cameras or places change has them again

    def answer(self, request: PredictionRequest, means: Means, progress: Progress) -> tuple[Document, Arrays]:
        """The result document of a request and its arrays.

        Parameters
        ----------
        means : brings the film and the effects that a shot names.

        Raises
        ------
        InputError : shots that cannot be built or that the twin does not know, images of several sizes, pixels beyond
            the receiver, an unknown column or one that a shot lacks, an answer of more than `MOST_VALUES`.
        Stopped : cancelled; looked for before each image, and within walks and runs of Monte Carlo.

        Notes
        -----
        All in irradiance, 1/mm^2 per flux of a chip, before a camera's gain: `images_per_mm2` (shot, row, column);
        `jacobian_per_mm2` (column, shot, row, pixel column) in the order of `columns`, by each shot's own parameter,
        of its scene or of its camera, in the unit that its name ends with; with an anchor, where that is wanted,
        `noise_per_mm2` (function, shot, row, column): the covariance of two pixels is the sum over functions of their
        products, and `twin_per_mm2` (shot, row, column), the twin alone, whose noise has nothing in common with
        that, unless the anchor has the stored exits; where sensors bend signals `by_gain_per_mm2` and `by_offset`
        (shot, row, column), by which the twin's signal grows with the gain and with the offset; about a run
        `by_camera_per_mm2` (camera column, shot, row, pixel column), in their order in `columns`: how the images
        change with the camera, with the run's noise, where the jacobian has how the twin's do. Images are float64,
        for differences are taken of them; the others are float32, which rounds 6e-8 of a value: the least noisy
        column of a scene has 1e-4, the noise knows itself to some percent.
        """
        columns, cameras = _columns(request)
        _refuse_too_much(request)
        shots = _shots(request.shots, "shots", means, 1 if request.anchor is None else GROUPS)
        _refuse_beyond_twin(request, shots)
        steps = _Steps(progress, len(shots) + sum(len(stencil_of(c, shot)) for c in columns for shot in shots))
        job = _Job(request, steps, self._source, self._threads)
        supply = job.supply(self._lights)
        if request.anchor is None:
            images, of_camera = twin_views(shots, supply, cameras, report=steps.image, **job.options)
            arrays: Arrays = {"images_per_mm2": images}
        else:
            anchor = self._anchor(_run_of(request.anchor, request.noise), job, supply, means)
            shots = anchor.near(shots)
            found = anchor.predict(shots, supply, cameras, report=steps.image)
            arrays = {"images_per_mm2": found.images_per_mm2}
            if request.noise:
                arrays["noise_per_mm2"] = found.noise_per_mm2.astype(np.float32)
            arrays["twin_per_mm2"] = found.twin_per_mm2.astype(np.float32)
            of_camera = found.of_camera_per_mm2
            of_cameras = [column.name for column in cameras]
            if of_cameras and request.anchor.histories:
                order = [of_cameras.index(name) for name in request.columns if name in of_cameras]
                arrays["by_camera_per_mm2"] = found.images_by_camera_per_mm2.astype(np.float32)[order]
        if request.columns:
            of_scene = jacobian(shots, columns, supply, report=steps.image, **job.options)
            names = [*(column.name for column in columns), *(column.name for column in cameras)]
            order = [names.index(name) for name in request.columns]
            arrays["jacobian_per_mm2"] = np.concatenate([of_scene, of_camera]).astype(np.float32)[order]
        _bend(arrays, shots)
        return _document(request), arrays

    def _anchor(self, asked: AnchorRequest, job: _Job, supply: Supply, means: Means) -> Anchor:
        """The anchor of a request: one of those kept, or made anew; without a run there is nothing to keep."""
        wanted = job.request.shots
        at = asked.shots or wanted
        if len(at) != len(wanted) or _size(at[0]) != _size(wanted[0]):
            given, allowed = (f"{len(some)} shots of {_size(some[0])} pixels" for some in (at, wanted))
            raise InputError("anchor.shots", given, allowed, "one for each of the wanted ones, in the same order")
        decisive = job.request.model_dump(mode="json", include={"exit_histories", "exit_seed", "noise"})
        of_wanted = [] if asked.shots else [shot.model_dump(mode="json") for shot in wanted]
        key = sha256_of([asked.model_dump(mode="json"), decisive, *of_wanted])

        def make() -> Anchor:
            shots = _shots(at, "anchor.shots" if asked.shots else "shots", means, GROUPS)
            return job.anchor(asked, at, shots, supply, self._fields)

        return self._anchors.of(key, float(asked.histories), make) if asked.histories else make()


class _Steps:
    """How far a request is, in images of the twin; reports of several threads may overtake each other."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self.total, self.done = progress, total, 0

    def image(self) -> None:
        """One more is begun."""
        self.say("images")
        self.done += 1

    def run(self, share: float) -> None:
        """So much of a run of Monte Carlo is done."""
        self.say("Monte Carlo", share * RUN_STEPS)

    def say(self, note: str, beyond: float = 0.0) -> None:
        """Tell the progress."""
        self._progress.report((self.done + beyond) / self.total, note)


@dataclass(frozen=True)
class _Job:
    """A request under way."""

    request: PredictionRequest
    steps: _Steps
    source: ExitSource
    threads: int

    @property
    def options(self) -> dict[str, int]:
        """Of the twin's images."""
        blocks = blocks_of(self.request.exit_histories) // BLOCK
        return {"blocks": blocks, "shadow_rays": SHADOW_RAYS, "threads": self.threads}

    def supply(self, lights: Lights, uneven: int = UNEVEN_HISTORIES, *, apart: bool = False) -> Supply:
        """Exits of chips with notes, as many blocks as are used or more; for unevenness so many histories in sets.

        `apart` : none of them are those of a supply that is not apart.
        """
        used = self.options["blocks"]
        blocks = -(-used // BATCH) * BATCH  # whole batches are not copied
        sets = -(-uneven // (GROUPS * used * BLOCK))
        numbers = range(sets, 2 * sets) if apart else range(sets)
        first, *others = (partial(self._exits, blocks, number * blocks) for number in numbers)
        return Supply(first, lights, others)

    def _exits(self, blocks: int, first_block: int, scene: Scene) -> Exits:
        return self.source.exits(
            scene,
            int(self.request.exit_seed),
            blocks,
            first_block=first_block,
            notes=True,
            report=lambda _: self.steps.say("chip exits"),
        )

    def anchor(
        self,
        asked: AnchorRequest,
        at: Sequence[ShotRequest],
        shots: Sequence[Shot],
        supply: Supply,
        known: FieldSource,
    ) -> Anchor:
        """An anchor at these shots; what several cameras see is run once, what is `known` is not run again."""
        if not asked.histories:
            return Anchor(shots, None, supply, report=self.steps.image, **self.options)
        even = [shot.evenly_lit() for shot in shots]
        run = asked.model_dump(mode="json", exclude={"shots"}) | {"exit_seed": self.request.exit_seed}
        seeds = [_seed_of(asked, wanted) for wanted in at]
        keys = [sha256_of([run, seed, *_keys(shot)]) for seed, shot in zip(seeds, even, strict=True)]
        surely = not self.request.noise
        uneven = any(one is not shot for one, shot in zip(even, shots, strict=True))
        images = 4 if uneven else 1 + self.request.noise  # of each shot
        to_run = {key for key in keys if key not in known}
        self.steps.total += RUN_STEPS * len(to_run) + images * len(shots)
        fields: dict[str, ModuleField] = {}  # all of them are needed at once, however few are kept
        known_first = sorted(zip(keys, at, even, strict=True), key=lambda one: one[0] in to_run)
        for key, wanted, shot in known_first:  # what is made may push out what is known
            with named(shot.name):
                run_it, lasting = partial(self._field, asked, wanted, shot.traced), not asked.stored_exits
                fields[key] = fields.get(key) or known.of(key, asked.histories, run_it, lasting=lasting)
        more = self.supply(supply.lights, UNEVEN_ABOUT, apart=surely)
        of_shots = [fields[key] for key in keys]
        return Anchor(shots, of_shots, supply, more, surely, report=self.steps.image, **self.options)

    def _field(self, asked: AnchorRequest, wanted: ShotRequest, scene: Scene) -> ModuleField:
        """A module's field by Monte Carlo."""
        run = RayRequest(
            **{name: getattr(wanted, name) for name in Module.model_fields},
            histories=asked.histories,
            seed=_seed_of(asked, wanted),
            stored_exits=asked.stored_exits,
            exit_seed=self.request.exit_seed,
        )
        solver = solver_of(run, scene, self.source, self.threads)
        tally = solver.run_to(blocks_of(asked.histories), self.steps.run)
        self.steps.done += RUN_STEPS
        return unweighed(tally, scene)


def _seed_of(asked: AnchorRequest, wanted: ShotRequest) -> str:
    """The seed of a module's run: another for each design, so that no two modules of an anchor share their noise.

    Nor, without stored exits, does any share histories with the exits that the twin lands. In another environment a
    module keeps its seed. One that is set apart shares none with a module of the same numbers.
    """
    module = wanted.model_dump(mode="json", include={"design", "array"} | ({"apart"} if wanted.apart else set()))
    return str(int(sha256_of({"seed": asked.seed, "module": module})[:15], 16) % 10**18)


def _keys(shot: Shot) -> list[str]:
    """Of all that decides a module's field: not of the camera, nor of effects in it."""
    return [scene_key(one) for one in scenes_of(shot.traced)]


def _refuse_beyond_twin(request: PredictionRequest, shots: Sequence[Shot]) -> None:
    """InputError where the twin alone is asked for what it cannot represent."""
    names = {name for shot in shots for name in shot.effects.beyond_twin}
    if names and request.anchor is None:
        mend = f"the twin cannot represent {', '.join(sorted(names))}"
        raise InputError("anchor", None, "an anchor with histories, so that Monte Carlo does", mend)


def _bend(arrays: Arrays, shots: Sequence[Shot]) -> None:
    """Let the sensors' effects act: images as if the light had been other, the rest by the slope there.

    An effect s acts on the signal y = g E + o + a of all light; returned is E' with g E' + o + a = s(y), so that who
    multiplies by the gain, adds the offset and the ambient plane a, and lets the sensor's own steps follow, has the
    image. Its derivatives are then others, by the gain s' E, by the offset s'.
    """
    for number, shot in enumerate(shots):
        if not shot.effects.bends_signals:
            continue
        image = arrays["images_per_mm2"][number]
        bent, slope = _bent(image, shot)
        if np.array_equal(bent, image):  # off: bit for bit as it was
            continue
        twin = arrays.get("twin_per_mm2", arrays["images_per_mm2"])
        by_gain = arrays.setdefault("by_gain_per_mm2", twin.astype(np.float32))
        its_own, its_slope = _bent(twin[number].astype(np.float64), shot)
        by_gain[number] = its_slope * twin[number]
        arrays.setdefault("by_offset", np.ones_like(by_gain))[number] = its_slope
        twin[number] = its_own
        arrays["images_per_mm2"][number] = bent
        for name in ("noise_per_mm2", "jacobian_per_mm2", "by_camera_per_mm2"):
            if name in arrays:
                arrays[name][:, number] *= slope.astype(arrays[name].dtype)


def _bent(image_per_mm2: Real, shot: Shot) -> tuple[Real, Real]:
    """An image as the sensor's effects leave it, bit for bit the same where they are off; their slope."""
    gain, offset, step = shot.camera.gain_dn, shot.camera.offset_dn, SLOPE_STEP * shot.camera.full_scale_dn
    plane = ambient(shot.camera)
    signal = gain * image_per_mm2 + offset + plane
    low, at, high = (shot.effects.signal(signal + by, shot.camera) for by in (-step, 0.0, step))
    bent = image_per_mm2 if np.array_equal(at, signal) else (at - plane - offset) / gain
    return bent, (high - low) / (2.0 * step)


def _size(shot: ShotRequest) -> str:
    return f"{shot.camera.rows} x {shot.camera.columns}"


def _run_of(anchor: AnchorRequest, noise: bool) -> AnchorRequest:
    """The anchor whose run is taken: without its noise one at the same place by another run, which has nothing in
    common with its own."""
    if noise or not anchor.histories:
        return anchor
    if anchor.stored_exits:
        mend = "the other run would land the same exits: full histories, or noise = true"
        raise InputError("anchor.stored_exits", True, "false where noise = false", mend)
    histories = min(anchor.histories, max(anchor.histories // FEWER, ENOUGH))
    return anchor.model_copy(update={"seed": str(int(anchor.seed) ^ OTHER_RUN), "histories": histories})


def _columns(request: PredictionRequest) -> tuple[list[Column], list[CameraColumn]]:
    """The columns of a request: of scenes, of the camera. InputError for one that is not known, or wanted twice."""
    refuse_twice("columns", request.columns)
    known = [*COLUMNS, *CAMERA_COLUMNS]
    for number, name in enumerate(request.columns):
        if name not in known:
            raise InputError(f"columns.{number}", name, ", ".join(known), did_you_mean(name, known))
    wanted = set(request.columns)
    return [c for c in COLUMNS.values() if c.name in wanted], [c for c in CAMERA_COLUMNS.values() if c.name in wanted]


def _refuse_too_much(request: PredictionRequest) -> None:
    """InputError where the answer would be too large; before anything is built."""
    pixels = sum(shot.camera.rows * shot.camera.columns for shot in request.shots)
    anchored = 1 + MOST_FUNCTIONS + sum(name in CAMERA_COLUMNS for name in request.columns)
    times = 1 + len(request.columns) + (anchored if request.anchor is not None else 0)
    if pixels * times > MOST_VALUES:
        mend = "fewer pixels or columns at once: ask in parts"
        raise InputError("shots", f"{pixels} pixels x {times} images of each", f"a product up to {MOST_VALUES}", mend)


def _refuse_wide_view(camera: Camera, groups: int) -> None:
    """InputError where an image, with what its blurs see beyond it, is too large to be held for each group."""
    seen = seen_px(camera)
    if seen * groups > MOST_VALUES:
        value = f"{camera.pixel_um:g}: {seen} pixels are seen by blurs"
        mend = "pixel_um is in um on the receiver; else fewer pixels, or less blur"
        raise InputError("pixel_um", value, f"{MOST_VALUES // groups} pixels of {groups} groups", mend)


def _shots(wanted: Sequence[ShotRequest], where: str, means: Means, groups: int) -> list[Shot]:
    """The shots of a request, their chips built once where they are alike. InputErrors name the shot."""
    built: dict[str, Scene] = {}
    shots = []
    for number, shot in enumerate(wanted):
        name = f"{where}.{number}"
        with named(name):
            effects = means.effects(shot)
            camera = effects.camera(shot.camera)
            with named("camera"):
                _refuse_wide_view(camera, groups)
            film = None if shot.film is None else means.film(shot.film)
            refuse_other_film(shot, film, effects)
            key = sha256_of(shot.model_dump(mode="json", include={"environment", "design", "film"}))
            if key not in built:
                built[key] = scene_of(shot.environment, shot.design, film, cell_of(shot.environment, shot.design))
            bare = replace(built[key], layout=_open(shot))
            bare = with_tops(bare, shot.environment, film, effects)
            scene, whole = effects.for_twin.scene(bare), effects.scene(bare)
            open_array(scene)
        shots.append(Shot(scene, camera, name, effects=effects, whole=whole if effects.beyond_twin else None))
    refuse_several_sizes(shots)
    return shots


def _open(shot: ShotRequest) -> Cell | Array:
    """The finite module of a shot; the twin knows only open edges."""
    if shot.array is None:
        mend = "a single chip has rows = columns = 1; images of endless chips come of a simulation"
        raise InputError("array", None, "rows and columns of a finite module", mend)
    if shot.array.rows * shot.array.columns > MOST_CHIPS:
        chips = f"{shot.array.rows} x {shot.array.columns} chips"
        raise InputError("array", chips, f"up to {MOST_CHIPS} chips", "predict a part of the module")
    if shot.array.wall_reflectance is not None:
        mend = "images of walled modules come of a simulation by Monte Carlo"
        raise InputError("array.wall_reflectance", shot.array.wall_reflectance, "none: an open edge", mend)
    return layout_of(shot)


def _document(request: PredictionRequest) -> Document:
    """What was computed, of the run that was taken, with counts as they were rounded up to whole blocks."""
    anchor = None if request.anchor is None else _run_of(request.anchor, request.noise)
    of_anchor = (
        {}
        if anchor is None
        else {
            "groups": GROUPS,
            "histories": GROUPS * blocks_of(anchor.histories) if anchor.histories else 0,
            "seed": anchor.seed,
            "stored_exits": anchor.stored_exits,
        }
    )
    return {
        "task": request.task,
        "columns": list(request.columns),
        "exit_histories": GROUPS * blocks_of(request.exit_histories),
        "exit_seed": request.exit_seed,
        "unit": "1/mm2 per flux of a chip",
        **of_anchor,
    }
