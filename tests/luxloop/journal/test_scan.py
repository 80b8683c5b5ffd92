"""A segment read from its beginning: damage is noticed by its checksums, before anybody reckons the chain."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Header, McapRecord
from mcap.writer import MCAP0_MAGIC

from luxloop.errors import LuxloopError
from luxloop.journal.reader import SegmentReader, segments_of
from luxloop.journal.scan import FOOTER, HEAD, UNPACKED_LIMIT_BYTES, Scan
from luxloop.journal.segment import PROFILE
from tests.journals import write_run

DATA_END_BYTES = HEAD.size + 4  # ends in the checksum over all before it; the index follows
CHUNK_CHECKSUM = HEAD.size + 3 * 8  # after two times and a size


def a_segment(folder: Path) -> tuple[Path, bytearray, int]:
    """A finished one of three steps, its bytes, and where its index begins."""
    write_run(folder, 3)
    (path,) = segments_of(folder)
    raw = bytearray(path.read_bytes())
    return path, raw, FOOTER.unpack(raw[-FOOTER.size :])[2]


def test_a_segment_without_the_checksum_over_its_data_is_at_fault(tmp_path: Path) -> None:
    """Zero means "not reckoned" in MCAP: whoever changed the data could have it not compared."""
    path, raw, index = a_segment(tmp_path)
    assert raw[index - DATA_END_BYTES] == 0x0F
    raw[index - 4 : index] = bytes(4)
    path.write_bytes(raw)
    scan = Scan(path)
    assert len(list(scan)) == 5  # the opening, three steps, the end
    assert (scan.finished, scan.torn) == (False, False)
    assert "checksum over the data is missing" in scan.fault


def test_a_chunk_that_does_not_match_its_checksum_ends_a_torn_segment(tmp_path: Path) -> None:
    """Nothing else holds it together there: what was committed before it counts, it and what follows do not."""
    path, raw, index = a_segment(tmp_path)
    summary = SegmentReader(path).index
    assert summary is not None
    raw[summary["ChunkIndex"][2].chunk_start_offset + CHUNK_CHECKSUM] ^= 4
    path.write_bytes(raw[: index - DATA_END_BYTES])
    scan = Scan(path)
    assert len(list(scan)) == 2  # the opening and a step
    assert (scan.finished, scan.torn) == (False, False)
    assert "crc" in scan.fault.lower()


def as_written(record: McapRecord) -> bytes:
    """A record as it lies in a file."""
    built = RecordBuilder()
    record.write(built)
    return bytes(built.end())  # type: ignore[no-untyped-call]  # mcap leaves its return type open


def with_chunk(path: Path, compression: str, packed: bytes, plain: bytes, size_bytes: int) -> Path:
    """A segment of one chunk, as somebody made it with a right checksum."""
    chunk = Chunk(compression, packed, 0, 0, zlib.crc32(plain), size_bytes)
    path.write_bytes(MCAP0_MAGIC + as_written(Header(PROFILE, "x")) + as_written(chunk))
    return path


LARGER = bytes(UNPACKED_LIMIT_BYTES + 1)
OTHER = struct.pack("<BQ", 0, 0) * 1000


@pytest.mark.parametrize(
    ("compression", "packed", "plain", "size_bytes", "fault"),
    [
        ("zstd", zstandard.compress(LARGER), LARGER, len(LARGER), "no journal has such"),
        ("zstd", zstandard.compress(LARGER), b"", 0, "has not the size"),
        ("zstd", zstandard.compress(b"short"), b"short", 6, "has not the size"),
        ("zstd", zstandard.compress(OTHER), OTHER, len(OTHER), "a record of kind 0"),
        ("", OTHER, OTHER, len(OTHER), "a record of kind 0"),
        ("lz4", b"garbage", b"", 0, "compression 'lz4'"),
    ],
    ids=["much", "much, as nothing", "less than stated", "other records", "other records, plain", "lz4"],
)
def test_a_chunk_that_no_writer_of_ours_makes_is_a_fault(
    tmp_path: Path, compression: str, packed: bytes, plain: bytes, size_bytes: int, fault: str
) -> None:
    """A few kB that unpack to very much, another compression, other records: said before memory or time is lost."""
    scan = Scan(with_chunk(tmp_path / "audit-0001.mcap", compression, packed, plain, size_bytes))
    assert list(scan) == []
    assert (scan.finished, scan.torn) == (False, False)
    assert fault in scan.fault


def test_readers_by_the_index_refuse_such_a_chunk_too(tmp_path: Path) -> None:
    """The third chunk says of itself that it is compressed otherwise."""
    path, raw, _ = a_segment(tmp_path)
    summary = SegmentReader(path).index
    assert summary is not None
    name = summary["ChunkIndex"][2].chunk_start_offset + CHUNK_CHECKSUM + 4 + 4  # after checksum and length
    assert raw[name : name + 4] == b"zstd"
    raw[name : name + 4] = b"lz4\0"
    path.write_bytes(raw)
    with pytest.raises(LuxloopError, match="damaged"):
        list(SegmentReader(path).records())


GARBAGE = Chunk("lz4", b"garbage", 0, 0, 0, 0)


def test_a_chunk_before_the_header_stays_packed(tmp_path: Path) -> None:
    """Whoever looks for the header would have unpacked it."""
    path = tmp_path / "audit-0001.mcap"
    path.write_bytes(MCAP0_MAGIC + as_written(GARBAGE))
    scan = Scan(path)
    assert list(scan) == []
    assert "compression 'lz4'" in scan.fault


@pytest.mark.parametrize("more", [as_written(GARBAGE), b"\x04\xff", b""], ids=["a chunk", "half a record", "nothing"])
def test_an_index_is_read_without_what_else_is_among_it(tmp_path: Path, more: bytes) -> None:
    """A second index behind the end, with a right checksum: it is of no data, and a chunk in it stays packed."""
    path, raw, _ = a_segment(tmp_path)
    tail = FOOTER.pack(0x02, 20, len(raw), 0, 0, MCAP0_MAGIC)[: FOOTER.size - 12]
    path.write_bytes(bytes(raw) + more + tail + struct.pack("<I", zlib.crc32(more + tail)) + MCAP0_MAGIC)
    index = SegmentReader(path).index
    assert not (index and index["ChunkIndex"])
    scan = Scan(path)
    assert len(list(scan)) == 5
    assert not scan.finished
    assert scan.fault
