"""From a fit to a verdict: is there structure, which effect scores, what is explained when it is added, by how much.

    base fit -> structure, scores -> nothing visible?
             -> refits of the short list -> shares, held-out errors, rivals -> verdict
             -> the best one is kept and the next is looked for, while structure is left and it explains enough
             -> where it explains too little alone: with another one, if the two leave nothing

Nothing here asks a worker: columns come from `Means.signatures`, refits from the fit's own predictor.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from luxloop.effect import EffectSpec
from validation.diagnose.explanation import LEVEL
from validation.diagnose.ground import Ground
from validation.diagnose.in_words import left_in_words, limits_in_words, more_in_words
from validation.diagnose.next_measurement import image_can_tell, left_out_of
from validation.diagnose.proposal import Proposal, next_in_words
from validation.diagnose.refitted import Refitted
from validation.diagnose.rounds import Diagnosis, Step, is_the_rest, trusted
from validation.diagnose.score import Candidate, Projected, Scores, scores
from validation.diagnose.tried import (
    GroundOf,
    InShape,
    MembersFit,
    Progress,
    Tried,
    columns_of,
    of_all_or_each,
    short_list,
)
from validation.diagnose.verdict import Verdict, decided, is_visible, not_trustworthy, nothing_visible
from validation.effects.confounding import Confounding, confounding
from validation.fit import AT_LIMIT, NOT_CONVERGED, Fit

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
    in_shape: InShape
    members_fit: MembersFit
    ground_of: GroundOf
    """The structure of a further fit, with a null of its own."""
    next_image: Callable[[Fit, Sequence[Refitted]], list[Proposal]]
    """Measurements that would tell rivals apart, the best of them first."""
    progress: Progress = lambda *_: None


def diagnosed(ground: Ground, effects: Sequence[EffectSpec], means: Means, *, seed: int = 1) -> Diagnosis:
    """The rounds of a diagnosis; effects that the model has are not tried again."""
    before = {one.name for one in ground.fit.model.effects}

    def step_on(ground: Ground) -> Step:
        present = {one.name for one in ground.fit.model.effects}
        return _step(ground, _open(effects, present, present - before), means, seed)

    steps: list[Step] = []
    while True:
        step = step_on(ground)
        steps.append(step)
        fit = step.leads_to
        if fit is None or step.best.p_left >= LEVEL / 2.0 or len(steps) == MOST_STEPS:
            break
        ground = means.ground_of(fit)
    part = _as_part(steps[0])
    if part is not None and part.leads_to is not None:
        rest = step_on(means.ground_of(part.leads_to))
        steps = [part, rest] if is_the_rest(part, rest) else steps
    first, *further = trusted(steps)
    is_open = first is part or first.verdict.word == "cannot_tell_apart"
    if further and is_open and is_the_rest(first, further[-1]):
        beside = tuple(one.best.name for one in further)
        verdict, proposals = _verdict_on(first, first.scores.tested, means, beside)
        first = replace(first, verdict=verdict, proposals=proposals, beside=beside)
    return Diagnosis((first, *further), first.scores.tested or len(effects))


def _open(effects: Sequence[EffectSpec], present: Collection[str], added: Collection[str]) -> list[EffectSpec]:
    """Those that a model does not have; nor what says the same in another way as an effect that a round added."""
    gone = set(present).union(*(one.excludes for one in effects if one.name in added))
    return [one for one in effects if one.name not in gone and not set(added) & set(one.excludes)]


def _as_part(step: Step) -> Step | None:
    """The round with the effect that explains most named, where it explains too little to be named alone."""
    if step.verdict.names or not step.explanations:
        return None
    return replace(step, verdict=decided(step.explanations, step.scores.tested, str, lambda _: "", beside=()))


def _verdict_on(
    tried: Tried | Step, known: int, means: Means, beside: Collection[str] | None = None
) -> tuple[Verdict, tuple[Proposal, ...]]:
    """The verdict on what was tried in a round, and the measurements that it asks for."""
    proposals: list[Proposal] = []
    fit = tried.ground.fit

    def next_image(names: Sequence[str]) -> str:
        by_name = {one.candidate.effect.name: one for one in tried.refits}
        rivals = [by_name[name] for name in names]
        proposals[:] = means.next_image(fit, rivals)
        told = image_can_tell(fit.problem.images, [one.candidate.effect for one in rivals])
        return next_in_words(proposals, left_out_of(rivals), images=told)

    left = partial(left_in_words, tried.ground, tried.explanations)
    verdict = decided(tried.explanations, known, left, next_image, beside=beside)
    return verdict, tuple(proposals)


def _step(ground: Ground, effects: Sequence[EffectSpec], means: Means, seed: int) -> Step:
    fit = ground.fit
    if doubts := beyond_limits(fit):
        nobody = Confounding((), np.zeros((0, 0)))
        return Step(ground, Scores((), 1.0, 0, ()), nobody, (), (), not_trustworthy(doubts))
    means.progress(0.1, "signatures of the effects")
    candidates = means.signatures(fit, effects)
    scored = _scored(ground, candidates, seed)
    if is_visible(ground.structure.p, scored.p) and (faint := blurred(scored)):
        means.progress(0.18, "signatures by more Monte Carlo")
        closer = means.closely(fit, [one for one in effects if one.name in faint])
        candidates = [one for one in candidates if one.effect.name not in faint] + closer
        scored = _scored(ground, candidates, seed)
    chosen = replace(scored, effects=tuple(of_all_or_each(fit, one) for one in scored.effects))
    best = {one.name: columns_of(fit, one.best.candidate) for one in chosen.effects}
    alike = confounding(best)
    if not is_visible(ground.structure.p, scored.p):
        nothing = nothing_visible(limits_in_words(scored), more_in_words(fit))
        verdict = not_trustworthy(fit.distrust) if fit.distrust else nothing
        return Step(ground, scored, alike, (), (), verdict)
    tried = Tried(ground, means.in_shape, best, short_list(fit, chosen, alike))
    tried.refit(means.progress)
    tried.finish(means.progress)
    tried.look_into_group(means.members_fit, means.ground_of)
    verdict, proposals = _verdict_on(tried, scored.tested, means)
    return Step(ground, scored, alike, tuple(tried.refits), tuple(tried.explanations), verdict, proposals)


def _scored(ground: Ground, candidates: Sequence[Candidate], seed: int) -> Scores:
    projected = Projected.of(candidates, ground.fit.basis)
    return scores(projected, ground.fit.residual_with_priors, ground.fit.variance_scale, seed=seed)


def blurred(scored: Scores) -> set[str]:
    """Names of effects whose columns are Monte Carlo's, with noise that may be why others score better.

    A column that agrees with the true one by r shows r^2 of its drop, and r^2 of its size.
    """
    most = max((one.largest.drop for one in scored.effects), default=0.0)
    noisy = [one for one in scored.effects if not one.best.candidate.effect.twin]
    return {one.name for one in noisy if one.largest.drop > LEAST_SEEN * most > 0.0}


def beyond_limits(fit: Fit) -> list[str]:
    """Why a fit may not be trusted, but for what a missing effect does to it.

    It drives parameters to their limits, and leaves a bent valley in which the last steps gain little.
    """
    excused = tuple(f"{name}{AT_LIMIT}" for name in fit.at_limit)
    excused += (NOT_CONVERGED,) if fit.gap < LITTLE * fit.chi2 else ()
    return [reason for reason in fit.distrust if not reason.startswith(excused)] if excused else [*fit.distrust]
