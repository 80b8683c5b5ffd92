"""Maps and lines of text as the protobuf messages that viewers draw: foxglove.RawImage 32FC1 and foxglove.Log.

A map has row 0 at its lowest y; an image has row 0 at its top. So rows are written in reverse order, and a viewer
shows +y upwards as our own plots do; `read_image` turns them back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, get_args

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP
from numpy.typing import NDArray

from luxloop.errors import InputError

Level = Literal["unknown", "debug", "info", "warning", "error", "fatal"]
LEVELS: tuple[Level, ...] = get_args(Level)
IMAGE, LOG = "foxglove.RawImage", "foxglove.Log"
ENCODING = "32FC1"
FRAME = "receiver"
SECOND_NS = 1_000_000_000
STAMP = ".google.protobuf.Timestamp"
FIELDS: dict[str, tuple[tuple[str, int, str], ...]] = {
    IMAGE: (
        ("timestamp", 1, STAMP), ("frame_id", 7, "string"), ("width", 2, "fixed32"), ("height", 3, "fixed32"),
        ("encoding", 4, "string"), ("step", 5, "fixed32"), ("data", 6, "bytes"),
    ),
    LOG: (
        ("timestamp", 1, STAMP), ("level", 2, ".foxglove.Log.Level"), ("message", 3, "string"),
        ("name", 4, "string"), ("file", 5, "string"), ("line", 6, "fixed32"),
    ),
}  # fmt: skip
"""Name, number and kind of each field, as the published schemas have them."""


@dataclass(frozen=True)
class LogLine:
    """One line of a run's log."""

    message: str
    level: Level = "info"
    name: str = ""


def image_of(map_yx: NDArray[Any], log_time_ns: int, frame: str = FRAME) -> bytes:
    """A map (y, x), row 0 at the lowest y, as an image of float32, row 0 at the top; `frame`: of what.

    Raises InputError where it has not two dimensions, or a value is not finite in float32.
    """
    if map_yx.ndim != 2 or 0 in map_yx.shape:
        raise InputError("map", map_yx.shape, "a shape (y, x)")
    with np.errstate(over="ignore"):  # said below
        pixels = np.ascontiguousarray(map_yx[::-1], dtype="<f4")
    if not np.isfinite(pixels).all():
        raise InputError("map", float(np.max(map_yx)), "finite values up to 3.4e38")
    height, width = pixels.shape
    image = _message(IMAGE)(
        timestamp=_stamp(log_time_ns), frame_id=frame, width=width, height=height, encoding=ENCODING,
        step=4 * width, data=pixels.tobytes(),
    )  # fmt: skip
    return bytes(image.SerializeToString(deterministic=True))


def read_image(data: bytes) -> NDArray[np.float32]:
    """The map (y, x), row 0 at the lowest y, of an image. Raises InputError where it is none of ours."""
    image = _parsed(IMAGE, data)
    size = 4 * image.width * image.height
    if image.encoding != ENCODING or len(image.data) != size or image.step != 4 * image.width:
        raise InputError("image", f"{image.encoding}, {len(image.data)} bytes", f"{ENCODING} of {size} bytes")
    return np.frombuffer(image.data, "<f4").reshape(image.height, image.width)[::-1]


def frame_of(data: bytes) -> str:
    """Of what an image is: its frame. Raises InputError where it is none."""
    return str(_parsed(IMAGE, data).frame_id)


def log_of(line: LogLine, log_time_ns: int) -> bytes:
    """A line of text as foxglove.Log."""
    log = _message(LOG)(
        timestamp=_stamp(log_time_ns), level=LEVELS.index(line.level), message=line.message, name=line.name
    )
    return bytes(log.SerializeToString(deterministic=True))


def read_log(data: bytes) -> LogLine:
    """The line of text. Raises InputError where it is none, or of a level that we do not know."""
    log = _parsed(LOG, data)
    if not 0 <= log.level < len(LEVELS):  # to protobuf any number is one
        raise InputError("level", log.level, f"0 to {len(LEVELS) - 1}: {', '.join(LEVELS)}")
    return LogLine(log.message, LEVELS[log.level], log.name)


@cache
def descriptor_set(name: str) -> bytes:
    """The schema of a message as MCAP wants it: its file and all it imports, serialised."""
    stamp = descriptor_pb2.FileDescriptorProto()
    TIMESTAMP.CopyToProto(stamp)
    return bytes(descriptor_pb2.FileDescriptorSet(file=[stamp, _file(name)]).SerializeToString(deterministic=True))


def _file(name: str) -> Any:
    """The description of the .proto file in which a message is defined."""
    package, short = name.split(".")
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{package}/{short}.proto", package=package, syntax="proto3", dependency=[TIMESTAMP.name]
    )
    message = file.message_type.add(name=short)
    for field, number, kind in FIELDS[name]:
        described = message.field.add(name=field, number=number, label=kinds.LABEL_OPTIONAL)
        if kind.startswith("."):
            described.type = kinds.TYPE_MESSAGE if kind == STAMP else kinds.TYPE_ENUM
            described.type_name = kind
        else:
            described.type = getattr(kinds, f"TYPE_{kind.upper()}")
    if name == LOG:
        level = message.enum_type.add(name="Level")
        for number, word in enumerate(LEVELS):
            level.value.add(name=word.upper(), number=number)
    return file


@cache
def _message(name: str) -> Any:
    """The message class, from a pool of our own: another package may know these names too."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(descriptor_set(name)).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def _parsed(name: str, data: bytes) -> Any:
    try:
        return _message(name).FromString(data)
    except DecodeError as error:
        raise InputError(name, data[:20], "a message of this kind") from error


def _stamp(log_time_ns: int) -> Any:
    return {"seconds": log_time_ns // SECOND_NS, "nanos": log_time_ns % SECOND_NS}
