"""A film table as bytes: a JSON header and named arrays in one deterministic encoding, whose SHA-256 is its address.

    "LXF1" | header bytes u32 | header (canonical JSON, describes the arrays), blanks to a multiple of 8 | arrays, raw

Arrays are little-endian, float64 before those of 32 bits and then by name, so that each begins at a multiple of its
size. Nothing is unpickled; every length is checked before it is used.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from luxloop.words import canonical

MAGIC = b"LXF1"
DTYPES = ("<f8", "<f4", "<i4")
MAX_BYTES = 64 << 20
MAX_AXES = 8


def pack(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The bytes of a header (JSON values) and arrays (f8, f4 or i4); the same input gives the same bytes."""
    described, raws = [], []
    for name, array in sorted(arrays.items(), key=lambda item: (-item[1].dtype.itemsize, item[0])):
        dtype = array.dtype.newbyteorder("<").str
        if dtype not in DTYPES:
            raise InputError(name, array.dtype.str, "one of " + ", ".join(DTYPES))
        described.append([name, dtype, list(array.shape)])
        raws.append(np.ascontiguousarray(array, dtype=dtype).tobytes())
    text = canonical({"header": dict(header), "arrays": described})
    text += b" " * (-(len(text) + 8) % 8)
    packed = b"".join([MAGIC, struct.pack("<I", len(text)), text, *raws])
    if len(packed) > MAX_BYTES:
        raise InputError("table", f"{len(packed)} bytes", f"at most {MAX_BYTES} bytes", "use a coarser grid")
    return packed


def unpack(packed: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and arrays of `pack`. Raises InputError where bytes are missing, too many, or no packed table."""
    if not 8 <= len(packed) <= MAX_BYTES or packed[:4] != MAGIC:
        raise InputError("table", packed[:8], f"a packed film table of at most {MAX_BYTES} bytes")
    (size,) = struct.unpack_from("<I", packed, 4)
    try:
        text = json.loads(packed[8 : 8 + size])
        header = dict(text["header"])
        described = [(str(name), str(dtype), [int(n) for n in shape]) for name, dtype, shape in text["arrays"]]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError("table", packed[8:40], "a packed film table", "its header cannot be read") from error
    arrays, offset = {}, 8 + size
    for name, dtype, shape in described:
        sizes = len(shape) <= MAX_AXES and min(shape, default=0) >= 0 and prod(shape) * 4 <= MAX_BYTES
        if dtype not in DTYPES or not sizes:
            allowed = f"dtype in {DTYPES}, up to {MAX_AXES} axes, at most {MAX_BYTES} bytes"
            raise InputError(f"table.{name}", (dtype, shape[: MAX_AXES + 1]), allowed)
        count = prod(shape)
        end = offset + count * int(dtype[2])
        if end > len(packed):
            raise InputError(f"table.{name}", f"{len(packed)} bytes", f"at least {end} bytes", "it was cut short")
        arrays[name] = np.frombuffer(packed, dtype=dtype, count=count, offset=offset).reshape(shape)
        offset = end
    if offset != len(packed):
        raise InputError("table", f"{len(packed)} bytes", f"{offset} bytes as its header says")
    return header, arrays
