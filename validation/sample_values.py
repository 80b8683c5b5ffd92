"""Values that effects have sample by sample: the powers of a module's chips, the tilt of its receiver.

    [[effects]] EFFECT                 any module, a campaign's designs among them: there it is off
    [samples.ID.EFFECT]                the sample ID of the data, in place of those
    [fit."effects.EFFECT.PARAMETER"]   limits and prior of all of them; prior_sd is the spread that a group has

One number of these is a member; its path is samples.ID.EFFECT.PARAMETER, with .N for chip N of a list.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from luxloop.effect import Value
from luxloop.errors import InputError
from luxloop.model import Fit, Model

LEAD = "samples."


@dataclass(frozen=True)
class Member:
    """Where a number stands: of which sample, effect and parameter, of a list of which chip."""

    sample: str
    effect: str
    parameter: str
    chip: int | None = None

    @property
    def path(self) -> str:
        """As fits call it."""
        return f"{LEAD}{self.sample}.{self.effect}.{self.parameter}" + (f".{self.chip}" * (self.chip is not None))

    @property
    def limits_path(self) -> str:
        """The [fit] table that all members of its kind share."""
        return f"effects.{self.effect}.{self.parameter}"


def of_sample(model: Model, sample: str) -> Model:
    """The model of one sample: its effects as they are there."""
    if not model.samples:
        return model
    own = model.samples.get(sample, {})
    effects = tuple(
        one.model_copy(update={"parameters": {**one.parameters, **own.get(one.name, {})}}) for one in model.effects
    )
    return model.model_copy(update={"effects": effects, "samples": {}})


def members(model: Model) -> dict[str, tuple[Member, float]]:
    """All numbers with limits that samples have of their own, and their values, by path."""
    found: dict[str, tuple[Member, float]] = {}
    for sample, effects in model.samples.items():
        for effect, values in effects.items():
            for name, value in values.items():
                several = enumerate(value) if isinstance(value, tuple) else [(None, value)]
                for chip, one in several:
                    member = Member(sample, effect, name, chip)
                    if isinstance(one, float) and member.limits_path in model.fit:
                        found[member.path] = member, one
    return found


def numbers(model: Model) -> dict[str, Any]:
    """All values of a model by path, members among them."""
    return model.leaves() | {path: value for path, (_, value) in members(model).items()}


def free_members(model: Model) -> dict[str, tuple[Member, float]]:
    """Those that the model file lets move."""
    return {path: (one, value) for path, (one, value) in members(model).items() if model.fit[one.limits_path].free}


def with_members(model: Model, values: Mapping[str, float]) -> Model:
    """The model with other values of members, by path. InputError for one that it does not have."""
    if not values:
        return model
    known = members(model)
    samples = {
        sample: {name: dict(own) for name, own in effects.items()} for sample, effects in model.samples.items()
    }
    for path, value in values.items():
        if path not in known:
            raise InputError("path", path, "a value of a sample in the model", "luxloop model show lists them")
        member, _ = known[path]
        own = samples[member.sample][member.effect]
        old = own[member.parameter]
        own[member.parameter] = (
            tuple(value if chip == member.chip else one for chip, one in enumerate(old))
            if isinstance(old, tuple)
            else value
        )
    return model.model_copy(update={"samples": samples})


def with_number(model: Model, path: str, value: object) -> Model:
    """The model with another value at a path, a member's or its own. InputError for one that it does not take."""
    if not path.startswith(LEAD):
        return model.with_value(path, value)
    limits, number = limits_of(model, path), float(str(value))
    if limits is not None and not limits.lower <= number <= limits.upper:
        raise InputError(path, number, f"{limits.lower:g} to {limits.upper:g}", "as for the effect itself")
    return with_members(model, {path: number})


def with_sample(model: Model, sample: str, effect: str, values: Mapping[str, Value]) -> Model:
    """The model with an effect's values in one sample."""
    return model.model_copy(
        update={"samples": {**model.samples, sample: {**model.samples.get(sample, {}), effect: dict(values)}}}
    )


def limits_of(model: Model, path: str) -> Fit | None:
    """What a fit may do with a number of the model, or with a member; None where nothing says so."""
    if not path.startswith(LEAD):
        return model.fit.get(path)
    known = members(model)
    return model.fit[known[path][0].limits_path] if path in known else None


def is_by_sample(model: Model, path: str) -> bool:
    """Whether the [fit] table at a path is that of members, not of one number."""
    effect = path.split(".")[1]
    return path.startswith("effects.") and any(effect in own for own in model.samples.values())


def without_samples(model: Model, effect: str) -> Model:
    """The model without what its samples have of an effect."""
    left = {
        sample: {name: values for name, values in own.items() if name != effect}
        for sample, own in model.samples.items()
    }
    return model.model_copy(update={"samples": {sample: own for sample, own in left.items() if own}})


def without(model: Model, effect: str) -> Model:
    """The model without an effect and without what its [fit] tables and its samples say of it."""
    left = tuple(one for one in model.effects if one.name != effect)
    fit = {path: one for path, one in model.fit.items() if not path.startswith(f"effects.{effect}.")}
    return without_samples(model.model_copy(update={"effects": left, "fit": fit}), effect)


def refuse_strangers(model: Model, samples: Iterable[str]) -> None:
    """Raises InputError for values of a sample that the data do not have, or of an effect that the model lacks."""
    known, effects = list(samples), [one.name for one in model.effects]
    for sample, own in model.samples.items():
        if sample not in known:
            mend = f"remove the tables [samples.{sample}...] from the model file"
            raise InputError("samples", sample, f"a sample of the data: {', '.join(known)}", mend)
        for name in own:
            if name not in effects:
                mend = f"write it under [[effects]], or remove [samples.{sample}.{name}]"
                raise InputError(f"samples.{sample}", name, f"an effect of the model: {', '.join(effects)}", mend)
