"""What binds sets and verdicts to each other, so that a miss cannot be taken away without a trace.

    root       SHA-256 of {name: seal} of all sets: in blind.json, printed by `make`
    record     a verdict, its number, the hash of its residuals, that of the record before, its own
    chain.json how many records there are, and the hash of the last
    opened/    of each set whose seal was opened the hash of the verdict that was on record then

All of it lies in one folder: who writes everything anew is found by nobody but him who noted the root, and, of
verdicts, where the chain ended; `make`, `diagnose` and `score` print them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from luxloop.errors import InputError
from luxloop.words import sha256_of
from validation.blind_test.folders import (
    ANSWERS,
    ASKED,
    CHAIN,
    INDEX,
    OPENED,
    SCHEMA,
    SEAL,
    SETS,
    Index,
    read_json,
    write_whole,
)
from validation.blind_test.records import maps_path, read_record, record_path

FIRST = "0" * 64
"""Stands for the record before the first."""
WHOLE = "take the folder as it was: it does not count with sets or verdicts taken away"
Record = Mapping[str, Any]


# The root


def close(folder: Path, index: Index) -> Index:
    """The index with all seals and their root, written once all sets are made.

    Raises InputError where a set has another seal than an index that was closed before says.
    """
    seals = {one.id: _seal(folder, one.id) for one in index.sets}
    for name, sealed in index.seals.items():
        if seals.get(name) != sealed:
            raise InputError(f"{name}: seal", seals.get(name), f"the seal of {INDEX}, {sealed[:16]}...", WHOLE)
    closed = index.model_copy(update={"seals": seals, "root": sha256_of(seals)})
    write_whole(folder / INDEX, closed.text())
    return closed


def check_root(folder: Path, index: Index) -> None:
    """Raises InputError where sets were taken out of the index, or their seals are not those that were bound."""
    asked = folder / ANSWERS / ASKED
    if asked.exists():
        count = read_json(asked, ASKED, "what was asked for", WHOLE).get("sets")
        if count != len(index.sets):
            raise InputError(
                f"{folder.name}/{INDEX}", f"{len(index.sets)} sets", f"{count} that were asked for", WHOLE
            )
    if index.root is None:
        if index.seals:
            raise InputError(f"{folder.name}/{INDEX}", "no root", "the root of the seals that it lists", WHOLE)
        return
    names = {one.id for one in index.sets}
    if names != set(index.seals) or sha256_of(index.seals) != index.root:
        other = ", ".join(sorted(names ^ set(index.seals))) or "its seals"
        raise InputError(f"{folder.name}/{INDEX}", other, f"all sets of the root {index.root[:16]}...", WHOLE)
    for name, sealed in index.seals.items():
        if (folder / SETS / name).is_dir() and (found := _seal(folder, name)) != sealed:
            mend = "the seal was changed after it was bound: the set does not count"
            raise InputError(f"{name}: seal", found, f"the seal of {INDEX}, {sealed[:16]}...", mend)


def gone(folder: Path, index: Index) -> list[str]:
    """Sets that were bound, judged or opened here, and whose folders are not there any more."""
    return [
        one.id for one in index.sets
        if not (folder / SETS / one.id).is_dir()
        and (one.id in index.seals or record_path(folder, one.id).exists() or _mark(folder, one.id).exists())
    ]  # fmt: skip


def refuse_gone(folder: Path, index: Index) -> None:
    """Raises InputError before a set that is on record would be made anew: its answer and salt would be lost."""
    for name in gone(folder, index):
        raise InputError(f"{name}: data", f"{SETS}/{name} is not there", "a set that is on record", WHOLE)


def _mark(folder: Path, name: str) -> Path:
    return folder / OPENED / f"{name}.json"


def _seal(folder: Path, name: str) -> str:
    path = folder / SETS / name / SEAL
    return str(read_json(path, f"{name}: seal", "a set with a seal", "luxloop blind make writes it").get("sha256"))


# The chain


@dataclass(frozen=True)
class Chain:
    """Where the records of a folder end."""

    count: int = 0
    last: str = FIRST

    def added(self, record: Record) -> dict[str, Any]:
        """A record with its place after the last, and its hash."""
        placed = {**record, "number": self.count + 1, "before": self.last}
        return placed | {"sha256": hash_of(placed)}

    def write(self, folder: Path) -> None:
        """Put on record where the chain ends."""
        write_whole(folder / CHAIN, self._document())

    def mend(self, folder: Path) -> None:
        """The same, before the first record, and where the writing was cut short after the last."""
        path = folder / CHAIN
        if not path.exists() or read_json(path, CHAIN, "its end", WHOLE) != self._document():
            self.write(folder)

    def _document(self) -> dict[str, Any]:
        return {"schema": SCHEMA, "records": self.count, "last": self.last}


def hash_of(record: Record) -> str:
    """SHA-256 of a record as a file has it, without its own hash."""
    plain = json.loads(json.dumps({name: value for name, value in record.items() if name != "sha256"}))
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def chain_of(folder: Path, index: Index) -> Chain:
    """Where the chain ends, every record checked.

    Raises InputError for a verdict that was edited, taken away, or put between the others. Folders of an older
    luxloop have neither root nor chain: nothing is checked there, and `score` says so.
    """
    records = list(_records(folder, index))
    chained = sorted((one for one in records if _is_placed(one)), key=lambda one: int(one["number"]))
    if index.root is not None and len(chained) < len(records):
        loose = next(str(one.get("id")) for one in records if not _is_placed(one))
        raise InputError(f"{loose}: verdict", "a record without a number", "one that diagnose put on record", WHOLE)
    end = Chain()
    for one in chained:
        end = _next(end, one)
    _check_end(folder, chained, end)
    return end


def _is_placed(record: Record) -> bool:
    return isinstance(record.get("number"), int) and isinstance(record.get("before"), str)


def _records(folder: Path, index: Index) -> Iterable[dict[str, Any]]:
    return (read_record(folder, one.id) for one in index.sets if record_path(folder, one.id).exists())


def _next(end: Chain, record: Record) -> Chain:
    name = f"{record.get('id')}: verdict"
    if record.get("sha256") != hash_of(record):
        raise InputError(name, record.get("sha256"), "the record that diagnose wrote", f"it was edited; {WHOLE}")
    if (record["number"], record["before"]) != (end.count + 1, end.last):
        mend = f"a verdict was taken away, or made anew; {WHOLE}"
        raise InputError(name, f"record {record['number']}", f"record {end.count + 1} of the chain", mend)
    return Chain(end.count + 1, str(record["sha256"]))


def _check_end(folder: Path, chained: list[dict[str, Any]], end: Chain) -> None:
    """The last record may be one more than is said: the writing was cut short between the two."""
    path = folder / CHAIN
    if not chained and not path.exists():
        return  # nothing was judged yet
    said = read_json(path, CHAIN, "where the chain of verdicts ends", WHOLE)
    before = Chain(end.count - 1, str(chained[-1]["before"])) if chained else end
    if (said.get("records"), said.get("last")) not in ((end.count, end.last), (before.count, before.last)):
        mend = f"a verdict was taken away; {WHOLE}"
        raise InputError(CHAIN, f"{end.count} verdicts", f"{said.get('records')} verdicts", mend)


def end_of(folder: Path, index: Index) -> str | None:
    """How many verdicts are on record, and the hash of the last, as the records have it; None where nothing chains
    them. Raises InputError as `chain_of` does."""
    end = chain_of(folder, index)
    return f"{end.count}, the last {end.last}" if end.count else None


def check_maps(folder: Path, name: str, record: Record) -> None:
    """Raises InputError for residuals that are not those of the verdict; without them a page is drawn without."""
    path, stated = maps_path(folder, name), record.get("maps_sha256")
    if stated is None or not path.exists():
        return
    if (found := hashlib.sha256(path.read_bytes()).hexdigest()) != stated:
        mend = "put back the file that diagnose wrote, or remove it: the page goes without"
        raise InputError(f"{name}: residuals", found, f"those of the verdict, {stated[:16]}...", mend)


# What was opened


def mark_opened(folder: Path, name: str, record: Record) -> None:
    """Put on record by which verdict a seal was opened.

    Raises InputError where it was opened before, with another verdict or another seal, and where nothing can be
    written.
    """
    found, path = {"verdict": hash_of(record), "seal": record.get("seal")}, _mark(folder, name)
    if path.exists():
        said = read_json(path, f"{name}: opened", "a mark of the score", WHOLE)
        if {each: said.get(each) for each in found} != found:
            mend = "its seal was opened before this verdict was made: put back the one that was there"
            raise InputError(f"{name}: verdict", found["verdict"], f"{str(said.get('verdict'))[:16]}...", mend)
        return
    try:
        write_whole(path, {"schema": SCHEMA, **found})
    except OSError as error:
        mend = f"{error.strerror}; the score marks what it opened: copy the folder first"
        raise InputError("FOLDER", str(folder), "a folder that can be written", mend) from None


def refuse_opened(folder: Path, index: Index) -> None:
    """Raises InputError for a set whose seal was opened and whose verdict is gone: a new one would not count."""
    for one in index.sets:
        if _mark(folder, one.id).exists() and not record_path(folder, one.id).exists():
            mend = "put back the verdict that was there, or make new sets"
            raise InputError(f"{one.id}: verdict", "none, and its seal is open", "a seal that is shut", mend)
