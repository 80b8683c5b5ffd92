"""From a fit to a verdict: is there structure, which effect scores, what is explained when it is added, by how much.

    base fit -> structure, scores -> nothing visible?
             -> refits of the short list -> shares, held-out errors, rivals -> verdict
             -> the best one is kept and the next is looked for, while structure is left and it explains enough

Nothing here asks a worker: columns come from `Means.signatures`, refits from the fit's own predictor.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectSpec
from validation.diagnose import held_out as held
from validation.diagnose.evidence import group_log_evidence, log_evidence
from validation.diagnose.frozen import slopes_of
from validation.diagnose.ground import Ground
from validation.diagnose.in_words import left_in_words, limits_in_words
from validation.diagnose.refit import Refitted, beside, finished, is_stuck, limits_of, refit, unstuck
from validation.diagnose.score import Candidate, EffectScore, Projected, Scores, scores
from validation.diagnose.verdict import (
    ALIKE,
    LEVEL,
    Explanation,
    Verdict,
    decided,
    doubted,
    is_visible,
    not_trustworthy,
    nothing_visible,
)
from validation.effects.confounding import Confounding, confounding, left_beside
from validation.effects.known import is_smooth
from validation.fit import NOT_CONVERGED, Fit
from validation.fit.whitening import held_scale

Real = NDArray[np.float64]
Progress = Callable[[float, str], None]

SHORT_LIST = 8
MOST_ENDED = 4
"""Of the short list, that are fitted to their end."""
WORTH = 0.3
"""Of the largest drop of chi2: what a refit that is stuck must reach to be made anew."""
MOST_STEPS = 3
LITTLE = 0.02
"""Of chi2, that a fit without a missing effect may leave to be gained."""


@dataclass(frozen=True)
class Means:
    """What a diagnosis asks of whoever has the workers."""

    signatures: Callable[[Fit, Sequence[EffectSpec]], list[Candidate]]
    """The whitened columns of effects at a fit: for each parameter with an off value, in each of its shapes."""
    ground_of: Callable[[Fit], Ground]
    """The structure of a further fit, with a null of its own."""
    next_image: Callable[[Fit, Sequence[Refitted]], str]
    """In words, the measurement that would tell rivals apart, the best of them first."""
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

    @property
    def best(self) -> Explanation:
        """The explanation that the verdict names first."""
        return next(one for one in self.explanations if one.name == self.verdict.set[0])

    @property
    def kept(self) -> Refitted | None:
        """The refit of the effect that the verdict names first; None where it names none."""
        return next((one for one in self.refits if one.candidate.effect.name in self.verdict.set[:1]), None)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """All rounds; the first one's verdict is the verdict."""

    steps: tuple[Step, ...]
    known: int
    """Effects that there are."""

    @property
    def verdict(self) -> Verdict:
        """Of the first round; a second effect that was found besides is told after it."""
        first = self.steps[0].verdict
        if len(self.added) == 1 and self.added[0].distrust:
            return doubted(self.added[0])
        if len(self.added) < 2:
            return first
        further = ", ".join(f"{one.name} ({one.size})" for one in self.added[1:])
        return replace(first, sentence=f"{first.sentence} What it leaves is explained by {further}.")

    @property
    def added(self) -> list[Explanation]:
        """The effect of each round that was kept, and of the last one where it explains what is left."""
        return [step.best for step in self.steps if step.verdict.word in ("one_effect", "cannot_tell_apart")]


def diagnosed(
    ground: Ground, effects: Sequence[EffectSpec], means: Means, *, seed: int = 1, level: float = LEVEL
) -> Diagnosis:
    """The rounds of a diagnosis; effects that the model has are not tried again."""
    steps: list[Step] = []
    while len(steps) < MOST_STEPS:
        present = {one.name for one in ground.fit.model.effects}
        step = _step(ground, [one for one in effects if one.name not in present], means, seed, level)
        steps.append(step)
        kept = step.kept
        if kept is None or kept.fit is None or step.best.p_left >= level / 2.0:
            break
        ground = means.ground_of(kept.fit)
    return Diagnosis(tuple(trusted(steps)), len(effects))


def trusted(steps: Sequence[Step]) -> list[Step]:
    """The rounds without the last ones that name nothing, or nothing to be trusted: the ones before stand."""
    found = list(steps)
    while len(found) > 1 and (found[-1].kept is None or found[-1].best.distrust):
        found.pop()
    return found


def _step(ground: Ground, effects: Sequence[EffectSpec], means: Means, seed: int, level: float) -> Step:
    fit = ground.fit
    if doubts := beyond_limits(fit):
        nobody = Confounding((), np.zeros((0, 0)))
        return Step(ground, Scores((), 1.0, 0, ()), nobody, (), (), not_trustworthy(doubts))
    means.progress(0.1, "signatures of the effects")
    projected = Projected.of(means.signatures(fit, effects), ground.projection)
    scored = scores(projected, fit.residual, fit.variance_scale, seed=seed)
    best = {one.name: projected.own(one.best.candidate) for one in scored.effects}
    alike = confounding(best)
    if not is_visible(ground.structure.p, scored.p, level):
        verdict = not_trustworthy(fit.distrust) if fit.distrust else nothing_visible(limits_in_words(scored, level))
        return Step(ground, scored, alike, (), (), verdict)
    tried = _Tried(ground, projected, best, short_list(scored, alike))
    tried.refit(means.progress)
    tried.finish(means.progress)

    def next_image(names: Sequence[str]) -> str:
        by_name = {one.candidate.effect.name: one for one in tried.refits}
        return means.next_image(fit, [by_name[name] for name in names])

    verdict = decided(tried.explanations, len(effects), lambda: left_in_words(ground), next_image, level)
    return Step(ground, scored, alike, tuple(tried.refits), tuple(tried.explanations), verdict)


@dataclass(eq=False)
class _Tried:
    """The short list of a round, fitted further and further."""

    ground: Ground
    projected: Projected
    columns: dict[str, Real]
    """Of each effect, those of its best shape."""
    short: list[EffectScore]
    refits: list[Refitted] = field(default_factory=list)
    explanations: list[Explanation] = field(default_factory=list)

    def refit(self, progress: Progress) -> None:
        """Each effect added to the fit; what is stuck there, and worth it, from where the model began."""
        fit = self.ground.fit
        slopes = slopes_of(fit)
        for number, one in enumerate(self.short):
            progress(0.2 + 0.7 * number / len(self.short), f"adding {one.name}")
            self.refits.append(refit(fit, one.best, slopes))
            self.explanations.append(self._explained(number))
        most = max((one.drop for one in self.explanations), default=0.0)
        for number, one in enumerate(self.short):
            if is_stuck(self.refits[number], fit) and self.explanations[number].drop > WORTH * most:
                progress(0.85, f"fitting {one.name}, from where the model began")
                self._keep(number, unstuck(self.refits[number], fit))

    def finish(self, progress: Progress) -> None:
        """What would be named is fitted to its end, with its near rivals, about the Monte Carlo that it ends with."""
        fit, ended = self.ground.fit, set[int]()
        while (likely := self._likeliest(ended)) is not None:
            progress(0.9, f"fitting {self.short[likely].name}")
            ended.add(likely)
            found = finished(self.refits[likely], fit.problem.predictor, fit.problem.predict_curves)
            self.short[likely] = as_fitted(self.projected, self.short[likely], found)
            self.columns[self.short[likely].name] = self.projected.own(self.short[likely].best.candidate)
            self._keep(likely, found)
            least = WORTH * self.explanations[likely].drop
            for number in sorted(set(range(len(self.short))) - ended):
                if self.explanations[number].plausible and self.explanations[number].drop > least:
                    progress(0.9, f"fitting {self.short[number].name} beside {self.short[likely].name}")
                    self._keep(number, beside(self.refits[number], found, fit))

    def _keep(self, number: int, found: Refitted) -> None:
        self.refits[number] = found
        self.explanations[number] = self._explained(number)

    def _explained(self, number: int) -> Explanation:
        rivals = [other.name for other in self.short]
        return _explanation(self.ground, self.short[number], self.refits[number], self.columns, rivals)

    def _likeliest(self, ended: Collection[int]) -> int | None:
        """The number of the one that a verdict would name; once it has ended, of one that may yet take its place.

        By what its own derivatives still promise, if that is 0.8 of the best's. Those that the twin cannot represent
        are fitted to their end by minutes of Monte Carlo, and only where they are named.
        """
        usable = [number for number, one in enumerate(self.explanations) if one.plausible]
        best = max(usable, key=lambda number: self.explanations[number].drop, default=None)
        if best is None or best not in ended:
            return best
        least = (1.0 - 2.0 * ALIKE) * self.explanations[best].drop
        smooth = [number for number in usable if is_smooth(self.refits[number].candidate.effect)]
        near = [number for number in smooth if number not in ended and self._reach(number) > least]
        return max(near, key=self._reach, default=None) if len(ended) < MOST_ENDED else None

    def _reach(self, number: int) -> float:
        """By how much chi2 would fall with an effect, at its fit's own word."""
        found = self.refits[number].fit
        return self.explanations[number].drop + (0.0 if found is None else found.gap)


def beyond_limits(fit: Fit) -> list[str]:
    """Why a fit may not be trusted, but for what a missing effect does to it.

    It drives parameters to their limits, and leaves a bent valley in which the last steps gain little.
    """
    excused = tuple(f"{name} is at" for name in fit.at_limit)
    excused += (NOT_CONVERGED,) if fit.gap < LITTLE * fit.chi2 else ()
    return [reason for reason in fit.distrust if not reason.startswith(excused)] if excused else [*fit.distrust]


def short_list(scored: Scores, alike: Confounding) -> list[EffectScore]:
    """The best few, those that are nearly the same as the best one, and what is there or not.

    Of a switch the column is the whole way at the values of a fit without it, which may have gone far to make up for
    it: only a fit with it tells.
    """
    best = [one for one in scored.effects if one.best.drop > 0.0][:SHORT_LIST]
    group = alike.group_of(best[0].name) if best else ()
    others = [one for one in scored.effects if one not in best]
    near = [one for one in others if one.name in group and one.best.drop > 0.0][:SHORT_LIST]
    return best + near + [one for one in others if one.best.candidate.is_switch and one not in near]


def as_fitted(projected: Projected, score: EffectScore, found: Refitted) -> EffectScore:
    """The score with the column of the words that the effect was fitted with, where those are others."""
    words = {(name, value) for name, value in found.shape if isinstance(value, str)}
    own = score.best.candidate
    if words <= set(own.shape):
        return score
    same = (one for one in projected.candidates if (one.effect, one.parameter) == (own.effect, own.parameter))
    other = next((one for one in same if words <= set(one.shape)), own)
    return replace(score, best=replace(score.best, candidate=other, size=other.size(found.value)))


def _explanation(
    ground: Ground, score: EffectScore, found: Refitted, columns: dict[str, Real], rivals: Sequence[str]
) -> Explanation:
    candidate, base = score.best.candidate, ground.fit
    scale = held_scale(float(found.residual @ found.residual), base.freedom - 1.0)
    drop = base.chi2 + base.reduced.chi2_prior - found.chi2
    length, beside = float(np.sqrt(score.best.drop)), {}
    if not candidate.is_group:
        own, size = columns[score.name][0], 1.0 if candidate.is_switch else score.best.size
        length = abs(size) * float(np.linalg.norm(own))
        others = [rival for rival in rivals if rival != score.name]
        beside = {rival: abs(size) * left_beside(own, [columns[rival]]) for rival in others}
    change, percents = _held_out(base, found, candidate.effect)
    return Explanation(
        name=score.name,
        parameter=candidate.parameter.name,
        unit=candidate.parameter.unit,
        shape=found.shape,
        as_well=found.as_well,
        value=found.value,
        error=found.error,
        drop=drop,
        share=ground.loudest.share(found.residual, scale),
        held_out=change,
        held_out_percent=percents,
        log_evidence=_log_evidence(ground, found, drop, columns[score.name]),
        plausible=not found.at_limit and drop > 0.0,
        distrust=found.fit.distrust if found.fit is not None else base.distrust,
        p_left=ground.judged(found.residual).p,
        sigma=length,
        sigma_rival=beside,
    )


def _log_evidence(ground: Ground, found: Refitted, drop: float, columns: Real) -> float | None:
    """None for a switch, which has no range, and where the size is not known."""
    candidate = found.candidate
    if candidate.is_switch or found.at_limit:
        return None
    lower, upper = limits_of(candidate.parameter)
    if candidate.is_group:
        return group_log_evidence(columns @ ground.fit.residual, columns @ columns.T, upper)
    return log_evidence(drop, found.error, lower, upper) if 0.0 < found.error < np.inf else None


def _held_out(
    base: Fit, found: Refitted, effect: EffectSpec
) -> tuple[held.Change | None, tuple[float, float] | None]:
    """The change of the density in data left out, and the rms errors; None where a held-out test is not possible."""
    if found.fit is None or not held.same_rows(base, found.fit):
        return None, None
    folds = held.folds_of(base, effect.scope)
    if not folds:
        return None, None
    before, after = held.held_out(base, folds), held.held_out(found.fit, folds)
    return held.change(before, after), (before.rms_percent, after.rms_percent)
