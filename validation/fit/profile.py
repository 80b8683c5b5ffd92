"""The profile of a parameter: chi2 along it, all others refitted, so that a curved or one-sided valley is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from validation.fit.image_fit import linearised
from validation.fit.least_squares import prior_chi2
from validation.fit.result import Fit

Real = NDArray[np.float64]

STEPS = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)  # in standard errors


@dataclass(frozen=True, eq=False)
class Profile:
    """Chi2 above its least value along one parameter, priors included and others refitted."""

    name: str
    values: Real
    chi2_above: Real
    parabola: Real  # what the standard error alone would say


def profile(fit: Fit, name: str, steps: Sequence[float] = STEPS) -> Profile:
    """Chi2 along a parameter: the others moved as the linear model says, predicted anew, and moved once more.

    Raises InputError where the fit has no such parameter or the data do not hold it.
    """
    if name not in fit.names:
        raise InputError("parameter", name, ", ".join(fit.names), "one that the fit moved")
    index, error = fit.names.index(name), fit.error(name)
    if not 0.0 < error < np.inf:
        raise InputError("parameter", name, "one that is held by the data and not at a limit", "widen its limits")
    parameter = fit.problem.unknowns.parameters[index]
    wanted = np.unique(np.clip(fit.value(name) + np.array(steps) * error, parameter.lower, parameter.upper))
    base = fit.chi2 + prior_chi2(fit.problem.unknowns.parameters, fit.values)
    chi2 = np.array([_refitted_chi2(fit, index, value) for value in wanted])
    return Profile(name, wanted, (chi2 - base) / fit.variance_scale, ((wanted - fit.value(name)) / error) ** 2)


def _refitted_chi2(fit: Fit, index: int, value: float) -> float:
    """Chi2 with one parameter held at a value, under the whitening of the optimum."""
    along = fit.covariance[:, index] / fit.covariance[index, index]  # how the others follow
    moved = fit.values + np.where(np.isfinite(along), along, 0.0) * (value - fit.values[index])
    moved[index] = value
    held = np.zeros(len(moved), dtype=bool)
    held[index] = True
    evaluation = fit.problem.evaluate(fit.problem.unknowns.within(moved))
    _, reduced, _ = linearised(evaluation, fit.whitening)
    return reduced.step(fixed=held).chi2
