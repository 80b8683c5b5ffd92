"""Every message on the bus, as frozen models with units in the names. `bus/keys.py` says which travels where.

client ──Submit──▶ controller ──Lease──▶ worker          Outcome goes back the same way, by Done.
"""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from luxloop.errors import InputError
from luxloop.words import Words, canonical, sha256_of

SCHEMA = 1  # of all messages together; a frame of another number is refused, naming both

Code = Literal[
    "bad_input",  # the request cannot be used; trying again will not help
    "too_large",  # over the size limit of its key
    "busy",  # a bounded queue is full; try again later
    "version",  # the other side speaks another schema or is of another release
    "no_router",  # no router at the endpoint
    "no_controller",  # a router, but nobody who answers
    "no_worker",  # nobody of that kind came within the task's patience
    "worker_lost",  # workers died or fell silent while computing it, as often as is allowed
    "crashed",  # the worker's computation raised, as often as is allowed
    "cancelled",  # its submitters withdrew it
    "stale",  # of an attempt or an epoch that is over
    "refused",  # not permitted
    "timed_out",  # over its own time limit
    "not_found",  # a blob nobody holds, a task nobody knows
    "unknown_effect",  # the worker does not know the effect, or another source of it
]

Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Text = Annotated[str, Field(max_length=4000)]


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    try:
        canonical(values)
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError("values", str(error)[:200], "JSON values and finite numbers only") from error
    return values


Plain = Annotated[dict[str, Any], AfterValidator(_finite)]


class Failure(Words):
    """Why something could not be done, typed: `code` for machines, the rest for a person."""

    code: Code
    message: Text
    field: Text = ""
    value: Text = ""
    allowed: Text = ""
    mend: Text = ""
    where: Text = ""
    history: tuple[Text, ...] = ()

    def text(self) -> str:
        """One line for a person: what, where, the mend, and what was tried before."""
        parts = [self.message] + [f"[{self.where}]"] * bool(self.where)
        parts += [f"mend: {self.mend}"] * (bool(self.mend) and self.mend not in self.message)
        return f"{self.code}: " + "; ".join(parts + list(self.history))

    @classmethod
    def of(cls, error: Exception, where: str = "") -> Failure:
        """An exception as a message: `InputError` keeps its fields, anything else is a crash of that side."""
        if isinstance(error, InputError):
            return cls(
                code="bad_input",
                message=str(error)[:4000],
                field=error.field[:4000],
                value=repr(error.value)[:200],
                allowed=error.allowed[:4000],
                mend=error.mend[:4000],
                where=where,
            )
        return cls(code="crashed", message=f"{type(error).__name__}: {error}"[:4000], where=where)


class Task(Words):
    """One piece of work: what kind of worker, which request (canonical JSON), of which release.

    Its id is the SHA-256 of all that decides the result, so the same question has the same id from anybody, and a
    result may serve everybody who asked. The seed, the environment and the effects are part of `inputs`.
    """

    kind: Name
    inputs: Plain
    version: Text

    @cached_property
    def id(self) -> str:
        """SHA-256 over kind, inputs and release."""
        return sha256_of({"kind": self.kind, "inputs": self.inputs, "version": self.version})


class Submit(Words):
    """A client asks for a task's outcome; the query is held until it is there or the hold is over."""

    task: Task
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


class Describe(Words):
    """What a worker can do, told once before it is given work: its kind, release, and catalogue."""

    worker: Name
    kind: Name
    version: Text
    host: Text
    pid: int
    slots: int = Field(1, ge=1, le=64)
    catalogue: Plain = Field(default_factory=dict)


class Hello(Words):
    """A worker introduces itself to the controller; answered by `Welcome` or a `Failure`."""

    describe: Describe


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


class StatusAsked(Words):
    """Anybody asks the controller how things stand."""


class WorkerStatus(Words):
    """One worker as the controller sees it."""

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
    resident_mb: float


class BlobAsked(Words):
    """A piece of a large array by its hash; answered by `BlobPiece` with the bytes as array `piece`."""

    offset: int = Field(0, ge=0)
    length: int = Field(1 << 20, ge=1, le=1 << 20)


class BlobPiece(Words):
    """Where the piece lies in the whole."""

    offset: int
    total_bytes: int


MESSAGES: dict[str, type[Words]] = {
    model.__name__: model
    for model in (
        Failure, Submit, Outcome, Pending, Withdraw, Hello, Welcome, Pull, Lease, Nothing, Done, Receipt,
        Heartbeat, Cancel, StatusAsked, Status, BlobAsked, BlobPiece,
    )
}  # fmt: skip
