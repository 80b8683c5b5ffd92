"""A message as bytes: one self-describing frame, the same on zenoh, in process and in a file.

    "LXL1" | head bytes u32 | body bytes u32 | head (JSON) | body (JSON) | 0..7 zeros | arrays, raw little-endian

The head names the schema, the kind of message and each array (name, dtype, shape, SHA-256). Arrays above
`INLINE_BYTES` do not travel in the frame: the sender keeps them in its store and the receiver fetches them by hash.
Nothing is unpickled; every length is checked before it is used.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from math import prod
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from luxloop.errors import InputError
from luxloop.messages import MESSAGES, SCHEMA
from luxloop.words import Words, as_input_error

MAGIC = b"LXL1"
INLINE_BYTES = 1 << 20
HEADER_BYTES = 1 << 20
FRAME_BYTES = 16 << 20
ARRAY_BYTES = 1 << 32
USUAL_HEAD_BYTES = 100
MAX_ARRAYS = 256
DTYPES = ("<f8", "<f4", "<i8", "<i4", "<u8", "<u4", "<u2", "|u1")

Array = NDArray[Any]
Message = TypeVar("Message", bound=Words)


@dataclass(frozen=True)
class Parcel:
    """A decoded frame: the message, and its arrays by name."""

    message: Words
    arrays: Mapping[str, Array] = field(default_factory=dict)

    def expect(self, kind: type[Message]) -> Message:
        """The message as a `kind`, or an `InputError` naming both."""
        if not isinstance(self.message, kind):
            raise InputError("kind", type(self.message).__name__, kind.__name__, "both sides of one release?")
        return self.message


def encode(
    message: Words, arrays: Mapping[str, Array] | None = None, keep: Callable[[bytes], str] | None = None
) -> bytes:
    """`message` and its arrays as a frame; arrays above `INLINE_BYTES` go to `keep` (a store) and by hash only.

    Raises InputError where the frame would be over its limit, or a large array comes without a store.
    """
    specs, chunks = [], []
    for name, array in (arrays or {}).items():
        raw, dtype = _raw(name, array)
        spec: dict[str, Any] = {"name": name, "dtype": dtype, "shape": list(array.shape)}
        if len(raw) > INLINE_BYTES:
            if keep is None:
                raise InputError(name, f"{len(raw)} bytes", f"at most {INLINE_BYTES} bytes without a store")
            specs.append(spec | {"sha256": keep(raw), "inline": False})
        else:
            specs.append(spec | {"sha256": hashlib.sha256(raw).hexdigest(), "inline": True})
            chunks += [raw, bytes(-len(raw) % 8)]
    head = json.dumps({"schema": SCHEMA, "kind": type(message).__name__, "arrays": specs}).encode()
    body = message.model_dump_json().encode()
    size = len(head) + len(body)
    if size > HEADER_BYTES or size + sum(map(len, chunks)) > FRAME_BYTES - 64:
        raise InputError(
            type(message).__name__,
            f"{size + sum(map(len, chunks))} bytes",
            f"at most {HEADER_BYTES} bytes of text and {FRAME_BYTES} in all",
            "send less at once; arrays above 1 MB go by hash",
        )
    start = MAGIC + struct.pack("<II", len(head), len(body)) + head + body
    return b"".join([start, bytes(-len(start) % 8), *chunks])


def decode(data: bytes, fetch: Callable[[str, int], bytes] | None = None) -> Parcel:
    """The parcel in `data`, every array's hash checked; arrays sent by hash are got from `fetch(sha256, bytes)`.

    Without `fetch` (a controller that only passes a result on) arrays sent by hash are left out.
    Raises InputError where bytes are missing, too many, of another schema, or do not match their hash.
    """
    head, body, offset = _split(data)
    kind = head.get("kind")
    model = MESSAGES.get(kind) if isinstance(kind, str) else None
    if model is None:
        raise InputError("kind", kind, "a message of this release: " + ", ".join(sorted(MESSAGES)))
    try:
        message = model.model_validate_json(body)
    except ValidationError as error:
        raise as_input_error(error, model.__name__) from error
    arrays: dict[str, Array] = {}
    for name, dtype, shape, sha256, inline in _specs(head):
        size = prod(shape) * np.dtype(dtype).itemsize
        if inline:
            raw = data[offset : offset + size]
            offset += size + (-size % 8)
        elif fetch is not None:
            raw = fetch(sha256, size)
        else:
            continue
        if len(raw) != size or hashlib.sha256(raw).hexdigest() != sha256:
            raise InputError(name, f"{len(raw)} bytes", f"{size} bytes with SHA-256 {sha256}", "send it again")
        arrays[name] = np.frombuffer(raw, dtype=dtype).reshape(shape)
    if len(data) - offset >= 8:  # less is padding
        raise InputError("frame", f"{len(data)} bytes", f"{offset} bytes as its head says")
    return Parcel(message, arrays)


def reframe(data: bytes, message: Words) -> bytes:
    """The frame `data` with another message in front of the same arrays, which are not touched or copied twice."""
    head, _, offset = _split(data)
    new = json.dumps({"schema": SCHEMA, "kind": type(message).__name__, "arrays": head["arrays"]}).encode()
    body = message.model_dump_json().encode()
    start = MAGIC + struct.pack("<II", len(new), len(body)) + new + body
    return b"".join([start, bytes(-len(start) % 8), data[offset:]])


def _raw(name: str, array: Array) -> tuple[bytes, str]:
    dtype = array.dtype.newbyteorder("<").str
    if dtype not in DTYPES:
        raise InputError(name, array.dtype.str, "one of " + ", ".join(DTYPES))
    return np.ascontiguousarray(array, dtype=dtype).tobytes(), dtype


def _split(data: bytes) -> tuple[dict[str, Any], bytes, int]:
    """Head, body and the offset of the arrays; every length checked."""
    if len(data) > FRAME_BYTES:
        raise InputError("frame", f"{len(data)} bytes", f"at most {FRAME_BYTES} bytes")
    if len(data) < 12 or data[:4] != MAGIC:
        raise InputError("frame", data[:12], f"bytes that begin with {MAGIC!r}", "is this a luxloop of another age?")
    head_size, body_size = struct.unpack_from("<II", data, 4)
    end = 12 + head_size + body_size
    if head_size + body_size > HEADER_BYTES or end > len(data):
        raise InputError("frame", f"{len(data)} bytes", f"{end} bytes of text as it announces", "it was cut short")
    raw = data[12 : 12 + head_size]
    head = _read_usual_head(raw) if head_size <= USUAL_HEAD_BYTES else _read_head(raw)
    return head, data[12 + head_size : end], end + (-end % 8)


def _read_head(raw: bytes) -> dict[str, Any]:
    try:
        head = json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise InputError("frame", raw[:30], "a JSON head") from error
    if not isinstance(head, dict) or head.get("schema") != SCHEMA:
        seen = head.get("schema") if isinstance(head, dict) else head
        raise InputError("schema", seen, f"{SCHEMA}", "run the same release of luxloop on all sides")
    return head


_read_usual_head = lru_cache(64)(_read_head)  # messages without arrays have one head for each kind


def _specs(head: dict[str, Any]) -> list[tuple[str, str, tuple[int, ...], str, bool]]:
    """The arrays' descriptions, checked for type and size before anything is allocated."""
    specs = []
    announced = head.get("arrays")
    if not isinstance(announced, list) or len(announced) > MAX_ARRAYS:
        raise InputError("arrays", announced, f"a list of at most {MAX_ARRAYS}")
    for spec in announced:
        try:
            name, dtype, sha256 = str(spec["name"]), str(spec["dtype"]), str(spec["sha256"])
            shape, inline = tuple(spec["shape"]), bool(spec["inline"])
        except (KeyError, TypeError) as error:
            raise InputError("arrays", spec, "name, dtype, shape, sha256, inline") from error
        sizes = all(type(n) is int and 0 <= n <= ARRAY_BYTES for n in shape)  # not bool, not float
        if dtype not in DTYPES or not sizes or len(shape) > 8 or prod(max(n, 1) for n in shape) > ARRAY_BYTES // 8:
            raise InputError(f"arrays.{name}", (dtype, shape), f"dtype in {DTYPES}, at most {ARRAY_BYTES} bytes")
        specs.append((name, dtype, shape, sha256, inline))
    return specs
