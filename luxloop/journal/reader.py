"""A run's journal read back: all segments in order, also those that were never finished or are being written now.

    for step in RunJournal(folder).steps(): ...

A finished segment is read by its index: 16,000 steps open without being read. The order is that of writing.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.records import Attachment, Chunk, Message, Metadata

from luxloop.campaign import Step
from luxloop.errors import InputError, LuxloopError
from luxloop.journal.chain import Mark
from luxloop.journal.scan import BROKEN, HEAD, Index, Scan, index_of, parts_of, record_of, refuse_foreign
from luxloop.journal.segment import FORMAT, PATTERN, being_written
from luxloop.journal.topics import CHAIN, TOPICS, Close, Record
from luxloop.words import Words, parse

W = TypeVar("W", bound=Words)


class SegmentReader:
    """One segment, by its index where it is finished, else by reading it from its beginning."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @cached_property
    def index(self) -> Index | None:
        """The index; None where the segment is not finished, or damaged."""
        with self.path.open("rb") as file:
            try:
                return index_of(file)
            except BROKEN:
                return None

    @cached_property
    def opening(self) -> tuple[list[tuple[str, dict[str, str]]], list[tuple[str, bytes]]]:
        """Metadata and attachments with their names, start after start; empty where none were committed."""
        if self.index is not None:
            return self._indexed_opening(self.index)
        kinds: dict[str, list[tuple[str, bytes]]] = {"metadata": [], "attachment": []}
        for link in next((commit.links for commit in Scan(self.path)), ()):
            kind, _, name = link.topic.partition("/")
            kinds.setdefault(kind, []).append((name, link.data))
        return [(name, json.loads(data)) for name, data in kinds["metadata"]], kinds["attachment"]

    def _indexed_opening(self, index: Index) -> tuple[list[tuple[str, dict[str, str]]], list[tuple[str, bytes]]]:
        def read(kind: type[Metadata] | type[Attachment], offset: int) -> Any:
            file.seek(offset + HEAD.size)
            return kind.read(ReadDataStream(file))

        with self.path.open("rb") as file:
            refuse_foreign(file)
            try:
                metadata = [read(Metadata, place.offset) for place in index["MetadataIndex"]]
                attached = [read(Attachment, place.offset) for place in index["AttachmentIndex"]]
            except (*BROKEN, OSError) as error:
                raise self._damaged(error) from error
        facts = [(item.name, item.metadata) for item in metadata if item.name != "chain"]
        return facts, [(item.name, item.data) for item in attached]

    def records(self, topics: Iterable[str] = ()) -> Iterator[Record]:
        """The records of these topics (all but `/chain` where none is named), in the order of writing.

        Raises LuxloopError naming the file where it cannot be read as its index says.
        """
        wanted = frozenset(topics) or TOPICS.keys() - {CHAIN}
        if self.index is not None:
            for chunk in self._chunks(self.index, wanted, newest_first=False):
                yield from chunk
            return
        for commit in Scan(self.path):
            found = (*commit.links, commit.checkpoint)
            yield from (link for link in found if isinstance(link, Record) and link.topic in wanted)

    def last(self, topic: str, count: int) -> list[Record]:
        """The last records of a topic, in the order of writing."""
        if self.index is None:
            return list(deque(self.records([topic]), count))
        found: list[Record] = []
        for chunk in self._chunks(self.index, {topic}, newest_first=True):
            found = chunk + found
            if len(found) >= count:
                break
        return found[-count:]

    def _chunks(self, index: Index, topics: Iterable[str], newest_first: bool) -> Iterator[list[Record]]:
        """The records of these topics, chunk by chunk."""
        channels = {one.id: one.topic for one in index["Channel"]}
        wanted = {number: topic for number, topic in channels.items() if topic in topics}
        places = sorted(index["ChunkIndex"], key=lambda place: place.chunk_start_offset, reverse=newest_first)
        with self.path.open("rb") as file:
            for place in places:
                if wanted.keys().isdisjoint(place.message_index_offsets):
                    continue
                try:
                    file.seek(place.chunk_start_offset + HEAD.size)
                    parts = [*parts_of(Chunk.read(ReadDataStream(file)))]
                except (*BROKEN, OSError) as error:
                    raise self._damaged(error) from error
                found = (part for part in parts if isinstance(part, Message) and part.channel_id in wanted)
                yield [record_of(part, wanted) for part in found]

    def _damaged(self, error: Exception) -> LuxloopError:
        return LuxloopError(f"{self.path}: damaged ({error}); see `luxloop audit verify`")


class RunJournal:
    """The journal in a run's folder. It may grow while it is read: what is seen is what was there when asked."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError where there is no such folder, or no journal in it."""
        self.folder = folder
        if not folder.is_dir():
            raise InputError("run", str(folder), "the folder of a run", "see `luxloop campaign list`")
        paths = segments_of(folder)
        self.segments = [SegmentReader(path) for path in sorted({*paths} - left_over(paths), key=number_of)]
        if not any(run.get("journal") == FORMAT for run in self.starts("run")):
            seen = f"{len(self.segments)} file(s) {PATTERN}, none with the beginning of a journal of format {FORMAT}"
            raise InputError(str(folder), seen, "the folder of a run with its journal", "name another folder")

    def starts(self, name: str) -> list[dict[str, str]]:
        """Facts by which the run was opened, `run` or `environment`, of each start."""
        return [facts for segment in self.segments for of, facts in segment.opening[0] if of == name]

    def metadata(self, name: str) -> dict[str, str]:
        """Those of its last start."""
        return next(reversed(self.starts(name)), {})

    def attachments(self) -> dict[str, bytes]:
        """The attached files by name; of several starts the last one's counts."""
        return {name: data for segment in self.segments for name, data in segment.opening[1]}

    def attached(self, name: str, model: type[W]) -> W:
        """An attached JSON file as words. Raises InputError where it is not there, or is none of them."""
        files = self.attachments()
        if name not in files:
            allowed = f"an attachment of the journal in {self.folder}"
            raise InputError(name, sorted(files), allowed, "is it a campaign?")
        try:
            plain = json.loads(files[name])
        except (ValueError, RecursionError) as error:
            raise InputError(name, files[name][:40], "JSON", f"luxloop audit verify {self.folder}") from error
        return parse(model, plain, name)

    def records(self, *topics: str) -> Iterator[Record]:
        """The records of these topics (all but `/chain` where none is named), in the order of writing."""
        for segment in self.segments:
            yield from segment.records(topics)

    def last(self, topic: str, count: int) -> list[Record]:
        """The last records of a topic, in the order of writing."""
        found: list[Record] = []
        for segment in reversed(self.segments):
            if len(found) < count:
                found = segment.last(topic, count - len(found)) + found
        return found

    def steps(self) -> Iterator[Step]:
        """All steps of the run."""
        return (entry.value for entry in self.records("/step"))

    @property
    def close(self) -> Close | None:
        """Why the run was closed by its last start; None where it goes on, or was killed."""
        lines = self.segments[-1].last("/log", 1)
        return Close.of(lines[0].value.message) if lines else None

    @property
    def being_written(self) -> bool:
        """Whether a living process holds the last segment open."""
        return being_written(self.segments[-1].path)


def segments_of(folder: Path) -> list[Path]:
    """The segments in a folder, in their order."""
    return sorted((path for path in folder.glob(PATTERN) if number_of(path)), key=number_of)


def left_over(paths: list[Path]) -> set[Path]:
    """Those of a run's segments that its first one holds too: a compaction was interrupted, and the next one ends it.

    What is damaged is none: that is for others to say.
    """
    with suppress(LuxloopError, OSError, IndexError):
        first = SegmentReader(paths[0])
        end = first.last(CHAIN, 1)[0].value.records if paths[1:] and first.index else 0
        later = [Scan(path) for path in paths[1:] if end]
        if any(next(iter(scan), None) and scan.before.records < end for scan in later):
            marks = {commit.mark for commit in Scan(paths[0])}
            return {path for path in paths[1:] if any(end.mark in marks for end in deque(Scan(path), 1))}
    return set()


def number_of(path: Path) -> int:
    """The number of a segment, from 1, by its name; 0 where the name is none."""
    digits = path.stem.rpartition("-")[2]
    return int(digits) if digits.isascii() and digits.isdigit() else 0


def tail_of(folder: Path) -> Mark:
    """How far the chain of a run has come: after its last committed record, in whichever segment that is.

    Raises InputError where a file in the folder is somebody else's.
    """
    for path in reversed(segments_of(folder)):
        last = deque(Scan(path), 1)
        if last:
            return last[0].mark
    return Mark()
