"""The dispatch core: which task goes to which worker. Pure: an event in, commands out; no clock, no I/O.

    Submitted -> ready -> leased -> done | failed          a task
                   ^         |
                   +---------+   the worker left, fell silent, crashed, ran over the limit, or handed it back

An attempt that ended badly is tried again elsewhere, up to `attempts` times; then the task is set aside with the
history of its attempts. A delivery counts only from the holder of the lease, with its attempt and epoch: everything
older is fenced. `story` tells what happened to a task.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from env_controller import events as e

STORIES = 1000  # finished tasks whose story is kept


@dataclass
class TaskRecord:
    """A task that has not ended."""

    task_id: str
    kind: str
    since_s: float  # when it was submitted, or when the last worker of its kind went
    patience_s: float
    limit_s: float
    attempt: int = 0  # leases given so far: fences old ones
    failures: list[str] = field(default_factory=list)
    story: list[str] = field(default_factory=list)


@dataclass
class LeaseRecord:
    """A task in a worker's hands."""

    task_id: str
    worker: str
    attempt: int
    granted_s: float


@dataclass
class WorkerRecord:
    """A worker that has introduced itself."""

    worker: str
    kind: str
    slots: int
    heard_s: float
    finished: int = 0


class Scheduler:
    """The state of one epoch. `handle` is the only way to change it."""

    def __init__(self, epoch: str, *, attempts: int = 3, silence_s: float = 6.0) -> None:
        self.epoch, self.attempts, self.silence_s = epoch, attempts, silence_s
        self.tasks: dict[str, TaskRecord] = {}
        self.leases: dict[str, LeaseRecord] = {}  # by task
        self.workers: dict[str, WorkerRecord] = {}
        self.ready: dict[str, OrderedDict[str, None]] = {}  # by kind, in the order of submission
        self.polls: dict[int, str] = {}  # held polls in the order in which they came -> worker
        self.counts = {"done": 0, "failed": 0, "requeued": 0, "fenced": 0}
        self._stories: OrderedDict[str, list[str]] = OrderedDict()
        self._rules: dict[type[e.Event], Callable[[Any], list[e.Command]]] = {
            e.Submitted: self._submitted,
            e.Withdrawn: self._withdrawn,
            e.Joined: self._joined,
            e.Left: self._left,
            e.Polled: self._polled,
            e.PollOver: self._poll_over,
            e.Delivered: self._delivered,
            e.HandedBack: self._handed_back,
            e.Beat: self._beat,
            e.Tick: self._tick,
        }

    def handle(self, event: e.Event) -> list[e.Command]:
        """The commands that follow from one event."""
        worker = self.workers.get(getattr(event, "worker", ""))
        if worker is not None:
            worker.heard_s = event.at_s
        return self._rules[type(event)](event)

    def story(self, task_id: str) -> list[str]:
        """What happened to a task, one line each, oldest first; empty where it is not known (any more)."""
        task = self.tasks.get(task_id)
        return list(task.story if task else self._stories.get(task_id, []))

    def held_by(self, worker: str) -> list[LeaseRecord]:
        """The leases of one worker."""
        return [lease for lease in self.leases.values() if lease.worker == worker]

    def _submitted(self, event: e.Submitted) -> list[e.Command]:
        if event.task_id in self.tasks:
            task = self.tasks[event.task_id]
            task.patience_s = max(task.patience_s, event.patience_s)
            return []
        task = TaskRecord(event.task_id, event.kind, event.at_s, event.patience_s, event.limit_s)
        self.tasks[event.task_id] = task
        self._tell(task, event.at_s, "submitted")
        self._make_ready(task)
        return self._match(event.kind, event.at_s)

    def _withdrawn(self, event: e.Withdrawn) -> list[e.Command]:
        task = self.tasks.get(event.task_id)
        if task is None:
            return []
        lease = self.leases.get(event.task_id)
        stop: list[e.Command] = [e.Stop(lease.worker, lease.task_id, lease.attempt)] if lease else []
        return [*stop, self._end(task, event.at_s, "cancelled")]

    def _joined(self, event: e.Joined) -> list[e.Command]:
        """A worker comes, or comes back: it keeps what is still its own or nobody else has taken up since."""
        before = self.workers.get(event.worker)
        commands = self._release_polls(event.worker)
        finished = before.finished if before else 0
        self.workers[event.worker] = WorkerRecord(event.worker, event.kind, event.slots, event.at_s, finished)
        for lease in self.held_by(event.worker):
            if (lease.task_id, lease.attempt) not in event.holding:
                commands += self._requeue(lease, event.at_s, "the worker came back without it", blame=False)
        for task_id, attempt in event.holding:
            if not self._adopt(event, task_id, attempt):
                commands.append(e.Stop(event.worker, task_id, attempt))
        return commands

    def _adopt(self, event: e.Joined, task_id: str, attempt: int) -> bool:
        """Whether a worker may go on with an attempt: its lease stands, or the task still waits for another one."""
        lease, task = self.leases.get(task_id), self.tasks.get(task_id)
        if lease is not None:
            return (lease.worker, lease.attempt) == (event.worker, attempt)
        full = len(self.held_by(event.worker)) >= event.slots
        if full or task is None or (task.kind, task.attempt) != (event.kind, attempt):
            return False
        del self.ready[task.kind][task_id]
        self.leases[task_id] = LeaseRecord(task_id, event.worker, attempt, event.at_s)
        task.failures = [said for said in task.failures if not said.startswith(f"attempt {attempt}:")]
        self._tell(task, event.at_s, f"attempt {attempt} goes on with {event.worker}")
        return True

    def _left(self, event: e.Left) -> list[e.Command]:
        return self._forget(event.worker, event.at_s, event.reason, blame=event.blame)

    def _polled(self, event: e.Polled) -> list[e.Command]:
        worker = self.workers.get(event.worker)
        if worker is None:
            return [e.Introduce(event.poll)]
        commands: list[e.Command] = []
        for lease in self.held_by(event.worker):
            if lease.task_id not in event.holding:
                commands += self._requeue(lease, event.at_s, "the lease never reached the worker", blame=False)
        if len(self.held_by(event.worker)) >= worker.slots:
            return [*commands, e.Release(event.poll)]
        older = [poll for poll, name in self.polls.items() if name == event.worker]
        for poll in older[: len(older) + 1 + len(self.held_by(event.worker)) - worker.slots]:
            del self.polls[poll]  # its asker has given it up: a grant to it would be lost
            commands.append(e.Release(poll))
        self.polls[event.poll] = event.worker
        commands += self._match(worker.kind, event.at_s)
        if not event.hold and event.poll in self.polls:
            del self.polls[event.poll]
            commands.append(e.Release(event.poll))
        return commands

    def _poll_over(self, event: e.PollOver) -> list[e.Command]:
        return [e.Release(event.poll)] if self.polls.pop(event.poll, None) is not None else []

    def _delivered(self, event: e.Delivered) -> list[e.Command]:
        refusal = self._fence(event.worker, event.task_id, event.attempt, event.epoch)
        receive = e.Receive(event.worker, event.task_id, event.attempt, not refusal, refusal)
        if refusal:
            self.counts["fenced"] += 1
            return [receive]
        if event.verdict == "crashed":
            lease = self.leases[event.task_id]
            return [receive, *self._requeue(lease, event.at_s, f"crashed: {event.reason}", code="crashed")]
        self.workers[event.worker].finished += 1
        return [receive, self._end(self.tasks[event.task_id], event.at_s, event.verdict)]

    def _handed_back(self, event: e.HandedBack) -> list[e.Command]:
        refusal = self._fence(event.worker, event.task_id, event.attempt, event.epoch)
        receive = e.Receive(event.worker, event.task_id, event.attempt, not refusal, refusal)
        if refusal:
            return [receive]
        return [receive, *self._requeue(self.leases[event.task_id], event.at_s, "handed back", blame=False)]

    def _beat(self, event: e.Beat) -> list[e.Command]:
        worker = self.workers.get(event.worker)
        return self._match(worker.kind, event.at_s) if worker else []

    def _tick(self, event: e.Tick) -> list[e.Command]:
        commands: list[e.Command] = []
        for lease in list(self.leases.values()):
            worker, task = self.workers[lease.worker], self.tasks[lease.task_id]
            if event.at_s - worker.heard_s > self.silence_s:
                why, code = f"{lease.worker} was silent for {event.at_s - worker.heard_s:.1f} s", "worker_lost"
            elif event.at_s - lease.granted_s > task.limit_s:
                why, code = f"over its limit of {task.limit_s:g} s on {lease.worker}", "timed_out"
            else:
                continue
            commands.append(e.Stop(lease.worker, lease.task_id, lease.attempt))
            commands += self._requeue(lease, event.at_s, why, code=code)
        return commands + self._lose_patience(event.at_s)

    def _lose_patience(self, at_s: float) -> list[e.Command]:
        """End the tasks that have waited too long for a worker of their kind to appear."""
        served = {worker.kind for worker in self.workers.values()}
        waiting = [self.tasks[i] for kind, ids in self.ready.items() if kind not in served for i in ids]
        return [self._end(task, at_s, "no_worker") for task in waiting if at_s - task.since_s > task.patience_s]

    def _match(self, kind: str, at_s: float) -> list[e.Command]:
        """Give ready tasks of a kind to the polls that have waited longest."""
        commands: list[e.Command] = []
        ready = self.ready.get(kind)
        for poll, name in list(self.polls.items()):
            if not ready:
                break
            worker = self.workers[name]
            if worker.kind != kind or at_s - worker.heard_s > self.silence_s:
                continue
            del self.polls[poll]
            if len(self.held_by(name)) >= worker.slots:
                commands.append(e.Release(poll))
                continue
            task = self.tasks[ready.popitem(last=False)[0]]
            task.attempt += 1
            self.leases[task.task_id] = LeaseRecord(task.task_id, name, task.attempt, at_s)
            self._tell(task, at_s, f"attempt {task.attempt} leased to {name}")
            commands.append(e.Grant(poll, name, task.task_id, task.attempt))
        return commands

    def _fence(self, worker: str, task_id: str, attempt: int, epoch: str) -> str:
        """Why a delivery does not count, or an empty string where it does."""
        lease = self.leases.get(task_id)
        if epoch != self.epoch:
            return f"epoch {epoch} is over, this is {self.epoch}"
        if lease is None:
            return "the task has ended" if task_id not in self.tasks else "the task is not leased"
        if (lease.worker, lease.attempt) != (worker, attempt):
            return f"attempt {attempt} of {worker} is over, attempt {lease.attempt} is with {lease.worker}"
        return ""

    def _release_polls(self, name: str) -> list[e.Command]:
        mine = [poll for poll, worker in self.polls.items() if worker == name]
        self.polls = {poll: worker for poll, worker in self.polls.items() if worker != name}
        return [e.Release(poll) for poll in mine]

    def _forget(self, name: str, at_s: float, reason: str, *, blame: bool) -> list[e.Command]:
        """Take a worker off the list, its polls and leases with it."""
        gone = self.workers.pop(name, None)
        if gone is None:
            return []
        commands = self._release_polls(name)
        for lease in self.held_by(name):
            commands += self._requeue(lease, at_s, f"{name} was lost: {reason}", blame=blame)
        if not any(worker.kind == gone.kind for worker in self.workers.values()):
            for task_id in self.ready.get(gone.kind, ()):
                self.tasks[task_id].since_s = at_s
        return commands

    def _requeue(
        self, lease: LeaseRecord, at_s: float, why: str, *, blame: bool = True, code: str = "worker_lost"
    ) -> list[e.Command]:
        """Take a lease back; the task is ready again, or set aside when it has been tried often enough."""
        del self.leases[lease.task_id]
        task = self.tasks[lease.task_id]
        self._tell(task, at_s, f"attempt {lease.attempt}: {why}")
        if blame:
            task.failures.append(f"attempt {lease.attempt}: {why}")
        if len(task.failures) >= self.attempts:
            return [self._end(task, at_s, code)]
        self.counts["requeued"] += 1
        task.since_s = at_s
        self._make_ready(task)
        return self._match(task.kind, at_s)

    def _make_ready(self, task: TaskRecord) -> None:
        """Queue a task: a new one at the end, one that comes back at the front, for it has waited longest."""
        queue = self.ready.setdefault(task.kind, OrderedDict())
        queue[task.task_id] = None
        if task.attempt:
            queue.move_to_end(task.task_id, last=False)

    def _end(self, task: TaskRecord, at_s: float, code: str) -> e.Finish:
        self.tasks.pop(task.task_id)
        self.leases.pop(task.task_id, None)
        queue = self.ready.get(task.kind, OrderedDict())
        queue.pop(task.task_id, None)
        if not queue:
            self.ready.pop(task.kind, None)
        self.counts["done" if code == "done" else "failed"] += 1
        self._tell(task, at_s, f"ended: {code}")
        self._stories[task.task_id] = task.story
        while len(self._stories) > STORIES:
            self._stories.popitem(last=False)
        return e.Finish(task.task_id, code, tuple(task.failures))  # type: ignore[arg-type]  # codes come from above

    @staticmethod
    def _tell(task: TaskRecord, at_s: float, what: str) -> None:
        task.story.append(f"{at_s:.3f} {what}")
