"""A local set finds out who of it hangs, and starts it again."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from env_controller import watch
from env_controller.local_set import Member, watched
from env_controller.watch import MISSES, SERVER_HUNG_S, WORKER_HUNG_S, Server, Silences
from luxloop import __version__
from luxloop.client import Client
from luxloop.endpoint import listening
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.messages import Describe, Status, WorkerStatus
from luxloop.settings import Settings
from tests.conftest import stop, wait_for

ROUTER: Server = "router"
CONTROLLER: Server = "controller"
SERVERS: dict[Server, int] = {ROUTER: 1, CONTROLLER: 2}
WORKERS = (3, 4)


def status(*pids: int, heard_s_ago: float = 0.5) -> Status:
    """A status that lists the workers with these process ids."""
    workers = tuple(
        WorkerStatus(
            describe=Describe(worker=f"ray-{pid}", kind="ray", version=__version__, host="here", pid=pid),
            heard_s_ago=heard_s_ago,
        )
        for pid in pids
    )
    counts = {"running": 0, "done": 0, "failed": 0, "requeued": 0, "fenced": 0}
    about = {"epoch": "e", "version": __version__, "up_s": 1.0, "now_unix_s": 1.0, "resident_mb": 1.0}
    return Status(**about, workers=workers, queued={}, **counts)


def hung(seen: Sequence[Status | Server], every_s: float = 5.0) -> list[dict[int, str]]:
    """Who is found to hang after each of these."""
    silences = Silences()
    return [silences.note(found, SERVERS, WORKERS, every_s * i) for i, found in enumerate(seen)]


@pytest.mark.parametrize("role", ["router", "controller"])
def test_a_server_is_given_up_after_its_time(role: Server) -> None:
    """Not before; once; the reason names it and the time."""
    found = hung([role] * 6)
    assert [list(one) for one in found] == [[], [], [], [], [SERVERS[role]], []]
    assert found[4][SERVERS[role]] == f"the {role} has not answered for {SERVER_HUNG_S:g} s"


def test_an_answer_begins_the_time_anew() -> None:
    """And so does another one's silence: without a router nobody can say anything of the controller."""
    assert not any(hung([CONTROLLER] * 4 + [status()] + [CONTROLLER] * 4))
    assert not any(hung([CONTROLLER] * 4 + [ROUTER] + [CONTROLLER] * 4))


def test_a_pause_of_the_whole_set_is_nobodys_fault() -> None:
    """One question missed, however long that took."""
    assert not any(hung([CONTROLLER] * (MISSES - 1), every_s=100.0))


def test_a_worker_is_given_up_that_was_listed_once() -> None:
    """One that still starts, or compiles, was not; one that another set owns is left alone."""
    beats = int(WORKER_HUNG_S / 5.0)
    found = hung([status(3, 99)] + [status()] * (beats + 1))
    assert [list(one) for one in found] == [[]] * (beats + 1) + [[3]]
    assert "a worker for 60 s" in found[-1][3]


def test_a_worker_without_a_heartbeat_is_given_up() -> None:
    """It is listed as long as its token stands; what counts is what was heard."""
    seen = [status(3, 4), *[status(3, heard_s_ago=WORKER_HUNG_S + 1.0)] * 13]
    assert [sorted(one) for one in hung(seen)][-1] == [3, 4]


@pytest.mark.parametrize("certificate", [True, False])
def test_an_answer_that_cannot_be_read_does_not_end_the_watch(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, certificate: bool
) -> None:
    """The next question may be answered well; without a certificate there is no session, and none is asked."""
    asked = threading.Event()
    answers = iter([InputError("frame", b"", "a frame")])

    def ask(*_: Any, **__: Any) -> Any:
        for error in answers:
            raise error
        asked.set()
        raise RemoteError(Failure(code="refused", message="enough"))

    def opened(_: Settings) -> Any:
        if not certificate:
            raise InputError("LUXLOOP_CERTS", "", "a folder with certificates")
        return SimpleNamespace(close=lambda: None)

    monkeypatch.setattr(watch, "ASK_EVERY_S", 0.01)
    monkeypatch.setattr(watch, "ask_for", ask)
    monkeypatch.setattr(watch, "ZenohBus", opened)
    looking = watch.Watch(settings, dict, tuple, lambda *_: pytest.fail("somebody was killed"))
    assert asked.wait(10.0 if certificate else 0.2) == certificate
    looking.close()


@pytest.fixture
def members(settings: Settings) -> Iterator[list[Member]]:
    """Router and controller of a set."""
    made = [Member(role, settings, quiet=True) for role in ("router", "controller")]
    yield made
    for member in made:
        stop(member.process)


@pytest.mark.slow
@pytest.mark.parametrize("place", [0, 1])
def test_a_stopped_process_is_started_again(
    settings: Settings, members: list[Member], place: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Router or controller, stopped by SIGSTOP: the set answers again, the other process is as it was."""
    monkeypatch.setattr(watch, "SERVER_HUNG_S", 4.0)
    monkeypatch.setattr(watch, "ASK_EVERY_S", 0.5)
    told, pids = list[str](), [member.process.pid for member in members]
    looking, over = watched(settings, members, told.append), threading.Event()

    def look_after() -> None:
        while not over.wait(0.2):
            for member in members:
                member.look_after(told.append)

    thread = threading.Thread(target=look_after)
    thread.start()
    try:
        wait_for(lambda: listening(settings.router), "the router")
        with Client(settings, local=False) as client:
            os.kill(pids[place], signal.SIGSTOP)
            wait_for(lambda: any("is killed" in line for line in told), "the watch", 60.0)
            client.status(30.0)
        assert members[1 - place].process.pid == pids[1 - place]
        assert members[place].process.pid != pids[place]
    finally:
        over.set()
        thread.join()
        looking.close()
