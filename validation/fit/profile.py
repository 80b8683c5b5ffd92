"""The profile of a parameter: chi2 along it, all others refitted, so that a curved or one-sided valley is seen.

A fit solves columns' residual = 0; about a noisy anchor that is not where chi2 is least (`problem`). So chi2 is not
read off along the parameter but summed up from its slope, -2 columns' residual with the others refitted: where the
columns are the prediction's own derivatives the two are the same, and where they are not the valley ends at the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from luxloop.errors import InputError
from validation.fit.descent import linearised
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
    parameter, at = fit.problem.unknowns.parameters[index], fit.value(name)
    wanted = np.unique(np.clip(at + np.append(steps, 0.0) * error, parameter.lower, parameter.upper))
    slopes = [_slope(fit, index, value) for value in wanted]
    chi2 = cumulative_trapezoid(slopes, wanted, initial=0.0)
    chi2 -= chi2[np.argmin(np.abs(wanted - at))]
    return Profile(name, wanted, chi2 / fit.variance_scale, ((wanted - at) / error) ** 2)


def _slope(fit: Fit, index: int, value: float) -> float:
    """How chi2 grows with a parameter at a value of it, the others refitted, under the whitening of the optimum."""
    along = fit.covariance[:, index] / fit.covariance[index, index]  # how the others follow
    moved = fit.values + np.where(np.isfinite(along), along, 0.0) * (value - fit.values[index])
    moved[index] = value
    evaluation = fit.problem.evaluate(fit.problem.unknowns.within(moved))
    _, reduced, _ = linearised(evaluation, fit.whitening)
    way = reduced.step(fixed=~fit.active, bounded=False).change[
        index
    ]  # to where the parameter would go if it were free
    return -2.0 * float(way / reduced.covariance(1.0, fit.active)[index, index])
