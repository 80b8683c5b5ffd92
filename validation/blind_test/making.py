"""Makes blind sets: a truth's light, what is hidden in it, as strongly as asked, the noise, the sealed answer.

    truth --light()--> plain --ruler--> amounts --light(), signals(), recorded()--> data set + seal | answer

A set appears in its folder whole, after its answer; what was made is kept when making is cut short and goes on.
"""

from __future__ import annotations

import secrets
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop import __version__
from luxloop.errors import InputError
from luxloop.model import Model
from luxloop.words import sha256_of
from validation import blind
from validation.blind_test.folders import ANSWERS, INDEX, SETS, Entry, Index, read_index, read_json, write_whole
from validation.blind_test.seals import Answer, Hiding, seal
from validation.blind_test.strength import LEAST_SIGMA, Halves, NotReached, Ruler, amount_for, sigma_beside, sigma_of
from validation.blind_test.truths import (
    Counts,
    Kinds,
    Planned,
    Truth,
    camera_of,
    planned,
    sample_of,
    surroundings_of,
    truth_of,
)
from validation.dataset.folder import read_dataset, write_sums
from validation.dataset.images import write_tiff
from validation.dataset.manifest import ImageShot, Manifest
from validation.dataset.manifest_file import MANIFEST
from validation.dataset.manifest_file import to_toml as manifest_text
from validation.dataset.simulate import expected_images, views_of
from validation.dataset.simulation_plan import Plan
from validation.diagnose.score import Projected
from validation.effects.known import Known, for_chips
from validation.measured import MeasuredImage, measured_images
from validation.prediction import Predictor

Real = NDArray[np.float64]
Light = tuple[list[Real], list[Real]]
"""Of all samples, by two halves of the histories."""

HISTORIES = 4_000_000
"""Of walks inside a chip, for each sample."""
MOST_SEED = 10**15
WEAK, ASKED = "too-weak.json", "asked.json"
"""Beside the answers: kinds that do not show as strongly as was asked; what was asked for."""


@dataclass(frozen=True, eq=False)
class Asked:
    """What is asked of `blind make`."""

    folder: Path
    counts: Counts
    seed: int
    sigma: float
    plan: Plan
    model: Model
    kinds: Sequence[str] = ()
    pixels: int = 128
    histories: int = HISTORIES
    rivals: bool = True
    """Whether the strength that is left beside each effect of the catalogue goes into the answer."""

    def __post_init__(self) -> None:
        """Refuse a strength that nobody could see."""
        if self.counts.sets > self.counts.nothing and not self.sigma >= LEAST_SIGMA:
            allowed = f"at least {LEAST_SIGMA:g}"
            mend = f"{self.sigma:g} sigma are less than this camera can show beside {len(blind.KINDS)} other kinds"
            raise InputError("--sigma", self.sigma, allowed, mend)
        camera_of(self.plan.camera, self.pixels)
        surroundings_of(self.model)

    def document(self) -> dict[str, Any]:
        """What must be the same for making to go on."""
        return {
            **asdict(self.counts), "seed": self.seed, "sigma": self.sigma, "kinds": list(self.kinds),
            "plan_sha256": sha256_of(self.plan), "model_sha256": self.model.sha256,
            "pixels": self.pixels, "histories": self.histories, "rivals": self.rivals,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scene:
    """A truth before its camera: its plain light, how it is exposed, what measures changes of it."""

    asked: Asked
    truth: Truth
    predictor: Predictor
    known: Known

    @property
    def camera(self) -> blind.Camera:
        """The declared one."""
        return camera_of(self.asked.plan.camera, self.asked.pixels)

    def light(self, hidden: Sequence[blind.Hidden] = ()) -> Light:
        """Of all samples with these things hidden; what only the camera does changes no light."""
        if hidden and all(blind.KINDS[one.kind].place == "camera" for one in hidden):
            return self.plain
        samples = [sample_of(one) for one in self.asked.plan.samples]
        first, second = (
            blind.light(
                self.truth.surroundings, samples, self.camera, self.truth.poses, hidden,
                seed=self.truth.seed + half, histories=-(-self.asked.histories // 2),
            )
            for half in (0, 1)
        )  # fmt: skip
        return first, second

    @cached_property
    def plain(self) -> Light:
        """With nothing hidden."""
        return self.light()

    @cached_property
    def exposure(self) -> tuple[list[float], float]:
        """Exposures in ms and DN per ms at 1/mm^2, by which the plain images peak at a share of full scale."""
        asked = self.asked
        views = views_of(asked.plan, 0, asked.pixels, asked.pixels)
        mean = _mean(self.plain)
        expected = expected_images(views, mean, asked.plan.camera)
        lit = expected[0]
        dn_per_ms = float(lit.signal_dn.max() / lit.irradiance_per_mm2.max()) / lit.exposure_ms
        return [one.exposure_ms for one in expected], dn_per_ms

    def signals(self, light: Sequence[Real], hidden: Sequence[blind.Hidden] = ()) -> list[Real]:
        """Expected signals (row, column) in DN above black."""
        exposures, dn_per_ms = self.exposure
        return blind.signals(light, exposures, dn_per_ms, self.camera, hidden)

    @cached_property
    def ruler(self) -> Ruler:
        """A perfect fit of the plain images."""
        with tempfile.TemporaryDirectory() as folder:
            raw = [image + self.camera.black_level_dn for image in self.signals(_mean(self.plain))]
            write_images(Path(folder), self.asked.plan, "plain", raw, self.exposure[0], np.float32)
            images: list[MeasuredImage] = measured_images(read_dataset(Path(folder)))
        return Ruler.at(self.truth, images, self.predictor)

    @cached_property
    def rivals(self) -> Projected:
        """The columns of all effects that these samples can have."""
        chips = max(one.rows * one.columns for one in self.asked.plan.samples)
        specs = [for_chips(one, chips) for one in self.known.specs if not one.name.startswith("film_")]
        return self.ruler.rivals(self.predictor, self.known, specs)

    def change(self, light: Light, hidden: Sequence[blind.Hidden]) -> Halves:
        """What these hidden things change, by each half of the light."""
        first, second = (
            self.ruler.left(
                [one - other for one, other in zip(self.signals(there, hidden), self.signals(here), strict=True)]
            )
            for there, here in zip(light, self.plain, strict=True)
        )
        return first, second

    def hide(self, name: str, seed: int) -> tuple[blind.Hidden, Light, Halves]:
        """A thing of a kind at the asked strength, the light with it, what it changes. Raises NotReached."""
        tried: dict[float, tuple[blind.Hidden, Light, Halves]] = {}

        def measure(amount: float) -> float:
            hidden = blind.Hidden(name, amount, seed)
            light = self.light([hidden])
            tried[amount] = hidden, light, self.change(light, [hidden])
            return sigma_of(tried[amount][2])

        return tried[amount_for(blind.KINDS[name], self.asked.sigma, measure)]


@dataclass(frozen=True, eq=False)
class Begun:
    """A folder that sets are put into, and what they are."""

    asked: Asked
    index: Index
    plan: Sequence[Planned]
    kinds: Kinds


def begin(asked: Asked) -> Begun:
    """The folder, begun or to be gone on with. Nothing is traced yet.

    Raises InputError where it has other sets, and where there is no kind of a sort that is asked for.
    """
    plan = planned(asked.counts, asked.seed)
    kinds = _kinds(asked, plan)
    return Begun(asked, _index(asked, plan), plan, kinds)


def make(
    begun: Begun, predictor: Predictor, known: Known, heard: Callable[[int, int, str], None] = lambda *_: None
) -> None:
    """All sets that are not there yet. `heard` is told how many of how many are there, and what is done.

    Raises InputError where no kind that is left shows as strongly as was asked.
    """
    asked, plan, kinds = begun.asked, begun.plan, begun.kinds
    scene: Scene | None = None
    for number, one in enumerate(plan):
        if (asked.folder / SETS / one.id).is_dir():
            continue
        if scene is None or scene.truth.number != one.truth:
            heard(number, len(plan), f"the light of truth {one.truth + 1}")
            truth = truth_of(one.truth, asked.model, len(asked.plan.samples), asked.seed)
            scene = Scene(asked, truth, predictor, known)
        heard(number, len(plan), one.id)
        _make_one(scene, one, kinds)
    heard(len(plan), len(plan), "done")


def _make_one(scene: Scene, one: Planned, kinds: Kinds) -> None:
    asked, start = scene.asked, time.monotonic()
    found: list[tuple[blind.Hidden, Light, Halves]] = []
    for _ in range(one.count):
        found.append(_hidden(scene, one, kinds, [each[0].kind for each in found]))
    hidden = [each[0] for each in found]
    light = found[0][1] if len(found) == 1 else scene.light(hidden) if found else scene.plain
    whole = sigma_of(scene.change(light, hidden)) if found else 0.0
    raw = blind.recorded(scene.signals(_mean(light), hidden), scene.camera, hidden, one.seed)
    known_one = asked.rivals and len(found) == 1 and not one.outside
    hidings = tuple(_hiding(each, halves, scene.rivals if known_one else None) for each, _, halves in found)
    for each in hidden:
        kinds.took(each.kind)
    temporary = asked.folder / SETS / f".{one.id}"
    shutil.rmtree(temporary, ignore_errors=True)
    write_images(temporary, asked.plan, one.id, raw, scene.exposure[0], np.uint16)
    answer = Answer(
        id=one.id, hidden=hidings, asked_sigma=asked.sigma if found else 0.0, sigma=whole,
        truth=scene.truth.document(), light=one.light, seed=asked.seed, histories=asked.histories,
        dataset_sha256=read_dataset(temporary).sha256, seconds=time.monotonic() - start,
    )  # fmt: skip
    seal(asked.folder, temporary, answer)
    write_sums(temporary)
    temporary.rename(asked.folder / SETS / one.id)


def _hidden(scene: Scene, one: Planned, kinds: Kinds, beside: Sequence[str]) -> tuple[blind.Hidden, Light, Halves]:
    """The next kind that shows as strongly as was asked."""
    weak = weak_kinds(scene.asked.folder)
    while (name := kinds.next(one.outside, beside)) is not None:
        try:
            return scene.hide(name, one.seed + len(beside))
        except NotReached as reason:
            kinds.drop(name)
            weak[name] = reason.sigma
            write_whole(scene.asked.folder / ANSWERS / WEAK, weak)
    reached = ", ".join(f"{name} {sigma:.1f}" for name, sigma in weak.items())
    mend = f"at their most, and as far as amounts were found, kinds show by (sigma): {reached or 'none is left'}"
    raise InputError("--sigma", scene.asked.sigma, "a strength that the declared camera can see", mend)


def _hiding(hidden: blind.Hidden, halves: Halves, rivals: Projected | None) -> Hiding:
    kind = blind.KINDS[hidden.kind]
    beside = sigma_beside(halves, rivals) if rivals is not None else {}
    return Hiding(
        kind=kind.name, place=kind.place, amount=hidden.amount, unit=kind.unit, seed=hidden.seed, right=kind.right,
        sigma=sigma_of(halves), rivals={name: left for name, left in beside.items() if name not in kind.right},
    )  # fmt: skip


def write_images(
    folder: Path, plan: Plan, name: str, raw: Sequence[NDArray[Any]], exposures_ms: Sequence[float], kind: type
) -> None:
    """An ordinary data set: an image of each sample, manifest, hashes."""
    shots = []
    for sample, image, exposure in zip(plan.samples, raw, exposures_ms, strict=True):
        file = f"images/{sample.id}.tif"
        write_tiff(folder / file, image.astype(kind))
        shots.append(ImageShot(id=sample.id, kind="image", sample=sample.id, file=file, exposure_ms=exposure))
    manifest = Manifest(
        name=f"blind {name}", licence=plan.licence, camera=plan.camera, samples=plan.samples, shots=tuple(shots),
        notes=f"Made by luxloop {__version__} blind make. Something may be hidden in it.",
    )  # fmt: skip
    (folder / MANIFEST).write_text(manifest_text(manifest), encoding="utf-8")
    write_sums(folder)


def _mean(light: Light) -> list[Real]:
    return [(one + other) / 2.0 for one, other in zip(*light, strict=True)]


def seed_of(folder: Path, seed: int | None) -> int:
    """The seed that was given, that of the sets which are there, or one that nobody has chosen."""
    if seed is not None:
        return seed
    path = folder / ANSWERS / ASKED
    if path.exists():
        return int(read_json(path, ASKED, "what was asked for", "name another folder")["seed"])
    return secrets.randbelow(MOST_SEED)


def _index(asked: Asked, plan: Sequence[Planned]) -> Index:
    """What the folder says of itself; InputError where it has other sets."""
    entries = tuple(sorted((Entry(id=one.id, light=one.light) for one in plan), key=lambda one: one.id))
    index = Index(plan=asked.plan.name, model=asked.model.name, sets=entries)
    path = asked.folder / ANSWERS / ASKED
    if path.exists():
        there = read_index(asked.folder) if (asked.folder / INDEX).exists() else index
        if there != index or read_json(path, ASKED, "what was asked for", "name another folder") != asked.document():
            mend = "the same command goes on with its sets; take another folder for others"
            raise InputError("FOLDER", str(asked.folder), "an empty folder, or one that the same command began", mend)
    elif asked.folder.exists() and any(asked.folder.iterdir()):
        raise InputError("FOLDER", str(asked.folder), "an empty folder, or one that is not there yet", "name another")
    write_whole(path, asked.document())
    write_whole(asked.folder / INDEX, index.text())
    return index


def _answers(folder: Path) -> Iterator[Answer]:
    for path in sorted((folder / ANSWERS).glob("set-*.json")):
        yield Answer.model_validate(read_json(path, path.name, "an answer", "make the sets anew")["answer"])


def weak_kinds(folder: Path) -> dict[str, float]:
    """Kinds that do not show as strongly as was asked, with the sigma that they have at their most."""
    path = folder / ANSWERS / WEAK
    return dict(read_json(path, WEAK, "sigma by kind", "remove it")) if path.exists() else {}


def _kinds(asked: Asked, plan: Sequence[Planned]) -> Kinds:
    """The kinds to choose from, with what sets that are there have taken."""
    kinds = Kinds(asked.kinds, asked.seed)
    for name in weak_kinds(asked.folder):
        kinds.drop(name)
    for answer in _answers(asked.folder):
        if (asked.folder / SETS / answer.id).is_dir():
            for one in answer.hidden:
                kinds.took(one.kind)
    for outside in {one.outside for one in plan if one.count}:
        if not kinds.has(outside):
            where = "outside of" if outside else "in"
            allowed = f"at least one kind {where} the catalogue that is strong enough"
            raise InputError("--kinds", ", ".join(asked.kinds), allowed, "name others")
    return kinds
