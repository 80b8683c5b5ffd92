"""All processes of a set on this machine: router, controller, workers; started, watched, restarted, stopped.

What ends is started again; what lives and does not answer is killed (`watch.py`), and then started again.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from env_controller.taken import refuse_taken
from env_controller.watch import Server, Watch
from luxloop.errors import InputError, LuxloopError
from luxloop.process import orphaned, usable_cores
from luxloop.settings import Settings, as_environment, usable_cache

RESTART_S = 0.5  # a process that ended is started again after this, doubled each time it ends within a minute
RESTART_MOST_S = 10.0
STOP_S = 6.0  # a worker leaves within 5 s
AT_ONCE_S = 2.0  # what fails so soon after its first start would fail again
BAD_INPUT = InputError.exit_code  # and what was told something wrong, however long a busy machine took to find out


class MemberError(LuxloopError):
    """A process of the set that failed as soon as it was first started; the set ends with its exit code."""

    def __init__(self, role: str, code: int) -> None:
        self.exit_code = code
        super().__init__(f"the {role} ended with {code} as soon as it was started, for the reason above; all stopped")


class Member:
    """One process of the set."""

    def __init__(self, role: str, settings: Settings, quiet: bool, threads: int | None = None) -> None:
        self.role, self._settings = role, settings
        self._threads = {} if threads is None else {"LUXLOOP_THREADS": str(threads)}
        self._argv = [sys.executable, "-m", "luxloop", "serve", role] + ["--quiet"] * quiet
        self._wait_s, self._again_s, self._began_s, self._first = RESTART_S, 0.0, 0.0, True
        self.process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        self._began_s = time.monotonic()
        environment = as_environment(self._settings) | {"LUXLOOP_WITH_PARENT": str(os.getpid())} | self._threads
        return subprocess.Popen(self._argv, env=environment, stdin=subprocess.DEVNULL)

    def look_after(self, tell: Callable[[str], None]) -> None:
        """Start the process again where it has ended, not faster than doubling pauses allow.

        Raises MemberError where its first start ended by itself, at once or for bad input: it lacks something.
        """
        code, now = self.process.poll(), time.monotonic()
        if code is None:
            return
        if self._first and (code == BAD_INPUT or (code > 0 and now - self._began_s < AT_ONCE_S)):
            raise MemberError(self.role, code)
        self._first = False
        if not self._again_s:
            self._wait_s = RESTART_S if now - self._began_s > 60 else min(2 * self._wait_s, RESTART_MOST_S)
            self._again_s = now + self._wait_s
            tell(f"{self.role} ended with {self.process.returncode}; starting again in {self._wait_s:g} s")
        elif now >= self._again_s:
            self._again_s = 0.0
            self.process = self._start()


def threads_each(workers: int) -> int | None:
    """Threads for each of several workers that compute at once: the cores are shared out; None where nothing is said.

    Two ray workers of one thread do more designs than one of two: not all of a design's work is rays.
    """
    if workers < 2 or "LUXLOOP_THREADS" in os.environ:
        return None
    return max(1, usable_cores() // workers)


def watched(settings: Settings, members: list[Member], tell: Callable[[str], None]) -> Watch:
    """A watch over the members of a set, router and controller first."""

    def servers() -> dict[Server, int]:
        return {"router": members[0].process.pid, "controller": members[1].process.pid}

    def workers() -> frozenset[int]:
        return frozenset(member.process.pid for member in members[2:])

    def kill(pid: int, why: str) -> None:
        tell(f"{why}: process {pid} is killed")
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)

    return Watch(settings, servers, workers, kill)


def run_local(settings: Settings, workers: dict[str, int], stop: threading.Event, *, quiet: bool = False) -> None:
    """Keep a set alive until `stop` is set, or whoever started it has gone; then stop all of it.

    Raises before anything is started where the cache folder cannot be used (InputError) or the endpoint is taken
    (LuxloopError), and MemberError where a process fails at once.
    """

    def tell(text: str) -> None:
        if not quiet:
            print(f"local: {text}", file=sys.stderr, flush=True)  # noqa: T201  a server's log goes to stderr

    usable_cache(settings)
    refuse_taken(settings.router)
    roles = ["router", "controller", *(role for role, count in workers.items() for _ in range(count))]
    members = [Member(role, settings, quiet, threads_each(workers.get(role, 1))) for role in roles]
    watch = watched(settings, members, tell)
    try:
        tell(f"{', '.join(roles)} at {settings.router}")
        while not stop.wait(0.2) and not orphaned():
            for member in members:
                member.look_after(tell)
    finally:
        watch.close()
        for member in reversed(members):  # workers first, so that they can hand back what they hold
            member.process.terminate()
        end_s = time.monotonic() + STOP_S
        for member in reversed(members):
            try:
                member.process.wait(max(end_s - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                member.process.kill()
                member.process.wait()
