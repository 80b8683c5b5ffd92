"""A worker's loop, where we are the controller that it asks."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest

from luxloop.bus import Asked, Inbox
from luxloop.bus.keys import KEYS, at
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
