"""What everybody saw, in the order in which it was seen: lines of JSON in one file that many processes append to.

    asked, told, failed    a designer: lane, number, digest of the step's content
    finished               the same: records and root of the journal, as told at its end
    epoch, accepted,       a controller's core: a task is taken up, handed out, a result comes, the task is over
    granted, delivered,
    ended
    computes, computed     a worker
    on record              the lab, after a controller died: the steps that its journal holds
    tail lost              the same after the lab took bytes of the journal away: what was told of them is excused
    fault, healed, looked  the nemesis

A line is one `write`: a process killed the moment after has left it whole.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from luxloop.campaign import Step
from luxloop.words import sha256_of

Seen = dict[str, Any]
Steps = dict[str, str]
"""Digest of a step's content, by "lane:number"."""


class History:
    """The file, open for appending; thread-safe, and safe among processes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        self._lock = threading.Lock()
        self._read_bytes = 0
        self._seen: list[Seen] = []
        self._told: dict[tuple[str, str], Seen] = {}

    def note(self, what: str, **facts: Any) -> None:
        """Append what was seen now."""
        line = json.dumps({"what": what, "time_s": time.time(), "pid": os.getpid()} | facts)
        os.write(self._file, line.encode() + b"\n")

    def read(self) -> list[Seen]:
        """All that was seen so far."""
        with self._lock:
            self._read_on()
            return list(self._seen)

    def tellings(self, run: str) -> list[Seen]:
        """The tellings of a run's steps, the first of each: a designer that goes on is told the old ones again."""
        with self._lock:
            self._read_on()
            return [seen for (of_run, _), seen in self._told.items() if of_run == run]

    def _read_on(self) -> None:
        with self.path.open("rb") as file:
            file.seek(self._read_bytes)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        self._read_bytes += len(whole)
        for line in whole.splitlines():
            seen = json.loads(line)
            self._seen.append(seen)
            if seen["what"] == "told":
                self._told.setdefault((seen["run"], seen["step"]), seen)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._file)


def name_of(step: Step) -> str:
    """Which step of its run it is."""
    return f"{step.lane}:{step.number}"


def digest_of(step: Step) -> str:
    """Of what it says, without times and names."""
    return sha256_of(step.content())


def digests_of(steps: Iterable[Step]) -> Steps:
    """Of many steps."""
    return {name_of(step): digest_of(step) for step in steps}
