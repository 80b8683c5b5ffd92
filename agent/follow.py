"""A run looked at while it goes on: from its growing journal, or from a replay on the bus; the view is the same.

    journal file  ──from_journal─┐
                                 ├─▶ records ─▶ Seen ─▶ a line for each step, JSON lines, or the live table
    replay/<run>  ──from_replay──┘

Who comes late to a journal still gets all of it; who comes late to a replay misses what was before, and is told.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from agent.in_words import line, plain
from agent.live import live
from agent.overview import RUNNING, overview
from agent.progress import FINALISTS, Progress
from luxloop.bus import Bus, Heard, Inbox, Presence
from luxloop.bus.frame import decode
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.campaign import RunId, Step
from luxloop.endpoint import listening
from luxloop.errors import InputError, RemoteError
from luxloop.journal.reader import RunJournal, left_over, segments_of
from luxloop.journal.scan import Scan
from luxloop.journal.segment import being_written
from luxloop.journal.topics import VALIDATION, Close, Record
from luxloop.messages import Replayed
from luxloop.settings import Settings

LOOK_S = 0.2  # how often a file that does not grow is looked at again
AWAY_S = 5.0  # a router that is away for longer has ended the replay that was heard
TOPICS = frozenset({"/step", "/agent", "/log"})

Say = Callable[[str], None]


@dataclass
class Seen:
    """What came by so far, for the view."""

    progress: Progress = field(default_factory=Progress)
    reason: str = ""
    _designs: set[tuple[float, ...]] = field(default_factory=set)

    def take(self, entry: Record) -> Step | None:
        """The step of a record that is one."""
        if entry.topic == "/agent":
            agent = entry.value
            self.progress.epsilon = agent.epsilon
            self.progress.episodes = max(self.progress.episodes, agent.episode + 1)
        elif entry.topic == "/log":
            close = Close.of(entry.value.message)
            self.reason = close.reason if close else self.reason
        elif entry.topic == "/step":
            step: Step = entry.value
            self._step(step)
            return step
        return None

    def _step(self, step: Step) -> None:
        seen = self.progress
        seen.steps, seen.last = seen.steps + 1, step
        seen.physics_s += step.physics_s
        if step.final:
            seen.stage = FINALISTS
        if step.failure is not None or not step.feasible or step.final:
            return
        self._designs.add(tuple(step.design.as_vector()))
        seen.evaluations = len(self._designs)
        if seen.best is None or step.uniformity > seen.best.uniformity:
            seen.best = step


def from_journal(folder: Path) -> Iterator[Record]:
    """The records of a run from its beginning, then as they are committed, until nobody writes it any more."""
    done: set[Path] = set()
    while paths := [path for path in _segments(folder) if path not in done]:
        for path in paths:
            for commit in Scan(path, partial(_more, path)):
                yield from (link for link in commit.links if isinstance(link, Record) and link.topic in TOPICS)
        done.update(paths)


def _segments(folder: Path) -> list[Path]:
    """The segments that a run consists of, as `RunJournal` has them; it cannot be asked before the first commit."""
    paths = segments_of(folder)
    again = left_over(paths)
    return [path for path in paths if path not in again]


def _more(path: Path) -> bool:
    """Whether a segment may still grow; after a little while."""
    if not being_written(path):
        return False
    time.sleep(LOOK_S)
    return True


@dataclass
class Listener:
    """Hears a replay. `late`: records published before it listened; `missed`: those lost on the way since."""

    bus: Bus
    realm: str
    run: str
    late: int = 0
    missed: int = 0

    def records(self) -> Iterator[Record]:
        """The records as they are played, until the player says that it is over, or it or the router has gone.

        Before anything was heard it is waited for, however long.
        """
        inbox = Inbox()
        self.bus.subscribe(at(self.realm, "replay", name=self.run), inbox)
        self.bus.watch(at(self.realm, "alive", role="designer", kind="replay", name=self.run), inbox)
        expected: int | None = None
        heard_s = time.monotonic()
        while True:
            event = inbox.take(LOOK_S)
            if event is not None or expected is None or self.bus.connected():
                heard_s = time.monotonic()
            gone = isinstance(event, Presence) and not event.alive
            if gone or time.monotonic() - heard_s > AWAY_S:
                return
            if not isinstance(event, Heard):
                continue
            words, entry = played(event.frame)
            if expected is None:
                self.late = words.place
            else:
                self.missed += max(words.place - expected, 0)
            expected = words.place + 1
            if entry is None:
                return
            yield entry


def played(frame: bytes) -> tuple[Replayed, Record | None]:
    """What a frame of a replay says, and its record; none at the end. Raises InputError where it is no such frame."""
    parcel = decode(frame)
    words = parcel.expect(Replayed)
    if not words.topic:
        return words, None
    data = b"".join(piece.tobytes() for piece in parcel.arrays.values())
    return words, Record(words.topic, words.sequence, words.log_time_ns, data)


def follow_run(folder: Path, *, as_json: bool, show: bool) -> None:
    """Tell every new step of a run until it ends; first how it stands, at the end what came of it."""
    row, write = overview(folder), Writer(as_json)
    write.status("status", row)
    if row["state"] == RUNNING:
        began_s = time.monotonic()
        with live(show, row["run"], evaluations_of(folder), None) as look:
            seen = Seen()
            for entry in from_journal(folder):
                if seen.take(entry) is None:
                    continue
                if seen.progress.steps == 1:
                    seen.progress.began_s = began_s - max(time.time() - entry.log_time_ns / 1e9, 0.0)
                look(seen.progress)
                if seen.progress.steps > row["steps"] and not show:
                    write.step(entry, seen)
    elif not as_json:
        return
    write.status("end", overview(folder))


def follow_replay(settings: Settings, source: str, *, as_json: bool, show: bool, say: bool) -> None:
    """Tell every step of the replay `replay/<run>` as it is played; waits for a router and a player to come.

    `say` tells on stderr what is waited for. Raises InputError where `source` names no replay.
    """
    run = name_of(source)
    if say:
        _say(f"waiting for a replay of {run} at {settings.router}: luxloop audit replay {run} --level 5")
    write, seen = Writer(as_json), Seen()
    with _joined(settings) as bus, live(show, source, 0, None) as look:
        listener = Listener(bus, settings.realm, run)
        for entry in listener.records():
            if entry.topic in TOPICS and seen.take(entry) is not None:
                look(seen.progress)
                if not show:
                    write.step(entry, seen)
    write.replay_end(source, seen, listener)


def _joined(settings: Settings) -> ZenohBus:
    """A session at the router, as soon as there is one."""
    while True:
        while not listening(settings.router):
            time.sleep(LOOK_S)
        try:
            return ZenohBus(settings)
        except RemoteError as error:  # it went as we came
            if error.failure.code != "no_router":
                raise


def name_of(source: str) -> str:
    """The run of `replay/<run>`. Raises InputError where that is not what `source` says."""
    kind, _, run = source.partition("/")
    try:
        if kind != "replay":
            raise ValueError(kind)
        return str(TypeAdapter(RunId).validate_python(run))
    except (ValidationError, ValueError) as error:
        raise InputError("--from", source, "replay/RUN, with the id of a run", "e.g. replay/trial") from error


def evaluations_of(folder: Path) -> int:
    """How many evaluations a campaign was planned for; 0 where its journal does not say."""
    try:
        return int(json.loads(RunJournal(folder).attachments()["campaign.json"])["stop"]["evaluations"])
    except (KeyError, TypeError, ValueError):
        return 0


class Writer:
    """Writes what happens on stdout: a line for people, or a JSON object a line."""

    def __init__(self, as_json: bool) -> None:
        self._as_json = as_json

    def step(self, entry: Record, seen: Seen) -> None:
        """One step."""
        step, best = seen.progress.last, seen.progress.best
        if self._as_json:
            facts = {"sequence": entry.sequence, "time_unix_s": entry.log_time_ns / 1e9, **(plain(step) or {})}
            _put(json.dumps({"event": "step", **facts}))
            return
        at_utc = datetime.fromtimestamp(entry.log_time_ns / 1e9, UTC)
        so_far = f"  best of the walk {100.0 * best.uniformity:.2f} %" if best else ""
        if step is not None and step.role is not None:
            so_far = f"  evaluated anew: {step.role.replace('_', ' ')}"
        _put(f"{at_utc:%H:%M:%S} {entry.sequence:>6}  {line(plain(step))}{so_far}")

    def status(self, event: str, row: dict[str, Any]) -> None:
        """How a run stands."""
        _put(json.dumps({"event": event, **row}) if self._as_json else status_line(row))

    def replay_end(self, source: str, seen: Seen, listener: Listener) -> None:
        """What came by of a replay."""
        facts = {"from": source, "steps": seen.progress.steps, "reason": seen.reason}
        facts |= {"late": listener.late, "missed": listener.missed}
        if self._as_json:
            _put(json.dumps({"event": "end", **facts}))
            return
        lost = f", {listener.missed:,} records lost on the way" if listener.missed else ""
        late = f", {listener.late:,} records were out before" if listener.late else ""
        _put(f"the replay is over: {seen.progress.steps:,} steps{late}{lost}; {seen.reason or 'without an end'}")


def status_line(row: dict[str, Any]) -> str:
    """How a run stands, in a line."""
    why = f" ({row['reason']})" if row["reason"] else ""
    what = "to do it again" if row["kind"] == VALIDATION else "to go on"
    mend = f"; {what}: {row['mend']}" if row["mend"] else ""
    return f"{row['run']}: {row['state']}{why}, {row['steps']:,} steps, best {line(row['best'])}{mend}"


def _put(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def _say(text: str) -> None:
    sys.stderr.write(f"luxloop: {text}\n")
