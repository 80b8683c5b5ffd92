"""Maps and text as the messages that viewers draw."""

from __future__ import annotations

import numpy as np
import pytest
from google.protobuf import descriptor_pb2  # type: ignore[import-untyped]  # protobuf ships no types

from luxloop.errors import InputError
from luxloop.journal.image import IMAGE, LOG, LogLine, descriptor_set, image_of, log_of, read_image, read_log

TIME_NS = 1_795_283_958_000_000_007
MAP = np.array([[-1.0, 0.0, 109_814.0], [1.5, 2.5, 3.5]])
"""Row 0 is the lowest y."""
IMAGE_HEX = (
    "0a0808f6b787d806100715030000001d02000000220533324643312d0c00000032180000c03f0000204000006040000080bf0000"
    "0000007bd6473a087265636569766572"
)
LOG_HEX = "0a0808f6b787d806100710031a06c2b52d4c4544220864657369676e6572"


def test_an_image_is_that_of_the_published_message() -> None:
    """The bytes that foxglove-schemas-protobuf 0.4.0 makes of the same pixels, the rows of highest y first."""
    assert image_of(MAP, TIME_NS).hex() == IMAGE_HEX


def test_a_line_of_text_is_that_of_the_published_message() -> None:
    """The same for foxglove.Log, level WARNING."""
    assert log_of(LogLine("µ-LED", "warning", "designer"), TIME_NS).hex() == LOG_HEX


def test_a_map_is_read_as_it_was_written() -> None:
    """The same rows and columns, to float32."""
    found = read_image(bytes.fromhex(IMAGE_HEX))
    np.testing.assert_array_equal(found, MAP.astype(np.float32))


def test_a_spot_at_the_highest_y_is_at_the_top_of_the_image() -> None:
    """Viewers draw the first row on top: it must be the map's last."""
    spot = np.zeros((4, 3))
    spot[-1, 0] = 1.0
    pixels = np.float32(1.0).tobytes() + bytes(44)
    assert pixels in image_of(spot, 0)
    assert read_image(image_of(spot, 0))[-1, 0] == 1.0


def test_a_view_of_any_stride_is_written_as_it_reads() -> None:
    """Transposed and reversed arrays are no special case."""
    wide = np.arange(24.0).reshape(4, 6)
    np.testing.assert_array_equal(read_image(image_of(wide.T[::-1, ::2], 0)), wide.T[::-1, ::2])


@pytest.mark.parametrize("bad", [np.zeros(3), np.zeros((0, 2)), np.array([[np.nan]]), np.array([[1e39]])])
def test_what_is_no_map_is_refused(bad: np.ndarray) -> None:
    """Another shape, no pixels, not a number, too large for float32."""
    with pytest.raises(InputError, match="map"):
        image_of(bad, 0)


@pytest.mark.parametrize("data", [b"\xff\xff", bytes.fromhex(IMAGE_HEX)[:60], bytes.fromhex(LOG_HEX)])
def test_what_is_no_image_is_refused(data: bytes) -> None:
    """Bytes of nothing, a cut message, another message."""
    with pytest.raises(InputError):
        read_image(data)


def test_text_is_read_as_it_was_written() -> None:
    """Message, level and name."""
    assert read_log(bytes.fromhex(LOG_HEX)) == LogLine("µ-LED", "warning", "designer")


@pytest.mark.parametrize("level", ["06", "ffffffffffffffffff01"])
def test_a_level_that_nobody_knows_is_refused(level: str) -> None:
    """6 and -1, which protobuf reads."""
    with pytest.raises(InputError, match=r"level: got (6|-1), allowed: 0 to 5"):
        read_log(bytes.fromhex("10" + level))


@pytest.mark.parametrize("name", [IMAGE, LOG])
def test_a_schema_is_complete(name: str) -> None:
    """It brings the well-known Timestamp with it; a viewer has no other source."""
    files = descriptor_pb2.FileDescriptorSet.FromString(descriptor_set(name)).file
    known = {f"{file.package}.{message.name}" for file in files for message in file.message_type}
    assert known == {"google.protobuf.Timestamp", name}
    assert all(needed in [file.name for file in files] for file in files for needed in file.dependency)
