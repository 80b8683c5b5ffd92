"""What an effect of a camera or of another instrument is tried on: a camera, light, a signal, curves of a film."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.acting import Effects
from containers.effect import Reading
from containers.effect_example import MORE, SHARE, Example, Seen, alone, no_law, text_of
from luxloop.camera import Camera
from luxloop.errors import InputError
from luxloop.words import parse

Real = NDArray[np.float64]

CAMERA = Camera(rows=16, columns=16, pixel_um=40.0, gain_dn=1000.0)


def images() -> Iterator[Example[Any]]:
    """The examples of an effect of a camera: one for each of its hooks."""
    row, column = np.mgrid[:16, :16] - 7.5
    spot = 2.0 * np.exp(-((row - 0.7) ** 2 + column**2) / (2 * 1.8**2))
    yield Example("a camera", CAMERA, Effects.camera, _camera_seen, _refuse_camera, _camera_kept)
    yield Example("light of 16 x 16 pixels", spot, _light, alone, _refuse_more(spot), _light_kept)
    signal = CAMERA.full_scale_dn * spot / spot.max()
    yield Example("a signal of 16 x 16 pixels", signal, _signal, alone, no_law, no_law)


def curves() -> Iterator[Example[Any]]:
    """The examples of an effect of an instrument that measures films: one for each quantity."""
    wavelength, aoi = np.linspace(400.0, 800.0, 9), np.array([0.0, 45.0, 70.0])
    wave = 0.5 + 0.4 * np.sin(wavelength / 40.0)[:, None] * np.cos(np.radians(aoi))
    for quantity, value in (("R", wave), ("T", 1.0 - wave), ("psi", 45.0 * wave), ("delta", 180.0 * wave)):
        polarisation = "u" if quantity in "RT" else "p"
        reading = Reading(quantity, wavelength, aoi, polarisation)  # type: ignore[arg-type]
        name = f"a curve of {quantity}"
        yield Example(name, value, lambda all_, one, at=reading: all_.curve(one, at), alone, no_law, no_law)  # type: ignore[misc]


def _camera_seen(camera: Camera) -> list[Seen]:
    return [text_of(camera.model_dump_json())]


def _refuse_camera(camera: Camera) -> None:
    parse(type(camera), camera.model_dump(), "camera")
    for name in ("rows", "columns", "pixel_um"):
        if getattr(camera, name) != getattr(CAMERA, name):
            allowed = f"{getattr(CAMERA, name)}"
            raise InputError(f"camera.{name}", getattr(camera, name), allowed, "an image keeps its pixels")
    if camera.gain_dn > CAMERA.gain_dn * (1.0 + MORE):
        raise InputError("camera.gain_dn", camera.gain_dn, "at most what it was", "light would be made")


def _camera_kept(before: Camera, after: Camera, law: str) -> None:
    if law == "energy" and (before.gain_dn, before.vignetting) != (after.gain_dn, after.vignetting):
        raise InputError("conserves", "another gain or vignetting", "no light lost", 'leave out "energy"')


def _light(effects: Effects, image: Real) -> Real:
    """The light of an image. InputError where it is not linear, or images in one array are not each its own."""
    found = effects.light(image, CAMERA)
    both = effects.light(np.stack([image, 3.0 * image[::-1]]), CAMERA)
    apart = np.stack([found, 3.0 * effects.light(image[::-1], CAMERA)])
    if np.abs(both - apart).max() > MORE * max(1.0, float(np.abs(apart).max())):
        mend = "work on the last two axes; what bends with the light belongs into signal"
        raise InputError("light", "not linear, or images mixed", "linear, each image for itself", mend)
    return found


def _refuse_more(spot: Real) -> Callable[[Any], None]:
    def refuse(image: Real) -> None:
        if image.sum() > spot.sum() * (1.0 + MORE):
            mend = "light from elsewhere belongs into signal, or the camera's ambient_dn"
            raise InputError("light", f"{image.sum() / spot.sum():.6f} of what came in", "at most 1", mend)

    return refuse


def _light_kept(before: Real, after: Real, law: str) -> None:
    share = float(after.sum() / before.sum())
    if law == "energy" and abs(share - 1.0) > SHARE:
        raise InputError("light", f"{share:.6f} of what came in", f"1 within {SHARE:g}", 'leave out "energy"')


def _signal(effects: Effects, image: Real) -> Real:
    return effects.signal(image, CAMERA)
