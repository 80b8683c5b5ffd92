"""Records that every viewer can read: flat schemas, values that agree with them, nothing lost on the way."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from luxloop.errors import InputError
from luxloop.journal.schemas import conform, flat_schema, restore
from luxloop.journal.topics import TOPICS, Record, record
from luxloop.words import Plain, Words
from tests.journals import records_of_step

ALLOWED = {"object", "array", "string", "number", "integer", "boolean"}
KEYS = {"type", "properties", "items", "description", "title", "contentMediaType", "$comment"}
WORDS = {topic: kind for topic, kind in TOPICS.items() if isinstance(kind, type)}
PYTHON: dict[str, type | tuple[type, ...]] = {"string": str, "number": (int, float), "integer": int, "boolean": bool}


def agrees(value: Any, schema: dict[str, Any]) -> bool:
    """Whether a value is what its schema says: a validator of the few words that flat schemas use."""
    if schema["type"] == "object":
        known = schema["properties"]
        return isinstance(value, dict) and all(name in known and agrees(v, known[name]) for name, v in value.items())
    if schema["type"] == "array":
        return isinstance(value, list) and all(agrees(item, schema["items"]) for item in value)
    return isinstance(value, PYTHON[schema["type"]]) and (schema["type"] == "boolean" or not isinstance(value, bool))


def nodes(schema: dict[str, Any]) -> list[dict[str, Any]]:
    """A schema and all schemas inside it."""
    inner = [*schema.get("properties", {}).values(), *([schema["items"]] if "items" in schema else [])]
    return [schema, *(node for child in inner for node in nodes(child))]


@pytest.mark.parametrize("topic", WORDS)
def test_every_channel_uses_only_what_viewers_know(topic: str) -> None:
    """No reference, union, null, tuple or free keys; every object has properties, every array items."""
    for node in nodes(flat_schema(WORDS[topic])):
        assert node["type"] in ALLOWED
        assert node.keys() <= KEYS
        assert (node["type"] == "object") == ("properties" in node)
        assert (node["type"] == "array") == ("items" in node)


@pytest.mark.parametrize("topic", WORDS)
def test_what_may_be_null_is_null_where_it_is_absent(topic: str) -> None:
    """Nulls are left out of records: then the default must be null."""
    whole = WORDS[topic].model_json_schema(mode="serialization")
    for model in [whole, *whole.get("$defs", {}).values()]:
        for name, field in model.get("properties", {}).items():
            if {"type": "null"} in field.get("anyOf", []):
                assert (name, field["default"]) == (name, None)


def test_written_records_agree_with_their_schemas() -> None:
    """Every JSON record of a step."""
    checked = 0
    for entry in records_of_step(3):
        kind = TOPICS[entry.topic]
        if isinstance(kind, type):
            assert agrees(json.loads(entry.data), flat_schema(kind))
            checked += 1
    assert checked == 4


class Inner(Words):
    """Something inside."""

    pair: tuple[float, float] | None = None
    names: dict[str, int] = Field(default_factory=dict)


class Everything(Words):
    """Every shape that a field may have."""

    text: str
    count: int = Field(description="How many.")
    flag: bool
    inner: Inner | None = None
    many: tuple[Inner, ...] = ()
    free: Plain = Field(default_factory=dict)
    by_name: dict[str, Inner] = Field(default_factory=dict)


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**60), 2**60)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)
NUMBER = st.floats(allow_nan=False, allow_infinity=False)
INNER = st.builds(
    Inner,
    pair=st.none() | st.tuples(NUMBER, NUMBER),
    names=st.dictionaries(st.text(), st.integers(-(2**53), 2**53), max_size=3),
)
EVERYTHING = st.builds(
    Everything,
    text=st.text(),
    count=st.integers(-(2**53), 2**53),
    flag=st.booleans(),
    inner=st.none() | INNER,
    many=st.lists(INNER, max_size=3).map(tuple),
    free=st.dictionaries(st.text(), JSON, max_size=3),
    by_name=st.dictionaries(st.text(), INNER, max_size=3),
)


@settings(max_examples=80, derandomize=True)
@given(EVERYTHING)
def test_what_is_written_is_what_is_read(words: Everything) -> None:
    """Through JSON text, whatever the values; and it agrees with the schema on the way."""
    schema = flat_schema(Everything)
    flat = json.loads(json.dumps(conform(words.model_dump(mode="json"), schema)))
    assert agrees(flat, schema)
    assert Everything.model_validate(restore(flat, schema)) == words


def test_free_form_is_one_string_of_json_and_named_values_are_pairs() -> None:
    """As a person sees it in a viewer."""
    words = Everything(
        text="t", count=1, flag=True, free={"b": None, "a": [1, 2.5]}, by_name={"x": Inner(pair=(1, 2))}
    )
    assert conform(words.model_dump(mode="json"), flat_schema(Everything)) == {
        "text": "t",
        "count": 1,
        "flag": True,
        "many": [],
        "free": '{"a":[1,2.5],"b":null}',
        "by_name": [{"key": "x", "value": {"pair": [1.0, 2.0], "names": []}}],
    }
    assert flat_schema(Everything)["properties"]["count"]["description"] == "How many."


class Union(Words):
    """Two kinds in one field."""

    either: int | str


class Mixed(Words):
    """Two kinds in one array."""

    both: tuple[int, str]


class Anything(Words):
    """No kind at all."""

    what: Any


@pytest.mark.parametrize(("model", "field"), [(Union, "either"), (Mixed, "both"), (Anything, "what")])
def test_a_field_without_one_form_is_refused_with_its_name(model: type[Words], field: str) -> None:
    """Found when the schema is made, not in a viewer."""
    with pytest.raises(TypeError, match=f"{model.__name__}.{field}"):
        flat_schema(model)


def test_an_integer_that_a_browser_would_round_is_refused() -> None:
    """2^53 goes, one more does not."""
    assert conform(2**53, {"type": "integer"}) == 2**53
    with pytest.raises(InputError, match="string"):
        conform(2**53 + 1, {"type": "integer"})


def test_words_of_another_topic_are_refused() -> None:
    """A step is no request; and a topic must be in the table."""
    step = records_of_step(0)[3]
    with pytest.raises(InputError, match="RequestRecord"):
        record("/request/ray", step.value, 0, 0)
    with pytest.raises(InputError, match="/nonsense"):
        Record("/nonsense", 0, 0, b"")
    with pytest.raises(InputError, match="sequence"):
        Record("/step", 2**32, 0, b"")
    with pytest.raises(InputError, match="log_time_ns"):
        Record("/step", 0, -1, b"")


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b'{"run": 1}', b"\xff", b'{"figures": 3}', b"[" * 100_000])
def test_bytes_that_are_no_record_are_refused_with_their_topic(data: bytes) -> None:
    """Not JSON, of another form, of another kind."""
    with pytest.raises(InputError, match="/step"):
        _ = Record("/step", 0, 0, data).value
