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
    """The four processes of `luxloop serve local`, kept from command to command until the end of the block."""
    running = RunningSet(settings)
    try:
        for role in ("thin-film", "ray-tracing"):
            running.add("-m", "luxloop", "serve", role, "--quiet")
        wait_for(lambda: len(running.client.status(5.0).workers) == 2, "two workers", 300.0)  # kernels are compiled
        yield
    finally:
        running.close()
