"""`python healthy.py listens|connected`: exit 0 where this container's process does its part, else 1 and why not.

listens     for the router: it answers a TLS handshake, with its own certificate on both sides
connected   for all others: the process has a session with the router. zenoh ends it within 4 s where the process
            hangs or the network is cut, and at once where a certificate does not fit or has expired

Cheap on purpose (the standard library, some 30 ms), for it runs again and again. Whether a worker gets on with its
task is told by its heartbeats: the controller watches them, `luxloop doctor` shows them.
"""

from __future__ import annotations

import os
import socket
import ssl
import sys
from pathlib import Path

ESTABLISHED = "01"
HANDSHAKE_S = 3.0
SOCKETS = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))


def listens(port: int, certificates: Path) -> str:
    """Why a session could not be opened at this port of our own; empty where it could."""
    context = ssl.create_default_context(cafile=certificates / "ca.pem")
    context.load_cert_chain(certificates / "router.pem")
    try:
        with socket.create_connection(("localhost", port), HANDSHAKE_S) as plain:
            context.wrap_socket(plain, server_hostname="localhost").close()
    except OSError as error:
        return f"no TLS session at port {port}: {error}"
    return ""


def connected(port: int, tables: str) -> str:
    """What is wrong if no socket of this container is connected to that port elsewhere; else empty.

    `tables` is what Linux shows in /proc/net/tcp: number, local and remote address:port in hex, state, and more.
    """
    rows = (line.split() for line in tables.splitlines())
    if any(row[3] == ESTABLISHED and row[2].endswith(f":{port:04X}") for row in rows if len(row) > 3):
        return ""
    return f"no session with the router, port {port}"


def main() -> int:
    """The exit code, after the reason was printed."""
    port = int(os.environ["LUXLOOP_ROUTER"].rpartition(":")[2])
    if sys.argv[1:] == ["listens"]:
        wrong = listens(port, Path(os.environ["LUXLOOP_CERTS"]))
    else:
        wrong = connected(port, "".join(path.read_text() for path in SOCKETS if path.exists()))
    sys.stdout.write(wrong and wrong + "\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
