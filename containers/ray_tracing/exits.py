"""The light that leaves a chip, stored: it depends on the chip, its bottom and its emission, not on D or S.

A set of exits is a function of (chip, exit seed, first block, count) alone. Its groups are independent and alike, so
the spread between the groups of whatever they are landed on holds the exits' own sampling error. What ends inside the
chip is booked by block, so a set serves any smaller count too, with the same result as a set of that count; and a
count of any size is made of batches (`exit_source`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Lambertian
from containers.ray_tracing.arrays import ENDS, TRACE
from containers.ray_tracing.kernel import EXIT, PLACE_OF_EXIT, exits_of_group, land_group, scratch
from containers.ray_tracing.monte_carlo import BLOCK, survival_of
from containers.ray_tracing.packing import emission_arrays, scene_arrays
from containers.ray_tracing.sobol import DIRECTIONS
from containers.ray_tracing.tally import GROUPS, Tally
from containers.scene import Array, Cell, Receiver, Scene
from luxloop.errors import InputError
from luxloop.process import usable_cores

Real = NDArray[np.float64]
Single = NDArray[np.float32]

VERSION = 10
"""Of the walk inside the chip and what it notes: another number makes other keys."""
LANDING = 0x9E3779B97F4A7C15
"""Landing draws with the seed turned by this, so that it shares no number with the walk inside the chip."""
FAN = 2
"""As `MonteCarlo` has it; where the walk inside the chip is paid for already, more cost more than they bring."""


@dataclass(frozen=True)
class Exits:
    """A set of exits; group by group, one after the other in `rays`."""

    rays: Single
    """(exit, EXIT)"""
    notes: Single
    """(exit, TRACE), what a change of the chip is reckoned from (`reweighting`); (exit, 0): not kept."""
    ends: NDArray[np.int64]
    """(group, block + 1), number in `rays` of the exit after each block of histories; first, where it begins."""
    ledger: Real
    """(group, block, end), what ended in the chip in each block, and what was emitted."""
    first_block: int = 0
    """Of each group's histories."""
    weights: Single | None = None
    """(exit,), factors on the exits' weights where the chip is another than theirs (`reweighting`)."""
    births: Births | None = None
    """Of a chip that shines unevenly, the exits being those of one that shines evenly; only direct light knows it."""

    @property
    def histories(self) -> int:
        """Of each group."""
        return BLOCK * int(self.ledger.shape[1])

    def numbers(self, group: int, blocks: range) -> NDArray[np.uint64]:
        """Of the histories that a group's exits of some of its blocks are of, (exit,).

        What becomes of an exit is drawn by its history's number, not its own: where one chip loses light that another
        one sends out, all other light of both goes the same ways.
        """
        ends = self.ends[group, blocks.start : blocks.stop + 1]
        begins = BLOCK * np.arange(self.first_block + blocks.start, self.first_block + blocks.stop, dtype=np.uint64)
        places = self.rays[ends[0] : ends[-1], PLACE_OF_EXIT].astype(np.uint64)
        return np.repeat(begins, np.diff(ends)) + places

    @property
    def nbytes(self) -> int:
        """In memory."""
        return int(self.rays.nbytes + self.notes.nbytes + self.ends.nbytes + self.ledger.nbytes)


@dataclass(frozen=True)
class Births:
    """Where the light of a chip is born, and further sets of exits that tell what that changes."""

    weights: Real
    """(y, x), of equal cells of the chip's area, of mean 1."""
    width_um: float
    others: tuple[Exits, ...] = ()
    """With notes, as the first set has them."""


def chip_scene(scene: Scene) -> Scene:
    """The same chip, alone: what the walk inside it depends on, and nothing else."""
    layout = Cell(scene.chip.width_um * 4.0)
    receiver = Receiver(Lambertian(0.0))
    return replace(
        scene, layout=layout, distance_um=scene.chip.thickness_um * 2.0, receiver=receiver, tilt_per_um=(0.0, 0.0),
        leak_share=0.0, leak_um=0.0,
    )  # fmt: skip


def chip_key(scene: Scene) -> str:
    """SHA-256 of all that decides the exits of a scene's chip."""
    return scene_key(chip_scene(scene))


def scene_key(scene: Scene) -> str:
    """SHA-256 of all that decides what becomes of light in a scene whose chips have one top."""
    parts = (*scene_arrays(scene).parts, *emission_arrays(scene))
    powers = [scene.layout.power] if isinstance(scene.layout, Array) else []  # those above are shares of all
    digest = hashlib.sha256(f"exits {VERSION}".encode())
    for part in (*parts, *powers):
        digest.update(str((part.dtype.str, part.shape)).encode() + np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def make_exits(
    scene: Scene,
    seed: int,
    histories: int,
    *,
    first_block: int = 0,
    groups: int = GROUPS,
    notes: bool = False,
    threads: int | None = None,
    report: Callable[[float], None] | None = None,
) -> Exits:
    """Exits of `histories` (a multiple of `BLOCK`) of each group, from block `first_block` on."""
    if histories < BLOCK or histories % BLOCK:
        raise InputError("histories", histories, f"a multiple of {BLOCK}", "of each group")
    blocks, done = range(first_block, first_block + histories // BLOCK), [0]
    walk = _Walk(scene, seed, groups, notes)

    def of_group(group: int) -> list[_Block]:
        found = []
        for block in blocks:
            found.append(walk.block(group, block))
            done[0] += 1
            if report is not None:
                report(done[0] / (len(blocks) * groups))
        return found

    with ThreadPoolExecutor(threads or usable_cores()) as pool:
        of_groups = list(pool.map(of_group, range(groups)))
    counts = np.array([[len(block.rays) for block in found] for found in of_groups], np.int64)
    last = np.cumsum(counts.ravel()).reshape(counts.shape)
    rays = np.concatenate([block.rays for found in of_groups for block in found])
    rays.flags.writeable = False  # as those that come out of a file: kernels are compiled once
    return Exits(
        rays=rays,
        notes=np.concatenate([block.notes for found in of_groups for block in found]),
        ends=np.concatenate([(last[:, :1] - counts[:, :1]), last], axis=1),
        ledger=np.array([[block.ledger for block in found] for found in of_groups]),
        first_block=first_block,
    )


class _Block(NamedTuple):
    """What one block of one group's histories leaves."""

    rays: Single
    notes: Single
    ledger: Real


class _Walk:
    """The walk inside the chip of a scene, block by block."""

    def __init__(self, scene: Scene, seed: int, groups: int, notes: bool) -> None:
        alone = chip_scene(scene)
        self._arrays, self._emission = scene_arrays(alone), emission_arrays(alone)
        self._seed, self._groups, self._notes = np.uint64(seed), groups, TRACE if notes else 0

    def block(self, group: int, block: int) -> _Block:
        rays, notes = np.zeros((BLOCK, EXIT), np.float32), np.zeros((BLOCK, self._notes), np.float32)
        ledger = np.zeros(len(ENDS))
        found = exits_of_group(
            self._arrays, self._emission, self._seed, group, self._groups, block * BLOCK, BLOCK, True, DIRECTIONS,
            rays, notes, ledger, scratch(),
        )  # fmt: skip
        return _Block(rays[:found].copy(), notes[:found].copy(), ledger)


class Landing:
    """Stored exits of a scene's chip, landed in the scene; `tally` holds what they left, like `MonteCarlo`'s."""

    def __init__(
        self,
        scene: Scene,
        exits: Exits | Callable[[int], Exits],
        seed: int,
        *,
        groups: int = GROUPS,
        survival: float | None = None,
        fan: int = FAN,
        threads: int | None = None,
        direction_bins: tuple[int, int] = (0, 0),
    ) -> None:
        if isinstance(exits, Exits) and exits.births is not None:
            raise InputError("exits", "of a chip lit evenly", "those of this one", "make_exits walks them")
        self.scene, self.seed = scene, seed
        self._exits_at = exits if callable(exits) else lambda _: exits
        self.tally = Tally.empty(scene, groups if callable(exits) else exits.ends.shape[0], direction_bins)
        self._arrays, self._emission = scene_arrays(scene), emission_arrays(scene)
        self._survival, self._fan = survival_of(scene) if survival is None else survival, fan
        self._threads = threads or usable_cores()

    def run_to(self, histories: int, report: Callable[[float], None] | None = None) -> Tally:
        """Land the exits of the first `histories` (a multiple of `BLOCK`) of each group."""
        begin = self.tally.histories
        with ThreadPoolExecutor(self._threads) as pool:
            while self.tally.histories < histories:
                if report is not None:
                    report((self.tally.histories - begin) / (histories - begin))
                exits = self._exits_at(self.tally.histories // BLOCK)
                here = self.tally.histories // BLOCK - exits.first_block
                blocks = range(here, min(exits.ledger.shape[1], here + (histories - self.tally.histories) // BLOCK))
                if not blocks:
                    raise InputError("exits", exits.histories, f"{histories} histories of each group", "store more")
                list(pool.map(partial(self._land, exits, blocks), range(self.tally.groups)))
                self.tally.histories += BLOCK * len(blocks)
        return self.tally

    def _land(self, exits: Exits, blocks: range, group: int) -> None:
        ends = exits.ends[group]
        own = slice(ends[blocks.start], ends[blocks.stop])
        weights = exits.weights if exits.weights is None else exits.weights[own]
        land_group(
            self._arrays, self._emission, np.uint64(self.seed ^ LANDING), group, self.tally.groups,
            exits.numbers(group, blocks), exits.rays[own], np.zeros(0, np.float32) if weights is None else weights,
            self._survival, self._fan, self.tally.sinks(group), scratch(),
        )  # fmt: skip
        self.tally.ledger[group] += exits.ledger[group, blocks.start : blocks.stop].sum(axis=0)
