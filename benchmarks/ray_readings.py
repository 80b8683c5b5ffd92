"""Uniformity of the paper's designs under several readings of the paper, beside its own numbers and the known ones.

    python benchmarks/ray_readings.py [--target-error 0.15] [--readings "clear chip" ...]

U of Eq. 8 over one whole pitch, in percent with its standard error, and the change of the mean illuminance of S_b3 by
its DBR. `known` are the numbers of an earlier program (S_b3: good to 1 point); those in the last row of a reading are
ours less known. One full walk for each number, on all cores, seed 1, stopped by its own error.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks import cells
from benchmarks.processes import table
from containers.bsdf import Mirror
from containers.ray_tracing.estimate import Estimate
from containers.scene import Scene
from luxloop.design import Design
from luxloop.model import Environment

PAPER = (68.15, 90.32, 83.97, 86.51, -8.4)
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Reading:
    """One way to read the paper."""

    environment: Environment
    known: Numbers = ()
    """U of the four designs, mean change, in percent."""
    change: Callable[[Scene], Scene] = lambda scene: scene


def of_clear(**changes: object) -> Environment:
    """The clear chip with changes."""
    return cells.CLEAR.model_copy(update=changes)


def perfect_mirror(scene: Scene) -> Scene:
    """Below the chip a mirror that takes nothing, instead of one with the substrate's reflectance."""
    return replace(scene, chip=replace(scene.chip, mirror=Mirror(1.0)))


MIRROR = of_clear(active_layer_depth=0.99, chip_bottom="mirror", chip_absorption_per_cm=200.0)
READINGS = {
    "clear chip": Reading(cells.CLEAR, (68.8, 66.4, 77.2, 68.0, -2.5)),
    "30 /cm": Reading(of_clear(chip_absorption_per_cm=30.0), (68.9, 75.5, 91.7, 71.6, -8.5)),
    "layer 0.99 T, mirror, 200 /cm": Reading(MIRROR, (66.6, 89.8, 94.1, 80.3, -13.0)),
    "the same, mirror of reflectance 1": Reading(MIRROR, (66.6, 89.8, 94.1, 80.3, -13.0), perfect_mirror),
    "layer 0.95 T, 500 /cm": Reading(
        of_clear(active_layer_depth=0.95, chip_absorption_per_cm=500.0), (64.0, 90.3, 94.1, 84.4, -15.7)
    ),
}


def measured(reading: Reading, design: Design, target: float) -> tuple[Estimate, float, float, int]:
    """U, mean relative illuminance with its error, and histories."""
    scene = reading.change(cells.scene_for(reading.environment, design))
    solver = cells.full_walk(scene, 1)
    one = cells.to_error(solver, scene, target)
    return one, *cells.mean_of(scene, solver.tally), solver.tally.total_histories


def rows_of(name: str, reading: Reading, target: float) -> list[tuple[str, ...]]:
    """The rows of a reading, and what they took."""
    with cells.Clock() as clock:
        found = [measured(reading, design, target) for design in cells.DESIGNS.values()]
    (_, bare, bare_error, _), (_, dbr, dbr_error, _) = found[:2]
    change = dbr / bare - 1.0
    error = (1.0 + change) * float(np.hypot(bare_error / bare, dbr_error / dbr))
    values = [*(100.0 * one.value for one, *_ in found), 100.0 * change]
    errors = [*(100.0 * one.standard_error for one, *_ in found), 100.0 * error]
    spent = f"{sum(one[-1] for one in found) / 1e6:.1f} M", f"{clock.wall_s:.1f}", f"{clock.cpu_s:.1f}"
    shown = [(name, *(f"{v:.2f} +- {e:.2f}" for v, e in zip(values, errors, strict=True)), *spent)]
    blank = ("", "", "")
    shown.append(("  less known", *(f"{v - k:+.1f}" for v, k in zip(values, reading.known, strict=True)), *blank))
    shown.append(("  less paper", *(f"{v - p:+.1f}" for v, p in zip(values, PAPER, strict=True)), *blank))
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target-error", type=float, default=0.15, help="of every U, in points")
    parser.add_argument("--readings", nargs="+", choices=list(READINGS), default=list(READINGS), metavar="READING")
    options = parser.parse_args()
    cells.full_walk(cells.golden_scene("B"), 1).run_to(128)  # compiled
    print(cells.load())
    with cells.Clock() as clock:
        rows = [row for name in options.readings for row in rows_of(name, READINGS[name], options.target_error)]
    heads = ("reading", *cells.DESIGNS, "change of the mean", "histories", "wall s", "CPU s")
    rows.append(("paper", *(f"{value:.2f}" for value in PAPER), "", "", ""))
    table(f"U in %, each to {options.target_error:g} points", rows, heads)
    print(f"  {clock.wall_s:.0f} s, {clock.cpu_s:.0f} CPU-s; {cells.load()}")


if __name__ == "__main__":
    main()
