"""The twin of a finite module with open edges: the map of one chip, laid at the place of each.

    direct light of one chip among its neighbours  x  places and powers  +  round trips inside the module (`exchange`)

Each stored exit serves all chips and, where the emission is symmetric, all eight of its images, so that few of them
make a smooth map. Of powers and displacements everything is in it but that neighbours stand elsewhere.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.direct import ARRIVES, direct_light
from containers.ray_tracing.exchange import Exchange
from containers.ray_tracing.exits import Exits
from containers.ray_tracing.field import CUTOFF_X, TAPER_END, Axis, CellField, ModuleField
from containers.ray_tracing.shadow import RAYS, correction
from containers.ray_tracing.tally import Box
from containers.ray_tracing.twin import SEED, cloud_window, plate
from containers.scene import Array, Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]

BINS_PER_HEIGHT = 8.0
PAD = 2.0
"""In distances: how far beyond the module's edge the map goes on."""
MOST_BINS = 512
"""Along a half of one chip's map."""


class ModuleTwin:
    """The irradiance of a finite module, 1/mm^2 per flux emitted by one chip, anywhere on its receiver.

    Parameters
    ----------
    exits : of the scene's chip. blocks : how many of their blocks to use.
    groups : independent groups that are kept apart, a divisor of the exits' groups; 2 are the fewest, and the fastest.
    shadow_rays : rays that measure what the chips take from the light sent back; 0: they take nothing.

    Raises
    ------
    InputError : walls at the edge, a tilted receiver, surfaces that the twin does not know.

    Notes
    -----
    What chips take from the light sent back is spread over the module: the cell's, by the share of the area with chips.
    """

    def __init__(
        self,
        scene: Scene,
        exits: Exits,
        *,
        blocks: int | None = None,
        groups: int = 2,
        shadow_rays: int = RAYS,
        threads: int | None = None,
    ) -> None:
        if not isinstance(scene.layout, Array) or scene.layout.wall is not None or any(scene.tilt_per_um):
            what = "walls" if isinstance(scene.layout, Array) and scene.layout.wall else "cell or tilt"
            raise InputError("layout", what, "a finite array with open edges, level", "use cell_field or Monte Carlo")
        self.scene, self.layout = scene, scene.layout
        self.chip = one_chip(scene, exits, blocks=blocks, groups=groups, threads=threads)
        self.exchange = Exchange(
            self.layout, scene.substrate, scene.receiver, scene.distance_um, self._returned(shadow_rays, threads)
        )
        plain = self.chip.coefficients[:, ARRIVES]
        self._waves = [self.exchange.solve(self._laid(one, *self.exchange.centres_um)) for one in plain]
        self._mean_waves = np.mean(self._waves, axis=0)
        k = np.hypot(*np.meshgrid(self.chip.y.wavenumber_per_um, self.chip.x.wavenumber_per_um, indexing="ij"))
        self._recorded = self.chip.coefficients.sum(axis=1) * plate(scene.receiver, k)
        self._spread = plate(scene.receiver, self.exchange.wavenumbers) if scene.receiver.spread_share else None

    def mean(self, x_um: Real, y_um: Real) -> Real:
        """The map (y, x) at every crossing of the given places."""
        again = self.exchange.sum_up(self._mean_waves, x_um, y_um, self._spread)
        return np.asarray(1e6 * (self._laid(self._recorded.mean(axis=0), x_um, y_um) + again))

    def of_groups(self, x_um: Real, y_um: Real) -> Real:
        """The map of each group, (group, y, x)."""
        pairs = zip(self._recorded, self._waves, strict=True)
        laid = [self._laid(one, x_um, y_um) + self.exchange.sum_up(w, x_um, y_um, self._spread) for one, w in pairs]
        return 1e6 * np.stack(laid)

    def field(self) -> ModuleField:
        """All groups as a field over the module and a pad beyond its edges."""
        box = Box.of(self.scene)
        x, y = (
            Axis(-n * box.step_um / 2.0, n * box.step_um, int(TAPER_END * CUTOFF_X / self.scene.height_um * n * box.step_um / np.pi), "box")
            for n in (box.columns, box.rows)
        )
        at_x, at_y = ((np.arange(n) + 0.5 - n / 2.0) * box.step_um for n in (box.columns, box.rows))
        values = self.of_groups(at_x, at_y)
        coefficients = y.functions(at_y).T @ values @ x.functions(at_x) / (box.rows * box.columns)
        histories = self.chip.histories
        return ModuleField(coefficients, x, y, histories, 0.0, per_m2=1e6)

    def _laid(self, chip: Real, x_um: Real, y_um: Real) -> Real:
        """Direct light (y, x) of all chips, from the coefficients of one; chips of one y are taken together."""
        along_x: dict[float, Real] = defaultdict(lambda: np.zeros((x_um.size, chip.shape[1])))
        for (cx, cy), power in zip(self.layout.centres_um.reshape(-1, 2), self.layout.power.ravel(), strict=True):
            if power > 0.0:
                along_x[float(cy)] += power * self.chip.x.functions(x_um - cx)
        rows = [(self.chip.y.functions(y_um - cy), functions) for cy, functions in along_x.items()]
        left, right = (np.concatenate(one, axis=1) for one in zip(*rows, strict=True))
        size, many = chip.shape[0], len(rows)
        middle = np.concatenate([left[:, i * size : (i + 1) * size] @ chip for i in range(many)], axis=1)
        return np.asarray(middle @ right.T)

    def _returned(self, rays: int, threads: int | None) -> float:
        """Share of what would come up again without chips."""
        if not rays:
            return 1.0
        axis = Axis(0.0, self.layout.spacing_um / 2.0, 1, "even")
        dT = correction(self.scene, axis, axis, rays=rays, seed=SEED, threads=threads)
        albedo = float(self.scene.substrate.albedo(np.array([0.5]))[0])
        area = self.layout.power.size * self.layout.spacing_um**2 / (4.0 * self.layout.half_x_um * self.layout.half_y_um)
        return 1.0 + float(dT[0, 0]) / albedo * min(area, 1.0) if albedo > 0.0 else 1.0


class ChipMap:
    """Irradiance (1/um^2 per emitted flux) of one chip as a series: coefficients (group, layer, y, x) and its axes."""

    def __init__(self, coefficients: Real, x: Axis, y: Axis, histories: int) -> None:
        self.coefficients, self.x, self.y, self.histories = coefficients, x, y, histories


def one_chip(
    scene: Scene, exits: Exits, *, blocks: int | None = None, groups: int = 2, threads: int | None = None
) -> ChipMap:
    """Direct light of the chip in the middle of an array that reaches as far around it as any two chips are apart."""
    layout = scene.layout
    assert isinstance(layout, Array)
    reach = max(layout.half_x_um, layout.half_y_um) + float(np.abs(layout.centres_um).max()) + PAD * scene.distance_um
    half = reach + 4.0 * scene.distance_um
    around = Array.regular(2 * layout.rows - 1, 2 * layout.columns - 1, layout.spacing_um, half)
    bins = min(int(np.ceil(reach * BINS_PER_HEIGHT / scene.height_um)), MOST_BINS)
    step = reach / bins
    folded = scene.emission.symmetric
    start, count = (0.0, bins) if folded else (-reach, 2 * bins)
    box = Box(start, start, step, count, count, folded=folded, cell=False)
    alone = replace(scene, layout=around)
    tally = direct_light(alone, box, exits, SEED, blocks=blocks, one_chip=True, threads=threads)
    together = tally.groups // groups
    modes = min(int(TAPER_END * CUTOFF_X / scene.height_um * reach / np.pi), count - 1 if folded else bins - 1)
    found = []
    for layer in range(tally.bins.shape[1]):
        whole = replace_bins(tally.bins[:, layer], groups, folded)
        field = CellField.from_bins(whole, tally.histories * together, 2.0 * reach, scene.height_um, modes, folded=folded)
        found.append(field.coefficients)
    k = np.hypot(*np.meshgrid(field.y.wavenumber_per_um, field.x.wavenumber_per_um, indexing="ij"))
    fade = np.cos(np.pi / 2.0 * np.clip((k * scene.height_um / CUTOFF_X - 1.0) / (TAPER_END - 1.0), 0.0, 1.0)) ** 2
    cloud = np.multiply.outer(cloud_window(field.y, step), cloud_window(field.x, step))
    coefficients = np.stack(found, axis=1) * (fade / cloud) / (2.0 * reach) ** 2
    return ChipMap(coefficients, field.x, field.y, tally.histories * tally.groups)


def replace_bins(bins: Real, groups: int, folded: bool) -> Real:
    """Bins (groups, y, x) of the whole map from those of more groups, unfolded with all symmetries."""
    together = bins.reshape(groups, -1, *bins.shape[1:]).sum(axis=1)
    if not folded:
        return np.asarray(together)
    quarter = (together + together.swapaxes(1, 2)) / 8.0
    half = np.concatenate([quarter[:, ::-1], quarter], axis=1)
    return np.concatenate([half[:, :, ::-1], half], axis=2)
