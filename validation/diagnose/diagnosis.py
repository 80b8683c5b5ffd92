"""From a fit to a verdict: is there structure, which effect scores, what is explained when it is added, by how much.

    base fit -> structure, scores -> nothing visible?
             -> refits of the short list -> shares, held-out errors, rivals -> verdict
             -> the best one is kept and the next is looked for, while structure is left and it explains enough

Nothing here asks a worker: columns come from `Means.signatures`, refits from the fit's own predictor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from luxloop.effect import EffectSpec
from validation.diagnose.explanation import LEVEL, Explanation
from validation.diagnose.ground import Ground
from validation.diagnose.in_words import left_in_words, limits_in_words, more_in_words
from validation.diagnose.next_measurement import Proposal, next_in_words
from validation.diagnose.refit import Refitted
from validation.diagnose.score import Candidate, Projected, Scores, scores
from validation.diagnose.tried import GroundOf, MembersFit, Progress, Tried, columns_of, short_list
from validation.diagnose.verdict import (
    HALF,
    Verdict,
    concluded,
    decided,
    is_visible,
    not_trustworthy,
    nothing_visible,
)
from validation.effects.confounding import Confounding, confounding
from validation.fit import NOT_CONVERGED, Fit

MOST_STEPS = 3
LEAST_SEEN = 0.25
"""Of the largest drop of chi2: what noise may leave of the true effect's (walls: columns agreed by 0.5 to 0.7)."""
LITTLE = 0.02
"""Of chi2, that a fit without a missing effect may leave to be gained."""


@dataclass(frozen=True)
class Means:
    """What a diagnosis asks of whoever has the workers."""

    signatures: Callable[[Fit, Sequence[EffectSpec]], list[Candidate]]
    """The whitened columns of effects at a fit: for each parameter with an off value, in each of its shapes."""
    closely: Callable[[Fit, Sequence[EffectSpec]], list[Candidate]]
    """The same of effects that only Monte Carlo shows, with less of its noise."""
    members_fit: MembersFit
    ground_of: GroundOf
    """The structure of a further fit, with a null of its own."""
    next_image: Callable[[Fit, Sequence[Refitted]], list[Proposal]]
    """Measurements that would tell rivals apart, the best of them first."""
    progress: Progress = lambda *_: None


@dataclass(frozen=True, eq=False)
class Step:
    """One round: what scored on a fit, what each of the short list came to."""

    ground: Ground
    scores: Scores
    confounding: Confounding
    refits: tuple[Refitted, ...]
    explanations: tuple[Explanation, ...]
    verdict: Verdict
    proposals: tuple[Proposal, ...] = ()
    """Where it cannot tell effects apart: the measurements that would."""

    @property
    def best(self) -> Explanation:
        """The explanation that the verdict names first."""
        return next(one for one in self.explanations if one.name == self.verdict.set[0])

    @property
    def kept(self) -> Refitted | None:
        """The refit of the effect that the verdict names first; None where it names none."""
        return next((one for one in self.refits if one.candidate.effect.name in self.verdict.set[:1]), None)

    @property
    def leads_to(self) -> Fit | None:
        """The fit beside which another effect can be looked for; None without one, or of a group by a line."""
        return None if self.kept is None else self.kept.fit


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """All rounds; the first one's verdict is the verdict."""

    steps: tuple[Step, ...]
    known: int
    """Effects that there are."""

    @property
    def verdict(self) -> Verdict:
        """Of the first round; a second effect that was found besides is told after it."""
        first, added, ground = self.steps[0].verdict, self.added, self.steps[0].ground
        only = added[0] if len(added) == 1 else None
        shares = [one.share for one in added] if self.steps[-1].leads_to is not None else []
        p_left = added[-1].p_left if added else 1.0
        found = concluded(
            first, only, shares, p_left, self.known, lambda: left_in_words(ground, self.steps[0].explanations)
        )
        if len(added) < 2 or found is not first:
            return found
        further = ", ".join(f"{one.name} ({one.size})" for one in added[1:])
        return replace(first, sentence=f"{first.sentence} What it leaves is explained by {further}.")

    @property
    def added(self) -> list[Explanation]:
        """The effect of each round that was kept, and of the last one where it explains what is left."""
        return [step.best for step in self.steps if step.verdict.names]

    @property
    def set(self) -> tuple[str, ...]:
        """Names of the effects that the verdict speaks of."""
        return self.steps[0].verdict.set if self.verdict.names else ()

    @property
    def proposals(self) -> tuple[Proposal, ...]:
        """The measurements that the last round which could not tell effects apart asks for."""
        asked = [step.proposals for step in self.steps if step.verdict.word == "cannot_tell_apart"]
        return asked[-1] if asked and self.verdict.names else ()


def diagnosed(
    ground: Ground, effects: Sequence[EffectSpec], means: Means, *, seed: int = 1, level: float = LEVEL
) -> Diagnosis:
    """The rounds of a diagnosis; effects that the model has are not tried again."""
    steps: list[Step] = []
    while len(steps) < MOST_STEPS:
        present = {one.name for one in ground.fit.model.effects}
        step = _step(ground, [one for one in effects if one.name not in present], means, seed, level)
        steps.append(step)
        fit = step.leads_to
        if fit is None or step.best.p_left >= level / 2.0:
            break
        ground = means.ground_of(fit)
    return Diagnosis(tuple(trusted(steps)), len(effects))


def trusted(steps: Sequence[Step]) -> list[Step]:
    """The rounds without the last ones that name nothing, or nothing to be trusted: the ones before stand.

    So does what leaves structure and explains less than half of what was there, or is a group of many members: as a
    second effect it is a guess.
    """
    found = list(steps)
    while len(found) > 1 and (found[-1].kept is None or found[-1].best.distrust or is_a_guess(found[-1].best)):
        found.pop()
    return found


def is_a_guess(best: Explanation, level: float = LEVEL) -> bool:
    """Whether an effect explains less than half, or is a group, and leaves structure."""
    return (best.share.value < HALF or best.has_members) and best.p_left < level / 2.0


def _step(ground: Ground, effects: Sequence[EffectSpec], means: Means, seed: int, level: float) -> Step:
    fit = ground.fit
    if doubts := beyond_limits(fit):
        nobody = Confounding((), np.zeros((0, 0)))
        return Step(ground, Scores((), 1.0, 0, ()), nobody, (), (), not_trustworthy(doubts))
    means.progress(0.1, "signatures of the effects")
    candidates = means.signatures(fit, effects)
    projected, scored = _scored(ground, candidates, seed)
    visible = is_visible(ground.structure.p, scored.p, level)
    if visible and (faint := blurred(scored)):
        means.progress(0.18, "signatures by more Monte Carlo")
        closer = means.closely(fit, [one for one in effects if one.name in faint])
        candidates = [one for one in candidates if one.effect.name not in faint] + closer
        projected, scored = _scored(ground, candidates, seed)
    best = {one.name: columns_of(fit, projected, one.best.candidate) for one in scored.effects}
    alike = confounding(best)
    if not visible:
        nothing = nothing_visible(limits_in_words(scored, level), more_in_words(fit))
        verdict = not_trustworthy(fit.distrust) if fit.distrust else nothing
        return Step(ground, scored, alike, (), (), verdict)
    tried = Tried(ground, projected, best, short_list(scored, alike))
    tried.refit(means.progress)
    tried.finish(means.progress)
    tried.look_into_group(means.members_fit, means.ground_of)

    proposals: list[Proposal] = []

    def next_image(names: Sequence[str]) -> str:
        by_name = {one.candidate.effect.name: one for one in tried.refits}
        proposals[:] = means.next_image(fit, [by_name[name] for name in names])
        return next_in_words(proposals, images=bool(fit.problem.images))

    verdict = decided(
        tried.explanations, len(effects), lambda: left_in_words(ground, tried.explanations), next_image, level
    )
    refits, explanations = tuple(tried.refits), tuple(tried.explanations)
    return Step(ground, scored, alike, refits, explanations, verdict, tuple(proposals))


def _scored(ground: Ground, candidates: Sequence[Candidate], seed: int) -> tuple[Projected, Scores]:
    projected = Projected.of(candidates, ground.projection)
    return projected, scores(projected, ground.fit.residual, ground.fit.variance_scale, seed=seed)


def blurred(scored: Scores) -> set[str]:
    """Names of effects whose columns are Monte Carlo's, with noise that may be why others score better.

    A column that agrees with the true one by r shows r^2 of its drop, and r^2 of its size.
    """
    most = max((one.best.drop for one in scored.effects), default=0.0)
    noisy = [one for one in scored.effects if not one.best.candidate.effect.twin]
    return {one.name for one in noisy if one.best.drop > LEAST_SEEN * most > 0.0}


def beyond_limits(fit: Fit) -> list[str]:
    """Why a fit may not be trusted, but for what a missing effect does to it.

    It drives parameters to their limits, and leaves a bent valley in which the last steps gain little.
    """
    excused = tuple(f"{name} is at" for name in fit.at_limit)
    excused += (NOT_CONVERGED,) if fit.gap < LITTLE * fit.chi2 else ()
    return [reason for reason in fit.distrust if not reason.startswith(excused)] if excused else [*fit.distrust]
