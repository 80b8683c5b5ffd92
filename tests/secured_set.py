"""A set over mTLS as real processes, each with its own role's folder only; papers of any kind beside it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

from env_controller.certs import Authority, make
from luxloop.client import Client
from luxloop.endpoint import listening
from luxloop.errors import RemoteError
from luxloop.settings import Settings
from tests.conftest import free_endpoint, start, stop, wait_for
from tests.forks import Process

PRETEND = str(Path(__file__).with_name("pretend_worker.py"))
DAY = timedelta(days=1)


def free_tls_endpoint() -> str:
    """A TLS endpoint on loopback that nobody listens at."""
    return free_endpoint().replace("tcp/", "tls/")


@contextmanager
def running_router(settings: Settings) -> Iterator[None]:
    """A router process while inside."""
    process = start(settings, "-m", "luxloop", "serve", "router", "--quiet")
    try:
        wait_for(lambda: listening(settings.router), "the router")
        yield
    finally:
        stop(process)


class SecuredSet:
    """Router, controller, and two workers that pretend. Close it at the end."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.certs = folder, folder / "certs"
        make(self.certs, days=2)
        self.authority = Authority.read(self.certs)
        places = {name: folder / name for name in ("cache", "runs", "effects")}
        self.settings = Settings(
            router=free_tls_endpoint(), certs=self.certs, heartbeat_s=0.1, silence_s=5.0, **places
        )
        self.processes = [
            self._start("router", "-m", "luxloop", "serve", "router", "--quiet"),
            self._start("controller", "-m", "luxloop", "serve", "controller", "--quiet"),
            self._start("thin-film", PRETEND, "film"),
            self._start("ray-tracing", PRETEND, "ray"),
        ]
        wait_for(self._answers, "the controller")
        self.client = Client(self.settings, local=False)
        wait_for(lambda: len(self.client.status(5.0).workers) == 2, "two workers")

    def with_certs(self, folder: Path) -> Settings:
        """The settings of somebody who has another folder of certificates."""
        return self.settings.model_copy(update={"certs": folder})

    def worker(self, kind: str) -> str:
        """The name of the worker of that kind."""
        return next(w.describe.worker for w in self.client.status(5.0).workers if w.describe.kind == kind)

    def papers(
        self,
        name: str,
        *,
        role: str = "client",
        authority: Authority | None = None,
        begin: timedelta = -DAY,
        end: timedelta = DAY,
    ) -> Settings:
        """Settings with a client's file of our choice beside the set's true CA."""
        folder, now = self.folder / name, datetime.now(UTC)
        folder.mkdir(exist_ok=True)
        (folder / "ca.pem").write_bytes((self.certs / "ca.pem").read_bytes())
        (folder / "client.pem").touch(mode=0o600)
        signed = (authority or self.authority).issue(role, (), now + begin, now + end)
        (folder / "client.pem").write_bytes(signed)
        return self.with_certs(folder)

    def close(self) -> None:
        """End all of it."""
        self.client.close()
        for process in reversed(self.processes):
            stop(process)

    def _start(self, role: str, *argv: str) -> Process:
        return start(self.with_certs(self.certs / role), *argv)

    def _answers(self) -> bool:
        try:
            Client(self.settings, local=False).close()
        except RemoteError:
            return False
        return True
