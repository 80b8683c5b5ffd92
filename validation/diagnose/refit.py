"""A model with one effect more, fitted again from where the fit without it stood.

The Monte Carlo of the base fit stays the anchor: what the effect changes is the twin's difference. Derivatives stay
those of the base fit and of the score test (`frozen`); what is kept is fitted to its end with its own (`ending`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from luxloop.model import Model
from validation.diagnose.anew import (
    OF_NOISE,
    STEPS,
    about_its_own,
    by_twin,
    has_monte_carlo,
    has_other_light,
    is_scale,
    start_of,
    total_chi2,
)
from validation.diagnose.evidence import drawn_back
from validation.diagnose.frozen import FrozenCurves, FrozenImages, Slopes, frozen_at
from validation.diagnose.refitted import Refitted, added, limits_of
from validation.effects.known import is_smooth
from validation.fit import Fit, prior_chi2, refitted, unknowns_of
from validation.fit.descent import is_dark
from validation.fit.least_squares import Parameter, reduce
from validation.fit.problem import Problem
from validation.fit.start import start_values

if TYPE_CHECKING:
    from validation.diagnose.score import Candidate, Score

Real = NDArray[np.float64]

LEAST_SHARE = 1e-3
"""Of its range: where a parameter starts whose image goes with its square, at whose off nothing has a slope."""

LEAST = 1e-4
"""Of a column: what the fit's own parameters must leave of it, for it to be fitted beside another."""

LEAST_DROP = 10.0
"""Of chi2, three standard deviations and a little: a sample in which an effect lowers it by less stays without."""

MOST_HALVINGS = 4


def refit(base: Fit, score: Score, slopes: Slopes) -> Refitted:
    """The fit with an effect; `slopes`: those of the model's own parameters, which move beside it (`slopes_of`)."""
    if score.candidate.is_group:
        return spread(base, score.candidate)
    if score.candidate.is_switch:
        return switched(base, score.candidate)
    return freed(base, score, slopes)


def freed(base: Fit, score: Score, slopes: Slopes) -> Refitted:
    """The effect's numbers that act are more unknowns, begun where their columns expect them, all else beside.

    One that goes to the end of its range beside the one that scored is left off, where the others stay inside so:
    what the data hardly know takes of anything, and another effect may be missing, too.
    """
    tried = acting_together(base, score.candidate)
    found = _freed(base, score, slopes, tried)
    ended = () if found.fit is None else found.fit.at_limit
    inside = [one for one, path in zip(tried, found.paths, strict=True) if path not in ended]
    if inside[:1] != tried[:1] or len(inside) == len(tried):
        return found
    fewer = _freed(base, score, slopes, inside)
    return found if fewer.driven else fewer


def _freed(base: Fit, score: Score, slopes: Slopes, tried: Sequence[Candidate]) -> Refitted:
    """The same with these parameters; begun half as far from off, as often as the images there are worse than without
    the effect: beyond a straight line's reach."""
    candidate = replace(score.candidate, others=tuple(tried[1:]))
    sizes = [score.size] if len(tried) == 1 else _sizes(base, tried)
    paths = [one.path for one in tried]
    squares = frozenset(
        path for path, one in zip(paths, tried, strict=True) if one.parameter.score_variable == "square"
    )
    lines = frozenset() if is_smooth(candidate.effect) else frozenset([candidate.effect.name])
    slopes = {**slopes, **{path: one.parts for path, one in zip(paths, tried, strict=True)}}
    frozen = with_slopes(base.problem, slopes, squares, lines)
    own = base.problem.unknowns
    for _ in range(1 + MOST_HALVINGS):
        starts = [_inside(one, size) for one, size in zip(tried, sizes, strict=True)]
        sizes = [one.size(start) for one, start in zip(tried, starts, strict=True)]
        left = base.residual - sum(size * one.columns[0] for one, size in zip(tried, sizes, strict=True))
        step = reduce(base.columns, left, own.parameters, base.values).step(short=True)
        beside, at = own.within(base.values + step.change), dict(zip(paths, starts, strict=True))
        problem, values = posed(frozen, added(base.model, candidate, at), tuple(slopes), own.named(beside) | at)
        if not is_dark(problem, values):
            residual = problem.evaluate(values, derivatives=False).residual(base.whitening)
            if residual @ residual + prior_chi2(own.parameters, beside) <= total_chi2(base):
                break
        sizes = [0.5 * size for size in sizes]
    if is_dark(problem, values):
        problem, values = posed(frozen, problem.model, tuple(slopes), own.named(base.values) | at)
    found = refitted(problem, values, STEPS)
    return Refitted(
        candidate, found.value(paths[0]), found.error(paths[0]), found.residual, total_chi2(found),
        not set(paths).isdisjoint(found.driven), found.model, found,
    )  # fmt: skip


def acting_together(base: Fit, candidate: Candidate) -> list[Candidate]:
    """A candidate, and those of the effect's other numbers of which the fit's own leave something; of those that
    other samples have, where it shows there."""
    others = [
        one
        for one in candidate.others
        if np.linalg.norm(base.basis.left(one.columns)) > LEAST * np.linalg.norm(one.columns)
    ]
    by_sample = {one.sample: [other for other in others if other.sample == one.sample] for one in others}
    shown = [one for one, own in by_sample.items() if one != candidate.sample and drop_of(base, own) >= LEAST_DROP]
    return [candidate, *(one for one in others if one.sample in (candidate.sample, *shown))]


def drop_of(base: Fit, tried: Sequence[Candidate]) -> float:
    """By how much chi2 should fall with all of these, each within its range, on the linear model."""
    rows = np.concatenate([base.basis.left(one.columns) for one in tried])
    inside = [_inside(one, size) for one, size in zip(tried, _sizes(base, tried), strict=True)]
    change = np.array([one.size(value) for one, value in zip(tried, inside, strict=True)]) @ rows
    return float(change @ (2.0 * base.residual_with_priors - change))


def whole_of(base: Fit, found: Refitted, candidate: Candidate) -> Real:
    """The rows of an effect whose parameters act together, at their sizes, less what the fit's own parameters do.

    `candidate`: in the shape that it was fitted with; what it acts by besides, and was left off, does not count.
    """
    size = found.size
    tried = [one for one in (candidate, *candidate.others) if one.path in size]
    return np.asarray(sum(one.size(size[one.path]) * base.basis.left(one.columns)[0] for one in tried))


def expected(base: Fit, candidate: Candidate) -> tuple[float, float]:
    """By how much chi2 should fall with a single column more, and its size, on the linear model within all limits.

    That of its score, but that a parameter which the fit has driven to its limit may come back from there.
    """
    own, (below, above) = base.problem.unknowns.parameters, candidate.sides
    size = Parameter(candidate.key, -np.inf if below else 0.0, np.inf if above else 0.0)
    columns = np.concatenate([base.columns, candidate.columns])
    step = reduce(columns, base.residual, (*own, size), np.append(base.values, 0.0)).step()
    return max(0.0, base.reduced.step().chi2 - step.chi2), float(step.change[-1])


def _sizes(base: Fit, tried: Sequence[Candidate]) -> list[float]:
    """Where their columns, less what the fit's own parameters do, leave least."""
    rows = np.concatenate([base.basis.left(one.columns) for one in tried])
    return [float(size) for size in np.linalg.lstsq(rows.T, base.residual_with_priors, rcond=1e-6)[0]]


def _inside(one: Candidate, size: float) -> float:
    """The parameter at a size, a little inside of its range."""
    lower, upper = limits_of(one.parameter)
    least = LEAST_SHARE * (upper - lower)
    return float(np.clip(one.value(size), lower + least, upper - least))


def switched(base: Fit, candidate: Candidate) -> Refitted:
    """The effect is there, with the word of its shape; derivatives are of where it begins: it is no small change.

    Begun where the fit without it ended, or, where that went far to make up for it, where it began: from what fits
    better. Where the twin alone, begun with the model's own values, fits better with it than without, the fit is made
    anew: beside an anchor in a corner, a right one may fit worse than nothing. What no longer promises to fit better
    is not fitted to its end.
    """
    paths, ended = base.problem.unknowns.model_paths, base.problem.unknowns.named(base.values)
    problem, near = posed(base.problem, added(base.model, candidate, {}), paths, ended)
    begun = replace(problem, model=added(base.problem.model, candidate, {}))
    of_model = {*paths, *filter(is_scale, ended)}
    anew = start_values(begun, {name: value for name, value in ended.items() if name not in of_model})
    starts = [(_lending(problem), near), (_lending(begun), anew)]
    residuals = [one.evaluate(values, derivatives=False).residual(base.whitening) for one, values in starts]
    problem, values = starts[int(np.argmin([residual @ residual for residual in residuals]))]
    found = refitted(frozen_at(problem, values), values, STEPS, total_chi2(base))
    settled = found.converged and total_chi2(found) < total_chi2(base) and not has_other_light(problem, found.values)
    if has_monte_carlo(problem) and not settled:
        below = total_chi2(without_by_twin(base)) - OF_NOISE
        own = by_twin(begun, start_of(begun, ended), below)
        if total_chi2(own) < below:
            own = about_its_own(begun, own, total_chi2(found))
            found = own if total_chi2(own) < total_chi2(found) - OF_NOISE else found
    return Refitted(candidate, 1.0, 0.0, found.residual, total_chi2(found), False, found.model, found)


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
    rows = base.basis.left(candidate.columns)
    _, upper = limits_of(candidate.parameter)
    best, members, log = drawn_back(rows, base.residual_with_priors, upper)
    size = np.maximum(np.linalg.eigvalsh(rows @ rows.T), 0.0)
    curvature = float(np.sum((best * size / (1.0 + best**2 * size)) ** 2)) * 2.0
    residual = base.residual - members @ rows[:, : len(base.residual)]
    return Refitted(
        candidate, best, 1.0 / np.sqrt(curvature) if curvature > 0.0 else np.inf, residual,
        total_chi2(base) - 2.0 * max(log, 0.0), best >= upper, None, None,
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
