"""`luxloop audit verify`: an index that says other than the data it stands behind breaks a sealed journal."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Chunk, DataEnd
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from env_controller.audit.checks import exit_code, verify
from env_controller.audit.recover import recover
from luxloop.journal.reader import RunJournal, segments_of
from luxloop.journal.scan import FOOTER, HEAD
from tests.journals import write_run

DATA_END_BYTES = HEAD.size + 4
UNKNOWN = 0x80
AMISS = "its index says other than its data"


def written(*records: Any) -> bytes:
    """Records as they lie in a file."""
    built = RecordBuilder()
    for one in records:
        one.write(built)
    return bytes(built.end())  # type: ignore[no-untyped-call]  # mcap leaves its return type open


def index_of(path: Path) -> Summary:
    """The index of a finished segment."""
    with path.open("rb") as file:
        index = SeekingReader(file).get_summary()
    assert index is not None
    return index


def data_of(path: Path) -> bytes:
    """The data section of a finished segment, without its end."""
    raw = path.read_bytes()
    return raw[: FOOTER.unpack(raw[-FOOTER.size :])[2] - DATA_END_BYTES]


def forged(path: Path, change: Callable[[Any], object], data: bytes | None = None) -> None:
    """Write a segment anew with these data, where given, and its index after `change`, with right checksums."""
    data, index = data or data_of(path), index_of(path)
    change(index)
    parts = index.schemas.values(), index.channels.values(), index.chunk_indexes
    body = written(*(one for part in parts for one in part), *index.attachment_indexes, *index.metadata_indexes)
    data += written(DataEnd(zlib.crc32(data)))
    tail = FOOTER.pack(Opcode.FOOTER, 20, len(data), 0, 0, MCAP0_MAGIC)[:-12]
    path.write_bytes(data + body + tail + struct.pack("<I", zlib.crc32(body + tail)) + MCAP0_MAGIC)


def chunk_of(path: Path, number: int) -> tuple[Chunk, bytes, int]:
    """A chunk, its contents, and where it begins."""
    index = index_of(path)
    with path.open("rb") as file:
        chunks = [one for one in StreamReader(file, emit_chunks=True).records if isinstance(one, Chunk)]
    true, start = chunks[number], index.chunk_indexes[number].chunk_start_offset
    return true, zstandard.decompress(true.data, true.uncompressed_size), start


def chunk_with(true: Chunk, data: bytes) -> bytes:
    """The same chunk with other contents, as it lies in a file."""
    times = true.message_end_time, true.message_start_time
    return written(Chunk("zstd", zstandard.compress(data), *times, zlib.crc32(data), len(data)))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished run of three steps, uniformities 0.50, 0.51 and 0.52."""
    write_run(tmp_path / "a-run", 3)
    return tmp_path / "a-run"


def found(folder: Path) -> tuple[int, str]:
    """Exit code of verify with the true root and count, and what is broken."""
    root, records = (folder / "audit.sha256").read_text().split()
    audit = verify(folder, root, int(records))
    return exit_code(audit), "; ".join(one.found for one in audit.findings if one.verdict == "broken")


def seen(folder: Path) -> tuple[list[float], dict[str, str], set[str]]:
    """What a reader by the index has: uniformities, metadata of the run, attachments."""
    journal = RunJournal(folder)
    return [step.uniformity for step in journal.steps()], journal.metadata("environment"), {*journal.attachments()}


def number_of_steps(index: Any) -> int:
    """The channel of the steps."""
    return next(int(number) for number, channel in index.channels.items() if channel.topic == "/step")


def drops_topic(index: Any) -> None:
    """The second step's chunk is said to hold no steps."""
    del index.chunk_indexes[2].message_index_offsets[number_of_steps(index)]


def renames_topic(index: Any) -> None:
    """The channel of the steps is said to be of notes."""
    index.channels[number_of_steps(index)].topic = "/note"


@pytest.mark.parametrize(
    "change",
    [
        lambda index: index.chunk_indexes.pop(2),
        lambda index: index.chunk_indexes.append(index.chunk_indexes[2]),
        lambda index: index.metadata_indexes.pop(1),
        lambda index: index.attachment_indexes.pop(0),
        drops_topic,
        renames_topic,
    ],
    ids=["a chunk", "a chunk twice", "metadata", "attachment", "topic of a chunk", "topic of a channel"],
)
def test_an_index_that_says_other_than_the_data_is_found(run: Path, change: Callable[[Any], object]) -> None:
    """Readers by the index see something else, while the chain over the data holds: exit 5, and recover mends it."""
    (path,) = segments_of(run)
    whole = seen(run)
    forged(path, lambda _: None)
    assert (found(run), seen(run)) == ((0, ""), whole)
    forged(path, change)
    assert seen(run) != whole
    code, what = found(run)
    assert code == 5
    assert AMISS in what
    recovery = recover(run)
    assert (recovery.exit_code, recovery.sound) == (0, False)
    assert (found(recovery.out), seen(recovery.out)) == ((0, ""), whole)


def test_a_step_that_only_the_index_knows_is_found(run: Path) -> None:
    """A forged chunk within a record of unknown kind, which no scan reads, in place of the true one."""
    (path,) = segments_of(run)
    true, data, _ = chunk_of(path, 2)
    chunk = chunk_with(true, data.replace(b'"uniformity":0.51', b'"uniformity":0.99'))
    whole = data_of(path)

    def point(index: Any) -> None:
        index.chunk_indexes[2].chunk_start_offset = len(whole) + HEAD.size

    forged(path, point, whole + struct.pack("<BQ", UNKNOWN, len(chunk)) + chunk)
    assert seen(run)[0] == [0.5, 0.52, 0.99]
    code, what = found(run)
    assert code == 5
    assert "of unknown kind" in what


def test_a_record_of_unknown_kind_is_found(run: Path) -> None:
    """Before the true chunk, and the index points at it: a reader that goes by the index takes its contents."""
    (path,) = segments_of(run)
    true, data, start = chunk_of(path, 3)
    chunk = chunk_with(true, data.replace(b'"uniformity":0.52', b'"uniformity":0.99'))
    whole = data_of(path)

    def shift(index: Any) -> None:
        index.chunk_indexes[4].chunk_start_offset += len(chunk)
        index.metadata_indexes[-1].offset += len(chunk)

    forged(path, shift, whole[:start] + bytes([UNKNOWN]) + chunk[1:] + whole[start:])
    assert seen(run)[0] == [0.5, 0.51, 0.99]
    code, what = found(run)
    assert code == 5
    assert "of unknown kind" in what


def test_a_channel_keeps_its_first_topic(run: Path) -> None:
    """The last chunk announces the steps' channel once more as one of notes, and the index says the same."""
    (path,) = segments_of(run)
    true, data, start = chunk_of(path, -1)
    whole, before = data_of(path), len(chunk_with(true, data))
    index = index_of(path)
    channel = index.channels[number_of_steps(index)]
    renames_topic(index)
    chunk = chunk_with(true, data + written(channel))

    def change(index: Any) -> None:
        renames_topic(index)
        index.metadata_indexes[-1].offset += len(chunk) - before

    assert whole[start:].startswith(chunk_with(true, data))
    forged(path, change, whole[:start] + chunk + whole[start + before :])
    assert seen(run)[0] == []
    code, what = found(run)
    assert code == 5
    assert AMISS in what


def test_records_outside_chunks_are_found(run: Path) -> None:
    """Readers by the index do not see them, though a scan could."""
    (path,) = segments_of(run)
    true, data, start = chunk_of(path, -1)
    whole, before = data_of(path), len(chunk_with(true, data))

    def change(index: Any) -> None:
        del index.chunk_indexes[-1]
        index.metadata_indexes[-1].offset += len(data) - before

    forged(path, change, whole[:start] + data + whole[start + before :])
    code, what = found(run)
    assert code == 5
    assert "a record outside a chunk" in what
