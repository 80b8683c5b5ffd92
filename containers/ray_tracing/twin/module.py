"""The twin of a finite module with open edges: the map of one chip, laid at the place of each.

    direct light of one chip among its neighbours  x  places and powers  +  round trips inside the module (`exchange`)

What of direct light goes on inside the substrate is laid at the places of chips, too, and comes up in `exchange`.

Each stored exit serves all chips and, where the emission is symmetric, all eight of its images (four where more chips
stand one way than the other), so that few of them make a smooth map. Of powers and displacements everything is in it
but that neighbours stand elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.arrays import EmissionArrays
from containers.ray_tracing.exits import Exits
from containers.ray_tracing.field import CUTOFF_X, TAPER_END, Axis, ModuleField, beyond_cutoff
from containers.ray_tracing.packing import emission_arrays
from containers.ray_tracing.tally import Box, Tally
from containers.ray_tracing.twin.cell import SEED, cloud_window
from containers.ray_tracing.twin.closure import Leak
from containers.ray_tracing.twin.direct import Way, direct_light, open_way
from containers.ray_tracing.twin.direct_kernel import ARRIVES, INSIDE
from containers.ray_tracing.twin.exchange import Exchange, Waves, sum_up
from containers.ray_tracing.twin.grid import Complex
from containers.ray_tracing.twin.held import Held
from containers.ray_tracing.twin.shadow import RAYS, correction
from containers.ray_tracing.twin.ways import Ways
from containers.scene import Array, Cell, Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]

BINS_PER_HEIGHT = 8.0
PAD = 2.0
"""In distances: how far beyond the module's edge the map goes on."""
MOST_BINS = 512
"""Along a half of one chip's map."""
LEAST_X = 8.2305
"""Wavenumber times height where x K1(x) is 1e-3: a map whose bins do not tell waves so short is refused. Monte Carlo
refuses modules before they are as large."""
SLACK = 0.25
"""In distances: of the pad, what chips may stand beyond their lattice."""
HELD_BYTES = 128 * 2**20
"""Of the light of chips that is remembered."""
STEPS_PER_SD = 4.0
"""Of the spread in the receiver's plate, at least."""


class ModuleTwin:
    """The irradiance of a finite module, 1/mm^2 per flux emitted by one chip, anywhere on its receiver.

    Parameters
    ----------
    exits : of the scene's chip. blocks : how many of their blocks to use.
    groups : independent groups that are kept apart, a divisor of the exits' own; 2 are the fewest, and the fastest.
    seed : of all frozen random numbers.
    shadow_rays : rays that measure what the chips take from the light sent back; 0: they take nothing.
    known : light of chips that is remembered; it only saves time.

    Raises
    ------
    InputError : walls at the edge, a tilted receiver, surfaces that the twin does not know, a module too large for
        its height.

    Notes
    -----
    What a chip takes from the light sent back is that of an endless array's chip, from the places that see it.
    """

    def __init__(
        self,
        scene: Scene,
        exits: Exits,
        *,
        blocks: int | None = None,
        groups: int = 2,
        shadow_rays: int = RAYS,
        seed: int = SEED,
        threads: int | None = None,
        known: Lights | None = None,
    ) -> None:
        self.scene, self.layout = scene, open_array(scene)
        way = open_way(*surroundings(scene, self.layout))
        lit = emission_arrays(replace(scene, layout=Cell(self.layout.spacing_um)))

        def make() -> tuple[ChipMap, float]:
            ways = None if known is None else known.ways
            tally = direct_light(way, lit, exits, seed, blocks=blocks, groups=groups, threads=threads, known=ways)
            return one_chip(scene, tally), self._lost(way, lit, shadow_rays, seed, threads)

        key = digest_of(way, lit, id(exits), blocks, groups, shadow_rays, seed) if known is not None else ""
        self.chip, lost = make() if known is None else known.of(key, exits, make)
        leak = Leak.of(scene)
        self.exchange = Exchange(self.layout, scene.substrate, scene.receiver, scene.distance_um, lost, leak)
        self._recorded = self.chip.coefficients.sum(axis=1)

    def mean(self, x_um: Real, y_um: Real) -> Real:
        """The map (y, x) at every crossing of the given places."""
        chip = self.chip
        waves = self._waves(chip.coefficients[:, ARRIVES].mean(axis=0), chip.leaked.mean(axis=0))
        recorded = self._recorded.mean(axis=0)
        return self._through_plate(lambda x, y: self._laid(recorded, x, y) + sum_up(waves, x, y), x_um, y_um)

    def of_groups(self, x_um: Real, y_um: Real) -> Real:
        """The map of each group, (group, y, x)."""
        each = zip(self.chip.coefficients[:, ARRIVES], self.chip.leaked, strict=True)
        waves = [self._waves(*one) for one in each]

        def light(x: Real, y: Real) -> Real:
            again = np.stack([sum_up(one, x, y) for one in waves])
            return np.asarray(np.stack([self._laid(one, x, y) for one in self._recorded]) + again)

        return self._through_plate(light, x_um, y_um)

    def _through_plate(self, light: Callable[[Real, Real], Real], x_um: Real, y_um: Real) -> Real:
        """What is recorded of light (..., y, x): of what arrives inside the module, a share is displaced."""
        a, sd = self.scene.receiver.spread_share, self.scene.receiver.spread_um
        recorded = light(x_um, y_um)
        if a and sd:
            (x, to_x), (y, to_y) = (
                _displaced(at, half, min(self.scene.height_um / BINS_PER_HEIGHT, sd / STEPS_PER_SD), sd)
                for at, half in ((x_um, self.layout.half_x_um), (y_um, self.layout.half_y_um))
            )
            recorded = (1.0 - a) * recorded + a * (to_y @ light(x, y) @ to_x.T)
        return np.asarray(1e6 * recorded)

    def field(self) -> ModuleField:
        """All groups as a field over the module and a pad beyond its edges.

        `truncation` is what the waves beyond those of the chip's map would add; 0 where only faint ones are.
        """
        x0, x1, y0, y1 = Box.of(self.scene).ends_um
        last = TAPER_END * CUTOFF_X / self.scene.height_um / np.pi
        x, y = (Axis(low, high - low, int(last * (high - low)), "box") for low, high in ((x0, x1), (y0, y1)))
        at_x, at_y = map(_samples, (x, y))
        values = self.of_groups(at_x, at_y)
        coefficients = y.functions(at_y).T @ values @ x.functions(at_x) / (at_x.size * at_y.size)
        kept_x = float(self.chip.x.wavenumber_per_um.max()) * self.scene.height_um
        left_out = beyond_cutoff(self.scene.height_um, kept_x) if kept_x < CUTOFF_X else 0.0
        return ModuleField(coefficients, x, y, self.chip.histories, left_out, per_m2=1e6)

    def _waves(self, arrives: Real, leaked: Real) -> Waves:
        """All light but what comes directly from chips with these coefficients (y, x), which leak so much (y, x)."""
        exchange, inside = self.exchange, None
        if leaked.size:
            inside = exchange.wide.laid(leaked, self.chip.step_um, self.layout)
        return exchange.solve(self._laid(arrives, *exchange.grid.centres_um), inside)

    def _laid(self, chip: Real, x_um: Real, y_um: Real) -> Real:
        """Direct light (y, x) of all chips, from the coefficients of one.

        Notes
        -----
        With f_k(u) = Re(a_k e^iku) along both axes the sum over chips of p f_k(y - c_y) f_l(x - c_x) is
        Re(e^iky e^ilx P(k, l) + e^iky e^-ilx P(k, -l)) / 2,  P(k, l) = a_k a_l sum p e^-ikc_y e^-ilc_x.
        """
        (kx, ax), (ky, ay) = map(_waves_of, (self.chip.x, self.chip.y))
        centres, power = self.layout.centres_um.reshape(-1, 2), self.layout.power.reshape(-1, 1)
        to_x, to_y = ax * np.exp(-1j * np.outer(centres[:, 0], kx)), ay * np.exp(-1j * np.outer(centres[:, 1], ky))
        along_x, along_y = np.exp(1j * np.outer(kx, x_um)), np.exp(1j * np.outer(y_um, ky))
        lit = (power * to_y).T
        both = (chip * (lit @ to_x)) @ along_x + (chip * (lit @ to_x.conj())) @ along_x.conj()
        return np.asarray((along_y @ both).real / 2.0)

    def _lost(self, way: Way, emission: EmissionArrays, rays: int, seed: int, threads: int | None) -> float:
        """Share of what would come up again without chips that does not with them, in an endless array."""
        albedo = float(self.scene.substrate.albedo(np.array([0.5]))[0])
        if not rays or albedo == 0.0:
            return 0.0
        axis = Axis(0.0, self.layout.spacing_um / 2.0, 1, "even")
        return -float(correction(way, emission, axis, axis, rays=rays, seed=seed, threads=threads)[0, 0]) / albedo


def open_array(scene: Scene) -> Array:
    """The layout of a scene that the twin knows as a module; InputError for any other, and for one too large."""
    layout = scene.layout
    if not isinstance(layout, Array) or layout.wall is not None or any(scene.tilt_per_um):
        what = "walls" if isinstance(layout, Array) and layout.wall else "cell or tilt"
        raise InputError("layout", what, "a finite array with open edges, level", "use cell_field or Monte Carlo")
    reach, most = _reach_um(scene, layout), (MOST_BINS - 1) * np.pi / LEAST_X * scene.height_um
    if reach > most:
        sides = f"{2 * layout.half_x_um:g} x {2 * layout.half_y_um:g} um"
        side = max(2.0 * max(layout.half_x_um, layout.half_y_um) - (reach - most), 0.0)
        mend = "fewer chips, a smaller pitch, or a higher receiver"
        raise InputError("array", sides, f"up to about {side:.0f} um a side at this height", mend)
    return layout


@dataclass(frozen=True)
class ChipMap:
    """Direct light of one chip, per emitted flux.

    coefficients : (group, layer, y, x), irradiance of the receiver in 1/um^2, in functions of the axes x and y.
    leaked : (group, y, x), what goes on inside the substrate, by squares of `step_um` about the chip; (group, 0, 0)
        where none does.
    """

    coefficients: Real
    leaked: Real
    step_um: float
    x: Axis
    y: Axis
    histories: int

    @property
    def nbytes(self) -> int:
        """In memory."""
        return int(self.coefficients.nbytes + self.leaked.nbytes)


class Lights(Held[tuple[ChipMap, float]]):
    """The light of chips, each reckoned once: modules whose chips only stand or shine otherwise share it.

    Where other light takes the same ways, these are walked once.
    """

    def __init__(self, most_bytes: int = HELD_BYTES) -> None:
        super().__init__(most_bytes, lambda one: one[0].nbytes)
        self.ways = Ways()


def digest_of(way: Way, emission: EmissionArrays, *facts: object) -> str:
    """Of all that decides the light of one chip among its neighbours."""
    traced = way.arrays
    digest = sha256(repr((traced.kept, traced.leak_share, *facts)).encode())
    for part in (*emission, traced.box, *traced.scene.parts, *traced.receiver.parts):
        digest.update(repr(part.shape).encode() + part.tobytes())
    return digest.hexdigest()


def surroundings(scene: Scene, layout: Array) -> tuple[Scene, Box]:
    """A chip at (0, 0) with as many others around it as any chip of the array sees, and bins around it; no edge."""
    reach = _reach_um(scene, layout)
    around = Array.regular(
        2 * layout.rows - 1, 2 * layout.columns - 1, layout.spacing_um, reach + 4.0 * scene.distance_um
    )
    bins = min(int(np.ceil(reach * BINS_PER_HEIGHT / scene.height_um)), MOST_BINS)
    if scene.emission.symmetric:
        oblong = layout.rows != layout.columns
        box = Box(0.0, 0.0, reach / bins, bins, bins, folded=True, cell=False, oblong=oblong)
    else:
        box = Box(-reach, -reach, reach / bins, 2 * bins, 2 * bins, folded=False, cell=False)
    return replace(scene, layout=around), box


def _reach_um(scene: Scene, layout: Array) -> float:
    """How far one chip's map goes. Chips a little beyond their lattice ask for no larger one: its pad is for them."""
    lattice = 0.5 * (max(layout.rows, layout.columns) - 1) * layout.spacing_um
    furthest = max(lattice, float(np.abs(layout.centres_um).max()) - SLACK * scene.distance_um)
    return max(layout.half_x_um, layout.half_y_um) + furthest + PAD * scene.distance_um


def one_chip(scene: Scene, tally: Tally) -> ChipMap:
    """One chip's direct light, out of its bins."""
    box = tally.box
    bins = box.columns if box.folded else box.columns // 2
    reach = bins * box.step_um
    modes = min(int(TAPER_END * CUTOFF_X / scene.height_um * reach / np.pi), bins - 1)
    layers, leaks = range(tally.bins.shape[1])[:INSIDE], tally.bins.shape[1] > INSIDE
    leaked = tally.cell_bins(INSIDE) / tally.histories if leaks else np.zeros((tally.groups, 0, 0))
    fields = [tally.cell_field(layer, 2.0 * reach, scene.height_um, modes) for layer in layers]
    x, y = fields[0].x, fields[0].y
    k = np.hypot(*np.meshgrid(y.wavenumber_per_um, x.wavenumber_per_um, indexing="ij"))
    fade = np.cos(np.pi / 2.0 * np.clip((k * scene.height_um / CUTOFF_X - 1.0) / (TAPER_END - 1.0), 0.0, 1.0)) ** 2
    cloud = np.multiply.outer(cloud_window(y, box.step_um), cloud_window(x, box.step_um))
    coefficients = np.stack([field.coefficients for field in fields], axis=1) * (fade / cloud) / (2.0 * reach) ** 2
    return ChipMap(coefficients, leaked, box.step_um, x, y, tally.total_histories)


def _displaced(at_um: Real, half_um: float, step_um: float, sd_um: float) -> tuple[Real, Real]:
    """Samples of a module along an axis, and the matrix (place, sample) of a Gaussian's weights over them."""
    count = int(np.ceil(2.0 * half_um / step_um))
    sample = ((np.arange(count) + 0.5) / count * 2.0 - 1.0) * half_um
    weight = np.exp(-0.5 * ((at_um[:, None] - sample) / sd_um) ** 2)
    return sample, weight * (2.0 * half_um / count / (sd_um * np.sqrt(2.0 * np.pi)))


def _waves_of(axis: Axis) -> tuple[Real, Complex]:
    """Wavenumbers k and amplitudes a of an axis' functions, Re(a e^ikx)."""
    k = axis.wavenumber_per_um
    amplitude = np.full(k.size, np.sqrt(2.0), complex)
    amplitude[0] = 1.0
    amplitude[axis.modes + 1 :] *= -1j  # the sines of a periodic axis
    return k, amplitude


def _samples(axis: Axis) -> Real:
    """Middles of twice as many equal parts of a box as it has modes."""
    count = 2 * max(axis.modes, 1)
    return np.asarray(axis.start_um + (np.arange(count) + 0.5) / count * axis.length_um)
