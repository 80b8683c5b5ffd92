"""What `spectrum = sampled` does to U: a wavelength per history, beside one spectrum-averaged table for all light.

    python benchmarks/ray_spectrum.py [--seeds 16] [--histories 262144] [--models paper clear_chip] [--dispersive]

U of Eq. 8 of the paper's four designs by full walks, both readings with the same seeds: their difference is taken
seed by seed, and its standard error comes from the spread of the seeds, so what both have in common drops out.
`alone` is what that error would be if the two were independent; `mean` is the change of the mean illuminance. An
average is right for one encounter with the film; light that comes back to it is no longer that of the line. Without
pairs there is no film, and both are the same request: 0 bit for bit.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from benchmarks import cells
from benchmarks.processes import table
from containers.ray_tracing.monte_carlo import blocks_of
from containers.scene import Scene
from luxloop.design import Design
from luxloop.model import Environment

Real = NDArray[np.float64]
FIRST_SEED = 1
READINGS = ("averaged", "sampled")


def of_seeds(scene: Scene, seeds: int, histories: int) -> Real:
    """(seed, 2): U in percent and the mean relative illuminance."""
    found = []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        solver = cells.full_walk(scene, seed)
        solver.run_to(blocks_of(histories))
        one = cells.uniformity_of(scene, solver.tally)
        found.append((100.0 * one.value, cells.mean_of(scene, solver.tally)[0]))
    return np.array(found)


def with_error(values: Real, digits: int = 2) -> str:
    """Mean of (seed,) and its standard error."""
    return f"{values.mean():+.{digits}f} +- {values.std(ddof=1) / np.sqrt(values.size):.{digits}f}"


def row(
    name: str, environment: Environment, label: str, design: Design, options: argparse.Namespace
) -> tuple[str, ...]:
    """One design under one model, by both readings."""
    scenes = [cells.scene_for(environment.model_copy(update={"spectrum": one}), design) for one in READINGS]
    with cells.Clock() as plain:
        averaged = of_seeds(scenes[0], options.seeds, options.histories)
    with cells.Clock() as by_wave:
        sampled = of_seeds(scenes[1], options.seeds, options.histories)
    change = 100.0 * (sampled[:, 1] / averaged[:, 1] - 1.0)
    alone = float(np.hypot(averaged[:, 0].std(ddof=1), sampled[:, 0].std(ddof=1)) / np.sqrt(options.seeds))
    return (
        name, label, f"{scenes[1].chip.index.size}", with_error(averaged[:, 0])[1:], with_error(sampled[:, 0])[1:],
        with_error(sampled[:, 0] - averaged[:, 0]), f"{alone:.2f}", with_error(change),
        f"{plain.wall_s:.1f} / {by_wave.wall_s:.1f}",
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--histories", type=int, default=1 << 18, help="of each walk")
    parser.add_argument("--models", nargs="+", choices=list(cells.MODELS), default=["paper", "clear_chip"])
    parser.add_argument("--dispersive", action="store_true", help="indices of the material tables instead of fixed")
    options = parser.parse_args()
    indices = "dispersive" if options.dispersive else "fixed"
    print(f"{cells.load()}; indices {indices}; {options.seeds} seeds of {options.histories:,} histories each")
    rows = [
        row(name, cells.MODELS[name].model_copy(update={"indices": indices}), label, design, options)
        for name in options.models
        for label, design in cells.DESIGNS.items()
    ]
    heads = (
        "model",
        "design",
        "lines",
        "U averaged, %",
        "U sampled, %",
        "change, points",
        "alone",
        "mean, %",
        "wall s",
    )
    table("sampled less averaged, same seeds", rows, heads)
    print(f"  {cells.load()}")


if __name__ == "__main__":
    main()
