"""Level 5 of a replay: the records over the bus as they were, at a chosen pace, paused, from a step, some topics."""

from __future__ import annotations

import os
import pty
import select
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from env_controller.audit import playback
from env_controller.audit.playback import Pace, Pressed, frame_of, keyboard, play, publish
from luxloop.bus import Inbox
from luxloop.bus.frame import FRAME_BYTES, INLINE_BYTES, decode
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.endpoint import listening
from luxloop.errors import InputError, RemoteError
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import Record, map_record
from luxloop.messages import Replayed
from luxloop.settings import Settings
from tests.conftest import wait_for
from tests.journals import RUN, write_run
from tests.local_bus import LocalBus, LocalRouter


def never(_: float) -> bool:
    """A keyboard that nobody touches."""
    return False


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[list[float], Pressed]]:
    """Makes time go on only where it is waited for; `at_s` are the moments when the space bar is pressed."""

    def make(*at_s: float) -> tuple[list[float], Pressed]:
        now, keys = [0.0], list(at_s)

        def pressed(limit_s: float) -> bool:
            if keys and keys[0] <= now[0] + limit_s:
                now[0] = max(now[0], keys.pop(0))
                return True
            now[0] += limit_s
            return False

        monkeypatch.setattr(time, "monotonic", lambda: now[0])
        return now, pressed

    return make


Clock = Callable[..., tuple[list[float], Pressed]]


def test_records_come_at_their_own_pace(clock: Clock) -> None:
    """Twice as fast takes half the time; a long pause is cut short; time never goes back."""
    now, pressed = clock()
    pace, seen = Pace(2.0, pressed), []
    for gap_s in (0.0, 1.0, 3.0, -5.0, 10_000.0):
        pace.wait(gap_s)
        seen.append(now[0])
    assert seen == [0.0, 0.5, 2.0, 2.0, 2.0 + playback.MOST_PAUSE_S]


def test_rate_0_waits_for_nothing(clock: Clock) -> None:
    """As fast as can be."""
    now, pressed = clock()
    pace = Pace(0.0, pressed)
    for _ in range(100):
        pace.wait(3600.0)
    assert now == [0.0]


def test_the_space_bar_pauses_and_goes_on(clock: Clock) -> None:
    """What is paused is added to all that follows."""
    now, pressed = clock(1.5, 7.5)
    pace, seen = Pace(1.0, pressed), []
    for gap_s in (0.0, 1.0, 1.0, 1.0):
        pace.wait(gap_s)
        seen.append(now[0])
    assert seen == [0.0, 1.0, 8.0, 9.0]


@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_it_may_begin_paused(clock: Clock, rate: float) -> None:
    """Nothing is due before the space bar."""
    now, pressed = clock(5.0)
    Pace(rate, pressed, paused=True).wait(0.0)
    assert now == [5.0]


def test_the_keyboard_is_a_terminals_space_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another key is none; the terminal is left as it was, also after an error; no terminal, no key."""
    master, slave = pty.openpty()
    with os.fdopen(slave, "r") as terminal, monkeypatch.context() as patch:
        patch.setattr(sys, "stdin", terminal)
        before = playback.termios.tcgetattr(slave)
        with suppress(RuntimeError), keyboard() as pressed:
            assert not pressed(0.0)
            for key, wanted in ((b"x", False), (b" ", True)):
                os.write(master, key)
                assert select.select([slave], [], [], 10)[0]
                assert pressed(1.0) is wanted
            assert playback.termios.tcgetattr(slave) != before
            raise RuntimeError
        assert playback.termios.tcgetattr(slave) == before
    os.close(master)
    with open(os.devnull) as nothing, monkeypatch.context() as patch:
        patch.setattr(sys, "stdin", nothing)
        with keyboard() as pressed:
            assert not pressed(0.0)


def test_a_record_travels_as_it_lies_in_the_journal(tmp_path: Path) -> None:
    """Topic, sequence, time and bytes; a map above 1 MB goes in pieces within the frame's limits."""
    write_run(tmp_path, 1)
    large = map_record(np.random.default_rng(1).random((700, 700)), 3, 5)
    assert len(large.data) > INLINE_BYTES
    for place, entry in enumerate([*RunJournal(tmp_path).records(), large]):
        frame = frame_of(RUN, place, entry)
        assert len(frame) < FRAME_BYTES
        parcel = decode(frame)
        words = parcel.expect(Replayed)
        data = b"".join(piece.tobytes() for piece in parcel.arrays.values())
        assert Record(words.topic, words.sequence, words.log_time_ns, data) == entry
        assert words.place == place


def test_the_end_is_told_even_to_an_interrupted_view(tmp_path: Path) -> None:
    """Ctrl-C in the middle: the last message says that it is over."""
    write_run(tmp_path, 2)
    router, inbox = LocalRouter(), Inbox()

    def interrupt(entry: Record) -> None:
        if entry.sequence == 1:
            raise KeyboardInterrupt

    with LocalBus(router) as theirs, LocalBus(router) as ours:
        ours.subscribe(at("lab", "replay"), inbox)
        with pytest.raises(KeyboardInterrupt):
            publish(theirs, "lab", RUN, RunJournal(tmp_path).records(), Pace(0.0, never), interrupt)
        heard = [decode(inbox.take(1.0).frame).message for _ in range(len(inbox))]  # type: ignore[union-attr]
    assert heard[-1] == Replayed(run=RUN, place=len(heard) - 1)


def test_a_run_is_played_over_a_router_of_its_own(tmp_path: Path, settings: Settings) -> None:
    """Where none listens: one is started at that endpoint, and has gone when all is out; steps and topics chosen."""
    write_run(tmp_path, 4)
    told: list[Record] = []
    done = play(tmp_path, settings, rate=0.0, topics=("/step", "/map/sim"), start=2, look=told.append)
    assert told == [entry for entry in RunJournal(tmp_path).records("/step", "/map/sim") if entry.sequence >= 2]
    assert (done.run, done.records, done.steps) == (RUN, 4, 2)
    assert done.document()["key"].endswith(f"replay/{RUN}")
    assert not listening(settings.router)
    with pytest.raises(RemoteError, match="no router"):
        play(tmp_path, settings, local=False)


@pytest.mark.usefixtures("router")
def test_a_router_that_is_there_is_used_and_stays(tmp_path: Path, settings: Settings) -> None:
    """Who listens there hears every record in order, then the end."""
    write_run(tmp_path, 3)
    inbox = Inbox()

    def all_heard() -> bool:
        """A subscription takes a moment to be known at the router: the first play may come too early."""
        done = play(tmp_path, settings, rate=0.0)
        heard: list[Replayed] = []
        while (not heard or heard[-1].topic) and (event := inbox.take(2.0)) is not None:
            heard.append(decode(event.frame).expect(Replayed))  # type: ignore[union-attr]  # nothing else is told
        return [words.place for words in heard] == list(range(done.records + 1))

    with ZenohBus(settings) as bus:
        bus.subscribe(at(settings.realm, "replay", name=RUN), inbox)
        wait_for(all_heard, "every record, then the end")
    assert listening(settings.router)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"rate": -1.0}, "--rate"),
        ({"rate": float("nan")}, "--rate"),
        ({"topics": ("/steps",)}, "--topics"),
        ({"start": 4}, "--start"),
        ({"start": -1}, "--start"),
    ],
)
def test_what_cannot_be_played_is_refused(
    tmp_path: Path, settings: Settings, options: dict[str, object], named: str
) -> None:
    """Before a router is looked for; the field's name is the option's."""
    write_run(tmp_path, 4)
    with pytest.raises(InputError, match=named):
        play(tmp_path, settings, **options)  # type: ignore[arg-type]


def test_paused_needs_a_terminal(tmp_path: Path, settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody could go on."""
    write_run(tmp_path, 1)
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with pytest.raises(InputError, match="--paused"):
            play(tmp_path, settings, paused=True)
