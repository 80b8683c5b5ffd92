"""The words for a physical effect: what the catalogue says of it, and how a model applies it. No physics here.

An `EffectSpec` is what a worker's `describe` answers for each effect it knows; an `AppliedEffect` is what stands in a
model file and travels in every request. `check` holds the two together at the border.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from luxloop.errors import InputError
from luxloop.units import unit_of
from luxloop.words import Sha256, Words

Stage = Literal["stack", "surface", "emission", "volume", "geometry", "detector", "module"]
Scope = Literal["global", "per_camera", "per_sample"]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Number = Annotated[float, Field(strict=True)]
Value = Number | Annotated[str, Field(max_length=64)] | Annotated[tuple[Number, ...], Field(max_length=10_000)]


class EffectParameter(Words):
    """One parameter of an effect: a number in a range, a number per chip, or one of a few words (`choices`)."""

    name: Name
    description: str
    unit: str = ""
    lower: float | None = None
    upper: float | None = None
    choices: tuple[str, ...] = ()
    per_chip: bool = False
    off: float | str | None = Field(None, description="Value at which the effect is absent; none: nowhere.")
    score_variable: Literal["value", "square"] = Field(
        "value", description="What has a slope at off: the parameter, or its square (roughness, slopes, rms)."
    )
    one_sided: bool = Field(False, description="Only one side of off exists.")
    shape_grid: tuple[float, ...] = Field((), description="Values to try of what says nothing at off: a length, say.")

    @model_validator(mode="after")
    def _is_whole(self) -> EffectParameter:
        if unit_of(self.name) != self.unit:
            allowed = f"{unit_of(self.name)!r}, by the ending of {self.name}"
            raise InputError("unit", self.unit, allowed, "a name ends with its unit: shift_um, loss_per_cm, share")
        if self.choices and (self.lower is not None or self.upper is not None or self.per_chip):
            raise InputError("choices", self.choices, "no range and no per_chip beside them")
        if not self.choices and (self.lower is None or self.upper is None or not self.lower < self.upper):
            raise InputError("lower", self.lower, f"a number below upper = {self.upper}", "or give choices")
        for value in (self.off, *self.shape_grid):
            if value is not None:
                self.refuse_outside(value)
        return self

    @property
    def allowed(self) -> str:
        """What may stand there, for people: a range with its unit, or the words."""
        if self.choices:
            return " or ".join(self.choices)
        return f"{self.lower:g} to {self.upper:g} {self.unit}".strip() + (", a list, one per chip" * self.per_chip)

    def refuse_outside(self, value: float | str) -> None:
        """Raises InputError where one value is not in the range or not one of the choices."""
        inside = value in self.choices
        if self.lower is not None and self.upper is not None:
            inside = isinstance(value, float) and self.lower <= value <= self.upper
        if not inside:
            raise InputError(self.name, value, self.allowed, self.description)


class EffectSpec(Words):
    """What the catalogue says of an effect: where it acts, on what, how large, and where that is written."""

    name: Name
    stage: Stage
    description: str
    parameters: tuple[EffectParameter, ...] = ()
    acts_on: tuple[Literal["modules", "films"], ...] = Field(("modules",), description="Films: those measured.")
    scope: Scope = Field("global", description="Whether one value holds for all data, per camera or per sample.")
    twin: bool = Field(True, description="Whether the deterministic twin can represent it.")
    walks: bool = Field(False, description="Whether each value has other walks inside the chips, and their noise.")
    by_chance: bool = Field(False, description="Whether a share of the light, drawn by chance, goes another way.")
    discrete: bool = Field(False, description="No slope at off: tested by a refit, not by the score.")
    conserves: tuple[Literal["energy", "reciprocity"], ...] = ()
    excludes: tuple[Name, ...] = Field((), description="Effects that say the same in another way.")
    formula: str = Field("", max_length=1000, description="What it does, in a line.")
    reference: str = Field("", description="Where its formula comes from.")
    source_sha256: Sha256 | None = Field(None, description="Of the file of a user's own effect.")

    @field_validator("parameters")
    @classmethod
    def _names_differ(cls, parameters: tuple[EffectParameter, ...]) -> tuple[EffectParameter, ...]:
        refuse_twice("parameters", (parameter.name for parameter in parameters))
        return parameters


class AppliedEffect(Words):
    """An effect of a model: its name, the values of its parameters, and for a user's own the hash of its source."""

    name: Name
    parameters: dict[Name, Value] = Field(default_factory=dict)
    source_sha256: Sha256 | None = None


def check(applied: AppliedEffect, spec: EffectSpec) -> None:
    """Raises InputError where `applied` is not an effect that `spec` describes; returns nothing.

    All parameters must be given: a model's hash may not depend on what a catalogue takes for a default.
    """
    where = f"effects.{applied.name}"
    if applied.name != spec.name:
        raise InputError(where, applied.name, spec.name, "this is the description of another effect")
    if applied.source_sha256 != spec.source_sha256:
        given, wanted = applied.source_sha256, str(spec.source_sha256)
        raise InputError(f"{where}.source_sha256", given, wanted, "the source changed")
    known = {parameter.name: parameter for parameter in spec.parameters}
    for name in applied.parameters:
        if name not in known:
            allowed = " or ".join(known) or "no parameter"
            raise InputError(f"{where}.{name}", applied.parameters[name], allowed, did_you_mean(name, known))
    for name, parameter in known.items():
        if name not in applied.parameters:
            raise InputError(f"{where}.{name}", None, parameter.allowed, "the parameter is missing")
        _check_value(f"{where}.{name}", applied.parameters[name], parameter)


def _check_value(where: str, value: Value, parameter: EffectParameter) -> None:
    if isinstance(value, tuple) != parameter.per_chip:
        raise InputError(where, value, parameter.allowed, "a list where there is a value per chip, else one value")
    for one in value if isinstance(value, tuple) else (value,):
        try:
            parameter.refuse_outside(one)
        except InputError as error:
            raise InputError(where, one, error.allowed, error.mend) from None


def refuse_twice(field: str, names: Iterable[str]) -> None:
    """Raises InputError where a name comes twice."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(field, name, "each name once", "remove or rename one of the two")
        seen.add(name)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """ "did you mean X?" for the known word nearest to a misspelt one, else ""."""
    nearest = difflib.get_close_matches(word, list(known), n=1)
    return f"did you mean {nearest[0]}?" if nearest else ""
