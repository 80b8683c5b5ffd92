"""Level 5 of a replay: a run's records once more over the bus, at their own pace or another, for whoever listens.

    play(folder, settings, rate=10.0)     # on the other side: luxloop campaign status --follow --from replay/<run>

Nobody need listen, and who comes late misses what was before. Each record goes as it lies in the journal, under the
key `replay/<run>`; after the last one a message without a topic says that it is over. A player that is killed is
missed by its liveliness token.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from luxloop.bus import Bus
from luxloop.bus.frame import INLINE_BYTES, encode
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.endpoint import listening
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import TOPICS, Record
from luxloop.messages import Replayed
from luxloop.settings import Settings, as_environment

MOST_PAUSE_S = 10.0
"""Between two records, whatever their times: a run that lay a night between two segments is not waited for."""
JOIN_S = 1.0  # where the router is ours, who waits for one gets so long to come in
LEAVE_S = 0.5  # and what was published so long to reach them, before that router goes
START_S, STOP_S = 20.0, 5.0
LOOK_S = 0.1  # how often the keyboard is looked at while paused

Pressed = Callable[[float], bool]


@dataclass(frozen=True)
class Played:
    """What was published: of which run, under which key, how many records, how many of them steps, for how long."""

    run: str
    key: str
    records: int = 0
    steps: int = 0
    wall_s: float = 0.0

    def document(self) -> dict[str, Any]:
        """As one object for machines."""
        return {"run": self.run, "key": self.key, "records": self.records, "steps": self.steps, "wall_s": self.wall_s}


class Pace:
    """When the next record is due: `rate` times as fast as it was, 0 as fast as can be; the space bar stops it."""

    def __init__(self, rate: float, pressed: Pressed, *, paused: bool = False) -> None:
        self._rate, self._pressed, self._paused = rate, pressed, paused
        self._due_s = time.monotonic()

    def wait(self, gap_s: float) -> None:
        """Return when a record is due that came `gap_s` after the one before."""
        if self._rate:
            self._due_s += min(max(gap_s, 0.0) / self._rate, MOST_PAUSE_S)
        while True:
            if self._paused:
                self._stand_still()
            left_s = self._due_s - time.monotonic() if self._rate else 0.0
            self._paused = self._pressed(max(left_s, 0.0))
            if not self._paused and (not self._rate or time.monotonic() >= self._due_s):
                return

    def _stand_still(self) -> None:
        since_s = time.monotonic()
        while not self._pressed(LOOK_S):
            pass
        self._paused = False
        self._due_s += time.monotonic() - since_s


def play(
    folder: Path,
    settings: Settings,
    *,
    rate: float = 1.0,
    topics: Sequence[str] = (),
    start: int = 0,
    paused: bool = False,
    local: bool = True,
    look: Callable[[Record], object] = lambda _: None,
) -> Played:
    """Publish the records of the run in `folder`; returns when all are out.

    `rate` is a multiple of real time, 0 for as fast as possible; `topics` are those wanted, none named: all;
    `start` is the first step; `paused` waits for the space bar at once. Needs a router at `settings.router`: where
    none listens and `local` allows, one is started there for as long as this lasts. `look` is told every record.

    Raises InputError for a rate, topic or step that there is not, or `paused` without a terminal; RemoteError
    no_router where no router can be had.
    """
    journal = RunJournal(folder)
    _refuse(journal, rate, topics, start, paused)
    records = (entry for entry in journal.records(*topics) if entry.sequence >= start)
    with _router_at(settings, local), ZenohBus(settings) as bus, keyboard() as pressed:
        return publish(bus, settings.realm, name_of(journal), records, Pace(rate, pressed, paused=paused), look)


def publish(
    bus: Bus,
    realm: str,
    run: str,
    records: Iterator[Record],
    pace: Pace,
    look: Callable[[Record], object] = lambda _: None,
) -> Played:
    """Put the records on the bus, each when it is due; the end is told also where this is interrupted."""
    key, began_s = at(realm, "replay", name=run), time.monotonic()
    bus.announce(at(realm, "alive", role="designer", kind="replay", name=run))  # a client may announce that much
    place = steps = 0
    before_ns: int | None = None
    try:
        for entry in records:
            pace.wait(0.0 if before_ns is None else (entry.log_time_ns - before_ns) / 1e9)
            before_ns = entry.log_time_ns
            bus.publish(key, frame_of(run, place, entry))
            place, steps = place + 1, steps + (entry.topic == "/step")
            look(entry)
    finally:
        bus.publish(key, encode(Replayed(run=run, place=place)))
    return Played(run, key, place, steps, time.monotonic() - began_s)


def frame_of(run: str, place: int, entry: Record) -> bytes:
    """A record as a frame of the bus: its bytes in pieces that travel within it. Raises InputError above 16 MB."""
    words = Replayed(run=run, place=place, topic=entry.topic, sequence=entry.sequence, log_time_ns=entry.log_time_ns)
    data = np.frombuffer(entry.data, np.uint8)
    pieces = {f"data-{begin}": data[begin : begin + INLINE_BYTES] for begin in range(0, len(data), INLINE_BYTES)}
    return encode(words, pieces)


def name_of(journal: RunJournal) -> str:
    """The name under which a run is played: its id."""
    return journal.metadata("run").get("run", "")


def _refuse(journal: RunJournal, rate: float, topics: Sequence[str], start: int, paused: bool) -> None:
    unknown = sorted(set(topics) - TOPICS.keys())
    if unknown:
        raise InputError("--topics", unknown[0], "some of " + ", ".join(TOPICS))
    if not 0.0 <= rate <= 1e6:
        raise InputError("--rate", rate, "0 to 1,000,000 times real time", "0: as fast as possible")
    last = max((entry.sequence for entry in journal.last("/step", 1)), default=0)
    if not 0 <= start <= last:
        raise InputError("--start", start, f"0 to {last:,}, the steps of this run")
    if paused and not sys.stdin.isatty():
        raise InputError("--paused", paused, "a terminal with a space bar to go on", "leave it out")


@contextmanager
def keyboard() -> Iterator[Pressed]:
    """A function that waits so many seconds at most, and says whether the space bar was pressed meanwhile.

    Where stdin is no terminal it never is.
    """
    if not sys.stdin.isatty():
        yield _never
        return
    number = sys.stdin.fileno()

    def pressed(limit_s: float) -> bool:
        ready, _, _ = select.select([number], [], [], limit_s)
        return bool(ready) and os.read(number, 1) == b" "

    before = termios.tcgetattr(number)
    tty.setcbreak(number)
    try:
        yield pressed
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)


def _never(limit_s: float) -> bool:
    if limit_s > 0.0:
        time.sleep(limit_s)
    return False


@contextmanager
def _router_at(settings: Settings, local: bool) -> Iterator[None]:
    """While inside, a router listens at `settings.router`: the one that is there, or one of our own."""
    if listening(settings.router):
        yield
        return
    if not local:
        raise _no_router(settings, "start one there: luxloop serve router")
    process = subprocess.Popen(
        [sys.executable, "-m", "luxloop", "serve", "router", "--quiet"],
        env=as_environment(settings) | {"LUXLOOP_WITH_PARENT": str(os.getpid())},
        stdin=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for us: the end is published before the router goes
    )
    try:
        end_s = time.monotonic() + START_S
        while not listening(settings.router):
            if process.poll() is not None or time.monotonic() > end_s:
                raise _no_router(settings, "none could be started there: name a running one by LUXLOOP_ROUTER")
            time.sleep(0.02)
        time.sleep(JOIN_S)
        try:
            yield
        finally:
            time.sleep(LEAVE_S)
    finally:
        process.terminate()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _no_router(settings: Settings, mend: str) -> RemoteError:
    return RemoteError(Failure(code="no_router", message=f"no router at {settings.router}", mend=mend))
