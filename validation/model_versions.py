"""The versions of a model file: kept beside it, written so that a kill at any moment loses none.

    model.toml   .luxloop/models/001.toml   002.toml   versions.jsonl   lock

A line of `versions.jsonl` says of which file a version is, when and by which command it came, its hash, its errors.
Order of a save: the version's text, then its line, then the model file, each by write to a temporary file, fsync and
rename; a lock held by the operating system keeps two processes apart and is free again when its holder dies. A text
that somebody edited by hand is kept as a version of its own before anything replaces it.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from pydantic import Field, ValidationError

from luxloop.errors import InputError
from luxloop.files import read_text as read_file
from luxloop.files import try_to_write
from luxloop.model import Model
from luxloop.model_file import parse_toml, read_text, to_toml
from luxloop.words import Words

BY_HAND = "edited by hand"
MOST_BYTES = 64 << 20
"""Of the list of versions, a few hundred bytes each."""


class Version(Words):
    """One version of one model file."""

    number: int = Field(ge=1)
    file: str
    time: str = Field(description="UTC, ISO 8601.")
    command: str
    sha256: str = Field(description='Hash of the model; "" where the text is no model.')
    errors: dict[str, float] = Field(default_factory=dict, description="What a fit of this version left, by name.")


def save(path: Path, model: Model, command: str, errors: dict[str, float] | None = None) -> Version:
    """Writes a model file and keeps it as a version, which is returned; `command` is what made it."""
    with _locked(path):
        return _replace(path, to_toml(model), command, errors or {})


def try_to_save(path: Path) -> None:
    """Raises InputError where a model file could not be saved, before anything is computed for it."""
    with _locked(path):
        for file in (path, _log(path)):
            try_to_write(file)


def versions(path: Path) -> list[Version]:
    """The versions of a model file, oldest first; none where it was never saved by a command."""
    return [version for version in _all(path) if version.file == path.name]


def version_text(path: Path, number: int) -> str:
    """The text of a version of a model file; InputError names the versions there are."""
    known = [version.number for version in versions(path)]
    if number not in known:
        raise InputError(
            "version", number, f"a version of {path.name}: {_list(known)}", "luxloop model show lists them"
        )
    return read_text(_version_file(path, number))


def previous(path: Path) -> int:
    """The number of the version before the one that the file holds; InputError where there is none."""
    known = versions(path)
    now = read_text(path) if path.exists() or not known else None  # a deleted file has all its versions before it
    if _was_killed(path, known, now):
        known.pop()  # nobody has ever had that version
    while known and version_text(path, known[-1].number) == now:
        known.pop()
    if not known:
        raise InputError("version", path.name, "a file with an earlier version", "there is nothing to go back to")
    return known[-1].number


def _was_killed(path: Path, known: list[Version], now: str | None) -> bool:
    """Whether the last save never wrote the file: it holds the version before, and is older than the last one.

    By both of its times: `mv` and `cp -p` put a file back with the old one of its contents, and the one of its entry
    changes with its owner and mode.
    """
    if [version_text(path, one.number) == now for one in known[-2:]] != [True, False]:
        return False
    held, last = path.stat(), _version_file(path, known[-1].number).stat()
    return held.st_mtime_ns <= last.st_mtime_ns and held.st_ctime_ns <= last.st_ctime_ns


def undo(path: Path, command: str = "undo", to: int | None = None) -> Version:
    """Puts an earlier version (the one before, or number `to`) back as a new one: undo twice is where you were."""
    with _locked(path):
        number = previous(path) if to is None else to
        text = version_text(path, number)
        old = next(version for version in versions(path) if version.number == number)
        return _replace(path, text, command, old.errors)


def _replace(path: Path, text: str, command: str, errors: dict[str, float]) -> Version:
    _keep_hand_edits(path)
    version = _keep(path, text, command, errors)
    _write_atomically(path, text)
    return version


def _write_atomically(path: Path, text: str) -> None:
    """Replaces a file in one step: after a kill it holds the old text or the new, on disk, never a part of one.

    Under the lock the temporary file has one name, so what a kill leaves behind is written over by the next save.
    """
    path = Path(os.path.realpath(path))  # a link stays a link; `resolve` would stop at links in a ring
    temporary = path.with_name(f".{path.name}.tmp")
    with temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    if path.exists():
        shutil.copymode(path, temporary)
    temporary.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)  # the rename itself lies in the folder
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _keep_hand_edits(path: Path) -> None:
    """Before a file is replaced: its text becomes a version, unless the last one has it already."""
    if not path.exists():
        return
    text, known = read_text(path), versions(path)
    if not any(version_text(path, version.number) == text for version in known):
        _keep(path, text, BY_HAND if known else "as found", {})


def _keep(path: Path, text: str, command: str, errors: dict[str, float]) -> Version:
    """Writes the text of a new version, then its line; call it under the lock."""
    known = _all(path)
    stored = [int(file.stem) for file in _folder(path).glob("[0-9]*.toml") if file.stem.isdigit()]
    number = max([0, *(version.number for version in known), *stored]) + 1  # a kill may have left a text without line
    now = datetime.now(UTC).isoformat(timespec="seconds")
    version = Version(number=number, file=path.name, time=now, command=command, sha256=_hash(text), errors=errors)
    _write_atomically(_version_file(path, number), text)
    lines = [one.model_dump_json() for one in (*known, version)]
    _write_atomically(_log(path), "\n".join(lines) + "\n")
    return version


def _all(path: Path) -> list[Version]:
    """The versions of all model files of the folder, oldest first."""
    log = _log(path)
    if not log.exists():
        return []
    found = []
    text = read_file(log, str(log), "the versions that luxloop keeps", most_bytes=MOST_BYTES)
    for number, line in enumerate(text.splitlines(), 1):
        try:
            found.append(Version.model_validate_json(line))
        except ValidationError:
            raise InputError(
                f"{log}: line {number}", line, "what luxloop wrote there", "remove the line; its NNN.toml stays"
            ) from None
    return found


def _hash(text: str) -> str:
    try:
        return parse_toml(text, "").sha256
    except InputError:
        return ""  # a text that is no model is kept all the same: it is somebody's work


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """One process at a time in the folder of versions; what the file system refuses becomes an InputError."""
    try:
        _folder(path).mkdir(parents=True, exist_ok=True)
        with (_folder(path) / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
    except OSError as error:
        raise InputError("model", str(path), "a place that can be written", str(error.strerror)) from error


def _folder(path: Path) -> Path:
    return path.parent / ".luxloop" / "models"


def _log(path: Path) -> Path:
    return _folder(path) / "versions.jsonl"


def _version_file(path: Path, number: int) -> Path:
    return _folder(path) / f"{number:03d}.toml"


def _list(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers)) or "none"
