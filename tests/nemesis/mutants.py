"""Three ways to break the product on purpose, for which it has no switch: the checker must find each of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

SLOW_DISK_S = 0.4
"""So long is a batch acknowledged and not yet written, where that is the mutation."""


def acknowledge_before_fsync() -> None:
    """A step is told before it is on the disk."""
    from luxloop.journal.journal import Done, Journal
    from luxloop.journal.segment import Segment
    from luxloop.journal.topics import Record

    put, commit = Journal.put, Segment.commit

    def hasty(self: Journal, records: Sequence[Record], done: Done) -> None:
        done(None)
        put(self, records, lambda _: None)

    def slow(self: Segment) -> None:
        time.sleep(SLOW_DISK_S)
        commit(self)

    Journal.put = hasty  # type: ignore[method-assign]
    Segment.commit = slow  # type: ignore[method-assign]


def no_fencing() -> None:
    """A result is taken of whoever delivers it, whatever became of the attempt."""
    from env_controller.scheduler import LeaseRecord, Scheduler, WorkerRecord

    def fence(self: Scheduler, worker: str, task_id: str, attempt: int, epoch: str) -> str:
        if task_id not in self.leases:
            return "the task has ended"
        kind = self.tasks[task_id].kind
        self.workers.setdefault(worker, WorkerRecord(worker, kind, 1, 0.0))  # taken off the list while it was stopped
        return ""

    def held(self: Scheduler, task_id: str, worker: str, attempt: int) -> LeaseRecord:
        return self.leases[task_id]

    Scheduler._fence = fence  # type: ignore[method-assign]
    Scheduler._held = held  # type: ignore[method-assign]


def no_requeue() -> None:
    """A task whose worker was lost is not queued again."""
    from env_controller.scheduler import Scheduler, TaskRecord

    plain = Scheduler._make_ready

    def make_ready(self: Scheduler, task: TaskRecord) -> None:
        if task.attempt == 0:
            plain(self, task)

    Scheduler._make_ready = make_ready  # type: ignore[method-assign]


MUTANTS: dict[str, Callable[[], Any]] = {
    "acknowledge-before-fsync": acknowledge_before_fsync,
    "no-fencing": no_fencing,
    "no-requeue": no_requeue,
}
