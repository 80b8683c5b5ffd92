"""The ways of stored exits to the receiver, walked once.

A film, absorption in the chip, where its light is born: they change what exits weigh, and what becomes of the few
that meet a chip on their way (0 to 2 % of the light of chips of 40 um, 400 um apart); all others land where they did.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np

from containers.ray_tracing.arrays import EmissionArrays, SceneArrays
from containers.ray_tracing.exits import LANDING, Exits
from containers.ray_tracing.kernel import scratch
from containers.ray_tracing.tally import nowhere
from containers.ray_tracing.twin.direct_kernel import Arrivals, walk_ways
from containers.ray_tracing.twin.held import Held
from containers.ray_tracing.twin.parallel import in_parallel

HELD_BYTES = 256 * 2**20
"""Of ways that are remembered: 131,072 histories of a chip have 2 MB."""


@dataclass(frozen=True)
class Dark:
    """A scene whose chips, and whose receiver, take all that meets them."""

    scene: SceneArrays

    @cached_property
    def key(self) -> str:
        """SHA-256 of all that decides what becomes of a ray in it."""
        digest = sha256()
        for part in self.scene.parts:
            digest.update(repr(part.shape).encode() + part.tobytes())
        return digest.hexdigest()


class Ways:
    """Where exits first come to the receiver; what nobody holds any more is gone at the next look."""

    def __init__(self, most_bytes: int = HELD_BYTES) -> None:
        self._held = Held[list[Arrivals]](most_bytes, _bytes_of)

    def __len__(self) -> int:
        """How many sets of exits are remembered, each in a scene."""
        return len(self._held)

    def of(
        self,
        dark: Dark,
        emission: EmissionArrays,
        exits: Exits,
        *,
        blocks: int,
        groups: int,
        seed: int,
        threads: int | None,
    ) -> list[Arrivals]:
        """Those of the first blocks, group by group; parameters as those of `land_direct`."""

        def walk(group: int) -> Arrivals:
            rays = exits.rays[exits.ends[group, 0] : exits.ends[group, blocks]]
            found = Arrivals(np.zeros((len(rays), 3)), np.zeros(len(rays), np.int8))
            walk_ways(
                dark.scene, emission, np.uint64(seed ^ LANDING), group, groups, exits.numbers(group, range(blocks)),
                rays, np.zeros(0, np.float32), found, nowhere(), scratch(),
            )  # fmt: skip
            return found

        facts = exits.first_block, exits.ends[:, [0, blocks]].tolist(), groups, seed
        chip = emission.chip_cumulative.tolist(), emission.centres_um.tolist()
        key = f"{dark.key} {id(exits.rays)} {facts} {chip}"
        return self._held.of(key, exits.rays, lambda: in_parallel(walk, range(len(exits.ends)), threads))


def _bytes_of(ways: list[Arrivals]) -> int:
    return sum(one.places.nbytes + one.bounces.nbytes for one in ways)
