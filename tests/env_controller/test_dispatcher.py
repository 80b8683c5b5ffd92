"""The process around the core, driven message by message in one thread: askers, workers, strangers, rivals."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

from env_controller.actions import Want
from env_controller.dispatcher import ORPHAN_S, Dispatcher
from env_controller.outcomes import RUN_LIMIT_S
from luxloop import __version__
from luxloop.bus import Event, Heard, Presence
from luxloop.bus.frame import HEADER_BYTES, decode, encode
from luxloop.bus.keys import HOLD_S, at
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.messages import (
    Cancel,
    Describe,
    Done,
    Heartbeat,
    Held,
    Hello,
    Introduce,
    Lease,
    Nothing,
    Outcome,
    Pending,
    Pull,
    Receipt,
    Status,
    StatusAsked,
    Submit,
    Task,
    Welcome,
    Withdraw,
)
from luxloop.settings import Settings
from luxloop.words import Words
from tests.env_controller.desk import Question
from tests.local_bus import LocalBus, LocalRouter

TASK = Task(kind="film", inputs={"pairs": 4.5}, version=__version__)
OTHER = Task(kind="film", inputs={"pairs": 5.0}, version=__version__)


class Desk:
    """A controller whose inbox we are, on a clock that we set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **changes: Any) -> None:
        self.now = 1000.0
        monkeypatch.setattr("env_controller.dispatcher.time.monotonic", lambda: self.now)
        self.bus = LocalBus(LocalRouter())
        self.told: list[tuple[str, Words]] = []
        monkeypatch.setattr(self.bus, "publish", lambda key, frame: self.told.append((key, decode(frame).message)))
        self.controller = Dispatcher(self.bus, Settings(**changes))

    def put(self, row: str, message: Words | bytes, kind: str = "film") -> Question:
        """Put a question and return it."""
        frame = message if isinstance(message, bytes) else encode(message)
        question = Question(at("luxloop", row, kind=kind), frame)
        self.take(question.asked)
        return question

    def take(self, event: Event) -> None:
        self.controller.take(event)

    def wait(self, s: float) -> None:
        """Let time pass, a tick every quarter of a second."""
        for _ in range(int(s / 0.25)):
            self.now += 0.25
            self.controller._tick()

    def submit(self, task: Task = TASK, asker: str = "me", **options: Any) -> Question:
        return self.put("submit", Submit(task=task, asker=asker, **options))

    def hello(self, worker: str = "w1", *holding: Held) -> Question:
        describe = Describe(worker=worker, kind="film", version=__version__, host="h", pid=1)
        return self.put("hello", Hello(describe=describe, holding=holding))

    def pull(self, worker: str = "w1") -> Question:
        return self.put("pull", Pull(worker=worker, kind="film", epoch=self.controller.epoch))

    def done(self, worker: str = "w1", task: Task = TASK, attempt: int = 1, **outcome: Any) -> Question:
        outcome = outcome or {"result": {"R": 0.5}}
        done = Done(
            worker=worker,
            kind="film",
            attempt=attempt,
            epoch=self.controller.epoch,
            outcome=Outcome(task_id=task.id, **outcome),
        )
        return self.put("done", done)

    def beat(self, worker: str = "w1") -> None:
        self.take(
            Heard(
                at("luxloop", "heartbeat", kind="film", worker=worker), encode(Heartbeat(worker=worker, kind="film"))
            )
        )

    def status(self) -> Status:
        message = self.put("status", StatusAsked()).message
        assert isinstance(message, Status)
        return message


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch) -> Desk:
    """A controller with nobody at it."""
    return Desk(monkeypatch)


def test_a_task_goes_round(desk: Desk) -> None:
    """Hello, pull, submit, lease, done, outcome: each question is answered once, in that order."""
    assert isinstance(desk.hello().message, Welcome)
    pull, submit = desk.pull(), desk.submit()
    assert isinstance(pull.message, Lease)
    assert submit.message is None
    assert desk.done().message == Receipt(accepted=True)
    assert isinstance(submit.message, Outcome)
    assert submit.message.result == {"R": 0.5}
    assert desk.submit(asker="another").message == submit.message


def test_predictions_about_one_anchor_go_to_the_worker_that_has_it(desk: Desk) -> None:
    """Though another has waited longer."""

    def asked(pairs: float) -> Task:
        inputs = {"shots": [{"pairs": pairs}], "anchor": {"histories": 1000, "shots": [{"pairs": 5.0}]}}
        return Task(kind="film", inputs=inputs, version=__version__)

    for worker in ("w1", "w2"):
        desk.hello(worker)
        desk.pull(worker)
    desk.submit(asked(5.0))
    desk.done("w1", asked(5.0))
    waits = desk.pull("w1")
    desk.submit(asked(5.1))
    assert isinstance(waits.message, Lease)


def test_the_longest_limit_that_was_asked_for_counts(desk: Desk) -> None:
    """A run wants for an hour what a client has asked for with 10 s; an impatient third one changes nothing."""
    desk.submit(limit_s=10.0)
    desk.controller._want(Want("one", TASK))
    desk.submit(asker="third", limit_s=1.0)
    desk.hello()
    lease = desk.pull().message
    assert isinstance(lease, Lease)
    assert lease.limit_s == RUN_LIMIT_S
    other = desk.submit(OTHER, limit_s=10.0)
    desk.submit(OTHER, asker="another", limit_s=20.0)
    desk.hello("w2")
    second = desk.pull("w2").message
    assert isinstance(second, Lease)
    assert (second.limit_s, other.message) == (20.0, None)


def test_a_fresh_wish_is_computed_again(desk: Desk) -> None:
    """A finished result is not given to one who asks for a fresh computation."""
    desk.hello()
    desk.submit()
    desk.pull()
    desk.done()
    again = desk.submit(fresh=True)
    assert again.message is None
    assert isinstance(desk.pull().message, Lease)


def test_while_it_is_computed_again_nobody_is_given_the_old_result(desk: Desk) -> None:
    """Not who asks without `fresh`, nor a run: what the old one speaks of, a film's table, may have gone."""
    desk.hello()
    desk.submit()
    desk.pull()
    desk.done()
    desk.pull()
    desk.controller._want(Want("one", TASK, fresh=True))
    plain = desk.submit()
    desk.controller._want(Want("two", TASK))
    assert plain.message is None
    assert not desk.controller._ended
    desk.done(result={"R": 0.6})
    assert isinstance(plain.message, Outcome)
    assert plain.message.result == {"R": 0.6}


def test_holds_end_with_a_word(desk: Desk) -> None:
    """After the hold a submitter hears Pending, a worker Nothing; nobody is left to a time-out."""
    for worker in ("w1", "w2"):
        desk.hello(worker)
    submit = desk.submit()
    assert isinstance(desk.pull("w1").message, Lease)
    pull = desk.pull("w2")
    for _ in range(int(HOLD_S) + 1):
        desk.wait(1.0)
        desk.beat("w1")
        desk.beat("w2")
    assert isinstance(submit.message, Pending)
    assert submit.message.state == "running"
    assert isinstance(pull.message, Nothing)


class TestWithdrawing:
    """One asker's wish is its own."""

    def test_a_stranger_cannot_withdraw(self, desk: Desk) -> None:
        """Who does not wait for the task has nothing to take back."""
        submit = desk.submit()
        receipt = desk.put("withdraw", Withdraw(task_id=TASK.id, asker="stranger")).message
        assert isinstance(receipt, Receipt)
        assert not receipt.accepted
        assert submit.message is None

    def test_two_askers_one_leaves(self, desk: Desk) -> None:
        """The one who leaves is told so, the other gets the result."""
        desk.hello()
        mine, theirs = desk.submit(), desk.submit(asker="them")
        desk.pull()
        assert desk.put("withdraw", Withdraw(task_id=TASK.id, asker="me")).message == Receipt(accepted=True)
        assert isinstance(mine.message, Failure)
        assert mine.message.code == "cancelled"
        assert theirs.message is None
        desk.done()
        assert isinstance(theirs.message, Outcome)

    def test_the_last_one_ends_the_task(self, desk: Desk) -> None:
        """Nobody waits: the worker is told to stop, and its result comes too late."""
        desk.hello()
        submit = desk.submit()
        desk.pull()
        desk.put("withdraw", Withdraw(task_id=TASK.id, asker="me"))
        assert isinstance(submit.message, Outcome)
        assert submit.message.failure is not None
        assert submit.message.failure.code == "cancelled"
        cancel = at("luxloop", "cancel", kind="film", worker="w1")
        assert desk.told == [(cancel, Cancel(task_id=TASK.id, attempt=1))]
        late = desk.done().message
        assert isinstance(late, Receipt)
        assert not late.accepted

    def test_one_who_is_about_to_ask_again_still_waits(self, desk: Desk) -> None:
        """Told Pending a moment ago it holds no question open; the other's leaving does not stop its computation."""
        desk.hello()
        first = desk.submit()
        desk.pull()
        desk.wait(HOLD_S + 0.5)
        assert isinstance(first.message, Pending)
        desk.hello()  # and a token: it is not silent
        theirs = desk.submit(asker="them")
        assert desk.put("withdraw", Withdraw(task_id=TASK.id, asker="them")).message == Receipt(accepted=True)
        assert isinstance(theirs.message, Failure)
        assert desk.told == []
        again = desk.submit()
        desk.done()
        assert isinstance(again.message, Outcome)
        assert again.message.failure is None

    def test_a_run_that_no_longer_wants_it_leaves_it_to_who_is_about_to_ask_again(self, desk: Desk) -> None:
        """The run is closed between two questions of a client."""
        desk.hello()
        desk.submit()
        desk.controller._want(Want("one", TASK))
        desk.pull()
        desk.wait(HOLD_S + 0.5)
        desk.controller._unwant(TASK.id)
        assert desk.told == []
        desk.wait(ORPHAN_S + 0.5)
        assert TASK.id not in desk.controller.core.tasks  # nor does the client any more

    def test_one_may_leave_between_two_questions(self, desk: Desk) -> None:
        """Told Pending it does not ask again, but takes its wish back: the task ends."""
        desk.hello()
        desk.submit()
        desk.pull()
        desk.wait(HOLD_S + 0.5)
        assert desk.put("withdraw", Withdraw(task_id=TASK.id, asker="me")).message == Receipt(accepted=True)
        assert isinstance(desk.told[-1][1], Cancel)

    def test_a_task_nobody_asks_about_is_dropped(self, desk: Desk) -> None:
        """A client that was killed does not come back: its task does not wait for ever."""
        desk.hello()
        desk.submit(patience_s=3600.0)
        desk.wait(HOLD_S + ORPHAN_S / 2)
        assert desk.status().queued == {"film": 1}
        desk.wait(ORPHAN_S)
        assert desk.status().queued == {}


def test_what_ends_between_two_questions_is_kept_for_the_next(desk: Desk) -> None:
    """The hold was over, then the task failed: the asker's next question gets that failure, once."""
    desk.hello()
    first = desk.submit()
    desk.pull()
    desk.wait(HOLD_S + 0.5)
    assert isinstance(first.message, Pending)
    desk.hello()  # back with empty hands
    lease = desk.pull().message
    assert isinstance(lease, Lease)
    failure = Failure(code="bad_input", message="thickness_nm: negative")
    desk.done(attempt=lease.attempt, failure=failure)
    second = desk.submit().message
    assert isinstance(second, Outcome)
    assert second.failure == failure
    assert desk.submit().message is None  # and then it is a new wish


class TestComingBack:
    """A worker we do not know (any more) beats: it is asked who it is and what it holds."""

    def test_an_unknown_worker_is_asked_to_introduce_itself(self, desk: Desk) -> None:
        """One Introduce on its own key; a known one hears nothing."""
        desk.beat()
        assert desk.told == [(at("luxloop", "cancel", kind="film", worker="w1"), Introduce())]
        desk.told.clear()
        desk.hello()
        desk.beat()
        assert desk.told == []

    def test_it_goes_on_with_its_attempt(self, desk: Desk) -> None:
        """Lost with its token and back with the attempt in hand: the first attempt's result counts."""
        desk.hello()
        submit = desk.submit()
        desk.pull()
        desk.take(Presence(at("luxloop", "alive", role="worker", kind="film", name="w1"), alive=False))
        assert desk.status().queued == {"film": 1}
        desk.hello("w1", Held(task_id=TASK.id, attempt=1, epoch=desk.controller.epoch))
        assert desk.status().running == 1
        assert desk.done().message == Receipt(accepted=True)
        assert isinstance(submit.message, Outcome)
        assert submit.message.failure is None

    def test_what_it_holds_of_an_earlier_controller_is_stopped(self, desk: Desk) -> None:
        """An attempt of another epoch is nobody's: the worker is told to drop it."""
        desk.hello("w1", Held(task_id=TASK.id, attempt=4, epoch="earlier"))
        assert desk.told == [(at("luxloop", "cancel", kind="film", worker="w1"), Cancel(task_id=TASK.id, attempt=4))]

    def test_our_own_lost_link_is_nobody_s_fault(self, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
        """While we have no router every token vanishes: more such losses than attempts do not fail the task."""
        monkeypatch.setattr(desk.bus, "connected", lambda: False)
        submit = desk.submit()
        for _ in range(5):
            desk.hello()
            assert isinstance(desk.pull().message, Lease)
            desk.take(Presence(at("luxloop", "alive", role="worker", kind="film", name="w1"), alive=False))
        assert submit.message is None
        assert desk.status().queued == {"film": 1}


def test_a_large_set_can_be_asked_how_it_stands(desk: Desk) -> None:
    """What its workers can do, 25 kB each, is left out: a status of a hundred of them is one frame."""
    catalogue = {"effects": ["x" * 25_000]}
    for number in range(100):
        one = Describe(worker=f"w{number}", kind="film", version=__version__, host="h", pid=1, catalogue=catalogue)
        desk.put("hello", Hello(describe=one))
    assert len(desk.status().workers) == 100


class TestHostile:
    """Whatever is put is answered once with a typed failure; the controller goes on."""

    @pytest.mark.parametrize(
        ("row", "message", "field"),
        [
            ("submit", Heartbeat(worker="w", kind="film"), "message"),
            ("status", Submit(task=TASK, asker="me"), "message"),
            ("submit", Submit(task=Task(kind="ray", inputs={}, version=__version__), asker="me"), "kind"),
            ("pull", Pull(worker="w1", kind="ray", epoch="e"), "kind"),
            ("submit", b"", "frame"),
            ("submit", b"LXL1" + b"\xff" * 40, "frame"),
        ],
    )
    def test_a_message_that_does_not_belong(self, desk: Desk, row: str, message: Words | bytes, field: str) -> None:
        """The wrong message, or the wrong kind of worker, for its key."""
        failure = desk.put(row, message).message
        assert isinstance(failure, Failure)
        assert (failure.code, failure.field) == ("bad_input", field)
        assert desk.status().running == 0

    @pytest.mark.parametrize(
        ("row", "message"), [("submit", Submit(task=TASK, asker="me")), ("status", StatusAsked())]
    )
    def test_arrays_that_nobody_asked_for(self, desk: Desk, row: str, message: Words) -> None:
        """Only a delivery has any; up to 16 MB of them would be held with the question."""
        failure = desk.put(row, encode(message, {"map_lx": np.ones(9)})).message
        assert isinstance(failure, Failure)
        assert (failure.code, failure.field) == ("bad_input", "arrays")
        assert desk.status().queued == {}

    def test_a_question_that_is_held_keeps_no_frame(self, desk: Desk) -> None:
        """Of what was asked the controller keeps the task, and how to answer."""
        desk.hello()
        desk.pull()
        for asker in ("me", "them"):
            desk.submit(asker=asker)
        desk.hello("w2")
        desk.pull("w2")
        held = [one.asked for wanted in desk.controller._wanted.values() for one in wanted.waiting]
        held += [asked for _, asked in desk.controller._polls.values()]
        assert [asked.frame for asked in held] == [b""] * 3

    def test_a_key_that_is_none_of_ours(self, desk: Desk) -> None:
        """Any key, however short."""
        question = Question("x", encode(StatusAsked()))
        desk.take(question.asked)
        assert isinstance(question.message, Failure)

    def test_a_task_too_large_to_hand_out_is_refused_at_once(self, desk: Desk) -> None:
        """A request that fits its own frame but not the lease's never enters the queue."""
        size = HEADER_BYTES
        while True:  # the largest submission that can be encoded
            task = Task(kind="film", inputs={"x": "y" * size}, version=__version__)
            try:
                frame = encode(Submit(task=task, asker="a"))
                break
            except ValueError:
                size -= 1
        failure = desk.put("submit", frame).message
        assert isinstance(failure, Failure)
        assert desk.status().queued == {}

    def test_a_full_queue_says_busy(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Above the bound the asker is told to come again, and the mend names the setting."""
        desk = Desk(monkeypatch, queue_tasks=1)
        desk.submit()
        failure = desk.submit(OTHER).message
        assert isinstance(failure, Failure)
        assert failure.code == "busy"
        assert "LUXLOOP_QUEUE_TASKS" in failure.mend
        assert desk.submit(asker="another").message is None  # the same task is no second one


class TestGoingOn:
    """What nobody foresaw is told to its asker, or logged; the controller goes on."""

    @pytest.mark.parametrize("last", ["crashed", "worker_lost", "gone"])
    def test_a_crash_of_many_words_is_told_in_fewer(self, monkeypatch: pytest.MonkeyPatch, last: str) -> None:
        """A compiler may write pages: the third attempt crashes too, falls silent, or loses its worker."""
        desk = Desk(monkeypatch, silence_s=3.0)
        submit = desk.submit()
        desk.hello()
        for attempt in (1, 2, 3):
            desk.pull()
            if attempt < 3 or last == "crashed":
                desk.done(attempt=attempt, failure=Failure.of(RuntimeError("x" * 5000), "w1"))
        if last == "gone":
            desk.take(Presence(at("luxloop", "alive", role="worker", kind="film", name="w1"), alive=False))
        desk.wait(4.0 if last == "worker_lost" else 0.25)
        assert isinstance(submit.message, Outcome)
        failure = submit.message.failure
        assert failure is not None
        assert failure.code == ("crashed" if last == "crashed" else "worker_lost")
        assert len(failure.history) == 3
        assert max(map(len, failure.history)) < 600
        assert max(map(len, desk.controller.core.story(TASK.id))) < 600

    def test_a_tick_that_fails_is_not_the_last(self, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
        """The second one, a moment later, is as any other."""
        ticks, stop = [], threading.Event()

        def tick(now_s: float) -> None:
            ticks.append(now_s)
            if len(ticks) == 2:
                stop.set()
            raise RuntimeError("no room")

        monkeypatch.setattr(desk.controller._campaigns, "tick", tick)
        monkeypatch.setattr("env_controller.dispatcher.TICK_S", 0.0)
        desk.controller._serve(stop)
        assert len(ticks) == 2

    def test_a_token_that_cannot_be_looked_up_ends_nothing(
        self, desk: Desk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        """It is logged; the task goes elsewhere once its worker is silent."""
        desk.hello()
        desk.submit()
        desk.pull()
        with monkeypatch.context() as broken:
            broken.setattr(desk.bus, "connected", lambda: 1 // 0)
            desk.take(Presence(at("luxloop", "alive", role="worker", kind="film", name="w1"), alive=False))
        assert "ZeroDivisionError" in caplog.text
        desk.wait(10.0)
        assert desk.status().queued == {"film": 1}


def test_a_later_controller_takes_over(desk: Desk) -> None:
    """Two controllers on one realm: the earlier one ends, the later one is not moved by the earlier."""
    other = at("luxloop", "alive", role="controller", kind="controller", name="")
    desk.take(Presence(other + "0", alive=True))
    desk.take(Presence(other + "z", alive=False))
    desk.take(Presence(other + desk.controller.epoch, alive=True))
    with pytest.raises(RemoteError, match="has taken over"):
        desk.take(Presence(other + "z", alive=True))
