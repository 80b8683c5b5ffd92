"""What diagnose, next, add and remove share: a fit on the data on record, its ground, the workers' catalogue.

The data are those that `compare` put into the model file; the model's own parameters are calibrated anew, beside the
effects that it has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from luxloop.effect import EffectSpec, Value
from luxloop.errors import InputError, RemoteError
from luxloop.model import Model
from validation.comparing import Solver, noisy_curves
from validation.contrasts.structure import DRAWS
from validation.diagnose.anew import about_itself, has_monte_carlo
from validation.diagnose.by_sample import is_by_sample, with_members_free, with_own_values
from validation.diagnose.columns import FitSight, candidates_of, in_shape
from validation.diagnose.diagnosis import Means, diagnosed
from validation.diagnose.ending import finished
from validation.diagnose.frozen import slopes_of
from validation.diagnose.ground import Ground
from validation.diagnose.groups import joined
from validation.diagnose.held import Held, held_alike
from validation.diagnose.next_measurement import Rivals
from validation.diagnose.proposal import Proposal
from validation.diagnose.refit import refit
from validation.diagnose.refitted import Refitted
from validation.diagnose.rounds import Diagnosis
from validation.diagnose.score import Candidate, Projected, Score, scores
from validation.diagnose.tried import of_all_or_each
from validation.effects.known import Known, for_chips
from validation.effects.signatures import Column, Projection, signature
from validation.fit import Fit, fit
from validation.fit.parameters import free_paths
from validation.observed import Observed
from validation.prediction import Predictor
from validation.sample_values import free_members

Progress = Callable[[float, str], None]

CLOSELY = 4_000_000
"""Histories a sample, of each of two runs, for columns whose noise may decide. Of walls of 0.3, by a score of 20 at
500,000, columns by 2 million scored 27 and 42, and agreed by 0.81 where others did by 0.48 to 0.61."""


def silent(*_: object) -> None:
    """A progress that nobody sees."""


@dataclass(eq=False)
class Diagnosing:
    """A model, its data and the workers."""

    model: Model
    observed: Observed
    predictor: Predictor
    known: Known
    solver: Solver
    free: tuple[str, ...]
    """Paths of the model that move."""
    cache: Path | None = None
    progress: Progress = silent
    among: tuple[str, ...] = ()
    """Names of the effects to choose from; none: all."""
    refused: dict[str, str] = field(default_factory=dict)
    """Effects that cannot be had with these samples beside the model's own, with the reason."""
    traced: dict[tuple[object, ...], list[Column]] = field(default_factory=dict)
    """Columns of effects by Monte Carlo, kept from round to round."""
    traced_closely: dict[tuple[object, ...], list[Column]] = field(default_factory=dict)
    """The same by CLOSELY histories."""
    _sight: tuple[Fit, FitSight] | None = None
    """The last fit that was looked at, and what was already predicted about it."""

    def fitted(self, model: Model) -> Fit:
        """A model on these data; effects in it are fitted where its [fit] tables free them."""
        anchor_at = self.solver.anchor_at
        free = [*self.free, *(path for path in free_paths(model) if path.startswith("effects."))]
        found = fit(
            model,
            self.observed.images,
            self.predictor,
            free=list(dict.fromkeys(free)),
            anchor_at=anchor_at,
            curves=self.observed.curves,
            predict_curves=self.solver.curves_of(self.predictor),
            others=self.observed.films,
            start=self.observed.films_at,
            most_histories=self.solver.most_histories,
        )
        found = found.doubted(noisy_curves(found, self.solver))
        moving = {member.effect for member, _ in free_members(model).values()}
        specs = [one for one in self.known.specs if one.name in moving]
        if not specs:
            return found
        return with_members_free(found, specs, self._apart).doubted(noisy_curves(found, self.solver))

    def ground(self, found: Fit) -> Ground:
        """The structure that a fit leaves, and its null; of one that is too far from its anchor, about a new one."""
        ground = Ground.of(found, DRAWS, self.solver.seed, self.cache)
        if ground.fit.distrust == found.distrust or not has_monte_carlo(found.problem):
            return ground
        again = about_itself(found)
        return Ground.of(again.doubted(noisy_curves(again, self.solver)), DRAWS, self.solver.seed, self.cache)

    @cached_property
    def effects(self) -> list[EffectSpec]:
        """Those that these data could show: of modules where there are images or far fields, of films else."""
        spectra = any(not curve.free_scale for curve in self.observed.curves)
        for name in self.among:
            self.known.spec(name)
        there = {"films": spectra, "modules": self.observed.of_modules}
        seen = [one for one in self.known.specs if any(there[what] for what in one.acts_on)]
        chosen = [one for one in seen if not self.among or one.name in self.among]
        if not chosen:
            mend = "images of modules show effects of modules, spectra those of films"
            raise InputError("--among", ", ".join(self.among), "effects that these data can show", mend)
        chips = max((one.sample.rows * one.sample.columns for one in self.observed.images), default=1)
        return [for_chips(one, chips) for one in chosen]

    @property
    def untested(self) -> list[str]:
        """Effects that these data cannot show, with the reason; those that samples refuse after a diagnosis."""
        names = {one.name for one in self.effects}
        wanted = set(self.among) or {one.name for one in self.known.specs}
        left = [one for one in self.known.specs if one.name not in names and one.name in wanted]
        why = {"films": "there are no spectra of films", "modules": "there are no images of modules"}
        idle = [f"{one.name}: {why[one.acts_on[0]]}" for one in left]
        return idle + [f"{name}: {reason}" for name, reason in self.refused.items()]

    def signatures(self, found: Fit, effects: Sequence[EffectSpec]) -> list[Candidate]:
        """The whitened columns of effects at a fit."""
        return self._candidates(found, effects, self._sight_of(found))

    def closely(self, found: Fit, effects: Sequence[EffectSpec]) -> list[Candidate]:
        """The same by more Monte Carlo, for effects that the twin cannot represent."""
        return self._candidates(found, effects, self._sight_of(found).closer(CLOSELY, self.traced_closely))

    def _candidates(self, found: Fit, effects: Sequence[EffectSpec], sight: FitSight) -> list[Candidate]:
        names = [[one.name for one in model.effects] for model in (found.model, self.model)]
        refused = self.refused if names[0] == names[1] else {}  # what a later round refuses, the first one has tested
        return joined(
            candidates_of(found, effects, sight, lambda share, name: self.progress(0.1 + 0.4 * share, name), refused)
        )

    def in_shape(self, found: Fit, effect: EffectSpec, shape: dict[str, Value]) -> list[Candidate]:
        """The whitened columns of an effect at a fit, in one shape."""
        return list(in_shape(found, effect, shape, self._sight_of(found), Projection.of(found)))

    def scored(self, found: Fit, effects: Sequence[EffectSpec]) -> dict[str, Score]:
        """Effects at their best shape on a fit, by name; InputError for one that these data cannot show."""
        projected = Projected.of(self.signatures(found, effects), found.basis)
        impossible = next((one.name for one in effects if one.name in self.refused), None)
        if impossible is not None:
            allowed = "an effect that these samples can have"
            raise InputError("EFFECT", impossible, allowed, self.refused[impossible])
        if projected.untestable:
            name = projected.untestable[0]
            allowed, mend = "an effect that these data can show", "what is fitted anyway does all that it does"
            raise InputError("EFFECT", name, allowed, mend)
        tested = scores(projected, found.residual_with_priors, found.variance_scale, seed=self.solver.seed)
        return {one.name: of_all_or_each(found, one).best for one in tested.effects}

    def refitted(self, found: Fit, effect: EffectSpec) -> Refitted:
        """The fit with an effect at its best shape, what shapes it free where the data hold it."""
        added = refit(found, self.scored(found, [effect])[effect.name], slopes_of(found))
        return finished(added, found.problem.predictor, found.problem.predict_curves)

    def added(self, found: Fit, effect: EffectSpec) -> Fit:
        """The fit of the model that has an effect besides: where each sample has its own of it, a value for each.

        Samples are those of images: far fields alone have one value, as they had in the diagnosis.
        """
        if is_by_sample(effect) and self.observed.images and "modules" in effect.acts_on:
            self.scored(found, [effect])  # what these data cannot show is said first
            return with_own_values(found, effect, self._apart)
        ended = self.refitted(found, effect).fit
        if ended is None:
            raise ValueError(f"{effect.name} is a group, and no sample has its own of it")
        return ended

    def _members_fit(self, found: Fit, effect: EffectSpec) -> Fit | None:
        """The fit with a group's members; None where a worker refuses a step of it (a chip beyond the module)."""
        try:
            return with_own_values(found, effect, self._apart)
        except (InputError, RemoteError) as error:
            if isinstance(error, RemoteError) and error.failure.code != "bad_input":
                raise
            return None

    def _apart(self, found: Fit, effect: EffectSpec, shape: Mapping[str, Value]) -> list[Column]:
        """The columns of an effect at a fit, of each sample by themselves."""
        sight = self._sight_of(found)
        return signature(sight, sight.at(found.model, effect), effect, shape, apart=True)

    def _sight_of(self, found: Fit) -> FitSight:
        if self._sight is None or self._sight[0] is not found:
            sight = FitSight.of(found, self.predictor, self.known.beyond_twin, self.solver.seed, self.traced)
            self._sight = found, sight
        return self._sight[1]

    def next_image(self, found: Fit, rivals: Sequence[Refitted]) -> list[Proposal]:
        """What would tell rivals apart, the best first."""
        return Rivals(found, rivals, self.predictor, self.known.beyond_twin).proposals(
            lambda share, words: self.progress(0.9 + 0.1 * share, words)
        )

    def diagnosed(self) -> Diagnosis:
        """The verdict."""
        effects = self.effects  # a misspelt name is said before anything is traced
        self.progress(0.0, "the fit without more effects")
        ground = self.ground(self.fitted(self.model))
        means = Means(
            self.signatures, self.closely, self.in_shape, self._members_fit, self.ground, self.next_image,
            self.progress,
        )  # fmt: skip
        return diagnosed(ground, effects, means, seed=self.solver.seed)

    def held(self, found: Diagnosis) -> list[Held]:
        """Numbers of films that the data set holds and that would do what the best effect does."""
        first = found.steps[0]
        drops = [one.drop for one in first.explanations if one.plausible]
        if first.verdict.word == "nothing_visible":
            return []
        return held_alike(first.ground.fit, self.predictor, max(drops, default=0.0))

    def spec(self, name: str) -> EffectSpec:
        """An effect by name; InputError with what is near, or why these data cannot show it."""
        self.known.spec(name)
        found = next((one for one in self.effects if one.name == name), None)
        if found is None:
            reason = next(text for text in self.untested if text.startswith(f"{name}:"))
            raise InputError("EFFECT", name, "an effect that these data can show", reason)
        return found
