"""The parameters by which images are differentiated: each moves a scene, or the camera, and knows a useful step.

Steps of scenes are 1 to 3 % of a parameter: with common random numbers and shared arrivals smaller ones bring
nothing, larger ones begin to bend (benchmarks/twin.py has the differences of half and double steps). The lobe's
sigma is moved by 30 %: rays that are scattered otherwise share little, so that 3 % leave a derivative of noise (0.5
of it on the clear chip, 0.07 here), and light goes with sigma^2, of which a central difference is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from containers.bsdf import Bsdf, GaussianLobe, Lambertian, Mirror, Mixture, SpecularTable
from containers.ray_tracing.packing import node_angles
from containers.scene import Array, Face, Scene
from luxloop.camera import Camera
from luxloop.errors import InputError


@dataclass(frozen=True)
class Column:
    """A parameter of a scene."""

    name: str
    value: Callable[[Scene], float]
    move: Callable[[Scene, float], Scene]
    """The scene with the parameter raised by an amount."""
    step: Callable[[float], float]
    """Of a difference, at a value."""
    low: float = 0.0
    high: float = np.inf

    def stencil(self, scene: Scene) -> tuple[tuple[float, float], ...]:
        """Amounts to move by and their weights: a derivative of second order within the range.

        Where a scene cannot be moved to both sides (chips that nearly touch each other, or the receiver), to one.

        Raises
        ------
        InputError : a scene without the parameter, one that leaves no room for two steps on either side, or where the
            parameter is 0 and steps are shares of it.
        """
        value = self.value(scene)
        h = self.step(value)
        if not h > 0.0:
            mend = "its step is a share of it: leave the column out, or start from a small value"
            raise InputError(self.name, value, "above 0", mend)
        for steps in (
            ((h, 0.5 / h), (-h, -0.5 / h)),
            ((0.0, -1.5 / h), (h, 2.0 / h), (2.0 * h, -0.5 / h)),
            ((0.0, 1.5 / h), (-h, -2.0 / h), (-2.0 * h, 0.5 / h)),
        ):
            if all(self._has_room(scene, value, amount) for amount, _ in steps):
                return steps
        raise InputError(self.name, value, f"room for two steps of {h:g} on one side", "leave the column out")

    def _has_room(self, scene: Scene, value: float, amount: float) -> bool:
        if not self.low <= value + amount <= self.high:
            return False
        try:
            self.move(scene, amount)
        except InputError:
            return False
        return True


def _share_of(share: float, least: float = 0.0) -> Callable[[float], float]:
    return lambda value: max(share * value, least)


def _chip(scene: Scene, name: str, amount: float) -> Scene:
    changes: dict[str, Any] = {name: getattr(scene.chip, name) + amount}
    return replace(scene, chip=replace(scene.chip, **changes))


def _absorption(name: str, rise: float) -> Column:
    """So much more absorption on average, and `rise` times that at the top beyond it."""

    def move(scene: Scene, amount: float) -> Scene:
        mean, more = scene.chip.absorption_per_um + amount, scene.chip.absorption_rise_per_um + rise * amount
        return replace(scene, chip=replace(scene.chip, absorption_per_um=mean, absorption_rise_per_um=more))

    return Column(name, lambda s: s.chip.absorption_per_um, move, _share_of(0.03, 1e-5))


def _spaced(scene: Scene, amount: float) -> Scene:
    """Chips and edges move outwards together."""
    layout = scene.layout
    ratio = (layout.spacing_um + amount) / layout.spacing_um
    if not isinstance(layout, Array):
        return replace(scene, layout=replace(layout, spacing_um=layout.spacing_um + amount))
    halves = {name: ratio * getattr(layout, name) for name in ("half_x_um", "half_y_um")}
    return replace(scene, layout=replace(layout, spacing_um=layout.spacing_um + amount, **halves))


def _scaled(bsdf: Bsdf, ratio: float) -> Bsdf:
    """The same scatter with the reflectance times a ratio."""
    if isinstance(bsdf, Lambertian | GaussianLobe | Mirror):
        return replace(bsdf, reflectance=bsdf.reflectance * ratio)
    if isinstance(bsdf, Mixture):
        return Mixture(tuple(_scaled(part, ratio) for part in bsdf.parts), bsdf.shares)
    raise InputError("surface", type(bsdf).__name__, "Lambertian, GaussianLobe, Mirror or a Mixture of them")


def _reflectance(bsdf: Bsdf) -> float:
    return float(bsdf.albedo(np.array([0.5]))[0])


def _substrate(scene: Scene, amount: float) -> Scene:
    """The substrate and, where the chip stands on a mirror, that too: one coat."""
    ratio = 1.0 + amount / _reflectance(scene.substrate)
    scene = replace(scene, substrate=_scaled(scene.substrate, ratio))
    if scene.chip.mirror is None:
        return scene
    return replace(scene, chip=replace(scene.chip, mirror=_scaled(scene.chip.mirror, ratio)))


def _widened(bsdf: Bsdf, amount: float) -> Bsdf:
    if isinstance(bsdf, GaussianLobe):
        return replace(bsdf, sigma_rad=bsdf.sigma_rad + amount)
    if isinstance(bsdf, Mixture):
        return Mixture(tuple(_widened(part, amount) for part in bsdf.parts), bsdf.shares)
    return bsdf


def _sigma(bsdf: Bsdf) -> float:
    parts = bsdf.parts if isinstance(bsdf, Mixture) else (bsdf,)
    sigmas = [part.sigma_rad for part in parts if isinstance(part, GaussianLobe)]
    if not sigmas:
        raise InputError("substrate", type(bsdf).__name__, "a Gaussian lobe, or a Mixture with one")
    return sigmas[0]


def _receiver(scene: Scene, amount: float) -> Scene:
    bsdf = scene.receiver.bsdf
    return replace(scene, receiver=replace(scene.receiver, bsdf=_scaled(bsdf, 1.0 + amount / _reflectance(bsdf))))


COLUMNS = {
    column.name: column
    for column in (
        Column("distance_um", lambda s: s.distance_um,
               lambda s, a: replace(s, distance_um=s.distance_um + a), _share_of(0.01)),
        Column("spacing_um", lambda s: s.layout.spacing_um, _spaced, _share_of(0.01)),
        Column("width_um", lambda s: s.chip.width_um, lambda s, a: _chip(s, "width_um", a), _share_of(0.03)),
        Column("thickness_um", lambda s: s.chip.thickness_um,
               lambda s, a: _chip(s, "thickness_um", a), _share_of(0.03)),
        Column("substrate_reflectance", lambda s: _reflectance(s.substrate), _substrate, _share_of(0.01), high=1.0),
        Column("substrate_sigma_rad", lambda s: _sigma(s.substrate),
               lambda s, a: replace(s, substrate=_widened(s.substrate, a)), _share_of(0.3)),
        Column("receiver_reflectance", lambda s: _reflectance(s.receiver.bsdf), _receiver,
               _share_of(0.03), high=0.999),
        _absorption("absorption_per_um", 0.0),
        _absorption("absorption_to_top_per_um", 1.0),
        _absorption("absorption_to_bottom_per_um", -1.0),
    )
}  # fmt: skip
"""Those of scenes, by name; per um, rad, or of a share of 1. Absorption to the top or to the bottom: its mean, and
with it its rise to there."""


@dataclass(frozen=True)
class CameraColumn:
    """A parameter of the camera: only what it sees of a map changes, the map does not."""

    name: str
    move: Callable[[Camera, float], Camera]
    """The camera with the parameter raised by an amount."""
    step: float
    """Of a central difference: it errs by (k step)^2 / 6 of a wave k, 2e-4 for a period of 4 pixels."""


def _shifted(camera: Camera, rows: float, columns: float) -> Camera:
    row, column = camera.shift_px
    return camera.model_copy(update={"shift_px": (row + rows, column + columns)})


CAMERA_COLUMNS = {
    column.name: column
    for column in (
        CameraColumn("shift_row_px", lambda c, a: _shifted(c, a, 0.0), 0.02),
        CameraColumn("shift_column_px", lambda c, a: _shifted(c, 0.0, a), 0.02),
        CameraColumn("rotation_deg", lambda c, a: c.model_copy(update={"rotation_deg": c.rotation_deg + a}), 0.01),
    )
}
"""Those of the camera (of it, not of the scene), by name; per pixel or degree."""


def film_column(tops: Callable[[Scene], Face], name: str = "film") -> Column:
    """The top face moved towards another one: at 0 the scene's own, at 1 that of `tops` (of the same index).

    A film's thickness, index or roughness changes its powers R and T in proportion as long as the change is small.
    """

    def move(scene: Scene, amount: float) -> Scene:
        own, other = scene.chip.top, tops(scene)
        inside, outside = (
            tuple(_between(a, b, amount) for a, b in zip(getattr(own, side), getattr(other, side), strict=True))
            for side in ("inside", "outside")
        )
        return replace(scene, chip=replace(scene.chip, top=Face(inside, outside)))

    return Column(name, lambda _: 0.0, move, lambda _: 0.25, low=-1.0, high=1.0)


def _between(own: Bsdf, other: Bsdf, amount: float) -> SpecularTable:
    """Powers (1 - amount) own + amount other, at the kernels' nodes and those of tables among them."""
    n = max(own.index_ratio, 1.0 / own.index_ratio)
    nodes = [
        node_angles(n, own.index_ratio > 1.0),
        *(f.theta_in_rad for f in (own, other) if isinstance(f, SpecularTable)),
    ]
    theta = np.unique(np.concatenate(nodes))
    (R, T), (R1, T1) = own.deltas(theta), other.deltas(theta)
    R, T = (np.clip(a + amount * (b - a), 0.0, 1.0) for a, b in ((R, R1), (T, T1)))
    return SpecularTable(theta, R, np.minimum(T, 1.0 - R), own.index_ratio)
