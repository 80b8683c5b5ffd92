"""Images as cameras and their programs write them: TIFF, a matrix of numbers as text, LMK .pf; row 0 as in the file.

LMK .pf (TechnoTeam): lines `Key=Value` with `Typ`, `Lines` and `Columns`, a zero byte, then the pixels row by row,
little-endian. Read are the grey kinds, `Pic98::TPlane<float>` (a luminance image) and
`Pic98::TPlane<unsigned short>` (a camera image); colour images and the text form are not.
"""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np

from luxloop.errors import InputError
from validation.dataset.images import IMAGE_TYPES, Pixels, read_tiff

TIFF, TEXT, LMK = (".tif", ".tiff"), (".csv", ".txt"), (".pf",)
LMK_KINDS = {"Pic98::TPlane<float>": "<f4", "Pic98::TPlane<unsigned short>": "<u2"}
MAX_HEADER_BYTES = 65_536


def is_image(path: Path) -> bool:
    """Whether a file's ending is one that is read here."""
    return path.suffix.lower() in TIFF + TEXT + LMK


def read_foreign(path: Path, name: str, types: tuple[str, ...] = IMAGE_TYPES) -> Pixels:
    """The image in a file as uint16 or float32 (a mask also uint8 or bool); `name` is what errors call the file.

    Raises InputError for what cannot be read as an image.
    """
    suffix = path.suffix.lower()
    if suffix in TIFF:
        return read_tiff(path, name, types).values
    if suffix in TEXT:
        return _matrix(path, name)
    if suffix in LMK:
        return _lmk(path, name)
    raise InputError(f"{name}: format", path.suffix, ", ".join(TIFF + TEXT + LMK), "save the image as TIFF")


def _matrix(path: Path, name: str) -> Pixels:
    """A matrix as text: one row a line; tabs, semicolons, commas or blanks between; whole numbers become uint16.

    Beside tabs and semicolons a comma can only be a decimal one; thousands that are set apart are refused.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{name}: format", "no UTF-8", "numbers as text", "save it as UTF-8") from None
    lines = [line.partition("#")[0] for line in text.splitlines()]
    first = next((line for line in lines if line.strip()), "")
    between = next((mark for mark in ("\t", ";", ",") if mark in first), None)
    lines = [line.rstrip(" " + (between or "")) for line in lines]
    if between in ("\t", ";"):
        _refuse_thousands(lines, between, name)
        lines = [line.replace(",", ".") for line in lines]
    try:
        values = np.loadtxt(io.StringIO("\n".join(lines)), delimiter=between, ndmin=2)
    except ValueError as error:
        mend = "a header line? Remove it. Rows of different lengths? Export the matrix again"
        raise InputError(f"{name}: format", str(error)[:80], "a matrix of numbers", mend) from None
    if min(values.shape, default=0) < 2:
        raise InputError(f"{name}: size", values.shape, "a matrix: rows and columns of pixels", "one row a line")
    whole = bool(np.all(values == np.round(values))) and 0.0 <= values.min() <= values.max() <= 65_535.0
    return values.astype(np.uint16 if whole else np.float32)


def _refuse_thousands(lines: list[str], between: str, name: str) -> None:
    """InputError where commas are not all decimal ones: two in a cell, or points beside them."""
    cells = (cell for line in lines if "," in line for cell in line.split(between))
    cell = next((cell for cell in cells if cell.count(",") > 1), "")
    points, commas = (next((line for line in lines if mark in line), "") for mark in ".,")
    if cell or (points and commas):
        value = cell or f"{points[:40]} and {commas[:40]}"
        mend = "export the matrix without marks between thousands"
        raise InputError(f"{name}: format", value, "decimal commas or decimal points, not both", mend)


def _lmk(path: Path, name: str) -> Pixels:
    """A grey LMK image."""
    raw = path.read_bytes()
    end = raw.find(b"\0", 0, MAX_HEADER_BYTES)
    lines = raw[: max(end, 0)].decode("latin-1").splitlines()
    header = dict(line.lstrip("|").partition("=")[::2] for line in lines if "=" in line)
    kind = header.get("Typ", "(none)")
    if end < 0 or kind not in LMK_KINDS:
        mend = "export one channel as TIFF" if "RGB" in kind else "is it an LMK image, in its binary form?"
        raise InputError(f"{name}: Typ", kind, " or ".join(LMK_KINDS), mend)
    sizes = [header.get(key, "") for key in ("Lines", "Columns")]
    if not all(re.fullmatch(r"[1-9]\d{0,5}", size.strip()) for size in sizes):
        raise InputError(f"{name}: Lines, Columns", sizes, "two whole numbers", "save it again")
    rows, columns = map(int, sizes)
    number = np.dtype(LMK_KINDS[kind])
    there, needed = len(raw) - end - 1, rows * columns * number.itemsize
    if there != needed:
        raise InputError(f"{name}: size", f"{there} bytes", f"{needed} bytes: {rows} x {columns}", "save it again")
    pixels = np.frombuffer(raw, number, offset=end + 1).reshape(rows, columns)
    return pixels.astype(number.newbyteorder("="))
