"""Every message on the bus, as frozen models with units in the names. `bus/keys.py` says which travels where.

client ──Submit──▶ controller ──Lease──▶ worker          Outcome goes back the same way, by Done.
"""

from __future__ import annotations

import json
from functools import cached_property
from typing import ClassVar, Literal, Protocol

from pydantic import Field, model_validator

from luxloop import __version__
from luxloop.campaign import Action, Begin, Begun, End, Ended, Note, RunId, Step
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.words import Name, Plain, Sha256, Text, Words, sha256_of

SCHEMA = 1  # of all messages together; a frame of another number is refused, naming both


class Request(Protocol):
    """A message that names the kind of worker it is for."""

    KIND: ClassVar[str]

    def model_dump_json(self) -> str: ...


class Task(Words):
    """One piece of work: what kind of worker, which request (canonical JSON), of which release.

    Its id is the SHA-256 of all that decides the result, so the same question has the same id from anybody, and a
    result may serve everybody who asked. The seed, the environment and the effects are part of `inputs`.
    """

    kind: Name
    inputs: Plain
    version: Text

    @classmethod
    def of(cls, request: Request) -> Task:
        """The task that a typed request makes: its kind of worker, its canonical inputs, this release."""
        return cls(kind=request.KIND, inputs=json.loads(request.model_dump_json()), version=__version__)

    @cached_property
    def id(self) -> str:
        """SHA-256 over kind, inputs and release."""
        return sha256_of({"kind": self.kind, "inputs": self.inputs, "version": self.version})


class Submit(Words):
    """A client asks for a task's outcome; the query is held until it is there or the hold is over."""

    task: Task
    asker: Name
    fresh: bool = Field(False, description="compute it again, although a finished result is kept")
    patience_s: float = Field(30.0, ge=0.0, le=86400.0, description="how long to wait for a worker to appear")
    limit_s: float = Field(600.0, gt=0.0, le=86400.0, description="longest computation of one attempt")


class Outcome(Words):
    """What came of a task: a result (with arrays beside it in the frame) or a failure; and who computed it."""

    task_id: Sha256
    result: Plain | None = None
    failure: Failure | None = None
    worker: str = ""
    attempt: int = 0
    compute_s: float = 0.0

    @model_validator(mode="after")
    def _exactly_one(self) -> Outcome:
        if (self.result is None) == (self.failure is None):
            raise InputError("result", self.result, "either a result or a failure")
        return self


class Pending(Words):
    """Not finished yet: ask again. `state` is queued or running, `progress_ratio` from the last heartbeat."""

    task_id: Sha256
    state: Literal["queued", "running"]
    progress_ratio: float = 0.0
    note: Text = ""


class Withdraw(Words):
    """A client no longer wants a task; it is cancelled when nobody else waits for it."""

    task_id: Sha256
    asker: Name


class Describe(Words):
    """What a worker can do, told once before it is given work: its kind, release, and catalogue."""

    worker: Name
    kind: Name
    version: Text
    host: Text
    pid: int
    slots: int = Field(1, ge=1, le=64)
    catalogue: Plain = Field(default_factory=dict)


class Held(Words):
    """An attempt in a worker's hands."""

    task_id: Sha256
    attempt: int
    epoch: Name


class Hello(Words):
    """A worker introduces itself to the controller; answered by `Welcome` or a `Failure`.

    `holding` is what it computes at that moment: it may keep what is still its own, and is told to drop the rest.
    """

    describe: Describe
    holding: tuple[Held, ...] = Field((), max_length=64)


class Welcome(Words):
    """The controller's answer: the epoch that fences everything of its earlier lives."""

    epoch: Name
    version: Text


class Pull(Words):
    """A worker with a free slot asks for a task; held open until there is one or the hold is over.

    `holding` names what it still computes or must deliver: a lease that is not in it was lost on the way.
    """

    worker: Name
    kind: Name
    epoch: Name
    holding: tuple[Sha256, ...] = Field((), max_length=64)


class Lease(Words):
    """A task handed to a worker: attempt and epoch must come back with the result."""

    task: Task
    attempt: int = Field(ge=1)
    epoch: Name
    limit_s: float


class Nothing(Words):
    """No task within the hold: pull again."""


class Done(Words):
    """A worker delivers, until it gets a `Receipt`; `handed_back` returns the task unfinished without blame."""

    worker: Name
    kind: Name
    attempt: int
    epoch: Name
    outcome: Outcome | None = None
    handed_back: Sha256 | None = None
    wants_next: bool = False


class Receipt(Words):
    """The controller has the result safe, or will never want it (`accepted` false, with the reason)."""

    accepted: bool
    reason: Text = ""
    next: Lease | None = None


class Heartbeat(Words):
    """A worker is alive, and how far it is: once a second from a thread that does not compute."""

    worker: Name
    kind: Name
    task_id: Sha256 | None = None
    attempt: int = 0
    progress_ratio: float = 0.0
    note: Text = ""
    busy_s: float = 0.0
    resident_mb: float = 0.0
    sent_unix_s: float = 0.0


class Cancel(Words):
    """The controller tells a worker to drop an attempt; looked at between chunks of the computation."""

    task_id: Sha256
    attempt: int


class Introduce(Words):
    """The controller hears a worker that it does not know (any more): let it say hello with what it holds."""


class StatusAsked(Words):
    """Anybody asks the controller how things stand."""


class WorkerStatus(Words):
    """One worker as the controller sees it; what it can do, its catalogue, only itself says."""

    describe: Describe
    task_id: str = ""
    attempt: int = 0
    progress_ratio: float = 0.0
    heard_s_ago: float = 0.0
    clock_skew_s: float = 0.0
    finished: int = 0
    resident_mb: float = 0.0


class Status(Words):
    """How things stand: workers, queue lengths by kind, counts since this epoch began."""

    epoch: Name
    version: Text
    up_s: float
    now_unix_s: float
    workers: tuple[WorkerStatus, ...]
    queued: dict[str, int]
    running: int
    done: int
    failed: int
    requeued: int
    fenced: int
    hedged: int = 0
    resident_mb: float


class BlobAsked(Words):
    """A piece of a large array by its hash; answered by `BlobPiece` with the bytes as array `piece`."""

    offset: int = Field(0, ge=0)
    length: int = Field(1 << 20, ge=1, le=1 << 20)


class BlobPiece(Words):
    """Where the piece lies in the whole, and who holds it: the next piece is asked of that one only."""

    holder: Name
    offset: int
    total_bytes: int


class Replayed(Words):
    """A record of a journal that is played back; its bytes are the frame's arrays, one after the other.

    `place` counts what the player has published, so that a listener knows what it missed.
    """

    run: RunId
    place: int = Field(ge=0)
    topic: Text = Field("", description="Of the record; empty: the replay is over.")
    sequence: int = Field(0, ge=0)
    log_time_ns: int = Field(0, ge=0)


MESSAGES: dict[str, type[Words]] = {
    model.__name__: model
    for model in (
        Failure, Submit, Outcome, Pending, Withdraw, Hello, Welcome, Pull, Lease, Nothing, Done, Receipt,
        Heartbeat, Cancel, Introduce, StatusAsked, Status, BlobAsked, BlobPiece,
        Begin, Begun, Action, Step, Note, End, Ended, Replayed,
    )
}  # fmt: skip
