"""A fit made anew: for a model that has another light than the anchor's, or that begins in a corner (decision 35)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from validation.diagnose.frozen import frozen_at
from validation.fit import Fit, prior_chi2, refitted
from validation.fit.anchored_fit import ANCHOR_MOVE, MAX_ANCHORS, NEAR, TWIN_STEPS, first_of, moved
from validation.fit.problem import Problem
from validation.fit.start import start_values
from validation.prediction import Anchored
from validation.sample_values import numbers

Real = NDArray[np.float64]

OTHER_LIGHT = 0.1
"""Share by which the light of an image may differ from that at the anchor, before Monte Carlo is asked for anew."""

STRAYED = 5.0
"""Errors by which a parameter may be from where the anchor has it, before Monte Carlo is asked for anew. Reweighted
by some 12 errors of absorption, exits added 80 to a chi2 of 7,028 (decision 41); by its square that is 14 at 5."""

ON_THE_WAY = 4_000_000
"""Histories a sample of anchors that only find where the last one shall be."""

STEPS = 12
"""Of a fit with frozen derivatives: what explains little never converges."""

TWIN_ANEW = 3
"""Sets of derivatives of a fit by the twin alone, at most."""

OF_NOISE, OF_TWO_RUNS = 10.0, 30.0
"""Of chi2: two fits of one model about two Monte Carlo runs of a million histories differ by as much; what is allowed
for where one of them has fewer histories than the other."""


def has_other_light(problem: Problem, values: Real) -> bool:
    """Whether an image has another light at these values than at the anchor; never where there is no Monte Carlo.

    What the twin errs by, and the noise of Monte Carlo, is carried over from the anchor as a share of the light, and
    this share is nearly the same only where the light is.
    """
    anchor, known = problem.anchor, problem.unknowns.named(values)
    if anchor is None or not has_monte_carlo(problem):
        return False
    alone = replace(anchor, histories=0)
    here, there = (
        problem.predictor.images(one, problem.views(one, known), (), alone)
        for one in (problem.unknowns.model(problem.model, values), anchor.model)
    )
    changes = [
        float(one.irradiance_per_mm2.sum() / other.irradiance_per_mm2.sum()) - 1.0
        for one, other in zip(here, there, strict=True)
    ]
    return max(map(abs, changes), default=0.0) > OTHER_LIGHT


def has_strayed(found: Fit) -> bool:
    """Whether a parameter is far from where the anchor has it; never where there is no Monte Carlo."""
    anchor = found.problem.anchor
    if anchor is None or not has_monte_carlo(found.problem):
        return False
    there = numbers(anchor.model)
    known = [path for path in found.problem.unknowns.model_paths if path in there]
    return any(abs(found.value(path) - float(there[path])) > STRAYED * found.error(path) > 0.0 for path in known)


def is_scale(name: str) -> bool:
    """Whether a straight line through an image, or a curve, tells where it starts."""
    return name == "gain" or name.endswith((".gain", ".offset_dn", ".scale"))


def start_of(problem: Problem, ended: Mapping[str, float]) -> dict[str, float]:
    """Where a fit of the problem's model begins by itself: at its own values, images placed as another fit ended."""
    leaves = numbers(problem.model)
    placed = {name: value for name, value in ended.items() if not is_scale(name)}
    return placed | {path: float(leaves[path]) for path in problem.unknowns.model_paths}


def by_twin(problem: Problem, start: Mapping[str, float], below: float = np.inf) -> Fit:
    """As far as the twin alone goes from there in a few steps, with the chip exits of the problem's model.

    Derivatives are those where it begins, anew where it has gone some errors away: those by what changes the light in
    a chip are a walk each. `below`: a chi2 above which nobody asks for it; where columns no longer promise to come
    below, it ends.
    """
    lent = _lent(problem)
    values, paths = start_values(lent, start), problem.unknowns.model_paths
    for _ in range(TWIN_ANEW):
        at, found = problem.unknowns.named(values), refitted(frozen_at(lent, values), values, TWIN_STEPS, below)
        values = found.values
        if is_near(found, at, paths, NEAR) or total_chi2(found) - found.gap > below:
            break
    return thawed(found, lent)


def is_near(found: Fit, at: Mapping[str, float], paths: Sequence[str], errors: float) -> bool:
    """Whether all of these parameters are within so many of their errors of given values."""
    return all(abs(found.value(path) - at[path]) <= errors * found.error(path) for path in paths)


def chi2_by_twin(problem: Problem, start: Mapping[str, float]) -> float:
    """Where such a fit begins: of data and priors."""
    lent = _lent(problem)
    at = lent.evaluate(start_values(lent, start), derivatives=False)
    residual = at.residual(at.whitening())
    return float(residual @ residual) + prior_chi2(lent.unknowns.parameters, at.values)


def _lent(problem: Problem) -> Problem:
    """The problem by the twin, whose own model's chip exits stand for all."""
    anchor = problem.anchor or Anchored(problem.model, 0)
    return replace(problem, anchor=replace(anchor, model=problem.model, histories=0, poses=()))


def about_its_own(problem: Problem, found: Fit, beside: float = np.inf) -> Fit:
    """The fit about Monte Carlo at what a fit has found, and anew where that moves it.

    By a few histories until it stays, where the twin has led by fewer still, and once by as many as the problem's
    anchor has, where those are more (so that the one before may be some errors away) and chi2 is not above that of
    what it stands `beside`: more histories tell less noise, and what is wrong costs more then.
    Derivatives are taken once with each anchor: those of effects are a walk for each moved chip.
    """
    anchor = problem.anchor
    if anchor is None:
        raise ValueError("a fit about Monte Carlo needs an anchor to take histories and seed from")
    few = replace(anchor, histories=min(anchor.histories, ON_THE_WAY))
    last = few.histories == anchor.histories
    found = _about(problem, found, first_of(few))
    for _ in range(MAX_ANCHORS - 1):
        before, found = found, _about(problem, found, few)
        move = moved(found, before, problem.unknowns.model_paths)
        if found.converged and move <= (ANCHOR_MOVE if last else NEAR):
            break
    if not last and total_chi2(found) < beside + OF_TWO_RUNS:
        found = _about(problem, found, anchor)
    return thawed(found, problem)


def about_itself(found: Fit) -> Fit:
    """The fit from where it ended, about Monte Carlo there. ValueError where it is about none."""
    if found.problem.anchor is None:
        raise ValueError("a fit without an anchor is about no Monte Carlo")
    return thawed(_about(found.problem, found, found.problem.anchor), found.problem)


def _about(problem: Problem, found: Fit, anchor: Anchored) -> Fit:
    """The fit from where another ended, with the anchor moved to there."""
    there = replace(anchor, model=found.model, poses=tuple(found.poses.values()))
    here = replace(thawed(found, problem).problem, anchor=there)
    return refitted(frozen_at(here, found.values), found.values, STEPS)


def fitted_anew(problem: Problem, start: Mapping[str, float]) -> Fit | None:
    """The fit from these values by the twin, then about Monte Carlo of its own; None where there is no Monte Carlo.

    What made up for a missing effect leads the long way back only where nothing but the twin has a say.
    """
    if not has_monte_carlo(problem):
        return None
    return about_its_own(problem, by_twin(problem, start))


def has_monte_carlo(problem: Problem) -> bool:
    """Whether its anchor is one."""
    return problem.anchor is not None and problem.anchor.histories > 0


def total_chi2(fit: Fit) -> float:
    """Of data and priors."""
    return fit.chi2 + prior_chi2(fit.problem.unknowns.parameters, fit.values)


def thawed(found: Fit, problem: Problem) -> Fit:
    """A fit whose derivatives are no longer frozen, but those of a problem's predictors."""
    own = replace(found.problem, predictor=problem.predictor, predict_curves=problem.predict_curves)
    return replace(found, problem=own)
