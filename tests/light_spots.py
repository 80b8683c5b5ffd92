"""Maps of a Gaussian spot and its closed forms, for the tests of the camera."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from containers.ray_tracing.light_map import LightMap
from luxloop.camera import Camera

Real = NDArray[np.float64]
RNG = np.random.default_rng(7)
SD_UM = 60.0
SPOT_UM = (35.0, -72.0)
"""x, y of the spot of most tests: not at the centre, not on a diagonal."""


def grid(step_um: float, half_um: float) -> Real:
    """Sample places along an axis: whole cells between - and + half_um."""
    count = round(2 * half_um / step_um)
    return (np.arange(count) - (count - 1) / 2) * step_um


def map_of(function: Any, step_um: float = 6.4, half_um: float = 1000.0, beyond: Any = "mirror") -> LightMap:
    """A map of function(x, y) in um."""
    x = grid(step_um, half_um)
    return LightMap(function(x, x[:, None]) + 0.0 * x * x[:, None], (x[0], x[0]), step_um, beyond)


def gaussian(x: Any, y: Any, sd_um: float = SD_UM) -> Any:
    """A spot of unit flux (per mm2, with lengths in um)."""
    r2 = (x - SPOT_UM[0]) ** 2 + (y - SPOT_UM[1]) ** 2
    return 1e6 * np.exp(-r2 / (2 * sd_um**2)) / (2 * np.pi * sd_um**2)


def spot(step_um: float = 6.4, sd_um: float = SD_UM, half_um: float = 1000.0, beyond: Any = "mirror") -> LightMap:
    """The map of that spot."""
    return map_of(lambda x, y: gaussian(x, y, sd_um), step_um, half_um, beyond)


def pixel_mean_of_spot(x: Real, y: Real, at: tuple[float, float], sd_um: float, side_um: float) -> Real:
    """Closed form: means of a spot of unit flux at `at` over squares about x (column,), y (row,)."""

    def along(points: Real) -> Real:
        upper, lower = (erf((points + sign * side_um / 2) / (np.sqrt(2.0) * sd_um)) for sign in (1, -1))
        return np.asarray((upper - lower) / (2 * side_um))

    return 1e6 * along(y - at[1])[:, None] * along(x - at[0])


def image_of_spot(camera: Camera, sd_um: float = SD_UM, at: tuple[float, float] = SPOT_UM) -> Real:
    """Closed form for an image that is neither turned nor distorted; `at` in um of the image's own plane."""
    centre = camera.centre_px or ((camera.rows - 1) / 2, (camera.columns - 1) / 2)
    x, y = (
        (np.arange(n) - c) * camera.pixel_um
        for n, c in ((camera.columns, centre[1]), (camera.rows, centre[0]))
    )  # fmt: skip
    return pixel_mean_of_spot(x, y, at, sd_um, camera.pixel_um)


def centroid_px(image: Real) -> tuple[float, float]:
    """Row and column of the centre of gravity."""
    row, column = np.indices(image.shape)
    return float((image * row).sum() / image.sum()), float((image * column).sum() / image.sum())


def error(image: Real, truth: Real) -> float:
    """Largest deviation as a share of the largest value."""
    return float(np.abs(image - truth).max() / np.abs(truth).max())
