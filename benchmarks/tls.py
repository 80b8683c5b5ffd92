"""What certificates cost: `python -m benchmarks.tls`.

A router process; on plain tcp and over mTLS: opening a session, a question and its answer of several sizes between
two sessions through the router, one after the other. Then what the certificates cost before a session is opened.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.processes import percentile, table, wait_for
from env_controller.certs import make
from luxloop.bus import Asked, Inbox
from luxloop.bus.identity import Identity, answering
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.endpoint import free_loopback, listening
from luxloop.settings import Settings, as_environment

SESSIONS = 30
SIZES = {"1 KB": (1 << 10, 500), "100 KB": (100 << 10, 200), "4 MB": (4 << 20, 30)}
STATUS = at("luxloop", "status")


def main() -> None:
    """Print the table."""
    columns: dict[str, list[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begin_s = time.perf_counter()
        make(folder / "certs", days=1)
        made_ms = 1e3 * (time.perf_counter() - begin_s)
        for kind, certs in (("tcp", None), ("tls", folder / "certs")):
            settings = Settings(router=free_loopback(f"{kind}/"), certs=certs, cache=folder)
            with running(settings):
                columns[kind] = [*opening(settings), *asking(settings)]
    heads = ["open a session, p50", "p99", *(f"{size}, {p}" for size in SIZES for p in ("p50", "p99"))]
    rows = list(zip(heads, columns["tcp"], columns["tls"], strict=True))
    table("one router process, two sessions in another one; milliseconds", rows, ("", "tcp", "tls with certificates"))
    print(f"\na whole set of certificates is made in {made_ms:.0f} ms")


@contextmanager
def running(settings: Settings) -> Iterator[None]:
    """A router process while inside."""
    argv = [sys.executable, "-m", "luxloop", "serve", "router", "--quiet"]
    process = subprocess.Popen(argv, env=as_environment(settings), stdin=subprocess.DEVNULL)
    try:
        wait_for(lambda: listening(settings.router))
        time.sleep(0.5)
        yield
    finally:
        process.kill()
        process.wait()


def opening(settings: Settings) -> list[str]:
    """As a client does it: look whether somebody listens, then open."""
    taken = []
    for _ in range(SESSIONS):
        begin_s = time.perf_counter()
        answering(settings, Identity.of(settings, "client"))
        bus = ZenohBus(settings)
        taken.append(1e3 * (time.perf_counter() - begin_s))
        bus.close()
    return [f"{percentile(taken, 50):.1f}", f"{percentile(taken, 99):.1f}"]


def asking(settings: Settings) -> list[str]:
    """Milliseconds of a question answered with as many bytes."""
    cells, inbox, over = [], Inbox(), threading.Event()

    def serve() -> None:
        while not over.is_set():
            event = inbox.take(0.1)
            if isinstance(event, Asked):
                event.answer(event.frame)

    with ZenohBus(settings, role="controller") as server, ZenohBus(settings) as client:
        server.answer(STATUS, inbox)
        threading.Thread(target=serve, daemon=True).start()
        time.sleep(0.3)
        for size, count in SIZES.values():
            taken = []
            for _ in range(count):
                begin_s = time.perf_counter()
                client.ask(STATUS, bytes(size), 10.0)
                taken.append(1e3 * (time.perf_counter() - begin_s))
            cells += [f"{percentile(taken, 50):.2f}", f"{percentile(taken, 99):.2f}"]
        over.set()
    return cells


if __name__ == "__main__":
    main()
