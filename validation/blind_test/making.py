"""Makes blind sets: a truth's light, what is hidden in it, as strongly as asked, the noise, the sealed answer.

    truth --light()--> plain --ruler--> amounts --light(), signals(), recorded()--> data set + seal | answer

A set appears in its folder whole, after its answer; what was made is kept when making is cut short and goes on.
"""

from __future__ import annotations

import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from luxloop.errors import InputError
from luxloop.model import Model
from luxloop.model_file import SHIPPED, find_model, to_toml
from luxloop.words import parse, sha256_of
from validation import blind
from validation.blind_test.bound import close, refuse_gone
from validation.blind_test.folders import (
    ANSWERS,
    ASKED,
    INDEX,
    MODEL,
    SETS,
    Entry,
    Index,
    hash_of_fit,
    is_empty,
    move_whole,
    read_index,
    read_json,
    write_whole,
)
from validation.blind_test.left_out import leave_out, left_out
from validation.blind_test.scenes import Light, Scene, mean_of, write_images
from validation.blind_test.seals import Answer, Hiding, seal
from validation.blind_test.strength import LEAST_SIGMA, Halves, NoAmount, NotReached, sigma_beside, sigma_of
from validation.blind_test.truths import (
    Counts,
    Kinds,
    Planned,
    Truth,
    camera_of,
    planned,
    priors_of,
    sample_of,
    surroundings_of,
    truth_of,
)
from validation.dataset.folder import read_dataset, write_sums
from validation.dataset.simulation_plan import Plan
from validation.diagnose.score import Projected
from validation.effects.known import Known
from validation.prediction import Predictor

HISTORIES = 32_000_000
"""Of walks inside a chip, for each sample, in two halves. No laboratory's light has the noise that is left: along the
effects that it is most like, 0.4 of their errors at a small camera (`python -m benchmarks.blind_noise`)."""
MOST_SEED = 10**15


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
        """Refuse a strength that nobody could see, one that is no number, and what the forward model has not."""
        if not np.isfinite(self.sigma):
            raise InputError("--sigma", self.sigma, f"a number, at least {LEAST_SIGMA:g}", "20 is the usual one")
        if self.counts.sets > self.counts.nothing and not self.sigma >= LEAST_SIGMA:
            allowed = f"at least {LEAST_SIGMA:g}"
            mend = f"{self.sigma:g} sigma are less than this camera can show beside {len(blind.KINDS)} other kinds"
            raise InputError("--sigma", self.sigma, allowed, mend)
        camera_of(self.plan.camera, self.pixels)
        for one in self.plan.samples:
            sample_of(one)
        surroundings_of(self.model)

    def document(self) -> dict[str, Any]:
        """What must be the same for making to go on."""
        return {
            **asdict(self.counts), "seed": self.seed, "sigma": self.sigma, "kinds": list(self.kinds),
            "plan_sha256": sha256_of(self.plan), "model_sha256": self.model.sha256,
            "pixels": self.pixels, "histories": self.histories, "rivals": self.rivals,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Begun:
    """A folder that sets are put into, and what they are."""

    asked: Asked
    index: Index
    plan: Sequence[Planned]
    kinds: Kinds


def prepared(asked: Asked) -> Begun:
    """What would be begun or gone on with; nothing is written yet.

    Raises InputError where the folder has other sets, and where there is no kind of a sort that is asked for.
    """
    plan = planned(asked.counts, asked.seed)
    kinds = _kinds(asked)
    return Begun(asked, _index(asked, plan), plan, kinds)


def begin(asked: Asked) -> Begun:
    """The folder, begun or to be gone on with. Nothing is traced yet. Raises InputError as `prepared` does."""
    begun = prepared(asked)
    write_whole(asked.folder / ANSWERS / ASKED, asked.document())
    if begun.index.model == MODEL:
        write_whole(asked.folder / MODEL, to_toml(asked.model))
    write_whole(asked.folder / INDEX, begun.index.text())
    return begun


def make(
    begun: Begun, predictor: Predictor, known: Known, heard: Callable[[int, int, str], None] = lambda *_: None
) -> Index:
    """All sets that are not there yet, then the root of all; the index with it.

    `heard` is told how many of how many are there, and what is done.

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
            scene = Scene(truth, asked.plan, asked.pixels, asked.histories, asked.sigma, predictor, known)
        heard(number, len(plan), one.id)
        _make_one(asked, scene, one, kinds)
    heard(len(plan), len(plan), "done")
    return close(asked.folder, begun.index)


def _make_one(asked: Asked, scene: Scene, one: Planned, kinds: Kinds) -> None:
    start = time.monotonic()
    found: list[tuple[blind.Hidden, Light, Halves]] = []
    for _ in range(one.count):
        found.append(_hidden(asked, scene, one, kinds, [each[0].kind for each in found]))
    hidden, entry = [each[0] for each in found], _entry(one, scene.truth)
    light = found[0][1] if len(found) == 1 else scene.lights.of(hidden) if found else scene.lights.plain
    whole = sigma_of(scene.change(scene.lights, light, hidden)) if found else 0.0
    raw = blind.recorded(scene.signals(mean_of(light), hidden), scene.camera, hidden, one.seed)
    rivals = scene.rivals if asked.rivals and len(found) == 1 else None
    hidings = tuple(_hiding(each, halves, rivals) for each, _, halves in found)
    for each in hidden:
        kinds.took(each.kind)
    temporary = asked.folder / SETS / f".{one.id}"
    shutil.rmtree(temporary, ignore_errors=True)
    write_images(temporary, asked.plan, one.id, raw, scene.exposure[0], np.uint16)
    answer = Answer(
        id=one.id, hidden=hidings, asked_sigma=asked.sigma if found else 0.0, sigma=whole,
        truth=scene.truth.document(), light=one.light, priors=entry.priors,
        fit_sha256=hash_of_fit(entry.known_before(asked.model)), seed=asked.seed, histories=asked.histories,
        dataset_sha256=read_dataset(temporary).sha256, seconds=time.monotonic() - start,
    )  # fmt: skip
    seal(asked.folder, temporary, answer)
    write_sums(temporary)
    move_whole(temporary, asked.folder / SETS / one.id)


def _hidden(
    asked: Asked, scene: Scene, one: Planned, kinds: Kinds, beside: Sequence[str]
) -> tuple[blind.Hidden, Light, Halves]:
    """The next kind that shows as strongly as was asked; what does not is left out of this truth, not of others."""
    without = left_out(asked.folder, one.truth)
    while (name := kinds.next(one.outside, beside, without)) is not None:
        try:
            return scene.hide(name, one.seed + len(beside))
        except NotReached as reason:
            without[name] = reason.sigma
        except NoAmount:
            without[name] = None
        leave_out(asked.folder, one.truth, without)
    weak = ", ".join(f"{kind} {sigma:.1f}" for kind, sigma in without.items() if sigma is not None)
    tried = ", ".join(kind for kind, sigma in without.items() if sigma is None)
    mend = f"in truth {one.truth + 1} kinds show at their most by (sigma): {weak or 'none is left'}"
    mend += f"; no amount was found for {tried}" if tried else ""
    raise InputError("--sigma", asked.sigma, "a strength that the declared camera can see", mend)


def _hiding(hidden: blind.Hidden, halves: Halves, rivals: Projected | None) -> Hiding:
    kind = blind.KINDS[hidden.kind]
    beside = sigma_beside(halves, rivals) if rivals is not None else {}
    return Hiding(
        kind=kind.name, place=kind.place, amount=hidden.amount, unit=kind.unit, seed=hidden.seed, right=kind.right,
        sigma=sigma_of(halves), rivals={name: left for name, left in beside.items() if name not in kind.right},
    )  # fmt: skip


def seed_of(folder: Path, seed: int | None) -> int:
    """The seed that was given, that of the sets which are there, or one that nobody has chosen."""
    if seed is not None:
        return seed
    path = folder / ANSWERS / ASKED
    if path.exists():
        found = read_json(path, ASKED, "what was asked for", "name another folder").get("seed")
        if not isinstance(found, int):
            raise InputError(f"{ASKED}: seed", found, "a whole number", "put the file back, or name another folder")
        return found
    return secrets.randbelow(MOST_SEED)


def _index(asked: Asked, plan: Sequence[Planned]) -> Index:
    """What the folder says of itself; InputError where it has other sets."""
    truths = {k: truth_of(k, asked.model, len(asked.plan.samples), asked.seed) for k in {one.truth for one in plan}}
    entries = tuple(sorted((_entry(one, truths[one.truth]) for one in plan), key=lambda one: one.id))
    model = next((name for name in SHIPPED if find_model(name).sha256 == asked.model.sha256), MODEL)
    index = Index(plan=asked.plan.name, model=model, model_sha256=asked.model.sha256, sets=entries)
    path = asked.folder / ANSWERS / ASKED
    if path.exists():
        there = read_index(asked.folder) if (asked.folder / INDEX).exists() else index
        refuse_gone(asked.folder, there)
        index = index.model_copy(update={"seals": there.seals, "root": there.root})
        if there != index or read_json(path, ASKED, "what was asked for", "name another folder") != asked.document():
            mend = "the same command goes on with its sets; take another folder for others"
            raise InputError("FOLDER", str(asked.folder), "an empty folder, or one that the same command began", mend)
    elif asked.folder.exists() and not is_empty(asked.folder):
        raise InputError("FOLDER", str(asked.folder), "an empty folder, or one that is not there yet", "name another")
    return index


def _entry(one: Planned, truth: Truth) -> Entry:
    return Entry(id=one.id, light=one.light, priors=priors_of(truth, one.seed))


def _answers(folder: Path) -> Iterator[Answer]:
    for path in sorted((folder / ANSWERS).glob("set-*.json")):
        data = read_json(path, path.name, "an answer", "make the sets anew")
        yield parse(Answer, data.get("answer"), f"{path.parent.name}/{path.name}")


def _kinds(asked: Asked) -> Kinds:
    """The kinds to choose from, with what sets that are there have taken."""
    kinds = Kinds(asked.kinds, asked.seed)
    for answer in _answers(asked.folder):
        if (asked.folder / SETS / answer.id).is_dir():
            for one in answer.hidden:
                kinds.took(one.kind)
    _check_kinds(asked, kinds)
    return kinds


def _check_kinds(asked: Asked, kinds: Kinds) -> None:
    """Raises InputError where a sort of set that is asked for has no kind."""
    names, counts = ", ".join(asked.kinds), asked.counts
    if not kinds.has(False) and counts.one + counts.two:
        mend = f"{names} lie outside of the catalogue: --outside {counts.sets} asks for nothing else"
        raise InputError("--kinds", names, "at least one kind in the catalogue", mend)
    if not kinds.has(True) and counts.outside:
        mend = f"{names} lie in the catalogue: leave --outside out, or name others"
        raise InputError("--kinds", names, "at least one kind outside of the catalogue", mend)
    if counts.two and not kinds.has_two():
        mend = "two hidden effects of one group could not be told apart: name kinds of another group, too"
        raise InputError("--kinds", names, "kinds of two groups, for --two", mend)
