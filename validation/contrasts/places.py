"""Where the pixels of an image lie in the module."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from luxloop.model import Environment
    from validation.dataset.manifest import Sample
    from validation.measured import MeasuredImage
    from validation.prediction import Pose

Real = NDArray[np.float64]
Mask = NDArray[np.bool_]

CELL = 2  # pixels: the side of the smallest block that votes


@dataclass(frozen=True, eq=False)
class Picture:
    """An image as contrasts see it; maps are (row, column) of binned pixels, row 0 at the lowest y."""

    id: str
    used: Mask
    pixel_um: float
    x_um: Real  # in the module, of the pixels' centres
    y_um: Real
    chips_um: Real  # (chip, 2): x and y of the chips' centres
    grid: int  # images of one grid lie on the same pixels of the camera


def picture(image: MeasuredImage, pose: Pose, environment: Environment, grid: int) -> Picture:
    """Where the pixels of an image lie, with the pose that was fitted."""
    x_um, y_um = module_coordinates_um(image, pose)
    chips_um = chip_centres_um(image.sample, environment)
    return Picture(image.shot.id, image.used, image.pixel_um, x_um, y_um, chips_um, grid)


def from_nearest_um(x_um: Real, y_um: Real, chips_um: Real) -> Real:
    """Distance of places from the centre of the chip that is nearest to each."""
    nearest = np.full(x_um.shape, np.inf)
    for chip_x_um, chip_y_um in chips_um:
        np.minimum(nearest, np.hypot(x_um - chip_x_um, y_um - chip_y_um), out=nearest)
    return nearest


def module_coordinates_um(image: MeasuredImage, pose: Pose) -> tuple[Real, Real]:
    """x and y (row, column) in the module of the centres of an image's pixels."""
    rows, columns = np.indices(image.used.shape)
    y = (rows - image.centre_px[0] - pose.shift_px[0]) * image.pixel_um
    x = (columns - image.centre_px[1] - pose.shift_px[1]) * image.pixel_um
    turn = np.radians(pose.rotation_deg)  # the module appears turned by this, x towards y: turn it back
    return np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x


def chip_centres_um(sample: Sample, environment: Environment) -> Real:
    """(chip, 2): x and y of the centres of a sample's chips."""
    if sample.layout == "single":
        return np.zeros((1, 2))
    pitch_um = sample.pitch_um(environment.spacing_is)
    x = (np.arange(sample.columns) - (sample.columns - 1) / 2.0) * pitch_um
    y = (np.arange(sample.rows) - (sample.rows - 1) / 2.0) * pitch_um
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
