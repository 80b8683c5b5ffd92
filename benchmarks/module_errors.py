"""Whether the errors that are told of a finite module hold: of its map, pixel by pixel, and of its uniformity.

    python benchmarks/module_errors.py [--seeds 12] [--histories 40000,320000] [--reference 6000000]

Runs that differ in their seed alone, beside one of many histories. `map` is rms over the places, in % of its mean:
what the runs are off by (the noise of the reference taken out), and what is told; z2 is the mean of (off / told)^2, 1
where errors hold. U in points: mean error told, spread over the runs, how far their mean is from the reference. The
last module's chips shine more at one side, so it is not its own mirror image. Told by the root of the share of light
(until decision 68), by Stein's estimate (what a worker tells), and by the groups as they were counted.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.build import scene_of
from containers.ray_tracing.field import Field
from containers.ray_tracing.light import _error_over_noise, _share_of_first, _weighed, unweighed
from containers.ray_tracing.monte_carlo import MonteCarlo, blocks_of
from containers.ray_tracing.outcome import region_of
from containers.ray_tracing.uniformity import uniformity
from containers.scene import Array, Emission, Scene
from luxloop.design import Design
from luxloop.model_file import find_model

Real = NDArray[np.float64]
DESIGNS = {
    "start": Design(distance_um=140.0, width_um=40.0, spacing_um=440.0, thickness_um=35.0, dbr_pairs=0.0),
    "even": Design(distance_um=180.0, width_um=54.0, spacing_um=300.0, thickness_um=5.0, dbr_pairs=0.0),
}
UNEVEN = Emission(position=np.array([[0.7, 1.3]]))
MODULES = {"one chip": (1, 400.0, None), "2 x 2": (2, 600.0, None), "2 x 2, uneven": (2, 600.0, UNEVEN)}
PLACES_UM = np.linspace(-300.0, 300.0, 31)
WAYS = ("share", "Stein", "counted")


def field_of(scene: Scene, histories: int, seed: int) -> Field:
    """What the receiver counted, no mode weighed."""
    return unweighed(MonteCarlo(scene, seed).run_to(blocks_of(histories)), scene)


def told_by(field: Field) -> dict[str, Field]:
    """The weighed field, its spread told in each way."""
    share = _share_of_first(field)
    errors = dict(zip(WAYS, (share, _error_over_noise(field, share), np.ones_like(share)), strict=True))
    return {way: replace(field, coefficients=_weighed(field, share, error)) for way, error in errors.items()}


def map_of(field: Field) -> tuple[Real, Real]:
    """Mean and variance of the mean (y, x)."""
    groups = field.grid(PLACES_UM, PLACES_UM)
    return groups.mean(axis=0), groups.var(axis=0, ddof=1) / len(groups)


def row(scene: Scene, histories: int, seeds: int, reference: tuple[Real, Real, float]) -> list[str]:
    """The cells of a row of the table."""
    maps: dict[str, list[tuple[Real, Real]]] = {way: [] for way in WAYS}
    values: dict[str, list[tuple[float, float]]] = {way: [] for way in WAYS}
    for seed in range(seeds):
        for way, field in told_by(field_of(scene, histories, seed)).items():
            of_u = uniformity(field, region_of(scene))
            maps[way].append(map_of(field))
            values[way].append((of_u.value, of_u.standard_error))
    truth, noise, true_u = reference
    cells = []
    for way in WAYS:
        mean, variance = (np.array(part) for part in zip(*maps[way], strict=True))
        off2 = (mean - truth) ** 2
        z2 = np.mean(off2 / (variance + noise))
        told, spread = (100.0 * np.sqrt(x) / truth.mean() for x in (variance.mean(), np.mean(off2 - noise)))
        of_u = 100.0 * np.array(values[way])
        if not cells:
            cells.append(f"{spread:.2f}")
        cells.append(f"{told:.2f} ({z2:.2f})")
        off = of_u[:, 0].mean() - 100.0 * true_u
        cells.append(f"{of_u[:, 1].mean():.2f} of {of_u[:, 0].std(ddof=1):.2f}, {off:+.2f}")
    return cells


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--histories", default="40000,320000")
    parser.add_argument("--reference", type=int, default=6_000_000)
    asked = parser.parse_args()
    environment = find_model("paper").environment
    heads = ["module", "design", "histories", "map off by, %"]
    heads += [f"{what} by {way}" for way in WAYS for what in ("map told, % (z2)", "U told of spread, off")]
    table = [heads]
    for module, (side, half_um, emission) in MODULES.items():
        for name, design in DESIGNS.items():
            layout = Array.regular(side, side, design.spacing_um, half_um)
            scene = scene_of(environment, design, None, layout)
            scene = replace(scene, emission=emission or scene.emission)
            many = field_of(scene, asked.reference, 1000)
            reference = *map_of(many), uniformity(many, region_of(scene)).value
            table += [
                [module, name, f"{histories:,}", *row(scene, histories, asked.seeds, reference)]
                for histories in map(int, asked.histories.split(","))
            ]
    widths = [max(len(line[column]) for line in table) for column in range(len(heads))]
    for line in table:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))


if __name__ == "__main__":
    main()
