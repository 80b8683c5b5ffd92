"""Time of one design at a standard error of U of 0.3 points, of random ones, and what the whole grid would take.

    python benchmarks/ray_designs.py [--designs 100] [--models clear_chip paper] [--target-error 0.3] [--seed 1]

All cores; a time holds scene, film table, tracing, the stopping rule and U. `full walk` is cold: nothing stored.
`exits from memory` lands exits that are held, `from the folder` those that another process wrote (they are mapped and
their hash is checked), `exits made` is the first time, when the chip's exits are computed and stored. Random designs
are drawn from the feasible ones of the paper's grid (92,070 of 106,920; the others take no time). The grid is
projected as a mean over them: by full walks, and by stored exits, where each of its 660 chips is computed once.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import cells
from benchmarks.processes import table
from containers.ray_tracing.exit_source import ExitSource
from luxloop.design import Bounds, Design
from luxloop.errors import InputError
from luxloop.model import Environment

CHIPS = 660
"""W x T x pairs of the grid."""
BUDGET_S = 60.0
"""A design that would take longer is left out, and counted."""
REPEATS = 3


@dataclass(frozen=True)
class Spent:
    """What a design took by one way."""

    wall_s: float
    cpu_s: float
    histories: int
    error: float


def walked(environment: Environment, design: Design, target: float, seed: int) -> Spent:
    """By the full walk."""
    with cells.Clock() as clock:
        scene = cells.scene_for(environment, design)
        solver = cells.full_walk(scene, seed)
        one = cells.to_error(solver, scene, target, BUDGET_S)
    return Spent(clock.wall_s, clock.cpu_s, solver.tally.total_histories, one.standard_error)


def landed(source: ExitSource, environment: Environment, design: Design, target: float, seed: int) -> Spent:
    """By exits of a source, made there where it has none."""
    with cells.Clock() as clock:
        scene = cells.scene_for(environment, design)
        solver = cells.landing(scene, source.batches(scene, seed), seed)
        one = cells.to_error(solver, scene, target, BUDGET_S)
    return Spent(clock.wall_s, clock.cpu_s, solver.tally.total_histories, one.standard_error)


def four_ways(environment: Environment, design: Design, target: float, seed: int) -> dict[str, Spent]:
    """The mean of some repeats of each way, with other seeds."""
    found: dict[str, list[Spent]] = {}
    for number in range(seed, seed + REPEATS):
        with tempfile.TemporaryDirectory() as name:
            source = ExitSource(Path(name))
            once = {
                "full walk": walked(environment, design, target, number),
                "exits made": landed(source, environment, design, target, number),
                "exits from memory": landed(source, environment, design, target, number),
                "exits from the folder": landed(ExitSource(Path(name)), environment, design, target, number),
            }
        for way, spent in once.items():
            found.setdefault(way, []).append(spent)
    return {way: mean_of(spent) for way, spent in found.items()}


def mean_of(spent: list[Spent]) -> Spent:
    """The mean of each number."""
    wall_s, cpu_s, histories, error = np.mean([tuple(vars(one).values()) for one in spent], axis=0)
    return Spent(float(wall_s), float(cpu_s), round(histories), float(error))


def one_design(models: list[str], target: float, seed: int) -> None:
    """The first table: the paper's best design."""
    rows = []
    for model in models:
        for way, spent in four_ways(cells.MODELS[model], cells.DESIGNS["S_b3"], target, seed).items():
            rows.append((model, way, *columns(spent)))
    heads = ("model", "way", "wall s", "CPU s", "histories", "error, points")
    table(f"S_b3 to {target:g} points, mean of {REPEATS} seeds", rows, heads)


def columns(spent: Spent) -> tuple[str, ...]:
    """What is shown of it."""
    return f"{spent.wall_s:.3f}", f"{spent.cpu_s:.3f}", f"{spent.histories:,}", f"{100.0 * spent.error:.3f}"


def many(model: str, designs: list[Design], target: float, seed: int) -> list[tuple[str, ...]]:
    """Rows of the second table: random designs by the full walk, by fresh exits and by stored ones."""
    environment = cells.MODELS[model]
    found: dict[str, list[Spent]] = {"full walk": [], "exits made": [], "exits from memory": []}
    left_out = 0
    for design in designs:
        source = ExitSource()
        try:
            found["full walk"].append(walked(environment, design, target, seed))
            found["exits made"].append(landed(source, environment, design, target, seed))
            found["exits from memory"].append(landed(source, environment, design, target, seed))
        except InputError as error:
            left_out += 1
            print(f"  {model}, {design}: {error}")
    least = min(map(len, found.values()))
    rows = [(model, way, *spread(spent[:least])) for way, spent in found.items()]
    print(f"  {model}: {left_out} of {len(designs)} designs left out")
    print(f"  {model}: {projected({way: mean_of(spent[:least]) for way, spent in found.items()})}")
    return rows


def spread(spent: list[Spent]) -> tuple[str, ...]:
    """Mean, median and largest wall time, mean CPU time, mean histories, mean error."""
    walls = np.array([one.wall_s for one in spent])
    cpu, count, error = np.mean([(one.cpu_s, one.histories, 100.0 * one.error) for one in spent], axis=0)
    return (
        f"{walls.mean():.3f}", f"{np.median(walls):.3f}", f"{walls.max():.3f}", f"{cpu:.3f}", f"{count:,.0f}",
        f"{error:.3f}",
    )  # fmt: skip


def projected(mean: dict[str, Spent]) -> str:
    """Hours for the whole grid: the chips' exits once each, and a landing for each feasible design."""
    feasible = round(cells.feasible_share() * Bounds.preset("paper-grid").count)
    texts = []
    for unit, field in (("h here", "wall_s"), ("CPU-h", "cpu_s")):
        full, made, held = (float(getattr(one, field)) / 3600.0 for one in mean.values())
        stored = CHIPS * (made - held) + feasible * held
        texts.append(f"{feasible * full:.1f} {unit} by full walks, {stored:.1f} {unit} by stored exits")
    return f"the grid's {feasible:,} feasible designs of {Bounds.preset('paper-grid').count:,}: {'; '.join(texts)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--designs", type=int, default=100, help="random ones, for each model")
    parser.add_argument("--models", nargs="+", choices=sorted(cells.MODELS), default=["clear_chip", "paper"])
    parser.add_argument("--target-error", type=float, default=0.3, help="of every U, in points")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    walked(cells.CLEAR, cells.DESIGNS["S_b3"], 5.0, 1)  # compiled
    landed(ExitSource(), cells.CLEAR, cells.DESIGNS["S_b3"], 5.0, 1)
    print(cells.load())
    one_design(options.models, options.target_error, options.seed)
    print(cells.load())
    designs = cells.random_designs(options.designs, options.seed)
    rows = [row for model in options.models for row in many(model, designs, options.target_error, options.seed)]
    heads = ("model", "way", "mean wall s", "median", "largest", "mean CPU s", "histories", "error, points")
    table(f"{options.designs} random designs of the paper's grid to {options.target_error:g} points", rows, heads)
    print(cells.load())


if __name__ == "__main__":
    main()
