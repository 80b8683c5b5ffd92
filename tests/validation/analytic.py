"""A predictor in closed form for tests: each chip is a Gaussian spot on a wide halo, and three parameters shape them.

    E(x, y) = sum over chips of  exp(-d^2/2w^2)/(2 pi w^2) + h (1 + d^2/L^2)^(-3/2)/(2 pi L^2)
    w = 40 um + 8 um x substrate.sigma_deg    h = substrate.reflectance    L = 40 um + 200 um x receiver.reflectance

Noise is drawn by the same words as a camera's: variance = constant + slope x signal, one fixed pattern in all images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.model import Fit, Model
from validation.dataset.manifest import CameraFacts, ImageShot, Sample
from validation.measured import MeasuredImage
from validation.prediction import Anchored, Pose, Predicted, View

Real = NDArray[np.float64]

SIGMA = "environment.substrate.sigma_deg"
HALO = "environment.substrate.reflectance"
REACH = "environment.receiver.reflectance"
PATHS = (SIGMA, HALO, REACH)

MODEL = Model(
    name="spots",
    fit={
        SIGMA: Fit(free=True, lower=1.0, upper=15.0, prior_mean=5.0, prior_sd=5.0),
        HALO: Fit(free=True, lower=0.0, upper=1.0),
        REACH: Fit(free=True, lower=0.05, upper=0.95),
    },
)

TRUTH = MODEL.with_value(SIGMA, 6.0).with_value(HALO, 0.7).with_value(REACH, 0.5)
"""What the two images are of."""
POSES = [Pose((0.8, -1.7), 0.0), Pose((-2.4, 0.6), 0.4)]

CAMERA = CameraFacts(
    pixel_um=25.0, bit_depth=16, gain_dn_per_e=1.0, read_noise_e=6.0, full_well_e=60_000.0, black_level_dn=64.0
)
SINGLE = Sample(
    id="single", layout="single", distance_um=180.0, width_um=40.0, spacing_um=400.0, thickness_um=20.0, dbr_pairs=5.5
)
ARRAY = Sample(
    id="array",
    layout="array",
    rows=2,
    columns=3,
    distance_um=180.0,
    width_um=40.0,
    spacing_um=300.0,
    thickness_um=20.0,
    dbr_pairs=0.0,
)


class Spots:
    """Predicts images in closed form; `asked` counts the questions, `anchors` holds those asked about.

    `noise` (function, row, column) by sample is what an anchor tells of its noise, `drawn` (row, column) that noise.
    """

    def __init__(
        self, noise: dict[str, Real] | None = None, error: float = 0.0, drawn: dict[str, Real] | None = None
    ) -> None:
        self.asked, self._noise, self._error, self._drawn = 0, noise or {}, error, drawn or {}
        self.anchors: list[Anchored | None] = []

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """The images; without an anchor they are off by `error` times the halo's derivative, as a twin may be."""
        self.asked += 1
        self.anchors.append(anchor)
        found = []
        for view in views:
            value, by = spots(model, view)
            columns = {name: by[name] for name in paths}
            twin = value + self._error * by[HALO]
            if anchor is None or not anchor.histories:
                found.append(Predicted(twin, columns))
                continue
            noisy = value + self._drawn.get(view.sample.id, 0.0)
            found.append(Predicted(noisy, columns, self._noise.get(view.sample.id), twin))
        return found


def spots(model: Model, view: View) -> tuple[Real, dict[str, Real]]:
    """Irradiance in 1/mm^2 and its derivatives by parameter and pose."""
    substrate, receiver = model.environment.substrate, model.environment.receiver
    width, reach = 40.0 + 8.0 * (substrate.sigma_deg or 0.0), 40.0 + 200.0 * receiver.reflectance
    halo = substrate.reflectance
    value = np.zeros((view.rows, view.columns))
    by = {name: np.zeros_like(value) for name in (*PATHS, "shift_row_px", "shift_column_px", "rotation_deg")}
    rows, columns = np.indices(value.shape)
    turn = np.radians(view.pose.rotation_deg)
    for x, y in _chips(view.sample):
        at_x, at_y = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
        dx = (columns - view.centre_px[1] - view.pose.shift_px[1]) * view.pixel_um - at_x
        dy = (rows - view.centre_px[0] - view.pose.shift_px[0]) * view.pixel_um - at_y
        d2 = dx**2 + dy**2
        core = 1e6 * np.exp(-d2 / (2.0 * width**2)) / (2.0 * np.pi * width**2)
        far = 1e6 * (1.0 + d2 / reach**2) ** -1.5 / (2.0 * np.pi * reach**2)
        value += core + halo * far
        by[SIGMA] += 8.0 * core * (d2 / width**3 - 2.0 / width)
        by[HALO] += far
        by[REACH] += 200.0 * halo * far * (3.0 * d2 / reach**3 / (1.0 + d2 / reach**2) - 2.0 / reach)
        by_d2 = -core / (2.0 * width**2) - 1.5 * halo * far / (reach**2 + d2)
        by["shift_column_px"] += by_d2 * -2.0 * dx * view.pixel_um
        by["shift_row_px"] += by_d2 * -2.0 * dy * view.pixel_um
        by["rotation_deg"] += by_d2 * 2.0 * (dx * at_y - dy * at_x) * np.pi / 180.0
    return value, by


def blank(shot: str, sample: Sample, side: int = 24, prnu: float = 0.0, **facts: Any) -> MeasuredImage:
    """An image of nothing, ready for `measured`."""
    like = np.ones((side, side))
    return MeasuredImage(
        shot=ImageShot(id=shot, kind="image", sample=sample.id, file=f"{shot}.tif", exposure_ms=8.0),
        sample=sample,
        camera=CAMERA,
        signal_dn=0.0 * like,
        used=like > 0.0,
        constant_dn2=36.0 * like,
        slope_dn=1.0 * like,
        dark_dn2=0.0 * like,
        prnu=prnu,
        binning=1,
        pixel_um=25.0,
        centre_px=((side - 1) / 2.0, (side - 1) / 2.0),
        saturated=0,
        masked=0,
        raw_pixels=like.size,
        **facts,
    )


def expected_dn(model: Model, image: MeasuredImage, gain: float, offset_dn: float, pose: Pose) -> Real:
    """What a camera without noise would see."""
    view = View(image.sample, *image.used.shape, image.pixel_um, image.centre_px, pose)
    return gain * spots(model, view)[0] + offset_dn


def measured(
    model: Model, images: Sequence[MeasuredImage], random: np.random.Generator, poses: Sequence[Pose] = ()
) -> list[MeasuredImage]:
    """The images of a model with noise, gains of 300 DN mm^2 and offsets of 20 DN, in the given poses."""
    poses = poses or [Pose()] * len(images)
    pattern: dict[tuple[int, ...], Real] = {}
    found = []
    for image, pose in zip(images, poses, strict=True):
        fixed = pattern.setdefault(image.used.shape, random.standard_normal(image.used.shape))
        signal_dn = expected_dn(model, image, 300.0, 20.0, pose)
        spread = np.sqrt(image.variance_dn2(signal_dn)) * random.standard_normal(signal_dn.shape)
        found.append(replace(image, signal_dn=signal_dn * (1.0 + image.prnu * fixed) + spread))
    return found


def two_images(
    seed: int = 1, prnu: float = 0.0, truth: Model = TRUTH, poses: Sequence[Pose] = POSES
) -> list[MeasuredImage]:
    """A single chip and an array, of the truth at these poses, with noise."""
    images = [blank("single-a", SINGLE, prnu=prnu), blank("array-a", ARRAY, prnu=prnu)]
    return measured(truth, images, np.random.default_rng(seed), poses)


def _chips(sample: Sample) -> list[tuple[float, float]]:
    pitch = sample.spacing_um
    return [
        ((column - (sample.columns - 1) / 2.0) * pitch, (row - (sample.rows - 1) / 2.0) * pitch)
        for row in range(sample.rows)
        for column in range(sample.columns)
    ]
