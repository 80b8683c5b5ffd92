"""From a fit to a verdict: is there structure, which effect scores, what is explained when it is added, by how much.

    base fit -> structure, scores -> nothing visible?
             -> refits of the short list -> shares, held-out errors, rivals -> verdict
             -> the best one is kept and the next is looked for, while structure is left and it explains enough

Nothing here asks a worker: columns come from `signatures`, refits from the fit's own predictor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from luxloop.effect import EffectSpec
from validation.contrasts import Region
from validation.contrasts.null import Null, Projection, Variances
from validation.contrasts.structure import Structure, judged
from validation.diagnose import held_out as held
from validation.diagnose.evidence import log_evidence
from validation.diagnose.explained import Loudest
from validation.diagnose.frozen import slopes_of
from validation.diagnose.refit import Refitted, finished, limits_of, refit
from validation.diagnose.score import Candidate, EffectScore, Projected, Scores, scores
from validation.diagnose.verdict import (
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
from validation.fit import Fit
from validation.fit.whitening import variance_scale

Real = NDArray[np.float64]
Signatures = Callable[[Fit, Sequence[EffectSpec]], list[Candidate]]
"""The whitened columns of effects at a fit: for each parameter with an off value, in each of its shapes."""
Progress = Callable[[float, str], None]

SHORT_LIST = 5
MOST_STEPS = 3
POWER = 0.9


@dataclass(frozen=True, eq=False)
class Ground:
    """The fit that effects are added to, its structure, and the null that judges all that follow."""

    fit: Fit
    structure: Structure
    null: Null
    projection: Projection
    variances: Variances

    @property
    def loudest(self) -> Loudest:
        """Its largest family."""
        family = self.structure.families[0]
        return Loudest(
            self.null.layout, self.variances.weight, family.name, family.expected, family.freedom, family.energy
        )

    def judged(self, residual: Real) -> Structure:
        """The structure in another residual, by the same contrasts and the same null."""
        return judged(residual, self.null.layout, self.projection, self.variances, self.null)


@dataclass(frozen=True, eq=False)
class Step:
    """One round: what scored on a fit, what each of the short list came to."""

    ground: Ground
    scores: Scores
    confounding: Confounding
    refits: tuple[Refitted, ...]
    explanations: tuple[Explanation, ...]
    verdict: Verdict


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
        if self.added and self.added[-1].distrust:
            return doubted(self.added[-1])
        if len(self.added) < 2:
            return first
        further = ", ".join(f"{one.name} ({one.size})" for one in self.added[1:])
        return replace(first, sentence=f"{first.sentence} What it leaves is explained by {further}.")

    @property
    def added(self) -> list[Explanation]:
        """The effect of each round that was kept, and of the last one where it explains what is left."""
        kept = [step for step in self.steps if step.verdict.word in ("one_effect", "cannot_tell_apart")]
        return [best_of(step) for step in kept]


def diagnosed(
    ground: Ground,
    effects: Sequence[EffectSpec],
    signatures: Signatures,
    ground_of: Callable[[Fit], Ground],
    next_image: Callable[[Step, Sequence[str]], str],
    *,
    seed: int = 1,
    level: float = LEVEL,
    progress: Progress = lambda *_: None,
) -> Diagnosis:
    """The rounds of a diagnosis.

    Parameters
    ----------
    ground_of : the structure of a further fit, with a null of its own.
    next_image : in words, the measurement that would tell these rivals apart.
    """
    steps: list[Step] = []
    while len(steps) < MOST_STEPS:
        added = {
            path.split(".")[1] for path in ground.fit.problem.unknowns.model_paths if path.startswith("effects.")
        }
        tried = [one for one in effects if one.name not in added]
        step = _step(ground, tried, signatures, next_image, seed, level, progress)
        steps.append(step)
        best = next((one for one in step.refits if one.candidate.effect.name in step.verdict.set[:1]), None)
        if best is None or best.fit is None or best_of(step).p_left >= level / 2.0:
            break
        problem = ground.fit.problem
        ground = ground_of(finished(best, problem.predictor, problem.predict_curves).fit or best.fit)
    if len(steps) > 1 and steps[-1].verdict.word in ("nothing_visible", "none_of_the_known", "fit_not_trustworthy"):
        steps.pop()  # what the last one kept is all that can be named
    return Diagnosis(tuple(steps), len(effects))


def best_of(step: Step) -> Explanation:
    """The explanation that a round's verdict names first."""
    return next(one for one in step.explanations if one.name == step.verdict.set[0])


def _step(
    ground: Ground,
    effects: Sequence[EffectSpec],
    signatures: Signatures,
    next_image: Callable[[Step, Sequence[str]], str],
    seed: int,
    level: float,
    progress: Progress,
) -> Step:
    nothing = Scores((), 1.0, 0, ())
    nobody = Confounding((), np.zeros((0, 0)))
    doubts = beyond_limits(ground.fit)
    if doubts:
        return Step(ground, nothing, nobody, (), (), not_trustworthy(doubts))
    progress(0.1, "signatures of the effects")
    candidates = signatures(ground.fit, effects)
    projected = Projected.of(candidates, ground.projection)
    scored = scores(projected, ground.fit.residual, ground.fit.variance_scale, seed=seed)
    best = {one.name: _columns_of(projected, one.best.candidate) for one in scored.effects}
    alike = confounding(best)
    if not is_visible(ground.structure.p, scored.p, level):
        if ground.fit.distrust:
            return Step(ground, scored, alike, (), (), not_trustworthy(ground.fit.distrust))
        return Step(ground, scored, alike, (), (), nothing_visible(limits_in_words(scored, level)))
    short = short_list(scored, alike)
    refits, explanations, slopes = [], [], slopes_of(ground.fit)
    for number, one in enumerate(short):
        progress(0.2 + 0.7 * number / len(short), f"adding {one.name}")
        found = refit(ground.fit, one.best, slopes)
        refits.append(found)
        explanations.append(_explanation(ground, one, found, best, [other.name for other in short]))
    step = Step(ground, scored, alike, tuple(refits), tuple(explanations), nothing_visible(()))
    step = replace(step, verdict=decided(explanations, len(effects), "", "", level))
    if step.verdict.word == "cannot_tell_apart":
        step = replace(
            step, verdict=decided(explanations, len(effects), "", next_image(step, step.verdict.set), level)
        )
    elif step.verdict.word == "none_of_the_known":
        step = replace(step, verdict=decided(explanations, len(effects), left_in_words(ground), "", level))
    return step


def beyond_limits(fit: Fit) -> list[str]:
    """Why a fit may not be trusted, but for parameters at their limits: a missing effect drives them there."""
    return [reason for reason in fit.distrust if not any(reason.startswith(f"{name} is at") for name in fit.at_limit)]


def short_list(scored: Scores, alike: Confounding) -> list[EffectScore]:
    """The best few, and those that are nearly the same as the best one."""
    best = [one for one in scored.effects if one.best.drop > 0.0][:SHORT_LIST]
    if not best:
        return []
    group = alike.group_of(best[0].name)
    return (
        best + [one for one in scored.effects[SHORT_LIST:] if one.name in group and one.best.drop > 0.0][:SHORT_LIST]
    )


def limits_in_words(scored: Scores, level: float = LEVEL) -> list[str]:
    """Above which size an effect would have been seen with 90 % power, the most visible first."""
    return [f"{name} {value:.2g} {unit}".rstrip() for name, _, value, unit in limits(scored, level)]


def limits(scored: Scores, level: float = LEVEL) -> list[tuple[str, str, float, str]]:
    """(effect, parameter, value, unit) of the size that is seen with 90 % power, of all that can be tested."""
    count = max(len(scored.effects), 1)
    wanted = float(norm.isf(level / 4.0 / count) + norm.isf(1.0 - POWER))
    found = []
    for one in scored.effects:
        candidate = one.best.candidate
        if candidate.is_switch or candidate.is_group:
            continue
        lower, upper = limits_of(candidate.parameter)
        off = candidate.parameter.off if isinstance(candidate.parameter.off, float) else 0.0
        value = abs(candidate.value(wanted * one.best.error) - off)
        if value <= max(upper - off, off - lower):
            found.append(
                (value / (upper - lower), one.name, candidate.parameter.name, value, candidate.parameter.unit)
            )
    return [entry[1:] for entry in sorted(found)]


def left_in_words(ground: Ground, most: int = 3) -> str:
    """What is left: the regions that are least like noise, and on which samples it depends."""
    regions = [f"{one.z:+.1f} sigma at {one.place}" for one in _distinct(ground.structure.where)[:most]]
    by_pairs: dict[float, list[float]] = {}
    for image in ground.fit.problem.images:
        by_pairs.setdefault(image.sample.dbr_pairs, []).append(ground.structure.shots[image.shot.id].z)
    pairs = ", ".join(f"{n:g} pairs z {max(z):.1f}" for n, z in sorted(by_pairs.items()))
    return "; ".join(regions) + (f"; by DBR: {pairs}." if len(by_pairs) > 1 else ".")


def _distinct(regions: Sequence[Region]) -> list[Region]:
    """One of each family."""
    return list({one.family: one for one in reversed(regions)}.values())[::-1]


def _columns_of(projected: Projected, candidate: Candidate) -> Real:
    for one, part in zip(projected.candidates, projected.slices(), strict=True):
        if one is candidate:
            return projected.columns[part]
    raise ValueError(f"{candidate.key} was not projected")


def _explanation(
    ground: Ground, score: EffectScore, found: Refitted, columns: dict[str, Real], rivals: Sequence[str]
) -> Explanation:
    candidate, base = score.best.candidate, ground.fit
    parameter = candidate.parameter
    scale = variance_scale(float(found.residual @ found.residual), base.freedom - 1.0)
    own = columns[score.name][0] if not candidate.is_group else None
    size = 1.0 if candidate.is_switch else score.best.size
    length = float(np.sqrt(score.best.drop)) if own is None else abs(size) * float(np.linalg.norm(own))
    beside = {} if own is None else {
        rival: abs(size) * left_beside(own, [columns[rival]]) for rival in rivals if rival != score.name
    }  # fmt: skip
    drop = base.chi2 + _priors(base) - found.chi2
    change, percents = _held_out(base, found, candidate.effect)
    evidence = None
    if not (candidate.is_group or candidate.is_switch or found.at_limit) and np.isfinite(found.error) and found.error:
        evidence = log_evidence(drop, found.error, *limits_of(parameter))
    return Explanation(
        name=score.name,
        parameter=parameter.name,
        unit=parameter.unit,
        value=found.value,
        error=found.error,
        drop=drop,
        share=ground.loudest.share(found.residual, scale),
        held_out=change,
        held_out_percent=percents,
        log_evidence=evidence,
        plausible=not found.at_limit and drop > 0.0,
        distrust=found.fit.distrust if found.fit is not None else base.distrust,
        p_left=ground.judged(found.residual).p,
        sigma=length,
        sigma_rival=beside,
    )


def _priors(fit: Fit) -> float:
    return fit.reduced.chi2_prior


def _held_out(
    base: Fit, found: Refitted, effect: EffectSpec
) -> tuple[held.Change | None, tuple[float, float] | None]:
    """The change of the density in data left out, and the rms errors; None where a held-out test is not possible."""
    if found.fit is None:
        return None, None
    folds = held.folds_by_blocks(base) if effect.scope == "per_sample" else held.folds_by_sample(base)
    if not folds:
        return None, None
    before, after = held.held_out(base, folds), held.held_out(found.fit, folds)
    return held.change(before, after), (before.rms_percent, after.rms_percent)
