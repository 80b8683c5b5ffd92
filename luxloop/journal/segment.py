"""One segment of a journal: an MCAP file that one process writes from its start to its end, and never opens again.

    runs/<id>/audit-0001.mcap     metadata `run`, `environment`; attachments; records; ... /chain at each commit
    runs/<id>/audit.sha256        root of the chain and count of records, once a segment is finished

What `commit` returned from is on the disk: a killed process, or a power cut after it, loses nothing of it. The chain
goes on from segment to segment: the first link of one follows the last committed link of the one before.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, cast

from mcap.writer import CompressionType, Writer

from luxloop import __version__
from luxloop.journal.chain import Link, Mark
from luxloop.journal.image import descriptor_set
from luxloop.journal.schemas import flat_schema
from luxloop.journal.topics import CHAIN, CHANNEL_FACTS, TOPICS, Checkpoint, Record, record
from luxloop.words import canonical

PROFILE = "luxloop"
FORMAT = "1"
SIDE_FILE = "audit.sha256"
PATTERN = "audit-*.mcap"
CHUNK_BYTES = 256 << 10
SPILL_BYTES = 16 << 20  # waits in memory at most while a whole segment is copied


class SegmentFile:
    """The MCAP file of a segment: links go in as they are and where they are; the chain is the caller's business."""

    def __init__(self, path: Path, chunk_bytes: int = CHUNK_BYTES) -> None:
        """Opens a new file. Raises FileExistsError where there is one."""
        self._channels: dict[str, int] = {}
        self._file = _DurableFile(path)
        self._writer = Writer(cast(IO[bytes], self._file), chunk_bytes, CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start(PROFILE, f"luxloop {__version__}")

    def add(self, link: Link) -> None:
        """Append a record, metadata or an attachment, as `metadata_link` and `attachment_link` made it."""
        if isinstance(link, Record):
            channel = self._channels.get(link.topic) or self._register(link.topic)
            self._writer.add_message(channel, link.log_time_ns, link.data, link.log_time_ns, link.sequence)
            return
        self._end_chunk()  # records wait in one; these do not
        kind, _, name = link.topic.partition("/")
        if kind == "metadata":
            self._writer.add_metadata(name, json.loads(link.data))
        else:
            self._writer.add_attachment(0, link.log_time_ns, name, "application/octet-stream", link.data)

    def sync(self) -> None:
        """Make all that was added durable."""
        self._end_chunk()
        self._file.sync()

    def spill(self) -> None:
        """Write out what waits in memory where that is much, but for the chunk that is being filled."""
        if len(self._file.waiting) > SPILL_BYTES:
            self._file.sync()

    def finish(self, mark: Mark) -> None:
        """Write the root of the chain, index and checksums, and close."""
        try:
            self._writer.add_metadata("chain", {"records": str(mark.records), "root": mark.root})
            self._writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves its return type open
            self._file.sync()
        finally:
            self.close()

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def _end_chunk(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap leaves its return type open

    def _register(self, topic: str) -> int:
        kind = TOPICS[topic]
        if isinstance(kind, str):
            encoding, described = "protobuf", (kind, "protobuf", descriptor_set(kind))
        else:
            schema = canonical(flat_schema(kind))
            encoding, described = "json", (f"luxloop.{kind.__name__}", "jsonschema", schema)
        number, facts = self._writer.register_schema(*described), CHANNEL_FACTS.get(topic, {})
        self._channels[topic] = self._writer.register_channel(topic, encoding, number, facts)
        return self._channels[topic]


class Segment:
    """A segment being written. Every method may raise OSError; after that only what was committed counts."""

    def __init__(
        self, path: Path, before: Mark, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]
    ) -> None:
        """Opens a new file and commits metadata and attachments. Raises FileExistsError where there is one.

        `before` is how far the chain has come in the segments before this one.
        """
        self.path, self.mark = path, before
        self._last = 0, time.time_ns()
        self._file = SegmentFile(path)
        ours = {"journal": FORMAT, "records_before": str(before.records), "root_before": before.root}
        try:
            for name, facts in {"run": {}, **metadata}.items():
                self._add(metadata_link(name, {**facts, **(ours if name == "run" else {})}))
            for name, data in attachments.items():
                self._add(attachment_link(name, time.time_ns(), data))
            self.commit()
            sync_folder(path.parent)
        except BaseException:
            self.close()
            path.unlink(missing_ok=True)
            raise

    def write(self, entry: Record) -> None:
        """Add a record; it counts once it is committed."""
        self._add(entry)
        self._last = entry.sequence, entry.log_time_ns

    def commit(self) -> None:
        """Make everything that was written durable, with the chain's mark at its end."""
        checkpoint = Checkpoint(records=self.mark.records, root=self.mark.root)
        self._file.add(record(CHAIN, checkpoint, *self._last))
        self._file.sync()

    def finish(self) -> Mark:
        """Commit, write index and checksums, and close; the mark is in the metadata `chain` and in the side file."""
        try:
            self.commit()
            self._file.finish(self.mark)
            write_side_file(self.path.parent, self.mark)
        finally:
            self.close()
        return self.mark

    def close(self) -> None:
        """Let go of the file; without `finish` it ends after the last commit, as after a crash."""
        self._file.close()

    def _add(self, link: Link) -> None:
        self._file.add(link)
        self.mark = self.mark.then([link])


def metadata_link(name: str, facts: Mapping[str, str]) -> Link:
    """What the chain covers of a segment's metadata."""
    return Link(f"metadata/{name}", 0, 0, canonical(facts))


def attachment_link(name: str, log_time_ns: int, data: bytes) -> Link:
    """What the chain covers of an attachment."""
    return Link(f"attachment/{name}", 0, log_time_ns, data)


def being_written(path: Path) -> bool:
    """Whether a living process, on this machine or under this file system's locks, holds the segment open."""
    with suppress(OSError), path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):  # the latter over some networks
            return True
    return False


class _DurableFile:
    """A new file whose bytes wait in memory until `sync`; what fails to be written whole is taken back."""

    def __init__(self, path: Path) -> None:
        self._raw = path.open("xb", buffering=0)
        self.waiting = bytearray()
        self._safe_bytes = 0
        with suppress(OSError):  # a file system without locks
            fcntl.flock(self._raw, fcntl.LOCK_EX)

    def write(self, data: bytes) -> int:
        self.waiting += data
        return len(data)

    def tell(self) -> int:
        return self._safe_bytes + len(self.waiting)

    def flush(self) -> None:
        """All is written by `sync`."""

    def sync(self) -> None:
        """Write what waits, and wait for the disk. Raises OSError also where the file has been removed."""
        try:
            rest = memoryview(bytes(self.waiting))
            while rest:
                rest = rest[self._raw.write(rest) :]
            os.fdatasync(self._raw.fileno())
        except OSError:
            with suppress(OSError):  # else a reader stops where the last commit ended
                self._raw.truncate(self._safe_bytes)
            raise
        if os.fstat(self._raw.fileno()).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, "its file was removed while it was written")
        self._safe_bytes += len(self.waiting)
        self.waiting.clear()

    def close(self) -> None:
        self._raw.close()


def write_side_file(folder: Path, mark: Mark) -> None:
    """Put the mark in a file of its own, replaced as a whole."""
    path = folder / SIDE_FILE
    fresh = path.with_name(f".{path.name}.new")
    with fresh.open("w") as file:
        file.write(f"{mark.root} {mark.records}\n")
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(path)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Make names in a folder durable: new ones, and those that changed."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
