"""A TCP proxy between a process and the router whose link can be slowed, cut and reset."""

from __future__ import annotations

import math
import socket
import struct
import threading
import time
from contextlib import suppress

from luxloop.endpoint import host_and_port

PIECE_BYTES = 4096
RESET = struct.pack("ii", 1, 0)  # linger for 0 s: closing sends a reset


class Proxy:
    """Listens at `endpoint` and passes everything on to `target`, both as the settings write them.

    `bytes_per_s` and `delay_s` hold for each direction of each connection and may be changed at any time.
    """

    def __init__(self, target: str, host: str = "127.0.0.1") -> None:
        self._target = host_and_port(target)
        self._listener = socket.create_server((host, 0))
        self.endpoint = f"tcp/{host}:{self._listener.getsockname()[1]}"
        self.bytes_per_s, self.delay_s = math.inf, 0.0
        self._flows = threading.Event()
        self._flows.set()
        self._ends: set[socket.socket] = set()
        self._lock = threading.Lock()
        threading.Thread(target=self._accept, daemon=True).start()

    def slow(self, bytes_per_s: float, delay_s: float) -> None:
        """From now on this fast; `fast` ends it."""
        self.bytes_per_s, self.delay_s = bytes_per_s, delay_s

    def fast(self) -> None:
        """As fast as it goes."""
        self.slow(math.inf, 0.0)

    def cut(self) -> None:
        """Nothing gets through, and nobody is told, as when a cable is pulled; `heal` ends it."""
        self._flows.clear()

    def heal(self) -> None:
        """What waits gets through."""
        self._flows.set()

    def reset(self) -> None:
        """Every connection is reset; new ones are taken."""
        with self._lock:
            ends, self._ends = self._ends, set()
        for end in ends:
            _let_go(end, reset=True)

    def close(self) -> None:
        """End all of it."""
        _let_go(self._listener)
        self.heal()
        self.reset()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(self._target, timeout=2.0)
            except OSError:  # the router is away
                _let_go(near)
                continue
            far.settimeout(None)
            with self._lock:
                self._ends |= {near, far}
            for ends in ((near, far), (far, near)):
                threading.Thread(target=self._pass_on, args=ends, daemon=True).start()

    def _pass_on(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(PIECE_BYTES):
                if self.delay_s or self.bytes_per_s < math.inf:
                    time.sleep(self.delay_s + len(data) / self.bytes_per_s)
                self._flows.wait()
                sink.sendall(data)
        with self._lock:  # those that a reset has taken are its own
            mine = self._ends & {source, sink}
            self._ends -= mine
        for end in mine:
            _let_go(end)


def _let_go(end: socket.socket, *, reset: bool = False) -> None:
    """Close a socket so that the other side, and a thread of ours that waits for it, notice at once."""
    with suppress(OSError):
        if reset:
            end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        end.shutdown(socket.SHUT_RD if reset else socket.SHUT_RDWR)
    end.close()
