"""One segment of a journal: an MCAP file that one process writes from its start to its end, and never opens again.

    runs/<id>/audit-0001.mcap     metadata `run`, `environment`; attachments; records; ... /chain at each commit
    runs/<id>/audit.sha256        root of the chain and count of records, once a segment is finished

What `commit` returned from is on the disk: a killed process, or a power cut after it, loses nothing of it. The chain
goes on from segment to segment: the first link of one follows the last committed link of the one before.
"""

from __future__ import annotations

import errno
import fcntl
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


class Segment:
    """A segment being written. Every method may raise OSError; after that only what was committed counts."""

    def __init__(
        self, path: Path, before: Mark, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]
    ) -> None:
        """Opens a new file and commits metadata and attachments. Raises FileExistsError where there is one.

        `before` is how far the chain has come in the segments before this one.
        """
        self.path, self.mark = path, before
        self._channels: dict[str, int] = {}
        self._last = 0, time.time_ns()
        self._file = _DurableFile(path)
        stream = cast(IO[bytes], self._file)
        self._writer = Writer(stream, CHUNK_BYTES, CompressionType.ZSTD, enable_data_crcs=True)
        ours = {"journal": FORMAT, "records_before": str(before.records), "root_before": before.root}
        try:
            self._writer.start(PROFILE, f"luxloop {__version__}")
            for name, facts in {"run": {}, **metadata}.items():
                self._add_metadata(name, {**facts, **(ours if name == "run" else {})})
            for name, data in attachments.items():
                self._add_attachment(name, data)
            self.commit()
            _sync_folder(path.parent)
        except BaseException:
            self.close()
            path.unlink(missing_ok=True)
            raise

    def write(self, entry: Record) -> None:
        """Add a record; it counts once it is committed."""
        self._message(entry)
        self.mark = self.mark.then([entry])
        self._last = entry.sequence, entry.log_time_ns

    def commit(self) -> None:
        """Make everything that was written durable, with the chain's mark at its end."""
        checkpoint = Checkpoint(records=self.mark.records, root=self.mark.root)
        self._message(record(CHAIN, checkpoint, *self._last))
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap leaves its return type open
        self._file.sync()

    def finish(self) -> Mark:
        """Commit, write index and checksums, and close; the mark is in the metadata `chain` and in the side file."""
        try:
            self.commit()
            self._writer.add_metadata("chain", {"records": str(self.mark.records), "root": self.mark.root})
            self._writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves its return type open
            self._file.sync()
            _write_side_file(self.path.parent / SIDE_FILE, self.mark)
        finally:
            self.close()
        return self.mark

    def close(self) -> None:
        """Let go of the file; without `finish` it ends after the last commit, as after a crash."""
        self._file.close()

    def _message(self, entry: Record) -> None:
        channel = self._channels.get(entry.topic) or self._register(entry.topic)
        self._writer.add_message(channel, entry.log_time_ns, entry.data, entry.log_time_ns, entry.sequence)

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

    def _add_metadata(self, name: str, facts: Mapping[str, str]) -> None:
        self._writer.add_metadata(name, dict(facts))
        self.mark = self.mark.then([metadata_link(name, facts)])

    def _add_attachment(self, name: str, data: bytes) -> None:
        now_ns = time.time_ns()
        self._writer.add_attachment(0, now_ns, name, "application/octet-stream", data)
        self.mark = self.mark.then([attachment_link(name, now_ns, data)])


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
        except BlockingIOError:
            return True
    return False


class _DurableFile:
    """A new file whose bytes wait in memory until `sync`; what fails to be written whole is taken back."""

    def __init__(self, path: Path) -> None:
        self._raw = path.open("xb", buffering=0)
        self._waiting = bytearray()
        self._safe_bytes = 0
        with suppress(OSError):  # a file system without locks
            fcntl.flock(self._raw, fcntl.LOCK_EX)

    def write(self, data: bytes) -> int:
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        return self._safe_bytes + len(self._waiting)

    def flush(self) -> None:
        """All is written by `sync`."""

    def sync(self) -> None:
        """Write what waits, and wait for the disk. Raises OSError also where the file has been removed."""
        try:
            rest = memoryview(bytes(self._waiting))
            while rest:
                rest = rest[self._raw.write(rest) :]
            os.fdatasync(self._raw.fileno())
        except OSError:
            with suppress(OSError):  # else a reader stops where the last commit ended
                self._raw.truncate(self._safe_bytes)
            raise
        if os.fstat(self._raw.fileno()).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, "its file was removed while it was written")
        self._safe_bytes += len(self._waiting)
        self._waiting.clear()

    def close(self) -> None:
        self._raw.close()


def _write_side_file(path: Path, mark: Mark) -> None:
    """The mark in a file of its own, replaced as a whole."""
    fresh = path.with_name(f".{path.name}.new")
    with fresh.open("w") as file:
        file.write(f"{mark.root} {mark.records}\n")
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(path)
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
