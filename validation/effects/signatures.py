"""What an effect's parameters do to images and curves where the effect is absent: columns, and angles between them.

    signature   (prediction with the effect moved by +h - by -h) / 2h, h in the score variable v: p, or p^2
    projected   whitened by the camera's noise; what calibration and nuisances can imitate taken out

Whole predictions are moved, so an effect's own code is never asked for a derivative. Where the twin cannot represent
an effect, Monte Carlo runs at each moved model with the same random numbers; twice with others, and what both agree
about is the column: of walls at a module's edge a single difference is mostly noise, whose energy dilutes the effect.
Where light takes other ways inside the chips with each value, the twin's walks are two in the same way.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectParameter, EffectSpec, Value
from luxloop.errors import InputError
from luxloop.model import Model
from validation.dataset.manifest import Sample
from validation.effects.agreed import agreed
from validation.effects.known import NEAR_OFF, acting, applied, is_smooth, off_values, with_effect
from validation.fit import Fit
from validation.fit.descent import linearised
from validation.fit.least_squares import Basis, basis
from validation.fit.parameters import free_paths, gain_of, unknowns_of
from validation.fit.problem import ImagePredictor, Problem
from validation.fit.start import start_values
from validation.fit.whitening import Whitening
from validation.measured import MeasuredImage
from validation.prediction import Anchored, Curve, Predictor, View
from validation.prediction.differences import Moved, stencil
from validation.sample_values import of_sample, with_sample, without

Real = NDArray[np.float64]

STEP_SHARE = {"value": 0.1, "square": 0.04}
"""Of the way from off to the end of the range, in the score variable: 0.04 of its square is 0.2 of a width. By Monte
Carlo steps are as long as the range allows."""
FILM_STEPS = 0.1
"""Of these steps, where only films are in sight: curves have no noise, and delta bends within a part of such."""
LEAST_ROOM = 0.1
"""Of a parameter's range: with less to its nearer end, steps go to the other one only."""
HISTORIES, RUNS = 500_000, 2
"""Of Monte Carlo, for each sample, where the twin cannot represent an effect: of each of so many runs."""
ALONE = 0.25
"""Of these, for a single chip, which lights its image with all of them: as bright an image of 5 x 5 chips has 18
times the noise variance (decision 45)."""
COLUMN_ERROR = 0.08
"""Of what parameters imitate of a column: their columns err by 2 to 4 %, as it does. What is left below is that."""
ROUNDING, FILM_ROUNDING = 1e-6, 2e-3
"""Of a column, that gains, offsets and poses leave where they imitate it wholly; that thickness and index of a film
do, whose columns are differences of exact curves."""


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
    run: int | None = None
    """Of Monte Carlo, or of walks: what this one says, noise and all; None: what all of them agree about."""
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
        (found,) = self.parts_of([model], traced, views, lender)
        return found

    def parts_of(
        self,
        models: Sequence[Model],
        traced: bool = False,
        views: Sequence[int] | None = None,
        lender: Model | None = None,
        run: int = 0,
    ) -> list[tuple[Real, ...]]:
        """The same of several models, asked for together; by which run of Monte Carlo, or of the twin's walks.

        All are lent the exits of one: the lender's, or the first model's. Curves are the same in every run.
        """
        wanted = tuple(range(len(self.views)) if views is None else views)
        traced = traced or self._is_beyond_twin(models)
        lent = "" if traced else (lender or models[0]).sha256
        keys = [(model.sha256, run, lent, wanted) for model in models]
        new = {key: model for key, model in zip(keys, models, strict=True) if key not in self._known}
        if new:
            images = (
                self._traced(new.values(), wanted, run)
                if traced
                else self._of_twin(new.values(), wanted, lender or models[0], 1 + run)
            )
            for (key, model), seen in zip(new.items(), images, strict=True):
                self._known[key] = (*self._placed(seen, wanted), *self._curves(model))
        return [self._known[key] for key in keys]

    def summed(
        self,
        weighted: Sequence[Moved[Model]],
        traced: bool = False,
        views: Sequence[int] | None = None,
        lender: Model | None = None,
        *,
        walks: bool = False,
    ) -> tuple[Real, ...]:
        """The parts of models times their weights, added up; by Monte Carlo what two runs of it agree about.

        `walks` : the twin's walks inside chips are two, too.
        """
        models, runs = [one.what for one in weighted], []
        several = range(RUNS if traced or walks or self._is_beyond_twin(models) else 1)
        for run in several if self.run is None else [self.run]:
            seen = self.parts_of(models, traced, views, lender, run)
            parts = [[one.weight * part for part in found] for one, found in zip(weighted, seen, strict=True)]
            runs.append([np.asarray(sum(of_models)) for of_models in zip(*parts, strict=True)])
        first, *others = runs
        count = len(self.views)
        images = first[:count] if not others else [agreed(*of) for of in zip(first[:count], *others, strict=True)]
        return (*images, *first[count:])

    def at(self, model: Model, spec: EffectSpec) -> Model:
        """The model at which the column of an effect is taken.

        Of one that the twin represents without those that it cannot: what a tilt does to the column of another effect
        is of second order, and with it all columns would be by Monte Carlo.
        """
        if spec.twin:
            for one in model.effects:
                model = without(model, one.name) if one.name in self.beyond_twin else model
        return model

    def _is_beyond_twin(self, models: Iterable[Model]) -> bool:
        return any(one.name in self.beyond_twin for model in models for one in model.effects)

    def _traced(self, models: Iterable[Model], wanted: Sequence[int], run: int) -> Iterator[list[Real]]:
        asked = [self.views[number] for number in wanted]
        enough, seed = enough_of(asked, self.histories), self.seed + run
        for model in models:
            anchor = Anchored(model, self.histories, seed, exit_seed=1 + run, stored_exits=True, enough=enough)
            found = self.predictor.images(model, asked, (), anchor) if asked else []
            yield [one.irradiance_per_mm2 for one in found]

    def _of_twin(
        self, models: Iterable[Model], wanted: Sequence[int], lender: Model, exit_seed: int
    ) -> Iterator[list[Real]]:
        several = list(models)
        pairs = [(model, self.views[number]) for model in several for number in wanted]
        found = self.predictor.several(pairs, lender, exit_seed) if pairs else []
        count = len(wanted)
        yield from (found[first * count : (first + 1) * count] for first in range(len(several)))

    def _placed(self, seen: Sequence[Real], wanted: Sequence[int]) -> Iterator[Real]:
        """An image for each view; dark where it was not wanted."""
        by_view = dict(zip(wanted, seen, strict=True))
        for number, view in enumerate(self.views):
            yield by_view.get(number, np.zeros((view.rows, view.columns)))

    def _curves(self, model: Model) -> Iterator[Real]:
        if self.curves:
            yield from (found.value for found in self.predictor.spectra(model, self.curves))


@dataclass(frozen=True, eq=False)
class Column:
    """The derivative of everything in sight by one parameter of an effect, or by that of one chip of one sample."""

    effect: str
    parameter: str
    shape: Mapping[str, Value]
    chip: int | None
    step: float
    """In the score variable."""
    parts: tuple[Real, ...]
    """Images in 1/mm2, then curves, per the score variable: the parameter's own unit, or its square."""
    sample: str = ""
    """Whose own value is moved; "": one value holds for all."""


def signature(
    sight: Sight,
    model: Model,
    spec: EffectSpec,
    shape: Mapping[str, Value] | None = None,
    scale: float = 1.0,
    *,
    apart: bool = False,
) -> list[Column]:
    """The columns of an effect: one for each parameter with an off value; of one per chip for each chip and sample.

    Parameters
    ----------
    model : an effect of that name in it stays at its values, and is moved from there; else it is moved from off.
    shape : of its parameters without an off value; default: the middle of their grids (`known.shapes_of`).
    scale : of the steps, to see whether a derivative is stable.
    apart : each sample has a value of its own of every parameter, so a column too.

    Raises
    ------
    RemoteError : what a worker refuses.
    """
    columns: list[Column] = []
    scale *= 1.0 if sight.views else FILM_STEPS
    for one in acting(spec):
        for sample, chips, views in _modules(sight, one, apart):
            several = range(chips) if one.per_chip else (None,)
            moving = [_Moving(model, spec, one, dict(shape or {}), chips, chip, sample) for chip in several]
            columns += _columns(sight, moving, views, scale)
    return columns


@dataclass(frozen=True, eq=False)
class _Moving:
    """A parameter that is moved: of which effect, of which chip, of which sample ("": of all)."""

    model: Model
    spec: EffectSpec
    one: EffectParameter
    shape: dict[str, Value]
    chips: int
    chip: int | None
    sample: str

    @property
    def start(self) -> dict[str, Value]:
        """The values that it starts from: those in the model, or off."""
        effects = of_sample(self.model, self.sample).effects
        present = next((one.parameters for one in effects if one.name == self.spec.name), {})
        written = {name: value for name, value in present.items() if value != ()}
        return off_values(self.spec, self.shape, self.chips) | written

    @property
    def value(self) -> float:
        """Where the parameter itself starts."""
        value = self.start[self.one.name]
        return float(value[self.chip or 0] if isinstance(value, tuple) else value)

    def moved(self, by: float) -> Model:
        """The model after a step in the score variable. Raises InputError where that leaves the range."""
        return self._model(self._value(by)) if by else self.model

    def moved_nearly(self, by: float, step: float) -> Model:
        """The same; off itself is left out for a value as near to it as shows nothing, on the side of the step."""
        return self.moved(by + NEAR_OFF * step if self._value(by) == self.one.off else by)

    def step(self, scale: float) -> float:
        """In the score variable."""
        one = self.one
        room = [abs(float(end or 0.0) - float(one.off or 0.0)) for end in (one.lower, one.upper)]
        both, square = min(room) > 0.0, one.score_variable == "square"
        whole = max(room) ** 2 if square else min(room) if both else max(room)
        if is_smooth(self.spec) and not self.spec.by_chance:
            return scale * STEP_SHARE[one.score_variable] * whole
        # short steps would leave the noise of Monte Carlo, or of a few rays, and little else: as far as there is room
        longest = whole * (1.0 if both and not square else 0.5)
        return min(scale, 1.0) * (longest if square else min(longest, self._room))

    @property
    def _room(self) -> float:
        """How long a step may be from where the parameter stands: to both sides, near an end two to the other one."""
        lower, upper = float(self.one.lower or 0.0), float(self.one.upper or 0.0)
        near, far = sorted((self.value - lower, upper - self.value))
        return near if near >= LEAST_ROOM * (upper - lower) else far / 2.0

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
        if not self.sample:
            return with_effect(self.model, applied(self.spec, values))
        has = any(one.name == self.spec.name for one in self.model.effects)
        model = self.model if has else with_effect(self.model, applied(self.spec, off_values(self.spec, self.shape)))
        return with_sample(model, self.sample, self.spec.name, values)


def _columns(sight: Sight, moving: Sequence[_Moving], views: Sequence[int] | None, scale: float) -> Iterator[Column]:
    """The columns of parameters, or of the chips of one, of one effect: all moved models are asked for together."""
    steps = [_stencil(one, one.step(scale)) for one in moving]
    models = [step.what for several in steps for step in several]
    spec, lender = moving[0].spec, moving[0].model
    traced = not spec.twin
    for run in range(1 if is_smooth(spec) else RUNS) if sight.run is None else [sight.run]:
        sight.parts_of(models, traced, views, lender, run)
    for one, several in zip(moving, steps, strict=True):
        parts = sight.summed(several, traced, views, lender, walks=spec.walks)
        yield Column(one.spec.name, one.one.name, one.shape, one.chip, one.step(scale), parts, one.sample)


def _stencil(one: _Moving, step: float) -> list[Moved[Model]]:
    """Where a parameter is moved to, with which weights."""
    name = f"effects.{one.spec.name}.{one.one.name}"
    if not one.spec.walks:
        return stencil(one.moved, step, name)
    up = float(one.one.upper or 0.0) > float(one.one.off or 0.0)
    return stencil(lambda by: one.moved_nearly(by, step if up else -step), step, name)


def _modules(sight: Sight, one: EffectParameter, apart: bool) -> Iterator[tuple[str, int, Sequence[int] | None]]:
    """Each sample, its chips and its views; once and all views for a parameter that all have in common."""
    if not one.per_chip and not apart:
        yield "", 0, None
        return
    for sample in {view.sample.id: view.sample for view in sight.views}.values():
        chips = _chips(sample)
        if chips > 1 or not one.per_chip:  # the power of a single chip is its image's gain
            yield sample.id, chips, [number for number, view in enumerate(sight.views) if view.sample.id == sample.id]


def enough_of(views: Sequence[View], histories: int) -> tuple[tuple[str, int], ...]:
    """Histories of those samples whose images are as quiet with fewer, by id, for an anchor of so many."""
    alone = {view.sample.id: int(ALONE * histories) for view in views if _chips(view.sample) == 1}
    return tuple(alone.items())


def _chips(sample: Sample) -> int:
    return sample.rows * sample.columns if sample.layout == "array" else 1


# What calibration and nuisances cannot imitate


@dataclass(frozen=True, eq=False)
class Projection:
    """How columns become rows of unit noise, and what is taken out of them."""

    whitening: Whitening
    gains: tuple[float, ...]
    scales: tuple[float, ...]
    """Of curves."""
    taken: Basis
    """What gains, offsets, poses and free parameters can imitate."""
    nuisances: Basis | None = None
    """The same for gains, offsets, poses and films' own alone, whose columns are exact; None: they are all of it."""

    @classmethod
    def of(cls, fit: Fit) -> Projection:
        """About a fit."""
        gains = tuple(fit.gains[image.shot.id] for image in fit.problem.images)
        scales = tuple(fit.value(f"{c.id}.scale") if c.free_scale else 1.0 for c in fit.problem.curves)
        alone = basis(fit.columns, fit.reduced, fit.active & _nuisances(fit.problem))
        return cls(fit.whitening, gains, scales, fit.basis, alone)

    @classmethod
    def at(cls, model: Model, images: Sequence[MeasuredImage], predictor: ImagePredictor) -> Projection:
        """About a model as it stands, its gains and offsets fitted linearly; what it frees may move."""
        problem = Problem(model, unknowns_of(model, free_paths(model), images), tuple(images), predictor)
        evaluation = problem.evaluate(start_values(problem, {}))
        white, reduced, columns = linearised(evaluation)
        gains = tuple(gain_of(image, evaluation.by_name) for image in images)
        taken = (basis(columns, reduced, mask) for mask in (np.ones(len(columns), bool), _nuisances(problem)))
        return cls(white, gains, (), *taken)

    @classmethod
    def of_curves(
        cls, model: Model, curves: Sequence[Curve], sigma: Sequence[Real], paths: Sequence[str], predictor: Predictor
    ) -> Projection:
        """About curves of films as they stand, (row,) errors each; the films' parameters at these paths may move."""
        found = predictor.spectra(model, curves, paths)
        columns = [
            np.concatenate([one.jacobian[path] / error for one, error in zip(found, sigma, strict=True)])
            for path in paths
        ]
        rows = sum(map(len, sigma))
        taken, _ = np.linalg.qr(np.array(columns).reshape(len(paths), rows).T)
        free = Basis(taken, np.zeros((0, len(paths))))
        return cls(Whitening((), (), (), (), tuple(sigma)), (), (1.0,) * len(curves), free)

    def rows(self, column: Column) -> Real:
        """Its parts in standard deviations, one after the other; nothing taken out yet."""
        count = len(self.gains)
        images = [gain * part for gain, part in zip(self.gains, column.parts[:count], strict=True)]
        rows = [self.whitening.rows(images)] if images else []
        for scale, part, sigma in zip(self.scales, column.parts[count:], self.whitening.curve_sigma, strict=True):
            rows.append(scale * part / sigma)
        return np.concatenate(rows)


def _nuisances(problem: Problem) -> NDArray[np.bool_]:
    """Which unknowns are no parameters of the model, whose columns are by exits."""
    return np.array([name not in problem.unknowns.model_paths for name in problem.unknowns.names], bool)


def projected(columns: Sequence[Column], projection: Projection) -> Real:
    """(column, row): whitened columns without what calibration and nuisances can imitate (`Basis.left`); 0 where it
    is all."""
    taken = projection.taken
    if not columns:
        return np.zeros((0, len(taken.data) + len(taken.prior)))
    found = np.array([projection.rows(column) for column in columns])
    left = taken.left(found)
    in_all, in_alone = (np.sum((found @ one.data) ** 2, axis=1) for one in (taken, projection.nuisances or taken))
    rounding = ROUNDING if projection.gains else FILM_ROUNDING
    noise = COLUMN_ERROR * np.sqrt(np.maximum(in_all - in_alone, 0.0)) + rounding * np.linalg.norm(found, axis=1)
    left[np.linalg.norm(left, axis=1) < noise] = 0.0
    return np.asarray(left)
