"""Images as requests to the ray-tracing worker, and its answers as images again.

Views of one size are one request, so that six images cost one round trip. Derivatives are further requests, under
way at once: parameters by which the worker differentiates are its columns, others are moved models, shot by shot.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from luxloop.camera import Camera
from luxloop.errors import InputError
from luxloop.ray import AnchorRequest, ChipArray, PredictionRequest, RayRequest, ShotRequest
from validation.prediction.differences import SHARE, moved_models
from validation.prediction.words import POSE_COLUMNS, Anchored, Pose, Predicted, Real, Traced, View, run_of
from validation.sample_values import members, of_sample

if TYPE_CHECKING:
    from luxloop.client import Answer
    from luxloop.model import Model
    from luxloop.ray import Film
    from validation.dataset.manifest import Sample

FilmOf = Callable[["Model", float], "Film | None"]
Ask = Callable[[Sequence[PredictionRequest]], "list[Answer]"]

PER_CM = 1e-4
"""In 1/um."""
COLUMNS: dict[str, tuple[str, float]] = {
    "environment.substrate.reflectance": ("substrate_reflectance", 1.0),
    "environment.substrate.sigma_deg": ("substrate_sigma_rad", math.pi / 180.0),
    "environment.receiver.reflectance": ("receiver_reflectance", 1.0),
    "environment.chip_absorption_per_cm": ("absorption_per_um", PER_CM),
}
"""The worker's column for a path, and that column's unit in the path's own."""
ABSORBER = "chip_absorption"
ABSORPTION = f"effects.{ABSORBER}.absorption_per_cm"
ABSORBING = {
    "even": "absorption_per_um",
    "rising": "absorption_to_top_per_um",
    "falling": "absorption_to_bottom_per_um",
}
"""The column of the effect that adds to the environment's absorption, by its profile: a difference of walks of its
own knew 200 /cm to 52 where the column does to 6."""
MOST_SHOTS, MOST_VALUES = 64, 1 << 24
"""Of one request, and of its answer: half of what the worker allows."""
ANCHOR_FUNCTIONS = 200
JACOBIAN_EXITS, FINE_EXITS = 65_536, 262_144
"""Whose exits columns are taken with, on the way to an anchor and about it: there a fit rests on them, and with fewer
their own noise adds to its errors (decision 27)."""
COLUMN_EXITS = 524_288
"""Whose exits the columns of effects are taken with: what a fit's own parameters leave of them is small, and of a
quarter of these it was noise that two walks disagreed about (decision 70)."""
DIFFERENCE_HISTORIES = 1_000_000
"""Of Monte Carlo, where the twin cannot represent an effect that is moved."""
DIFFERENCE_SHARE = 0.1
"""Of its range, that it is then moved: shorter steps leave the noise of Monte Carlo and little else, longer ones bend
(walls of 0.5 by 5 % at 0.25)."""
CHANCE_SHARE = 0.25
"""Of its range, that an effect is moved which sends a share of the light another way: as far as there is room for."""
DIFFERENCE = 77
"""What a seed is drawn for, so that no other run shares its random numbers."""
DIFFERENCE_EXITS = 262_144
"""Of moved models, some of which have a walk of their own, and more noise."""


class _Move(NamedTuple):
    """A view of a moved model, and its weight in the derivative by a path."""

    path: str
    weight: float
    model: Model
    about: Model
    """From which it was moved: its chips' exits stand for those of the moved one where they can."""
    traced: bool
    """By Monte Carlo, for the twin cannot represent what is moved."""
    view: int


@dataclass(frozen=True)
class Wanted:
    """What is to be predicted of views at a model."""

    model: Model
    paths: tuple[str, ...]
    anchor: Anchored | None
    film_of: FilmOf
    beyond_twin: frozenset[str] = frozenset()
    """Names of effects that the twin cannot represent."""
    on_all_light: frozenset[str] = frozenset()
    """Names of effects that act on what an anchor has over the twin as on the twin's light."""
    by_chance: frozenset[str] = frozenset()
    """Names of effects that send a share of the light, drawn by chance, another way."""
    noise: bool = True
    """Of the anchor's Monte Carlo, with the images; else these are by another run, and good for differences alone."""

    @property
    def exit_seed(self) -> str:
        """Of the walks inside chips."""
        return str(1 if self.anchor is None else self.anchor.exit_seed)

    @property
    def column_exits(self) -> int:
        """Histories whose exits columns are taken with."""
        at = self.anchor
        return FINE_EXITS if at is not None and (at.histories or at.exit_seed != 1) else JACOBIAN_EXITS

    @property
    def poses(self) -> tuple[str, ...]:
        """Those of a pose, by which an image's own map is differentiated."""
        return tuple(path for path in self.paths if path in POSE_COLUMNS)

    @property
    def columns(self) -> dict[str, tuple[str, float]]:
        """Others by which the worker differentiates: its column, and the column's unit in the path's own."""
        known = dict(COLUMNS)
        for one in self.model.effects:
            elsewhere = any("profile" in own.get(ABSORBER, {}) for own in self.model.samples.values())
            if one.name == ABSORBER and one.parameters.get("profile") in ABSORBING and not elsewhere:
                known[ABSORPTION] = ABSORBING[str(one.parameters["profile"])], PER_CM
        return {path: known[path] for path in self.paths if path in known}

    @property
    def of_all_light(self) -> tuple[str, ...]:
        """By differences of models that are moved about the anchor: of effects on all light."""
        if self.anchor is None or not self.anchor.histories:
            return ()
        own = [path for path in self.paths if path not in self.columns]
        return tuple(path for path in own if self.effect_of(path) in self.on_all_light)

    def effect_of(self, path: str) -> str:
        """The effect whose number is at a path, of one sample or of all; "": no effect's."""
        own = members(self.model).get(path)
        return own[0].effect if own else path.split(".")[1] if path.startswith("effects.") else ""

    def seen_by(self, path: str, views: Sequence[View]) -> list[int]:
        """Numbers of the views that a path's number moves: all, or those of the one sample whose it is."""
        own = members(self.model).get(path)
        return [number for number, view in enumerate(views) if own is None or view.sample.id == own[0].sample]

    @property
    def differences(self) -> tuple[str, ...]:
        """All others: by differences of moved models, as the twin has them."""
        known = {*self.columns, *POSE_COLUMNS, *self.of_all_light}
        return tuple(path for path in self.paths if path not in known)


def predict(wanted: Wanted, views: Sequence[View], ask: Ask) -> list[Predicted]:
    """The images of views, in their order."""
    at, times = wanted.anchor, 1 + len(wanted.paths) + len(wanted.poses)
    if at is not None and at.poses and len(at.poses) != len(views):
        raise InputError("anchor.poses", len(at.poses), f"{len(views)}, one for each view, or none")
    groups = list(_groups(views, times + ANCHOR_FUNCTIONS * (at is not None), at))
    moves = list(_moves(wanted, views))
    further = [group for some in _by_path(moves) for group in _groups_of(some, moves, views)]
    requests = [_image_request(wanted, views, group) for group in groups]
    requests += [_column_request(wanted, views, group) for group in groups if wanted.columns]
    requests += [_difference_request(wanted, views, [moves[n] for n in some]) for some in further]
    of_all_light = [(path, *moved) for path in wanted.of_all_light for moved in moved_models(wanted.model, path)]
    requests += [_moved_request(wanted, views, model, group) for *_, model in of_all_light for group in groups]
    answers = iter(ask(requests))
    found: dict[int, Predicted] = {}
    for group in groups:
        found |= dict(zip(group, _images(wanted, next(answers)), strict=True))
    for group in groups if wanted.columns else ():
        for number, columns in zip(group, _columns(wanted.columns, next(answers)), strict=True):
            found[number].jacobian_per_mm2.update(columns)
    for some in further:
        for n, image in zip(some, next(answers).arrays["images_per_mm2"], strict=True):
            columns = found[moves[n].view].jacobian_per_mm2
            columns[moves[n].path] = columns.get(moves[n].path, 0.0) + moves[n].weight * _real(image)
    for one in found.values():
        still = {path: np.zeros_like(one.irradiance_per_mm2) for path in wanted.differences}
        one.jacobian_per_mm2.update(still | one.jacobian_per_mm2)
    for path, weight, _ in of_all_light:
        for group in groups:
            for n, image in zip(group, next(answers).arrays["images_per_mm2"], strict=True):
                columns = found[n].jacobian_per_mm2
                columns[path] = columns.get(path, 0.0) + weight * _real(image)
    found = {number: replace(one, of_all_light=frozenset(wanted.of_all_light)) for number, one in found.items()}
    at_model = wanted.model if wanted.anchor is None else wanted.anchor.model  # whose histories the noise is of
    runs = [run_of(view.sample, at_model) for view in views]
    for run in set(runs):
        parts = [[n for n in group if runs[n] == run] for group in groups]
        found |= _told_apart(found, [part for part in parts if part])
    return [found[number] for number in range(len(views))]


def several(
    wanted: Sequence[tuple[Model, View]], lender: Model, film_of: FilmOf, ask: Ask, exit_seed: int = 1
) -> list[Real]:
    """The twin's images of views in models, with the exits of a lender's chips where these can stand for theirs."""
    groups = list(_groups([view for _, view in wanted], 1 + ANCHOR_FUNCTIONS))
    requests = []
    for group in groups:
        shots = tuple(_shot(*wanted[number], film_of) for number in group)
        lent = tuple(_shot(lender, wanted[number][1], film_of) for number in group)
        anchor = AnchorRequest(shots=lent, histories=0)
        requests.append(
            PredictionRequest(shots=shots, anchor=anchor, exit_histories=COLUMN_EXITS, exit_seed=str(exit_seed))
        )
    found: dict[int, Real] = {}
    for group, answer in zip(groups, ask(requests), strict=True):
        found |= dict(zip(group, map(_real, answer.arrays["images_per_mm2"]), strict=True))
    return [found[number] for number in range(len(wanted))]


def simulation(model: Model, view: View, histories: int, seed: int, number: int, film_of: FilmOf) -> RayRequest:
    """The request for a view by Monte Carlo; a seed gives every number its own random numbers."""
    drawn = np.random.SeedSequence((seed, number)).generate_state(1, np.uint64)[0]
    return RayRequest(
        **module_of(model, view.sample, film_of),
        histories=histories,
        budget_s=86_400.0,
        seed=str(int(drawn) % 10**18),
        images=(camera_of(view, view.pose),),
    )


def simulated(answer: Answer, view: View) -> Traced:
    """The image of such an answer, its digital numbers over the gain: of 1 where the view has no sensor."""
    gain_dn, offset_dn = (1.0, 0.0) if view.sensor is None else (view.sensor.gain_dn, view.sensor.offset_dn)
    image, error = (_real(answer.arrays[name]) for name in ("image_0", "image_error_0"))
    return Traced((image - offset_dn) / gain_dn, {}, error_per_mm2=error / gain_dn)


def module_of(model: Model, sample: Sample, film_of: FilmOf) -> dict[str, Any]:
    """The finite module of a sample in a model, as requests have it."""
    model = of_sample(model, sample.id)
    chips = (
        {"rows": sample.rows, "columns": sample.columns} if sample.layout == "array" else {"rows": 1, "columns": 1}
    )
    return {
        "environment": model.environment,
        "design": sample.design,
        "film": film_of(model, sample.dbr_pairs),
        "effects": model.effects,
        "array": ChipArray(**chips, half_um=sample.half_um(model.environment.spacing_is)),
    }


def camera_of(view: View, pose: Pose) -> Camera:
    """The camera of a view."""
    of_sensor = {} if view.sensor is None else vars(view.sensor)
    return Camera(
        **of_sensor,
        rows=view.rows,
        columns=view.columns,
        pixel_um=view.pixel_um,
        centre_px=view.centre_px,
        shift_px=pose.shift_px,
        rotation_deg=pose.rotation_deg,
    )


def _shot(model: Model, view: View, film_of: FilmOf) -> ShotRequest:
    return ShotRequest(**module_of(model, view.sample, film_of), camera=camera_of(view, view.pose))


def _of_own_run(shot: ShotRequest, sample: Sample, model: Model) -> ShotRequest:
    """An anchor's shot, set apart as `run_of` tells runs apart: where the sample has values of its own."""
    return shot.model_copy(update={"apart": sample.id}) if sample.id in model.samples else shot


def _image_request(wanted: Wanted, views: Sequence[View], group: Sequence[int]) -> PredictionRequest:
    """Views of one size, anchored where that is wanted."""
    shots = tuple(_shot(wanted.model, views[number], wanted.film_of) for number in group)
    if wanted.anchor is None:
        return PredictionRequest(shots=shots, columns=wanted.poses)
    at = wanted.anchor
    poses = at.poses or [Pose()] * len(views)
    seen = [replace(views[number], pose=poses[number], sensor=None) for number in group]
    anchored = tuple(_of_own_run(_shot(at.model, view, wanted.film_of), view.sample, at.model) for view in seen)
    histories = at.histories_of(views[group[0]].sample.id)
    anchor = AnchorRequest(shots=anchored, histories=histories, seed=str(at.seed), stored_exits=at.stored_exits)
    exits = {} if wanted.noise else {"exit_histories": COLUMN_EXITS}
    seed, noise = wanted.exit_seed, wanted.noise
    return PredictionRequest(shots=shots, columns=wanted.poses, anchor=anchor, exit_seed=seed, noise=noise, **exits)


def _moved_request(wanted: Wanted, views: Sequence[View], model: Model, group: Sequence[int]) -> PredictionRequest:
    """The same of a moved model, for a difference about the same place: by a run whose noise is not the images'."""
    return _image_request(replace(wanted, model=model, paths=(), noise=False), views, group)


def _column_request(wanted: Wanted, views: Sequence[View], group: Sequence[int]) -> PredictionRequest:
    """The derivatives of the same views: differences of the twin's images, with the exits of the anchor's chips."""
    columns = tuple(dict.fromkeys(name for name, _ in wanted.columns.values()))
    shots = tuple(_shot(wanted.model, views[number], wanted.film_of) for number in group)
    anchor = None
    if wanted.anchor is not None:
        lent = tuple(_shot(wanted.anchor.model, views[number], wanted.film_of) for number in group)
        anchor = AnchorRequest(shots=lent, histories=0)
    return PredictionRequest(
        shots=shots, columns=columns, anchor=anchor, exit_histories=wanted.column_exits, exit_seed=wanted.exit_seed
    )


def _difference_request(wanted: Wanted, views: Sequence[View], moves: Sequence[_Move]) -> PredictionRequest:
    """The images of models moved along one path, all with the same random numbers.

    With the exits of the chips that were moved: two chips that are walked each by itself differ by two walks' noise.
    """

    def shot(model: Model, move: _Move) -> ShotRequest:
        return _shot(model, _about(views[move.view]), wanted.film_of)

    if any(move.traced for move in moves):
        anchor = AnchorRequest(histories=DIFFERENCE_HISTORIES, seed=_difference_seed(wanted))
    else:
        anchor = AnchorRequest(shots=tuple(shot(move.about, move) for move in moves), histories=0)
    shots = tuple(shot(move.model, move) for move in moves)
    return PredictionRequest(shots=shots, exit_histories=DIFFERENCE_EXITS, exit_seed=wanted.exit_seed, anchor=anchor)


def _difference_seed(wanted: Wanted) -> str:
    """Of the moved models' Monte Carlo, the same for all of them: neither the anchor's, nor that of other exits."""
    at = (1, 1) if wanted.anchor is None else (wanted.anchor.seed, wanted.anchor.exit_seed)
    return str(int(np.random.SeedSequence((*at, DIFFERENCE)).generate_state(1, np.uint64)[0]) % 10**18)


def _about(view: View) -> View:
    """The view from a pose rounded to half a pixel and a tenth of a degree, so that steps of a fit ask the same."""
    row, column = (round(2.0 * shift) / 2.0 for shift in view.pose.shift_px)
    return replace(view, pose=Pose((row, column), round(view.pose.rotation_deg, 1)))


def _images(wanted: Wanted, answer: Answer) -> Iterator[Predicted]:
    """The images of one answer, in the order of its shots."""
    arrays, columns = answer.arrays, _columns({path: (path, 1.0) for path in wanted.poses}, answer)
    for shot, image in enumerate(arrays["images_per_mm2"]):
        noise = _real(arrays["noise_per_mm2"][:, shot]) if len(arrays.get("noise_per_mm2", ())) else None
        twin = _real(arrays["twin_per_mm2"][shot]) if "twin_per_mm2" in arrays else None
        by_gain = _real(arrays["by_gain_per_mm2"][shot]) if "by_gain_per_mm2" in arrays else None
        by_offset = _real(arrays["by_offset"][shot]) if "by_offset" in arrays else None
        by_camera = arrays.get("by_camera_per_mm2", ())
        by_pose = {path: _real(one[shot]) for path, one in zip(wanted.poses, by_camera, strict=False)}
        yield Predicted(_real(image), next(columns), noise, twin, by_gain, by_offset, by_pose)


def _told_apart(found: Mapping[int, Predicted], parts: Sequence[Sequence[int]]) -> dict[int, Predicted]:
    """Views of one run, of several requests (images of two sizes), with noise that bounds what they share.

    The functions of one request are not those of another. With m requests each has m times its own covariance and
    nothing in common with others: whatever X is, [[A, X], [X', B]] <= diag(2 A, 2 B), so that no error is too small.
    """
    apart, before = {}, 0
    for part in parts if len(parts) > 1 else ():
        most = 0
        for number in part:
            noise = found[number].noise_per_mm2
            if noise is not None:
                others, most = np.zeros((before, *noise.shape[1:])), len(noise)
                apart[number] = replace(
                    found[number], noise_per_mm2=np.concatenate([others, math.sqrt(len(parts)) * noise])
                )
        before += most
    return apart


def _columns(columns: Mapping[str, tuple[str, float]], answer: Answer) -> Iterator[dict[str, Real]]:
    """Each shot's derivatives by these paths, each in the path's own unit."""
    names = list(dict.fromkeys(name for name, _ in columns.values()))
    for shot in range(len(answer.arrays["images_per_mm2"])):
        yield {
            path: unit * _real(answer.arrays["jacobian_per_mm2"][names.index(name), shot])
            for path, (name, unit) in columns.items()
        }


def _moves(wanted: Wanted, views: Sequence[View]) -> Iterator[_Move]:
    """All views of all models that were moved; about the anchor's, where there is one: asked for once in a fit.

    Where the anchor lacks an effect, or has it elsewhere, about the wanted model: effects are bent more.
    """
    for path in wanted.differences:
        name = wanted.effect_of(path)
        at = wanted.model if wanted.anchor is None or name else wanted.anchor.model
        traced = name in wanted.beyond_twin
        share = CHANCE_SHARE if name in wanted.by_chance else DIFFERENCE_SHARE if traced else SHARE
        for weight, model in moved_models(at, path, share):
            yield from (_Move(path, weight, model, at, traced, number) for number in wanted.seen_by(path, views))


def _by_path(moves: Sequence[_Move]) -> list[list[int]]:
    """Numbers of moves by path: each path is asked for by itself."""
    found: dict[str, list[int]] = {}
    for number, move in enumerate(moves):
        found.setdefault(move.path, []).append(number)
    return list(found.values())


def _groups_of(some: Sequence[int], moves: Sequence[_Move], views: Sequence[View]) -> Iterator[list[int]]:
    for group in _groups([views[moves[n].view] for n in some], 1 + ANCHOR_FUNCTIONS):
        yield [some[k] for k in group]


def _groups(views: Sequence[View], times: int, at: Anchored | None = None) -> Iterator[list[int]]:
    """Numbers of views of one size, and of as many histories, as many together as a request and its answer hold.

    Views of one sample, or of samples alike, see one run of Monte Carlo, whose noise is told by the same functions
    only within a request: they are parted only where they are of several sizes, or more than one holds
    (`_told_apart`).
    """
    alike: dict[tuple[int, int, int], dict[str, list[int]]] = {}
    for number, view in enumerate(views):
        histories = 0 if at is None else at.histories_of(view.sample.id)
        runs = alike.setdefault((view.rows, view.columns, histories), {})
        run = view.sample.id if at is None else run_of(view.sample, at.model)
        runs.setdefault(run, []).append(number)
    for (rows, columns, _), runs in alike.items():
        yield from _together(runs.values(), max(1, min(MOST_SHOTS, MOST_VALUES // (rows * columns * times))))


def _together(parts: Iterable[list[int]], most: int) -> Iterator[list[int]]:
    """Groups of at most so many, of whole parts where these are no more than that."""
    group: list[int] = []
    for part in parts:
        if group and len(group) + len(part) > most:
            yield group
            group = []
        group = group + part
        while len(group) > most:
            yield group[:most]
            group = group[most:]
    if group:
        yield group


def _real(array: Any) -> Real:
    return np.asarray(array, np.float64)
