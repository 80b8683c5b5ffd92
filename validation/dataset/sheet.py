"""The table of an import: a CSV with a row per image file and what was in front of the camera.

    file,sample,layout,rows,columns,distance_um,width_um,spacing_um,thickness_um,dbr_pairs,exposure_ms,...

Columns may be missing and cells empty: options then say it for all images at once.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from luxloop.effect import did_you_mean
from luxloop.errors import InputError
from luxloop.files import whole
from validation.dataset.csv_lines import csv_lines
from validation.writing import written

DESIGN = ("distance_um", "width_um", "spacing_um", "thickness_um", "dbr_pairs")
SAMPLE = ("layout", "rows", "columns", *DESIGN)
FILES = ("dark", "flat", "mask")
COLUMNS = ("file", "sample", *SAMPLE, "exposure_ms", "frames_averaged", "dark_frames_averaged", *FILES)
WHOLE = ("rows", "columns", "frames_averaged", "dark_frames_averaged")
WORDS = ("file", "sample", "layout", *FILES)

Value = str | float | int
Row = dict[str, Value]


def read_sheet(path: Path) -> list[Row]:
    """The rows of a table, without their empty cells. Raises InputError for the first thing wrong with it."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("--table", str(path), "a CSV file", str(error)[:80]) from None
    between = ";" if ";" in text.partition("\n")[0] else ","  # spreadsheets of half of Europe write semicolons
    lines = csv_lines(text, path.name, between)
    header = [cell.strip() for cell in next(lines, (1, []))[1]]
    for column in header:
        if column not in COLUMNS:
            raise InputError(f"{path.name}: line 1", column, ", ".join(COLUMNS), did_you_mean(column, COLUMNS))
        if header.count(column) > 1:
            raise InputError(f"{path.name}: line 1", column, "each column once", "take one of the two away")
    if "file" not in header:
        raise InputError(f"{path.name}: line 1", ", ".join(header), "a column file", "--write-table writes one")
    rows = []
    for number, cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        where = f"{path.name}: line {number}"
        if len(cells) != len(header):
            open_quote = any("\n" in cell for cell in cells)
            mend = "a quotation mark that is not closed" if open_quote else "a decimal comma? Write a point"
            raise InputError(where, f"{len(cells)} cells", f"{len(header)}, as in line 1", mend)
        filled = {name: cell.strip() for name, cell in zip(header, cells, strict=True) if cell.strip()}
        if "file" not in filled:
            raise InputError(f"{where}: file", "", "the name of an image file")
        rows.append({name: _value(name, cell, f"{where}: {name}") for name, cell in filled.items()})
    return rows


def _value(name: str, cell: str, where: str) -> Value:
    if name in WORDS:
        return cell
    try:
        return int(cell) if name in WHOLE else float(cell)
    except ValueError:
        comma = re.fullmatch(r"[-+]?\d+,\d+", cell)
        mend = "a decimal comma: write a point" if comma else ""
        raise InputError(where, cell, "a whole number" if name in WHOLE else "a number", mend) from None


def write_sheet(path: Path, files: Iterable[str], known: Mapping[str, Value]) -> None:
    """Write a table to fill in: the files, and what is known of all of them. Raises InputError if it exists."""
    if path.exists():
        raise InputError("--write-table", str(path), "a file that does not exist", "give another name")
    rows = [{**known, "file": name} for name in files]
    with (
        written("--write-table", path, "name a file in a folder that is there, where you may write"),
        whole(path) as fresh,
        fresh.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
