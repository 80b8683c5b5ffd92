"""What a verdict would name, fitted to its end: with derivatives of its own, about Monte Carlo where it ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from luxloop.model import Fit as Limits
from luxloop.model import Model
from validation.diagnose.anew import (
    OF_NOISE,
    OF_TWO_RUNS,
    ON_THE_WAY,
    STEPS,
    about_its_own,
    by_twin,
    chi2_by_twin,
    fitted_anew,
    has_monte_carlo,
    has_other_light,
    has_strayed,
    is_near,
    start_of,
    thawed,
    total_chi2,
)
from validation.diagnose.frozen import FrozenImages, frozen_at, without
from validation.diagnose.refit import LEAST_SHARE, posed
from validation.diagnose.refitted import Refitted, Words, added, limits_of, path_of, with_fit
from validation.effects.agreed import agreed
from validation.effects.known import CHIP, applied, is_smooth, with_effect
from validation.effects.signatures import enough_of
from validation.fit import Fit, refitted
from validation.fit.anchored_fit import ANCHOR_MOVE, MAX_ANCHORS, moved
from validation.fit.problem import CurvePredictor, ImagePredictor, Problem
from validation.prediction import Anchored, View
from validation.prediction.differences import Moved, stencil
from validation.sample_values import LEAD, with_number

Real = NDArray[np.float64]

SLOPE_SHARE = 0.1
"""Of its range: by which an effect that the twin cannot represent is moved for the slope at its own value."""
FURTHER = 8
"""Steps of a fit with its own derivatives, after one with frozen ones: what is named is fitted further."""
AS_WELL = 2.0
"""Of chi2, within which words fit as well, and the first in the catalogue's order, the most usual ones, are taken:
differences of Akaike's criterion below 2 decide nothing (Burnham and Anderson, Model Selection, 2002)."""


def finished(found: Refitted, predictor: ImagePredictor, curves: CurvePredictor | None) -> Refitted:
    """The same with derivatives of its own, and the numbers that shape the effect free, where the data hold them.

    Before another effect is looked for, and before a model is written: a wrong shape asks for a spurious effect.
    """
    spec, fit = found.candidate.effect, found.fit
    if fit is None:
        return found
    if not is_smooth(spec):
        return _at_its_value(found, fit, predictor)
    problem = replace(fit.problem, predictor=predictor, predict_curves=curves)
    begun = _at_its_end(problem, fit)
    problem = replace(problem, anchor=begun.problem.anchor)
    own, as_well = _best_words(found, problem, begun)
    lengths = [one for one in spec.parameters if one.off is None and not one.choices and one.name != CHIP]
    shapes = [one for one in lengths if one.shape_grid]
    if shapes and not found.candidate.is_switch:
        limits = {path_of(spec.name, one.name): limits_of(one) for one in shapes}
        opened = {path: Limits(free=True, lower=low, upper=high) for path, (low, high) in limits.items()}
        model = own.model.model_copy(update={"fit": own.model.fit | opened})
        start = own.problem.unknowns.named(own.values) | {path: own.model.leaves()[path] for path in limits}
        better = _renewed(*posed(problem, model, (*own.problem.unknowns.model_paths, *limits), start))
        if better.converged and not any(path in better.at_limit for path in limits):
            own = better
    found, own = _left_off(found, problem, own)
    return replace(with_fit(found, thawed(own, problem)), as_well=as_well)


def _left_off(found: Refitted, problem: Problem, own: Fit) -> tuple[Refitted, Fit]:
    """The fit without numbers that went to the end of their range beside the one that scored, if it stays inside.

    As `freed` does, for what only derivatives of its own, or Monte Carlo where it ends, have driven there. Effects
    that the twin cannot follow end otherwise (`_at_its_value`) and keep such a number.
    """
    first, *others = (found.candidate, *found.candidate.others)
    inside = [one for one, path in zip(others, found.paths[1:], strict=True) if path not in own.at_limit]
    if len(inside) == len(others) or found.paths[0] in own.driven:
        return found, own
    fewer = replace(found, candidate=replace(first, others=tuple(inside)))
    left = {one.path: one.parameter.off for one in others if one not in inside}
    model = own.model
    for path, off in left.items():
        model = with_number(model, path, off)
    model = model.model_copy(update={"fit": {path: one for path, one in model.fit.items() if path not in left}})
    paths = [path for path in own.problem.unknowns.model_paths if path not in left]
    fit = _renewed(*posed(problem, model, paths, own.problem.unknowns.named(own.values)))
    fit = about_its_own(problem, fit) if has_strayed(fit) else fit
    return (found, own) if not set(fewer.paths).isdisjoint(fit.driven) else (fewer, fit)


def _at_its_end(problem: Problem, fit: Fit) -> Fit:
    """A fit with derivatives of its own; about Monte Carlo of its own where it begins or ends far from the anchor."""
    if has_other_light(problem, fit.values):
        anew = fitted_anew(problem, problem.unknowns.named(fit.values))
        if anew is not None:
            return anew
    if has_strayed(fit):
        return about_its_own(problem, fit)
    renewed = _renewed(problem, fit.values)
    return about_its_own(problem, renewed) if has_strayed(renewed) else renewed


def beside(found: Refitted, other: Refitted, base: Fit) -> Refitted:
    """The same about Monte Carlo at another effect's fit, where that has its own: about one run both have one noise.

    Of two runs chi2 differs by some 20. What loses more than 30 stays where it is: the other's model is another one
    there, where layers lie the other way round by 1,700. What has Monte Carlo of its own stays there, too: exits that
    land at another distance than the anchor's have noise that does not cancel, 500 and more of chi2 at 7 um. An
    effect that the twin cannot represent stays where its line begins.
    """
    fit, theirs = found.fit, None if other.fit is None else other.fit.problem.anchor
    smooth = is_smooth(found.candidate.effect) and is_smooth(other.candidate.effect)
    if fit is None or theirs is None or not smooth:
        return found
    if theirs == base.problem.anchor or fit.problem.anchor != base.problem.anchor:
        return found
    there = refitted(replace(fit.problem, anchor=theirs), fit.values, STEPS)
    return found if total_chi2(there) > found.chi2 + OF_TWO_RUNS else with_fit(found, there)


def is_stuck(found: Refitted, base: Fit) -> bool:
    """Whether the base fit, or this one, holds a parameter at its limit that the base fit moves and all samples have
    in common: it went there to make up for what the model lacks.

    Not where only Monte Carlo shows the effect, or another is a straight line already: the way back is the twin's.
    """
    effect = found.candidate.effect
    if found.fit is None or found.driven or found.candidate.is_switch or not effect.twin:
        return False
    if not is_smooth(effect) and _on_lines(base.problem.predictor):
        return False
    return bool(_held(base, base) | _held(found.fit, base))


def unstuck(found: Refitted, base: Fit) -> Refitted:
    """The same about Monte Carlo of its own, or from where the model began, if that fits better.

    What the twin errs by, carried over from the corner where the base fit's anchor stands, holds a fit there. Where
    it stays at the limit about its own, too, it is begun from the model's own values: by the twin first, from there
    and from where it is; Monte Carlo is asked only where the way from there leads out of the corner, and fits about
    as well. An effect with walks of its own keeps its line, from where the anchor has it.
    """
    fit = found.fit
    if fit is None:
        return found
    model = added(base.problem.model, found.candidate, found.size)
    predictor = _on_its_line(found, base.problem.predictor)
    problem = replace(fit.problem, model=model, predictor=predictor, predict_curves=base.problem.predict_curves)
    if not has_monte_carlo(problem):
        return found
    own = about_its_own(problem, fit, found.chi2)
    if total_chi2(own) < found.chi2 - OF_TWO_RUNS and set(found.paths).isdisjoint(own.driven):
        found, fit = with_fit(found, own), own
    if not _held(fit, base):
        return found
    ended = problem.unknowns.named(fit.values)
    highest = chi2_by_twin(problem, ended) + OF_NOISE
    begun = by_twin(problem, start_of(problem, ended), highest)
    if total_chi2(begun) > highest or _held(fit, base) <= _held(begun, base):
        return found  # worse, or in no corner: the model goes to that limit with the effect, too
    if total_chi2(begun) > total_chi2(by_twin(problem, ended)) + OF_NOISE:
        return found
    anew = about_its_own(problem, begun, found.chi2)
    return found if total_chi2(anew) >= found.chi2 else with_fit(found, anew)


def _on_its_line(found: Refitted, predictor: ImagePredictor) -> ImagePredictor:
    """The predictor, in which the effect is the straight line that it is in its fit, where it is one."""
    frozen = None if found.fit is None else found.fit.problem.predictor
    if is_smooth(found.candidate.effect) or not isinstance(frozen, FrozenImages):
        return predictor
    slopes = {path: frozen.slopes[path] for path in found.paths}
    return FrozenImages(predictor, slopes, frozen.squares, frozen.lines)


def _on_lines(predictor: ImagePredictor) -> bool:
    return isinstance(predictor, FrozenImages) and bool(predictor.lines)


def _held(found: Fit, base: Fit) -> set[str]:
    """What the data drive to its limit in a fit of the base fit's parameters that all samples have in common."""
    shared = {path for path in base.problem.unknowns.model_paths if not path.startswith(LEAD)}
    return shared & set(found.driven)


def _best_words(found: Refitted, problem: Problem, own: Fit) -> tuple[Fit, tuple[Words, ...]]:
    """The fit with the best words of the effect's shape (a law, a profile), and other words that fit as well."""
    spec = found.candidate.effect
    words = [one for one in spec.parameters if one.off is None and one.choices and not found.candidate.is_switch]
    if not words:
        return own, ()
    tried = next(dict(effect.parameters) for effect in problem.model.effects if effect.name == spec.name)
    known, start = own.problem, own.problem.unknowns
    for path in found.paths:
        known = without(known, path)
    fits = {}
    for said in product(*(one.choices for one in words)):
        wanted = tried | dict(zip((one.name for one in words), said, strict=True))
        model = with_effect(problem.model, applied(spec, wanted))
        begun = posed(known, model, start.model_paths, start.named(own.values))
        fits[said] = own if wanted == tried else _renewed(*begun)
    fits = {said: fit for said, fit in fits.items() if fit.trusted} or fits
    least = min(map(total_chi2, fits.values()))
    first, *others = (said for said, fit in fits.items() if total_chi2(fit) <= least + AS_WELL)
    return fits[first], tuple(others)


def _renewed(problem: Problem, values: Real) -> Fit:
    """The fit with derivatives of its own: those where it begins, renewed where it has moved away from there.

    What does not converge so, for an effect as large bends, takes some steps more with derivatives anew at each.
    """
    found = refitted(frozen_at(problem, values), values, STEPS)
    for _ in range(MAX_ANCHORS - 1):
        at = dict(zip(found.names, values, strict=True))
        if is_near(found, at, problem.unknowns.model_paths, ANCHOR_MOVE):
            break
        values = found.values
        found = refitted(frozen_at(replace(problem, images=found.problem.images), values), values, STEPS)
    return found if found.converged else refitted(problem, found.values, FURTHER)


def _at_its_value(found: Refitted, fit: Fit, predictor: ImagePredictor) -> Refitted:
    """The same about Monte Carlo at the effect's own value, where its line begins, with the slope that it has there.

    The twin cannot represent it, and it need not grow in proportion: light that walls send back comes to walls again.
    So it is done again where the value has moved by more than an anchor may be away: by a few histories, and at last
    by as many as the anchor has. Its chi2 and its held-out error stay those of the line: about another Monte Carlo it
    has other noise, in images of many chips of a hundred and more; and eight times as much variance where the effect
    takes the chip's symmetry.
    """
    anchor, line = fit.problem.anchor, found
    if anchor is None or not anchor.histories:
        return found
    found = replace(found, fit=replace(fit, problem=frozen_at(fit.problem, fit.values)))  # what was led out is not
    few = min(anchor.histories, ON_THE_WAY)
    for _ in range(MAX_ANCHORS):
        found = _about_its_value(found, predictor, few)
        if found.fit is None or moved(found.fit, fit, found.paths) <= ANCHOR_MOVE:
            break
        fit = found.fit
    found = found if few == anchor.histories else _about_its_value(found, predictor, anchor.histories)
    return replace(found, chi2=line.chi2, line=line.fit)


def _about_its_value(found: Refitted, predictor: ImagePredictor, histories: int) -> Refitted:
    """The fit from where another ended, about Monte Carlo at its value by so many histories."""
    fit = found.fit
    if fit is None or fit.problem.anchor is None:
        raise ValueError("an effect that only Monte Carlo shows needs a fit about it")
    there = replace(fit.problem.anchor, model=fit.model, poses=tuple(fit.poses.values()), histories=histories)
    slope = _sloped(found, fit, predictor, replace(there, histories=min(histories, 2 * ON_THE_WAY)))
    return with_fit(found, refitted(replace(fit.problem, anchor=there, predictor=slope), fit.values))


def _sloped(found: Refitted, fit: Fit, predictor: ImagePredictor, anchor: Anchored) -> ImagePredictor:
    """The fit's predictor with the slopes of the images by the effect as they are at the fit's own values.

    One by a square that is at off keeps that of its column, which was taken there: nothing has a slope by its root.
    """
    frozen = fit.problem.predictor
    if not isinstance(frozen, FrozenImages):
        return frozen
    views, slopes = fit.problem.views(fit.model, fit.problem.unknowns.named(fit.values)), {**frozen.slopes}
    for path, one in zip(found.paths, (found.candidate, *found.candidate.others), strict=True):
        lower, upper = limits_of(one.parameter)
        at_off = path in frozen.squares and fit.value(path) < LEAST_SHARE * (upper - lower)
        if path in slopes and not at_off:
            steps = stencil(partial(_moved, fit, path), SLOPE_SHARE * (upper - lower), path)
            squared = 2.0 * fit.value(path) if path in frozen.squares else 1.0
            seen = [number for number, view in enumerate(views) if one.sample in ("", view.sample.id)]
            images = _slope(steps, views, seen, predictor, anchor, squared)
            slopes[path] = [*images, *slopes[path][len(images) :]]
    before, own = frozen.others, {path: slopes[path] for path in found.paths if path in slopes}
    return replace(frozen, slopes=slopes, others=None if before is None else cache(lambda: {**before(), **own}))


def _moved(fit: Fit, path: str, by: float) -> Model:
    return with_number(fit.model, path, fit.value(path) + by)


def _slope(
    steps: Sequence[Moved[Model]],
    views: Sequence[View],
    own: Sequence[int],
    predictor: ImagePredictor,
    anchor: Anchored,
    squared: float,
) -> list[Real]:
    """What two differences of Monte Carlo at moved models agree about, each with random numbers of its own.

    Not those of the anchor, whose noise is in the residual; by a tenth of the range to either side, for of most such
    columns a fit leaves little, and short steps leave noise. `own`: of the views, those that it moves. `squared`: the
    slope of its square, by which it is told.
    """

    histories = anchor.histories // 2
    looked_at = [views[number] for number in own]
    poses = tuple(anchor.poses[number] for number in own) if anchor.poses else ()
    there = replace(anchor, histories=histories, poses=poses, enough=enough_of(looked_at, histories))

    def run(number: int) -> list[Real]:
        slopes = [np.zeros((view.rows, view.columns)) for view in views]
        for weight, model in steps:
            seed, exits = anchor.seed + 1 + number, anchor.exit_seed + number
            moved_there = replace(there, model=model, seed=seed, exit_seed=exits)
            for seen, image in zip(own, predictor.images(model, looked_at, (), moved_there), strict=True):
                slopes[seen] += weight * image.irradiance_per_mm2 / squared
        return slopes

    return [agreed(*of) for of in zip(run(0), run(1), strict=True)]
