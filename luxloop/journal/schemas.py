"""Words as records that every viewer of such files can read: flat schemas, and values that agree with them.

Viewers fall over `$ref`, `anyOf`, null, tuples and dictionaries of free keys. So a record's schema uses objects,
arrays, strings, numbers, integers and booleans only, and `conform` brings a value into that form; `restore` is its
inverse. What has no fixed form is one string of canonical JSON.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Any

from pydantic import BaseModel

from luxloop.errors import InputError
from luxloop.words import canonical

KINDS = ("object", "array", "string", "number", "integer", "boolean")
SAFE_INTEGER = 1 << 53
"""Above it viewers in a browser lose digits."""
JSON_TEXT = "application/json"
PAIRS = "key and value of each entry"

Schema = dict[str, Any]


@cache
def flat_schema(model: type[BaseModel]) -> Schema:
    """The flat JSON schema of a model's records.

    Raises TypeError where a field has no one form (a union of several kinds, an array of different kinds).
    """
    whole = model.model_json_schema(mode="serialization")
    return _flat(whole, whole.get("$defs", {}), model.__name__) | {"title": model.__name__}


def conform(value: Any, schema: Schema) -> Any:
    """A plain value in the form of its flat schema: without nulls, dictionaries as lists of pairs or as JSON text.

    Raises InputError for an integer that a browser would round.
    """
    if schema.get("contentMediaType") == JSON_TEXT:
        return canonical(value).decode()
    if schema["type"] == "object":
        known = schema["properties"]
        return {name: conform(item, known[name]) for name, item in value.items() if item is not None}
    if schema["type"] == "array":
        items = [{"key": key, "value": item} for key, item in value.items()] if _is_pairs(schema) else value
        return [conform(item, schema["items"]) for item in items]
    if schema["type"] == "integer" and abs(value) > SAFE_INTEGER:
        raise InputError("integer", value, f"up to 2^53 = {SAFE_INTEGER}", "make it a string")
    return value


def restore(value: Any, schema: Schema) -> Any:
    """The plain value that `conform` was given; what was null is absent."""
    if schema.get("contentMediaType") == JSON_TEXT:
        return json.loads(value)
    if schema["type"] == "object":
        known = schema["properties"]
        return {name: restore(item, known[name]) if name in known else item for name, item in value.items()}
    if schema["type"] == "array":
        items = [restore(item, schema["items"]) for item in value]
        return {item["key"]: item["value"] for item in items} if _is_pairs(schema) else items
    return value


def _is_pairs(schema: Schema) -> bool:
    return bool(schema.get("$comment") == PAIRS)


def _flat(node: Schema, definitions: dict[str, Schema], where: str) -> Schema:
    if "$ref" in node:
        name = str(node["$ref"]).rpartition("/")[2]
        return _flat(definitions[name], definitions, where)
    if "anyOf" in node:
        kinds = [_flat(item, definitions, where) for item in node["anyOf"] if item.get("type") != "null"]
        if any(kind != kinds[0] for kind in kinds):
            raise TypeError(f"{where}: several kinds, {[kind['type'] for kind in kinds]}")
        return kinds[0]
    kind = node.get("type")
    if kind == "object":
        return _flat_object(node, definitions, where)
    if kind == "array":
        items = [_flat(item, definitions, where) for item in node.get("prefixItems", [])]
        items += [_flat(node["items"], definitions, where)] if isinstance(node.get("items"), dict) else []
        if not items or any(item != items[0] for item in items):
            raise TypeError(f"{where}: an array of several kinds, or of any")
        return {"type": "array", "items": items[0]}
    if kind not in KINDS:
        raise TypeError(f"{where}: {node} is none of {', '.join(KINDS)}")
    return {"type": kind}


def _flat_object(node: Schema, definitions: dict[str, Schema], where: str) -> Schema:
    if "properties" in node:
        inner = {name: _flat(item, definitions, f"{where}.{name}") for name, item in node["properties"].items()}
        for name, item in node["properties"].items():
            if "description" in item:
                inner[name] = inner[name] | {"description": item["description"]}
        return {"type": "object", "properties": inner}
    values = node.get("additionalProperties")
    if isinstance(values, dict):
        pair = {"key": {"type": "string"}, "value": _flat(values, definitions, where)}
        return {"type": "array", "items": {"type": "object", "properties": pair}, "$comment": PAIRS}
    return {"type": "string", "contentMediaType": JSON_TEXT}
