"""A run whose workers have gone waits for them; somebody should be told."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from luxloop.client import Client
from luxloop.errors import RemoteError

KINDS = ("film", "ray")
LOOK_S = 15.0
SAY_S = 60.0
"""After so long without a worker of a kind, and each so long since: one that starts compiles its kernels."""


@contextmanager
def workers_watched(
    client: Client, tell: Callable[[str], None], look_s: float = LOOK_S, say_s: float = SAY_S
) -> Iterator[None]:
    """While inside, `tell` hears which kind of worker the run waits for; nothing where both are there."""
    left = threading.Event()
    watch = (client, tell, left, look_s, say_s)
    thread = threading.Thread(target=_watch, args=watch, name="workers-watched", daemon=True)
    thread.start()
    try:
        yield
    finally:
        left.set()
        thread.join()


def _watch(client: Client, tell: Callable[[str], None], left: threading.Event, look_s: float, say_s: float) -> None:
    seen_s, told_s = dict.fromkeys(KINDS, time.monotonic()), dict.fromkeys(KINDS, time.monotonic())
    while not left.wait(look_s):
        try:
            there = {worker.describe.kind for worker in client.status().workers}
        except RemoteError:  # nobody knows; who asks for steps says so
            continue
        now_s = time.monotonic()
        for kind in KINDS:
            if kind in there:
                seen_s[kind] = told_s[kind] = now_s
            elif now_s - told_s[kind] >= say_s:
                told_s[kind] = now_s
                waited_s = now_s - seen_s[kind]
                tell(f"no {kind} worker for {waited_s:.0f} s: the run waits for one (luxloop doctor says more)")
