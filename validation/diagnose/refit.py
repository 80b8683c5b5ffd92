"""A model with one effect more, fitted again from where the fit without it stood.

The Monte Carlo of the base fit stays the anchor: what the effect changes is the twin's difference. Derivatives stay
those of the base fit and of the score test (`frozen`); what is kept is fitted to its end with its own (`ending`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectParameter, Value
from luxloop.model import Fit as Limits
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
from validation.diagnose.evidence import logs_of_spreads
from validation.diagnose.frozen import FrozenCurves, FrozenImages, Slopes, frozen_at
from validation.effects.known import applied, is_smooth, off_values, with_effect
from validation.fit import Fit, prior_chi2, refitted, unknowns_of
from validation.fit.image_fit import is_dark
from validation.fit.least_squares import reduce
from validation.fit.problem import Problem
from validation.fit.start import start_values

if TYPE_CHECKING:
    from validation.diagnose.score import Candidate, Score

Real = NDArray[np.float64]

LEAST_SHARE = 1e-3
"""Of its range: where a parameter starts whose image goes with its square, at whose off nothing has a slope."""

MOST_HALVINGS = 4

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
    """None for a group as long as its members are no numbers of a model."""
    fit: Fit | None
    """None for a group whose members are reckoned on the linear model."""

    as_well: tuple[Words, ...] = ()
    """Other words of its shape, with which it fits as well."""
    line: Fit | None = None
    """Of an effect that the twin cannot represent, fitted about its own value: the fit about the base's anchor."""

    @property
    def beside_base(self) -> Fit | None:
        """The fit that has the base's noise of Monte Carlo: what can be held against the base, value by value."""
        return self.fit if self.line is None else self.line

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
            if residual @ residual + prior_chi2(own.parameters, beside) <= total_chi2(base):
                break
        size = 0.5 * candidate.size(start)
    if is_dark(problem, values):
        problem, values = posed(frozen, problem.model, tuple(slopes), own.named(base.values) | {path: start})
    found = refitted(problem, values, STEPS)
    return Refitted(
        candidate, found.value(path), found.error(path), found.residual, total_chi2(found), path in found.at_limit,
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
    settled = found.converged and total_chi2(found) < total_chi2(base) and not has_other_light(problem, found.values)
    if has_monte_carlo(problem) and not settled:
        own = by_twin(begun, start_of(begun, ended))
        if total_chi2(own) < total_chi2(without_by_twin(base)) - OF_NOISE:
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
    rows = candidate.columns - (candidate.columns @ base.basis.data) @ base.basis.data.T
    _, upper = limits_of(candidate.parameter)
    best, members, log = drawn_back(rows, base.residual, upper)
    size = np.maximum(np.linalg.eigvalsh(rows @ rows.T), 0.0)
    curvature = float(np.sum((best * size / (1.0 + best**2 * size)) ** 2)) * 2.0
    return Refitted(
        candidate, best, 1.0 / np.sqrt(curvature) if curvature > 0.0 else np.inf, base.residual - members @ rows,
        total_chi2(base) - 2.0 * max(log, 0.0), best >= upper, None, None,
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


def with_fit(found: Refitted, fit: Fit) -> Refitted:
    """The same with another fit of its model."""
    switch = found.candidate.is_switch
    path = path_of(found.candidate.effect.name, found.candidate.parameter.name)
    return replace(
        found, value=1.0 if switch else fit.value(path), error=0.0 if switch else fit.error(path),
        residual=fit.residual, chi2=total_chi2(fit), at_limit=path in fit.at_limit, model=fit.model, fit=fit,
    )  # fmt: skip


def of_members(found: Refitted, fit: Fit) -> Refitted:
    """A group's with the fit in which each member is a number of its own; spread, error and chi2 stay its line's."""
    return replace(found, residual=fit.residual, model=fit.model, fit=fit)


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
