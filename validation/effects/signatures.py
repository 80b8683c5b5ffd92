"""What an effect's parameters do to images and curves where the effect is absent: columns, and angles between them.

    signature   (prediction with the effect moved by +h - by -h) / 2h, h in the score variable v: p, or p^2
    projected   whitened by the camera's noise; what calibration and nuisances can imitate taken out

Whole predictions are moved, so an effect's own code is never asked for a derivative. Where the twin cannot represent
an effect, Monte Carlo runs at each moved model with the same random numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectParameter, EffectSpec, Value
from luxloop.errors import InputError
from luxloop.model import Model
from validation.effects.known import acting, applied, off_values, with_effect
from validation.fit import Fit
from validation.fit.image_fit import linearised
from validation.fit.least_squares import basis
from validation.fit.parameters import free_paths, gain_of, unknowns_of
from validation.fit.problem import ImagePredictor, Problem
from validation.fit.start import start_values
from validation.fit.whitening import Whitening
from validation.measured import MeasuredImage
from validation.prediction import Anchored, Curve, Predictor, View
from validation.prediction.differences import stencil

Real = NDArray[np.float64]

STEP_SHARE = {"value": 0.1, "square": 0.04}
"""Of the way from off to the end of the range, in the score variable: 0.04 of its square is 0.2 of a width."""
HISTORIES = 1_000_000
"""Of Monte Carlo, for each sample, where the twin cannot represent an effect."""
COLUMN_ERROR = 0.08
"""Of what parameters imitate of a column: their columns err by 2 to 4 %, as it does. What is left below is that."""
ROUNDING = 1e-6
"""Of a column, that gains, offsets and poses leave where they imitate it wholly."""


@dataclass(eq=False)
class Sight:
    """Everything that is looked at, and what was already predicted of it: a model is asked for once."""

    predictor: Predictor
    views: Sequence[View] = ()
    curves: Sequence[Curve] = ()
    beyond_twin: frozenset[str] = frozenset()
    """Names of effects that the twin cannot represent (`Known.beyond_twin`)."""
    histories: int = HISTORIES
    seed: int = 1
    _known: dict[tuple[object, ...], tuple[Real, ...]] = field(default_factory=dict)

    def parts(
        self, model: Model, traced: bool = False, views: Sequence[int] | None = None, lender: Model | None = None
    ) -> tuple[Real, ...]:
        """The images (row, column) of the views, then the curves (row,), as the model has them.

        Parameters
        ----------
        traced : by Monte Carlo, even where the twin would do. views : numbers of those wanted, default all; others 0.
        lender : whose chips' exits stand for those of a chip near them, so that what was moved has no new noise.
        """
        wanted = tuple(range(len(self.views)) if views is None else views)
        traced = traced or any(effect.name in self.beyond_twin for effect in model.effects)
        anchor = Anchored(model, self.histories, self.seed) if traced else Anchored(lender or model, 0)
        key = (model.sha256, anchor.model.sha256, traced, wanted)
        if key not in self._known:
            self._known[key] = (*self._images(model, anchor, wanted), *self._curves(model))
        return self._known[key]

    def _images(self, model: Model, anchor: Anchored, wanted: Sequence[int]) -> Iterator[Real]:
        asked = [self.views[number] for number in wanted]
        found = self.predictor.images(model, asked, (), anchor) if asked else []
        by_view = dict(zip(wanted, found, strict=True))
        for number, view in enumerate(self.views):
            nothing = np.zeros((view.rows, view.columns))
            yield by_view[number].irradiance_per_mm2 if number in by_view else nothing

    def _curves(self, model: Model) -> Iterator[Real]:
        if self.curves:
            yield from (found.value for found in self.predictor.spectra(model, self.curves))


@dataclass(frozen=True, eq=False)
class Column:
    """The derivative of everything in sight by one parameter of an effect, or by that of one chip."""

    effect: str
    parameter: str
    shape: Mapping[str, Value]
    chip: int | None
    step: float
    """In the score variable."""
    parts: tuple[Real, ...]
    """Images in 1/mm2, then curves, per the score variable: the parameter's own unit, or its square."""


def signature(
    sight: Sight, model: Model, spec: EffectSpec, shape: Mapping[str, Value] | None = None, scale: float = 1.0
) -> list[Column]:
    """The columns of an effect: one for each parameter with an off value, of a parameter per chip one for each chip.

    Parameters
    ----------
    model : an effect of that name in it stays at its values, and is moved from there; else it is moved from off.
    shape : of its parameters without an off value; default: the middle of their grids (`known.shapes_of`).
    scale : of the steps, to see whether a derivative is stable.

    Raises
    ------
    RemoteError : what a worker refuses.
    """
    columns = []
    for one in acting(spec):
        for chips, views in _modules(sight, one):
            for chip in range(chips) if one.per_chip else (None,):
                moving = _Moving(sight, model, spec, one, dict(shape or {}), chips, chip, views)
                columns.append(_column(moving, scale))
    return columns


@dataclass(frozen=True, eq=False)
class _Moving:
    """A parameter that is moved: of which effect, of which chip, in which views."""

    sight: Sight
    model: Model
    spec: EffectSpec
    one: EffectParameter
    shape: dict[str, Value]
    chips: int
    chip: int | None
    views: Sequence[int] | None

    @property
    def start(self) -> dict[str, Value]:
        """The values that it starts from: those in the model, or off."""
        present = next((e.parameters for e in self.model.effects if e.name == self.spec.name), {})
        return off_values(self.spec, self.shape, self.chips) | dict(present)

    @property
    def value(self) -> float:
        """Where the parameter itself starts."""
        value = self.start[self.one.name]
        return float(value[self.chip or 0] if isinstance(value, tuple) else value)

    def moved(self, by: float) -> tuple[Real, ...]:
        """What is seen after a step in the score variable. Raises InputError where that leaves the range."""
        if not by:
            return self.sight.parts(self.model, not self.spec.twin, self.views)
        return self.sight.parts(self._model(self._value(by)), not self.spec.twin, self.views, self.model)

    def _value(self, by: float) -> float:
        value, off = self.value, float(self.one.off or 0.0)
        if self.one.score_variable == "square":
            square = (value - off) ** 2 + by
            if square < 0.0:
                raise InputError(self.one.name, square, "a square from 0 on")
            value = off + float(np.sqrt(square))
        else:
            value += by
        self.one.refuse_outside(value)
        return value

    def _model(self, value: float) -> Model:
        values = self.start
        several = values[self.one.name]
        if isinstance(several, tuple):
            values[self.one.name] = tuple(value if n == self.chip else old for n, old in enumerate(several))
        else:
            values[self.one.name] = value
        return with_effect(self.model, applied(self.spec, values))


def _column(moving: _Moving, scale: float) -> Column:
    one = moving.one
    room = [abs(float(end or 0.0) - float(one.off or 0.0)) for end in (one.lower, one.upper)]
    reach = min(room) if min(room) > 0.0 else max(room)
    square = one.score_variable == "square"
    step = scale * STEP_SHARE[one.score_variable] * (max(room) ** 2 if square else reach)
    parts = [np.zeros_like(part) for part in moving.moved(0.0)]
    for weight, seen in stencil(moving.moved, step, f"effects.{moving.spec.name}.{one.name}"):
        for part, moved in zip(parts, seen, strict=True):
            part += weight * moved
    return Column(moving.spec.name, one.name, moving.shape, moving.chip, step, tuple(parts))


def _modules(sight: Sight, one: EffectParameter) -> Iterator[tuple[int, Sequence[int] | None]]:
    """How many chips, and the views of modules that have so many; once and all views for a parameter of no chip."""
    if not one.per_chip:
        yield 0, None
        return
    counts = [view.sample.rows * view.sample.columns if view.sample.layout == "array" else 1 for view in sight.views]
    for chips in sorted(set(counts) - {1}):
        yield chips, [number for number, count in enumerate(counts) if count == chips]


# What calibration and nuisances cannot imitate


@dataclass(frozen=True, eq=False)
class Projection:
    """How columns become rows of unit noise, and what is taken out of them."""

    whitening: Whitening
    gains: tuple[float, ...]
    scales: tuple[float, ...]
    """Of curves."""
    taken: Real
    """(row, direction), orthonormal: what gains, offsets, poses and free parameters can imitate."""
    nuisances: Real | None = None
    """The same for gains, offsets and poses alone, which are known without error; None: they are all of it."""

    @classmethod
    def of(cls, fit: Fit) -> Projection:
        """About a fit."""
        gains = tuple(fit.gains[image.shot.id] for image in fit.problem.images)
        scales = tuple(fit.value(f"{c.id}.scale") if c.free_scale else 1.0 for c in fit.problem.curves)
        alone = basis(fit.columns, fit.reduced, fit.active & _nuisances(fit.problem)).data
        return cls(fit.whitening, gains, scales, fit.basis.data, alone)

    @classmethod
    def at(cls, model: Model, images: Sequence[MeasuredImage], predictor: ImagePredictor) -> Projection:
        """About a model as it stands, its gains and offsets fitted linearly; what it frees may move."""
        problem = Problem(model, unknowns_of(model, free_paths(model), images), tuple(images), predictor)
        evaluation = problem.evaluate(start_values(problem, {}))
        white, reduced, columns = linearised(evaluation)
        gains = tuple(gain_of(image, evaluation.by_name) for image in images)
        taken = (basis(columns, reduced, mask).data for mask in (np.ones(len(columns), bool), _nuisances(problem)))
        return cls(white, gains, (), *taken)

    def rows(self, column: Column) -> Real:
        """Its parts in standard deviations, one after the other; nothing taken out yet."""
        count = len(self.gains)
        images = [gain * part for gain, part in zip(self.gains, column.parts[:count], strict=True)]
        rows = [self.whitening.rows(images)] if images else []
        for scale, part, sigma in zip(self.scales, column.parts[count:], self.whitening.curve_sigma, strict=True):
            rows.append(scale * part / sigma)
        return np.concatenate(rows)


def _nuisances(problem: Problem) -> NDArray[np.bool_]:
    """Which unknowns are no parameters of the model or of films."""
    parameters = {*problem.unknowns.model_paths, *problem.unknowns.other_paths}
    return np.array([name not in parameters for name in problem.unknowns.names])


def projected(columns: Sequence[Column], projection: Projection) -> Real:
    """(column, row): whitened columns without what calibration and nuisances can imitate; 0 where it is all."""
    if not columns:
        return np.zeros((0, len(projection.taken)))
    found = np.array([projection.rows(column) for column in columns])
    left = found - (found @ projection.taken) @ projection.taken.T
    alone = projection.taken if projection.nuisances is None else projection.nuisances
    in_all, in_alone = (np.sum((found @ part) ** 2, axis=1) for part in (projection.taken, alone))
    noise = COLUMN_ERROR * np.sqrt(np.maximum(in_all - in_alone, 0.0)) + ROUNDING * np.linalg.norm(found, axis=1)
    left[np.linalg.norm(left, axis=1) < noise] = 0.0
    return np.asarray(left)
