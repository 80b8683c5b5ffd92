"""A predictor whose derivatives stay as they were: what makes a refit with one effect more quick.

The images are asked for at every step, so where the fit ends is right whatever the derivatives are; they only say
where to go, and how sure the end is. Poses are differentiated on each image's own map, as always. An effect whose
image goes with its square has the slope 2 p times that of p^2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import Value
from luxloop.model import Model
from validation.fit import CurveData, Fit
from validation.fit.problem import CurvePredictor, Evaluation, ImagePredictor, Problem
from validation.prediction import Anchored, Predicted, PredictedCurve, View
from validation.sample_values import is_by_sample, members

Real = NDArray[np.float64]

Samples = Mapping[str, Mapping[str, Mapping[str, Value]]]
Slopes = Mapping[str, Sequence[Real]]
"""By path: derivatives of the images in 1/mm^2, then of the curves."""


@dataclass(frozen=True, eq=False)
class FrozenImages:
    """Images as a predictor has them, with given derivatives by the model's parameters."""

    predictor: ImagePredictor
    slopes: Slopes
    squares: frozenset[str]
    """Paths whose slopes are by the square."""
    lines: frozenset[str] = frozenset()
    """Effects that the twin cannot represent: the image is a straight line from where the anchor has them."""
    others: Callable[[], Slopes] | None = None
    """The same slopes by the exits of another walk inside the chips, asked for by who needs them; none: the same
    stand in for them."""
    exit_seed: int = 1
    """Of the walk of `slopes`."""

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """The images of all views of the problem, in its order; its predictor's derivatives where none are given."""
        asked, along = self._as_anchored(model, anchor)
        wanted = [path for path in paths if path in self.slopes]
        found = self.predictor.images(asked, views, [path for path in paths if path not in wanted], anchor)
        factors = {path: _factor(model, path, self.squares) for path in wanted}
        same = self.others is None or not wanted or _walk(anchor) == self.exit_seed
        walk = self.slopes if same or self.others is None else self.others()
        affected = []
        for number, one in enumerate(found):
            slopes = {path: factors[path] * walk[path][number] for path in wanted}
            added = sum((by * self.slopes[path][number] for path, by in along.items() if by), np.zeros(1))
            twin = None if one.twin_per_mm2 is None else one.twin_per_mm2 + added
            affected.append(
                replace(
                    one,
                    irradiance_per_mm2=one.irradiance_per_mm2 + added,
                    twin_per_mm2=twin,
                    jacobian_per_mm2=one.jacobian_per_mm2 | slopes,
                )
            )
        return affected

    def _as_anchored(self, model: Model, anchor: Anchored | None) -> tuple[Model, dict[str, float]]:
        """The model with its lines as the anchor has them, and how far each path has gone from there."""
        if not self.lines:
            return model, {}
        there = {} if anchor is None else {effect.name: effect for effect in anchor.model.effects}
        kept = [there.get(one.name) if one.name in self.lines else one for one in model.effects]
        samples = self._samples_as_anchored(model, {} if anchor is None else anchor.model.samples)
        effects = tuple(one for one in kept if one is not None)
        # what samples have of their own is known by its table of limits
        limits = {path: one for path, one in model.fit.items() if is_by_sample(model, path)}
        asked = model.model_copy(update={"effects": effects, "samples": samples, "fit": limits})
        here, at = _numbers(model), {} if anchor is None else _numbers(anchor.model)
        along = {}
        for path in self.slopes:
            if path in here and here[path][0] in self.lines:
                power = 2 if path in self.squares else 1
                before = at[path][1] if path in at else 0.0
                along[path] = here[path][1] ** power - before**power
        return asked, along

    def _samples_as_anchored(self, model: Model, there: Samples) -> Samples:
        """What samples have of their own, its lines as at the anchor."""
        found = {}
        for sample in {**model.samples, **there}:
            own = {name: one for name, one in model.samples.get(sample, {}).items() if name not in self.lines}
            found[sample] = own | {name: one for name, one in there.get(sample, {}).items() if name in self.lines}
        return found


@dataclass(frozen=True, eq=False)
class FrozenCurves:
    """Curves as their predictor has them, with given derivatives by effects; those by films are its own."""

    predict: CurvePredictor
    slopes: Slopes
    squares: frozenset[str]
    images: int
    """How many images come before the curves in the slopes."""

    def __call__(
        self, model: Model, curves: Sequence[CurveData], paths: Sequence[str], others: Mapping[str, float]
    ) -> list[PredictedCurve]:
        """The curves of the problem, in its order."""
        frozen = [path for path in paths if path in self.slopes]
        found = self.predict(model, curves, [path for path in paths if path not in frozen], others)
        factors = {path: _factor(model, path, self.squares) for path in frozen}
        return [
            replace(
                one,
                jacobian=one.jacobian
                | {path: factors[path] * self.slopes[path][self.images + number] for path in frozen},
            )
            for number, one in enumerate(found)
        ]


def slopes_of(fit: Fit) -> dict[str, list[Real]]:
    """The derivatives at a fit, by path of the model."""
    at = fit.problem.evaluate(fit.values)
    return _slopes(at, at.predicted)


def frozen_at(problem: Problem, values: Real) -> Problem:
    """The problem with the derivatives by its model that it has at these values, those of a second walk too.

    Straight lines stay the lines that they are.
    """
    at, own = problem.evaluate(values), problem.predictor
    lines = own if isinstance(own, FrozenImages) and own.lines else FrozenImages(own, {}, frozenset())
    names = _numbers(problem.model)
    kept = {path: slope for path, slope in lines.slopes.items() if path in names and names[path][0] in lines.lines}
    slopes, others = _slopes(at, at.predicted), cache(lambda: {**_slopes(at, at.others()), **kept})
    images = replace(lines, slopes={**slopes, **kept}, others=others, exit_seed=_walk(problem.anchor))
    curves = problem.predict_curves
    frozen = None if curves is None else FrozenCurves(curves, slopes, frozenset(), len(problem.images))
    return replace(problem, predictor=images, predict_curves=frozen)


def without(problem: Problem, path: str) -> Problem:
    """A problem that is frozen, but for the derivatives by one path, which are asked for again."""
    images, curves = problem.predictor, problem.predict_curves
    if isinstance(images, FrozenImages):
        known = images.others
        others = None if known is None else cache(lambda: _but(known(), path))
        images = replace(images, slopes=_but(images.slopes, path), others=others)
    if isinstance(curves, FrozenCurves):
        curves = replace(curves, slopes=_but(curves.slopes, path))
    return replace(problem, predictor=images, predict_curves=curves)


def _but(slopes: Slopes, path: str) -> Slopes:
    return {name: slope for name, slope in slopes.items() if name != path}


def _slopes(at: Evaluation, images: Sequence[Predicted]) -> dict[str, list[Real]]:
    return {
        path: [
            *(one.jacobian_per_mm2[path] for one in images),
            *(one.jacobian.get(path, np.zeros_like(one.value)) for one in at.predicted_curves),
        ]
        for path in at.problem.unknowns.model_paths
    }


def _walk(anchor: Anchored | None) -> int:
    return 1 if anchor is None else anchor.exit_seed


def _factor(model: Model, path: str, squares: frozenset[str]) -> float:
    return 2.0 * _numbers(model)[path][1] if path in squares else 1.0


def _numbers(model: Model) -> dict[str, tuple[str, float]]:
    """The numbers of effects, those of single samples among them, with the effect's name, by path."""
    common = {
        f"effects.{one.name}.{name}": (one.name, value)
        for one in model.effects
        for name, value in one.parameters.items()
        if isinstance(value, float)
    }
    return common | {path: (member.effect, value) for path, (member, value) in members(model).items()}
