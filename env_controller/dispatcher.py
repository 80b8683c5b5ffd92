"""The process around the dispatch core: messages become events, commands become answers.

One thread owns all state and takes everything from one bounded inbox. Questions of clients and polls of workers are
held open and answered when their time has come; a hold that is over is answered `Pending` or `Nothing`.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import NamedTuple
from uuid import uuid4

from env_controller import events as e
from env_controller.actions import Want
from env_controller.campaigns import Campaigns
from env_controller.outcomes import Results, failure_of, other_release, run_limit_s
from env_controller.roster import GONE_S, Roster
from env_controller.scheduler import Scheduler
from env_controller.soundness import sound
from env_controller.waiting import group_of
from luxloop import __version__
from luxloop import campaign as c
from luxloop import messages as m
from luxloop.bus import Asked, Bus, Event, Heard, Inbox, Presence
from luxloop.bus.frame import Array, Parcel, decode, encode, reframe
from luxloop.bus.keys import HOLD_S, KEYS, at, last_part, name_of
from luxloop.errors import InputError, LuxloopError, RemoteError, shortened
from luxloop.failure import Failure
from luxloop.process import resident_mb
from luxloop.settings import Settings
from luxloop.words import Words

log = logging.getLogger(__name__)

TICK_S = 0.25
DEAF_S = 1.0  # a tick that is later than this waited for our own thread: for a disk, or all of us stood still
MOST_FAILED_TICKS = 40  # in a row, ten seconds: nothing is looked after then, and who watches us begins us anew
WHY_CHARACTERS = 500  # kept of why an attempt crashed: a compiler's message has pages
ORPHAN_S = 30.0  # who has not asked again for so long has gone; a task that nobody else wants is withdrawn
QUESTIONS = ("submit", "withdraw", "status", "hello", "pull", "done", "begin", "act", "note", "end")
RUN_PATIENCE_S = float("inf")  # a run waits for a worker as long as it takes: a failure is a step of it for good
FINAL = ("bad_input", "too_large", "unknown_effect", "not_found", "version")  # another attempt would not mend these


class Waiting(NamedTuple):
    """A question that is held open: until when, by which asker."""

    until_s: float
    asker: str
    asked: Asked


@dataclass
class Wanted:
    """A task somebody waits for: the lease's contents, when each asker was last heard, who holds a question open."""

    task: m.Task
    limit_s: float
    heard_s: dict[str, float] = field(default_factory=dict)  # by asker, for HOLD_S + ORPHAN_S
    waiting: list[Waiting] = field(default_factory=list)
    by_runs: bool = False  # the environment-control agent wants it, too


class Dispatcher:
    """The controller's process. `run` until the event is set."""

    def __init__(self, bus: Bus, settings: Settings) -> None:
        self._bus, self._settings = bus, settings
        self.epoch = f"{time.time_ns() // 1000:015x}-{uuid4().hex[:6]}"  # later ones sort after earlier ones
        self.core = Scheduler(self.epoch, attempts=settings.attempts, silence_s=settings.silence_s)
        self._inbox = Inbox(4096)
        self._wanted: dict[str, Wanted] = {}
        self._polls: dict[int, tuple[float, Asked]] = {}
        self._roster = Roster()
        self._results = Results(int(settings.keep_results_mb * 1e6))
        self._delivery: bytes = b""  # the frame that is being handled
        self._failure: Failure | None = None  # what the last failed attempt said
        self._poll_count = 0
        self._campaigns = Campaigns(
            settings.runs_dir, self._want, self._unwant, lives=self._lives, later=self._inbox.offer
        )
        self._ended: deque[tuple[m.Task, bytes, bool]] = deque()  # what runs wanted, not yet told to them; if kept
        self._started_s = self._ticked_s = time.monotonic()

    def run(self, stop: threading.Event) -> None:
        """Serve until `stop` is set; whatever ends it, every journal is finished.

        Raises RemoteError where another controller already serves this realm, or a later one takes it over.
        """
        realm = self._settings.realm
        if self._bus.present(at(realm, "alive", role="controller")):
            raise RemoteError(
                Failure(
                    code="refused",
                    message=f"a controller already serves the realm {realm!r} at {self._settings.router}",
                    mend="use it, stop it, or take another realm (LUXLOOP_REALM)",
                )
            )
        for row in QUESTIONS:
            self._bus.answer(at(realm, row), self._inbox)
        self._bus.subscribe(at(realm, "heartbeat"), self._inbox)
        self._bus.watch(at(realm, "alive", role="worker"), self._inbox)
        self._bus.announce(at(realm, "alive", role="controller", kind="controller", name=self.epoch))
        self._bus.watch(at(realm, "alive", role="controller"), self._inbox)
        try:
            self._serve(stop)
        finally:
            self._campaigns.stop()

    def _serve(self, stop: threading.Event) -> None:
        next_tick_s, failed_ticks = 0.0, 0
        while not stop.is_set():
            event = self._inbox.take(TICK_S)
            if event is not None:
                self.take(event)
            if time.monotonic() >= next_tick_s:
                for _ in range(len(self._inbox)):  # a beat that lies in there ends a silence
                    if not stop.is_set() and (event := self._inbox.take(0.0)) is not None:
                        self.take(event)
                failed_ticks += 1
                with _going_on("a tick", last=failed_ticks == MOST_FAILED_TICKS):
                    self._tick()
                    failed_ticks = 0
                next_tick_s = time.monotonic() + TICK_S

    def take(self, event: Event) -> None:
        """Handle one thing that arrived; whatever is wrong with it is answered or logged, and the controller goes on.

        Raises RemoteError where a later controller has taken over.
        """
        if isinstance(event, Presence):
            self._give_way(event)
            with _going_on(event.key):
                self._notice(event)
        else:
            self._handle(event)
        with _going_on("what runs are told"):
            self._tell_runs()

    def _handle(self, event: Asked | Heard) -> None:
        try:
            parcel = _expected(event)
            self._refuse_another_kind(event.key, parcel.message)
            if isinstance(event, Heard):
                self._hear(parcel.message)
            else:
                self._answer(event, parcel)
        except LuxloopError as error:
            if isinstance(event, Asked):
                event.reply(error.failure if isinstance(error, RemoteError) else Failure.of(error, "controller"))
        except Exception as error:
            log.exception("a %s on %s could not be handled", type(event).__name__, event.key)
            if isinstance(event, Asked):
                event.reply(Failure.of(error, "controller"))

    def _give_way(self, presence: Presence) -> None:
        """Raises RemoteError where another controller's token appeared that began later: that one goes on."""
        name = last_part(presence.key)
        if "/alive/controller/" in presence.key and presence.alive and name > self.epoch:
            raise _taken_over(name)

    def _notice(self, presence: Presence) -> None:
        """A worker's token vanished."""
        name, kind = last_part(presence.key), presence.key.split("/")[-2]
        worker = "/alive/worker/" in presence.key
        if worker and not presence.alive and self._roster.kind_of(name) in (None, kind):
            blame = self._bus.connected()
            self._roster.strike(name)
            self._perform(self.core.handle(e.Left(time.monotonic(), name, blame=blame)))

    def _refuse_another_kind(self, key: str, message: Words) -> None:
        """Raises InputError where a message speaks for a worker of another kind than its key's.

        The router lets a role use the keys of its own kind only; a name inside a message is not seen there.
        """
        worker = message.describe.worker if isinstance(message, m.Hello) else getattr(message, "worker", None)
        kind = self._roster.kind_of(worker) if worker is not None else None
        if kind is not None and kind != key.split("/")[3]:
            raise InputError("worker", worker, f"a worker of the kind {key.split('/')[3]!r}, as its key says")

    def _answer(self, whole: Asked, parcel: Parcel) -> None:
        asked = replace(whole, frame=b"")  # what is held open keeps nothing of what was asked
        match message := parcel.message:
            case m.Submit():
                self._submit(asked, message)
            case m.Pull():
                self._pull(asked, message)
            case m.Done():
                self._done(whole, message, parcel.arrays)
            case m.Hello():
                self._hello(asked, message)
            case m.Withdraw():
                self._withdraw(asked, message)
            case c.Begin():
                self._campaigns.begin(whole, message)  # put once more when its journal was read
            case c.Action():
                self._campaigns.act(asked, message)
            case c.Note():
                self._campaigns.note(asked, message)
            case c.End():
                self._campaigns.end(asked, message)
            case _:
                asked.reply(self.status())

    def _submit(self, asked: Asked, submit: m.Submit) -> None:
        task, now = submit.task, time.monotonic()
        finished = self._kept(task.id, submit.asker, fresh=submit.fresh)
        if finished is not None:
            asked.answer(finished)
            return
        if task.version != __version__:
            asked.reply(other_release(task.version))
            return
        if task.id not in self._wanted:
            if len(self._wanted) >= self._settings.queue_tasks:
                mend = "submit fewer at once, or set LUXLOOP_QUEUE_TASKS"
                asked.reply(Failure(code="busy", message="the queue is full", mend=mend, where="controller"))
                return
            # refused here where it would be too large to hand out
            encode(m.Lease(task=task, attempt=10**9, epoch=self.epoch, limit_s=submit.limit_s))
            self._wanted[task.id] = Wanted(task, submit.limit_s)
        wanted = self._wanted[task.id]
        wanted.limit_s = max(wanted.limit_s, submit.limit_s)
        wanted.heard_s[submit.asker] = now
        wanted.waiting.append(Waiting(now + HOLD_S, submit.asker, asked))
        group = group_of(task)
        wish = e.Submitted(
            now, task.id, task.kind, submit.patience_s, submit.limit_s, share=submit.asker, group=group
        )
        self._perform(self.core.handle(wish))

    def _kept(self, task_id: str, asker: str, *, fresh: bool) -> bytes | None:
        """The outcome that is kept of a task; after a fresh wish nobody is given the old one any more."""
        if fresh:
            self._results.drop(task_id)
        return self._results.get(task_id, asker, time.monotonic())

    def _want(self, want: Want) -> None:
        """A run wants a task: as a client does, but that its outcome goes to the environment-control agent."""
        task, now, limit_s = want.task, time.monotonic(), run_limit_s(want.task)
        finished = self._kept(task.id, "", fresh=want.fresh)
        if finished is not None:
            self._ended.append((task, finished, True))
            return
        wanted = self._wanted.setdefault(task.id, Wanted(task, limit_s))
        wanted.limit_s, wanted.by_runs = max(wanted.limit_s, limit_s), True
        self._perform(
            self.core.handle(
                e.Submitted(now, task.id, task.kind, RUN_PATIENCE_S, limit_s, want.run, want.group, want.ahead)
            )
        )

    def _unwant(self, task_id: str) -> None:
        """No run wants the task any longer; it ends where no client does."""
        wanted = self._wanted.get(task_id)
        if wanted is not None:
            wanted.by_runs = False
            if not wanted.heard_s:
                self._perform(self.core.handle(e.Withdrawn(time.monotonic(), task_id)))

    def _lives(self, designer: str) -> bool:
        """Whether a designer's process is there; it is not given up while the router does not say."""
        try:
            return bool(self._bus.present(at(self._settings.realm, "alive", role="designer", name=designer)))
        except RemoteError:
            return True

    def _tell_runs(self) -> None:
        """Tell the runs what came of the tasks they wanted, which may make them want more."""
        while self._ended:
            task, frame, kept = self._ended.popleft()
            self._campaigns.ended(task, frame, kept=kept)

    def _withdraw(self, asked: Asked, withdraw: m.Withdraw) -> None:
        """One asker takes back its wish; the task ends when nobody else has been heard to want it.

        Who was told Pending a moment ago holds no question open, and is about to ask again.
        """
        wanted = self._wanted.get(withdraw.task_id)
        if wanted is None or wanted.heard_s.pop(withdraw.asker, None) is None:
            asked.reply(m.Receipt(accepted=False, reason="this asker does not wait for such a task"))
            return
        if not wanted.heard_s and not wanted.by_runs:
            self._perform(self.core.handle(e.Withdrawn(time.monotonic(), withdraw.task_id)))
        else:
            for waiting in [waiting for waiting in wanted.waiting if waiting.asker == withdraw.asker]:
                wanted.waiting.remove(waiting)
                waiting.asked.reply(Failure(code="cancelled", message="withdrawn by its asker"))
        asked.reply(m.Receipt(accepted=True))

    def _hello(self, asked: Asked, hello: m.Hello) -> None:
        describe, now = hello.describe, time.monotonic()
        if describe.version != __version__:
            asked.reply(other_release(describe.version))
            return
        self._roster.enter(describe, now)
        holding = tuple((held.task_id, held.attempt) for held in hello.holding if held.epoch == self.epoch)
        commands = self.core.handle(e.Joined(now, describe.worker, describe.kind, describe.slots, holding))
        old = [held for held in hello.holding if held.epoch != self.epoch]
        self._perform(commands + [e.Stop(describe.worker, held.task_id, held.attempt) for held in old])
        asked.reply(m.Welcome(epoch=self.epoch, version=__version__))

    def _pull(self, asked: Asked, pull: m.Pull) -> None:
        if pull.epoch != self.epoch:
            asked.reply(Failure(code="stale", message=f"epoch {pull.epoch} is over", mend="say hello again"))
            return
        poll = self._new_poll(asked)
        self._perform(self.core.handle(e.Polled(time.monotonic(), pull.worker, poll, pull.holding)))

    def _done(self, asked: Asked, done: m.Done, arrays: Mapping[str, Array]) -> None:
        now = time.monotonic()
        if done.handed_back is not None:
            back = e.HandedBack(now, done.worker, done.handed_back, done.attempt, done.epoch)
            receipt = self._perform(self.core.handle(back))
            asked.reply(receipt)
            return
        outcome = done.outcome
        if outcome is None:
            asked.reply(Failure(code="bad_input", message="a delivery without an outcome", where="controller"))
            return
        wanted = self._wanted.get(outcome.task_id)
        if wanted is not None and outcome.failure is None:
            outcome = sound(wanted.task, outcome, arrays)
        self._delivery, self._failure = reframe(asked.frame, outcome), outcome.failure
        verdict = "done" if outcome.failure is None else "refused" if outcome.failure.code in FINAL else "crashed"
        reason = shortened(outcome.failure.text(), WHY_CHARACTERS) if outcome.failure else ""
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
        if not isinstance(message, m.Heartbeat):
            return
        now = time.monotonic()
        if self._roster.hear(message, now):
            self._perform(self.core.handle(e.Beat(now, message.worker)))
        else:  # lost and back, or of before our own restart: it may hold something
            key = at(self._settings.realm, "cancel", kind=message.kind, worker=message.worker)
            self._bus.publish(key, encode(m.Introduce()))

    def _tick(self) -> None:
        now = time.monotonic()
        late_s, self._ticked_s = now - self._ticked_s - TICK_S, now
        deaf_s = late_s if late_s > DEAF_S else 0.0
        self._roster.leave_out(deaf_s, now)
        self._perform(self.core.handle(e.Tick(now, deaf_s)))
        for poll in [poll for poll, (until_s, _) in self._polls.items() if now > until_s]:
            self._perform(self.core.handle(e.PollOver(now, poll)))
        for task_id, wanted in list(self._wanted.items()):
            for waiting in [waiting for waiting in wanted.waiting if now > waiting.until_s]:
                wanted.waiting.remove(waiting)
                waiting.asked.reply(self._pending(task_id))
            for asker in [asker for asker, s in wanted.heard_s.items() if now - s > HOLD_S + ORPHAN_S]:
                del wanted.heard_s[asker]
            if not wanted.heard_s and not wanted.by_runs:
                self._perform(self.core.handle(e.Withdrawn(now, task_id)))
        self._tell_runs()
        self._campaigns.tick(now)
        for name in self._roster.unheard(now):
            self._roster.strike(name)
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
                    stale = Failure(code="stale", message="this worker is not known here", mend="say hello")
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
        wanted = self._wanted[finish.task_id]
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
        del self._wanted[finish.task_id]
        for waiting in wanted.waiting:
            waiting.asked.answer(frame)
        if wanted.by_runs:
            self._ended.append((wanted.task, frame, False))
        elif not wanted.waiting and finish.code not in ("done", "cancelled"):
            askers, now = wanted.heard_s.keys(), time.monotonic()  # it ended between two questions of its askers
            self._results.put(finish.task_id, frame, once=askers, until_s=now + ORPHAN_S)

    def _lease(self, grant: e.Grant) -> m.Lease:
        wanted = self._wanted[grant.task_id]
        return m.Lease(task=wanted.task, attempt=grant.attempt, epoch=self.epoch, limit_s=wanted.limit_s)

    def _cancel(self, stop: e.Stop) -> None:
        kind = self._roster.kind_of(stop.worker)
        if kind is not None:
            key = at(self._settings.realm, "cancel", kind=kind, worker=stop.worker)
            self._bus.publish(key, encode(m.Cancel(task_id=stop.task_id, attempt=stop.attempt)))

    def _pending(self, task_id: str) -> m.Pending:
        lease = self.core.leases.get(task_id)
        beat = self._roster.beat_about(lease.worker, task_id) if lease else None
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
            workers=self._roster.statuses(self.core, now),
            queued={kind: len(ids) for kind, ids in self.core.ready.items()},
            running=len(self.core.leases),
            resident_mb=resident_mb(),
            **self.core.counts,
        )


@contextmanager
def _going_on(what: str, *, last: bool = False) -> Iterator[None]:
    """What is wrong inside is logged, and ends nothing; the `last` time that it is borne it is raised."""
    try:
        yield
    except Exception:
        if last:
            raise
        log.exception("%s: something could not be handled", what)


def _expected(event: Asked | Heard) -> Parcel:
    """The message and its arrays, where it is the one that its key stands for and of the key's kind of worker.

    Only a delivery may have arrays.
    """
    parcel = decode(event.frame)
    message = parcel.message
    row = KEYS.get(name_of(event.key))
    if row is None or not isinstance(message, row.message):
        wanted = row.message.__name__ if row else "no message"
        raise InputError("message", type(message).__name__, f"{wanted} on the key {event.key}")
    if parcel.arrays and not isinstance(message, m.Done):
        raise InputError(
            "arrays", ", ".join(parcel.arrays), f"none with a {type(message).__name__}", "leave them out"
        )
    teller = message.task if isinstance(message, m.Submit) else getattr(message, "describe", message)
    kind = getattr(teller, "kind", None)
    if kind is not None and event.key.split("/")[3] != kind:
        raise InputError("kind", kind, f"{event.key.split('/')[3]}, as its key says")
    return parcel


def _taken_over(epoch: str) -> RemoteError:
    return RemoteError(
        Failure(code="refused", message=f"a later controller, epoch {epoch}, has taken over", mend="let it go on")
    )
