"""A client that starts its own set of processes."""

from __future__ import annotations

import subprocess
import sys
import time
from typing import Any

import pytest

from luxloop import __version__
from luxloop import client as clients
from luxloop.bus.frame import Parcel
from luxloop.client import Client
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.messages import Outcome, Pending, Submit, Task
from luxloop.settings import Settings
from luxloop.words import Words
from tests.conftest import wait_for
from tests.local_bus import LocalBus, LocalRouter

TASK = Task(kind="film", inputs={}, version="v")
PENDING = Pending(task_id=TASK.id, state="running")
OUTCOME = Outcome(task_id=TASK.id, result={"R": 0.5})
GONE = Failure(code="not_found", message="nobody holds its arrays")
BUSY = Failure(code="busy", message="queue full")


def test_a_set_that_ends_at_once_is_told_from_one_that_is_slow(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody waits a minute for processes that are gone, and what to do is said."""
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(RemoteError, match="has ended") as caught:
        Client(settings)
    assert caught.value.failure.code == "no_router"
    assert "luxloop serve local" in caught.value.failure.mend


def test_a_set_whose_worker_cannot_start_is_not_waited_for(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends as soon as router and controller answer."""
    monkeypatch.setenv("LUXLOOP_THREADS", "abc")
    monkeypatch.setattr(clients, "START_S", 600.0)
    begun_s = time.monotonic()
    gone = pytest.raises(RemoteError, match="the local set of processes has ended")
    with gone, Client(settings, patience_s=600.0) as client:  # the controller may answer before the worker has ended
        client.run(Task(kind="ray", inputs={}, version=__version__))
    assert time.monotonic() - begun_s < 60


def test_a_set_that_is_killed_ends_the_wait_for_its_answers(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever is patient with a controller that is away is told at once where none will come."""
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(popen(*arguments, **options))
        return started[-1]

    monkeypatch.setattr(clients.subprocess, "Popen", start)
    with Client(settings, patience_s=600.0) as client:
        started[0].kill()
        wait_for(lambda: not clients.listening(client.settings.router), "the router's end")
        begun_s = time.monotonic()
        for ask in (lambda: client.run(TASK), lambda: client.status(600.0)):
            with pytest.raises(RemoteError, match="the local set of processes has ended"):
                ask()
        assert time.monotonic() - begun_s < 60


def test_ctrl_c_while_a_set_starts_ends_it(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has a session of its own, so nobody else would tell it while this process lives."""
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(_: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(popen(["sleep", "60"], **options))
        return started[0]

    def interrupted(_: str) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr(clients.subprocess, "Popen", start)
    monkeypatch.setattr(clients, "listening", interrupted)
    with pytest.raises(KeyboardInterrupt):
        Client(settings)
    assert started[0].poll() is not None


class TestFresh:
    """What is computed again, and how often."""

    @pytest.mark.parametrize(
        ("fresh", "answers", "asked"),
        [
            (True, [PENDING, PENDING, OUTCOME], [True, False, False]),
            (True, [BUSY, PENDING, OUTCOME], [True, True, False]),
            (False, [PENDING, OUTCOME], [False, False]),
            (False, [GONE, PENDING, OUTCOME], [False, True, False]),
        ],
    )
    def test_one_who_waits_for_it_does_not_wish_it_fresh_again(
        self, monkeypatch: pytest.MonkeyPatch, fresh: bool, answers: list[Words], asked: list[bool]
    ) -> None:
        """What was delivered between a Pending and the next question is the fresh answer."""
        wishes = scripted(monkeypatch, answers)
        with Client(Settings()) as client:
            assert client.run(TASK, fresh=fresh).result == {"R": 0.5}
        assert wishes == asked

    @pytest.mark.parametrize(("fresh", "tries"), [(True, 1), (False, 2)])
    def test_arrays_that_are_gone_are_computed_once_more(
        self, monkeypatch: pytest.MonkeyPatch, fresh: bool, tries: int
    ) -> None:
        """And not for ever, where they have gone again."""
        wishes = scripted(monkeypatch, [PENDING, GONE] * 9)
        with Client(Settings()) as client, pytest.raises(RemoteError, match="nobody holds"):
            client.run(TASK, fresh=fresh)
        assert wishes == [fresh, False, True, False][: 2 * tries]


def scripted(monkeypatch: pytest.MonkeyPatch, answers: list[Words]) -> list[bool]:
    """Let clients be told these answers; whether each of their wishes was for a fresh computation."""
    wishes: list[bool] = []
    left = iter(answers)

    def told(_bus: LocalBus, _key: str, message: Words, *_: Any, **__: Any) -> Parcel:
        assert isinstance(message, Submit)
        wishes.append(message.fresh)
        answer = next(left)
        if isinstance(answer, Failure):
            raise RemoteError(answer)
        return Parcel(answer)

    monkeypatch.setattr(Client, "status", lambda *_: None)
    monkeypatch.setattr(clients, "answering", lambda *_: True)
    monkeypatch.setattr(clients, "ZenohBus", lambda _: LocalBus(LocalRouter()))
    monkeypatch.setattr(clients, "ask_for", told)
    return wishes
