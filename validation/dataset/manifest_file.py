"""`dataset.toml` as a file: read with every fault named, written so that reading gives the equal back."""

from __future__ import annotations

import json
import re
import typing
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from luxloop.effect import did_you_mean
from luxloop.errors import InputError, shortened
from luxloop.files import text_of, toml_of
from luxloop.model_file import range_of
from luxloop.units import unit_of
from validation.dataset.manifest import SCHEMA, Manifest, contradictions

MANIFEST = "dataset.toml"


def parse_manifest(raw: bytes) -> Manifest:
    """The manifest of a file's bytes; raises the first of its faults as an InputError, with the count of others."""
    manifest, faults = manifest_and_faults(raw)
    if manifest is None or faults:
        first, *others = faults
        more = f"{len(others)} more wrong: luxloop dataset check lists them" if others else ""
        raise InputError(first.field, first.value, first.allowed, "; ".join(filter(None, (first.mend, more))))
    return manifest


def manifest_and_faults(raw: bytes) -> tuple[Manifest | None, list[InputError]]:
    """The manifest, None where it cannot be read, and everything that is wrong with its words."""
    try:
        data = _toml_of(raw)
    except InputError as error:
        return None, [error]
    try:
        manifest = Manifest.model_validate(data)
    except ValidationError as error:
        wrong = [
            one for one in error.errors() if one["type"] != "too_short" or not one["input"]
        ]  # follows from others
        wrong.sort(key=lambda one: one["type"] != "extra_forbidden")  # a misspelling explains what is missing
        return None, [_fault(one, data) for one in wrong]
    between = contradictions(manifest)
    return manifest, [InputError(f"{MANIFEST}: {one.field}", one.value, one.allowed, one.mend) for one in between]


def _toml_of(raw: bytes) -> dict[str, Any]:
    """The data of the file, its schema checked and taken away."""
    if raw.startswith(b"\xef\xbb\xbf"):
        raise InputError(MANIFEST, "a byte order mark at its start", "UTF-8 without one", "save it as UTF-8, no BOM")
    data = toml_of(text_of(raw, MANIFEST), MANIFEST)
    schema = data.pop("schema", None)
    if schema != SCHEMA:
        mend = f'begin the file with schema = "{SCHEMA}"' if schema is None else "written for another luxloop"
        raise InputError(f"{MANIFEST}: schema", schema, SCHEMA, mend)
    return data


def _fault(error: Any, data: dict[str, Any]) -> InputError:
    """One wrong field of pydantic's as an InputError with its path, whole range, unit and meaning."""
    owner, name, path = _place(error["loc"], data)
    path = f"{MANIFEST}: {path or '(whole)'}"
    inner = error.get("ctx", {}).get("error")
    if isinstance(inner, InputError):
        path = path if path.endswith(f".{inner.field}") else f"{path}.{inner.field}"
        return InputError(path, inner.value, inner.allowed, inner.mend)
    value = error["input"]
    if error["type"] == "extra_forbidden":
        known = owner.model_fields
        return InputError(path, value, ", ".join(known), did_you_mean(name, known) or "remove it")
    if error["type"].startswith("union_tag"):
        kind = value.get("kind") if isinstance(value, dict) else value
        return InputError(f"{path}.kind", kind, "image, spectrum or far_field", "say what was measured")
    field = owner.model_fields.get(name)
    said = error["msg"].removeprefix("Input should be ")
    allowed = (range_of(owner, name) if field else "") or said
    if error["type"] == "missing":
        meaning = field.description or "" if field else ""
        return InputError(path, None, f"{allowed} {unit_of(name)}".strip(), f"the line is missing. {meaning}".strip())
    decimal = isinstance(value, str) and re.fullmatch(r"\s*-?\d+[.,]\d*\s*", value)
    mend = "a number without quotes, with a decimal point" if decimal else (field.description or "" if field else "")
    return InputError(path, value, f"{allowed} {unit_of(name)}".strip(), mend)


def _place(loc: tuple[int | str, ...], data: Any) -> tuple[type[BaseModel], str, str]:
    """The model class that holds the field at an error's location, the field's name, and the path for people."""
    owner: type[BaseModel] = Manifest
    shown, name = "", ""
    for at, part in enumerate(loc):
        data = _inside(data, part)
        if isinstance(part, int):
            id_ = data.get("id") if isinstance(data, dict) else None
            shown += f'["{shortened(id_, 100)}"]' if isinstance(id_, str) else f"[{part}]"
            continue
        kinds = [kind for kind in _models_of(owner, name) if _is_kind(kind, part)]
        if kinds:  # pydantic puts the chosen kind of a shot into the location; it is no field
            owner = kinds[0]
            continue
        if at and (inner := _models_of(owner, name)) and len(inner) == 1:
            owner = inner[0]
        shown, name = f"{shown}.{shortened(part, 100)}".lstrip("."), part
    return owner, name, shown


def _inside(data: Any, part: int | str) -> Any:
    """What lies under a key or a place of the raw data; the data itself where it has no such key."""
    if isinstance(data, dict) and part in data:
        return data[part]
    return data[part] if isinstance(data, list) and isinstance(part, int) and part < len(data) else data


def _models_of(owner: type[BaseModel], name: str) -> list[type[BaseModel]]:
    field = owner.model_fields.get(name)
    return _inner(field.annotation) if field else []


def _inner(annotation: Any) -> list[type[BaseModel]]:
    """The model classes inside an annotation such as `tuple[ImageShot | SpectrumShot, ...]`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in typing.get_args(annotation) for found in _inner(part)]


def _is_kind(model: type[BaseModel], tag: str) -> bool:
    field = model.model_fields.get("kind")
    return field is not None and tag in typing.get_args(field.annotation)


def to_toml(manifest: Manifest, remarks: Mapping[str, str] | None = None) -> str:
    """The text of `dataset.toml`; defaults are left out.

    `remarks` become comments behind a line, by its path: "camera.full_well_e", 'shots["a"].exposure_ms'.
    """
    lines = [
        "# A luxloop data set. The ending of a name is its unit; images: row 0 at the lowest y.",
        f"schema = {_toml(SCHEMA)}",
        *_lines(manifest, "", remarks or {}, leave=("camera", "samples", "films", "shots"), always=True),
    ]
    if manifest.camera is not None:
        lines += ["", "[camera]", *_lines(manifest.camera, "camera.", remarks or {}, always=True)]
    for group in ("samples", "films", "shots"):
        for one in getattr(manifest, group):
            lines += ["", f"[[{group}]]", *_lines(one, f'{group}["{one.id}"].', remarks or {})]
    return "\n".join(lines) + "\n"


def _lines(
    words: BaseModel, path: str, remarks: Mapping[str, str], leave: tuple[str, ...] = (), always: bool = False
) -> list[str]:
    """`name = value` of each field that is set; with `always` also of those at their default, unless None."""
    lines = []
    for name, field in type(words).model_fields.items():
        value = getattr(words, name)
        said = name in words.model_fields_set or always or f"{path}{name}" in remarks
        if name in leave or value is None or not (said or field.is_required()):
            continue
        remark = remarks.get(f"{path}{name}")
        lines.append(f"{name} = {_toml(value)}" + (f"  # {remark}" if remark else ""))
    return lines


def _toml(value: Any) -> str:
    """A TOML value. JSON's strings are TOML's but for DEL; floats and booleans are written alike."""
    if isinstance(value, BaseModel):
        value = value.model_dump(exclude_unset=True, exclude_none=True)
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, tuple | list):
        if value and isinstance(value[0], BaseModel):
            return "[\n" + "".join(f"  {_toml(item)},\n" for item in value) + "]"
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("\x7f", "\\u007f")
