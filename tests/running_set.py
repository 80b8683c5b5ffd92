"""A router and a controller as real processes, workers that can be added and killed, for tests that need a set."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from luxloop.client import Client
from luxloop.errors import RemoteError
from luxloop.settings import Settings
from tests.conftest import start, stop, wait_for
from tests.forks import Process


class RunningSet:
    """Router and controller, no worker yet. Close it at the end."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.router = self.start_router()
        self.controller = start(settings, "-m", "luxloop", "serve", "controller", "--quiet")
        self.workers: list[Process] = []
        wait_for(self._answers, "the controller")
        self.client = Client(settings, local=False)

    def start_router(self) -> Process:
        """A router process; a second one after the first was killed."""
        return start(self.settings, "-m", "luxloop", "serve", "router", "--quiet")

    def add(self, *argv: str) -> Process:
        """One more worker process."""
        self.workers.append(start(self.settings, *argv))
        return self.workers[-1]

    def ready(self, count: int) -> None:
        """Wait until so many workers have introduced themselves."""
        wait_for(lambda: len(self.client.status(5.0).workers) == count, f"{count} workers")

    def close(self) -> None:
        """End all of it."""
        self.client.close()
        for process in [*self.workers, self.controller, self.router]:
            stop(process)

    def _answers(self) -> bool:
        try:
            Client(self.settings, local=False).close()
        except RemoteError:
            return False
        return True


@contextmanager
def local_set(settings: Settings) -> Iterator[None]:
    """A set as `luxloop serve local` starts it, kept from command to command until the end of the block."""
    process = start(settings, "-m", "luxloop", "serve", "local", "--quiet")
    try:
        wait_for(lambda: _workers(settings) == 2, "two workers", 60.0)
        yield
    finally:
        process.terminate()
        process.wait(30)


def _workers(settings: Settings) -> int:
    """How many answer."""
    try:
        with Client(settings, local=False) as client:
            return len(client.status(1.0).workers)
    except RemoteError:
        return 0
