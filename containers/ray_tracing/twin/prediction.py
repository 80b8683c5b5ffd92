"""What cameras would see at parameters near an anchor, and how that changes with each parameter.

    map(theta) = twin(theta) + s (Monte Carlo at the anchor - twin(anchor)), s = light at theta / there
    image(theta) = what the camera at theta sees of that map

The twin's own error is nearly the same share of the light at both and cancels; what is left of the noise is that of
one Monte Carlo run, the same share at all parameters, and its covariance is known. With s = 1 a gain that is fitted
makes too much or too little of both wherever the light of an image has changed. Difference and sum are of maps, so
that a plate that scatters and a lens that blurs, stretches or darkens do so to all of the light; told noise
stays in the anchor's pixels. All images here are irradiance in 1/mm^2 per flux of a chip, before gain and what the
sensor does (`camera.response`): up to there a camera is linear.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.acting import NONE, Effects
from containers.ray_tracing.camera import irradiance_image, pixels, reach_um, receiver_points
from containers.ray_tracing.field import Field
from containers.ray_tracing.light_map import LightMap
from containers.ray_tracing.several_tops import scenes_of
from containers.ray_tracing.twin.birthplace import evenly_lit
from containers.ray_tracing.twin.columns import CameraColumn, Column
from containers.ray_tracing.twin.difference import Difference, Plate, without_noise
from containers.ray_tracing.twin.module import BINS_PER_HEIGHT, PAD, ModuleTwin
from containers.ray_tracing.twin.noise import NoiseBasis, most_functions, noise_columns
from containers.ray_tracing.twin.parallel import in_parallel
from containers.ray_tracing.twin.supply import Supply
from containers.scene import Array, Scene
from luxloop.camera import Camera
from luxloop.errors import InputError

Real = NDArray[np.float64]
Grid = Callable[[Any, Any], Any]
"""From x (x,) and y (y,) to values (..., y, x) in 1/mm^2."""
Report = Callable[[], None]


def nothing() -> None:
    """A report that nobody hears."""


@dataclass(frozen=True)
class Shot:
    """A finite module and the camera in front of it."""

    scene: Scene
    """As the twin knows it."""
    camera: Camera
    name: str = "shots"
    """By which it is called where it cannot be predicted."""
    base: Scene | None = None
    """Whose chip's exits may stand for those of this one; none: they are walked."""
    effects: Effects = NONE
    """Those on the light in the camera act on its images; the others have acted."""
    whole: Scene | None = None
    """With what the twin cannot represent, for Monte Carlo; none: the scene is whole."""

    @property
    def traced(self) -> Scene:
        """What Monte Carlo traces."""
        return self.whole or self.scene

    def evenly_lit(self) -> Shot:
        """The shot of chips that shine evenly; itself where the twin does not know how unevenly they do."""
        scene, whole = evenly_lit(self.scene), self.whole
        if scene is self.scene:
            return self
        if whole is None:
            return replace(self, scene=scene)
        known = np.array_equal(whole.emission.position, self.scene.emission.position)
        return replace(self, scene=scene, whole=evenly_lit(whole)) if known else self

    def image(self, light: LightMap, camera: Camera | None = None) -> Real:
        """The irradiance (..., row, column) that the pixels see of a map, by another camera where one is given."""
        camera = camera or self.camera
        return self.effects.light(irradiance_image(light, camera), camera)


@dataclass(frozen=True)
class Prediction:
    """Images and the noise that Monte Carlo left in them."""

    images_per_mm2: Real
    """(shot, row, column)"""
    noise_per_mm2: Real
    """(function, shot, row, column): the covariance of two pixels is the sum over functions of their products; 0
    functions where no Monte Carlo was run."""

    of_camera_per_mm2: Real
    """(camera column, shot, row, column): how the twin's images change with the camera, without the run's noise."""
    twin_per_mm2: Real
    """(shot, row, column): the twin's alone, without the anchor's Monte Carlo and its noise."""
    images_by_camera_per_mm2: Real
    """(camera column, shot, row, column): how the images themselves change with the camera, what the twin misses
    moved, too: where the anchor is, with the run's noise and none of the twin's."""

    @property
    def error_per_mm2(self) -> Real:
        """Standard error of each pixel, (shot, row, column)."""
        return np.asarray(np.sqrt((self.noise_per_mm2**2).sum(axis=0)))


class Anchor:
    """Shots at whose parameters Monte Carlo was run.

    Parameters
    ----------
    fields : by Monte Carlo, one for each shot, of its module with chips that shine evenly (`Shot.evenly_lit`):
        without the symmetries it has 8 times as much variance. With equally many groups; the same object where one
        run is seen by several cameras. None: no Monte Carlo, only chips whose exits stand for those of others.
    more : tells what unevenness adds at the anchor by more sets of exits than `supply` does; none: that does.
    surely : what the twin misses is known without what may be noise of the runs, for differences between images; the
        noise itself is not told.
    """

    def __init__(
        self,
        shots: Sequence[Shot],
        fields: Sequence[Field] | None,
        supply: Supply,
        more: Supply | None = None,
        surely: bool = False,
        /,
        *,
        report: Report = nothing,
        **options: int,
    ) -> None:
        self.shots, self._options = tuple(shots), options
        size = refuse_several_sizes(shots)
        self._differences: list[Difference] | None = None
        self._noise, self._light = np.zeros((0, len(shots), *size), np.float32), np.zeros(len(shots))
        if fields is None:
            return
        if len(shots) != len(fields) or len({field.groups for field in fields}) != 1:
            raise InputError("fields", len(fields), f"{len(shots)}, one for each shot, with equally many groups")
        even = [shot.evenly_lit() for shot in shots]
        maps = twin_maps(even, supply, report=report, **options)
        if not surely:
            self._noise = _noise_of(fields, even, _seen(even, maps), report, options.get("threads"))
        truth = [_mean_map(field, shot) for field, shot in zip(fields, even, strict=True)]
        if any(one is not other for one, other in zip(even, shots, strict=True)):
            uneven = twin_maps(shots, more or supply, report=report, **options)
            evenly = twin_maps(even, more or supply, report=report, **options) if surely else maps
            truth = [
                of + shining.irradiance_per_mm2 - without.irradiance_per_mm2
                for of, shining, without in zip(truth, uneven, evenly, strict=True)
            ]
            maps = twin_maps(shots, supply, report=report, **options)
        missing = [of - light.irradiance_per_mm2 for of, light in zip(truth, maps, strict=True)]
        if surely:
            missing = [
                without_noise(one, light.step_um, field)
                for one, light, field in zip(missing, maps, fields, strict=True)
            ]
        self._differences = [
            Difference(one, light.irradiance_per_mm2, light.step_um, Plate.of(shot.scene))
            for one, light, shot in zip(missing, maps, shots, strict=True)
        ]
        self._light = _seen(shots, maps).sum(axis=(1, 2))

    def predict(
        self,
        shots: Sequence[Shot],
        supply: Supply,
        cameras: Sequence[CameraColumn] = (),
        *,
        report: Report = nothing,
    ) -> Prediction:
        """The images of the same shots at other parameters, by the exits of the anchor's chips where they can be."""
        near = self.near(shots)
        seen = _views(near, supply, cameras, self._differences, report=report, **self._options)
        images, twin, of_camera, of_images = seen
        share = _share_of(twin.sum(axis=(1, 2)), self._light)[:, None, None]
        return Prediction(images, share * self._noise, of_camera, twin, of_images)

    def near(self, shots: Sequence[Shot]) -> list[Shot]:
        """The shots with the exits of the anchor's chips, where these can stand for theirs."""
        if len(shots) != len(self.shots):
            raise InputError("shots", len(shots), f"{len(self.shots)}, those of the anchor")
        return [replace(shot, base=at.scene) for shot, at in zip(shots, self.shots, strict=True)]

    @property
    def nbytes(self) -> int:
        """In memory."""
        return int(self._noise.nbytes) + sum(one.nbytes for one in self._differences or ())


def _share_of(light: Any, before: Any) -> Real:
    """Light in that of an anchor's twin, 1 where that has none."""
    light, before = np.asarray(light, float), np.asarray(before, float)
    return np.asarray(np.divide(light, before, out=np.ones_like(light), where=before > 0.0))


def _mean_map(field: Field, shot: Shot) -> Real:
    """The mean over groups of the whole map (y, x), at the samples of a shot."""
    mean = replace(field, coefficients=field.coefficients.mean(axis=0, keepdims=True))
    return light_map(lambda x, y: mean.grid(x, y)[0], shot, whole=True).irradiance_per_mm2


def _seen(shots: Sequence[Shot], maps: Sequence[LightMap]) -> Real:
    """Images (shot, row, column) of maps."""
    return np.stack([shot.image(light) for shot, light in zip(shots, maps, strict=True)])


def _noise_of(
    fields: Sequence[Field], shots: Sequence[Shot], light: Real, report: Report, threads: int | None
) -> NDArray[np.float32]:
    """(function, shot, row, column): of the mean of each field's groups; `light` (shot, row, column) without it."""
    replicas = _replicas([field.grid for field in fields], shots, report)
    mean, groups = replicas.mean(axis=0), len(replicas)
    first, bases = bases_of(shots, fields, light, threads)
    deviations = (replicas - mean) / np.sqrt(groups * (groups - 1.0))
    told = [(deviations[:, i], bases[n], bases[i]) for n, i in enumerate(first)]
    columns = in_parallel(lambda n: noise_columns(*told[n]), range(len(told)), threads)
    noise = np.zeros((max(map(len, columns)), *light.shape), np.float32)
    for number, one in enumerate(columns):
        noise[: len(one), number] = one
    return noise


def bases_of(
    shots: Sequence[Shot], fields: Sequence[Field], light: Real, threads: int | None = None
) -> tuple[list[int], list[NoiseBasis]]:
    """The smooth functions of each shot, alike for all shots of one field, and the number of that shot of its field
    that sees farthest, whose functions are taken. `light` (shot, row, column)."""
    places = []
    for shot in shots:
        row, column = pixels(shot.camera.rows), pixels(shot.camera.columns)
        places.append(receiver_points(shot.camera, row, column)[:2])
    reach = [max(float(np.abs(x).max()), float(np.abs(y).max())) for x, y in places]
    widest = [max((n for n, one in enumerate(fields) if one is field), key=lambda n: reach[n]) for field in fields]

    def basis(number: int, like: NoiseBasis | None = None) -> NoiseBasis:
        scene, (x, y) = shots[number].traced, places[number]
        most = most_functions(light.size, symmetric=scene.symmetric)
        of = light[number], reach[widest[number]], scene.height_um
        return NoiseBasis.at(x, y, *of, symmetric=scene.symmetric, most=most, like=like)

    numbers = sorted(set(widest))
    known = dict(zip(numbers, in_parallel(basis, numbers, threads), strict=True))
    return widest, [known.get(number) or basis(number, known[widest[number]]) for number in range(len(shots))]


def twin_images(shots: Sequence[Shot], supply: Supply, *, report: Report = nothing, **options: int) -> Real:
    """The twin's images (shot, row, column), several at once; parameters as those of `twin_views`."""
    return twin_views(shots, supply, (), report=report, **options)[0]


def twin_views(
    shots: Sequence[Shot],
    supply: Supply,
    cameras: Sequence[CameraColumn] = (),
    *,
    threads: int | None = None,
    report: Report = nothing,
    **options: int,
) -> tuple[Real, Real]:
    """The twin's images (shot, row, column), and their derivatives (camera column, shot, row, column) from one map.

    Parameters
    ----------
    report : called before each image, from several threads; what it raises ends the whole.
    options : `ModuleTwin`'s blocks and shadow_rays.
    """
    images, _, of_camera, _ = _views(shots, supply, cameras, None, threads=threads, report=report, **options)
    return images, of_camera


def _views(
    shots: Sequence[Shot],
    supply: Supply,
    cameras: Sequence[CameraColumn],
    differences: Sequence[Difference] | None,
    *,
    threads: int | None = None,
    report: Report = nothing,
    **options: int,
) -> tuple[Real, Real, Real, Real]:
    """Images of maps with what the twin misses in them, where that is known, and the twin's own; then how the twin's,
    and how the former, change with the camera."""
    rows, columns = refuse_several_sizes(shots)
    images, twin = np.zeros((2, len(shots), rows, columns))
    of_camera = np.zeros((len(cameras), *images.shape))
    of_images = of_camera if differences is None else np.zeros_like(of_camera)

    def see(number: int, light: LightMap) -> None:
        shot = shots[number]
        images[number] = twin[number] = shot.image(light)
        if differences is not None:
            missing, before = differences[number].laid(light, Plate.of(shot.scene))
            share = _share_of(twin[number].sum(), shot.image(before).sum())
            whole = replace(light, irradiance_per_mm2=light.irradiance_per_mm2 + share * missing)
            images[number] = shot.image(whole)
            for derivative, column in zip(of_images, cameras, strict=True):
                derivative[number] = _by_camera(shot, whole, column)
        for derivative, column in zip(of_camera, cameras, strict=True):
            derivative[number] = _by_camera(shot, light, column)

    _lit(see, shots, supply, whole=False, threads=threads, report=report, **options)
    return images, twin, of_camera, of_images


def _by_camera(shot: Shot, light: LightMap, column: CameraColumn) -> Real:
    """How the image of a map changes with the camera."""
    up, down = (shot.image(light, column.move(shot.camera, s * column.step)) for s in (1.0, -1.0))
    return np.asarray((up - down) / (2.0 * column.step))


def twin_maps(shots: Sequence[Shot], supply: Supply, **options: Any) -> list[LightMap]:
    """The twin's maps of whole modules; parameters as those of `twin_views`."""
    found: dict[int, LightMap] = {}
    _lit(found.__setitem__, shots, supply, whole=True, **options)
    return [found[number] for number in range(len(shots))]


def _lit(
    see: Callable[[int, LightMap], None],
    shots: Sequence[Shot],
    supply: Supply,
    *,
    whole: bool,
    threads: int | None = None,
    report: Report = nothing,
    **options: int,
) -> None:
    """Shows the twin's map of each shot, with its number, several at once: what its camera sees, or the whole."""
    parts = [scenes_of(shot.scene) for shot in shots]
    exits = [[supply.of(one, _base(one, shot)) for one in scenes] for scenes, shot in zip(parts, shots, strict=True)]

    def light(number: int) -> None:
        report()
        shot = shots[number]
        with named(shot.name):
            pairs = zip(parts[number], exits[number], strict=True)
            twins = [ModuleTwin(one, its, threads=1, known=supply.lights, **options) for one, its in pairs]
            see(number, light_map(lambda x, y: sum(twin.mean(x, y) for twin in twins), shot, whole=whole))

    in_parallel(light, range(len(shots)), threads)


def _base(scene: Scene, shot: Shot) -> Scene | None:
    """Whose exits may stand for those of a scene that is a part of a shot."""
    return shot.base if scene is shot.scene else shot.base or shot.scene


def jacobian(
    shots: Sequence[Shot],
    columns: Sequence[Column],
    supply: Supply,
    *,
    report: Report = nothing,
    **options: int,
) -> Real:
    """Derivatives (column, shot, row, pixel column) of the twin's images by each column's parameter, per its unit.

    Notes
    -----
    Central differences, at an end of a range one-sided ones of the same order, all with the same random numbers.
    A moved chip has the exits of its shot's own chip, or of its base, reweighted, where that can be.
    """
    found = np.zeros((len(columns), len(shots), *refuse_several_sizes(shots)))
    for derivative, column in zip(found, columns, strict=True):
        steps = [
            (number, weight, replace(shot, scene=column.move(shot.scene, amount), base=shot.base or shot.scene))
            for number, shot in enumerate(shots)
            for amount, weight in stencil_of(column, shot)
        ]
        images = twin_images([moved for _, _, moved in steps], supply, report=report, **options)
        for (number, weight, _), image in zip(steps, images, strict=True):
            derivative[number] += weight * image
    return found


def stencil_of(column: Column, shot: Shot) -> tuple[tuple[float, float], ...]:
    """Amounts and weights of a column's differences at a shot; InputError where it cannot be differentiated."""
    with named(shot.name):
        return column.stencil(shot.scene)


def _replicas(grids: Sequence[Grid], shots: Sequence[Shot], report: Report) -> Real:
    """Images (group, shot, row, column) of each group of maps."""
    seen = []
    for shot, grid in zip(shots, grids, strict=True):
        report()
        with named(shot.name):
            seen.append(image_of(grid, shot))
    return np.stack(seen, axis=1)


def refuse_several_sizes(shots: Sequence[Shot]) -> tuple[int, int]:
    """Rows and columns of all images; InputError where they are not of one size."""
    sizes = sorted({(shot.camera.rows, shot.camera.columns) for shot in shots})
    if len(sizes) != 1:
        several = ", ".join(f"{rows} x {columns}" for rows, columns in sizes)
        raise InputError("shots", f"images of {several} pixels", "one size", "predict them in groups")
    return sizes[0]


@contextmanager
def named(name: str) -> Iterator[None]:
    """Within it an InputError's field is led by a name."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}.{error.field}", error.value, error.allowed, error.mend) from error


def image_of(grid: Grid, shot: Shot) -> Real:
    """The irradiance (..., row, column) that a shot's pixels see of a map of what is traced."""
    return shot.image(light_map(grid, shot))


def light_map(grid: Grid, shot: Shot, *, whole: bool = False) -> LightMap:
    """A map as far as the camera sees, PSF included (with glare: all of it), or the whole; eight samples per height.

    It is known up to two distances beyond the module's edge, and dark from there on.
    """
    layout, camera, distance = shot.scene.layout, shot.camera, shot.scene.distance_um
    if not isinstance(layout, Array):
        raise InputError("layout", type(layout).__name__, "a finite array", "a cell's map is its field's")
    step = shot.scene.height_um / BINS_PER_HEIGHT
    reach = np.inf if camera.glare or whole else reach_um(camera) + 4.0 * step
    counts, dark = [], False
    for end in (ends := [half + PAD * distance for half in (layout.half_x_um, layout.half_y_um)]):
        dark = dark or end <= reach
        counts.append(int(np.ceil(min(end, reach) / step)))
    x, y = ((np.arange(2 * count) + 0.5 - count) * step for count in counts)
    inside = (np.clip(at, -end, end) for at, end in zip((x, y), ends, strict=True))  # the last by a half step
    return LightMap(grid(*inside), (float(x[0]), float(y[0])), step, "dark" if dark else "mirror")
