"""What is written on which topic, and how the words of a campaign become records and records words again.

`sequence` counts the steps of a run from 0, over all its segments: all records of a step carry its number.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from luxloop import __version__
from luxloop.campaign import AgentRecord, Begin, RunId, Step
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.journal.chain import Link
from luxloop.journal.image import IMAGE, LOG, Level, LogLine, image_of, log_of, read_image, read_log
from luxloop.journal.schemas import conform, flat_schema, restore
from luxloop.messages import Outcome, Task
from luxloop.words import Name, Plain, Sha256, Text, Words, canonical, parse

LIMITS = {"sequence": (1 << 32) - 1, "log_time_ns": (1 << 63) - 1}


class RequestRecord(Words):
    """A task as it was handed out; its inputs are canonical JSON, so that its id can be computed again."""

    task_id: Sha256
    kind: Name
    version: Text
    inputs: Plain


class ReplyRecord(Words):
    """What came of a task, by whom; large arrays by their hashes."""

    task_id: Sha256
    kind: Name
    worker: Text = ""
    attempt: int = 0
    compute_s: float = 0.0
    result: Plain | None = None
    failure: Failure | None = None
    arrays: dict[str, Sha256] = Field(default_factory=dict, description="SHA-256 of raw little-endian arrays.")


class LearnerRecord(AgentRecord):
    """What the learner of a run was like."""

    run: RunId


class NoteRecord(Words):
    """What a designer wanted to have on record: the result of its run."""

    run: RunId
    designer: Name
    result: Plain


class ValidationStep(Words):
    """A step of comparing a model with measurements: on what, what was asked of the workers, what was found."""

    run: RunId
    command: Name
    model_sha256: Sha256
    dataset_sha256: Sha256
    seed: Text = ""
    tasks: tuple[Text, ...] = Field((), max_length=10_000, description="Ids of what the workers were asked.")
    document: Plain


class Checkpoint(Words):
    """How far the chain has come when records became durable."""

    records: int = Field(ge=0)
    root: Sha256


CHAIN = "/chain"
VALIDATION = "validation"
"""The kind of runs that compare a model with measurements: nobody designs in them."""
ENDED, STOPPED = "ended: ", "stopped: "
"""How the log's last line of a run begins: nothing was left to do; it may be gone on with."""
TOPICS: dict[str, type[Words] | str] = {
    "/request/film": RequestRecord,
    "/reply/film": ReplyRecord,
    "/request/ray": RequestRecord,
    "/reply/ray": ReplyRecord,
    "/map/sim": IMAGE,
    "/step": Step,
    "/agent": LearnerRecord,
    "/note": NoteRecord,
    "/validation": ValidationStep,
    "/map/residual": IMAGE,
    "/log": LOG,
    CHAIN: Checkpoint,
}
"""The record of each topic: words as JSON, or the name of a protobuf message."""
CHANNEL_FACTS: dict[str, dict[str, str]] = {
    "/map/sim": {"unit": "lx", "row_0": "highest y", "axes": "y, x"},
    "/map/residual": {"unit": "standard deviations of the noise", "row_0": "highest y", "frame_id": "the shot"},
}


class Close(NamedTuple):
    """Why a run was closed, and whether nothing was left to do."""

    reason: str
    complete: bool

    @classmethod
    def of(cls, line: str) -> Close | None:
        """What a line of the log says of it; None where it is another one."""
        for prefix in (ENDED, STOPPED):
            if line.startswith(prefix):
                return cls(line.removeprefix(prefix), prefix == ENDED)
        return None

    @property
    def line(self) -> str:
        """How it stands in the log."""
        return f"{ENDED if self.complete else STOPPED}{self.reason}"


@dataclass(frozen=True)
class Record(Link):
    """A message of a journal: its topic, its step, when it came to be (Unix time), its bytes as they lie in the file.

    Raises InputError for a topic that is not in the table, and numbers that have no room.
    """

    def __post_init__(self) -> None:
        if self.topic not in TOPICS:
            raise InputError("topic", self.topic, "one of " + ", ".join(TOPICS))
        for name, most in LIMITS.items():
            if not 0 <= getattr(self, name) <= most:
                raise InputError(name, getattr(self, name), f"0 to {most}")

    @property
    def value(self) -> Any:
        """The record decoded: words, a map (y, x) with row 0 at the lowest y, or a `LogLine`.

        Raises InputError where the bytes are not what the topic holds.
        """
        kind = TOPICS[self.topic]
        if isinstance(kind, str):
            return read_image(self.data) if kind == IMAGE else read_log(self.data)
        try:
            plain = restore(json.loads(self.data), flat_schema(kind))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise InputError(self.topic, self.data[:60], f"JSON of a {kind.__name__}") from error
        return parse(kind, plain, self.topic)


def record(topic: str, words: Words, sequence: int, log_time_ns: int) -> Record:
    """Words as the record of their topic: flat canonical JSON."""
    kind = TOPICS.get(topic)
    if not isinstance(kind, type) or not isinstance(words, kind):
        raise InputError(topic, type(words).__name__, f"a {getattr(kind, '__name__', kind)}")
    plain = conform(words.model_dump(mode="json"), flat_schema(kind))
    return Record(topic, sequence, log_time_ns, canonical(plain))


def request_record(task: Task, sequence: int, log_time_ns: int) -> Record:
    """A task as the record of its request."""
    words = RequestRecord(task_id=task.id, **task.model_dump())
    return record(f"/request/{task.kind}", words, sequence, log_time_ns)


def reply_record(
    kind: str, outcome: Outcome, arrays: Mapping[str, NDArray[Any]], sequence: int, log_time_ns: int
) -> Record:
    """What came of a task of this kind as the record of its reply."""
    hashes = {name: _array_sha256(array) for name, array in arrays.items()}
    words = ReplyRecord(kind=kind, arrays=hashes, **outcome.model_dump())
    return record(f"/reply/{kind}", words, sequence, log_time_ns)


def step_record(step: Step, sequence: int, log_time_ns: int) -> Record:
    """A step."""
    return record("/step", step, sequence, log_time_ns)


def map_record(map_lx: NDArray[Any], sequence: int, log_time_ns: int) -> Record:
    """The map (y, x) of a step, row 0 at the lowest y, in lx; kept as float32."""
    return Record("/map/sim", sequence, log_time_ns, image_of(map_lx, log_time_ns))


def log_record(line: str, sequence: int, log_time_ns: int, level: Level = "info", name: str = "") -> Record:
    """A line of text."""
    return Record("/log", sequence, log_time_ns, log_of(LogLine(line, level, name), log_time_ns))


def opening(begin: Begin) -> tuple[dict[str, str], dict[str, bytes]]:
    """Metadata `run` and the attachments with which the journal of a run begins."""
    run = {name: str(getattr(begin.plan, name)) for name in ("run", "kind", "model", "reward")}
    run |= {"designer": begin.designer, "version": __version__, "facts": canonical(begin.facts).decode()}
    attachments = {name: text.encode() for name, text in begin.attachments.items()}
    return run, attachments | {"plan.json": canonical(begin.plan)}


def _array_sha256(array: NDArray[Any]) -> str:
    return sha256(np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes()).hexdigest()
