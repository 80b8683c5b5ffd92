"""Who of a local set hangs: a process that lives and does not answer, which nobody would start again.

The controller is asked for its status every two seconds through a session of our own. Where no answer comes although
the router is reached, the controller hangs; where the router is not reached, the router does; a worker that the
controller had listed and lists no longer has hung or lost its way. Stopped and deadlocked processes are found alike.
Where we are refused for our certificate, nobody is to blame.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Literal

from luxloop.bus import Interrupt, ask_for
from luxloop.bus.keys import KEYS, at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.errors import LuxloopError, RemoteError
from luxloop.messages import Status, StatusAsked
from luxloop.settings import Settings

Server = Literal["router", "controller"]
BLAMED: dict[str, Server] = {
    "no_router": "router",
    "no_controller": "controller",
    "timed_out": "controller",
    "busy": "controller",
}
"""Who is to blame that there is no status, by the failure's code."""
ASK_EVERY_S = 2.0
SERVER_HUNG_S = 20.0
WORKER_HUNG_S = 60.0
MISSES = 4  # so many questions in a row besides: a set that was itself stopped for a while has missed one


@dataclass
class Silence:
    """For how long a process has not been heard of while it should have been."""

    missed: int = 0
    since_s: float = 0.0

    def too_long(self, limit_s: float, now_s: float) -> bool:
        """After one more question without a sign of it."""
        self.since_s = self.since_s if self.missed else now_s
        self.missed += 1
        return self.missed >= MISSES and now_s - self.since_s >= limit_s


class Silences:
    """Of all processes of a set, by process id. Pure: what was seen goes in, who hangs comes out."""

    def __init__(self) -> None:
        self._silences: dict[int, Silence] = {}
        self._listed: set[int] = set()

    def note(
        self, found: Status | Server, servers: Mapping[Server, int], workers: Collection[int], now_s: float
    ) -> dict[int, str]:
        """Who has been silent for too long, and why one thinks so, after a status or who is to blame for none.

        `servers` and `workers` are the process ids of the set as it is now.
        """
        silent: dict[int, tuple[float, str]] = {}
        if isinstance(found, str):
            silent[servers[found]] = SERVER_HUNG_S, f"the {found} has not answered for {SERVER_HUNG_S:g} s"
            heard = set(servers.values()) - silent.keys()
        else:
            listed = {one.describe.pid for one in found.workers if one.heard_s_ago < WORKER_HUNG_S}
            self._listed = (self._listed | listed) & set(workers)
            why = f"the controller has heard nothing of a worker for {WORKER_HUNG_S:g} s"
            silent |= dict.fromkeys(self._listed - listed, (WORKER_HUNG_S, why))
            heard = listed | set(servers.values())
        for pid in heard:
            self._silences.pop(pid, None)
        hung = {
            pid: why
            for pid, (limit_s, why) in silent.items()
            if self._silences.setdefault(pid, Silence()).too_long(limit_s, now_s)
        }
        for pid in hung:
            del self._silences[pid]
        return hung


class Watch:
    """Asks in a thread of its own; `kill` is told a process id and why. End it by `close`."""

    def __init__(
        self,
        settings: Settings,
        servers: Callable[[], Mapping[Server, int]],
        workers: Callable[[], Collection[int]],
        kill: Callable[[int, str], object],
    ) -> None:
        self._settings, self._servers, self._workers, self._kill = settings, servers, workers, kill
        self._closing = Interrupt()
        self._bus: ZenohBus | None = None
        self._thread = threading.Thread(target=self._watch, name="watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ask no more, kill nobody any more."""
        self._closing.set()
        self._thread.join()

    def _watch(self) -> None:
        silences = Silences()
        while not self._closing.wait(ASK_EVERY_S):
            try:
                found: Status | Server | None = self._status()
            except RemoteError as error:
                found = BLAMED.get(error.failure.code)
            except LuxloopError:
                if self._bus is None:
                    break  # no certificate for a session of our own: what ends is started again, what hangs is not
                found = None  # an answer that cannot be read: the one who gave it does not hang
            if found is not None and not self._closing.is_set():
                for pid, why in silences.note(found, self._servers(), self._workers(), time.monotonic()).items():
                    self._kill(pid, why)
        if self._bus is not None:
            self._bus.close()

    def _status(self) -> Status:
        """What the controller says. Raises RemoteError where it says nothing."""
        self._bus = self._bus or ZenohBus(self._settings)
        key, row = at(self._settings.realm, "status"), KEYS["status"]
        return ask_for(self._bus, key, StatusAsked(), row.time_limit_s, cancelled=self._closing).expect(Status)
