"""A controller whose own thread stood still, for a disk or with its whole process: it blames nobody for it."""

from __future__ import annotations

import itertools
import threading
from contextlib import nullcontext

import pytest

from env_controller.dispatcher import MOST_FAILED_TICKS
from env_controller.roster import GONE_S
from luxloop.bus import Asked, Heard
from luxloop.bus.frame import encode
from luxloop.bus.keys import at
from luxloop.messages import Heartbeat, StatusAsked
from tests.env_controller.test_dispatcher import Desk

SILENCE_S = 6.0


class StallingDesk(Desk):
    """A controller that serves from its own inbox; what lies there takes the time that we say."""

    def stall(self, s: float) -> None:
        """The next thing in the inbox takes so long."""

        def answer(_: bytes) -> None:
            self.now += s

        self.controller._inbox.offer(Asked(at("luxloop", "status"), encode(StatusAsked()), answer, lambda: None))

    def beat_meanwhile(self) -> None:
        """A beat comes, and lies in the inbox."""
        key = at("luxloop", "heartbeat", kind="film", worker="w1")
        self.controller._inbox.offer(Heard(key, encode(Heartbeat(worker="w1", kind="film"))))

    def serve(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Go on until the inbox is empty and a tick is over."""
        stop = threading.Event()

        def tick(_: float) -> None:
            if not self.controller._inbox:
                stop.set()

        monkeypatch.setattr("env_controller.dispatcher.TICK_S", 0.0)  # our clock stands still between events
        monkeypatch.setattr(self.controller._campaigns, "tick", tick)
        self.controller._serve(stop)


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch) -> StallingDesk:
    """A controller with a task that its one worker computes."""
    desk = StallingDesk(monkeypatch, silence_s=SILENCE_S)
    desk.hello()
    desk.submit(patience_s=3600.0)
    desk.pull()
    return desk


@pytest.mark.parametrize("beats", [True, False])
def test_stalls_of_our_own_are_no_worker_s_silence(
    desk: StallingDesk, monkeypatch: pytest.MonkeyPatch, beats: bool
) -> None:
    """Three times 8 s: beats lie in the inbox behind what waited for its disk, or have not come in yet."""
    for _ in range(3):
        desk.stall(8.0)
        if beats:
            desk.beat_meanwhile()
        desk.serve(monkeypatch)
        desk.beat()
    assert desk.told == []
    assert desk.status().running == 1


def test_what_lies_in_the_inbox_is_heard_before_anybody_is_called_silent(
    desk: StallingDesk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten questions that take 0.9 s each, none of them a stall; behind them lies a beat."""
    for _ in range(10):
        desk.stall(0.9)
    desk.beat_meanwhile()
    desk.serve(monkeypatch)
    assert desk.told == []
    assert desk.status().running == 1


def test_a_stall_hides_a_silent_worker_for_no_longer_than_it_lasts(
    desk: StallingDesk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It said nothing before, during and after 8 s in which nobody listened."""
    desk.wait(2.0)
    desk.stall(8.0)
    desk.serve(monkeypatch)
    desk.wait(SILENCE_S - 2.25)
    assert desk.status().running == 1
    desk.wait(0.5)
    assert desk.status().running == 0
    assert desk.told != []


def test_a_stall_of_a_minute_takes_nobody_off_the_list(desk: StallingDesk, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that is not heard of for a minute of ours goes; this minute was none."""
    desk.stall(GONE_S + 10.0)
    desk.serve(monkeypatch)
    assert len(desk.status().workers) == 1
    desk.wait(GONE_S + 0.5)
    assert desk.status().workers == ()


@pytest.mark.parametrize("failing", [MOST_FAILED_TICKS - 1, MOST_FAILED_TICKS])
def test_ticks_that_fail_for_ten_seconds_end_a_controller(
    desk: StallingDesk, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    """Nothing is looked after then: it ends, and is begun anew; one less, and it goes on."""
    ticks, stop = itertools.count(1), threading.Event()

    def tick(_: float) -> None:
        if next(ticks) <= failing:
            raise RuntimeError("no room")
        stop.set()

    monkeypatch.setattr("env_controller.dispatcher.TICK_S", 0.0)
    monkeypatch.setattr(desk.controller._campaigns, "tick", tick)
    with pytest.raises(RuntimeError) if failing == MOST_FAILED_TICKS else nullcontext():
        desk.controller._serve(stop)
    assert stop.is_set() == (failing < MOST_FAILED_TICKS)
