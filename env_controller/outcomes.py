"""How tasks end: outcomes kept for those who ask again, failures in words, when a run's task has taken too long."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Collection

from env_controller.events import Finish
from luxloop import __version__
from luxloop.failure import Failure
from luxloop.messages import Task

MENDS = {
    "no_worker": "start a worker of this kind: luxloop serve local, or luxloop doctor to see who is there",
    "worker_lost": "the task was set aside; see the workers' logs, and luxloop doctor",
    "timed_out": "give the task a higher limit, or ask for less at once",
}


RUN_LIMIT_S, OF_BUDGET = 3600.0, 6.0  # of a run's task, or so many times its budget: what is longer hangs


def run_limit_s(task: Task) -> float:
    """How long a worker may compute a task of a run: an evaluation's budget is seconds, a day would be lost on one
    that hangs, as in an endless loop of a user's effect."""
    budget_s = task.inputs.get("budget_s")
    return max(RUN_LIMIT_S, OF_BUDGET * budget_s if isinstance(budget_s, int | float) else 0.0)


def failure_of(finish: Finish, kind: str, limit_s: float, last: Failure | None) -> Failure:
    """Why a task of a kind was set aside; `last` is what its last delivered attempt said."""
    tries = len(finish.history)
    said = {
        "no_worker": f"no {kind} worker came",
        "worker_lost": f"{tries} attempts of this {kind} task ended with its worker's loss",
        "timed_out": f"the {kind} task ran over its limit of {limit_s:g} s",
        "cancelled": f"the {kind} task was withdrawn",
        "crashed": last.message if last else f"the {kind} task crashed {tries} times",
    }[finish.code]
    return Failure(
        code=finish.code,
        message=said,
        mend=MENDS.get(finish.code, ""),
        where="controller",
        history=finish.history,
    )


def other_release(version: str) -> Failure:
    """What a client or worker of another release is told."""
    return Failure(
        code="version",
        message=f"the other side runs luxloop {version}, this controller {__version__}",
        mend="run the same release on all sides",
        where=f"controller {os.getpid()}",
    )


class Results:
    """Finished outcomes for those who ask again, the least recently used dropped above a bound."""

    def __init__(self, max_bytes: int) -> None:
        self._frames: OrderedDict[str, bytes] = OrderedDict()
        self._max_bytes, self._bytes = max_bytes, 0
        self._once: dict[str, tuple[set[str], float]] = {}  # by task: who may still have it, until when

    def get(self, task_id: str, asker: str = "", now_s: float = 0.0) -> bytes | None:
        """The kept outcome's frame; one that is kept for some askers only is given to each of them once, in time."""
        frame = self._frames.get(task_id)
        if frame is None or task_id not in self._once:
            if frame is not None:
                self._frames.move_to_end(task_id)
            return frame
        askers, until_s = self._once[task_id]
        given = asker in askers and now_s <= until_s
        askers.discard(asker)
        if not askers or now_s > until_s:
            self.drop(task_id)
        return frame if given else None

    def put(self, task_id: str, frame: bytes, *, once: Collection[str] = (), until_s: float = 0.0) -> None:
        """Keep an outcome's frame; with `once` for these askers only, who have not heard of it, until then."""
        self.drop(task_id)
        self._frames[task_id] = frame
        self._bytes += len(frame)
        if once:
            self._once[task_id] = set(once), until_s
        while self._bytes > self._max_bytes and self._frames:
            self.drop(next(iter(self._frames)))

    def drop(self, task_id: str) -> None:
        """Keep it no longer."""
        self._bytes -= len(self._frames.pop(task_id, b""))
        self._once.pop(task_id, None)
