"""The module that rays are traced in, as frozen descriptions; effects of geometry are Scene -> Scene.

    z = D (1 + tilt . r)  ──────────────────── receiver
                              air
    z = T        ┌────┐  top: film             ┌────┐
                 │chip│  sides                 │chip│
    z = 0  ──────┴────┴────────────────────────┴────┴── substrate
                  |<-W->|
                  |<---------- spacing -------->|

A `Cell` repeats for ever in x and y; an `Array` is a finite module about its centre, open or walled at its edge.
Kernels see none of this but arrays made from it (`ray_tracing.packing`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Bsdf, Lambertian
from containers.checked import within
from luxloop.errors import InputError

Real = NDArray[np.float64]

DIRECTIONS = 401
"""Cosines at least, where an intensity is multiplied: a parabola is then met to 1e-5 of its rise."""
LEAST_INDEX, MOST_INDEX = 2.0**0.5, 10.0
"""Of a chip: unfolding needs n^2 of at least 2."""
CLEARANCE_UM = 1e-3
"""Chips must end this far below the receiver, and this far from each other."""


@dataclass(frozen=True)
class Face:
    """A face of the chip, seen from both sides, one surface per wavelength of the scene."""

    inside: tuple[Bsdf, ...]
    outside: tuple[Bsdf, ...]


@dataclass(frozen=True)
class Chip:
    """A cuboid of one material."""

    width_um: float
    thickness_um: float
    index: Real
    """(wavelength,), refractive index."""
    top: Face
    sides: Face
    bottom: Literal["contact", "mirror", "air_gap"] = "contact"
    mirror: Bsdf | None = None
    """What light meets at the bottom, where `bottom` is mirror; below an air gap where that is not the substrate."""
    absorption_per_um: float = 0.0
    """The mean over its height."""
    absorption_rise_per_um: float = 0.0
    """How much more it is at the top than on average, and less at the bottom, linear in between; below 0: falling."""

    def __post_init__(self) -> None:
        within("width_um", self.width_um, 0.0, 1e5, "the side of the chip", above=True)
        within("thickness_um", self.thickness_um, 0.0, 1e5, "the height of the chip", above=True)
        most = float(within("absorption_per_um", self.absorption_per_um, 0.0, 1e3, "1 /cm is 1e-4 /um"))
        within("absorption_rise_per_um", self.absorption_rise_per_um, -most, most, "no part of the chip may amplify")
        index = within("index", self.index, LEAST_INDEX, MOST_INDEX, "unfolding needs n^2 of at least 2")
        if index.ndim != 1 or not index.size:
            raise InputError("index", index.shape, "one number per wavelength")
        if self.bottom != "air_gap" and (self.bottom == "mirror") != (self.mirror is not None):
            raise InputError("mirror", self.mirror, "a surface where bottom is mirror, and none where it is contact")


@dataclass(frozen=True)
class Emission:
    """Where and whereto light is born in a chip; tables of weights, so that an effect multiplies them."""

    layer_depth: float | None = None
    """Height of a thin active layer as a share of T; None: the whole volume."""
    layer_reach: float = 0.0
    """By how much of its height the layer reaches down from there, evenly; 0: a thin one."""
    cosine: Real = field(default_factory=lambda: np.array([-1.0, 1.0]))
    """(m,), increasing, cosine to the chip's normal, of the intensity below."""
    intensity: Real = field(default_factory=lambda: np.ones(2))
    """(m,), power per solid angle inside the chip, relative, linear in between."""
    position: Real = field(default_factory=lambda: np.ones((1, 1)))
    """(y, x), weights of equal cells of the chip's area, row 0 at the lowest y."""
    from_top: bool = False
    """Lambert's law into the air from the top face instead (golden case A); the fields above are then not used."""

    def __post_init__(self) -> None:
        if self.layer_depth is not None:
            within("layer_depth", self.layer_depth, 0.0, 1.0, "a share of the chip's thickness")
        most = 0.0 if self.layer_depth is None else 1.0
        within("layer_reach", self.layer_reach, 0.0, most, "a share of the layer's height; a whole volume has none")
        cosine = within("cosine", self.cosine, -1.0, 1.0, "from -1 to 1")
        intensity = within("intensity", self.intensity, 0.0, 1e12, "weights")
        position = within("position", self.position, 0.0, 1e12, "weights")
        if (
            cosine.ndim != 1
            or cosine.size < 2
            or cosine.shape != intensity.shape
            or not np.all(np.diff(cosine) > 0.0)
        ):
            raise InputError("cosine", cosine.shape, "increasing cosines, one for each intensity")
        if position.ndim != 2 or not position.sum() > 0.0 or not intensity.sum() > 0.0:
            raise InputError("position", position.shape, "weights (y, x), not all 0", "something must shine")

    @property
    def heights(self) -> tuple[float, float]:
        """The lowest and the highest place where light is born, as shares of T: evenly in between."""
        if self.layer_depth is None:
            return 0.0, 1.0
        return (1.0 - self.layer_reach) * self.layer_depth, self.layer_depth

    def by_direction(self, factor: Callable[[Real], Real]) -> Emission:
        """The emission with its intensity multiplied by a function of the cosine to the chip's normal."""
        cosine = np.union1d(self.cosine, np.linspace(self.cosine[0], self.cosine[-1], DIRECTIONS))
        intensity = np.interp(cosine, self.cosine, self.intensity) * factor(cosine)
        return replace(self, cosine=cosine, intensity=intensity)

    def by_place(self, weights: Real) -> Emission:
        """The emission with its weights of places multiplied by those (y, x) of equal cells of the chip's area."""
        shape = [int(np.lcm(a, b)) for a, b in zip(self.position.shape, weights.shape, strict=True)]
        fine = [
            np.kron(one, np.ones((shape[0] // one.shape[0], shape[1] // one.shape[1])))
            for one in (self.position, weights)
        ]
        return replace(self, position=fine[0] * fine[1])

    @property
    def symmetric(self) -> bool:
        """Whether the place of emission has the eight symmetries of the square."""
        p = self.position
        return p.shape[0] == p.shape[1] and all(np.array_equal(p, q) for q in (p[::-1], p[:, ::-1], p.T))


@dataclass(frozen=True)
class Receiver:
    """The diffuser above, and what is recorded of the light that arrives there."""

    bsdf: Bsdf
    spread_share: float = 0.0
    """Share of the recorded light that is displaced inside the plate."""
    spread_um: float = 0.0
    """Standard deviation of that displacement, in x and in y."""
    response: Real = field(default_factory=lambda: np.ones(2))
    """(m,), weight of the recorded light at equal steps of its cosine of incidence, 0 to 1."""

    def __post_init__(self) -> None:
        within("spread_share", self.spread_share, 0.0, 1.0, "a share of the light")
        within("spread_um", self.spread_um, 0.0, 1e4, "a standard deviation in um")
        if within("response", self.response, 0.0, 1e6, "weights").size < 2:
            raise InputError("response", self.response, "at least two numbers, at cosine 0 and 1")


@dataclass(frozen=True)
class Cell:
    """One chip in a square cell that repeats."""

    spacing_um: float

    @property
    def symmetric(self) -> bool:
        """It has the eight symmetries of the square."""
        return True


@dataclass(frozen=True)
class Array:
    """Rows (along y) x columns (along x) of chips about the module's centre."""

    rows: int
    columns: int
    spacing_um: float
    half_x_um: float
    half_y_um: float
    """The module's edges: planes |x|, |y| = half, from substrate to receiver."""
    power: Real
    """(row, column), relative; 1 is the nominal chip, 0 a dead one."""
    offset_um: Real
    """(row, column, 2), displacement (x, y) of each chip from its place."""
    wall: Bsdf | None = None
    """What stands at the edge, and lets through what it does not reflect; None: it is open, what crosses is lost."""

    def __post_init__(self) -> None:
        for name, value in (("rows", self.rows), ("columns", self.columns)):
            within(name, value, 1, 1000, "at least one chip")
        if np.shape(self.power) != (self.rows, self.columns):
            raise InputError("power", np.shape(self.power), f"({self.rows}, {self.columns})", "one per chip")
        if np.shape(self.offset_um) != (self.rows, self.columns, 2):
            raise InputError("offset_um", np.shape(self.offset_um), f"({self.rows}, {self.columns}, 2)", "x and y")
        if not within("power", self.power, 0.0, 1e3, "relative to the nominal chip").sum() > 0.0:
            raise InputError("power", 0.0, "at least one chip that shines", "one power above 0")

    @classmethod
    def regular(
        cls, rows: int, columns: int, spacing_um: float, half_um: float | None = None, wall: Bsdf | None = None
    ) -> Array:
        """Equal chips at their places; the edge half a spacing beyond the outer ones unless `half_um` is given."""
        half_x, half_y = (half_um if half_um is not None else count * spacing_um / 2.0 for count in (columns, rows))
        return cls(
            rows, columns, spacing_um, half_x, half_y, np.ones((rows, columns)), np.zeros((rows, columns, 2)), wall
        )

    @property
    def symmetric(self) -> bool:
        """Whether it has the eight symmetries of the square: equal chips at their places, as many each way."""
        square = self.rows == self.columns and self.half_x_um == self.half_y_um
        return square and not np.any(self.offset_um) and bool(np.ptp(self.power) == 0.0)

    @property
    def origin_um(self) -> tuple[float, float]:
        """Place (x, y) of the chip in column 0, row 0, before its displacement."""
        return -(self.columns - 1) / 2.0 * self.spacing_um, -(self.rows - 1) / 2.0 * self.spacing_um

    @property
    def centres_um(self) -> Real:
        """(row, column, 2), (x, y) of every chip."""
        x, y = self.origin_um
        places = np.stack(np.meshgrid(np.arange(self.columns), np.arange(self.rows)), axis=-1) * self.spacing_um
        return np.asarray(places + np.array([x, y]) + self.offset_um)


@dataclass(frozen=True)
class Scene:
    """Everything the tracer is asked about."""

    layout: Cell | Array
    chip: Chip
    distance_um: float
    """From the substrate to the receiver, at the module's centre."""
    emission: Emission
    substrate: Bsdf
    receiver: Receiver
    wavelength_weight: Real = field(default_factory=lambda: np.ones(1))
    """(wavelength,), of sum 1."""
    tilt_per_um: tuple[float, float] = (0.0, 0.0)
    """Relative rise of the receiver along x and y."""
    tops: tuple[tuple[Face, Real], ...] = ()
    """Top faces that chips of an array have instead of the chip's, and the share (row, column) or (column,) that each
    has of their light, of sum 1; none: all have the chip's."""
    leak_share: float = 0.0
    """Of the light that reaches the substrate beside the chips: goes on inside it and comes out again elsewhere."""
    leak_um: float = 0.0
    """L of the density exp(-r / L) / (2 pi L^2) of that displacement."""

    def __post_init__(self) -> None:
        within("leak_share", self.leak_share, 0.0, 1.0, "a share of the light at the substrate")
        within("leak_um", self.leak_um, 0.0, 1e5, "a length in um")
        self._refuse_what_does_not_fit()
        self._refuse_wavelengths()
        if float(np.min(self.receiver.bsdf.albedo(np.linspace(0.0, 1.5, 4)))) >= 1.0:
            raise InputError("receiver.reflectance", 1.0, "below 1", "the receiver must take some light")

    @property
    def height_um(self) -> float:
        """From the chips' top to the receiver."""
        return self.distance_um - self.chip.thickness_um

    @property
    def symmetric(self) -> bool:
        """Whether the map of the cell, or of the module, has the eight symmetries of the square."""
        even = not any(self.tilt_per_um) and not self.tops
        return self.layout.symmetric and self.emission.symmetric and even

    def _refuse_what_does_not_fit(self) -> None:
        within("distance_um", self.distance_um, 0.0, 1e6, "above the chips", above=True)
        lowest = self.distance_um
        width, spacing = self.chip.width_um, self.layout.spacing_um
        within("spacing_um", spacing, 0.0, 1e6, "from chip to chip", above=True)
        within("tilt_per_um", self.tilt_per_um, -1e3, 1e3, "relative rise per um")
        if width + CLEARANCE_UM > spacing:
            raise InputError("width_um", width, f"below the spacing {spacing:g} um", "the chips overlap")
        if isinstance(self.layout, Array):
            reach = np.abs(self.tilt_per_um) @ (self.layout.half_x_um, self.layout.half_y_um)
            lowest *= 1.0 - float(reach)
            self._refuse_displaced(self.layout)
        elif any(self.tilt_per_um):
            raise InputError("tilt_per_um", self.tilt_per_um, "0 for a cell that repeats", "tilt a finite array")
        if lowest < self.chip.thickness_um + CLEARANCE_UM:
            allowed = f"above the chips, {self.chip.thickness_um + CLEARANCE_UM:g} um"
            raise InputError("distance_um", lowest, allowed, "lift the receiver or take a thinner chip")

    def _refuse_displaced(self, array: Array) -> None:
        room = (array.spacing_um - self.chip.width_um - CLEARANCE_UM) / 2.0
        if room >= 0.0:
            within("offset_um", array.offset_um, -room, room, "a chip must stay within its own cell")
        x, y = array.origin_um
        for name, half, outer in (("half_x_um", array.half_x_um, -x), ("half_y_um", array.half_y_um, -y)):
            least = outer + self.chip.width_um / 2.0 + float(np.abs(array.offset_um).max(initial=0.0))
            if not half > least:
                raise InputError(name, half, f"above {least:g} um", "the module must hold its chips")

    def _refuse_wavelengths(self) -> None:
        waves = self.chip.index.size
        weight = within("wavelength_weight", self.wavelength_weight, 0.0, 1.0, "shares of sum 1")
        if weight.shape != (waves,) or abs(float(weight.sum()) - 1.0) > 1e-9:
            raise InputError("wavelength_weight", weight.shape, f"{waves} shares of sum 1", "one per wavelength")
        for name, face in (("top", self.chip.top), ("sides", self.chip.sides)):
            if not len(face.inside) == len(face.outside) == waves:
                raise InputError(f"chip.{name}", len(face.inside), f"{waves} surfaces", "one per wavelength")


def lambertian_receiver(reflectance: float) -> Receiver:
    """A diffuser that sends `reflectance` back by Lambert's law and records everything."""
    return Receiver(Lambertian(reflectance))
