"""What a camera makes of an expected signal: the noise of EMVA 1288 drawn, and its variance as a model has it.

    expected signal / K  --fixed pattern, photons (Poisson), full well-->  electrons
         --read noise, K, black level, rounding, full scale-->  raw numbers of a frame  --mean-->  an image

Variance of a pixel without saturation: (K s + (K read_noise)^2 + 1/12) / frames, s the expected signal above black.
The fixed pattern (PRNU) is no noise of a pixel but one pattern in all images of a camera: their covariance is the
product of signals times its variance. Source: EMVA standard 1288, release 4.0 linear.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxloop.errors import InputError

if TYPE_CHECKING:
    from validation.dataset.manifest import CameraFacts

Real = NDArray[np.float64]

PATTERN, SHOT = 0, 1
"""What a seed is drawn for, so that no two draws share their random numbers."""


def variance_dn2(signal_dn: ArrayLike, camera: CameraFacts, frames: int = 1) -> Real:
    """Variance in DN^2 of pixels with an expected signal above black, as a model has it: no PRNU, no saturation.

    Parameters
    ----------
    signal_dn : any shape; below 0 no light comes, and there is no less than no shot noise.
    frames : averaged into one image.
    """
    signal = np.maximum(np.asarray(signal_dn, np.float64), 0.0)
    return np.asarray((camera.gain_dn_per_e * signal + camera.dark_variance_dn2) / _at_least_one(frames))


def fixed_pattern(camera: CameraFacts, shape: tuple[int, int], seed: int) -> Real:
    """Relative sensitivity of each pixel (row, column), mean 1: the same for all images of a camera and seed."""
    drawn = np.random.default_rng((seed, PATTERN)).standard_normal(shape)
    return np.maximum(1.0 + 0.01 * camera.prnu_percent * drawn, 0.0)


def draw(
    signal_dn: ArrayLike,
    camera: CameraFacts,
    *,
    seed: int,
    shot: int = 0,
    frames: int = 1,
    pattern_seed: int | None = None,
) -> Real:
    """An image (row, column) in raw DN, black included: the mean of frames, each drawn, rounded and clipped alone.

    Parameters
    ----------
    signal_dn : expected signal above black (row, column).
    seed, shot : of the noise; images of one data set have one seed and different shots.
    pattern_seed : of the fixed pattern; by default `seed`. Many noise draws of one camera share it.

    Raises
    ------
    InputError : a signal that is negative or no finite number, no frame.

    Notes
    -----
    Electrons beyond the full well are lost, and numbers end at 0 and at full scale. Dark current is not drawn: at
    exposures of milliseconds it is below one electron.
    """
    signal = np.asarray(signal_dn, np.float64)
    if signal.ndim != 2 or not (np.isfinite(signal) & (signal >= 0.0)).all():
        least = float(signal.min()) if signal.size else None
        raise InputError(
            "signal_dn", least, "(row, column) of finite numbers from 0 on", "it is a signal above black"
        )
    pattern = fixed_pattern(camera, signal.shape, seed if pattern_seed is None else pattern_seed)
    electrons = signal / camera.gain_dn_per_e * pattern
    random, total = np.random.default_rng((seed, SHOT, shot)), np.zeros(signal.shape)
    for _ in range(_at_least_one(frames)):
        total += _frame(electrons, camera, random)
    return total / frames


def rms_over_noise(error_dn: Real, variance_dn2: Real) -> float:
    """Rms over the pixels of an error, in standard deviations of their noise."""
    return float(np.sqrt(np.mean(error_dn**2 / variance_dn2)))


def histories_for(share: float, histories: int, now: float) -> int:
    """Histories that bring noise, `now` with so many, down to a share of the camera's; rounded up to two digits."""
    needed = histories * (now / share) ** 2
    digit = 10.0 ** np.floor(np.log10(needed) - 1.0) if needed > 0.0 else 1.0
    return int(np.ceil(needed / digit) * digit)


def _frame(electrons: Real, camera: CameraFacts, random: np.random.Generator) -> Real:
    """Raw numbers of one frame for the expected electrons of each pixel."""
    collected = np.minimum(random.poisson(electrons), camera.full_well_e)
    read = collected + camera.read_noise_e * random.standard_normal(electrons.shape)
    raw = np.rint(camera.gain_dn_per_e * read + camera.black_level_dn)
    return np.clip(raw, 0.0, camera.full_scale_dn)


def _at_least_one(frames: int) -> int:
    if frames < 1:
        raise InputError("frames", frames, "1 or more")
    return frames
