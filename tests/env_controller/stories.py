"""A dispatch core with a clock of its own, for tests that read as a story."""

from __future__ import annotations

from env_controller import events as e
from env_controller.scheduler import Scheduler

A, B = "a" * 64, "b" * 64


class Story:
    """A scheduler with a clock of its own, for tests that read as a story."""

    def __init__(self, **options: float) -> None:
        self.core = Scheduler("e1", **options)  # type: ignore[arg-type]
        self.now = 0.0
        self.polls = 0

    def submit(self, task: str = A, **options: float) -> list[e.Command]:
        return self.core.handle(e.Submitted(self.now, task, "film", **options))  # type: ignore[arg-type]

    def join(self, worker: str = "w1", *holding: tuple[str, int], slots: int = 1) -> list[e.Command]:
        return self.core.handle(e.Joined(self.now, worker, "film", slots, holding))

    def poll(self, worker: str = "w1", holding: tuple[str, ...] = (), hold: bool = True) -> list[e.Command]:
        self.polls += 1
        return self.core.handle(e.Polled(self.now, worker, self.polls, holding, hold))

    def granted(self, worker: str = "w1") -> str:
        """The task that a poll is granted at once."""
        (grant,) = self.poll(worker)
        assert isinstance(grant, e.Grant)
        return grant.task_id

    def deliver(
        self, worker: str = "w1", task: str = A, attempt: int = 1, verdict: str = "done", epoch: str = "e1"
    ) -> list[e.Command]:
        return self.core.handle(e.Delivered(self.now, worker, task, attempt, epoch, verdict, "why"))  # type: ignore[arg-type]

    def leased(self, worker: str = "w1", task: str = A) -> Story:
        self.join(worker)
        self.submit(task)
        assert self.poll(worker) == [e.Grant(self.polls, worker, task, 1)]
        return self
