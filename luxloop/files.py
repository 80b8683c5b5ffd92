"""Files of people: read with errors that mend, whatever lies under the name; written whole or not at all."""

from __future__ import annotations

import os
import re
import shutil
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from luxloop.errors import InputError

MAX_BYTES = 1 << 20
COMMA, COMMA_MEND = re.compile(r"=\s*\d+,\d+\s*(#|$)"), "write decimals with a point"
TOO_LARGE = re.compile(r"[\da-fA-F_]{1000,}|([\[{][^\[\]{}]*){100}")
TOO_DEEP = re.compile(r"""(?m)(^|[\[{,])[ \t]*(("(\\.|[^"\\\n])*"|'[^'\n]*'|[\w-]+)[ \t]*\.[ \t]*){100}""")
TOO_LARGE_MEND = "a number has at most 4,300 digits; brackets, and names by dots, nest a hundredfold at most"


def read_text(path: Path, field: str, allowed: str, mend: str = "", most_bytes: int = MAX_BYTES) -> str:
    """The UTF-8 text in a file. Raises InputError naming `field` where there is none; `mend` says how to get one."""
    try:
        with path.open("rb") as file:
            raw = file.read(most_bytes + 1)  # what is too long, or has no end, is not taken in
    except FileNotFoundError:
        raise InputError(field, str(path), allowed, mend) from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        mend = getattr(error, "strerror", None) or str(error)
        raise InputError(field, str(path), "a file that can be read", mend) from None
    if len(raw) > most_bytes:
        raise InputError(path.name, f"more than {most_bytes:,} bytes", f"a file of at most {most_bytes:,} bytes")
    return text_of(raw, path.name)


def text_of(raw: bytes, where: str) -> str:
    """The text of a file's bytes, a byte order mark left out; `where` is the file's name. Raises InputError."""
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(where, raw[error.start : error.start + 8], "UTF-8 text", "save it as UTF-8") from None


def toml_of(text: str, where: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises InputError naming the line; `where` is the file's name and leads it."""
    try:
        if deep := TOO_DEEP.search(text):  # tomllib would read it for minutes
            raise RecursionError
        repr(data := tomllib.loads(text))  # a number in hex may be too long to be told of
        return data
    except (ValueError, RecursionError) as error:
        told, large = re.search(r"line (\d+)", str(error)), deep or TOO_LARGE.search(text)
        number = int(told[1]) if told else text.count("\n", 0, large.start() if large else None) + 1
        line = [*text.split("\n"), ""][number - 1]
        mend = COMMA_MEND if COMMA.search(line) else TOO_LARGE_MEND if large and not told else str(error)
        raise InputError(f"{where}: line {number}", line, "TOML", mend) from None


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Where to write a file for `path`, whose old one stays until the new one is complete.

    What is no file, such as a pipe, is written to itself.
    """
    path = Path(os.path.realpath(path))  # a link stays one; `resolve` would stop at links in a ring
    if path.exists() and not path.is_file():
        yield path
        return
    fresh = path.with_name(f".whole-{os.getpid()}-{os.urandom(6).hex()}{path.suffix}")
    try:
        yield fresh
        if path.exists():
            shutil.copymode(path, fresh)
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def try_to_write(path: Path) -> None:
    """Raises OSError or ValueError where `whole` could not write; leaves what is there. Rights alone do not tell."""
    if path.exists():
        os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))  # a folder, and a pipe that nobody reads, are refused
    if path.is_file() or not path.exists():
        TemporaryFile(dir=Path(os.path.realpath(path)).parent).close()  # the new one is written beside it first
