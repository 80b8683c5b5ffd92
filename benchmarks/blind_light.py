"""The blind test's own forward model: time, noise, and agreement with the project's Monte Carlo.

    python -m benchmarks.blind_light [--histories 32000000] [--monte-carlo 32000000] [--seed 1] [--dataset FOLDER]

Six images of the paper's plan are computed twice, each time as the mean of two halves of the histories, which is what
`luxloop blind make` does. Printed for each: CPU seconds; the noise of one of
them over that of the declared camera, in pixels and in blocks of 4, 16 and 64 pixels a side (each over the camera's
noise of such a block); the difference to the data set's image (default: examples/paper-like, 128 M histories of the
project) over that image's noise, gain and offset fitted. With
`--monte-carlo` the project's own Monte Carlo of that many histories is compared too, in this process.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from luxloop.model import Environment, Model
from luxloop.model_file import find_model
from validation.blind import Camera, Pose, Sample, Surroundings, light
from validation.blind_test.making import HISTORIES
from validation.dataset.simulated_images import PEAK_SHARE, views_of
from validation.dataset.simulation_plan import DECLARED, paper_plan
from validation.noise import variance_dn2

Real = NDArray[np.float64]

BLOCKS = (1, 4, 16, 64)
PIXELS = 128


def surroundings_of(environment: Environment) -> Surroundings:
    """The model's environment in the blind test's words."""
    substrate = environment.substrate
    return Surroundings(
        substrate.reflectance, substrate.sigma_deg or 0.0, environment.receiver.reflectance,
        environment.chip_absorption_per_cm, environment.active_layer_depth, environment.chip_bottom,
        environment.n_gan, environment.n_aln, environment.gan_layer_nm, environment.aln_layer_nm,
        environment.layer_order, environment.peak_nm, environment.fwhm_nm,
    )  # fmt: skip


def samples_of(samples: Sequence[Any]) -> list[Sample]:
    """A plan's samples in the blind test's words."""
    return [
        Sample(
            one.id, one.rows, one.columns, one.distance_um, one.width_um, one.spacing_um, one.thickness_um,
            one.dbr_pairs, one.half_um(),
        )
        for one in samples
    ]  # fmt: skip


def camera_of() -> Camera:
    """The camera at which all targets are stated."""
    return Camera(
        PIXELS, PIXELS, DECLARED.pixel_um, DECLARED.bit_depth, DECLARED.gain_dn_per_e, DECLARED.read_noise_e,
        DECLARED.full_well_e, DECLARED.black_level_dn,
    )  # fmt: skip


def camera_noise(image: Real) -> Real:
    """Standard deviation of each pixel, in the image's own unit, where its peak is exposed as data sets are."""
    full = min(DECLARED.full_scale_dn - DECLARED.black_level_dn, DECLARED.gain_dn_per_e * DECLARED.full_well_e)
    gain = PEAK_SHARE * full / image.max()
    return np.sqrt(variance_dn2(gain * image, DECLARED)) / gain


def by_blocks(whitened: Real) -> list[float]:
    """Root of the mean chi2 of blocks of so many pixels a side: 1 where each pixel has noise of its own of sd 1."""
    rows, columns = whitened.shape
    found = []
    for side in BLOCKS:
        blocks = whitened.reshape(rows // side, side, columns // side, side).mean(axis=(1, 3)) * side
        found.append(float(np.sqrt(np.mean(blocks**2))))
    return found


def without(image: Real, of: Sequence[Real], noise: Real) -> Real:
    """An image over its noise, less what fits of these images."""
    columns = np.stack([(one / noise).ravel() for one in of], axis=1)
    left = (image / noise).ravel()
    return np.asarray((left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]).reshape(image.shape))


def line(name: str, figures: Sequence[float]) -> None:
    """A row of figures, one for each size of block."""
    print(f"  {name:34}" + "".join(f"{figure:9.3f}" for figure in figures), flush=True)


def main() -> None:
    """Print all of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histories", type=int, default=HISTORIES)
    parser.add_argument("--monte-carlo", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--dataset", type=Path, default=Path("examples/paper-like"))
    asked = parser.parse_args()
    model = find_model("paper")
    around, samples, camera = surroundings_of(model.environment), samples_of(paper_plan().samples), camera_of()
    poses = [Pose()] * len(samples)
    light(around, samples[3:4], camera, poses[:1], seed=1, histories=100)  # compiles
    runs = []
    for seed in (asked.seed, asked.seed + 2):
        begun = time.process_time()
        halves = [
            light(around, samples, camera, poses, seed=seed + half, histories=asked.histories // 2) for half in (0, 1)
        ]
        runs.append([(one + other) / 2.0 for one, other in zip(*halves, strict=True)])
        print(f"{asked.histories:,} histories, seed {seed}: {time.process_time() - begun:.1f} CPU s for six images")
    print(" " * 36 + "".join(f"{side:8}^2" for side in BLOCKS))
    for number, sample in enumerate(samples):
        first, second = (run[number] for run in runs)
        noise = camera_noise(first)
        print(sample.id)
        line("noise / camera's", [one / np.sqrt(2.0) for one in by_blocks((second - first) / noise)])
        raw = tifffile.imread(asked.dataset / "images" / f"{sample.id}.tif") - DECLARED.black_level_dn
        of_data = np.sqrt(variance_dn2(raw, DECLARED))
        line("data set less it / its noise", by_blocks(without(raw, [first, np.ones_like(first)], of_data)))
        if asked.monte_carlo:
            theirs = [monte_carlo(model, number, asked.monte_carlo, seed) for seed in (1, 2)]
            mean = (theirs[0] + theirs[1]) / 2.0
            line("Monte Carlo's noise / camera's", [x / 2.0 for x in by_blocks((theirs[1] - theirs[0]) / noise)])
            line("Monte Carlo less it / camera's", by_blocks((mean - first) / noise))
            line("the same, gain and offset out", by_blocks(without(mean, [first, np.ones_like(first)], noise)))


def monte_carlo(model: Model, number: int, histories: int, seed: int) -> Real:
    """The project's own image of a sample."""
    from tests.validation.workers import Workers
    from validation.prediction import Predictor

    with tempfile.TemporaryDirectory() as folder:
        view = views_of(paper_plan(), 1)[number]
        found = Predictor(Workers(Path(folder))).monte_carlo(model, [view], histories, seed)
    return found[0].irradiance_per_mm2


if __name__ == "__main__":
    main()
