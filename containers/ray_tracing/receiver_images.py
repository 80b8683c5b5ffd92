"""What cameras see of a solved receiver: their expected images, and the standard errors of these.

The field is known once for each independent group. What a camera does to it is linear up to the signal, so the
deviations of the groups from their mean go through one by one, and their spread is the error of the signal; the
sensor's own steps bend it by their slope there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from containers.acting import NONE, Effects
from containers.ray_tracing.camera import ambient, irradiance_image, reach_um, seen_px, sensed
from containers.ray_tracing.field import CellField, Field
from containers.ray_tracing.light_map import LightMap
from containers.ray_tracing.tally import Box
from luxloop.camera import Camera
from luxloop.errors import InputError

Real = NDArray[np.float64]

SAMPLES_PER_WAVE = 6.0
"""Of the shortest wave of the field: the spline through them errs by 0.2 % of a wave whose amplitude is 1e-4."""
WIDEST_STEP_UM = 50.0
"""Half of the narrowest glare."""
BESIDE_STEPS = 8
"""Of a map, that lie between its edge and what is seen, where it does not go on as its own mirror image: a spline
feels its edge by 3e-5 there."""
MOST_SAMPLES = 2048
"""Along an axis."""
MOST_PIXELS = 1 << 24
"""Of all images of a request together."""
MOST_SEEN = 2 * MOST_PIXELS
"""The same with what their blurs see beyond them."""


def images_of(
    field: Field, box: Box, cameras: Sequence[Camera], report: Callable[[float], None], effects: Effects = NONE
) -> list[tuple[Real, Real]]:
    """The expected image (row, column) in DN of each camera, and its standard error; glare sees all of the module.

    Parameters
    ----------
    field : of the receiver; `box` is where its bins lay. effects : those on cameras act here.
    report : hears the share done, may raise to stop.

    Raises
    ------
    InputError : pixels beyond the pad of a finite module, two distances past its edge, or so many periods of a cell
        in view that their map would be too large.
    """
    sums: list[tuple[Real, Real]] = []
    cameras = [effects.camera(camera) for camera in cameras]
    maps = _maps(field, box, cameras)
    groups = field.groups
    for number, light in enumerate(maps):
        report(number / (groups + 1))
        seen = [camera.gain_dn * effects.light(irradiance_image(light, camera), camera) for camera in cameras]
        if not number:
            sums = [(signal, np.zeros_like(signal)) for signal in seen]
        else:
            for (_, squares), deviation in zip(sums, seen, strict=True):
                squares += deviation**2
    errors = (np.sqrt(squares / (groups * (groups - 1))) for _, squares in sums)
    numbers = zip(sums, errors, cameras, strict=True)
    return [_digital(signal, error, camera, effects) for (signal, _), error, camera in numbers]


def refuse_too_many(cameras: Sequence[Camera]) -> None:
    """InputError where the images of all cameras together have more pixels than one answer should hold."""
    total = sum(camera.rows * camera.columns for camera in cameras)
    if total > MOST_PIXELS:
        raise InputError("images", f"{total} pixels", f"at most {MOST_PIXELS} in all images", "ask in parts")
    seen = sum(map(seen_px, cameras))
    if seen > MOST_SEEN:
        value, mend = f"{seen} pixels are seen by blurs", "pixel_um is in um on the receiver; else ask in parts"
        raise InputError("images", value, f"at most {MOST_SEEN}", mend)


def _digital(signal: Real, error: Real, camera: Camera, effects: Effects) -> tuple[Real, Real]:
    """Digital numbers and their error, for a signal and its error before the offset.

    Effects bend all light that arrives, ambient light too. The sensor's own steps come after theirs, as for who has
    a prediction (`predictor._bend`): pixels bend and saturate, what reads them is as it was calibrated.
    """
    light = (signal + step * error + camera.offset_dn + ambient(camera) for step in (-1.0, 0.0, 1.0))
    low, middle, high = (sensed(effects.signal(one, camera), camera) for one in light)
    return middle, np.abs(high - low) / 2.0


def _maps(field: Field, box: Box, cameras: Sequence[Camera]) -> Iterator[LightMap]:
    """The mean map, then each group's deviation from it."""
    per_mm2 = field.per_m2 * 1e-6
    finest_um = 2.0 * np.pi / (SAMPLES_PER_WAVE * float(field.x.wavenumber_per_um.max()))
    finest_um = min(finest_um, WIDEST_STEP_UM)
    if isinstance(field, CellField):
        half = field.spacing_um / 2.0
        step = half / np.ceil(half / finest_um)
        beyond_um = 0.0 if field.x.kind == "even" else BESIDE_STEPS * step
        reach = half * np.ceil((max(map(reach_um, cameras)) + beyond_um) / half * (1.0 - 1e-9))
        x0, y0, columns, rows, beyond = -reach, -reach, round(2 * reach / step), round(2 * reach / step), "mirror"
    else:
        step = box.step_um / np.ceil(box.step_um / finest_um)
        x0, x1, y0, y1 = box.ends_um
        columns, rows, beyond = round((x1 - x0) / step), round((y1 - y0) / step), "dark"
    if max(columns, rows) > MOST_SAMPLES:
        allowed = f"a view that a map of {MOST_SAMPLES} samples, {step:.3g} um apart, can hold"
        raise InputError("images", f"{columns} x {rows} samples", allowed, "fewer or smaller pixels")
    x_um, y_um = x0 + (np.arange(columns) + 0.5) * step, y0 + (np.arange(rows) + 0.5) * step
    mean = field.coefficients.mean(axis=0)
    for coefficients in (mean, *(field.coefficients - mean)):
        irradiance = per_mm2 * replace(field, coefficients=coefficients[None]).grid(x_um, y_um)[0]
        yield LightMap(irradiance, (float(x_um[0]), float(y_um[0])), float(step), beyond)  # type: ignore[arg-type]  # one of its two words
