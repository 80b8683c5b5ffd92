"""A worker's loop, where we are the controller that it asks."""

from __future__ import annotations

import sqlite3
import threading
from dataclasses import replace

import pytest

from luxloop.bus import Asked, Heard, Inbox
from luxloop.bus.frame import decode, encode
from luxloop.bus.keys import KEYS, at
from luxloop.failure import Failure
from luxloop.messages import BlobAsked, Introduce
from luxloop.settings import Settings
from luxloop.worker import Worker
from tests.local_bus import LocalBus, LocalRouter
from tests.sleepy_worker import Sleepy


def test_a_held_poll_does_not_keep_a_worker_that_is_to_leave(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its loop ends with the word to leave, not with the poll, which would be held for two minutes here."""
    monkeypatch.setitem(KEYS, "pull", replace(KEYS["pull"], time_limit_s=120.0))
    router, asked = LocalRouter(), Inbox()
    LocalBus(router).answer(at(settings.realm, "pull"), asked)
    worker = Worker(Sleepy(), LocalBus(router), settings)
    worker._epoch = "e1"
    working = threading.Thread(target=worker._work, daemon=True)
    working.start()
    assert isinstance(asked.take(60.0), Asked)
    worker._leaving.set()
    working.join(60.0)
    assert not working.is_alive()


def test_a_store_that_cannot_be_read_does_not_end_its_worker(settings: Settings) -> None:
    """Who asked for the blob is told; the worker goes on until it is to leave."""

    class Locked(Sleepy):
        def blob(self, sha256: str) -> bytes | None:
            raise sqlite3.OperationalError(f"{sha256}: database is locked")

    worker = Worker(Locked(), LocalBus(LocalRouter()), settings)
    frames: list[bytes] = []

    def answered(frame: bytes) -> None:
        frames.append(frame)
        worker._leaving.set()

    key = at(settings.realm, "blob", sha256="0" * 64, worker=worker.name)
    worker._inbox.offer(Asked(key, encode(BlobAsked()), answered, lambda: None))
    worker._attend(threading.current_thread())
    failure = decode(frames[0]).message
    assert isinstance(failure, Failure)
    assert "database is locked" in failure.message


@pytest.mark.parametrize("frame", [encode(BlobAsked()), b"junk"], ids=["question", "junk"])
def test_a_key_of_any_length_ends_no_worker(settings: Settings, frame: bytes) -> None:
    """`*` reaches every worker at once: what is no hash is bad input to each, however it was put."""
    worker = Worker(Sleepy(), LocalBus(LocalRouter()), settings)
    frames: list[bytes] = []

    def answered(frame: bytes) -> None:
        frames.append(frame)
        worker._leaving.set()

    key = at(settings.realm, "blob", sha256="a" * 5000)
    worker._inbox.offer(Asked(key, frame, answered, lambda: None))
    worker._attend(threading.current_thread())
    failure = decode(frames[0]).message
    assert isinstance(failure, Failure)
    assert failure.code == "bad_input"


def test_a_message_that_cannot_be_handled_is_not_the_last(
    settings: Settings, caplog: pytest.LogCaptureFixture
) -> None:
    """It is logged; the next one is taken as any other."""

    class Speechless(Sleepy):
        def catalogue(self) -> dict[str, object]:
            if len(worker._inbox) == 0:
                worker._leaving.set()
            raise ArithmeticError("no words for it")

    worker = Worker(Speechless(), LocalBus(LocalRouter()), settings)
    for _ in range(2):
        worker._inbox.offer(Heard(worker._key("cancel"), encode(Introduce())))
    worker._attend(threading.current_thread())
    assert caplog.text.count("ArithmeticError: no words for it") == 2


def test_a_worker_that_cannot_say_what_it_can_do_ends_with_the_reason(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not as one that was told to leave: its exit code is not 0, and the reason is seen."""

    class Wordless(Sleepy):
        def catalogue(self) -> dict[str, object]:
            return {"effects": "m\udce4rz"}

    monkeypatch.setattr("luxloop.worker.signal.signal", lambda *_: None)
    with pytest.raises(ValueError, match="catalogue"):
        Worker(Wordless(), LocalBus(LocalRouter()), settings).run()
