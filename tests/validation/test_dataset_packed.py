"""Packed TIFFs: what unpacks to more than its pixels is refused before it fills the memory."""

from __future__ import annotations

import lzma
import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile

from luxloop.errors import InputError
from validation.dataset.images import read_tiff

SIZE_PX = 64
PIXELS = np.arange(SIZE_PX * SIZE_PX, dtype="<u2").reshape(SIZE_PX, SIZE_PX)
WHOLE = PIXELS.tobytes()
MANY = 40 << 20
DEFLATE, OLD_DEFLATE, LZMA, PACKBITS = 8, 32946, 34925, 32773
MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def tiff(path: Path, compression: int, packed: bytes, fill_order: int = 1, tile_px: int = 0) -> Path:
    """A grey TIFF of 64 x 64 uint16 in one strip, or in one tile, that holds these bytes."""
    short, long = 3, 4
    place = [(322, short, tile_px), (323, short, tile_px), (324, long, 0), (325, long, len(packed))]
    strip = [(273, long, 0), (278, short, SIZE_PX), (279, long, len(packed))]
    tags = [
        (256, short, SIZE_PX),
        (257, short, SIZE_PX),
        (258, short, 16),
        (259, short, compression),
        (262, short, 1),
    ]
    tags = sorted([*tags, (266, short, fill_order), (277, short, 1), *(place if tile_px else strip)])
    start = 8 + 2 + 12 * len(tags) + 4
    body = struct.pack("<H", len(tags))
    for tag, kind, value in tags:
        body += struct.pack("<HHII", tag, kind, 1, start if tag in (273, 324) else value)
    path.write_bytes(b"II*\0" + struct.pack("<I", 8) + body + bytes(4) + packed)
    return path


def run(byte: int, count: int) -> bytes:
    """So many equal bytes by PackBits, whose longest run has 128."""
    return bytes([129, byte]) * (count // 128)


@pytest.mark.parametrize(
    ("compression", "packed", "fill_order"),
    [
        (DEFLATE, zlib.compress(WHOLE), 1),
        (DEFLATE, zlib.compress(WHOLE).translate(MIRRORED), 2),
        (OLD_DEFLATE, zlib.compress(WHOLE) + b"what follows", 1),
        (LZMA, lzma.compress(WHOLE), 1),
        (LZMA, lzma.compress(WHOLE[:4000]) + lzma.compress(WHOLE[4000:]), 1),
    ],
    ids=["deflate", "mirrored bits", "deflate with more behind it", "LZMA", "LZMA in two streams"],
)
def test_what_unpacks_to_its_pixels_is_read(tmp_path: Path, compression: int, packed: bytes, fill_order: int) -> None:
    """As tifffile reads it."""
    image = read_tiff(tiff(tmp_path / "a.tif", compression, packed, fill_order), "a.tif")
    np.testing.assert_array_equal(image.values, PIXELS)


@pytest.mark.parametrize("tile", [None, (32, 48)])
def test_strips_and_tiles_are_read(tmp_path: Path, tile: tuple[int, int] | None) -> None:
    """The last ones reach beyond the image, or are shorter."""
    pixels = np.random.default_rng(1).integers(0, 4096, (100, 90), np.uint16)
    rows = None if tile else 7
    tifffile.imwrite(tmp_path / "a.tif", pixels, compression="deflate", tile=tile, rowsperstrip=rows, predictor=False)
    np.testing.assert_array_equal(read_tiff(tmp_path / "a.tif", "a.tif").values, pixels)


def packed_zeros(compression: int) -> bytes:
    """Many zeros in one strip."""
    match compression:
        case 8:
            return zlib.compress(bytes(MANY), 1)
        case 34925:
            return lzma.compress(bytes(MANY), preset=0)
        case _:
            return run(0, MANY)


@pytest.mark.parametrize(
    ("compression", "before", "fill_order"),
    [(DEFLATE, b"", 1), (DEFLATE, b"", 2), (LZMA, b"", 1), (LZMA, lzma.compress(WHOLE), 1), (PACKBITS, b"", 1)],
    ids=["deflate", "mirrored bits", "LZMA", "LZMA, second stream", "PackBits"],
)
def test_what_unpacks_to_more_than_its_pixels_is_refused(
    tmp_path: Path, compression: int, before: bytes, fill_order: int
) -> None:
    """40 MB for 8 kB of pixels: neither read nor held."""
    packed = before + packed_zeros(compression)
    path = tiff(
        tmp_path / "a.tif", compression, packed.translate(MIRRORED) if fill_order == 2 else packed, fill_order
    )
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"a\.tif: size: got 'more than 8,192 bytes"):
            read_tiff(path, "a.tif")
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()


def test_a_tile_larger_than_an_image_may_be_is_refused(tmp_path: Path) -> None:
    """Of an image of 64 x 64 pixels."""
    path = tiff(tmp_path / "a.tif", DEFLATE, zlib.compress(WHOLE), tile_px=32_768)
    with pytest.raises(InputError, match=r"a\.tif: size: got '2048 MB"):
        read_tiff(path, "a.tif")


def test_a_strip_that_is_cut_off_is_damaged(tmp_path: Path) -> None:
    """As before: by its format."""
    for compression, packed in ((DEFLATE, zlib.compress(WHOLE)), (LZMA, lzma.compress(WHOLE))):
        path = tiff(tmp_path / "a.tif", compression, packed[: len(packed) // 2])
        with pytest.raises(InputError, match=r"a\.tif: format"):
            read_tiff(path, "a.tif")
