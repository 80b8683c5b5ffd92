"""Whether a packed TIFF unpacks to no more than its pixels.

That is found out before tifffile unpacks it, which by itself knows no end.
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from itertools import islice
from math import prod
from typing import Any

import numpy as np

from luxloop.errors import InputError

LZMA_MEMORY_BYTES = 128 << 20
"""Its strongest preset needs 65 MB to unpack."""
MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
"""Of each byte the one with its bits in the other order, as files of FillOrder 2 have them."""


def segment_bytes(page: Any) -> int:
    """The bytes of a strip or tile of a grey page, unpacked; a tile may reach beyond the image."""
    return int(prod(page.chunks) * np.dtype(page.dtype).itemsize)


def refuse_more_than_declared(file: Any, page: Any, name: str) -> None:
    """Raise InputError where a strip or tile of a page of a tifffile.TiffFile unpacks to more than its pixels.

    What is damaged may raise anything; of a packing that is not known here nothing is said.
    """
    unpacked = UNPACKED.get(int(page.compression))
    if unpacked is None:
        return
    most_bytes, handle = segment_bytes(page), file.filehandle
    for offset, count in islice(zip(page.dataoffsets, page.databytecounts, strict=False), prod(page.chunked)):
        handle.seek(offset)
        packed = handle.read(min(count, handle.size))
        if unpacked(packed.translate(MIRRORED) if page.fillorder == 2 else packed, most_bytes) > most_bytes:
            found = f"more than {most_bytes:,} bytes in one strip or tile"
            raise InputError(f"{name}: size", found, "as many as its pixels have", "save it again, uncompressed")


def _deflate(packed: bytes, most_bytes: int) -> int:
    """How many bytes come out, up to one more than `most_bytes`."""
    return len(zlib.decompressobj().decompress(packed, most_bytes + 1))


def _lzma(packed: bytes, most_bytes: int) -> int:
    """The same; of several streams behind each other all, and what is none at the end is passed over."""
    found = 0
    while packed and found <= most_bytes:
        stream = lzma.LZMADecompressor(memlimit=LZMA_MEMORY_BYTES)
        try:
            found += len(stream.decompress(packed, most_bytes + 1 - found))
        except lzma.LZMAError:
            if found:
                break
            raise
        packed = stream.unused_data
    return found


def _packbits(packed: bytes, most_bytes: int) -> int:
    """The same, by the lengths of its runs alone."""
    found = place = 0
    while place < len(packed) and found <= most_bytes:
        head = packed[place]
        if head < 128:  # so many bytes and one as they are
            found, place = found + head + 1, place + head + 2
        elif head > 128:  # one byte many times
            found, place = found + 257 - head, place + 2
        else:
            place += 1
    return found


UNPACKED: dict[int, Callable[[bytes, int], int]] = {
    8: _deflate, 32946: _deflate, 50013: _deflate, 34925: _lzma, 32773: _packbits,
}  # fmt: skip
"""By the TIFF tag Compression: those that tifffile unpacks by itself."""
