"""A client that starts its own set of processes."""

from __future__ import annotations

import sys

import pytest

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
