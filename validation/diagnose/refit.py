"""A model with one effect more, fitted again from where the fit without it stood.

The Monte Carlo of the base fit stays the anchor: what the effect changes is the twin's difference. Derivatives stay
those of the base fit and of the score test (`frozen`); what is kept is finished with its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectParameter, Value
from luxloop.model import Fit as Limits
from luxloop.model import Model
from validation.diagnose.anew import (
    STEPS,
    about_its_own,
    by_twin,
    fitted_anew,
    has_monte_carlo,
    has_other_light,
    has_strayed,
    is_scale,
    start_of,
    thawed,
)
from validation.diagnose.evidence import logs_of_spreads
from validation.diagnose.frozen import FrozenCurves, FrozenImages, Slopes, frozen_at, without
from validation.effects.agreed import agreed
from validation.effects.known import CHIP, applied, is_smooth, off_values, with_effect
from validation.fit import Fit, prior_chi2, refitted, unknowns_of
from validation.fit.image_fit import ANCHOR_MOVE, MAX_ANCHORS, is_dark
from validation.fit.least_squares import reduce
from validation.fit.problem import CurvePredictor, ImagePredictor, Problem
from validation.fit.start import start_values
from validation.prediction import Anchored
from validation.prediction.differences import stencil

if TYPE_CHECKING:
    from validation.diagnose.score import Candidate, Score

Real = NDArray[np.float64]

LEAST_SHARE = 1e-3
"""Of its range: where a parameter starts whose image goes with its square, at whose off nothing has a slope."""

MOST_HALVINGS = 4

OF_NOISE = 10.0
"""Of chi2: two fits of one model about two Monte Carlo runs of a million histories differ by as much."""
SLOPE_SHARE = 0.1
"""Of its range: by which an effect that the twin cannot represent is moved for the slope at its own value."""

FURTHER = 8
"""Steps of a fit with its own derivatives, after one with frozen ones: what is named is fitted further."""

AS_WELL = 2.0
"""Of chi2, within which words fit as well, and the first in the catalogue's order, the most usual ones, are taken:
differences of Akaike's criterion below 2 decide nothing (Burnham and Anderson, Model Selection, 2002)."""

Words = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Refitted:
    """What a model with an effect leaves, and the effect's size in it."""

    candidate: Candidate
    value: float
    """Of the parameter; of a group the rms of its members; of a switch 1."""
    error: float
    residual: Real
    """(row,), whitened."""
    chi2: float
    """Of data and priors; of an effect that the twin cannot represent its line's, about the base's own anchor."""
    at_limit: bool
    model: Model | None
    """None for a group: its members are known one by one, not as one number."""
    fit: Fit | None
    """None for a group, whose members are reckoned on the linear model."""

    as_well: tuple[Words, ...] = ()
    """Other words of its shape, with which it fits as well."""

    @property
    def shape(self) -> tuple[tuple[str, Value], ...]:
        """What only shapes the effect, as its model has it, else as it was tried."""
        effects = () if self.model is None else self.model.effects
        values = next((e.parameters for e in effects if e.name == self.candidate.effect.name), {})
        return tuple((name, values.get(name, value)) for name, value in self.candidate.shape)


def path_of(effect: str, parameter: str) -> str:
    """The path of an effect's parameter in a model."""
    return f"effects.{effect}.{parameter}"


def added(model: Model, candidate: Candidate, value: float | None) -> Model:
    """The model with the effect of a candidate in its shape; its parameter (None: a switch) is free in its range."""
    one, spec = candidate.parameter, candidate.effect
    values = off_values(spec, dict(candidate.shape))
    if value is None:
        return with_effect(model, applied(spec, values))
    lower, upper = limits_of(one)
    changed = with_effect(model, applied(spec, values | {one.name: float(np.clip(value, lower, upper))}))
    limits = {path_of(spec.name, one.name): Limits(free=True, lower=lower, upper=upper)}
    return changed.model_copy(update={"fit": model.fit | limits})


def limits_of(one: EffectParameter) -> tuple[float, float]:
    """The catalogue's range of a parameter; ValueError where it has words instead."""
    if one.lower is None or one.upper is None:
        raise ValueError(f"{one.name} has no range")
    return one.lower, one.upper


def refit(base: Fit, score: Score, slopes: Slopes) -> Refitted:
    """The fit with an effect; `slopes`: those of the model's own parameters, which move beside it (`slopes_of`)."""
    if score.candidate.is_group:
        return spread(base, score.candidate)
    if score.candidate.is_switch:
        return switched(base, score.candidate)
    return freed(base, score, slopes)


def freed(base: Fit, score: Score, slopes: Slopes) -> Refitted:
    """The effect's parameter is one more unknown, begun where the score test expects it, the others beside it.

    Or half as far from off, as often as the images there are worse than without it: beyond a straight line's reach.
    """
    candidate = score.candidate
    lower, upper = limits_of(candidate.parameter)
    least = LEAST_SHARE * (upper - lower)
    path = path_of(candidate.effect.name, candidate.parameter.name)
    squares = frozenset([path] if candidate.parameter.score_variable == "square" else [])
    lines = frozenset() if is_smooth(candidate.effect) else frozenset([candidate.effect.name])
    slopes = {**slopes, path: candidate.parts}
    frozen = with_slopes(base.problem, slopes, squares, lines)
    size, own = score.size, base.problem.unknowns
    for _ in range(1 + MOST_HALVINGS):
        start = float(np.clip(candidate.value(size), lower + least, upper - least))
        left = base.residual - candidate.size(start) * candidate.columns[0]
        step = reduce(base.columns, left, own.parameters, base.values).step(short=True)
        beside = own.within(base.values + step.change)
        problem, values = posed(
            frozen, added(base.model, candidate, start), tuple(slopes), own.named(beside) | {path: start}
        )
        if not is_dark(problem, values):
            residual = problem.evaluate(values).residual(base.whitening)
            if residual @ residual + prior_chi2(own.parameters, beside) <= _chi2(base):
                break
        size = 0.5 * candidate.size(start)
    if is_dark(problem, values):
        problem, values = posed(frozen, problem.model, tuple(slopes), own.named(base.values) | {path: start})
    found = refitted(problem, values, STEPS)
    return Refitted(
        candidate, found.value(path), found.error(path), found.residual, _chi2(found), path in found.at_limit,
        found.model, found,
    )  # fmt: skip


def switched(base: Fit, candidate: Candidate) -> Refitted:
    """The effect is there, with the word of its shape; derivatives are of where it begins: it is no small change.

    Begun where the fit without it ended, or, where that went far to make up for it, where it began: from what fits
    better. Where the twin alone, begun with the model's own values, fits better with it than without, the fit is made
    anew: beside an anchor in a corner, a right one may fit worse than nothing.
    """
    paths, ended = base.problem.unknowns.model_paths, base.problem.unknowns.named(base.values)
    problem, near = posed(base.problem, added(base.model, candidate, None), paths, ended)
    begun = replace(problem, model=added(base.problem.model, candidate, None))
    of_model = {*paths, *filter(is_scale, ended)}
    anew = start_values(begun, {name: value for name, value in ended.items() if name not in of_model})
    starts = [(_lending(problem), near), (_lending(begun), anew)]
    residuals = [one.evaluate(values).residual(base.whitening) for one, values in starts]
    problem, values = starts[int(np.argmin([residual @ residual for residual in residuals]))]
    found = refitted(frozen_at(problem, values), values, STEPS)
    settled = found.converged and _chi2(found) < _chi2(base) and not has_other_light(problem, found.values)
    if has_monte_carlo(problem) and not settled:
        own = by_twin(begun, start_of(begun, ended))
        if _chi2(own) < _chi2(without_by_twin(base)) - OF_NOISE:
            own = about_its_own(begun, own)
            found = own if _chi2(own) < _chi2(found) - OF_NOISE else found
    return Refitted(candidate, 1.0, 0.0, found.residual, _chi2(found), False, found.model, found)


@lru_cache(maxsize=2)
def without_by_twin(base: Fit) -> Fit:
    """The base model as far as the twin alone takes it: what switches are held against, once for all of them."""
    return by_twin(base.problem, start_of(base.problem, base.problem.unknowns.named(base.values)))


def _lending(problem: Problem) -> Problem:
    """The problem whose own model's chip exits stand for all, where an anchor only lends them."""
    anchor = problem.anchor
    if anchor is None or anchor.histories:
        return problem
    return replace(problem, anchor=replace(anchor, model=problem.model))


def spread(base: Fit, candidate: Candidate) -> Refitted:
    """A group's members by their columns, each drawn back to off by the spread that all of them have.

    The spread s is the most likely one: members are normal with it, and the data know each to one over its column.
    """
    rows = candidate.columns - (candidate.columns @ base.basis.data) @ base.basis.data.T
    _, upper = limits_of(candidate.parameter)
    best, members, log = drawn_back(rows, base.residual, upper)
    size = np.maximum(np.linalg.eigvalsh(rows @ rows.T), 0.0)
    curvature = float(np.sum((best * size / (1.0 + best**2 * size)) ** 2)) * 2.0
    return Refitted(
        candidate, best, 1.0 / np.sqrt(curvature) if curvature > 0.0 else np.inf, base.residual - members @ rows,
        _chi2(base) - 2.0 * max(log, 0.0), best >= upper, None, None,
    )  # fmt: skip


def drawn_back(rows: Real, residual: Real, largest: float) -> tuple[float, Real, float]:
    """The most likely spread of a group's members, the members (member,) with it, and ln of its likelihood ratio.

    `rows` (member, row): their columns, less what the fit's own parameters do; `largest`: spread that is tried.
    """
    size, axes = np.linalg.eigh(rows @ rows.T)
    size, along = np.maximum(size, 0.0), axes.T @ (rows @ residual)
    spreads = largest * np.geomspace(1e-4, 1.0, 400)
    logs = logs_of_spreads(along, size, spreads)
    best = float(spreads[int(np.argmax(logs))])
    return best, axes @ (best**2 * along / (1.0 + best**2 * size)), float(logs.max())


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
    begun = _ended(problem, fit)
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
    return replace(_with(found, thawed(own, problem)), as_well=as_well)


def _ended(problem: Problem, fit: Fit) -> Fit:
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

    Of two runs chi2 differs by some 20. An effect that the twin cannot represent stays where its line begins.
    """
    fit, theirs = found.fit, None if other.fit is None else other.fit.problem.anchor
    smooth = is_smooth(found.candidate.effect) and is_smooth(other.candidate.effect)
    if fit is None or theirs is None or not smooth or theirs == base.problem.anchor:
        return found
    return _with(found, refitted(replace(fit.problem, anchor=theirs), fit.values, STEPS))


def is_stuck(found: Refitted, base: Fit) -> bool:
    """Whether a parameter that the base fit moves, too, is held at its limit."""
    if found.fit is None or found.at_limit or found.candidate.is_switch or not is_smooth(found.candidate.effect):
        return False
    return not {*base.problem.unknowns.model_paths}.isdisjoint(found.fit.at_limit)


def unstuck(found: Refitted, base: Fit) -> Refitted:
    """The same from where the model began, not from where it went to make up for the effect, if that fits better."""
    fit = found.fit
    if fit is None:
        return found
    model = added(base.problem.model, found.candidate, found.value)
    problem = replace(
        fit.problem, model=model, predictor=base.problem.predictor, predict_curves=base.problem.predict_curves
    )
    anew = fitted_anew(problem, start_of(problem, problem.unknowns.named(fit.values)))
    return found if anew is None or _chi2(anew) >= found.chi2 else _with(found, anew)


def _best_words(found: Refitted, problem: Problem, own: Fit) -> tuple[Fit, tuple[Words, ...]]:
    """The fit with the best words of the effect's shape (a law, a profile), and other words that fit as well."""
    spec = found.candidate.effect
    words = [one for one in spec.parameters if one.off is None and one.choices and not found.candidate.is_switch]
    if not words:
        return own, ()
    tried = next(dict(effect.parameters) for effect in problem.model.effects if effect.name == spec.name)
    known, start = without(own.problem, path_of(spec.name, found.candidate.parameter.name)), own.problem.unknowns
    fits = {}
    for said in product(*(one.choices for one in words)):
        wanted = tried | dict(zip((one.name for one in words), said, strict=True))
        model = with_effect(problem.model, applied(spec, wanted))
        begun = posed(known, model, start.model_paths, start.named(own.values))
        fits[said] = own if wanted == tried else _renewed(*begun)
    fits = {said: fit for said, fit in fits.items() if fit.trusted} or fits
    least = min(map(_chi2, fits.values()))
    first, *others = (said for said, fit in fits.items() if _chi2(fit) <= least + AS_WELL)
    return fits[first], tuple(others)


def _renewed(problem: Problem, values: Real) -> Fit:
    """The fit with derivatives of its own: those where it begins, renewed where it has moved away from there.

    What does not converge so, for an effect as large bends, takes some steps more with derivatives anew at each.
    """
    found = refitted(frozen_at(problem, values), values, STEPS)
    for _ in range(MAX_ANCHORS - 1):
        paths = problem.unknowns.model_paths
        at = dict(zip(found.names, values, strict=True))
        if all(abs(found.value(path) - at[path]) <= ANCHOR_MOVE * found.error(path) for path in paths):
            break
        values = found.values
        found = refitted(frozen_at(replace(problem, images=found.problem.images), values), values, STEPS)
    return found if found.converged else refitted(problem, found.values, FURTHER)


def _at_its_value(found: Refitted, fit: Fit, predictor: ImagePredictor) -> Refitted:
    """The same about Monte Carlo at the effect's own value, where its line begins, with the slope that it has there.

    The twin cannot represent it, and it need not grow in proportion: light that walls send back comes to walls again.
    So it is done again where the value has moved by more than an anchor may be away. Its chi2 stays that of the line:
    about another Monte Carlo it has other noise, in images of many chips of a hundred and more.
    """
    line = found
    for _ in range(MAX_ANCHORS):
        anchor = fit.problem.anchor
        if anchor is None or not anchor.histories:
            break
        before, moved = found, replace(anchor, model=fit.model, poses=tuple(fit.poses.values()))
        problem = replace(fit.problem, anchor=moved, predictor=_sloped(found, fit, predictor, moved))
        fit = refitted(problem, fit.values)
        found = _with(found, fit)
        if abs(found.value - before.value) <= ANCHOR_MOVE * found.error:
            break
    return found if found is line else replace(found, chi2=line.chi2)


def _sloped(found: Refitted, fit: Fit, predictor: ImagePredictor, anchor: Anchored) -> ImagePredictor:
    """The fit's predictor with the slope of the images by the effect as it is at the fit's own value.

    What two differences of Monte Carlo at moved models agree about, each with random numbers of its own and not those
    of the anchor, whose noise is in the residual; by a tenth of the range to either side, for of most such columns a
    fit leaves little, and short steps leave noise.
    """
    frozen, one = fit.problem.predictor, found.candidate.parameter
    path = path_of(found.candidate.effect.name, one.name)
    if not isinstance(frozen, FrozenImages) or path not in frozen.slopes:
        return frozen
    views = fit.problem.views(fit.model, fit.problem.unknowns.named(fit.values))
    lower, upper = limits_of(one)
    step, squared = SLOPE_SHARE * (upper - lower), 2.0 * found.value if path in frozen.squares else 1.0
    moved = stencil(lambda by: fit.model.with_value(path, found.value + by), step, path)

    def run(number: int) -> list[Real]:
        slopes = [np.zeros((view.rows, view.columns)) for view in views]
        for weight, model in moved:
            seed, exits = anchor.seed + 1 + number, anchor.exit_seed + number
            there = replace(anchor, model=model, seed=seed, exit_seed=exits, histories=anchor.histories // 2)
            for slope, image in zip(slopes, predictor.images(model, views, (), there), strict=True):
                slope += weight * image.irradiance_per_mm2 / squared
        return slopes

    slopes = [agreed(*of) for of in zip(run(0), run(1), strict=True)]
    return replace(frozen, slopes={**frozen.slopes, path: [*slopes, *frozen.slopes[path][len(slopes) :]]})


def _with(found: Refitted, fit: Fit) -> Refitted:
    """The same with another fit of its model."""
    switch = found.candidate.is_switch
    path = path_of(found.candidate.effect.name, found.candidate.parameter.name)
    return replace(
        found, value=1.0 if switch else fit.value(path), error=0.0 if switch else fit.error(path),
        residual=fit.residual, chi2=_chi2(fit), at_limit=path in fit.at_limit, model=fit.model, fit=fit,
    )  # fmt: skip


def with_slopes(
    problem: Problem, slopes: Slopes, squares: frozenset[str] = frozenset(), lines: frozenset[str] = frozenset()
) -> Problem:
    """The problem about the same anchor, with slopes that stay."""
    curves = problem.predict_curves
    return replace(
        problem,
        predictor=FrozenImages(problem.predictor, slopes, squares, lines),
        predict_curves=None if curves is None else FrozenCurves(curves, slopes, squares, len(problem.images)),
    )


def posed(problem: Problem, model: Model, paths: Sequence[str], start: dict[str, float]) -> tuple[Problem, Real]:
    """The problem with another model, of which these paths move, and the values to start from."""
    known = problem.unknowns
    films = [one for one in known.parameters if one.name in known.other_paths]
    unknowns = unknowns_of(model, paths, problem.images, problem.curves, films, problem.discrepancies)
    return replace(problem, model=model, unknowns=unknowns), np.array([start[name] for name in unknowns.names])


def _chi2(fit: Fit) -> float:
    return fit.chi2 + prior_chi2(fit.problem.unknowns.parameters, fit.values)
