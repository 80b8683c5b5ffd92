"""What cameras would see at parameters near an anchor, and how that changes with each parameter.

    prediction(theta) = Monte Carlo at the anchor + twin(theta) - twin(anchor)

The twin's own error is nearly the same at both and cancels; what is left of the noise is that of one Monte Carlo run,
the same at all parameters, and its covariance is known. All images here are irradiance in 1/mm^2 per flux of a chip,
before gain and what the sensor does (`camera.response`): up to there a camera is linear.
"""

from __future__ import annotations

from collections import OrderedDict, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.camera import irradiance_image, margin_px, pixels, receiver_points
from containers.ray_tracing.exits import Exits, chip_key
from containers.ray_tracing.field import Field
from containers.ray_tracing.light_map import LightMap
from containers.ray_tracing.twin.columns import Column
from containers.ray_tracing.twin.direct import in_parallel
from containers.ray_tracing.twin.module import BINS_PER_HEIGHT, PAD, ModuleTwin
from containers.ray_tracing.twin.reweighting import reweighted, without_what_is_noted
from containers.scene import Array, Scene
from luxloop.camera import Camera
from luxloop.errors import InputError

Real = NDArray[np.float64]
EFFECTIVE, INEXACT = 0.9, 0.05
"""Share of exits that must stay effective, and of light whose weight may be inexact, where exits are reweighted."""
RECENT = 32
Grid = Callable[[Any, Any], Any]
"""From x (x,) and y (y,) to values (..., y, x) in 1/mm^2."""


@dataclass(frozen=True)
class Shot:
    """A finite module and the camera in front of it."""

    scene: Scene
    camera: Camera


class Supply:
    """Exits for chips that differ little, from as few walks inside chips as possible.

    Parameters
    ----------
    make : from a scene to exits of its chip, with notes; always with one seed, so that chips share random numbers.
    """

    def __init__(self, make: Callable[[Scene], Exits]) -> None:
        self._make = make
        self._held: dict[str, list[tuple[Scene, Exits]]] = defaultdict(list)
        self._recent: OrderedDict[tuple[int, ...], tuple[Scene, Exits]] = OrderedDict()

    def of(self, scene: Scene) -> Exits:
        """Exits of the scene's chip, reweighted where a chip much like it was walked in before."""
        known = id(scene.chip), id(scene.substrate), id(scene.emission)
        if known not in self._recent:
            self._recent[known] = scene, self._find(scene)  # the scene is kept, so that no other gets its ids
            if len(self._recent) > RECENT:
                self._recent.popitem(last=False)
        return self._recent[known][1]

    def _find(self, scene: Scene) -> Exits:
        alike = self._held[chip_key(without_what_is_noted(scene)[0])]
        for stored, exits in alike:
            found = reweighted(exits, stored, scene)
            if found.effective_share > EFFECTIVE and found.inexact_share < INEXACT:
                return found.exits
        made = self._make(scene)
        alike.append((scene, made))
        return made


@dataclass(frozen=True)
class Prediction:
    """Images and the noise that Monte Carlo left in them."""

    images_per_mm2: Real
    """(shot, row, column)"""
    noise_per_mm2: Real
    """(group, shot, row, column): the covariance of two pixels is the sum over groups of their products."""

    @property
    def error_per_mm2(self) -> Real:
        """Standard error of each pixel, (shot, row, column)."""
        return np.asarray(np.sqrt((self.noise_per_mm2**2).sum(axis=0)))


class Anchor:
    """Shots at whose parameters Monte Carlo was run.

    Parameters
    ----------
    fields : of the modules, by Monte Carlo, one for each shot, with equally many groups. Groups of one number are
        taken as related (one run seen by several cameras); of different runs their products are noise about 0.
    """

    def __init__(self, shots: Sequence[Shot], fields: Sequence[Field], supply: Supply, **options: int) -> None:
        if len(shots) != len(fields) or len({field.groups for field in fields}) != 1:
            raise InputError("fields", len(fields), f"{len(shots)}, one for each shot, with equally many groups")
        replicas = np.stack([image_of(field.grid, shot) for shot, field in zip(shots, fields, strict=True)], axis=1)
        self.shots, self._supply, self._options = tuple(shots), supply, options
        mean, groups = replicas.mean(axis=0), len(replicas)
        self._noise = (replicas - mean) / np.sqrt(groups * (groups - 1.0))
        self._correction = mean - twin_images(shots, supply, **options)

    def predict(self, shots: Sequence[Shot]) -> Prediction:
        """The images of the same shots at other parameters."""
        if len(shots) != len(self.shots):
            raise InputError("shots", len(shots), f"{len(self.shots)}, those of the anchor")
        return Prediction(twin_images(shots, self._supply, **self._options) + self._correction, self._noise)


def twin_images(shots: Sequence[Shot], supply: Supply, *, threads: int | None = None, **options: int) -> Real:
    """The twin's images (shot, row, column), several at once; `options` are `ModuleTwin`'s blocks and shadow_rays."""
    if len({(shot.camera.rows, shot.camera.columns) for shot in shots}) != 1:
        raise InputError("shots", "images of several sizes", "one size", "predict them in groups")
    exits = [supply.of(shot.scene) for shot in shots]
    images = np.zeros((len(shots), shots[0].camera.rows, shots[0].camera.columns))

    def see(number: int) -> None:
        shot = shots[number]
        images[number] = image_of(ModuleTwin(shot.scene, exits[number], threads=1, **options).mean, shot)

    in_parallel(see, range(len(shots)), threads)
    return images


def jacobian(shots: Sequence[Shot], columns: Sequence[Column], supply: Supply, **options: int) -> Real:
    """Derivatives (column, shot, row, pixel column) of the twin's images by each column's parameter, per its unit.

    Notes
    -----
    Central differences, at an end of a range one-sided ones of the same order, all with the same random numbers.
    """
    found = []
    for column in columns:
        derivative: Real = np.zeros(1)
        for amount, weight in column.stencil(shots[0].scene):
            moved = [Shot(column.move(shot.scene, amount), shot.camera) for shot in shots]
            derivative = derivative + weight * twin_images(moved, supply, **options)
        found.append(derivative)
    return np.stack(found)


def image_of(grid: Grid, shot: Shot) -> Real:
    """The irradiance (..., row, column) that a shot's pixels see of a map."""
    return irradiance_image(light_map(grid, shot), shot.camera)


def light_map(grid: Grid, shot: Shot) -> LightMap:
    """A map as far as the camera sees, PSF included (with glare: all of it), with eight samples per height."""
    layout, camera, distance = shot.scene.layout, shot.camera, shot.scene.distance_um
    if not isinstance(layout, Array):
        raise InputError("layout", type(layout).__name__, "a finite array", "a cell's map is its field's")
    step = shot.scene.height_um / BINS_PER_HEIGHT
    reach = np.inf if camera.glare else _reach_um(camera) + 4.0 * step
    counts, dark = [], False
    for half in (layout.half_x_um, layout.half_y_um):
        whole = half + PAD * distance
        dark = dark or whole <= reach
        counts.append(int(np.ceil(min(whole, reach) / step)))
    x, y = ((np.arange(2 * count) + 0.5 - count) * step for count in counts)
    return LightMap(grid(x, y), (float(x[0]), float(y[0])), step, "dark" if dark else "mirror")


def _reach_um(camera: Camera) -> float:
    before = margin_px(camera)
    row, column = pixels(camera.rows + 2 * before, -before), pixels(camera.columns + 2 * before, -before)
    x, y, side = receiver_points(camera, row[[0, -1]], column[[0, -1]])
    return float((np.maximum(np.abs(x), np.abs(y)) + side).max())
