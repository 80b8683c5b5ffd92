"""Where the nodes of a film table lie in u = k_parallel / k0, and how a u is found among them.

    node   0 ........ shared ........ N0 ..... segment ..... N1 ..... segment ..... N2
    u      0      low sin(theta)      low        cosine      n_AlN       cosine     high

The shared cells, u from 0 to the lower of the two outer indices (`low`), are uniform in the angle of that side (air)
and serve light of both sides. Beyond it light exists on the denser side only: cells from `low` to `high` in segments
that end at the indices of the layers, denser towards both ends, since all goes as the square root of the distance
there. So the place of any u, counted in cells, is closed-form (place i in a segment [a, b] of m cells):

    u = low sin(pi/2 place / shared),      u = a + (b - a) (1 - cos(pi i / m)) / 2

A cell may be split into 2^k parts, equal in that place; `first` counts the nodes before each cell. The number of a
node, with its fraction, is then first[cell] + (place - cell) (first[cell + 1] - first[cell]): no search, however
unevenly the cells are split. Tables are linear in this number.

Cells are split from the start where the phase of the stack, sum of kz k0 d over its layers, turns by more than
`MAX_TURN_RAD` within a part: interference repeats with every pi of it, and a dip narrower than that spacing is still
seen in its flanks. `refinement` splits further where the values ask for it.

With dispersion `low` and `high` are the largest over the wavelengths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.stack import StackRows
from luxloop.film import Grid

Real = NDArray[np.float64]

MAX_TURN_RAD = 0.4
"""Without it 3 of 100 random stacks (2 to 4 um films) hid dips of 3e-3 to 7e-3; 0.3 finds no more."""
SAME_INDEX = 1e-3
"""Layers closer in index than this share the end of a segment, half spaces closer than 1e-6 have none between."""


@dataclass(frozen=True)
class Axis:
    """The nodes of a table; see the head of this module."""

    breaks: tuple[float, ...]
    """u at the ends of the segments: low, (layers), high."""
    shared_cells: int
    segment_cells: int
    """Cells of each segment."""
    first: NDArray[np.int32]
    """(cell + 1,), number of the node at which each cell begins; the last one is the last node."""

    @property
    def shared_nodes(self) -> int:
        """How many nodes serve both sides."""
        return int(self.first[self.shared_cells]) + 1

    @property
    def parts(self) -> NDArray[np.int32]:
        """(cell,), in how many parts each cell is split."""
        return np.diff(self.first)

    @cached_property
    def place(self) -> Real:
        """(node,), in cells."""
        parts = self.parts
        cell = np.repeat(np.arange(parts.size), parts)
        return np.append(cell + (np.arange(cell.size) - self.first[cell]) / parts[cell], float(parts.size))

    @cached_property
    def break_nodes(self) -> NDArray[np.int32]:
        """Numbers of the nodes at the breaks, where the scale of `place` changes."""
        return self.first[self.shared_cells + self.segment_cells * np.arange(len(self.breaks))]

    @cached_property
    def u(self) -> Real:
        """u of every node, (node,)."""
        shared = self.place[: self.shared_nodes]
        pieces = [self.breaks[0] * np.sin(shared * (np.pi / 2 / self.shared_cells))]
        ends = zip(pairwise(self.breaks), pairwise(self.break_nodes + 1), strict=True)
        for number, ((a, b), (start, end)) in enumerate(ends):
            within = self.place[start:end] - self.shared_cells - number * self.segment_cells
            pieces.append(a + (b - a) * (1.0 - np.cos(np.pi * within / self.segment_cells)) / 2.0)
        return np.concatenate(pieces)

    def position(self, u: ArrayLike) -> Real:
        """Node number, with its fraction, at u (any shape); u beyond an end is at the end."""
        where = np.asarray(u, float)
        place = self.shared_cells * np.arcsin(np.clip(where / self.breaks[0], 0.0, 1.0)) / (np.pi / 2)
        for a, b in pairwise(self.breaks):
            place += self.segment_cells * np.arccos(1.0 - 2.0 * np.clip((where - a) / (b - a), 0.0, 1.0)) / np.pi
        cell = np.minimum(place.astype(int), self.first.size - 2)
        return np.asarray(self.first[cell] + (place - cell) * (self.first[cell + 1] - self.first[cell]))

    def split(self, times: ArrayLike) -> Axis:
        """The axis with every part of a cell divided into 2^times, (cell,)."""
        parts = np.left_shift(self.parts.astype(np.int64), np.asarray(times, np.int64))
        return replace(self, first=np.concatenate([[0], np.cumsum(parts)]).astype(np.int32))


def first_axis(rows: StackRows, grid: Grid, peak: int, max_nodes: int) -> Axis:
    """The axis before any value is known: the cells of the grid, split by the phase at the wavelength row `peak`.

    `max_nodes` limits the splitting. A smooth, lossless stack is split among the shared cells alone: beyond them it
    reflects everything.
    """
    outer = rows.index[:, [0, -1]].real
    low, high = float(outer.min(axis=1).max()), float(outer.max())
    breaks: tuple[float, ...] = (low,)
    segment_cells = 0
    if high - low >= 1e-6:
        breaks = (low, *_layers_between(rows.index[peak, 1:-1].real, low, high)[: grid.dense_nodes // 4], high)
        segment_cells = grid.dense_nodes // (len(breaks) - 1)
    shared = grid.shared_nodes - 1
    axis = Axis(
        breaks, shared, segment_cells, np.arange(shared + segment_cells * (len(breaks) - 1) + 1, dtype=np.int32)
    )
    times = np.ceil(np.log2(np.maximum(_turn_rad(rows, axis.u, peak) / MAX_TURN_RAD, 1.0))).astype(int)
    if rows.lossless:
        times[shared:] = 0
    while times.any() and np.left_shift(1, times).sum() >= max_nodes:
        times = np.maximum(times - 1, 0)
    return axis.split(times) if times.any() else axis


def _layers_between(n: Real, low: float, high: float) -> list[float]:
    """Indices of layers well between two others, those that are nearly the same once."""
    found: list[float] = []
    for index in sorted({float(x) for x in n if low + 1e-2 < x < high - 1e-2}):
        if not found or index - found[-1] > SAME_INDEX:
            found.append(index)
    return found


def _turn_rad(rows: StackRows, u: Real, peak: int) -> Real:
    """(cell,), by how much the phases of all layers together turn across each cell."""
    kz = np.sqrt(np.maximum(rows.index[peak, 1:-1].real ** 2 - u[:, None] ** 2, 0.0))
    phase = kz * rows.thickness_nm * (2.0 * np.pi / rows.wavelength_nm[peak])
    return np.asarray(np.abs(np.diff(phase, axis=0)).sum(axis=1))
