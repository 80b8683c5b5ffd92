"""A client that starts its own set of processes."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from luxloop import client as clients
from luxloop.client import Client
from luxloop.errors import RemoteError
from luxloop.settings import Settings


def test_a_set_that_ends_at_once_is_told_from_one_that_is_slow(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody waits a minute for processes that are gone, and what to do is said."""
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(RemoteError, match="ended at once") as caught:
        Client(settings)
    assert caught.value.failure.code == "no_router"
    assert "luxloop serve local" in caught.value.failure.mend


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
