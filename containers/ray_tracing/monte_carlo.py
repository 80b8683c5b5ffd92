"""The Monte Carlo solver: histories on all threads until there are enough of them, the same whoever computes what."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from time import perf_counter

import numpy as np

from containers.ray_tracing.arrays import SceneArrays
from containers.ray_tracing.kernel import scratch, trace_group
from containers.ray_tracing.packing import emission_arrays, scene_arrays
from containers.ray_tracing.sobol import DIRECTIONS
from containers.ray_tracing.tally import GROUPS, Tally
from containers.scene import Array, Scene
from luxloop.errors import InputError
from luxloop.process import usable_cores

BLOCK = 1024
"""Histories of a group that belong together; a run is a whole number of them."""
CHUNK_S = 0.1
"""About as long one call of a kernel takes, so that progress is told and a stop is heard."""
SURVIVAL, SURVIVAL_OF_MODULE = 0.35, 1.0
"""Chance that light goes on from the receiver, in a cell and in a finite module. Measured on S_b3: 1 needs 1.4 times
the time for the same error of U, 0.1 twice, in both shipped models; what comes back from above is smooth, and its
noise counts little. Images of modules are looked at for what is smooth, too: on 5 x 5 chips 0.35 needs 1.3 to 1.6
times the time that 1 needs for the same error, of a bin or of 32 x 32 of them."""

FAN = 4
"""Directions of the substrate's lobe in which first light is recorded. Measured on the paper's designs: in the paper
model an error of U takes 0.4 to 0.75 of the time that 1 needs, with a clear chip 0.85 to 1.03."""


class MonteCarlo:
    """Histories of one scene, continued at will; `tally` holds what they left."""

    def __init__(
        self,
        scene: Scene,
        seed: int,
        *,
        groups: int = GROUPS,
        sobol: bool = True,
        survival: float | None = None,
        fan: int = FAN,
        threads: int | None = None,
        direction_bins: tuple[int, int] = (0, 0),
    ) -> None:
        self.scene, self.seed = scene, seed
        self.tally = Tally.empty(scene, groups, direction_bins)
        self.arrays: SceneArrays = scene_arrays(scene)
        self._emission = emission_arrays(scene)
        self._sobol, self._fan = sobol, fan
        self._survival = survival_of(scene) if survival is None else survival
        self._threads = threads or usable_cores()
        self._calls = BLOCK // 8
        """Histories of a group in one call; grows until a call takes about `CHUNK_S`."""

    def run_to(self, histories: int, report: Callable[[float], None] | None = None) -> Tally:
        """Trace until each group has `histories`; `report` hears the share done and may raise to stop."""
        begin = self.tally.histories
        with ThreadPoolExecutor(self._threads) as pool:
            while self.tally.histories < histories:
                if report is not None:
                    report((self.tally.histories - begin) / (histories - begin))
                count = min(self._calls, histories - self.tally.histories)
                start_s = perf_counter()
                list(pool.map(partial(self._trace, count), range(self.tally.groups)))
                self.tally.histories += count
                call_s = (perf_counter() - start_s) * self._threads / self.tally.groups
                if call_s < CHUNK_S / 2.0:
                    self._calls *= 2
        return self.tally

    def _trace(self, count: int, group: int) -> None:
        tally = self.tally
        trace_group(
            self.arrays, self._emission, np.uint64(self.seed), group, tally.groups, tally.histories, count,
            self._sobol, self._survival, self._fan, DIRECTIONS, tally.sinks(group), scratch(),
        )  # fmt: skip


def survival_of(scene: Scene) -> float:
    """The chance that light goes on from a scene's receiver."""
    return SURVIVAL_OF_MODULE if isinstance(scene.layout, Array) else SURVIVAL


def blocks_of(histories: int, groups: int = GROUPS) -> int:
    """Histories of each group for at least `histories` in all, a whole number of blocks; InputError for none."""
    if not 0 < histories <= 10**11:
        raise InputError("histories", histories, "1 to 100,000,000,000", "how many rays are born")
    return BLOCK * -(-histories // (BLOCK * groups))
