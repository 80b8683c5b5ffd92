"""A segment read from its beginning, commit by commit, up to its end or to where it breaks off.

This is the way into a segment whose process was killed, or still lives: the usual readers of such files want an
index at the end and give nothing without it. A batch of records counts only with the mark of the chain behind it, so
what is read is what was committed, and perhaps one batch more whose acknowledgement was on its way.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any, cast

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from luxloop.errors import InputError
from luxloop.journal.chain import Link, Mark
from luxloop.journal.segment import PROFILE, attachment_link, metadata_link
from luxloop.journal.topics import CHAIN, Checkpoint, Record

BROKEN = (McapError, ValueError, KeyError, OverflowError, MemoryError, struct.error, zstandard.ZstdError)
"""What reading bytes that are not as they were written may raise."""
RECORD_LIMIT_BYTES = 256 << 20
UNPACKED_LIMIT_BYTES = 64 << 20
"""Of a chunk: ours hold 1 MB, or one record that came in a frame of 16 MB."""
HEAD, FOOTER = struct.Struct("<BQ"), struct.Struct("<BQQQI8s")
Index = dict[str, list[Any]]
"""The records of an index, by the names of their kinds in mcap."""
Places = dict[type[McapRecord], list[tuple[int, set[int]]]]
"""Where the records of each kind lie, and the channels of a chunk."""


@dataclass(frozen=True)
class Commit:
    """What became durable together: metadata and attachments first of all, then records; and the chain's mark.

    `checkpoint` is the record on `/chain` that says the mark.
    """

    links: tuple[Link, ...]
    mark: Mark
    checkpoint: Record


class Scan:
    """The commits of one segment. Iterate once; then it is known how the segment ends.

    `finished`: it was closed with index and root, `final`. Else `torn`: it breaks off, as after a kill, with
    `left_bytes` after the `read_bytes` to the last commit. `fault` says what is wrong with it otherwise. `before` is
    the mark from which its chain goes on, as it says itself. A compacted segment holds the openings of several
    starts, each where the chain had come to.

    With `more`, a file that grows is read as it grows: where it ends too early, `more` waits a little and says
    whether to look again.
    """

    def __init__(self, path: Path, more: Callable[[], bool] | None = None) -> None:
        self.path, self._more = path, more
        self.finished, self.torn, self.fault = False, False, ""
        self.before, self.final = Mark(), Mark()
        self.read_bytes = self.left_bytes = 0
        self._topics: dict[int, str] = {}
        self._places: Places = {Chunk: [], Metadata: [], Attachment: []}
        self._pending: list[Link] = []
        self._mark: Mark | None = None

    def __iter__(self) -> Iterator[Commit]:
        """Raises InputError where the file is no segment of a journal, OSError where it cannot be read."""
        with self.path.open("rb") as file:
            refuse_foreign(file)
            bounded = _Bounded(file, self._more)
            try:
                stream = StreamReader(cast(IO[bytes], bounded), False, True, True, RECORD_LIMIT_BYTES)
                place = len(MCAP0_MAGIC)
                for item in stream.records:
                    length = HEAD.unpack(os.pread(file.fileno(), HEAD.size, place))[1]
                    if place + HEAD.size + length != bounded.tell():
                        raise ValueError("a record of unknown kind, or of another length than it states")
                    channels: set[int] = set()
                    if type(item) in self._places:
                        self._places[type(item)].append((place, channels))
                    yield from self._take(item, channels)
                    place = bounded.tell()
                    if not self._pending:
                        self.read_bytes = place
                self._end(file)
            except (EndOfFile, struct.error):
                self.torn = not bounded.was_closed()
                self.fault = "" if self.torn else "it was finished, and breaks off in the middle"
            except BROKEN as error:
                self.fault = str(error) or type(error).__name__
            self.left_bytes = bounded.size_bytes - self.read_bytes

    def _take(self, item: McapRecord, channels: set[int]) -> Iterator[Commit]:
        match item:
            case Metadata(name="chain"):
                self.final = _mark(item.metadata["records"], item.metadata["root"])
            case Metadata():
                if item.name == "run":
                    self._start(_mark(item.metadata["records_before"], item.metadata["root_before"]))
                self._pending.append(metadata_link(item.name, item.metadata))
            case Attachment():
                self._pending.append(attachment_link(item.name, item.log_time, item.data))
            case Chunk():
                for part in parts_of(item):
                    if isinstance(part, Channel):
                        self._topics.setdefault(part.id, part.topic)
                    else:
                        channels.add(part.channel_id)
                        yield from self._message(part)
            case Message():
                raise ValueError("a record outside a chunk, where no reader looks")
            case DataEnd(data_section_crc=0):
                raise ValueError("the checksum over the data is missing")

    def _start(self, before: Mark) -> None:
        """An opening: the file's first, or of a later start, which must go on where the one before ended."""
        if self._mark is None:
            self.before = self._mark = before
        elif self._pending or before != self._mark:
            raise ValueError(f"a start after {before.records} records, where {self._mark.records} were committed")

    def _message(self, message: Message) -> Iterator[Commit]:
        entry = record_of(message, self._topics)
        if entry.topic != CHAIN:
            self._pending.append(entry)
            return
        mark = Mark(entry.value.records, entry.value.root)
        seen = (self._mark or Mark()).records + len(self._pending)
        if mark.records != seen:
            raise ValueError(f"{mark.records} records are counted where {seen} were read")
        yield Commit(tuple(self._pending), mark, entry)
        self._pending, self._mark = [], mark

    def _end(self, file: IO[bytes]) -> None:
        """The file was read to its end: what must be true of a finished one."""
        if self.final == Mark() or self._pending:
            self.fault = "it ends without the root of its chain"
        elif (index := index_of(file)) is None:
            self.fault = "its index does not match its checksum"
        elif not self._is_index(index):
            self.fault = "its index says other than its data"
        else:
            self.finished = True

    def _is_index(self, index: Index) -> bool:
        """Whether those who read by this index see what was read here."""
        topics = {one.id: one.topic for one in index["Channel"]}
        found: Places = {
            Chunk: [(one.chunk_start_offset, {*one.message_index_offsets}) for one in index["ChunkIndex"]],
            Metadata: [(one.offset, set()) for one in index["MetadataIndex"]],
            Attachment: [(one.offset, set()) for one in index["AttachmentIndex"]],
        }
        return topics == self._topics and found == self._places


def parts_of(chunk: Chunk) -> Iterator[Channel | Message]:
    """Channels and messages of a chunk. Raises one of BROKEN where it is damaged, or none that our writer makes."""
    data, size_bytes, packed = chunk.data, chunk.uncompressed_size, chunk.compression
    if packed not in ("zstd", "") or size_bytes > UNPACKED_LIMIT_BYTES:
        raise ValueError(f"a chunk of {size_bytes:,} bytes with compression {packed!r}: no journal has such")
    if packed:
        data = zstandard.ZstdDecompressor().stream_reader(data).read(size_bytes + 1)
    if len(data) != size_bytes or zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk has not the size and the crc that it states")
    stream = ReadDataStream(BytesIO(data))
    while stream.count < size_bytes:
        opcode, length = stream.read1(), stream.read8()
        if opcode == Opcode.MESSAGE:
            yield Message.read(stream, length)
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(stream)
        elif opcode == Opcode.SCHEMA:
            stream.read(length)
        else:
            raise ValueError(f"a chunk holds a record of kind {opcode}: no journal has such")


def record_of(message: Message, topics: dict[int, str]) -> Record:
    """A message as a record. Raises KeyError for a channel nobody announced, InputError for an unknown topic."""
    return Record(topics[message.channel_id], message.sequence, message.log_time, message.data)


def index_of(file: IO[bytes]) -> Index | None:
    """The index of a finished segment, checked against its checksum; None where there is none that holds."""
    size_bytes = os.fstat(file.fileno()).st_size
    if size_bytes < len(MCAP0_MAGIC) + FOOTER.size:
        return None
    file.seek(size_bytes - FOOTER.size)
    tail = file.read(FOOTER.size)
    opcode, _, start, _, crc, magic = FOOTER.unpack(tail)
    if opcode != Opcode.FOOTER or magic != MCAP0_MAGIC or not 0 < start <= size_bytes - FOOTER.size:
        return None
    file.seek(start)
    body = file.read(size_bytes - FOOTER.size - start)
    if crc == 0 or zlib.crc32(body + tail[: FOOTER.size - 12]) != crc:
        return None
    index: Index = defaultdict(list)
    for item in StreamReader(BytesIO(body + tail), True, True).records:  # its chunks, if it had any, stay packed
        index[type(item).__name__].append(item)
    return index


def _mark(records: str, root: str) -> Mark:
    """A mark out of metadata. Raises ValueError where it is none."""
    checked = Checkpoint.model_validate({"records": records, "root": root})
    return Mark(checked.records, checked.root)


def refuse_foreign(file: IO[bytes]) -> None:
    """Raise InputError for an MCAP file that somebody else wrote."""
    header = None
    with suppress(*BROKEN):  # what is wrong with it is said by whoever reads on
        header = next(StreamReader(file, False, True, False, RECORD_LIMIT_BYTES).records)
    file.seek(0)
    if isinstance(header, Header) and header.profile != PROFILE:
        raise InputError(str(file.name), f"an MCAP file of {header.library!r}", "a journal of luxloop")


class _Bounded:
    """A file as long as it was when it was opened, for its writer may be at work; or, with `more`, as it gets."""

    def __init__(self, file: IO[bytes], more: Callable[[], bool] | None) -> None:
        self._file, self._more, self.size_bytes = file, more, os.fstat(file.fileno()).st_size

    def read(self, size: int) -> bytes:
        again = self._more is not None
        while again and size > self.size_bytes - self._file.tell():
            again = self._more is not None and self._more()
            self.size_bytes = os.fstat(self._file.fileno()).st_size
        left = self.size_bytes - self._file.tell()
        return self._file.read(left if size < 0 else min(size, left))

    def tell(self) -> int:
        return self._file.tell()

    def was_closed(self) -> bool:
        self._file.seek(max(0, self.size_bytes - len(MCAP0_MAGIC)))
        return self.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC and self.size_bytes > len(MCAP0_MAGIC)
