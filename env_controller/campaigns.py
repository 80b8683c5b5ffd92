"""The runs that are open: their journals, the questions of their lanes, and what the agent wants done.

A step is told to its designer once it is on the disk. All of it happens in the dispatcher's thread but for `done` of
a journal, which comes from the writer's: what both touch is guarded by a lock.
"""

from __future__ import annotations

import heapq
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from env_controller import actions as a
from env_controller.audit.machine import machine
from env_controller.environment import EnvironmentAgent
from env_controller.events import Command
from env_controller.notes import note_records
from env_controller.past import Reader, ended_before, never_begun, was_begun
from env_controller.trials import Past
from luxloop.bus import Asked
from luxloop.bus.frame import Array, decode, encode
from luxloop.bus.keys import HOLD_S
from luxloop.campaign import Action, Begin, Begun, Cut, End, Ended, Note, Step
from luxloop.errors import LuxloopError, RemoteError
from luxloop.failure import Code, Failure
from luxloop.journal.journal import Done, Journal
from luxloop.journal.topics import (
    Close,
    Record,
    log_record,
    map_record,
    opening,
    reply_record,
    request_record,
    step_record,
)
from luxloop.messages import Nothing, Outcome, Receipt, Task

log = logging.getLogger(__name__)

SILENT_S = 120.0  # a designer not heard of for so long has gone: its run is closed
FULL_S = 60.0  # a journal that has had no room for so long ends its run
BEST_MAPS = 100  # of a grid run, those whose maps are kept
FINISHED = 64  # runs whose end is told again to who asks again


class Result(NamedTuple):
    """A task that has ended."""

    task: Task
    outcome: Outcome
    arrays: Mapping[str, Array]


@dataclass
class LaneDoor:
    """What a lane's designer asked last, what it was told, and its open question."""

    action: Action
    told: bytes | None = None
    asked: Asked | None = None
    until_s: float = 0.0


class Unwritten(NamedTuple):
    """Records that the journal had no room for, since when, and whom to tell that they are on the disk."""

    records: list[Record]
    done: Done
    since_s: float


@dataclass
class OpenRun:
    """A run between its begin and its end."""

    begin: Begin
    journal: Journal
    heard_s: float
    lanes: dict[int, LaneDoor] = field(default_factory=dict)
    sequence: int = 0
    on_record: int = 0  # steps that its journal held when it was opened
    best: list[float] = field(default_factory=list)  # heap of a grid's best uniformities
    error: LuxloopError | None = None
    notes: set[int | None] = field(default_factory=set)  # numbers of those that were put
    unwritten: deque[Unwritten] = field(default_factory=deque)
    """In the order in which they are to be put; nothing goes past them."""


class Campaigns:
    """All runs of a controller. `want` and `unwant` submit and withdraw tasks; `ended` is told what came of them."""

    def __init__(
        self,
        folder: Path,
        want: Callable[[a.Want], None],
        unwant: Callable[[str], None],
        *,
        lives: Callable[[str], bool] = lambda _: True,
        later: Callable[[Asked], object] = lambda _: None,
    ) -> None:
        """`lives` says whether a designer does; `later` puts a question to the dispatcher once more."""
        self.agent = EnvironmentAgent()
        self._folder, self._want, self._unwant, self._lives = folder, want, unwant, lives
        self._reader = Reader(folder, later)
        self._runs: dict[str, OpenRun] = {}
        self._finished: dict[str, tuple[str, Ended]] = {}
        self._lock = threading.Lock()

    @property
    def runs(self) -> tuple[str, ...]:
        """The ids of the open runs."""
        return tuple(self._runs)

    def begin(self, asked: Asked, begin: Begin) -> None:
        """Open a run's journal, or go on with it. The same begin may be asked twice; a run has one designer."""
        name = begin.plan.run
        run = self._runs.get(name)
        if run is not None and not begin.same_run(run.begin):
            if not begin.resume or self._lives(run.begin.designer):
                owner = f"the run {name!r} is in use by the designer {run.begin.designer} (process id and a number)"
                raise _refused(owner, "end that one first, or take another id")
            self._close(name, _stopped(f"its designer {run.begin.designer} has gone"), lost=True)
            run = None
        if run is None:
            again = begin.resume or was_begun(self._folder / name, begin)
            past = self._reader.past(asked, begin) if again else self._new(begin)
            if past is None:  # being read: the question is put once more
                return
            run = self._opened(begin, past)
        folder = str((self._folder / name).resolve())
        asked.reply(Begun(run=name, folder=folder, segment=run.journal.number, steps=run.on_record))

    def _new(self, begin: Begin) -> Past:
        """No past; raises RemoteError where the run exists. One of which nothing was committed does not."""
        name = begin.plan.run
        if (self._folder / name).exists() and not never_begun(self._folder / name):
            mend = f"take another id, or go on with it: luxloop campaign resume {name}"
            raise _refused(f"the run {name!r} exists in {self._folder}", mend)
        return Past()

    def _opened(self, begin: Begin, past: Past) -> OpenRun:
        name, now_s = begin.plan.run, time.monotonic()
        facts, attachments = opening(begin)
        about = {"run": facts, "environment": machine()}
        journal = Journal(self._folder / name, about, attachments, mark=past.mark)
        best = heapq.nlargest(BEST_MAPS, (step.uniformity for step in past.steps.values()))[::-1]
        run = OpenRun(begin, journal, now_s, sequence=past.sequence, on_record=len(past.steps), best=best)
        self._runs[name] = run
        self.agent.handle(a.Opened(now_s, begin.plan, past))
        return run

    def act(self, asked: Asked, action: Action) -> None:
        """Carry out an action, or say again what came of it; the question is held until that is known."""
        run, now_s = self._open(action.run, action.designer), time.monotonic()
        if run.error is not None:
            raise run.error
        lane = run.lanes.get(action.lane)
        if lane is None or lane.action.number != action.number:
            commands = self.agent.handle(a.Acted(now_s, action))  # refuses what cannot be meant
            with self._lock:
                lane = run.lanes[action.lane] = LaneDoor(action)
            self._hold(lane, asked, now_s)
            self._perform(commands)
        elif lane.action != action:
            raise _refused(f"action {action.number} of lane {action.lane} was another one", "number actions once")
        else:
            self._hold(lane, asked, now_s)

    def note(self, asked: Asked, note: Note) -> None:
        """Put on record what a designer wants there, once; answered when it is on the disk."""
        run = self._open(note.run, note.designer)
        _catch_up(run)

        def done(error: LuxloopError | None) -> None:
            asked.reply(_failure(error) if error else Receipt(accepted=True))

        again = note.number is not None and note.number in run.notes
        run.journal.put([] if again else note_records(note, run.sequence, time.time_ns()), done)
        run.notes.add(note.number)

    def end(self, asked: Asked, end: End) -> None:
        """Finish a run's journal; records and root go back, once more to who asks again.

        A run that was closed for its designer's silence and opened again by it has not ended yet.
        """
        designer, ended = self._finished.get(end.run, ("", None))
        if designer != end.designer or end.run in self._runs:
            ended = None
        if ended is None and end.run not in self._runs:
            ended = ended_before(self._folder / end.run, end)
        if ended is None:
            _catch_up(self._open(end.run, end.designer))
            ended = self._close(end.run, Close(end.reason, end.complete))
        asked.reply(ended)

    def ended(self, task: Task, frame: bytes, *, kept: bool = False) -> None:
        """A task that was wanted here has ended, or had (`kept`); runs that cannot take its outcome are closed."""
        runs = self.agent.wanting(task.id)
        try:
            result = result_of(task, frame)
            outcome = result.outcome
            event = a.Ended(time.monotonic(), task.id, outcome.result, outcome.failure, outcome.compute_s, kept)
            self._perform(self.agent.handle(event), result)
        except Exception as error:
            log.exception("the runs %s could not take what came of the task %s", runs, task.id)
            why = f"what came of the task {task.id} could not be taken: {Failure.of(error).message}"
            for name in runs:
                self._close(name, _stopped(why[:1000]), lost=True, code="crashed")

    def tick(self, now_s: float) -> None:
        """Write what waits, let go of questions whose hold is over, and of runs that cannot go on.

        One that is silent and lives computes, or waits for a worker: a fit with Monte Carlo says nothing for minutes.
        """
        self._reader.tick(now_s)
        for name, run in list(self._runs.items()):
            _write(run)
            if run.unwritten and now_s - run.unwritten[0].since_s > FULL_S:
                self._close(name, _stopped(f"its journal had no room for {FULL_S:g} s"), lost=True)
                continue
            with self._lock:
                for lane in run.lanes.values():
                    if lane.asked is not None and now_s > lane.until_s:
                        lane.asked.reply(Nothing())
                        lane.asked = None
                waited_for = any(lane.asked is not None for lane in run.lanes.values())
            silent_s = 0.0 if waited_for else now_s - run.heard_s
            if silent_s > SILENT_S and not self._lives(run.begin.designer):
                silent = f"nothing heard of its designer {run.begin.designer} for {SILENT_S:g} s"
                self._close(name, _stopped(silent), lost=True)

    def stop(self) -> None:
        """The controller ends: every journal is finished. Designers wait for the next one, which goes on."""
        for name in list(self._runs):
            self._close(name, _stopped("the controller was stopped"), lost=True, code="not_found")

    def _open(self, name: str, designer: str) -> OpenRun:
        run = self._runs.get(name)
        if run is None:
            message = f"no run {name!r} is open at this controller"
            raise RemoteError(Failure(code="not_found", message=message, mend="begin it first", where="controller"))
        if run.begin.designer != designer:
            raise _refused(f"the run {name!r} is in use by {run.begin.designer}", "one designer at a time")
        run.heard_s = time.monotonic()
        return run

    def _hold(self, lane: LaneDoor, asked: Asked, now_s: float) -> None:
        """Keep the question until its step is known; an older one on the same action is let go."""
        with self._lock:
            if lane.told is not None:
                asked.answer(lane.told)
                return
            if lane.asked is not None:
                lane.asked.reply(Nothing())
            lane.asked, lane.until_s = asked, now_s + HOLD_S

    def _perform(self, commands: list[Command], result: Result | None = None) -> None:
        """Do what the agent wants; what goes on one run's record becomes durable together."""
        records: dict[str, list[Record]] = {}
        steps: dict[str, list[Step]] = {}
        for command in commands:
            match command:
                case a.Want():
                    self._want(command)
                case a.Unwant():
                    self._unwant(command.task_id)
                case a.Again():
                    with self._lock:
                        self._answer(self._runs[command.step.run].lanes[command.step.lane], None, command.step)
                case a.Record() if result is not None:
                    run = self._runs[command.run]
                    records.setdefault(command.run, []).extend(_of_task(result, run.sequence))
                case a.Tell():
                    name, run = command.step.run, self._runs[command.step.run]
                    of_run = records.setdefault(name, [])
                    step = _with_cut(command.step, result)
                    if result is not None and self._map_wanted(run, command.step, result.task.id):
                        of_run.append(map_record(result.arrays["map_lx"], run.sequence, time.time_ns()))
                    of_run.append(step_record(step, run.sequence, time.time_ns()))
                    agent = run.lanes[command.step.lane].action.agent
                    if agent is not None:
                        note = Note(run=name, designer=run.begin.designer, agent=agent)
                        of_run.extend(note_records(note, run.sequence, time.time_ns()))
                    steps.setdefault(name, []).append(step)
                    run.sequence += 1
        for name, of_run in records.items():
            self._commit(self._runs[name], of_run, steps.get(name, []))

    @staticmethod
    def _map_wanted(run: OpenRun, step: Step, task_id: str) -> bool:
        """Of the steps that come of this task, every one's where the plan says so; of a grid the best so far."""
        if step.task_id != task_id or step.failure is not None or not step.feasible:
            return False
        if run.begin.plan.maps or step.final:
            return True
        if run.begin.plan.kind != "grid":
            return False
        heapq.heappush(run.best, step.uniformity)
        return len(run.best) <= BEST_MAPS or heapq.heappop(run.best) < step.uniformity

    def _commit(self, run: OpenRun, records: list[Record], steps: list[Step]) -> None:
        lanes = [run.lanes[step.lane] for step in steps]  # a lane's next action may come before `done`

        def done(error: LuxloopError | None) -> None:
            with self._lock:
                run.error = run.error or error
                for lane, step in zip(lanes, steps, strict=True):
                    self._answer(lane, error, step)

        run.unwritten.append(Unwritten(records, done, time.monotonic()))
        _write(run)

    def _let_go(self, run: OpenRun, failure: Failure) -> None:
        """Tell who waits in a run's lanes that nothing comes any more."""
        with self._lock:
            for lane in run.lanes.values():
                if lane.asked is not None:
                    lane.asked.reply(failure)
                    lane.asked = None

    @staticmethod
    def _answer(lane: LaneDoor, error: LuxloopError | None, step: Step) -> None:
        """Tell the step to who waits, or to who asks next."""
        frame = encode(_failure(error) if error else step)
        if error is None:
            lane.told = frame
        if lane.asked is not None:
            lane.asked.answer(frame)
            lane.asked = None

    def _close(self, name: str, close: Close, *, lost: bool = False, code: Code = "refused") -> Ended:
        """End a run: nothing more is computed for it, its journal is finished; who waits is told so with `code`.

        That is last, for another controller may open the run from then on.
        """
        run = self._runs.pop(name)
        self._perform(self.agent.handle(a.Closed(time.monotonic(), name)))
        _write(run)
        try:
            run.journal.put([log_record(close.line, run.sequence, time.time_ns())], lambda _: None)
            mark = run.journal.finish()
        except LuxloopError:
            if not lost:
                raise
            mark = None
        finally:
            run.journal.close()
            message, mend = f"the run {name!r} is closed, {close.line}", f"luxloop campaign resume {name}"
            self._let_go(run, Failure(code=code, message=message, mend=mend, where="controller"))
        ended = Ended(run=name, records=mark.records if mark else 0, root=mark.root if mark else "0" * 64,
                      folder=str((self._folder / name).resolve()))  # fmt: skip
        self._finished[name] = run.begin.designer, ended
        while len(self._finished) > FINISHED:
            del self._finished[next(iter(self._finished))]
        return ended


def _write(run: OpenRun) -> None:
    """Have the journal take what waits for it, in order; what it has no room for goes on waiting."""
    while run.unwritten:
        records, done, _ = run.unwritten[0]
        try:
            run.journal.put(records, done)
        except LuxloopError as error:
            if _failure(error).code == "busy":
                return
            done(error)
        run.unwritten.popleft()


def _catch_up(run: OpenRun) -> None:
    """Raises RemoteError busy where the journal has no room yet for what must go before that which comes now."""
    _write(run)
    if run.unwritten:
        message = f"too much waits for the disk of {run.journal.folder}"
        raise RemoteError(Failure(code="busy", message=message, mend="try again later", where="controller"))


def result_of(task: Task, frame: bytes) -> Result:
    """A task's outcome frame, decoded; arrays that went by hash are left out."""
    parcel = decode(frame)
    return Result(task, parcel.expect(Outcome), parcel.arrays)


def _of_task(result: Result, sequence: int) -> list[Record]:
    now_ns = time.time_ns()
    request = request_record(result.task, sequence, now_ns)
    return [request, reply_record(result.task.kind, result.outcome, result.arrays, sequence, now_ns)]


def _with_cut(step: Step, result: Result | None) -> Step:
    """A finalist's step with the line of Eq. 8, where its rays have just ended."""
    names = ("cut_x_um", "cut_lx", "cut_error_lx")
    if not step.final or result is None or not all(name in result.arrays for name in names):
        return step
    x_um, lx, error_lx = (tuple(map(float, result.arrays[name])) for name in names)
    return step.model_copy(update={"cut": Cut(x_um=x_um, illuminance_lx=lx, illuminance_error_lx=error_lx)})


def _stopped(reason: str) -> Close:
    return Close(reason, complete=False)


def _failure(error: LuxloopError) -> Failure:
    return error.failure if isinstance(error, RemoteError) else Failure.of(error, "controller")


def _refused(message: str, mend: str) -> RemoteError:
    return RemoteError(Failure(code="refused", message=message, mend=mend, where="controller"))
