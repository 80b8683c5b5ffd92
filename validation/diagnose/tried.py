"""The short list of a round of a diagnosis: each effect added to the fit, the likely ones fitted to their end."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri  # scipy.stats takes half a second to import

from luxloop.effect import EffectSpec, Value
from validation.diagnose import held_out as held
from validation.diagnose.anew import total_chi2
from validation.diagnose.by_place import chance_by_place
from validation.diagnose.ending import beside, finished, is_stuck, unstuck
from validation.diagnose.evidence import group_log_evidence, log_evidence
from validation.diagnose.explanation import LEVEL, Explanation, follows_field
from validation.diagnose.frozen import slopes_of
from validation.diagnose.ground import Ground
from validation.diagnose.refit import acting_together, drop_of, expected, refit, whole_of
from validation.diagnose.refitted import Refitted, limits_of, of_members
from validation.diagnose.score import Candidate, EffectScore, Score, Scores
from validation.diagnose.verdict import ALIKE
from validation.effects.confounding import Confounding, left_beside
from validation.effects.known import is_smooth
from validation.fit import Fit
from validation.fit.whitening import held_scale

Real = NDArray[np.float64]
Progress = Callable[[float, str], None]
MembersFit = Callable[[Fit, EffectSpec], Fit | None]
"""The fit with an effect whose members are numbers of their own; None where workers cannot have it so."""
GroundOf = Callable[[Fit], Ground]
InShape = Callable[[Fit, EffectSpec, dict[str, Value]], list[Candidate]]
"""The columns of an effect at a fit, in one shape."""

SHORT_LIST = 8
MOST_ENDED, MOST_LED_OUT = 4, 2
"""Of the short list, that are fitted to their end, and out of a corner: three runs of Monte Carlo each."""
DOUBTFUL = 0.05
"""Chance of what a group leaves by its line, below which its members are fitted. It is told by the null of the fit
without it, and so many members leave less of noise than that has: below 0.05 in 2 % of made-up cases."""
WORTH = 0.3
"""Of the largest drop of chi2: what a refit that is stuck must reach to be fitted out of its corner."""
LEFT_OF_ALIKE, FOR_ALIKE = 0.6, 0.7
"""What is left of the best effect beside one that is alike; of what others must reach, what such a one must. About
the fit without either it may gain less by where that fit stands: of a lens out of focus a plate that scatters gained
103 of chi2, the blur itself 31."""


@dataclass(eq=False)
class Tried:
    """The short list of a round, fitted further and further: `refit` first, then `finish`."""

    ground: Ground
    in_shape: InShape
    columns: dict[str, Real]
    """Of each effect, those of its best shape; of one that was fitted to its end, of the shape that it has there."""
    short: list[EffectScore]
    refits: list[Refitted] = field(default_factory=list)
    explanations: list[Explanation] = field(default_factory=list)

    def refit(self, progress: Progress) -> None:
        """Each effect added to the fit; what is stuck in a corner, and worth it, out of it."""
        fit = self.ground.fit
        slopes = slopes_of(fit)
        for number, one in enumerate(self.short):
            progress(0.2 + 0.7 * number / len(self.short), f"adding {one.name}")
            self.refits.append(refit(fit, one.best, slopes))
            self.explanations.append(self._explained(number))
        by_drop = sorted(range(len(self.short)), key=lambda number: -self.explanations[number].drop)
        least = WORTH * self.explanations[by_drop[0]].drop if by_drop else 0.0
        for number in by_drop[:MOST_LED_OUT]:
            if is_stuck(self.refits[number], fit) and self.explanations[number].drop > least:
                progress(0.85, f"fitting {self.short[number].name}, out of the corner")
                self._keep(number, unstuck(self.refits[number], fit))

    def finish(self, progress: Progress) -> None:
        """What would be named is fitted to its end, with its near rivals, about the Monte Carlo that it ends with."""
        fit, ended = self.ground.fit, set[int]()
        while (likely := self._likeliest(ended)) is not None:
            progress(0.9, f"fitting {self.short[likely].name}")
            ended.add(likely)
            least = WORTH * self.explanations[likely].drop  # as the others are: where a fit ends it may gain more
            found = finished(self.refits[likely], fit.problem.predictor, fit.problem.predict_curves)
            self.short[likely] = as_fitted(self.short[likely], found, partial(self.in_shape, fit))
            self.columns[self.short[likely].name] = columns_of(fit, self.short[likely].best.candidate)
            self._keep(likely, found)
            for number in self._about_the_first(likely):
                one = self.explanations[number]
                if one.plausible and one.drop > least * self._wanted_of(number, likely):
                    progress(0.9, f"fitting {self.short[number].name} beside {self.short[likely].name}")
                    self._keep(number, beside(self.refits[number], found, fit))
        self._tell_apart()

    def look_into_group(self, members_fit: MembersFit, ground_of: GroundOf) -> None:
        """A group that lowers chi2 most by the fit of its members, where by its line it is in doubt.

        What it leaves is judged by a null of its own: so many free numbers take of noise, too.
        """
        best = self._likeliest(())
        if best is None or not self.refits[best].candidate.is_group:
            return
        if self.explanations[best].p_left >= DOUBTFUL and not self.explanations[best].distrust:
            return
        fit = members_fit(self.ground.fit, self.refits[best].candidate.effect)
        if fit is not None:
            self._keep(best, of_members(self.refits[best], fit))
            self.explanations[best] = replace(self.explanations[best], p_left=ground_of(fit).structure.p)

    def _about_the_first(self, likely: int) -> list[int]:
        """What else is fitted about the Monte Carlo of the fit without an effect, at its end or not."""
        base, fits = self.ground.fit.problem.anchor, [one.fit for one in self.refits]
        return [n for n, fit in enumerate(fits) if n != likely and fit is not None and fit.problem.anchor == base]

    def _tell_apart(self) -> None:
        """How far each is from its rivals, once all have the shape that they ended with."""
        rivals = [one.name for one in self.short]
        for number, (score, found) in enumerate(zip(self.short, self.refits, strict=True)):
            length, beside = _sigma(self.ground.fit, score, found, self.columns, rivals)
            self.explanations[number] = replace(self.explanations[number], sigma=length, sigma_rival=beside)

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
        near = [
            number
            for number in smooth
            if number not in ended and self._reach(number) > least * self._wanted_of(number, best)
        ]
        return max(near, key=self._reach, default=None) if len(ended) < MOST_ENDED else None

    def _wanted_of(self, number: int, best: int) -> float:
        """The share of what others must gain that one must: less where it looks like the best one."""
        own, left = self.explanations[best].sigma, self.explanations[best].sigma_rival
        alike = left.get(self.short[number].name, own) < LEFT_OF_ALIKE * own
        return FOR_ALIKE if alike else 1.0

    def _reach(self, number: int) -> float:
        """By how much chi2 would fall with an effect, at its fit's own word."""
        found = self.refits[number].fit
        return self.explanations[number].drop + (0.0 if found is None else found.gap)


def columns_of(fit: Fit, candidate: Candidate) -> Real:
    """Those of a candidate, then those of what acts together with it, less what the fit's own parameters do."""
    return np.concatenate([fit.basis.left(one.columns) for one in acting_together(fit, candidate)])


def short_list(base: Fit, scored: Scores, alike: Confounding) -> list[EffectScore]:
    """The best few, those that are nearly the same as the best one, and what is there or not.

    They are the best, and begun, by what they should bring beside a fit that lets go of its limits: what is missing
    may have driven it there, and scores keep it there. Of a switch the column is the whole way at the values of a fit
    without it, which may have gone far to make up for it: only a fit with it tells.
    """
    found = {one.name: promised(base, one.best) for one in scored.effects}
    brings = {name: drop for name, (drop, _) in found.items()}
    effects = [replace(one, best=replace(one.best, size=found[one.name][1])) for one in scored.effects]
    effects.sort(key=lambda one: -brings[one.name])
    best = [one for one in effects if brings[one.name] > 0.0][:SHORT_LIST]
    group = alike.group_of(best[0].name) if best else ()
    others = [one for one in effects if one not in best]
    near = [one for one in others if one.name in group and brings[one.name] > 0.0][:SHORT_LIST]
    return best + near + [one for one in others if one.best.candidate.is_switch and one not in near]


def of_all_or_each(base: Fit, one: EffectScore) -> EffectScore:
    """The score by the number of one sample, to be fitted with those of the others, where one number of all explains
    less than they do, by more than noise gives so many more."""
    if one.apart is None or one.best.candidate.sample:
        return one
    tried = [acting_together(base, score.candidate) for score in (one.best, one.apart)]
    of_all, of_each = (drop_of(base, some) for some in tried)
    more = max(len(tried[1]) - len(tried[0]), 1)
    return replace(one, best=one.apart) if of_each - of_all > chdtri(more, LEVEL / 2.0) else one


def promised(base: Fit, score: Score) -> tuple[float, float]:
    """By how much chi2 should fall with an effect, and its size: its score's, or more where a limit holds the fit, or
    where every sample has its own of it."""
    own = score.drop, score.size
    if score.candidate.sample and score.drop > 0.0:
        own = max(score.drop, drop_of(base, acting_together(base, score.candidate))), score.size
    return own if score.candidate.is_group or not base.at_limit else max(own, expected(base, score.candidate))


def as_fitted(
    score: EffectScore, found: Refitted, in_shape: Callable[[EffectSpec, dict[str, Value]], list[Candidate]]
) -> EffectScore:
    """The score with the column of the shape that the effect was fitted with, where that is another."""
    own = score.best.candidate
    shape = {name: value for name, value in found.shape if name in dict(own.shape)}
    if shape == dict(own.shape):
        return score
    other = next(one for one in in_shape(own.effect, shape) if one.parameter == own.parameter)
    return replace(score, best=replace(score.best, candidate=other, size=other.size(found.value)))


def _explanation(
    ground: Ground, score: EffectScore, found: Refitted, columns: dict[str, Real], rivals: Sequence[str]
) -> Explanation:
    candidate, base = score.best.candidate, ground.fit
    scale = held_scale(float(found.residual @ found.residual), base.freedom - 1.0)
    drop = total_chi2(base) - found.chi2
    length, beside = _sigma(base, score, found, columns, rivals)
    change, percents = _held_out(base, found, candidate.effect)
    by_place = _by_place(base, candidate) if candidate.is_group else None
    return Explanation(
        name=score.name,
        parameter=candidate.words,
        unit=candidate.parameter.unit,
        shape=found.shape,
        as_well=found.as_well,
        value=found.value,
        error=found.error,
        drop=drop,
        share=ground.loudest.share(found.residual, scale, same_noise=_about_one_anchor(base, found)),
        held_out=change,
        held_out_percent=percents,
        log_evidence=_log_evidence(ground, found, drop, columns[score.name]),
        plausible=not found.driven and drop > 0.0 and not follows_field(by_place),
        at_end=found.at_end,
        has_members=candidate.is_group,
        by_place=by_place,
        distrust=base.distrust if found.fit is None else found.fit.distrust,
        p_left=ground.judged(found.residual).p,
        sigma=length,
        sigma_rival=beside,
        numbers=found.numbers,
    )


def _sigma(
    base: Fit, score: EffectScore, found: Refitted, columns: dict[str, Real], rivals: Sequence[str]
) -> tuple[float, dict[str, float]]:
    """How long an effect's image is at its size, in standard deviations, and what is left of it beside each rival."""
    candidate = score.best.candidate
    if candidate.is_group:
        return float(np.sqrt(score.best.drop)), {}
    size = 1.0 if candidate.is_switch else candidate.size(found.value)
    own = whole_of(base, found, candidate) if found.candidate.others else size * columns[score.name][0]
    others = [rival for rival in rivals if rival != score.name]
    return float(np.linalg.norm(own)), {rival: left_beside(own, [columns[rival]]) for rival in others}


def _about_one_anchor(base: Fit, found: Refitted) -> bool:
    """Whether what is left has the base's noise of Monte Carlo."""
    return found.fit is None or found.fit.problem.anchor == base.problem.anchor


def _by_place(base: Fit, candidate: Candidate) -> float:
    """The chance that a group's members follow the field by chance (`chance_by_place`)."""
    samples = {image.sample.id: image.sample for image in base.problem.images}.values()
    grids = [(one.rows, one.columns) for one in samples if one.layout == "array" and one.rows * one.columns > 1]
    _, upper = limits_of(candidate.parameter)
    return chance_by_place(base.basis.left(candidate.columns), base.residual_with_priors, upper, grids)


def _log_evidence(ground: Ground, found: Refitted, drop: float, columns: Real) -> float | None:
    """None for a switch, which has no range, and where the size is not known."""
    candidate = found.candidate
    if candidate.is_switch or found.driven:
        return None
    if candidate.is_group:
        _, upper = limits_of(candidate.parameter)
        return group_log_evidence(columns @ ground.fit.residual_with_priors, columns @ columns.T, upper)
    tried = (candidate, *candidate.others)
    fit, values, covariance = found.fit, np.array([found.value]), np.array([[found.error**2]])
    if fit is not None:
        values, covariance = np.array([fit.value(path) for path in found.paths]), fit.covariance_of(found.paths)
    known = np.diag(covariance)
    if not np.all((known > 0.0) & np.isfinite(known)):
        return None
    return log_evidence(drop, values, covariance, [limits_of(one.parameter) for one in tried])


def _held_out(
    base: Fit, found: Refitted, effect: EffectSpec
) -> tuple[held.Change | None, tuple[float, float] | None]:
    """The change of the density in data left out, and the rms errors; None where a held-out test is not possible."""
    fit = found.beside_base
    if fit is None:
        return None, None
    folds = held.folds_of(base, effect.scope)
    if not folds:
        return None, None
    before, after = held.held_out(base, folds), held.held_out(fit, folds)
    return held.change(before, after), (before.percent_of(effect), after.percent_of(effect))
