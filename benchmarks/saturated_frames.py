"""Single frames whose peak reaches saturation: pixels left out by what was measured, and by what is predicted.

    python -m benchmarks.saturated_frames [--trials 100]

Made-up images of 42 x 42 pixels of a 12-bit camera, photons and read noise, a gain and an offset of each fitted, by
the right model. How often it is told to differ at 1 % and at 5 %, where only pixels at saturation are left out, and
where those are that a frame of that light may have there (`MeasuredImage.may_be_clipped`), and how many are used.
"""

from __future__ import annotations

import argparse
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from validation.contrasts.families import layout_of
from validation.contrasts.null import Variances, null
from validation.contrasts.places import Picture
from validation.contrasts.structure import judged
from validation.dataset.manifest import CameraFacts
from validation.fit.least_squares import Basis
from validation.fit.whitening import Whitening
from validation.measured import MeasuredImage
from validation.prediction.words import Real

PIXELS, IMAGES, DRAWS = 42, 4, 2000
CAMERA = CameraFacts(
    pixel_um=24.0, bit_depth=12, gain_dn_per_e=0.38, read_noise_e=6.0, full_well_e=10_000.0, black_level_dn=64.0
)
LIMIT_DN = CAMERA.saturation_dn - CAMERA.black_level_dn


def photographed(signal_dn: Real, random: np.random.Generator) -> MeasuredImage:
    """One frame of an expected signal above black, as a data set's image is."""
    electrons = random.poisson(signal_dn / CAMERA.gain_dn_per_e) + random.normal(
        0.0, CAMERA.read_noise_e, signal_dn.shape
    )
    raw = np.clip(np.round(CAMERA.black_level_dn + CAMERA.gain_dn_per_e * electrons), 0, 4095)
    saturated, like = raw >= CAMERA.saturation_dn, np.ones(raw.shape)
    return MeasuredImage(
        shot=cast(Any, SimpleNamespace(frames_averaged=1)), sample=cast(Any, None), camera=CAMERA,
        signal_dn=raw - CAMERA.black_level_dn, used=~saturated, constant_dn2=CAMERA.dark_variance_dn2 * like,
        slope_dn=CAMERA.gain_dn_per_e * like, dark_dn2=0.0 * like, prnu=0.0, binning=1, pixel_um=CAMERA.pixel_um,
        centre_px=((PIXELS - 1) / 2.0,) * 2, saturated=int(saturated.sum()), masked=0, raw_pixels=raw.size,
    )  # fmt: skip


def chance(images: list[MeasuredImage], signal_dn: Real, *, by_prediction: bool, seed: int) -> tuple[float, float]:
    """p of the right model's structure, and the share of pixels that were used."""
    used = tuple(one.used & ~(by_prediction & one.may_be_clipped(signal_dn)) for one in images)
    weight = tuple(mask / np.sqrt(one.variance_dn2(signal_dn)) for one, mask in zip(images, used, strict=True))
    white, nothing = Whitening(used, weight, ()), np.zeros(signal_dn.shape)
    columns = [
        white.rows([one if k == number else nothing for k in range(len(images))])
        for number in range(len(images))
        for one in (signal_dn, np.ones(signal_dn.shape))
    ]
    basis = Basis(np.linalg.qr(np.array(columns).T)[0], np.zeros((0, len(columns))))
    y, x = (np.indices(signal_dn.shape) - (PIXELS - 1) / 2.0) * CAMERA.pixel_um
    layout = layout_of([Picture(f"{k}", one, 24.0, x, y, np.zeros((1, 2)), 0) for k, one in enumerate(used)])
    variances = Variances.of(layout, basis)
    residual = basis.residual(white.rows([one.signal_dn - signal_dn for one in images]))
    by_noise = null(layout, basis, variances.weight, DRAWS, seed)
    return judged(residual, layout, basis, variances, by_noise).p, float(np.mean([one.mean() for one in used]))


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=100)
    trials = parser.parse_args().trials
    y, x = np.indices((PIXELS, PIXELS)) - (PIXELS - 1) / 2.0
    lights = {
        "one chip": np.exp(-(x * x + y * y) / (2.0 * 9.0**2)),
        "even": 1.0 / (1.0 + ((x * x + y * y) / 144.0) ** 4),
    }
    print(f"{'light':>8} {'peak':>5} {'left out by':>12} {'at 1 %':>8} {'at 5 %':>8} {'used':>7}")
    for name, light in lights.items():
        for peak in (0.9, 0.97, 1.0, 1.03):
            for word, by_prediction in (("measured", False), ("predicted", True)):
                found = []
                for trial in range(trials):
                    random = np.random.default_rng((7, trial))
                    images = [photographed(peak * LIMIT_DN * light, random) for _ in range(IMAGES)]
                    found.append(chance(images, peak * LIMIT_DN * light, by_prediction=by_prediction, seed=trial))
                p, used = np.array(found).T
                few, more = 100 * np.mean(p < 0.01), 100 * np.mean(p < 0.05)
                print(f"{name:>8} {peak:>5g} {word:>12} {few:>6.0f} % {more:>6.0f} % {100 * used.mean():>5.1f} %")


if __name__ == "__main__":
    main()
