"""A pretend worker of a lab: it notes what it computes, holds the GIL on SIGUSR1, and obeys the lab's orders.

python -m tests.nemesis.worker film|ray NAP_S HISTORY ORDERS

An order is a file `<kind>-*.json` in the folder ORDERS: whoever computes next takes it. `nap_s` is how long that one
takes, `lie` that it answers wrongly.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from luxloop.bus.frame import Array
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.computation import Progress
from luxloop.settings import load_settings
from luxloop.words import sha256_of
from luxloop.worker import Worker
from tests.nemesis.history import History
from tests.pretend_worker import Pretend

GIL_FILE = "gil_s"


class Obedient(Pretend):
    """As `Pretend`, but for what it is ordered."""

    def __init__(self, kind: str, nap_s: float, history: History, orders: Path) -> None:
        super().__init__(kind, nap_s)
        self._history, self._orders = history, orders

    def compute(self, inputs: dict[str, Any], progress: Progress) -> tuple[dict[str, Any], Mapping[str, Array]]:
        """Its answer, after the nap; or a lie."""
        order = self._order()
        about = {"inputs": sha256_of(inputs), "lie": bool(order.get("lie"))}
        self._history.note("computes", **about)
        try:
            result, arrays = Pretend(self.kind, order.get("nap_s", self._nap_s)).compute(inputs, progress)
        finally:
            self._history.note("computed", **about)
        if order.get("lie"):
            result["metrics"]["uniformity"]["value"] = 0.125
        return result, arrays

    def _order(self) -> dict[str, Any]:
        """The oldest order for its kind; taken by one worker only."""
        for path in sorted(self._orders.glob(f"{self.kind}-*.json")):
            mine = path.with_suffix(f".{os.getpid()}")
            try:
                path.rename(mine)
            except FileNotFoundError:
                continue
            found: dict[str, Any] = json.loads(mine.read_text())
            return found
        return {}


def hold_gil(orders: Path) -> None:
    """A C call that does not let go of the GIL: no heartbeat, while the session's own threads go on."""
    ctypes.PyDLL(None).usleep(ctypes.c_uint(int(float((orders / GIL_FILE).read_text()) * 1e6)))


def main(kind: str, nap_s: str, history: str, orders: str) -> None:
    """Work until SIGTERM."""
    chosen = load_settings()
    signal.signal(signal.SIGUSR1, lambda *_: hold_gil(Path(orders)))
    with ZenohBus(chosen, patient=True, role="thin-film" if kind == "film" else "ray-tracing") as bus:
        Worker(Obedient(kind, float(nap_s), History(Path(history)), Path(orders)), bus, chosen).run()


if __name__ == "__main__":
    main(*sys.argv[1:])
