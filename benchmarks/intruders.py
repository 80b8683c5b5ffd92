"""Who is not let in, or not let do what they try: `python -m benchmarks.intruders`.

A router, a controller and two workers over mTLS as real processes; every try of tests/intruding.py against them, and
after each an honest task. Then connections that say nothing, many at once.
"""

from __future__ import annotations

import socket
import tempfile
import time
from pathlib import Path

from benchmarks.processes import table
from luxloop import __version__
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.endpoint import host_and_port
from luxloop.errors import RemoteError
from luxloop.messages import Task
from tests.intruding import NO_SESSION, NOT_PERMITTED, SEEN_BY_THE_CONTROLLER, GotThroughError, Try
from tests.secured_set import SecuredSet

WIDTH = 100


def main() -> None:
    """Print the tables."""
    with tempfile.TemporaryDirectory() as folder:
        lab = SecuredSet(Path(folder))
        try:
            through = [
                *show(lab, "no session", NO_SESSION),
                *show(lab, "a session, but not permitted: refused at the router", NOT_PERMITTED),
                *show(lab, "permitted keys, false contents: refused at the controller", SEEN_BY_THE_CONTROLLER),
            ]
            print(f"\n{len(through)} got through" + "".join(f"; {tried.who}: {tried.what}" for tried in through))
            silence(lab)
        finally:
            lab.close()


def show(lab: SecuredSet, title: str, tries: tuple[Try, ...]) -> list[Try]:
    """Try all of them, print what happened; those that got through."""
    rows, through = [], []
    for tried in tries:
        try:
            said = tried.do(lab)
        except GotThroughError as error:
            said, _ = f"GOT THROUGH: {error}", through.append(tried)
        said = said.replace(str(lab.folder), "DIR").replace(lab.settings.router, "tls/ROUTER")
        rows.append((tried.who, tried.what, said[:WIDTH], honest(lab)))
    table(title, rows, ("who", "tries", "what happens", "an honest task then"))
    return through


def honest(lab: SecuredSet) -> str:
    """How an honest client's task goes."""
    begin_s = time.monotonic()
    try:
        lab.client.run(Task(kind="film", inputs={"number": 1}, version=__version__), fresh=True, limit_s=10.0)
    except RemoteError as error:
        return error.failure.text()[:40]
    return f"{1e3 * (time.monotonic() - begin_s):.0f} ms"


def silence(lab: SecuredSet) -> None:
    """Open connections that say nothing, then drop them: what an honest client that comes then waits for."""
    rows = []
    for count in (1, 10, 50, 200):
        held = [socket.create_connection(host_and_port(lab.settings.router), 2.0) for _ in range(count)]
        beside = until_in(lab)
        for connection in held:
            connection.close()
        after, running = until_in(lab), honest(lab)
        rows.append((count, f"{beside:.2f} s", f"{after:.2f} s", running))
    heads = (
        "silent connections",
        "a new session beside them",
        "a new session after they close",
        "an open session's task",
    )
    table("connections that say nothing (the router drops each after 10 s)", rows, heads)


def until_in(lab: SecuredSet) -> float:
    """Seconds until a new session is open, tried again where it fails."""
    begin_s = time.monotonic()
    while True:
        try:
            with ZenohBus(lab.settings):
                return time.monotonic() - begin_s
        except RemoteError:
            if time.monotonic() - begin_s > 60.0:
                raise


if __name__ == "__main__":
    main()
