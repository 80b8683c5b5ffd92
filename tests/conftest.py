"""What all tests share: free ports, a router of one's own, both kinds of bus."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from luxloop.bus import Bus
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.settings import Settings, as_environment
from tests import forks
from tests.forks import Process
from tests.local_bus import LocalBus, LocalRouter


def free_endpoint() -> str:
    """A TCP endpoint on loopback that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def wait_for(condition: Callable[[], object], what: str, limit_s: float = 20.0) -> None:
    """Return as soon as `condition()` is true; fail naming `what` after `limit_s`."""
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            raise AssertionError(f"waited {limit_s} s in vain for {what}")
        time.sleep(0.02)


def start(settings: Settings, *argv: str) -> Process:
    """A process of this Python with the settings in its environment."""
    return forks.start(*argv, env=as_environment(settings))


def stop(process: Process) -> None:
    """End a process for certain."""
    process.kill()
    process.wait(10)


def processes_at(endpoint: str) -> list[str]:
    """The processes that were told this router in their environment."""
    return processes_with(f"LUXLOOP_ROUTER={endpoint}")


def handles(pid: int, number: int) -> bool:
    """Whether a process has a handler of its own for a signal (Linux)."""
    caught = next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("SigCgt:"))
    return bool(int(caught.split()[1], 16) >> (number - 1) & 1)


def state_of(pid: int) -> str:
    """The letter of a process's state: T, it was stopped (Linux)."""
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]


def processes_with(setting: str) -> list[str]:
    """The processes with this `NAME=value` in their environment, this one excepted."""
    found = []
    for environ in Path("/proc").glob("[0-9]*/environ"):
        try:
            held = environ.read_bytes().decode(errors="replace").split("\0")
        except OSError:  # ended while we looked
            continue
        if setting in held and environ.parent.name != str(os.getpid()):
            found.append(environ.parent.name)
    return found


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """Settings with a router port and a cache of their own."""
    folders = {name: tmp_path / name for name in ("cache", "runs", "effects")}
    return Settings(router=free_endpoint(), **folders)


@pytest.fixture
def router(settings: Settings) -> Iterator[Process]:
    """A real router process at `settings.router`."""
    process = start(settings, "-m", "luxloop", "serve", "router")
    try:
        wait_for(lambda: _listens(settings), "the router")
        yield process
    finally:
        stop(process)


@pytest.fixture(params=["zenoh", "in process"])
def new_bus(request: pytest.FixtureRequest) -> Iterator[Callable[[], Bus]]:
    """Opens buses of one set, of either kind; closes them at the end."""
    opened: list[Bus] = []
    if request.param == "zenoh":
        settings = request.getfixturevalue("settings")
        request.getfixturevalue("router")

        def make() -> Bus:
            opened.append(ZenohBus(settings))
            return opened[-1]
    else:
        shared = LocalRouter()

        def make() -> Bus:
            opened.append(LocalBus(shared))
            return opened[-1]

    yield make
    for bus in opened:
        bus.close()


def _listens(settings: Settings) -> bool:
    host, port = settings.router.removeprefix("tcp/").rsplit(":", 1)
    with socket.socket() as probe:
        return probe.connect_ex((host, int(port))) == 0


os.environ.setdefault("LUXLOOP_KERNELS", str(Path("~/.cache/luxloop/kernels").expanduser()))  # compiled at set-up


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests come first, so that no worker is left with a long one at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)
