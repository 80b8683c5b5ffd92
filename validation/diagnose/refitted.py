"""What a model with one effect more came to: the effect's size, what it leaves, the fit that says so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectParameter, Value
from luxloop.model import Fit as Limits
from luxloop.model import Model
from validation.diagnose.anew import total_chi2
from validation.effects.known import applied, off_values, with_effect
from validation.fit import Fit
from validation.sample_values import numbers, with_sample

if TYPE_CHECKING:
    from validation.diagnose.score import Candidate

Real = NDArray[np.float64]
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
    """Of data and priors; of an effect that is no smooth one its line's."""
    driven: bool
    """A parameter of the effect to its limit: beyond it chi2 would fall by more than noise does."""
    model: Model | None
    """None for a group as long as its members are no numbers of a model."""
    fit: Fit | None
    """None for a group whose members are reckoned on the linear model."""

    as_well: tuple[Words, ...] = ()
    """Other words of its shape, with which it fits as well."""
    line: Fit | None = None
    """Of an effect that is no smooth one, fitted about its own value: the fit before that, about the base's anchor
    unless it was led out of a corner."""

    @property
    def at_end(self) -> bool:
        """Whether a parameter of the effect is at its limit, where noise may have put it."""
        return self.fit is not None and not self.driven and not set(self.paths).isdisjoint(self.fit.at_limit)

    @property
    def beside_base(self) -> Fit | None:
        """What is held against the base, value by value: with the base's noise of Monte Carlo, as long as it is not
        about an anchor of its own. Then the noise of two runs is in the difference (`held_out.change`)."""
        return self.fit if self.line is None else self.line

    @property
    def shape(self) -> tuple[tuple[str, Value], ...]:
        """What shapes the effect, and what acts beside its parameter, as its model has them, else as it was tried."""
        effects = () if self.model is None else self.model.effects
        values = next((e.parameters for e in effects if e.name == self.candidate.effect.name), {})
        shaped = tuple((name, values.get(name, value)) for name, value in self.candidate.shape)
        known = {} if self.model is None else numbers(self.model)
        beside = {one.words: known[one.path] for one in self.candidate.others if one.path in known}
        return (*shaped, *beside.items())

    @property
    def paths(self) -> tuple[str, ...]:
        """Of the parameters that act, the one that scored first."""
        return tuple(one.path for one in (self.candidate, *self.candidate.others))

    @property
    def numbers(self) -> int:
        """How many of the effect's numbers were fitted, lengths among them; of a group and a switch 1."""
        known = () if self.fit is None else self.fit.problem.unknowns.model_paths
        of_all, own = path_of(self.candidate.effect.name, ""), self.paths
        return max(1, sum(path in own or path.startswith(of_all) for path in known))

    @property
    def size(self) -> dict[str, float]:
        """The effect's numbers that act, by path, as its model has them; of a group and a switch the one value."""
        known = {} if self.model is None else numbers(self.model)
        others = {one.path: float(known[one.path]) for one in self.candidate.others}
        return {self.candidate.path: self.value} | others


def path_of(effect: str, parameter: str) -> str:
    """The path of an effect's parameter in a model."""
    return f"effects.{effect}.{parameter}"


def added(model: Model, candidate: Candidate, size: Mapping[str, float]) -> Model:
    """The model with the effect of a candidate in its shape; what has a size, by path (no switch has), is free."""
    spec, limits = candidate.effect, dict[str, Limits]()
    off = off_values(spec, dict(candidate.shape))
    values = {"": dict(off)}
    for one in (candidate, *candidate.others):
        if one.path in size:
            lower, upper = limits_of(one.parameter)
            value = float(np.clip(size[one.path], lower, upper))
            values.setdefault(one.sample, dict(off))[one.parameter.name] = value
            limits[path_of(spec.name, one.parameter.name)] = Limits(free=True, lower=lower, upper=upper)
    model = with_effect(model, applied(spec, values.pop("")))
    for sample, own in values.items():
        model = with_sample(model, sample, spec.name, own)
    return model.model_copy(update={"fit": model.fit | limits})


def limits_of(one: EffectParameter) -> tuple[float, float]:
    """The catalogue's range of a parameter; ValueError where it has words instead."""
    if one.lower is None or one.upper is None:
        raise ValueError(f"{one.name} has no range")
    return one.lower, one.upper


def with_fit(found: Refitted, fit: Fit) -> Refitted:
    """The same with another fit of its model."""
    switch, (path, *_) = found.candidate.is_switch, found.paths
    return replace(
        found, value=1.0 if switch else fit.value(path), error=0.0 if switch else fit.error(path),
        residual=fit.residual, chi2=total_chi2(fit), driven=not set(found.paths).isdisjoint(fit.driven),
        model=fit.model, fit=fit,
    )  # fmt: skip


def of_members(found: Refitted, fit: Fit) -> Refitted:
    """A group's with the fit in which each member is a number of its own; spread, error and chi2 stay its line's."""
    return replace(found, residual=fit.residual, model=fit.model, fit=fit)
