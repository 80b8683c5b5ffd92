"""The images that a declared camera would record of samples, before its noise, and what their light errs by.

model, samples --Monte Carlo or twin--> irradiance --exposure--> expected signal
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from luxloop.errors import InputError
from validation.dataset.images import Real
from validation.dataset.manifest import CameraFacts
from validation.dataset.simulation_plan import Plan
from validation.noise import histories_for, rms_over_noise, variance_dn2

if TYPE_CHECKING:
    from luxloop.model import Model
    from validation.prediction import Predicted, View
    from validation.prediction.words import Asks

Solver = Literal["monte_carlo", "twin"]

PIXELS, PEAK_SHARE, HISTORIES = 128, 0.85, 16_000_000
LONGEST_EXPOSURE_MS = 8.0
"""Of the brightest image; the others are exposed so that their peak is as high."""
MOST_SIGMA = 3.0
"""Of all pixels together, that light may err by: of images with 3.4 a right diagnosis found no structure left."""
POSES = 2
"""What a seed is drawn for, beside those of `validation.noise`."""


@dataclass(frozen=True, eq=False)
class Expected:
    """An image before its noise."""

    view: View
    irradiance_per_mm2: Real
    """(row, column), per flux of a chip."""
    signal_dn: Real
    """(row, column), above black."""
    exposure_ms: float
    gain_dn: float
    """Signal where the irradiance is 1/mm^2."""
    error_dn: Real | None = None
    """(row, column), standard error that Monte Carlo left in the signal; None by the twin."""

    def lit_by(self, light: Predicted) -> Expected:
        """The same exposure of other light."""
        image = light.irradiance_per_mm2
        return replace(self, irradiance_per_mm2=image, signal_dn=self.gain_dn * np.maximum(image, 0.0))

    def with_error_of(self, light: Predicted) -> Expected:
        """The same, and what its light errs by."""
        from validation.prediction.words import Traced

        return replace(self, error_dn=self.gain_dn * light.error_per_mm2) if isinstance(light, Traced) else self

    def own_noise(self, camera: CameraFacts, frames: int = 1) -> float | None:
        """Rms of that error over the pixels, in standard deviations of the camera's noise, its pattern left out."""
        if self.error_dn is None:
            return None
        return rms_over_noise(self.error_dn, variance_dn2(self.signal_dn, camera, frames))


def views_of(
    plan: Plan, seed: int, rows: int = PIXELS, columns: int = PIXELS, shift_px: float = 0.0, rotation_deg: float = 0.0
) -> list[View]:
    """The camera before each sample, its centre chip in the middle but for a shift and a turn with these sds."""
    from validation.prediction import Pose, View

    drawn = np.random.default_rng((seed, POSES)).standard_normal((len(plan.samples), 3))
    centre = ((rows - 1) / 2, (columns - 1) / 2)
    return [
        View(
            sample, rows, columns, plan.camera.pixel_um, centre,
            Pose((shift_px * float(row) + 0.0, shift_px * float(column) + 0.0), rotation_deg * float(turn) + 0.0),
        )
        for sample, (row, column, turn) in zip(plan.samples, drawn, strict=True)
    ]  # fmt: skip


def light_seen(
    client: Asks,
    model: Model,
    views: Sequence[View],
    *,
    solver: Solver = "monte_carlo",
    histories: int = HISTORIES,
    seed: int = 1,
    heard: Callable[[int, int], None] | None = None,
) -> Sequence[Predicted]:
    """What each view sees, without columns; RemoteError with the first failure.

    Parameters
    ----------
    histories : of Monte Carlo, for each view; each has random numbers of its own.
    heard : told how many of how many are done.
    """
    from validation.prediction import Predictor

    predictor = Predictor(client)
    if solver == "twin":
        return predictor.images(model, views)
    return predictor.monte_carlo(model, views, histories, seed, heard)


def expected_images(
    views: Sequence[View], irradiance_per_mm2: Sequence[Real], camera: CameraFacts, peak_share: float = PEAK_SHARE
) -> list[Expected]:
    """The signals of a camera that is exposed so that the peak of each image is at a share of its full scale.

    The gain per exposure is one for all images, so it is evidence too. InputError for a share outside 0 to 1, and for
    an image without light.
    """
    if not 0.0 < peak_share <= 1.0:
        raise InputError("peak_share", peak_share, "above 0 to 1", "0.85 leaves room for the noise")
    full_dn = min(camera.full_scale_dn - camera.black_level_dn, camera.gain_dn_per_e * camera.full_well_e)
    peaks = [float(one.max()) for one in irradiance_per_mm2]
    if min(peaks) <= 0.0:
        sample = views[peaks.index(min(peaks))].sample.id
        raise InputError("irradiance", min(peaks), "light on the camera", f"sample {sample} is dark")
    gain_dn_per_ms = peak_share * full_dn / (LONGEST_EXPOSURE_MS * max(peaks))
    exposures = [round(LONGEST_EXPOSURE_MS * max(peaks) / peak, 3) for peak in peaks]
    return [
        Expected(view, one, gain_dn_per_ms * exposure * np.maximum(one, 0.0), exposure, gain_dn_per_ms * exposure)
        for view, one, exposure in zip(views, irradiance_per_mm2, exposures, strict=True)
    ]


def exposed(
    client: Asks, model: Model, views: Sequence[View], camera: CameraFacts, peak_share: float = PEAK_SHARE, **how: Any
) -> list[Expected]:
    """The signals of a model before a camera, exposed as `expected_images` says; `how` as `light_seen` takes it.

    Where the model has effects, some may bend signals, so the light goes through the sensor at the exposures that the
    same model without effects asks for.
    """
    from validation.prediction import Sensor

    if not model.effects:
        light = light_seen(client, model, views, **how)
        found = expected_images(views, [one.irradiance_per_mm2 for one in light], camera, peak_share)
        return [one.with_error_of(its) for one, its in zip(found, light, strict=True)]
    plain = model.model_copy(update={"effects": (), "fit": {}})
    unaided = light_seen(client, plain, views, solver="twin")
    like = expected_images(views, [one.irradiance_per_mm2 for one in unaided], camera, peak_share)
    full_dn = camera.full_scale_dn - camera.black_level_dn
    seen = [replace(one.view, sensor=Sensor(one.gain_dn, 0.0, full_dn)) for one in like]
    light = light_seen(client, model, seen, **how)
    return [one.lit_by(its).with_error_of(its) for one, its in zip(like, light, strict=True)]


def own_sigma(expected: Sequence[Expected], camera: CameraFacts, frames: int = 1) -> float | None:
    """What the light of images errs by in all pixels together, in the noise of the camera; None by the twin."""
    shares = [(one.own_noise(camera, frames), one.signal_dn.size) for one in expected]
    known = [(share, pixels) for share, pixels in shares if share is not None]
    return math.sqrt(sum(share**2 * pixels for share, pixels in known)) if known else None


def told_noise(own: Mapping[str, float | None], sigma: float | None, histories: int) -> Iterator[str]:
    """Where the light of images errs by what a diagnosis would see, and what mends it.

    Parameters
    ----------
    own, sigma : `Expected.own_noise` by id of the sample, and `own_sigma`, of so many histories a sample.
    """
    if sigma is None or sigma <= MOST_SIGMA:
        return
    by_noise = sorted((share, sample) for sample, share in own.items() if share is not None)
    ends = " to ".join(f"{share:.2g} ({sample})" for share, sample in dict.fromkeys((by_noise[0], by_noise[-1])))
    yield (
        f"the light of these images errs by {sigma:.2g} sigma of their camera in all, by pixel {ends} of its noise:"
        f" a diagnosis may take that for structure; --histories {histories_for(MOST_SIGMA, histories, sigma)} would"
        f" leave about {MOST_SIGMA:g}"
    )
