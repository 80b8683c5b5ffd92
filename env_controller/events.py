"""What happens to the dispatch core, and what it wants done: plain frozen facts, no sockets, no clock.

Every event carries the time at which it happened, so that a replay of the same events gives the same commands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Event:
    """Something happened at `at_s` (seconds on any clock that does not run backwards)."""

    at_s: float


@dataclass(frozen=True)
class Submitted(Event):
    """A task is wanted. Wanted twice, it is one task.

    `share` is whose wish it is, `group` what makes tasks alike (their film); `ahead`: of use only later, perhaps.
    """

    task_id: str
    kind: str
    patience_s: float = 30.0
    limit_s: float = 600.0
    share: str = ""
    group: str = ""
    ahead: bool = False


@dataclass(frozen=True)
class Withdrawn(Event):
    """Nobody wants the task any longer."""

    task_id: str


@dataclass(frozen=True)
class Joined(Event):
    """A worker introduced itself; `holding` is (task, attempt) of what it computes at that moment, of this epoch."""

    worker: str
    kind: str
    slots: int = 1
    holding: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class Left(Event):
    """A worker's token vanished. Without `blame` (it is we who lost the router) no attempt is held against a task."""

    worker: str
    reason: str = "its process ended, or hung, or its link was cut"
    blame: bool = True


@dataclass(frozen=True)
class Polled(Event):
    """A worker with a free slot asks for work. `holding` is what it has in hand; a lease not in it was lost.

    With `hold` the poll waits for a task, else it is released at once where there is none.
    """

    worker: str
    poll: int
    holding: tuple[str, ...] = ()
    hold: bool = True


@dataclass(frozen=True)
class PollOver(Event):
    """A held poll ended: its hold is over, or its asker has gone."""

    poll: int


@dataclass(frozen=True)
class Delivered(Event):
    """A worker says what came of an attempt: `done`; `refused` (the request is at fault, final); `crashed`."""

    worker: str
    task_id: str
    attempt: int
    epoch: str
    verdict: Literal["done", "refused", "crashed"]
    reason: str = ""


@dataclass(frozen=True)
class HandedBack(Event):
    """A worker that must go returns its task unfinished; nobody is to blame."""

    worker: str
    task_id: str
    attempt: int
    epoch: str


@dataclass(frozen=True)
class Beat(Event):
    """A worker says that it is alive."""

    worker: str


@dataclass(frozen=True)
class Tick(Event):
    """Time has passed; look for silence, time limits and lost patience.

    For `deaf_s` of it, up to now, we listened to nobody: that is as if it had not been.
    """

    deaf_s: float = 0.0


@dataclass(frozen=True)
class Command:
    """Something the process around the core must do."""


@dataclass(frozen=True)
class Grant(Command):
    """Answer the poll with the task."""

    poll: int
    worker: str
    task_id: str
    attempt: int


@dataclass(frozen=True)
class Release(Command):
    """Answer the poll with `Nothing`."""

    poll: int


@dataclass(frozen=True)
class Introduce(Command):
    """Answer the poll: this worker is not known here (any more), let it say hello again."""

    poll: int


@dataclass(frozen=True)
class Receive(Command):
    """Answer the delivery: accepted, or never wanted (with the reason)."""

    worker: str
    task_id: str
    attempt: int
    accepted: bool
    reason: str = ""


@dataclass(frozen=True)
class Finish(Command):
    """The task has ended. With code `done` or `refused` the delivered outcome stands, else a Failure is made."""

    task_id: str
    code: Literal["done", "refused", "crashed", "worker_lost", "timed_out", "no_worker", "cancelled"]
    history: tuple[str, ...] = ()


@dataclass(frozen=True)
class Stop(Command):
    """Tell the worker to drop the attempt."""

    worker: str
    task_id: str
    attempt: int
