"""The candidates of a diagnosis: every effect at off, in each of its shapes, as whitened columns at a fit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectSpec, Value
from luxloop.errors import InputError, RemoteError
from luxloop.model import Model
from validation.diagnose.score import Candidate
from validation.effects.known import acting, applied, is_smooth, off_values, shapes_of, with_effect
from validation.effects.signatures import Column, Projection, Sight, signature
from validation.fit import Fit
from validation.fit.problem import Problem, sensor_of, view_of
from validation.prediction import Anchored, Predictor
from validation.prediction.catalogue import ON_ALL_LIGHT
from validation.prediction.differences import Moved

Real = NDArray[np.float64]

NO_CHIPS = "no image is of a module of several chips"
"""Why an effect that has a number for each chip has no column: the power of a single one is its image's gain."""


@dataclass(eq=False)
class FitSight(Sight):
    """What a fit sees: its cameras where it found them, its curves with its films."""

    problem: Problem | None = None
    others: Mapping[str, float] = field(default_factory=dict)
    traced: dict[tuple[object, ...], list[Column]] = field(default_factory=dict)
    """By effect and shape: columns by Monte Carlo, of this fit or of one before it; their noise is larger than what
    they change by from one round of a diagnosis to the next."""
    about: Anchored | None = None
    """Whose Monte Carlo the twin's images have besides; none: they are its own."""

    @classmethod
    def of(
        cls,
        fit: Fit,
        predictor: Predictor,
        beyond_twin: frozenset[str] = frozenset(),
        seed: int = 1,
        traced: dict[tuple[object, ...], list[Column]] | None = None,
    ) -> FitSight:
        """About a fit."""
        by_name = fit.problem.unknowns.named(fit.values)
        views = [
            replace(view_of(image, fit.poses[image.shot.id]), sensor=sensor_of(image, by_name))
            for image in fit.problem.images
        ]
        others = {name: by_name[name] for name in fit.problem.unknowns.other_paths}
        known = {} if traced is None else traced
        return cls(predictor, views, (), beyond_twin, seed=seed, problem=fit.problem, others=others, traced=known)

    def closer(self, histories: int, traced: dict[tuple[object, ...], list[Column]]) -> FitSight:
        """The same with so many histories of Monte Carlo, and columns by so many that are known."""
        return replace(self, histories=histories, traced=traced, _known={})

    def signature(self, model: Model, spec: EffectSpec, shape: Mapping[str, Value]) -> list[Column]:
        """The columns of an effect in a shape."""
        if spec.twin:
            sight = self._of_all_light if is_smooth(spec) and spec.stage in ON_ALL_LIGHT else self
            return signature(sight, self.at(model, spec), spec, shape)
        key = (spec.name, *shape.items())
        if key not in self.traced:
            self.traced[key] = signature(self, model, spec, shape)
        return self.traced[key]

    @cached_property
    def _of_all_light(self) -> FitSight:
        """The same of all the light that the fit knows of, where it is about Monte Carlo."""
        anchor = None if self.problem is None else self.problem.anchor
        return self if anchor is None or not anchor.histories else replace(self, about=anchor, _known={})

    def _of_twin(
        self, models: Iterable[Model], wanted: Sequence[int], lender: Model, exit_seed: int
    ) -> Iterator[list[Real]]:
        if self.about is None or len(wanted) < len(self.views):
            yield from super()._of_twin(models, wanted, lender, exit_seed)
            return
        for model in models:
            found = self.predictor.images(model, self.views, (), self.about, noise=False)
            yield [one.irradiance_per_mm2 for one in found]

    def _curves(self, model: Model) -> Iterator[Real]:
        if self.problem is not None and self.problem.curves and self.problem.predict_curves is not None:
            found = self.problem.predict_curves(model, self.problem.curves, (), self.others)
            yield from (one.value for one in found)


def candidates_of(
    fit: Fit,
    effects: Sequence[EffectSpec],
    sight: FitSight,
    heard: Callable[[float, str], None] = lambda *_: None,
    refused: dict[str, str] | None = None,
) -> list[Candidate]:
    """All candidates of these effects.

    Parameters
    ----------
    refused : is told, by name, why an effect cannot be had with these samples (walls where the camera looks beyond
        them, a layer that the film does not have, a number for each chip of single ones); none: a RemoteError is
        raised.
    """
    projection, found = Projection.of(fit), list[Candidate]()
    for number, spec in enumerate(effects):
        heard(number / len(effects), spec.name)
        try:
            own = [one for shape in shapes_of(spec) for one in in_shape(fit, spec, shape, sight, projection)]
        except (InputError, RemoteError) as error:
            if refused is None or (isinstance(error, RemoteError) and error.failure.code != "bad_input"):
                raise
            refused[spec.name] = str(error).removeprefix("bad_input: ")
            continue
        if not own and refused is not None:
            refused[spec.name] = NO_CHIPS
        found += own
    return found


def in_shape(
    fit: Fit, spec: EffectSpec, shape: dict[str, Value], sight: FitSight, projection: Projection
) -> Iterator[Candidate]:
    """The candidates of an effect in one shape: one for each of its parameters that acts, of all samples, then of
    each, where each may have its own."""
    words = tuple(shape.items())
    if not acting(spec):
        yield from _switches(fit, spec, shape, sight, projection)
        return
    columns, found = sight.signature(fit.model, spec, shape), list[Candidate]()
    for one in acting(spec):
        own = [column for column in columns if column.parameter == one.name]
        if own:
            parts = () if one.per_chip else own[0].parts
            found.append(Candidate(spec, one, words, np.array([projection.rows(column) for column in own]), parts))
    yield from _together(found)
    yield from _together([one for each in found for one in _apart(each, sight, projection)])


def _together(found: Sequence[Candidate]) -> Iterator[Candidate]:
    """Each number of an effect, with the others; a group by itself."""
    single = [each for each in found if not each.is_group]
    for each in found:
        yield replace(each, others=tuple(other for other in single if other is not each and not each.is_group))


def _apart(one: Candidate, sight: FitSight, projection: Projection) -> Iterator[Candidate]:
    """A number of an effect that each sample may have its own of, sample by sample: what it does to its images.

    Tilts of several modules need have no direction in common. Not where a shape is tried, another in each, nor
    where curves show it, which have one value for all.
    """
    samples = list(dict.fromkeys(view.sample.id for view in sight.views))
    seen, curves = one.parts[: len(sight.views)], one.parts[len(sight.views) :]
    common = one.effect.scope != "per_sample" or one.is_group or bool(one.shape) or any(np.any(c) for c in curves)
    for sample in [] if common or len(samples) < 2 else samples:
        own = zip(sight.views, seen, strict=True)
        parts = (*(part if view.sample.id == sample else np.zeros_like(part) for view, part in own), *curves)
        column = Column(one.effect.name, one.parameter.name, {}, None, 1.0, parts, sample)
        yield replace(one, columns=projection.rows(column)[None], parts=parts, sample=sample)


def _switches(
    fit: Fit, spec: EffectSpec, shape: dict[str, Value], sight: FitSight, projection: Projection
) -> Iterator[Candidate]:
    """The way from the model as it is to each other word, or value, of a parameter that has no slope at off."""
    off = sight.at(fit.model, spec)
    for one in spec.parameters:
        others: Sequence[Value] = [word for word in one.choices if word != one.off] if one.off else [shape[one.name]]
        for value in others:
            values = off_values(spec, shape) | {one.name: value}
            moved = [Moved(1.0, with_effect(off, applied(spec, values))), Moved(-1.0, off)]
            parts = sight.summed(moved, not spec.twin, lender=off, walks=spec.walks)
            column = Column(spec.name, one.name, values, None, 1.0, parts)
            yield Candidate(spec, one, tuple(values.items()), projection.rows(column)[None], is_switch=True)
