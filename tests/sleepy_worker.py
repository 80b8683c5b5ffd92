"""A worker that computes nothing: naps, crashes, holds the GIL, returns what it is told. Run as a script."""

from __future__ import annotations

import ctypes
import os
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from luxloop.bus.frame import Array
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.computation import Progress
from luxloop.errors import InputError
from luxloop.settings import load_settings
from luxloop.worker import Worker


class Sleepy:
    """`what` in the inputs says what to do; `s` for how long; `number` makes two tasks different."""

    kind = "sleepy"

    def catalogue(self) -> dict[str, Any]:
        """Nothing worth telling."""
        return {}

    def blob(self, sha256: str) -> bytes | None:  # noqa: ARG002  the protocol has it
        """No store of its own."""
        return None

    def compute(self, inputs: dict[str, Any], progress: Progress) -> tuple[dict[str, Any], Mapping[str, Array]]:
        """Do what is asked and say which process did it."""
        what, s = inputs.get("what", "nothing"), float(inputs.get("s", 0.0))
        arrays: dict[str, Array] = {}
        if what == "nap":
            end_s = time.monotonic() + s
            while time.monotonic() < end_s:
                time.sleep(min(0.05, s))
                progress.report(1 - (end_s - time.monotonic()) / s, "napping")
        elif what == "nap deaf":
            time.sleep(s)
        elif what == "hold gil":
            ctypes.PyDLL(None).usleep(ctypes.c_uint(int(s * 1e6)))  # a C call that does not let go of the GIL
        elif what == "die":
            os._exit(9)
        elif what == "crash":
            raise RuntimeError("told to crash")
        elif what == "exit":
            sys.exit(3)
        elif what == "mojibake":
            progress.report(0.5, "caf\udce9")
            raise RuntimeError("caf\udce9")
        elif what == "unsendable":
            arrays["map"] = np.array([object()])
        elif what == "refuse":
            raise InputError("what", what, "anything else", "ask for something else")
        elif what == "nan":
            arrays["map"] = np.array([1.0, float("nan")])
        elif what == "big":
            arrays["map"] = np.arange(int(inputs["values"]), dtype="<f8")
        return {"pid": os.getpid(), "number": inputs.get("number", 0)}, arrays


if __name__ == "__main__":
    chosen = load_settings()
    with ZenohBus(chosen, patient=True) as bus:
        Worker(Sleepy(), bus, chosen).run()
