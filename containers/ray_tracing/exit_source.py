"""Where stored exits come from: memory, a folder that is bounded in size, or the walk inside the chip once more.

Whoever holds a batch, it is the same to the last bit: a batch is a function of (chip, exit seed, its number) alone.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Lock

import numpy as np

from containers.ray_tracing.array_store import ArrayStore
from containers.ray_tracing.exits import Exits, chip_key, make_exits
from containers.ray_tracing.monte_carlo import BLOCK
from containers.scene import Scene
from luxloop.errors import InputError
from luxloop.words import sha256_of

BATCH = 4
"""Blocks of a batch: 131,072 histories in 32 groups, about 3 MB where six of ten leave their chip."""
MEMORY_BYTES = 512 << 20
"""Of sets in memory: one of 524,288 histories with notes has 30 to 50 MB, and a diagnosis takes columns with two of
each chip."""
FOLDER_BYTES = 4 << 30
_ARRAYS = ("rays", "notes", "ends", "ledger")


class ExitSource:
    """Batches of exits by chip, exit seed and number; safe to ask from several threads.

    What is in memory is handed out as it is: who knows something of a set, such as where its rays go, knows it again.
    """

    def __init__(
        self,
        folder: Path | None = None,
        *,
        memory_bytes: int = MEMORY_BYTES,
        folder_bytes: int = FOLDER_BYTES,
        threads: int | None = None,
    ) -> None:
        self._store = ArrayStore(folder, folder_bytes, what="exits") if folder is not None else None
        self._memory_bytes, self._threads = memory_bytes, threads
        self._held: OrderedDict[str, Exits] = OrderedDict()
        self._lock = Lock()
        self.made = 0
        """Batches that had to be computed."""

    def batches(
        self, scene: Scene, seed: int, *, notes: bool = False, report: Callable[[float], None] | None = None
    ) -> Callable[[int], Exits]:
        """A function from the number of a block to the batch that holds it, for the chip of a scene."""
        chip = chip_key(scene)

        def batch_at(block: int) -> Exits:
            number = block // BATCH
            found = self._batch(scene, chip, seed, number, notes, report)
            self._keep(_key_of(chip, seed, number, notes), found)
            return found

        return batch_at

    def exits(
        self,
        scene: Scene,
        seed: int,
        blocks: int,
        *,
        first_block: int = 0,
        notes: bool = False,
        report: Callable[[float], None] | None = None,
    ) -> Exits:
        """`blocks` blocks of each group as one set, the first where a batch begins, for the chip of a scene.

        Raises InputError for no blocks, or another first one.
        """
        if blocks < 1:
            raise InputError("blocks", blocks, "at least 1")
        if first_block % BATCH:
            raise InputError("first_block", first_block, f"a multiple of {BATCH}")
        chip, first = chip_key(scene), first_block // BATCH
        key = _key_of(chip, seed, first, notes, blocks)
        found = self._in_memory(key)
        if found is None:
            numbers = range(first, first - -blocks // BATCH)
            found = joined([self._batch(scene, chip, seed, number, notes, report) for number in numbers], blocks)
            self._keep(key, found)
        return found

    def _batch(
        self, scene: Scene, chip: str, seed: int, number: int, notes: bool, report: Callable[[float], None] | None
    ) -> Exits:
        """A batch from memory, from the folder, or walked."""
        key = _key_of(chip, seed, number, notes)
        found = self._in_memory(key) or self._stored(key, number * BATCH)
        if found is None:
            first, how_many = number * BATCH, BATCH * BLOCK
            found = make_exits(
                scene, seed, how_many, first_block=first, notes=notes, threads=self._threads, report=report
            )
            self.made += 1
            if self._store is not None:
                self._store.put(key, {name: getattr(found, name) for name in _ARRAYS}, {"first_block": first})
        return found

    def _in_memory(self, key: str) -> Exits | None:
        with self._lock:
            if key in self._held:
                self._held.move_to_end(key)
            return self._held.get(key)

    def _stored(self, key: str, first_block: int) -> Exits | None:
        arrays = self._store.get(key) if self._store is not None else None
        if arrays is None or set(arrays) != set(_ARRAYS):
            return None
        rays, notes, ends, ledger = (arrays[name] for name in _ARRAYS)
        return Exits(rays, notes, ends, ledger, first_block)

    def _keep(self, key: str, exits: Exits) -> None:
        """In memory; what was used longest ago goes."""
        with self._lock:
            self._held[key] = exits
            self._held.move_to_end(key)
            while sum(e.nbytes for e in self._held.values()) > self._memory_bytes and len(self._held) > 1:
                self._held.popitem(last=False)


def _key_of(chip: str, seed: int, number: int, notes: bool, blocks: int = BATCH) -> str:
    """Of so many blocks from a batch on."""
    return sha256_of({"chip": chip, "seed": str(seed), "batch": number, "blocks": blocks, "notes": notes})


def joined(batches: Sequence[Exits], blocks: int) -> Exits:
    """The first `blocks` blocks of batches that follow each other, as one set."""
    whole = sum(batch.ledger.shape[1] for batch in batches)
    if len(batches) == 1 and blocks == whole:
        return batches[0]
    left, parts = blocks, list[tuple[Exits, int]]()
    for batch in batches:
        parts.append((batch, min(left, batch.ledger.shape[1])))
        left -= parts[-1][1]
    groups = range(batches[0].ends.shape[0])
    places = [(one, slice(one.ends[group, 0], one.ends[group, used])) for group in groups for one, used in parts]
    counts = np.concatenate([np.diff(one.ends[:, : used + 1], axis=1) for one, used in parts], axis=1)
    last = np.cumsum(counts.ravel()).reshape(counts.shape)
    rays = np.concatenate([one.rays[place] for one, place in places])
    rays.flags.writeable = False  # as those that come out of a file: kernels are compiled once
    return Exits(
        rays=rays,
        notes=np.concatenate([one.notes[place] for one, place in places]),
        ends=np.concatenate([last[:, :1] - counts[:, :1], last], axis=1),
        ledger=np.concatenate([one.ledger[:, :used] for one, used in parts], axis=1),
        first_block=batches[0].first_block,
    )
