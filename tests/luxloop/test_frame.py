"""Frames: what goes in comes out; whatever else arrives is an InputError, never another exception."""

from __future__ import annotations

import hashlib
import json
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from luxloop.bus.frame import DTYPES, INLINE_BYTES, MAGIC, decode, encode, reframe
from luxloop.errors import InputError
from luxloop.messages import Nothing, Outcome, StatusAsked, Submit, Task

TASK = Task(kind="thin-film", inputs={"pairs": 4.5, "layers": [1.5, 2.25]}, version="1")
SUBMIT = Submit(task=TASK, asker="me")
FRAME = encode(SUBMIT, {"map": np.arange(12, dtype="<f8").reshape(3, 4), "mask": np.ones(3, dtype="|u1")})


def framed(head: Any, body: bytes = b"{}", tail: bytes = b"") -> bytes:
    """Bytes in the form of a frame with any head."""
    text = json.dumps(head).encode()
    start = MAGIC + struct.pack("<II", len(text), len(body)) + text + body
    return start + bytes(-len(start) % 8) + tail


def spec(**changes: Any) -> dict[str, Any]:
    """The description of an empty array, with changes."""
    empty = hashlib.sha256(b"").hexdigest()
    return {"name": "map", "dtype": "<f8", "shape": [0], "sha256": empty, "inline": True} | changes


ARRAYS = st.sampled_from(DTYPES).flatmap(
    lambda dtype: arrays_of.arrays(dtype, arrays_of.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5))
)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(arrays=st.dictionaries(st.text(max_size=10), ARRAYS, max_size=4))
def test_arrays_come_out_bit_for_bit(arrays: dict[str, np.ndarray[Any, Any]]) -> None:
    """Any dtype and shape that is allowed arrives with its bytes, its name, and the message beside it."""
    parcel = decode(encode(SUBMIT, arrays))
    assert parcel.expect(Submit).task.id == TASK.id
    assert set(parcel.arrays) == set(arrays)
    for name, array in arrays.items():
        assert parcel.arrays[name].shape == array.shape
        assert parcel.arrays[name].tobytes() == array.tobytes()


def test_a_large_array_goes_by_hash() -> None:
    """Above 1 MB only its hash is in the frame; what is fetched under it must match."""
    kept: dict[str, bytes] = {}

    def keep(raw: bytes) -> str:
        sha256 = hashlib.sha256(raw).hexdigest()
        kept[sha256] = raw
        return sha256

    array = np.arange(INLINE_BYTES // 8 + 1, dtype="<f8")
    frame = encode(Nothing(), {"map": array}, keep)
    assert len(frame) < 1000
    np.testing.assert_array_equal(decode(frame, lambda sha256, _: kept[sha256]).arrays["map"], array)
    with pytest.raises(InputError, match="SHA-256"):
        decode(frame, lambda _, size: bytes(size))
    assert decode(frame).arrays == {}  # one who only passes it on
    with pytest.raises(InputError, match="without a store"):
        encode(Nothing(), {"map": array})


def test_another_message_before_the_same_arrays() -> None:
    """What the controller does to a delivery: a new message, the arrays' bytes as they were."""
    outcome = Outcome(task_id=TASK.id, result={})
    parcel = decode(reframe(FRAME, outcome))
    assert parcel.expect(Outcome) == outcome
    np.testing.assert_array_equal(parcel.arrays["map"], np.arange(12.0).reshape(3, 4))


@settings(max_examples=400, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_bytes_are_an_input_error(data: st.DataObject) -> None:
    """Bytes changed, cut out, put in or cut off: the same message comes out, or an InputError and nothing else."""
    frame = bytearray(FRAME)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(frame) - 1))
        how = data.draw(st.sampled_from(["change", "cut", "put", "end"]))
        if how == "change":
            frame[at] = data.draw(st.integers(0, 255))
        elif how == "cut":
            del frame[at : at + data.draw(st.integers(1, 16))]
        elif how == "put":
            frame[at:at] = data.draw(st.binary(min_size=1, max_size=16))
        elif at:
            del frame[at:]
        if len(frame) < 2:
            break
    try:
        decode(bytes(frame))
    except InputError:
        return


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(field=st.sampled_from(["name", "dtype", "shape", "sha256", "inline"]), value=JSON, head=JSON)
@example(field="shape", value=[1e18], head=None)
@example(field="shape", value=[True], head=None)
@example(field="shape", value=[0, 10**30], head=None)
@example(field="shape", value=["9"], head=None)
@example(field="shape", value=[-1], head=None)
@example(field="dtype", value="O", head=None)
def test_any_description_of_an_array_is_read_or_refused(field: str, value: Any, head: Any) -> None:
    """A head with any JSON in a field, or any JSON as the head: an InputError, or an empty array."""
    with pytest.raises(InputError):
        decode(framed(head))
    try:
        parcel = decode(framed({"schema": 1, "kind": "StatusAsked", "arrays": [spec(**{field: value})]}))
    except InputError:
        return
    assert all(array.size == 0 for array in parcel.arrays.values())


@pytest.mark.parametrize(
    ("frame", "field"),
    [
        (framed({"schema": 1, "kind": "StatusAsked"}), "arrays"),
        (framed({"schema": 1, "kind": "StatusAsked", "arrays": [spec()] * 257}), "arrays"),
        (framed({"schema": 1, "kind": ["StatusAsked"], "arrays": []}), "kind"),
        (framed({"schema": 1, "kind": "Words", "arrays": []}), "kind"),
        (framed({"schema": 2, "kind": "StatusAsked", "arrays": []}), "schema"),
        (framed({"schema": 1, "kind": "StatusAsked", "arrays": []}, tail=bytes(8)), "frame"),
        (framed({"schema": 1, "kind": "Outcome", "arrays": []}, b'{"a":' * 100_000), "Outcome"),
        (MAGIC + struct.pack("<II", 200_000, 0) + b"[" * 200_000, "frame"),
        (MAGIC + struct.pack("<II", 2**32 - 1, 2**32 - 1), "frame"),
        (b"", "frame"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_hostile_frame_names_what_is_wrong(frame: bytes, field: str) -> None:
    """No list of arrays, too many, another kind or schema, a tail, endless nesting, lengths of 4 GB."""
    with pytest.raises(InputError) as caught:
        decode(frame)
    assert caught.value.field.startswith(field)


def test_an_object_array_is_not_sent() -> None:
    """What would have to be pickled is refused where it would be sent."""
    with pytest.raises(InputError, match="one of <f8"):
        encode(StatusAsked(), {"map": np.array([object()])})
