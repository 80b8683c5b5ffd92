"""A model as a TOML file: read with errors that mend, written with unit, range and meaning beside every value.

The shape of the file is fixed, so it is written here line by line: `schema`, `name`, `notes`, `[environment]` with
its two surfaces, `[fit."PATH"]`, `[data]`, `[[effects]]`, `[samples.ID.EFFECT]`. A user's own comments are not kept;
`notes` is the place for words.
"""

from __future__ import annotations

import json
import typing
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from luxloop import files
from luxloop.effect import AppliedEffect, did_you_mean
from luxloop.errors import InputError, shortened
from luxloop.model import Environment, Fit, Model, Surface
from luxloop.units import unit_of
from luxloop.words import as_input_error

SCHEMA = "luxloop-model/1"
SHIPPED = ("paper", "clear_chip")


def find_model(path_or_name: str | Path) -> Model:
    """The model of that name among those shipped (`paper`, `clear_chip`), or in that file."""
    if str(path_or_name) in SHIPPED:
        name = f"{path_or_name}.toml"
        return parse_toml(resources.files("luxloop").joinpath("models", name).read_text(encoding="utf-8"), name)
    return read_model(Path(path_or_name))


def read_model(path: Path) -> Model:
    """The model in a file; InputError names file, field, value, range and mend."""
    return parse_toml(read_text(path), path.name)


def read_text(path: Path) -> str:
    """The text of a model file, or an InputError where there is none."""
    mend = did_you_mean(str(path), SHIPPED) or "luxloop model new writes one"
    return files.read_text(path, "model", f"a model file, or {' or '.join(SHIPPED)}", mend)


def parse_toml(text: str, where: str) -> Model:
    """The model that a file's text says; `where` is the file's name and leads every error."""
    data = files.toml_of(text, where)
    schema = data.pop("schema", None)
    if schema != SCHEMA:
        mend = f'begin the file with schema = "{SCHEMA}"' if schema is None else "written for another luxloop"
        raise InputError(f"{where}: schema", schema, SCHEMA, mend)
    try:
        return Model.model_validate(data)
    except ValidationError as error:
        raise _mendable(error, where) from None


def to_toml(model: Model) -> str:
    """The text of a model file; `parse_toml` gives the equal model back."""
    head = [
        "# A luxloop model. The ending of a name is its unit. `luxloop model show` explains, `model diff` compares.",
        f"schema = {_toml(SCHEMA)}",
        f"name = {_toml(model.name)}",
        f"notes = {_block(model.notes)}",
    ]
    lines = [*head, "", "[environment]", *_values(model.environment)]
    for name in ("substrate", "receiver"):
        lines += ["", f"# {Environment.model_fields[name].description}", f"[environment.{name}]"]
        lines += _values(getattr(model.environment, name))
    for path, fit in model.fit.items():
        lines += ["", f"[fit.{_toml(path)}]", *(f"{k} = {_toml(v)}" for k, v in fit if v is not None)]
    if model.data is not None:
        lines += ["", "[data]", *(f"{k} = {_toml(v)}" for k, v in model.data)]
    for effect in model.effects:
        lines += ["", "[[effects]]", f"name = {_toml(effect.name)}"]
        lines += [f"source_sha256 = {_toml(effect.source_sha256)}"] * (effect.source_sha256 is not None)
        lines += ["[effects.parameters]", *(f"{k} = {_toml(v)}" for k, v in effect.parameters.items())]
    for sample, name, values in ((id_, name, one) for id_, own in model.samples.items() for name, one in own.items()):
        lines += ["", f"[samples.{_toml(sample)}.{name}]", *(f"{k} = {_toml(v)}" for k, v in values.items())]
    return "\n".join(lines) + "\n"


class Change(NamedTuple):
    """One difference between two models; None is "not there"."""

    path: str
    before: Any
    after: Any

    def __str__(self) -> str:
        unit = unit_of(self.path)
        return f"{self.path}: {_shown(self.before)} -> {_shown(self.after)}" + (f" {unit}" if unit else "")


def diff(before: Model, after: Model) -> list[Change]:
    """What differs between two models, leaf by leaf in the order of the file; the order of effects at the end."""
    old, new = before.leaves(), after.leaves()
    changes = [Change(path, old.get(path), new.get(path)) for path in old | new if old.get(path) != new.get(path)]
    orders = [[effect.name for effect in model.effects] for model in (before, after)]
    if orders[0] != orders[1]:
        changes.append(Change("effects", *orders))
    return changes


def range_of(model: type[BaseModel], field: str) -> str:
    """What may stand in a field, for people: "390 to 770", "isotropic or in_plane_dipole", "" where it is free."""
    schema = _json_schema(model)["properties"][field]
    return " or ".join(filter(None, map(_range, schema.get("anyOf", [schema]))))


@cache
def _json_schema(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema()


def _range(schema: dict[str, Any]) -> str:
    if "enum" in schema:
        return " or ".join(schema["enum"])
    low = f"{schema['minimum']:g}" if "minimum" in schema else ""
    low = f"above {schema['exclusiveMinimum']:g}" if "exclusiveMinimum" in schema else low
    high = f"{schema['maximum']:g}" if "maximum" in schema else ""
    return " to ".join(filter(None, (low, high)))


def _values(words: Environment | Surface) -> list[str]:
    """A comment with unit, range and meaning above each value; what is not set stands as a comment too."""
    lines = []
    for name, field in type(words).model_fields.items():
        value = getattr(words, name)
        if isinstance(value, Surface):
            continue
        facts = ", ".join(filter(None, (unit_of(name), range_of(type(words), name))))
        lines.append(f"# {facts}: {field.description}")
        lines.append(f"# {name} =" if value is None else f"{name} = {_toml(value)}")
    return lines


def _toml(value: object) -> str:
    """A TOML value. JSON's strings are TOML's but for DEL, floats and booleans are written alike."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("\x7f", "\\u007f")


def _block(text: str) -> str:
    """A TOML string over several lines where the text has them."""
    if "\n" not in text:
        return _toml(text)
    return '"""\n' + "\n".join(_toml(line)[1:-1] for line in text.split("\n")) + '"""'


def _shown(value: object) -> str:
    if value is None:
        return "(none)"
    if isinstance(value, str):
        return shortened(value if value.isprintable() else json.dumps(value), 60)
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _mendable(error: ValidationError, where: str) -> InputError:
    """The first wrong field as an InputError with its whole range and meaning, or the word that was meant."""
    wrong = error.errors()
    # a misspelling explains the rest
    first = next((one for one in wrong if one["type"] == "extra_forbidden"), wrong[0])
    if not first["loc"] or "error" in first.get("ctx", {}):
        return as_input_error(error, where)
    # beyond four parts pydantic names the kinds of a value that it tried
    loc = first["loc"][:4] if first["loc"][0] in ("effects", "samples") else first["loc"]
    path, value = f"{where}: {'.'.join(map(str, loc))}", first["input"]
    owner, name = _owner(loc)
    if first["type"] == "extra_forbidden":
        return InputError(path, value, ", ".join(owner.model_fields), did_you_mean(name, owner.model_fields))
    if name not in owner.model_fields:
        return InputError(path, value, "a number, a word, or a list of numbers")
    allowed = range_of(owner, name) or first["msg"].removeprefix("Input should be ")
    if first["type"] == "missing":
        return InputError(path, None, allowed, "the line is missing")
    meaning = owner.model_fields[name].description or ""
    return InputError(path, value, f"{allowed} {unit_of(name)}".strip(), meaning)


def _owner(loc: tuple[int | str, ...]) -> tuple[type[BaseModel], str]:
    """The model class that holds the field at an error's location, and the field's name."""
    owner: type[BaseModel] = Model
    for part in loc[:-1]:
        field = owner.model_fields.get(str(part))  # a place in a list or a key of a mapping: the owner stays
        owner = (_inner(field.annotation) if field else None) or owner
    return owner, str(loc[-1])


def _inner(annotation: Any) -> type[BaseModel] | None:
    """The model class inside an annotation such as `tuple[AppliedEffect, ...]` or `dict[str, Fit]`."""
    if annotation in (Environment, Surface, Fit, AppliedEffect):
        return typing.cast("type[BaseModel]", annotation)
    inner = (_inner(part) for part in typing.get_args(annotation))
    return next((found for found in inner if found), None)
