"""A model with one effect more, fitted again from where the fit without it stood.

The Monte Carlo of the base fit stays the anchor: what the effect changes is the twin's difference. An effect that the
twin cannot represent is a straight line instead: its Monte Carlo derivative times a size (`Discrepancy`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectParameter
from luxloop.model import Fit as Limits
from luxloop.model import Model
from validation.effects.known import applied, off_values, with_effect
from validation.fit import Fit, prior_chi2, refitted, unknowns_of

if TYPE_CHECKING:
    from validation.diagnose.score import Candidate, Score

Real = NDArray[np.float64]

LEAST_SHARE = 1e-3
"""Of its range: where a parameter starts whose image goes with its square, at whose off nothing has a slope."""


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
    """Of data and priors."""
    at_limit: bool
    model: Model | None
    """None for a group: its members are known one by one, not as one number."""
    fit: Fit | None
    """None for a group, whose members are reckoned on the linear model."""


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


def refit(base: Fit, score: Score, paths: Sequence[str]) -> Refitted:
    """The fit with an effect; `paths`: the model's parameters that move beside it."""
    if score.candidate.is_group:
        return spread(base, score.candidate)
    if score.candidate.is_switch:
        return switched(base, score.candidate, paths)
    return freed(base, score, paths)


def freed(base: Fit, score: Score, paths: Sequence[str]) -> Refitted:
    """The effect's parameter is one more unknown, begun where the score test expects it."""
    candidate = score.candidate
    lower, upper = limits_of(candidate.parameter)
    least = LEAST_SHARE * (upper - lower)
    start = float(np.clip(candidate.value(score.size), lower + least, upper - least))
    path = path_of(candidate.effect.name, candidate.parameter.name)
    found = _again(base, added(base.model, candidate, start), paths, {path: start})
    return Refitted(
        candidate, found.value(path), found.error(path), found.residual, _chi2(found), path in found.at_limit,
        found.model, found,
    )  # fmt: skip


def switched(base: Fit, candidate: Candidate, paths: Sequence[str]) -> Refitted:
    """The effect is there, with the word of its shape."""
    found = _again(base, added(base.model, candidate, None), paths, {})
    return Refitted(candidate, 1.0, 0.0, found.residual, _chi2(found), False, found.model, found)


def spread(base: Fit, candidate: Candidate) -> Refitted:
    """A group's members by their columns, each drawn back to off by the spread that all of them have.

    The spread s is the most likely one: members are normal with it, and the data know each to one over its column.
    """
    rows = candidate.columns - (candidate.columns @ base.basis.data) @ base.basis.data.T
    size, axes = np.linalg.eigh(rows @ rows.T)
    size, along = np.maximum(size, 0.0), axes.T @ (rows @ base.residual)
    _, upper = limits_of(candidate.parameter)
    spreads = upper * np.geomspace(1e-4, 1.0, 400)
    logs = [0.5 * float(np.sum(s**2 * along**2 / (1.0 + s**2 * size) - np.log1p(s**2 * size))) for s in spreads]
    best = float(spreads[int(np.argmax(logs))])
    members = axes @ (best**2 * along / (1.0 + best**2 * size))
    residual = base.residual - members @ rows
    curvature = float(np.sum((best * size / (1.0 + best**2 * size)) ** 2)) * 2.0
    return Refitted(
        candidate, best, 1.0 / np.sqrt(curvature) if curvature > 0.0 else np.inf, residual,
        _chi2(base) - 2.0 * max(max(logs), 0.0), best >= upper, None, None,
    )  # fmt: skip


def shaped(found: Refitted, paths: Sequence[str]) -> Refitted:
    """The same with the numbers that shape the effect free too: before another effect is looked for.

    They are left as they are where the effect has none, is no number, or the data do not hold them.
    """
    spec, fit = found.candidate.effect, found.fit
    shapes = [one for one in spec.parameters if one.off is None and not one.choices and one.shape_grid]
    if fit is None or found.candidate.is_switch or not shapes:
        return found
    limits = {path_of(spec.name, one.name): limits_of(one) for one in shapes}
    here = {path: fit.model.leaves()[path] for path in limits}
    opened = {path: Limits(free=True, lower=low, upper=high) for path, (low, high) in limits.items()}
    model = fit.model.model_copy(update={"fit": fit.model.fit | opened})
    own = path_of(spec.name, found.candidate.parameter.name)
    better = _again(fit, model, (*paths, own), here)
    if not better.converged or any(path in better.at_limit for path in limits):
        return found
    return replace(
        found, value=better.value(own), error=better.error(own), residual=better.residual, chi2=_chi2(better),
        at_limit=own in better.at_limit, model=better.model, fit=better,
    )  # fmt: skip


def _again(base: Fit, model: Model, paths: Sequence[str], start: dict[str, float]) -> Fit:
    """The fit of another model about the same anchor, from where the base stood; keys of `start` are free too."""
    problem, known = base.problem, base.problem.unknowns
    films = [one for one in known.parameters if one.name in known.other_paths]
    unknowns = unknowns_of(model, (*paths, *start), problem.images, problem.curves, films, problem.discrepancies)
    by_name = known.named(base.values) | start
    values = np.array([by_name[name] for name in unknowns.names])
    return refitted(replace(problem, model=model, unknowns=unknowns), values)


def _chi2(fit: Fit) -> float:
    return fit.chi2 + prior_chi2(fit.problem.unknowns.parameters, fit.values)
