"""What a run of histories has left behind, group by group: bins of the receiver, ledger, optical events, directions.

Groups are independent and alike (each its own scrambled sequence, or its own stored exits), so the spread between
them is the standard error of whatever is computed from their mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.arrays import ENDS, Sinks
from containers.ray_tracing.field import CUTOFF_X, TAPER_END, CellField, mode_count
from containers.scene import Array, Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]

GROUPS = 32
MOST_BINS, MOST_NEEDED_BINS = 384, 768
"""Along an edge of a finite module and its pad: as many as are fine, and where its modes need more than those."""
FIRST, LATER = range(2)
"""Layers of the bins: first arrivals at the receiver, and those after it sent light back."""
OPTICAL_EVENTS = ("through_dbr", "from_sides", "after_top_reflection", "after_receiver")


@dataclass(frozen=True)
class Box:
    """Where bins lie on the receiver: a quarter of a symmetric cell (folded), a cell, or a module and its pad."""

    x0_um: float
    y0_um: float
    step_um: float
    rows: int
    columns: int
    folded: bool
    cell: bool
    oblong: bool = False
    """Where folded: x and y may not be exchanged, for more chips stand one way than the other."""

    @classmethod
    def of(cls, scene: Scene) -> Box:
        """Fine enough that the bins' window takes 2 to 20 % off the highest mode that is kept; it is divided out.

        A module has a pad around it, where the map goes on beyond its edge; walls stand between bins.
        """
        layout, height = scene.layout, scene.height_um
        if isinstance(layout, Array):
            pad = 2.0 * scene.distance_um
            most = max(layout.half_x_um, layout.half_y_um) + pad
            step = max(min(height / 8.0, layout.spacing_um / 32.0), 2.0 * most / MOST_BINS)
            step = max(min(step, _widest_um(height)), 2.0 * most / MOST_NEEDED_BINS)
            inner = 0.0 if layout.wall is None else pad  # what is a whole number of bins wide ends there
            half_x, half_y = layout.half_x_um + pad - inner, layout.half_y_um + pad - inner
            step = half_x / _whole(half_x / step, half_y / step)
            beyond = int(np.ceil(inner / step - 1e-9))
            columns, rows = round(half_x / step) + beyond, round(half_y / step) + beyond
            if scene.symmetric:
                return cls(0.0, 0.0, step, rows, columns, folded=True, cell=False)
            return cls(-columns * step, -rows * step, step, 2 * rows, 2 * columns, folded=False, cell=False)
        modes = mode_count(height, layout.spacing_um)
        bins = 128 if modes <= 8 else 256 if modes <= 24 else 512
        step = layout.spacing_um / bins
        if scene.symmetric:
            return cls(0.0, 0.0, step, bins // 2, bins // 2, folded=True, cell=True)
        return cls(-layout.spacing_um / 2.0, -layout.spacing_um / 2.0, step, bins, bins, folded=False, cell=True)

    @property
    def ends_um(self) -> tuple[float, float, float, float]:
        """x0, x1, y0, y1 of the bins once they are unfolded."""
        x1, y1 = self.x0_um + self.columns * self.step_um, self.y0_um + self.rows * self.step_um
        return (-x1, x1, -y1, y1) if self.folded else (self.x0_um, x1, self.y0_um, y1)

    @property
    def numbers(self) -> Real:
        """As `Sinks.box`."""
        return np.array([self.x0_um, self.y0_um, 1.0 / self.step_um, self.folded, self.cell], float)


@dataclass
class Tally:
    """The sinks of all groups; (group, ...) first in every array."""

    box: Box
    bins: Real
    """(group, layer, y, x), weights."""
    ledger: Real
    """(group, end), weights by `ENDS`."""
    arrivals: Real
    """(group, optical event), weights."""
    directions: Real
    """(group, 2, cosine, azimuth), weights: light that leaves chips, light at its first arrival."""
    histories: int = 0
    """Of each group."""
    groups: int = field(init=False)

    def __post_init__(self) -> None:
        self.groups = self.bins.shape[0]

    @classmethod
    def empty(cls, scene: Scene, groups: int = GROUPS, direction_bins: tuple[int, int] = (0, 0)) -> Tally:
        """Nothing yet; `direction_bins` (cosine, azimuth) where the far field is wanted."""
        box = Box.of(scene)
        _refuse_too_large(scene, box)
        return cls(
            box,
            np.zeros((groups, 2, box.rows, box.columns)),
            np.zeros((groups, len(ENDS))),
            np.zeros((groups, len(OPTICAL_EVENTS))),
            np.zeros((groups, 2, *direction_bins)),
        )

    def sinks(self, group: int) -> Sinks:
        """Where kernels write the histories of one group."""
        return Sinks(
            self.bins[group], self.box.numbers, self.ledger[group], self.arrivals[group], self.directions[group]
        )

    @property
    def total_histories(self) -> int:
        """Of all groups."""
        return self.histories * self.groups

    @property
    def ledger_per_history(self) -> dict[str, float]:
        """Share of the emitted light by its end; `roulette` is the net weight that roulette created."""
        total = self.ledger.sum(axis=0) / self.total_histories
        return dict(zip(ENDS, map(float, total), strict=True))

    @property
    def ledger_defect(self) -> float:
        """emitted + roulette - all ends, per history: 0 but for rounding."""
        ends = self.ledger_per_history
        put_in = ends.pop("emitted") + ends.pop("roulette")
        return put_in - sum(ends.values())

    @property
    def events_per_history(self) -> dict[str, float]:
        """Arrivals at the receiver per emitted light, by the paper's optical events."""
        return dict(zip(OPTICAL_EVENTS, map(float, self.arrivals.sum(axis=0) / self.total_histories), strict=True))

    def cell_bins(self, layer: int | None = None) -> Real:
        """(group, y, x): bins of a whole cell, unfolded where they were folded; of one layer or of both together."""
        bins = self.bins.sum(axis=1) if layer is None else self.bins[:, layer]
        if not self.box.folded:
            return np.asarray(bins)
        quarter = self._unfolded(bins)
        half = np.concatenate([quarter[:, ::-1], quarter], axis=1)
        return np.concatenate([half[:, :, ::-1], half], axis=2)

    def cell_field(self, layer: int, spacing_um: float, height_um: float, modes: int | None = None) -> CellField:
        """The light of one layer of a cell, or of what repeats as one does, `spacing_um` wide."""
        if self.box.folded:
            return CellField.from_quarter(
                self._unfolded(self.bins[:, layer]), self.histories, spacing_um, height_um, modes
            )
        return CellField.from_bins(self.bins[:, layer], self.histories, spacing_um, height_um, modes)

    def _unfolded(self, bins: Real) -> Real:
        """The light of one quadrant (group, y, x), of bins into which all four were folded."""
        return bins / 4.0 if self.box.oblong else np.asarray((bins + bins.swapaxes(1, 2)) / 8.0)


def _widest_um(height_um: float) -> float:
    """The widest bins that tell the highest mode of a module."""
    return float(np.pi * height_um / (TAPER_END * CUTOFF_X))


def _refuse_too_large(scene: Scene, box: Box) -> None:
    """InputError, before anything is traced, for a module whose bins cannot be as narrow as its height asks for."""
    layout, widest = scene.layout, _widest_um(scene.height_um)
    if isinstance(layout, Array) and box.step_um > widest:
        most = widest * MOST_NEEDED_BINS - 4.0 * scene.distance_um
        sides = f"{2 * layout.half_x_um:g} x {2 * layout.half_y_um:g} um"
        mend = "fewer chips, a smaller pitch, or a higher receiver"
        raise InputError("array", sides, f"up to about {max(most, 0.0):.0f} um a side at this height", mend)


def _whole(columns: float, rows: float) -> int:
    """The least whole number from `columns` on for which `rows` grows, in proportion, to a whole number too.

    Where there is none up to twice as many, the last row of bins reaches beyond the module.
    """
    least = max(2, int(np.ceil(columns - 1e-9)))
    for count in range(least, 2 * least):
        if abs(count * rows / columns - round(count * rows / columns)) < 1e-6:
            return count
    return least


def nowhere() -> Sinks:
    """Sinks that keep nothing but a ledger."""
    empty = np.zeros((2, 0, 0))
    return Sinks(empty, np.zeros(5), np.zeros(8), np.zeros(len(OPTICAL_EVENTS)), empty)
