"""Could a router listen at an endpoint: asked before one is started."""

from __future__ import annotations

import errno
import socket
from typing import Any

from luxloop.endpoint import host_and_port
from luxloop.errors import LuxloopError


def refuse_taken(endpoint: str) -> None:
    """Raises LuxloopError, with the mend, where no router could listen at `endpoint` now; returns nothing."""
    host, port = host_and_port(endpoint)
    try:
        wrong = [_refusal(*address) for address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)]
    except OSError as error:  # no such host
        wrong = [error]
    if None in wrong:  # a name may have several addresses: one is enough
        return
    taken = any(error is not None and error.errno == errno.EADDRINUSE for error in wrong)
    why = "something listens there already" if taken else getattr(wrong[0], "strerror", None) or str(wrong[0])
    look = "use it as it is (luxloop doctor says what it is), or " if taken else ""
    raise LuxloopError(f"cannot listen at {endpoint}: {why}; {look}choose another with --router or LUXLOOP_ROUTER")


def _refusal(family: int, kind: int, protocol: int, _name: str, address: tuple[Any, ...]) -> OSError | None:
    """What the system says against listening at this address; as for zenoh, one that listened before is no hurdle."""
    try:
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        return error
    return None
