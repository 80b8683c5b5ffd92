"""The set of processes on this machine: what ends it at its start, what only ends a process."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from env_controller import local_set
from env_controller.local_set import Member, MemberError, run_local, threads_each
from luxloop.errors import InputError
from luxloop.settings import Settings, as_environment
from tests.conftest import processes_at, stop


@pytest.fixture
def ended() -> Iterator[threading.Event]:
    """An event that ends a set which would go on for ever."""
    event = threading.Event()
    timer = threading.Timer(30.0, event.set)
    timer.start()
    yield event
    timer.cancel()


@pytest.fixture(params=["a stranger", "a router"])
def taken(request: pytest.FixtureRequest, settings: Settings) -> Iterator[Settings]:
    """Settings whose endpoint is taken by a program that knows no zenoh, or by another router."""
    if request.param == "a router":
        request.getfixturevalue("router")
        yield settings
        return
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield settings.model_copy(update={"router": f"tcp/127.0.0.1:{listener.getsockname()[1]}"})


@pytest.mark.parametrize("role", ["local", "router"])
def test_a_taken_port_ends_it_with_one_clear_line(taken: Settings, role: str) -> None:
    """Exit 1, the endpoint, the mend; nothing of zenoh's source, nothing left, not tried again and again."""
    done = subprocess.run(
        [sys.executable, "-m", "luxloop", "serve", role, "--quiet"],
        env=as_environment(taken) | {"LUXLOOP_REALM": f"second-{role}"},
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert f"cannot listen at {taken.router}: something listens there already" in line
    assert "--router" in line
    assert ".rs" not in line


def test_a_member_that_fails_at_once_ends_the_set(
    settings: Settings, ended: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With its exit code (2: there is no such role), naming it; router and controller are stopped."""
    monkeypatch.setattr(local_set, "AT_ONCE_S", 0.0)  # bad input is bad however slowly a loaded machine starts
    with pytest.raises(MemberError, match="the nonsense ended with 2") as caught:
        run_local(settings, {"nonsense": 1}, ended, quiet=True)
    assert caught.value.exit_code == 2
    assert processes_at(settings.router) == []


def test_a_member_that_breaks_at_once_ends_the_set(
    settings: Settings, ended: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever its exit code says: it lacks something, and would again."""
    monkeypatch.setattr(local_set, "AT_ONCE_S", 25.0)
    monkeypatch.setattr(local_set.sys, "executable", "/bin/false")
    with pytest.raises(MemberError, match="the router ended with 1"):
        run_local(settings, {}, ended, quiet=True)


def test_a_member_that_was_killed_at_once_is_started_again(settings: Settings) -> None:
    """Somebody else's signal says nothing against it."""
    member, told = Member("router", settings, quiet=True), list[str]()
    try:
        first = member.process.pid
        member.process.send_signal(signal.SIGKILL)
        member.process.wait(10)
        while member.process.pid == first:
            member.look_after(told.append)
    finally:
        stop(member.process)
    assert told == ["router ended with -9; starting again in 1 s"]


def test_an_unusable_cache_ends_the_set_before_it_starts(settings: Settings, tmp_path: Path) -> None:
    """A worker that cannot keep anything would otherwise be started for ever."""
    (tmp_path / "file").touch()
    bad = settings.model_copy(update={"cache": tmp_path / "file"})
    with pytest.raises(InputError, match="LUXLOOP_CACHE"):
        run_local(bad, {"thin-film": 1}, threading.Event())
    assert processes_at(settings.router) == []


def test_several_ray_workers_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of them has all, unless the user said how many threads; two have half each, many have one."""
    monkeypatch.setattr("env_controller.local_set.usable_cores", lambda: 4)
    monkeypatch.delenv("LUXLOOP_THREADS", raising=False)
    assert [threads_each(workers) for workers in (1, 2, 3, 4, 9)] == [None, 2, 1, 1, 1]
    monkeypatch.setenv("LUXLOOP_THREADS", "3")
    assert threads_each(2) is None
