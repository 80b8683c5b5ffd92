"""Images of what Monte Carlo or the twin found: how far they look, and how much may be asked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.acting import Effects
from containers.effect import DetectorEffect
from containers.effects.camera_psf import CameraPsf
from containers.effects.nonlinearity import Nonlinearity
from containers.effects.off_axis_blur import OffAxisBlur
from containers.effects.saturation import Saturation
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.field import CellField
from containers.ray_tracing.receiver_images import images_of
from containers.ray_tracing.simulation import simulate
from containers.ray_tracing.tally import Box
from luxloop.camera import Camera
from luxloop.computation import Progress
from luxloop.errors import InputError
from luxloop.ray import RayRequest
from luxloop.words import parse

SPACING_UM, PIXEL_UM = 400.0, 8.0
BLUR = CameraPsf(psf_um=30.0, profile="gaussian")


def image(pixels: int, *effects: DetectorEffect, **sensor: Any) -> NDArray[np.float64]:
    """An image of so many pixels a side of an endless cell that is not its own mirror image."""
    at = (np.arange(32) + 0.5) / 32.0
    one = 100.0 * (1.0 + 0.4 * np.sin(2.0 * np.pi * at) + 0.3 * np.cos(2.0 * np.pi * at)[:, None])
    field = CellField.from_bins(np.stack([one, one]), 32 * 32 * 100, SPACING_UM, 150.0)
    box = Box(-SPACING_UM / 2.0, -SPACING_UM / 2.0, SPACING_UM / 32.0, 32, 32, folded=False, cell=True)
    camera = Camera(rows=pixels, columns=pixels, pixel_um=PIXEL_UM, gain_dn=1000.0, **sensor)
    return images_of(field, box, [camera], lambda _: None, Effects(effects))[0][0]


def test_blur_looks_at_the_cells_beside_and_not_at_a_mirror() -> None:
    """What a small image shows near its edge, which is the cell's, the middle of a larger one shows, too."""
    small, large = image(48, BLUR), image(144, BLUR)
    np.testing.assert_allclose(small, large[48:96, 48:96], atol=1e-5 * large.max())
    sharp = image(48)
    assert np.abs(small - sharp).max() > 0.02 * sharp.max()


def test_rays_look_at_the_cells_beside_and_not_at_a_mirror() -> None:
    """A wave that is longer than the image: near the corner what a Gaussian leaves of it, by the law of the blur."""
    seen, sharp = image(48, OffAxisBlur(corner_um=60.0, shape="round")), image(48)
    y, x = (np.mgrid[:48, :48] - 23.5) / (24.0 * np.sqrt(2.0))
    left = np.exp(-0.5 * (2.0 * np.pi / SPACING_UM * 60.0 * (x**2 + y**2)) ** 2)
    mean = image(50).mean()  # of one whole period
    np.testing.assert_allclose(seen, mean + left * (sharp - mean), atol=5e-4 * sharp.max())


def test_effects_of_the_sensor_bend_ambient_light_too() -> None:
    """A pixel that saturates reads no more for it; what bends does so to all light, before the camera's own curve."""
    bare, plane = image(48), (0.0, 400.0)
    full = 0.8 * float(bare.max())
    own = {"full_scale_dn": full, "ambient_dn": plane}
    light = image(48, ambient_dn=plane)
    assert image(48, Saturation(knee=0.9), **own).max() <= full < light.max()
    bent = light * (1.0 - 0.1 * light / full)
    np.testing.assert_allclose(image(48, Nonlinearity(bend=0.1), **own), bent, rtol=1e-12)
    twice = bent * (1.0 - 0.05 * bent / full)
    np.testing.assert_allclose(image(48, Nonlinearity(bend=0.1), nonlinearity=0.05, **own), twice, rtol=1e-12)
    np.testing.assert_array_equal(image(48, Nonlinearity(bend=0.0), **own), image(48, **own))


def test_limits_are_those_of_a_camera_with_its_effects() -> None:
    """A camera that asks for little, behind a blur of 200 pixels: what is seen beyond its image is too much."""
    asked = parse(RayRequest, {
        "environment": {}, "histories": 1, "images": [{"rows": 4000, "columns": 4000, "pixel_um": 0.25}],
        "design": {"distance_um": 180, "width_um": 28, "spacing_um": 500, "thickness_um": 35, "dbr_pairs": 0},
    })  # fmt: skip
    effects = Effects((CameraPsf(psf_um=50.0, profile="gaussian"),))
    with pytest.raises(InputError, match="pixels are seen by blurs"):
        simulate(asked, None, ExitSource(), Progress(), effects=effects)
