"""A designer's door when the controller is away, comes back, or has forgotten the run."""

from __future__ import annotations

from typing import Any

import pytest

from luxloop import door as doors
from luxloop.bus.frame import Parcel
from luxloop.bus.keys import at
from luxloop.campaign import Action, Begin, Begun, Ended, Note, Step
from luxloop.design import Design
from luxloop.door import RunDoor
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.messages import Nothing, Receipt
from luxloop.words import Words
from tests.campaign_runs import plan_of

DESIGN = Design.from_vector((180.0, 28.0, 500.0, 35.0, 6.5))
ACTION = Action(run="one", designer="d", lane=0, number=0, design=DESIGN)
STEP = Step(
    run="one", lane=0, number=0, design=DESIGN, state=(0.0, 0.0, 0.0, 0.0, 0.0), uniformity=0.5, reward=0.0
)  # fmt: skip

BEGUN = Begun(run="one", folder="/runs/one", segment=1)


class Client:
    """Answers in turn with what it is given: words, a failure or its code; the last one for ever."""

    def __init__(self, *answers: Any) -> None:
        self.answers, self.rows, self.messages = list(answers), list[str](), list[Words]()

    def ask(self, row: str, message: Words, *_: Any) -> Parcel:
        self.rows.append(row)
        self.messages.append(message)
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if isinstance(answer, Failure):
            raise RemoteError(answer)
        if isinstance(answer, str):
            raise RemoteError(Failure(code=answer, message=answer))  # type: ignore[arg-type]  # the tests give codes
        return Parcel(answer)


class Clock:
    """A clock that sleeping moves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 0.0
        monkeypatch.setattr(doors.time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(doors.time, "sleep", self.sleep)

    def sleep(self, s: float) -> None:
        self.now_s += s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Time passes only where somebody sleeps."""
    return Clock(monkeypatch)


def door(*answers: Any, **plan: Any) -> tuple[RunDoor, Client]:
    """A door on a run, and who answers there."""
    client = Client(BEGUN, *answers)
    opened = RunDoor(client, Begin(plan=plan_of("one", **plan), designer="d"))  # type: ignore[arg-type]  # it has what is asked
    client.rows.clear()
    return opened, client


def test_a_question_is_asked_again_while_it_takes() -> None:
    """Held too long, let go, asked again: the step."""
    opened, client = door(Nothing(), Nothing(), STEP)
    assert opened.act(ACTION) == STEP
    assert client.rows == ["act"] * 3


def test_a_run_whose_journal_takes_long_to_read_is_asked_for_until_it_is_open() -> None:
    """Longer than one that is away would be waited for."""
    client = Client(*[Nothing()] * 100, BEGUN)
    assert RunDoor(client, Begin(plan=plan_of("one"), designer="d", resume=True)).begun == BEGUN  # type: ignore[arg-type]  # it has what is asked
    assert client.rows == ["begin"] * 101


@pytest.mark.parametrize("code", ["no_router", "no_controller", "timed_out", "busy"])
def test_who_is_away_for_a_moment_is_waited_for(code: str, clock: Clock) -> None:
    """Told how long, and then the step is there."""
    opened, _ = door(code, code, STEP)
    lost: list[float] = []
    opened.on_lost = lost.append
    assert opened.act(ACTION) == STEP
    assert lost == pytest.approx([0.0, 0.2])
    assert clock.now_s == pytest.approx(0.4)


def test_who_stays_away_is_given_up(clock: Clock) -> None:
    """After a minute, with the reason."""
    opened, _ = door("no_controller")
    with pytest.raises(RemoteError, match="no_controller"):
        opened.act(ACTION)
    assert doors.LOST_S < clock.now_s < doors.LOST_S + 1.0


def test_a_run_that_the_controller_has_forgotten_says_what_is_safe_and_where() -> None:
    """It was restarted and cannot go on with it: the reason, the folder, and the command."""
    opened, _ = door("not_found", "refused")
    with pytest.raises(RemoteError) as caught:
        opened.act(ACTION)
    assert "refused" in caught.value.failure.message
    assert "/runs/one" in caught.value.failure.message
    assert caught.value.failure.mend == "luxloop campaign resume one"


def test_a_comparison_that_the_controller_has_forgotten_is_to_be_run_again() -> None:
    """`campaign resume` goes on with none."""
    opened, _ = door("not_found", "refused", kind="validation")
    with pytest.raises(RemoteError) as caught:
        opened.act(ACTION)
    assert caught.value.failure.mend == "run it again"


def test_a_run_that_the_controller_has_forgotten_is_opened_again(clock: Clock) -> None:
    """It reads the journal back and answers; one that loses the run each time is given up."""
    opened, client = door("not_found", BEGUN, STEP)
    assert opened.act(ACTION) == STEP
    assert client.rows == ["act", "begin", "act"]
    opened, _ = door(*["not_found", BEGUN] * doors.REOPENED, "not_found")
    with pytest.raises(RemoteError, match="loses it again"):
        opened.act(ACTION)


@pytest.mark.parametrize("code", ["refused", "bad_input"])
def test_what_is_refused_is_not_asked_again(code: str) -> None:
    """At once."""
    opened, client = door(code)
    with pytest.raises(RemoteError):
        opened.act(ACTION)
    assert client.rows == ["act"]


def test_left_by_an_error_nobody_is_waited_for(clock: Clock) -> None:
    """The error comes through, not that of the end; the end was tried once."""
    opened, client = door("no_controller")
    with pytest.raises(ValueError, match="mine"), opened:
        raise ValueError("mine")
    assert client.rows[0] == "end"
    assert clock.now_s < 1.0


def test_left_by_an_error_whose_text_cannot_be_sent_it_is_that_error(clock: Clock) -> None:
    """A file name may hold bytes that are no UTF-8: in the reason they are replaced."""
    opened, client = door(Ended(run="one", records=1, root="0" * 64, folder="/runs/one"))
    with pytest.raises(OSError, match="caf"), opened:
        raise OSError("caf\udce9")
    assert client.rows == ["end"]


def test_a_note_has_one_number_however_often_it_is_asked(clock: Clock) -> None:
    """The controller knows it again when its answer was lost; the next note has another number."""
    opened, client = door("timed_out", Receipt(accepted=True))
    opened.note(log="one")
    opened.note(log="two")
    assert [note.number for note in client.messages if isinstance(note, Note)] == [0, 0, 1]


def test_left_quietly_the_run_is_ended_once() -> None:
    """The root is kept for whoever asks."""
    ended = Ended(run="one", records=3, root="0" * 64, folder="/runs/one")
    opened, client = door(ended)
    with opened:
        assert opened.end("enough") == ended
    assert client.rows == ["end"]


UNHEARD = Failure(code="refused", message="it is there, the question did not reach it", where=at("luxloop", "act"))


def test_a_question_that_reached_nobody_is_asked_again(clock: Clock) -> None:
    """A router that has just been started: the controller is known there before its questions are."""
    opened, client = door("no_controller", *[UNHEARD] * 4, STEP)
    assert opened.act(ACTION) == STEP
    assert client.rows == ["act"] * 6


def test_who_is_not_permitted_to_ask_is_told_soon(clock: Clock) -> None:
    """After a few seconds, not after the time for which a controller may be away."""
    opened, _ = door(UNHEARD)
    with pytest.raises(RemoteError, match="did not reach"):
        opened.act(ACTION)
    assert clock.now_s < 6.0
