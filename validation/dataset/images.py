"""Camera images as TIFF: one page, grey, uint16 or float32; read into arrays (row, column), row 0 at the lowest y.

What a file is (pages, colour, type of number) is refused here, at the first fault; what its pixels say is looked at
by `validation.dataset.image_checks`. Fields of errors are "FILE: what".
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from validation.dataset.packed import refuse_more_than_declared, segment_bytes

if TYPE_CHECKING:
    import tifffile

Real = NDArray[np.float64]
Pixels = NDArray[Any]

IMAGE_TYPES = ("uint16", "float32")
MASK_TYPES = ("bool", "uint8", "uint16")
MAX_PIXEL_BYTES = 256 << 20
TRANSFER_FUNCTION, ICC_PROFILE = 301, 34675  # TIFF tags that say that values are meant for a screen
ORIENTATION = 274  # the TIFF tag that says how rows and columns are to be turned and mirrored
WHY_NOT = {
    "uint8": "8-bit images are gamma-encoded or too coarse: save the camera's raw image as 16 bit",
    "int16": "signed numbers: save it as uint16",
    "int32": "signed numbers: save it as uint16",
    "float64": "save it as float32",
    "uint32": "a sum of frames? divide by their number, save as float32, and set frames_averaged",
}


class TiffImage(NamedTuple):
    """Pixels (row, column), and whether the file carries a transfer curve or a colour profile."""

    values: Pixels
    for_screens: bool


def read_tiff(path: Path, name: str, types: tuple[str, ...] = IMAGE_TYPES) -> TiffImage:
    """The one grey image of a TIFF file; `name` is what errors call the file.

    Raises InputError for what is no TIFF, damaged, of several pages, colour, of another type of number, larger than
    256 MB once unpacked or than its pixels, or packed so that a package is missing, which is named.
    """
    tifffile = library("reading TIFF")
    try:
        with tifffile.TiffFile(path) as file:
            page = _only_page(file, name, types)
            refuse_more_than_declared(file, page, name)
            values = page.asarray()
            for_screens = any(tag in page.tags for tag in (TRANSFER_FUNCTION, ICC_PROFILE))
    except InputError:
        raise
    except tifffile.TiffFileError as error:
        raise InputError(f"{name}: format", str(error)[:60], "a TIFF file", "save the image as TIFF") from None
    except Exception as error:  # tifffile meets damage in many ways: struct.error, IndexError, ValueError, zlib.error
        raise _unreadable(error, name) from error
    return TiffImage(values, for_screens)


def library(what_for: str) -> Any:
    """tifffile, imported late; InputError naming the mend where it is not installed."""
    try:
        import tifffile
    except ImportError:
        mend = "pip install 'luxloop[validation]'"
        raise InputError("tifffile", "not installed", f"the package tifffile for {what_for}", mend) from None
    return tifffile


def write_tiff(path: Path, values: Pixels) -> None:
    """Write an image (row, column) of uint16, float32 or uint8 as an uncompressed grey TIFF of one page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    library("writing TIFF").imwrite(path, np.ascontiguousarray(values), photometric="minisblack", metadata=None)


def _only_page(file: tifffile.TiffFile, name: str, types: tuple[str, ...]) -> Any:
    """The page of a file that holds what is allowed, before its pixels are read."""
    if len(file.pages) != 1:
        raise InputError(f"{name}: pages", len(file.pages), "1", "average the frames, or save them one by one")
    page: Any = file.pages[0]
    kind = getattr(page.photometric, "name", str(page.photometric))
    if page.samplesperpixel != 1 or kind not in ("MINISBLACK", "MINISWHITE") or len(page.shape) != 2:
        said = f"{kind.lower()}, {page.samplesperpixel} values a pixel, shape {page.shape}"
        raise InputError(f"{name}: colour", said, "grey, one value a pixel", "save the raw channel as grey")
    if (turned := page.tags.valueof(ORIENTATION, 1)) != 1:
        mend = "saved turned: save it upright, or strip the tag"
        raise InputError(f"{name}: orientation", int(turned), "1, rows and columns as in the file", mend)
    if kind == "MINISWHITE":
        raise InputError(f"{name}: photometric", "0 is white", "0 is black", "invert it when saving")
    kind_of_number = str(np.dtype(page.dtype)) if page.dtype is not None else f"{page.bitspersample} bits"
    if kind_of_number not in types:
        raise InputError(f"{name}: dtype", kind_of_number, " or ".join(types), WHY_NOT.get(kind_of_number, ""))
    if (size_bytes := max(page.nbytes, segment_bytes(page))) > MAX_PIXEL_BYTES:
        allowed = f"at most {MAX_PIXEL_BYTES >> 20} MB of pixels"
        raise InputError(f"{name}: size", f"{size_bytes >> 20} MB", allowed, "crop or bin the image")
    return page


def _unreadable(error: Exception, name: str) -> InputError:
    """What to say of a TIFF that could be opened and not be read: a package is missing, or it is damaged."""
    packed = re.search(r"COMPRESSION\.(\w+)", str(error))
    if "imagecodecs" in str(error):
        value = f"{packed[1]} compression" if packed else str(error)[:60]
        mend = "pip install 'luxloop[compressed]' (the package imagecodecs), or save it uncompressed"
        return InputError(f"{name}: compression", value, "none, or deflate", mend)
    value = str(error)[:60] or type(error).__name__
    return InputError(f"{name}: format", value, "a whole TIFF file", "save it again")


def binned_mean(values: Pixels, factor: int) -> Real:
    """The mean over squares of `factor` x `factor` pixels; what is left over is cut off evenly at both ends."""
    if factor == 1:
        return np.asarray(values, np.float64)
    cut = _whole_bins(values, factor)
    rows, columns = (size // factor for size in cut.shape)
    sums = cut.reshape(rows, factor, -1).sum(axis=1, dtype=np.float64)
    return np.asarray(sums.reshape(rows, columns, factor).sum(axis=2) / factor**2)


def binned_any(flags: NDArray[np.bool_], factor: int) -> NDArray[np.bool_]:
    """Whether any pixel of a square of `factor` x `factor` is flagged; cut as in `binned_mean`."""
    if factor == 1:
        return flags
    cut = _whole_bins(flags, factor)
    rows, columns = (size // factor for size in cut.shape)
    return np.asarray(cut.reshape(rows, factor, -1).any(axis=1).reshape(rows, columns, factor).any(axis=2))


def binned_place(place_px: float, size: int, factor: int) -> float:
    """Where a place of an axis of `size` pixels lies in binned pixels; the centres of pixels are whole numbers."""
    return (place_px - _cut_off(size, factor) + 0.5) / factor - 0.5


def _whole_bins(values: Pixels, factor: int) -> Pixels:
    (row, rows), (column, columns) = ((_cut_off(n, factor), n // factor * factor) for n in values.shape)
    return values[row : row + rows, column : column + columns]


def _cut_off(size: int, factor: int) -> int:
    return size % factor // 2
