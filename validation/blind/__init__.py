"""The blind test's own forward model: separate code, which shares nothing with the model that is tested.

It imports numpy, scipy and numba, and nothing of this project (decision 32; a contract in pyproject.toml holds it).

    surroundings, samples --light()--> 1/mm^2 at pixels --signals()--> DN above black --recorded()--> raw images

Axes: arrays (row, column) with row 0 at the lowest y; x along columns. Lengths in um, light per flux of one chip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from validation.blind.kinds import KINDS
from validation.blind.words import Camera, Hidden, Kind, Pose, Real, Sample, Surroundings

__all__ = [
    "KINDS", "Camera", "Hidden", "Kind", "Pose", "Real", "Sample", "Surroundings", "light", "recorded", "signals",
]  # fmt: skip


def light(
    surroundings: Surroundings,
    samples: Sequence[Sample],
    camera: Camera,
    poses: Sequence[Pose],
    hidden: Sequence[Hidden] = (),
    *,
    seed: int,
    histories: int,
    heard: Callable[[int, int], None] | None = None,
) -> list[Real]:
    """What a camera sees of each sample, (row, column) in 1/mm^2 per flux of one chip, mean over the pixel.

    Parameters
    ----------
    poses : one for each sample.
    hidden : all that is hidden; kinds of place "camera" act in `signals`.
    seed, histories : of the walks inside a chip; what else is traced takes its share. The same seed with other
        hidden things has the same random numbers.
    heard : told how many of how many samples are done.

    Raises
    ------
    ValueError with field, value and range.
    """
    from validation.blind.module import light_of  # compiles its kernels; the words alone are for those who list

    return light_of(surroundings, samples, camera, poses, hidden, seed=seed, histories=histories, heard=heard)


def signals(
    light: Sequence[Real],
    exposures_ms: Sequence[float],
    dn_per_ms: float,
    camera: Camera,
    hidden: Sequence[Hidden] = (),
) -> list[Real]:
    """Expected signals (row, column) in DN above black: light x exposure x gain, then what the sensor does to it.

    Parameters
    ----------
    exposures_ms : one for each image.
    dn_per_ms : digital numbers in a millisecond at 1/mm^2.
    """
    from validation.blind.sensor import signals_of

    return signals_of(light, exposures_ms, dn_per_ms, camera, hidden)


def recorded(
    signals: Sequence[Real], camera: Camera, hidden: Sequence[Hidden], seed: int
) -> list[NDArray[np.uint16]]:
    """Raw images: photon noise, full well, read noise, black level and bits of EMVA 1288; one frame each."""
    from validation.blind.sensor import recorded_of

    return recorded_of(signals, camera, hidden, seed)
