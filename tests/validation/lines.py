"""Curves that are sums of parameters times shapes: what their fit finds is known in closed form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from luxloop.model import Model
from tests.validation.analytic import TRUTH, Spots
from validation.fit import CurveData, Fit, Parameter, fit
from validation.prediction import PredictedCurve

Real = NDArray[np.float64]
SIGMA = 0.01
"""Standard deviation of every value, where no other is told."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Predicts curves by name: of each the shapes (row,) by parameter, as many of them as the curve has values."""

    shapes: Mapping[str, Mapping[str, Real]]
    error: Real | None = None

    def __call__(
        self,
        model: Model,  # noqa: ARG002  # a predictor's
        curves: Sequence[CurveData],
        paths: Sequence[str],  # noqa: ARG002  # likewise
        others: Mapping[str, float],
    ) -> list[PredictedCurve]:
        """The curves with their derivatives."""
        found = []
        for one in curves:
            shapes = {name: shape[: len(one.value)] for name, shape in self.shapes[one.id].items()}
            value = sum((others[name] * shape for name, shape in shapes.items()), np.zeros(len(one.value)))
            found.append(PredictedCurve(np.asarray(value), shapes, self.error))
        return found


def fit_of_lines(
    shapes: Mapping[str, Mapping[str, Real]],
    values: Mapping[str, Real],
    parameters: Sequence[Parameter],
    error: Real | None = None,
) -> Fit:
    """The fit of curves alone; `error`: of the prediction itself."""
    curves = [CurveData(name, value, np.full(len(value), SIGMA)) for name, value in values.items()]
    predict = Lines(shapes, error)
    return fit(TRUTH, [], Spots(), free=(), curves=curves, predict_curves=predict, others=parameters)


def noisy(random: np.random.Generator, truth: Real) -> Real:
    """With the noise of a curve."""
    return np.asarray(truth + SIGMA * random.standard_normal(len(truth)))
