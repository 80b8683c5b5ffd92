"""Verdicts on blind sets: the same diagnosis that a user gets, one record a set, written whole.

The seal is not opened, and nothing of `answers/` is read. Sets of one light are the same scene with other noise, and
other priors (decision 76): what the first of them asked of the workers (columns of effects, the anchor's Monte Carlo,
the null) serves all, and fits begin where its own ended.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop import __version__
from luxloop.effect import EffectSpec
from luxloop.errors import InputError
from luxloop.model import Model
from luxloop.model_file import find_model
from luxloop.words import sha256_of
from validation.blind_test.bound import Chain, chain_of, refuse_opened
from validation.blind_test.code import code_sha256
from validation.blind_test.folders import SCHEMA, SETS, Entry, Index, hash_of_fit, model_of, write_whole
from validation.blind_test.records import maps_path, record_path
from validation.blind_test.seals import seal_on
from validation.comparing import Solver
from validation.contrasts.structure import doubts_of, judged
from validation.dataset.folder import read_dataset
from validation.diagnose.anew import thawed
from validation.diagnose.arrays import arrays_of
from validation.diagnose.document import document
from validation.diagnose.frozen import frozen_at
from validation.diagnose.ground import Ground
from validation.diagnose.rounds import Diagnosis
from validation.diagnose.score import Candidate
from validation.diagnosing import Diagnosing
from validation.effects.known import Known
from validation.fit import Fit
from validation.fit.descent import unclipped
from validation.fit.parameters import free_paths
from validation.fit.problem import Problem
from validation.observed import Observed
from validation.prediction import Anchored, Predictor

KEPT = (
    "verdict", "sentence", "structure", "scores", "scores_p", "effects", "set", "groups", "confounding", "added",
    "next_measurement", "known", "distrust", "untestable", "shots", "parameters", "seed", "versions",
)  # fmt: skip
"""Of a diagnosis's document."""


@dataclass(eq=False)
class Shared:
    """What sets of one light have in common: asked once."""

    light: str = ""
    anchor: Anchored | None = None
    ground: Ground | None = None
    frozen: Problem | None = None
    """That of the first set's fit, with the derivatives where it ended: noise moves a fit by some errors."""
    candidates: list[Candidate] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class SharedSolver(Solver):
    """One anchor for all sets of a light but the first: its Monte Carlo is run once."""

    shared: Shared = field(default_factory=Shared)

    def anchor(self, model: Model) -> Anchored:
        """That with which the fit of the first set ended; of the first set its own, made anew where its fit moves."""
        return self.shared.anchor or super().anchor(model)


@dataclass(eq=False)
class SharedDiagnosing(Diagnosing):
    """A diagnosis that takes anchor, columns of effects and null of the base fit from the first set of its light."""

    shared: Shared = field(default_factory=Shared)

    def fitted(self, model: Model) -> Fit:
        """The base fit; its anchor is that of the sets to come, whose fits begin where it ended, if it is trusted."""
        first = self.shared.ground
        if first is not None and first.fit.trusted:
            self.shared.frozen = self.shared.frozen or frozen_at(first.fit.problem, first.fit.values)
            own = replace(
                self.shared.frozen, images=self.observed.images, model=model,
                unknowns=self.shared.frozen.unknowns.with_limits_of(model),
            )  # fmt: skip
            found = unclipped(own, first.fit.values)
            return thawed(found, first.fit.problem)
        found = super().fitted(model)
        self.shared.anchor = self.shared.anchor or found.problem.anchor
        return found

    def signatures(self, found: Fit, effects: Sequence[EffectSpec]) -> list[Candidate]:
        """Of the base fit those of the first set; of a fit with effects its own."""
        if found.model.effects:
            return super().signatures(found, effects)
        if not self.shared.candidates or self.shared.candidates[0].columns.shape[1] != len(found.residual):
            self.shared.candidates = super().signatures(found, effects)
            self.shared.refused = dict(self.refused)
        self.refused.update(self.shared.refused)
        return self.shared.candidates

    def ground(self, found: Fit) -> Ground:
        """By the null of the first set, which hardly depends on where a fit ends."""
        if found.model.effects:
            return super().ground(found)
        first = self.shared.ground
        if first is None or len(first.fit.residual) != len(found.residual):
            self.shared.ground = super().ground(found)
            self.shared.anchor = self.shared.ground.fit.problem.anchor
            return self.shared.ground
        if doubts_of(found, first.null.layout, first.variances, first.null):
            return super().ground(found)
        structure = judged(found.residual, first.null.layout, found.basis, first.variances, first.null)
        return replace(first, fit=found, structure=structure)


@dataclass(frozen=True, eq=False)
class Judge:
    """Who gives the verdicts."""

    folder: Path
    model: Model
    predictor: Predictor
    known: Known
    solver: Solver
    cache: Path | None = None
    among: tuple[str, ...] = ()
    """Names of the effects to choose from; none: all."""

    def verdicts(
        self, index: Index, heard: Callable[[int, int, str], None] = lambda *_: None
    ) -> Iterator[dict[str, Any]]:
        """One for each set that is made and has none, on record before it is yielded; those of a light together.

        `heard` is told how many of how many have one, and which is looked at. Raises InputError where verdicts were
        changed or taken away, and for a set whose seal was opened.
        """
        refuse_opened(self.folder, index)
        chain, missing = chain_of(self.folder, index), not_made(self.folder, index)
        chain.mend(self.folder)
        order = sorted((one for one in index.sets if one.id not in missing), key=lambda one: (one.light, one.id))
        shared = Shared()
        for number, one in enumerate(order):
            if one.light != shared.light:
                shared = Shared(one.light)
            heard(number, len(order), one.id)
            if not record_path(self.folder, one.id).exists():
                record = self._verdict(one, shared, chain)
                chain = Chain(record["number"], record["sha256"])
                chain.write(self.folder)
                yield record
        heard(len(order), len(order), "done")

    def _verdict(self, one: Entry, shared: Shared, chain: Chain) -> dict[str, Any]:
        sealed = seal_on(self.folder, one.id)  # of what is judged: a seal that comes later is no seal
        start = time.monotonic()
        dataset = read_dataset(self.folder / SETS / one.id)
        seed = seed_of_light(self.solver.seed, one.light)
        model = one.known_before(self.model)
        solver = SharedSolver(self.solver.histories, seed, self.solver.most_histories, shared=shared)
        first = shared.ground is None
        engine = SharedDiagnosing(
            model, Observed.of(dataset), self.predictor, self.known, solver,
            tuple(free_paths(self.model)), self.cache, among=self.among, shared=shared,
        )  # fmt: skip
        found = engine.diagnosed()
        told = document(found, solver.seed)
        record = {
            "schema": SCHEMA, "id": one.id, "light": one.light, "seal": sealed, "dataset_sha256": dataset.sha256,
            "model_sha256": self.model.sha256, "priors": one.priors, "fit_sha256": hash_of_fit(model),
            "solver": self.solver.document(), "among": list(self.among), "version": __version__,
            "code_sha256": code_sha256(), "seconds": time.monotonic() - start, "first_of_light": first,
            **{name: told[name] for name in KEPT},
        }  # fmt: skip
        if first or record["verdict"] != "nothing_visible":
            maps = packed(residuals_of(found))
            write_whole(maps_path(self.folder, one.id), maps)
            record["maps_sha256"] = sha256(maps).hexdigest()
        else:  # the same as those of the first, and a thousand times
            record |= {"confounding": {"names": [], "cosines": []}, "scores": record["scores"][:1]}
        placed = chain.added(record)
        write_whole(record_path(self.folder, one.id), placed)
        return placed


def seed_of_light(seed: int, light: str) -> int:
    """Of all that is random in verdicts on a light: by one seed, modules of all truths would err alike."""
    return int(sha256_of([seed, light])[:12], 16)


def not_made(folder: Path, index: Index) -> list[str]:
    """The sets that an unfinished `make` has still to make; of a whole folder none, for there a gap is damage."""
    return [] if index.root is not None else [one.id for one in index.sets if not (folder / SETS / one.id).is_dir()]


def chosen_model(folder: Path, index: Index, name: str | None) -> Model:
    """The model of the sets. Raises InputError for another one: the truths were drawn about this one."""
    own = model_of(folder, index)
    if name is not None and find_model(name).sha256 != own.sha256:
        raise InputError("--model", name, f"the model of the sets, {index.model}", "leave --model out")
    return own


def residuals_of(found: Diagnosis) -> dict[str, NDArray[np.float16]]:
    """Residuals in sigma by "SHOT/z" and, with the best effect, "SHOT/z_with"; three digits are enough to draw."""
    return {name: one.astype(np.float16) for name, one in arrays_of(found).items() if "/z" in name}


def packed(arrays: dict[str, NDArray[np.float16]]) -> bytes:
    """Arrays as the bytes of an .npz file."""
    memory = io.BytesIO()
    np.savez_compressed(memory, allow_pickle=False, **arrays)
    return memory.getvalue()
