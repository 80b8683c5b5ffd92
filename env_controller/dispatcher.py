"""The process around the dispatch core: messages become events, commands become answers.

One thread owns all state and takes everything from one bounded inbox. Questions of clients and polls of workers are
held open and answered when their time has come; a hold that is over is answered `Pending` or `Nothing`.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from uuid import uuid4

from env_controller import events as e
from env_controller.outcomes import Results, failure_of, other_release
from env_controller.scheduler import Scheduler
from luxloop import __version__
from luxloop import messages as m
from luxloop.bus import Asked, Bus, Event, Heard, Inbox, Presence
from luxloop.bus.frame import decode, encode, reframe
from luxloop.bus.keys import HOLD_S, at, last_part, name_of
from luxloop.errors import LuxloopError, RemoteError
from luxloop.settings import Settings
from luxloop.words import Words
from luxloop.worker import resident_mb

TICK_S = 0.25
ORPHAN_S = 30.0  # a task that nobody has asked about for so long is withdrawn
GONE_S = 60.0  # a worker not heard of for so long is taken off the list
FINAL = ("bad_input", "too_large", "unknown_effect", "version")  # failures that another attempt would not mend


@dataclass
class Wanted:
    """A task somebody waits for: the lease's contents, who holds a question open, when it was last asked for."""

    task: m.Task
    limit_s: float
    asked_s: float
    waiting: list[tuple[float, Asked]] = field(default_factory=list)


@dataclass
class Known:
    """A worker as it described itself and was last heard."""

    describe: m.Describe
    beat: m.Heartbeat | None = None
    heard_s: float = 0.0
    skew_s: float = 0.0


class Dispatcher:
    """The controller's process. `run` until the event is set."""

    def __init__(self, bus: Bus, settings: Settings) -> None:
        self._bus, self._settings = bus, settings
        self.epoch = uuid4().hex[:12]
        self.core = Scheduler(self.epoch, attempts=settings.attempts, silence_s=settings.silence_s)
        self._inbox = Inbox(4096)
        self._wanted: dict[str, Wanted] = {}
        self._polls: dict[int, tuple[float, Asked]] = {}
        self._workers: dict[str, Known] = {}
        self._results = Results(int(settings.keep_results_mb * 1e6))
        self._delivery: bytes = b""  # the frame that is being handled
        self._failure: m.Failure | None = None  # what the last failed attempt said
        self._poll_count = 0
        self._started_s = time.monotonic()

    def run(self, stop: threading.Event) -> None:
        """Serve until `stop` is set. Raises RemoteError where another controller already serves this realm."""
        realm = self._settings.realm
        if self._bus.present(at(realm, "alive", role="controller")):
            raise RemoteError(
                m.Failure(
                    code="refused",
                    message=f"a controller already serves the realm {realm!r} at {self._settings.router}",
                    mend="use it, stop it, or take another realm (LUXLOOP_REALM)",
                )
            )
        for row in ("submit", "withdraw", "status", "hello", "pull", "done"):
            self._bus.answer(at(realm, row), self._inbox)
        self._bus.subscribe(at(realm, "heartbeat"), self._inbox)
        self._bus.watch(at(realm, "alive", role="worker"), self._inbox)
        self._bus.announce(at(realm, "alive", role="controller", kind="controller", name=self.epoch))
        next_tick_s = 0.0
        while not stop.is_set():
            event = self._inbox.take(TICK_S)
            if event is not None:
                self.take(event)
            if time.monotonic() >= next_tick_s:
                self._tick()
                next_tick_s = time.monotonic() + TICK_S

    def take(self, event: Event) -> None:
        """Handle one thing that arrived; whatever is wrong with it is answered, and the controller goes on."""
        if isinstance(event, Presence):
            if not event.alive:
                name = last_part(event.key)
                self._workers.pop(name, None)
                self._perform(self.core.handle(e.Left(time.monotonic(), name)))
            return
        try:
            message = decode(event.frame).message
            if isinstance(event, Heard):
                self._hear(message)
            else:
                self._answer(event, message)
        except LuxloopError as error:
            if isinstance(event, Asked):
                failure = error.failure if isinstance(error, RemoteError) else m.Failure.of(error, "controller")
                event.reply(failure)

    def _answer(self, asked: Asked, message: Words) -> None:
        match message:
            case m.Submit():
                self._submit(asked, message)
            case m.Pull():
                self._pull(asked, message)
            case m.Done():
                self._done(asked, message)
            case m.Hello():
                self._hello(asked, message.describe)
            case m.Withdraw():
                self._withdraw(asked, message)
            case m.StatusAsked():
                asked.reply(self.status())
            case _:
                asked.reply(
                    m.Failure(
                        code="bad_input",
                        message=f"{type(message).__name__} is no question for the key {name_of(asked.key)}",
                        where="controller",
                    )
                )

    def _submit(self, asked: Asked, submit: m.Submit) -> None:
        task, now = submit.task, time.monotonic()
        finished = self._results.get(task.id)
        if finished is not None:
            asked.answer(finished)
            return
        if task.version != __version__:
            asked.reply(other_release(task.version))
            return
        if task.id not in self._wanted:
            if len(self._wanted) >= self._settings.queue_tasks:
                mend = "submit fewer at once, or set LUXLOOP_QUEUE_TASKS"
                asked.reply(m.Failure(code="busy", message="the queue is full", mend=mend, where="controller"))
                return
            self._wanted[task.id] = Wanted(task, submit.limit_s, now)
        wanted = self._wanted[task.id]
        wanted.asked_s = now
        wanted.waiting.append((now + HOLD_S, asked))
        self._perform(self.core.handle(e.Submitted(now, task.id, task.kind, submit.patience_s, submit.limit_s)))

    def _withdraw(self, asked: Asked, withdraw: m.Withdraw) -> None:
        """One asker takes back its wish; the task ends when nobody else holds a question open for it."""
        wanted = self._wanted.get(withdraw.task_id)
        others = len(wanted.waiting) - 1 if wanted else 0
        if wanted is not None and others <= 0:
            self._perform(self.core.handle(e.Withdrawn(time.monotonic(), withdraw.task_id)))
        reason = "" if wanted else "no such task is open"
        asked.reply(m.Receipt(accepted=wanted is not None, reason=reason))

    def _hello(self, asked: Asked, describe: m.Describe) -> None:
        if describe.version != __version__:
            asked.reply(other_release(describe.version))
            return
        now = time.monotonic()
        self._workers[describe.worker] = Known(describe, heard_s=now)
        self._perform(self.core.handle(e.Joined(now, describe.worker, describe.kind, describe.slots)))
        asked.reply(m.Welcome(epoch=self.epoch, version=__version__))

    def _pull(self, asked: Asked, pull: m.Pull) -> None:
        if pull.epoch != self.epoch:
            asked.reply(m.Failure(code="stale", message=f"epoch {pull.epoch} is over", mend="say hello again"))
            return
        poll = self._new_poll(asked)
        self._perform(self.core.handle(e.Polled(time.monotonic(), pull.worker, poll, pull.holding)))

    def _done(self, asked: Asked, done: m.Done) -> None:
        now = time.monotonic()
        if done.handed_back is not None:
            back = e.HandedBack(now, done.worker, done.handed_back, done.attempt, done.epoch)
            receipt = self._perform(self.core.handle(back))
            asked.reply(receipt)
            return
        outcome = done.outcome
        if outcome is None:
            asked.reply(m.Failure(code="bad_input", message="a delivery without an outcome", where="controller"))
            return
        self._delivery, self._failure = reframe(asked.frame, outcome), outcome.failure
        verdict = "done" if outcome.failure is None else "refused" if outcome.failure.code in FINAL else "crashed"
        reason = outcome.failure.text() if outcome.failure else ""
        receipt = self._perform(
            self.core.handle(
                e.Delivered(now, done.worker, outcome.task_id, done.attempt, done.epoch, verdict, reason)  # type: ignore[arg-type]  # one of the three literals above
            )
        )
        if done.wants_next and done.epoch == self.epoch:
            poll = self._new_poll(asked)
            for command in self.core.handle(e.Polled(time.monotonic(), done.worker, poll, hold=False)):
                if isinstance(command, e.Grant) and command.poll == poll:
                    receipt = receipt.model_copy(update={"next": self._lease(command)})
                elif not isinstance(command, (e.Release, e.Introduce)) or command.poll != poll:
                    self._perform([command])
            self._polls.pop(poll, None)
        asked.reply(receipt)

    def _hear(self, message: Words) -> None:
        if isinstance(message, m.Heartbeat) and message.worker in self._workers:
            known = self._workers[message.worker]
            known.beat, known.heard_s = message, time.monotonic()
            known.skew_s = time.time() - message.sent_unix_s
            self._perform(self.core.handle(e.Beat(known.heard_s, message.worker)))

    def _tick(self) -> None:
        now = time.monotonic()
        self._perform(self.core.handle(e.Tick(now)))
        for poll in [poll for poll, (until_s, _) in self._polls.items() if now > until_s]:
            self._perform(self.core.handle(e.PollOver(now, poll)))
        for task_id, wanted in list(self._wanted.items()):
            over = [asked for until_s, asked in wanted.waiting if now > until_s]
            wanted.waiting = [(until_s, asked) for until_s, asked in wanted.waiting if now <= until_s]
            for asked in over:
                asked.reply(self._pending(task_id))
            if not wanted.waiting and now - wanted.asked_s > HOLD_S + ORPHAN_S:
                self._perform(self.core.handle(e.Withdrawn(now, task_id)))
        for name in [name for name, known in self._workers.items() if now - known.heard_s > GONE_S]:
            del self._workers[name]
            self._perform(self.core.handle(e.Left(now, name, f"not heard of for {GONE_S:g} s")))

    def _perform(self, commands: list[e.Command]) -> m.Receipt:
        """Do what the core wants; the receipt is for the delivery among them, if there was one."""
        receipt = m.Receipt(accepted=False)
        for command in commands:
            match command:
                case e.Grant():
                    self._polls.pop(command.poll)[1].reply(self._lease(command))
                case e.Release():
                    self._polls.pop(command.poll)[1].reply(m.Nothing())
                case e.Introduce():
                    stale = m.Failure(code="stale", message="this worker is not known here", mend="say hello")
                    self._polls.pop(command.poll)[1].reply(stale)
                case e.Receive():
                    receipt = m.Receipt(accepted=command.accepted, reason=command.reason)
                case e.Stop():
                    self._cancel(command)
                case e.Finish():
                    self._finish(command)
        return receipt

    def _finish(self, finish: e.Finish) -> None:
        """Give the outcome to everybody who waits for it; keep a result for those who ask again."""
        wanted = self._wanted.pop(finish.task_id)
        if finish.code in ("done", "refused"):
            frame = self._delivery
            if finish.code == "done":
                self._results.put(finish.task_id, frame)
        else:
            frame = encode(
                m.Outcome(
                    task_id=finish.task_id,
                    failure=failure_of(finish, wanted.task.kind, wanted.limit_s, self._failure),
                )
            )
        for _, asked in wanted.waiting:
            asked.answer(frame)

    def _lease(self, grant: e.Grant) -> m.Lease:
        wanted = self._wanted[grant.task_id]
        return m.Lease(task=wanted.task, attempt=grant.attempt, epoch=self.epoch, limit_s=wanted.limit_s)

    def _cancel(self, stop: e.Stop) -> None:
        known = self._workers.get(stop.worker)
        if known is not None:
            key = at(self._settings.realm, "cancel", kind=known.describe.kind, worker=stop.worker)
            self._bus.publish(key, encode(m.Cancel(task_id=stop.task_id, attempt=stop.attempt)))

    def _pending(self, task_id: str) -> m.Pending:
        lease = self.core.leases.get(task_id)
        known = self._workers.get(lease.worker) if lease else None
        beat = known.beat if known and known.beat and known.beat.task_id == task_id else None
        return m.Pending(
            task_id=task_id,
            state="running" if lease else "queued",
            progress_ratio=beat.progress_ratio if beat else 0.0,
            note=beat.note if beat else "",
        )

    def _new_poll(self, asked: Asked) -> int:
        self._poll_count += 1
        self._polls[self._poll_count] = (time.monotonic() + HOLD_S, asked)
        return self._poll_count

    def status(self) -> m.Status:
        """How things stand."""
        now = time.monotonic()
        return m.Status(
            epoch=self.epoch,
            version=__version__,
            up_s=now - self._started_s,
            now_unix_s=time.time(),
            workers=tuple(self._worker_status(known, now) for known in self._workers.values()),
            queued={kind: len(ids) for kind, ids in self.core.ready.items()},
            running=len(self.core.leases),
            resident_mb=resident_mb(),
            **self.core.counts,
        )

    def _worker_status(self, known: Known, now: float) -> m.WorkerStatus:
        leases = self.core.held_by(known.describe.worker)
        record = self.core.workers.get(known.describe.worker)
        return m.WorkerStatus(
            describe=known.describe,
            task_id=leases[0].task_id if leases else "",
            attempt=leases[0].attempt if leases else 0,
            progress_ratio=known.beat.progress_ratio if known.beat and leases else 0.0,
            heard_s_ago=now - known.heard_s,
            clock_skew_s=known.skew_s,
            finished=record.finished if record else 0,
            resident_mb=known.beat.resident_mb if known.beat else 0.0,
        )
