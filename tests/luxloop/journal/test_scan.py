"""A segment read from its beginning: damage is noticed by its checksums, before anybody reckons the chain."""

from __future__ import annotations

from pathlib import Path

from luxloop.journal.reader import RECORD_HEAD_BYTES, SegmentReader, segments_of
from luxloop.journal.scan import FOOTER, Scan
from tests.journals import write_run

DATA_END_BYTES = RECORD_HEAD_BYTES + 4  # ends in the checksum over all before it; the index follows
CHUNK_CHECKSUM = RECORD_HEAD_BYTES + 3 * 8  # after two times and a size


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
    raw[summary.chunk_indexes[2].chunk_start_offset + CHUNK_CHECKSUM] ^= 4
    path.write_bytes(raw[: index - DATA_END_BYTES])
    scan = Scan(path)
    assert len(list(scan)) == 2  # the opening and a step
    assert (scan.finished, scan.torn) == (False, False)
    assert "crc" in scan.fault.lower()
