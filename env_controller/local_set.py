"""All processes of a set on this machine: router, controller, workers; started, watched, restarted, stopped."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable

from luxloop.settings import Settings, as_environment

RESTART_S = 0.5  # a process that ended is started again after this, doubled each time it ends within a minute
RESTART_MOST_S = 10.0
STOP_S = 6.0  # a worker leaves within 5 s


class Member:
    """One process of the set."""

    def __init__(self, role: str, settings: Settings, quiet: bool) -> None:
        self.role, self._settings = role, settings
        self._argv = [sys.executable, "-m", "luxloop", "serve", role] + ["--quiet"] * quiet
        self._wait_s, self._again_s, self._began_s = RESTART_S, 0.0, 0.0
        self.process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        self._began_s = time.monotonic()
        environment = as_environment(self._settings) | {"LUXLOOP_WITH_PARENT": "1"}
        return subprocess.Popen(self._argv, env=environment, stdin=subprocess.DEVNULL)

    def look_after(self, tell: Callable[[str], None]) -> None:
        """Start the process again where it has ended, not faster than doubling pauses allow."""
        if self.process.poll() is None:
            return
        now = time.monotonic()
        if not self._again_s:
            self._wait_s = RESTART_S if now - self._began_s > 60 else min(2 * self._wait_s, RESTART_MOST_S)
            self._again_s = now + self._wait_s
            tell(f"{self.role} ended with {self.process.returncode}; starting again in {self._wait_s:g} s")
        elif now >= self._again_s:
            self._again_s = 0.0
            self.process = self._start()


def run_local(settings: Settings, workers: dict[str, int], stop: threading.Event, *, quiet: bool = False) -> None:
    """Keep a set alive until `stop` is set, or whoever started it has gone; then stop all of it."""

    def tell(text: str) -> None:
        if not quiet:
            print(f"local: {text}", file=sys.stderr, flush=True)  # noqa: T201  a server's log goes to stderr

    roles = ["router", "controller", *(role for role, count in workers.items() for _ in range(count))]
    members = [Member(role, settings, quiet) for role in roles]
    parent = os.getppid() if os.environ.get("LUXLOOP_WITH_PARENT") == "1" else None
    tell(f"{', '.join(roles)} at {settings.router}")
    try:
        while not stop.wait(0.2) and parent in (None, os.getppid()):
            for member in members:
                member.look_after(tell)
    finally:
        for member in reversed(members):  # workers first, so that they can hand back what they hold
            member.process.terminate()
        end_s = time.monotonic() + STOP_S
        for member in reversed(members):
            try:
                member.process.wait(max(end_s - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                member.process.kill()
                member.process.wait()
