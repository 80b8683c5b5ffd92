"""What happens to the environment-control agent, and what it wants done: plain frozen facts, as those of the core."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from env_controller.events import Command, Event
from env_controller.trials import Past
from luxloop.campaign import Action, Plan, Step
from luxloop.failure import Failure
from luxloop.messages import Task


@dataclass(frozen=True)
class Opened(Event):
    """A run begins, or goes on after what is on record."""

    plan: Plan
    past: Past = field(default_factory=Past)


@dataclass(frozen=True)
class Acted(Event):
    """A designer wants an action carried out."""

    action: Action


@dataclass(frozen=True)
class Ended(Event):
    """A task that was wanted has ended: with a result, or with why there is none; `kept`: some time ago already."""

    task_id: str
    result: dict[str, Any] | None
    failure: Failure | None = None
    compute_s: float = 0.0
    kept: bool = False


@dataclass(frozen=True)
class Closed(Event):
    """A run is over; what it still wants is of no use."""

    run: str


@dataclass(frozen=True)
class Want(Command):
    """Have a task computed for a run, with `fresh` once more; `group`: its film."""

    run: str
    task: Task
    group: str = ""
    ahead: bool = False
    fresh: bool = False


@dataclass(frozen=True)
class Unwant(Command):
    """Nobody here waits for the task any longer."""

    task_id: str


@dataclass(frozen=True)
class Record(Command):
    """Put the task that has just ended on a run's record."""

    run: str
    task_id: str


@dataclass(frozen=True)
class Again(Command):
    """Tell the designer a step that is on record."""

    step: Step


@dataclass(frozen=True)
class Tell(Command):
    """Put the step on record, then tell its designer."""

    step: Step
