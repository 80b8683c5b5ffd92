"""Handshakes that are tried to find out why a session does not come about."""

from __future__ import annotations

import gc
import select
import socket
import struct
from typing import Any

import pytest

from luxloop.bus import identity
from luxloop.settings import Settings


def test_a_router_that_is_killed_before_the_handshake_leaves_no_socket_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its connection is reset: a test of killed routers had failed by the warning, one run in many."""
    with socket.socket() as router:
        router.bind(("127.0.0.1", 0))
        router.listen()
        connected = socket.create_connection

        def reset(*address: Any) -> socket.socket:
            ours = connected(*address)
            theirs, _ = router.accept()
            theirs.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            theirs.close()
            select.select([ours], [], [], 5.0)
            return ours

        monkeypatch.setattr(socket, "create_connection", reset)
        settings = Settings(router=f"tcp/127.0.0.1:{router.getsockname()[1]}")
        assert identity._unexpected_tls(settings) is None
        gc.collect()
