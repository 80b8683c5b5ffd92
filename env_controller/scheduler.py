"""The dispatch core: which task goes to which worker. Pure: an event in, commands out; no clock, no I/O.

    Submitted -> ready -> leased -> done | failed          a task
                   ^         |
                   +---------+   the worker left, fell silent, crashed, ran over the limit, or handed it back

An attempt that ended badly is tried again elsewhere, where a worker is listed that has not failed in it, up to
`attempts` times; then the task is set aside with the history of its attempts. A delivery counts only from the holder
of a lease, with its attempt and epoch: everything older is fenced. When nothing else waits, the slowest task is
hedged: an idle worker gets it too, under a lease of its own, and whoever delivers first ends it. `story` tells what
happened to a task.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from env_controller import events as e
from env_controller.hedging import Durations
from env_controller.waiting import Queue

STORIES = 1000  # finished tasks whose story is kept
GROUPS = 64  # of a worker that are remembered: as many fields by Monte Carlo as it keeps
BETWEEN_S = 0.25  # a worker that has delivered asks again within milliseconds; so long it is waited for


class Failed(NamedTuple):
    """An attempt that ended badly: whose, and why."""

    attempt: int
    worker: str
    why: str


@dataclass
class TaskRecord:
    """A task that has not ended."""

    task_id: str
    kind: str
    since_s: float  # when it was submitted, or when the last worker of its kind went
    patience_s: float
    limit_s: float
    share: str = ""
    group: str = ""
    ahead: bool = False
    attempt: int = 0  # leases given so far: fences old ones
    failures: list[Failed] = field(default_factory=list)
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
    groups: list[str] = field(default_factory=list)  # of its last tasks, the latest first
    delivered_s: float = -1e9


class Scheduler:
    """The state of one epoch. `handle` is the only way to change it."""

    def __init__(self, epoch: str, *, attempts: int = 3, silence_s: float = 6.0) -> None:
        self.epoch, self.attempts, self.silence_s = epoch, attempts, silence_s
        self.tasks: dict[str, TaskRecord] = {}
        self.leases: dict[str, LeaseRecord] = {}  # by task
        self.hedges: dict[str, LeaseRecord] = {}  # by task, the second leases
        self.workers: dict[str, WorkerRecord] = {}
        self.ready: dict[str, Queue] = {}  # by kind
        self.polls: dict[int, str] = {}  # held polls in the order in which they came -> worker
        self.counts = {"done": 0, "failed": 0, "requeued": 0, "fenced": 0, "hedged": 0}
        self._durations = Durations()
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
        return [lease for lease in self._all_leases() if lease.worker == worker]

    def _all_leases(self) -> list[LeaseRecord]:
        return [*self.leases.values(), *self.hedges.values()]

    def _lease(self, task_id: str, worker: str, attempt: int) -> LeaseRecord | None:
        """The lease of that worker and attempt, where it stands."""
        leases = (self.leases.get(task_id), self.hedges.get(task_id))
        return next((own for own in leases if own and (own.worker, own.attempt) == (worker, attempt)), None)

    def _submitted(self, event: e.Submitted) -> list[e.Command]:
        if event.task_id in self.tasks:
            task = self.tasks[event.task_id]
            task.patience_s = max(task.patience_s, event.patience_s)
            task.limit_s = max(task.limit_s, event.limit_s)
            if task.ahead and not event.ahead:
                task.share, task.ahead = event.share, False
                if task.task_id in self.ready.get(task.kind, ()):
                    self.ready[task.kind].discard(task.task_id)
                    self._make_ready(task)
            return []
        wish = (event.share, event.group, event.ahead)
        task = TaskRecord(event.task_id, event.kind, event.at_s, event.patience_s, event.limit_s, *wish)
        self.tasks[event.task_id] = task
        self._tell(task, event.at_s, "submitted")
        self._make_ready(task)
        return [] if self._comes_back(task, event.at_s) else self._match(event.kind, event.at_s)

    def _withdrawn(self, event: e.Withdrawn) -> list[e.Command]:
        task = self.tasks.get(event.task_id)
        return [] if task is None else self._end(task, event.at_s, "cancelled")

    def _joined(self, event: e.Joined) -> list[e.Command]:
        """A worker comes, or comes back: it keeps what is still its own or nobody else has taken up since.

        What was leased to it and it does not name may be on its way: its next poll tells.
        """
        before = self.workers.get(event.worker)
        commands = self._release_polls(event.worker)
        after = WorkerRecord(event.worker, event.kind, event.slots, event.at_s)
        if before is not None:  # the same process, whose link was cut: another one has another name
            after.finished, after.groups = before.finished, before.groups
        self.workers[event.worker] = after
        for task_id, attempt in event.holding:
            if not self._adopt(event, task_id, attempt):
                commands.append(e.Stop(event.worker, task_id, attempt))
        return commands

    def _adopt(self, event: e.Joined, task_id: str, attempt: int) -> bool:
        """Whether a worker may go on with an attempt: its lease stands, or the task still waits for another one."""
        if task_id in self.leases:
            return self._lease(task_id, event.worker, attempt) is not None
        task = self.tasks.get(task_id)
        full = len(self.held_by(event.worker)) >= event.slots
        if full or task is None or (task.kind, task.attempt) != (event.kind, attempt):
            return False
        self._take_out(task)
        self.leases[task_id] = LeaseRecord(task_id, event.worker, attempt, event.at_s)
        task.failures = [failed for failed in task.failures if failed.attempt != attempt]
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
        lease = self._held(event.task_id, event.worker, event.attempt)
        if event.verdict == "crashed":
            return [receive, *self._requeue(lease, event.at_s, f"crashed: {event.reason}", code="crashed")]
        task = self.tasks[event.task_id]
        worker = self.workers[event.worker]
        worker.finished, worker.delivered_s = worker.finished + 1, event.at_s
        self._durations.note(task.kind, event.at_s - lease.granted_s)
        return [receive, *self._end(task, event.at_s, event.verdict, winner=lease)]

    def _handed_back(self, event: e.HandedBack) -> list[e.Command]:
        refusal = self._fence(event.worker, event.task_id, event.attempt, event.epoch)
        receive = e.Receive(event.worker, event.task_id, event.attempt, not refusal, refusal)
        if refusal:
            return [receive]
        lease = self._held(event.task_id, event.worker, event.attempt)
        return [receive, *self._requeue(lease, event.at_s, "handed back", blame=False)]

    def _beat(self, event: e.Beat) -> list[e.Command]:
        worker = self.workers.get(event.worker)
        return self._match(worker.kind, event.at_s) if worker else []

    def _tick(self, event: e.Tick) -> list[e.Command]:
        self._leave_out(event.deaf_s, event.at_s)
        commands: list[e.Command] = []
        for lease in self._all_leases():
            worker, task = self.workers[lease.worker], self.tasks[lease.task_id]
            if event.at_s - worker.heard_s > self.silence_s:
                why, code = f"{lease.worker} was silent for {event.at_s - worker.heard_s:.1f} s", "worker_lost"
            elif event.at_s - lease.granted_s > task.limit_s:
                why, code = f"over its limit of {task.limit_s:g} s on {lease.worker}", "timed_out"
            else:
                continue
            commands.append(e.Stop(lease.worker, lease.task_id, lease.attempt))
            commands += self._requeue(lease, event.at_s, why, code=code)
        commands += self._lose_patience(event.at_s)
        return commands + [one for kind in list(self.ready) for one in self._match(kind, event.at_s)]

    def _leave_out(self, deaf_s: float, at_s: float) -> None:
        """Silence, limits and patience count from later by the time in which we were deaf; never from the future."""
        for worker in self.workers.values():
            worker.heard_s = min(worker.heard_s + deaf_s, at_s)
        for lease in self._all_leases():
            lease.granted_s = min(lease.granted_s + deaf_s, at_s)
        for task in self.tasks.values():
            task.since_s = min(task.since_s + deaf_s, at_s)

    def _lose_patience(self, at_s: float) -> list[e.Command]:
        """End the tasks that have waited too long for a worker of their kind to appear."""
        served = {worker.kind for worker in self.workers.values()}
        waiting = [self.tasks[i] for kind, ids in self.ready.items() if kind not in served for i in ids]
        lost = [task for task in waiting if at_s - task.since_s > task.patience_s]
        return [command for task in lost for command in self._end(task, at_s, "no_worker")]

    def _match(self, kind: str, at_s: float) -> list[e.Command]:
        """Give ready tasks of a kind to the polls that have waited longest, a task of a group rather to a worker that
        waits, too, and has had that group; where none is ready, slow ones."""
        commands: list[e.Command] = []
        for poll in list(self.polls):
            while poll in self.polls and self._answers(poll, kind, at_s):
                worker = self.workers[self.polls[poll]]
                if len(self.held_by(worker.worker)) >= worker.slots:
                    del self.polls[poll]
                    commands.append(e.Release(poll))
                    break
                task = self._next(worker)
                to = self._had(task, poll, at_s) if task else poll
                task = task or self._slow(worker, at_s)
                if task is None:
                    break
                commands.append(self._grant(task, self.workers[self.polls.pop(to)], to, at_s))
        return commands

    def _answers(self, poll: int, kind: str, at_s: float) -> bool:
        """Whether a poll is that of a worker of this kind that is not silent."""
        worker = self.workers[self.polls[poll]]
        return worker.kind == kind and at_s - worker.heard_s <= self.silence_s

    def _had(self, task: TaskRecord, poll: int, at_s: float) -> int:
        """Of the polls that could take a task, the one whose worker has had fewest other groups since the
        task's; else the one given."""
        found, since = poll, GROUPS
        for other, name in self.polls.items():
            worker = self.workers[name]
            groups = worker.groups
            if task.group in groups[:since] and self._is_free(other, task.kind, at_s) and self._may(task, worker):
                found, since = other, groups.index(task.group)
        return found

    def _may(self, task: TaskRecord, worker: WorkerRecord) -> bool:
        """Whether a worker may have a task: it has not failed in it, or so has every other one that is listed."""
        failed = {one.worker for one in task.failures}
        return worker.worker not in failed or not any(
            other.kind == task.kind and name not in failed for name, other in self.workers.items()
        )

    def _is_free(self, poll: int, kind: str, at_s: float) -> bool:
        """Whether the worker of a poll could take a task of a kind."""
        worker = self.workers[self.polls[poll]]
        return self._answers(poll, kind, at_s) and len(self.held_by(worker.worker)) < worker.slots

    def _comes_back(self, task: TaskRecord, at_s: float) -> bool:
        """Whether the one worker that had a task's group has just delivered and not asked yet: whoever waited for its
        answer may ask us before it does."""
        had = {name: one for name, one in self.workers.items() if one.kind == task.kind and task.group in one.groups}
        if any(self.polls[poll] in had and self._is_free(poll, task.kind, at_s) for poll in self.polls):
            return False
        asks = set(self.polls.values())
        return any(
            at_s - one.delivered_s < BETWEEN_S and name not in asks and not self.held_by(name)
            for name, one in had.items()
        )

    def _next(self, worker: WorkerRecord) -> TaskRecord | None:
        """The task whose turn it is, taken out of its queue."""
        queue = self.ready.get(worker.kind)
        group = worker.groups[0] if worker.groups else ""
        task_id = queue.take(group, lambda one: self._may(self.tasks[one], worker)) if queue else None
        if task_id is None:
            return None
        self._take_out(self.tasks[task_id])
        return self.tasks[task_id]

    def _slow(self, worker: WorkerRecord, at_s: float) -> TaskRecord | None:
        """The task that has run longest of those that are slow, run once, and with another worker."""
        limit_s = self._durations.slow_after_s(worker.kind)
        if limit_s is None:
            return None
        slow = [
            lease
            for lease in self.leases.values()
            if self.tasks[lease.task_id].kind == worker.kind
            and at_s - lease.granted_s > limit_s
            and lease.worker != worker.worker
            and lease.task_id not in self.hedges
            and self._may(self.tasks[lease.task_id], worker)
        ]
        longest = min(slow, key=lambda lease: lease.granted_s, default=None)
        return self.tasks[longest.task_id] if longest else None

    def _grant(self, task: TaskRecord, worker: WorkerRecord, poll: int, at_s: float) -> e.Grant:
        task.attempt += 1
        if task.group:
            worker.groups = [task.group, *(group for group in worker.groups if group != task.group)][:GROUPS]
        lease = LeaseRecord(task.task_id, worker.worker, task.attempt, at_s)
        if task.task_id in self.leases:
            self.hedges[task.task_id] = lease
            self.counts["hedged"] += 1
            self._tell(task, at_s, f"attempt {task.attempt} hedged by {worker.worker}")
        else:
            self.leases[task.task_id] = lease
            self._tell(task, at_s, f"attempt {task.attempt} leased to {worker.worker}")
        return e.Grant(poll, worker.worker, task.task_id, task.attempt)

    def _fence(self, worker: str, task_id: str, attempt: int, epoch: str) -> str:
        """Why a delivery does not count, or an empty string where it does."""
        lease = self.leases.get(task_id)
        if epoch != self.epoch:
            return f"epoch {epoch} is over, this is {self.epoch}"
        if lease is None:
            return "the task has ended" if task_id not in self.tasks else "the task is not leased"
        if self._lease(task_id, worker, attempt) is None:
            return f"attempt {attempt} of {worker} is over, attempt {lease.attempt} is with {lease.worker}"
        return ""

    def _held(self, task_id: str, worker: str, attempt: int) -> LeaseRecord:
        """As `_lease`, where `_fence` found it to stand."""
        lease = self._lease(task_id, worker, attempt)
        assert lease is not None  # noqa: S101  # `_fence` looked
        return lease

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
        """Take a lease back; the task is ready again, or set aside when it has failed often enough.

        Where it was hedged, the other lease goes on alone, whatever came of this one.
        """
        other = self.hedges.pop(lease.task_id, None)
        if other is None:
            del self.leases[lease.task_id]
        elif other is not lease:
            self.leases[lease.task_id] = other
        task = self.tasks[lease.task_id]
        self._tell(task, at_s, f"attempt {lease.attempt}: {why}")
        if blame:
            task.failures.append(Failed(lease.attempt, lease.worker, why))
        if other is not None:
            return []
        if blame and len(task.failures) >= self.attempts:
            return self._end(task, at_s, code)
        self.counts["requeued"] += 1
        task.since_s = at_s
        self._make_ready(task)
        return self._match(task.kind, at_s)

    def _make_ready(self, task: TaskRecord) -> None:
        """Queue a task; one that comes back goes first, for it has waited longest."""
        queue = self.ready.setdefault(task.kind, Queue())
        queue.add(task.task_id, task.share, task.group, ahead=task.ahead, again=task.attempt > 0)

    def _take_out(self, task: TaskRecord) -> None:
        """Out of its queue, if it waits; an empty queue goes."""
        queue = self.ready.get(task.kind)
        if queue is not None:
            queue.discard(task.task_id)
            if not queue:
                del self.ready[task.kind]

    def _end(self, task: TaskRecord, at_s: float, code: str, winner: LeaseRecord | None = None) -> list[e.Command]:
        """The task is over; whoever else still works on it is told to stop."""
        self.tasks.pop(task.task_id)
        leases = (self.leases.pop(task.task_id, None), self.hedges.pop(task.task_id, None))
        others = [lease for lease in leases if lease is not None and lease is not winner]
        self._take_out(task)
        if code != "cancelled":
            self.counts["done" if code == "done" else "failed"] += 1
        self._tell(task, at_s, f"ended: {code}")
        self._stories[task.task_id] = task.story
        while len(self._stories) > STORIES:
            self._stories.popitem(last=False)
        history = tuple(f"attempt {one.attempt}: {one.why}" for one in task.failures)
        finish = e.Finish(task.task_id, code, history)  # type: ignore[arg-type]  # codes come from above
        return [*(e.Stop(lease.worker, lease.task_id, lease.attempt) for lease in others), finish]

    @staticmethod
    def _tell(task: TaskRecord, at_s: float, what: str) -> None:
        task.story.append(f"{at_s:.3f} {what}")
