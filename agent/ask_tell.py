"""The one interface of all designers: ask for a proposal, tell the step that came of it.

    for each lane in turn:   proposal = designer.ask(lane)   one at a time in each lane
                             designer.learn()                while the answer is awaited, or not at all
                             designer.tell(lane, step)       step s of lane 0, of lane 1, ...; then step s + 1

What a designer proposes depends on its seed and on what it was told in that order: on no clock, on no worker's speed,
and not on whether `learn` was called. A step with a failure teaches nothing: its lane begins anew.
"""

from __future__ import annotations

import io
import itertools
import json
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from agent.moves import Key, key_of
from luxloop.campaign import AgentRecord, Move, Step
from luxloop.design import Design
from luxloop.errors import InputError

BROKEN = (
    OSError, ValueError, KeyError, EOFError, TypeError, AttributeError, RuntimeError, MemoryError, zipfile.BadZipFile,
)  # fmt: skip
"""What reading an .npz file that is not as it was written may raise."""


@dataclass(frozen=True)
class Proposal:
    """What is to be evaluated next in a lane, a design or a move, and what the designer was like when it chose."""

    design: Design | None
    move: Move | None
    record: AgentRecord

    def plain(self) -> dict[str, Any]:
        """The proposal as JSON values."""
        parts = {"design": self.design, "move": self.move, "record": self.record}
        return {name: part and part.model_dump(mode="json") for name, part in parts.items()}

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> Proposal:
        """The proposal that `plain` was made of."""
        design, move = plain["design"], plain["move"]
        return cls(
            design and Design.model_validate(design),
            move and Move.model_validate(move),
            AgentRecord.model_validate(plain["record"]),
        )


@dataclass(frozen=True)
class Checkpoint:
    """All that a designer is: JSON values and plain arrays. Restored, it goes on as if it had never stopped."""

    words: dict[str, Any]
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)

    def to_bytes(self) -> bytes:
        """The checkpoint as an .npz file; the words are its entry `words`, UTF-8 JSON."""
        words = np.frombuffer(json.dumps(self.words, allow_nan=False).encode(), dtype=np.uint8)
        file = io.BytesIO()
        np.savez(file, words=words, **self.arrays)  # type: ignore[arg-type]  # the stub takes a name for allow_pickle
        return file.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes) -> Checkpoint:
        """The checkpoint in an .npz file; raises InputError where the bytes are none."""
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                if any(entry.compress_type != zipfile.ZIP_STORED for entry in file.zip.infolist()):
                    raise zipfile.BadZipFile("an entry is compressed")
                arrays = {name: file[name] for name in file.files}
            return cls(json.loads(arrays.pop("words").tobytes()), arrays)
        except BROKEN as error:
            raise InputError(
                "checkpoint", f"{len(data)} bytes", "a designer's .npz checkpoint", str(error)
            ) from error


class Designer(Protocol):
    """Proposes designs in lanes; see the head of this file for the order of calls."""

    name: str
    known: Known

    @property
    def finished(self) -> bool:
        """Whether it has nothing more to propose."""

    def ask(self, lane: int) -> Proposal | None:
        """What to evaluate next in this lane; None where there is nothing more. The last one must have been told."""

    def tell(self, lane: int, step: Step) -> None:
        """Takes the step that came of the lane's proposal."""

    def learn(self) -> None:
        """Does now what would else be done in the next `tell`; changes no proposal."""

    def awaited(self, lane: int) -> Proposal | None:
        """The proposal of this lane that was not told yet: after `restore` it is to be sent again."""

    def state(self) -> Checkpoint:
        """All that the designer is."""

    def restore(self, checkpoint: Checkpoint) -> None:
        """Becomes what `state` was taken from; raises InputError where that was a designer of another kind."""


class Lanes:
    """The proposals under way: one in each lane, numbered from 0 in each."""

    def __init__(self, count: int) -> None:
        self.awaited: list[Proposal | None] = [None] * count
        self.asked = [0] * count

    def ask(self, lane: int, design: Key | None = None, move: Move | None = None, **record: Any) -> Proposal:
        """Books a proposal in a lane; raises ValueError where one is under way."""
        if self.awaited[lane] is not None:
            raise ValueError(f"lane {lane} was asked again before its step {self.asked[lane] - 1} was told")
        words = AgentRecord(lane=lane, number=self.asked[lane], **record)
        proposal = Proposal(None if design is None else Design.from_vector(design), move, words)
        self.awaited[lane], self.asked[lane] = proposal, self.asked[lane] + 1
        return proposal

    def told(self, lane: int, step: Step) -> Proposal:
        """The proposal that this step answers; raises ValueError where it answers another or none."""
        proposal = self.awaited[lane]
        if proposal is None or (step.lane, step.number) != (lane, proposal.record.number):
            due = "none" if proposal is None else f"step {proposal.record.number}"
            raise ValueError(f"lane {lane} was told step {step.number} of lane {step.lane}; under way: {due}")
        self.awaited[lane] = None
        return proposal

    def state(self) -> dict[str, Any]:
        """The lanes as JSON values."""
        return {"asked": list(self.asked), "awaited": [proposal and proposal.plain() for proposal in self.awaited]}

    def restore(self, words: dict[str, Any]) -> None:
        """The lanes as they were."""
        self.asked = list(words["asked"])
        self.awaited = [plain and Proposal.of_plain(plain) for plain in words["awaited"]]


class Known:
    """The designs asked for so far, and the uniformity of those that were told; each counts once."""

    def __init__(self) -> None:
        self.asked: dict[Key, None] = {}  # a dictionary is a set that keeps its order
        self.uniformity: dict[Key, float] = {}

    def __contains__(self, key: object) -> bool:
        return key in self.asked

    @property
    def evaluations(self) -> int:
        """How many different designs were told: the count that schedules and budgets go by."""
        return len(self.uniformity)

    def ask(self, key: Key) -> None:
        """Notes that a design was asked for."""
        self.asked[key] = None

    def tell(self, step: Step) -> Key:
        """Notes a step's uniformity, the first one told of a design; returns the design's key."""
        key = key_of(step.design)
        self.asked[key] = None
        self.uniformity.setdefault(key, step.uniformity)
        return key

    @property
    def best(self) -> tuple[Key, float] | None:
        """The best design told and its uniformity, the first of equals; None before the first."""
        return max(self.uniformity.items(), key=lambda item: item[1], default=None)

    def best_first(self, since: int = 0) -> Iterator[Key]:
        """The designs told after the first `since`, the best first, equals in their order."""
        told = itertools.islice(self.uniformity, since, None)
        return iter(sorted(told, key=self.uniformity.__getitem__, reverse=True))

    def state(self) -> dict[str, NDArray[np.float64]]:
        """The designs as arrays: asked (n, 5), told (m, 5), uniformity (m,)."""
        return {
            "known_asked": np.array(list(self.asked), dtype=np.float64).reshape(-1, len(Design.FIELDS)),
            "known_told": np.array(list(self.uniformity), dtype=np.float64).reshape(-1, len(Design.FIELDS)),
            "known_uniformity": np.array(list(self.uniformity.values()), dtype=np.float64),
        }

    def restore(self, arrays: dict[str, NDArray[Any]]) -> None:
        """The designs as they were."""
        self.asked = dict.fromkeys(map(tuple, arrays["known_asked"].tolist()))
        told = map(tuple, arrays["known_told"].tolist())
        self.uniformity = dict(zip(told, arrays["known_uniformity"].tolist(), strict=True))


def refuse_another(checkpoint: Checkpoint, name: str, settings: dict[str, Any]) -> None:
    """Raises InputError where a checkpoint is of another designer, or of one with other settings."""
    for field_name, ours in {"name": name, "settings": settings}.items():
        theirs = checkpoint.words.get(field_name)
        if theirs != ours:
            raise InputError(f"checkpoint.{field_name}", theirs, f"{ours}", "resume with what the run was begun with")
