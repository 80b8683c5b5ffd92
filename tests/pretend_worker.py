"""Workers of the kinds film and ray that compute nothing: answers of the right form at once, or after a nap.

Effects they know as the house's workers do, and refuse as they do.

python pretend_worker.py film|ray [seconds]
"""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from luxloop.bus.frame import Array
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.computation import Progress
from luxloop.effect import AppliedEffect
from luxloop.settings import load_settings
from luxloop.words import sha256_of
from luxloop.worker import Worker


class Pretend:
    """Uniformity is a smooth function of the design; a map of 64 x 64."""

    def __init__(self, kind: str, nap_s: float, effects: Path | None = None) -> None:
        self.kind, self._nap_s, self._effects = kind, nap_s, effects
        self._map = np.outer(np.linspace(1.0, 2.0, 64), np.linspace(3.0, 4.0, 64))

    def catalogue(self) -> dict[str, Any]:
        """Nothing worth telling."""
        return {}

    def blob(self, sha256: str) -> bytes | None:  # noqa: ARG002  the protocol has it
        """No store of its own."""
        return None

    @cached_property
    def _known(self) -> Any:
        from containers.catalogue import Catalogue  # late: few tests have effects

        return Catalogue(self._effects)

    def compute(self, inputs: dict[str, Any], progress: Progress) -> tuple[dict[str, Any], Mapping[str, Array]]:
        """An answer of the right form."""
        if inputs.get("effects"):
            self._known.effects([AppliedEffect.model_validate(one) for one in inputs["effects"]], self.kind)
        end_s = time.monotonic() + self._nap_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            time.sleep(min(0.05, left_s))
            progress.report(0.5, "napping")
        if self.kind == "film":
            return {"table_sha256": hashlib.sha256(repr(inputs).encode()).hexdigest(), "table_bytes": 9}, {}
        design = inputs["design"]
        noise = int(sha256_of(inputs)[:8], 16) / 0xFFFFFFFF - 0.5
        value = 0.5 + 0.2 * design["distance_um"] / 180.0 - 0.1 * design["width_um"] / 100.0 + 0.01 * noise
        metrics = {"uniformity": {"value": value, "standard_error": 0.01}}
        return {"metrics": metrics, "histories": 1, "ledger_defect": 0.0}, {"map_lx": self._map.astype(np.float32)}


if __name__ == "__main__":
    chosen = load_settings()
    with ZenohBus(chosen, patient=True, role="thin-film" if sys.argv[1] == "film" else "ray-tracing") as bus:
        nap_s = float(sys.argv[2]) if len(sys.argv) > 2 else 0.0
        Worker(Pretend(sys.argv[1], nap_s, chosen.effects), bus, chosen).run()
