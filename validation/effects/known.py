"""Which effects the workers know: asked of them, never imported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from luxloop.effect import AppliedEffect, EffectParameter, EffectSpec, Value, check, did_you_mean
from luxloop.errors import InputError
from luxloop.model import Model
from luxloop.ray import EffectsRequest
from luxloop.words import parse
from validation.prediction.words import Asks
from validation.sample_values import of_sample

THIRD = 1.0 / 3.0
CHIP = "chip"
"""A parameter of this name is the number of a chip: each is tried, and nothing between."""


@dataclass(frozen=True)
class Known:
    """The workers' catalogue, the user's own effects in it."""

    specs: tuple[EffectSpec, ...]
    refused: Mapping[str, str]
    """By file name of the user's folder: why it is not used."""
    trials: Mapping[str, Mapping[str, Any]]
    """By file name: its SHA-256, and a line for each thing that its trial looked at."""

    @classmethod
    def ask(cls, client: Asks) -> Known:
        """What the ray-tracing worker knows now, its folder looked through again. Raises RemoteError."""
        told = client.run(EffectsRequest(), fresh=True).result
        specs = tuple(parse(EffectSpec, one, "effects") for one in told["effects"])
        return cls(specs, told["refused_effects"], told.get("effect_trials", {}))

    def spec(self, name: str) -> EffectSpec:
        """The effect of that name. Raises InputError, with the reason where its file was refused."""
        for one in self.specs:
            if one.name == name:
                return one
        if why := self._why_refused(name):
            raise InputError("NAME", name, "an effect that can be used", why)
        names = [one.name for one in self.specs]
        mend = did_you_mean(name, names) or "luxloop effects list shows them"
        raise InputError("NAME", name, f"one of the {len(names)} effects that the workers know", mend)

    def refuse_unknown(self, model: Model) -> None:
        """Raises InputError for an effect of a model that is not known, or whose values are out of range."""
        known = {one.name: one for one in self.specs}
        for one in (model, *(of_sample(model, sample) for sample in model.samples)):
            for effect in one.effects:
                if effect.name not in known and not self._why_refused(effect.name):
                    mend = did_you_mean(effect.name, known) or "luxloop effects show NAME prints what to write"
                    raise InputError("effects", effect.name, f"one of {', '.join(known)}", mend)
                check(effect, self.spec(effect.name))

    def _why_refused(self, name: str) -> str:
        """Why a file, or what a package offers under that name, is not used; empty where there is none."""
        return self.refused.get(f"{name}.py") or self.refused.get(name, "")

    @property
    def beyond_twin(self) -> frozenset[str]:
        """The names of those that the twin cannot represent."""
        return frozenset(one.name for one in self.specs if not one.twin)


NEAR_OFF = 1e-6
"""Of a step: where an effect begins that light takes other ways with. At off itself it has the ways of another chip,
and a difference from there is mostly noise."""


def off_values(spec: EffectSpec, shape: Mapping[str, Value] | None = None, chips: int = 0) -> dict[str, Value]:
    """Values at which an effect is absent; what only shapes it as in `shape`, else in the middle of its grid."""
    values = {one.name: _off(one, chips) for one in spec.parameters}
    return values | {name: value for name, value in (shape or {}).items() if name in values}


def _off(one: EffectParameter, chips: int) -> Value:
    grid: Sequence[Value] = one.shape_grid or one.choices or (one.lower or 0.0,)
    value = grid[len(grid) // 2] if one.off is None else one.off
    return (float(value),) * chips if one.per_chip and isinstance(value, float) else value


def shapes_of(spec: EffectSpec) -> list[dict[str, Value]]:
    """The points of an effect's shape grid: each number with all else in the middle, every combination of words."""
    free = [one for one in spec.parameters if one.off is None and not one.per_chip]
    middle = {one.name: _off(one, 0) for one in free}
    words = [one for one in free if one.choices]
    said = product(*(one.choices for one in words))
    points = [middle, *(middle | {one.name: value} for one in free for value in one.shape_grid)]
    points += [middle | dict(zip((one.name for one in words), some, strict=True)) for some in said]
    return [point for number, point in enumerate(points) if point not in points[:number]]


def for_chips(spec: EffectSpec, chips: int) -> EffectSpec:
    """The effect with all chips of a module of so many to try, where it is of one chip."""
    numbers = tuple(float(chip) for chip in range(chips))
    parameters = [
        one.model_copy(update={"shape_grid": numbers}) if one.name == CHIP else one for one in spec.parameters
    ]
    return spec.model_copy(update={"parameters": tuple(parameters)})


def acting(spec: EffectSpec) -> list[EffectParameter]:
    """The parameters with a slope at off: numbers that have an off value."""
    return [one for one in spec.parameters if one.off is not None and not one.choices and not spec.discrete]


def is_smooth(spec: EffectSpec) -> bool:
    """Whether the twin represents it, and its images follow it without noise of their own."""
    return spec.twin and not spec.walks


def typical(spec: EffectSpec, chips: int = 0) -> dict[str, Value]:
    """Values that show an effect: a third of the way from off to the upper end; of chips every other one."""
    values: dict[str, Value] = {}
    for one in spec.parameters:
        value = _off(one, chips)
        if one.off is not None and one.choices:
            value = next(choice for choice in one.choices if choice != one.off)
        elif one.off is not None:
            off, end = float(one.off), far_end(one)
            value = float(f"{off + THIRD * (end - off):.12g}")
            if one.per_chip:
                value = tuple(value if chip % 2 == 0 else off - (value - off) for chip in range(chips))
        values[one.name] = value
    return values


def far_end(one: EffectParameter) -> float:
    """The upper end of a parameter's range, or the lower one where off is the upper."""
    lower, upper = float(one.lower or 0.0), float(one.upper or 0.0)
    return upper if one.off is None or upper > float(one.off) else lower


def nearly_off(spec: EffectSpec, values: Mapping[str, Value]) -> dict[str, Value]:
    """Values so near to off that nothing is seen of the effect; what only shapes it stays."""
    off = {one.name: one.off for one in acting(spec) if isinstance(one.off, float)}
    return {name: _drawn(value, off[name]) if name in off else value for name, value in values.items()}


def _drawn(value: Value, off: float) -> Value:
    """A number, or each of several, drawn nearly to off."""
    if isinstance(value, tuple):
        return tuple(off + NEAR_OFF * (one - off) for one in value)
    return off + NEAR_OFF * (value - off) if isinstance(value, float) else value


def applied(spec: EffectSpec, values: Mapping[str, Value]) -> AppliedEffect:
    """The effect with these values, as a model has it."""
    said = {"name": spec.name, "parameters": dict(values), "source_sha256": spec.source_sha256}
    return parse(AppliedEffect, said, f"effects.{spec.name}")


def with_effect(model: Model, one: AppliedEffect) -> Model:
    """The model with the effect, in the place of one of that name or after the others."""
    names = [effect.name for effect in model.effects]
    effects = tuple(one if effect.name == one.name else effect for effect in model.effects)
    return model.model_copy(update={"effects": effects if one.name in names else (*effects, one)})


def stanza(one: AppliedEffect) -> str:
    """What to paste into a model file."""
    lines = ["[[effects]]", f'name = "{one.name}"']
    lines += [f'source_sha256 = "{one.source_sha256}"'] if one.source_sha256 else []
    lines.append("[effects.parameters]")
    for name, value in one.parameters.items():
        text = (
            f'"{value}"' if isinstance(value, str) else str(list(value)) if isinstance(value, tuple) else repr(value)
        )
        lines.append(f"{name} = {text}")
    return "\n".join(lines)
