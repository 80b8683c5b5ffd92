"""The lines of a CSV, and what is said of one that cannot be cut into cells."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from luxloop.errors import InputError


def csv_lines(text: str, name: str, between: str = ",") -> Iterator[tuple[int, list[str]]]:
    """The number of the last line of each row, from 1, and its cells; `name` is what errors call the file.

    Raises InputError naming the line at which a row begins that cannot be read.
    """
    reader = csv.reader(io.StringIO(text), delimiter=between)
    begins = 1
    try:
        for cells in reader:
            begins = reader.line_num + 1
            yield reader.line_num, cells
    except csv.Error as error:
        mend = "a quotation mark that is not closed, or line ends of two kinds"
        raise InputError(f"{name}: line {begins}", str(error), "cells of a CSV", mend) from None
