"""Whether the noise that an anchor tells is the noise that it has: runs of Monte Carlo beside each other.

    python -m benchmarks.anchor_noise [--pairs 5.5] [--chips 5] [--runs 24] [--histories 2097152]

Images of one module by many runs, each with the noise that its groups tell. Printed is the standard deviation that
they tell over the one between runs: in rings about the centre, in blocks of pixels, and along what effects look like
beside a gain. With 24 runs one such number is known to 15 %.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.build import array_of, scene_of
from containers.ray_tracing.light import unweighed
from containers.ray_tracing.monte_carlo import MonteCarlo
from containers.ray_tracing.tally import GROUPS
from containers.ray_tracing.twin.noise import noise_columns
from containers.ray_tracing.twin.prediction import Shot, bases_of, image_of
from containers.scene import Array, Scene
from containers.stack import dbr_of
from containers.thin_film.table import film_table
from luxloop.camera import Camera
from luxloop.design import Design
from luxloop.film import Spectrum
from luxloop.model_file import find_model
from validation.dataset.simulation_plan import paper_samples

Real = NDArray[np.float64]
PIXELS, PIXEL_UM = 42, 24.0
BLOCKS = (1, 2, 6, 21)


def module(pairs: float, chips: int) -> Scene:
    """So many chips a side, as the paper's samples have them."""
    environment, chip = find_model("paper").environment, paper_samples()[0]
    sizes = {name: getattr(chip, name) for name in Design.FIELDS}
    design = Design(**sizes | {"dbr_pairs": pairs})
    spectrum = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
    film = film_table(dbr_of(environment, pairs), spectrum) if pairs else None
    return scene_of(environment, design, film, array_of(environment, design, chips, chips))


def looks(image: Real, scene: Scene) -> dict[str, Real]:
    """What effects look like (row, column): of the camera, of the light's reach, of single chips."""
    assert isinstance(scene.layout, Array)
    at = (np.arange(PIXELS) - (PIXELS - 1) / 2.0) * PIXEL_UM
    x, y = np.meshgrid(at, at)
    by_y, by_x = np.gradient(image, PIXEL_UM)
    square = (x**2 + y**2) / at.max() ** 2
    stretched = by_x * x + by_y * y
    centres = scene.layout.centres_um.reshape(-1, 2)
    far = [((x - at_x) ** 2 + (y - at_y) ** 2) / scene.height_um**2 for at_x, at_y in centres]
    lamps = [(1.0 + one) ** -2 for one in far]
    return {
        "vignetting": image * square,
        "magnification": stretched,
        "distortion": stretched * square,
        "nonlinearity": image**2,
        "ambient light": np.ones_like(image),
        "wider spots of all chips": np.sum([one * lamp for one, lamp in zip(far, lamps, strict=True)], axis=0),
        "middle chip": lamps[len(lamps) // 2],
    }


def told_and_found(scene: Scene, runs: int, histories: int) -> None:
    """Print the table of a module."""
    shot = Shot(scene, Camera(rows=PIXELS, columns=PIXELS, pixel_um=PIXEL_UM))
    start, each = time.monotonic(), -(-histories // GROUPS)
    tallies = [MonteCarlo(scene, seed).run_to(each) for seed in range(runs)]
    fields = [unweighed(tally, scene) for tally in tallies]
    replicas = np.array([image_of(field.grid, shot) for field in fields])
    images = replicas.mean(axis=1)
    mean = images.mean(axis=0)
    _, (basis,) = bases_of([shot], fields[:1], mean[None])
    deviations = (replicas - images[:, None]) / np.sqrt(GROUPS * (GROUPS - 1.0))
    columns = [noise_columns(one, basis, basis) for one in deviations]
    found = images - mean
    print(f"{runs} runs of {histories / 1e6:.1f} M histories: {time.monotonic() - start:.0f} s")

    def row(name: str, weights: Real) -> None:
        flat = weights.reshape(len(weights), -1)
        told = np.mean([((one.reshape(len(one), -1) @ flat.T) ** 2).sum(axis=0) for one in columns], axis=0)
        real = (found.reshape(runs, -1) @ flat.T).var(axis=0, ddof=1)
        print(f"{name:28s} {np.sqrt(np.mean(told / real.mean())):8.2f}")

    at = np.arange(PIXELS) - (PIXELS - 1) / 2.0
    ring = np.hypot(*np.meshgrid(at, at)) / at.max()
    pixels = np.eye(PIXELS * PIXELS).reshape(-1, PIXELS, PIXELS)
    for low, high in ((0.0, 0.3), (0.3, 0.6), (0.6, 0.9), (0.9, 1.2), (1.2, 1.5)):
        row(f"pixels at {low:g} to {high:g}", pixels[((ring >= low) & (ring < high)).ravel()])
    for side in BLOCKS:
        count = PIXELS // side
        blocks = np.kron(np.eye(count * count).reshape(-1, count, count), np.ones((side, side)))
        row(f"blocks of {side} x {side} pixels", blocks / mean)
    variance = mean * mean.max()  # a camera's, of light alone
    for name, look in looks(mean, scene).items():
        beside = look - mean * (look / variance * mean).sum() / (mean / variance * mean).sum()
        row(name, (beside / variance)[None])


def main(argv: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=float, default=5.5)
    parser.add_argument("--chips", type=int, default=5, help="a side")
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--histories", type=int, default=2_097_152, help="of a run")
    asked = parser.parse_args(argv)
    print("told over found, standard deviations")
    told_and_found(module(asked.pairs, asked.chips), asked.runs, asked.histories)


if __name__ == "__main__":
    main()
