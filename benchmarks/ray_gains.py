"""What each acceleration of the ray tracer gains: 1 / (variance of U x CPU time) with it over without it.

    python benchmarks/ray_gains.py [--models clear_chip paper] [--histories 262144] [--replicas 12]

S_b3 (6.5 pairs) in each model. Every row switches one acceleration of the shipped solver off (`gain` is what it
brings); then all are off together, or what is not shipped is added. Variance of U: the stated one, mean of all
replicas (good to some 7 %), where modes are used; of the raw bins the spread of the replicas (good to 20 %), and in
the last column with it the square of their bias, the distance from the shipped solver's mean. CPU time is that of all
threads. The receiver's default is its own reflectance: with these models the same as analog.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks import cells
from benchmarks.processes import table
from containers.ray_tracing.arrays import CONES, UNFOLD
from containers.ray_tracing.exits import make_exits
from containers.ray_tracing.monte_carlo import BLOCK, MonteCarlo
from containers.ray_tracing.split import SplitMonteCarlo
from containers.ray_tracing.stopping import Solver
from containers.ray_tracing.tally import GROUPS, Tally
from containers.scene import Scene
from luxloop.model import Environment

Real = NDArray[np.float64]
RAW_BINS = 64
WIDER_UM = 510.0
"""Pitch of the second design of the difference."""
ANALOG, IMPLICIT = 0.0, 1.0
"""Chance that light goes on from the receiver: as often as in nature, or always with less weight."""
Make = Callable[[Scene, int], Solver]
Read = Callable[[Scene, Tally], tuple[float, float]]


@dataclass(frozen=True)
class Found:
    """Replicas of one way to solve."""

    values: Real
    """(replica,), U."""
    errors: Real
    """(replica,), stated; 0 where nothing is."""
    cpu_s: float
    """Of one replica."""

    def cost(self, bias: float = 0.0) -> float:
        """Variance of U, and the square of a bias, times CPU time."""
        variance = np.mean(self.errors**2) if self.errors.any() else self.values.var(ddof=1)
        return float(variance + bias**2) * self.cpu_s


def plain(scene: Scene, seed: int, *, cones: bool = False, unfold: bool = True, **options: object) -> MonteCarlo:
    """The full walk with flags of its kernels taken away."""
    solver = cells.full_walk(scene, seed, **options)
    flags = solver.arrays.flags.copy()
    flags[UNFOLD] &= unfold
    flags[CONES] &= cones
    solver.arrays = solver.arrays._replace(flags=flags)
    return solver


def from_modes(scene: Scene, tally: Tally) -> tuple[float, float]:
    """U by the estimator, and its stated error."""
    one = cells.uniformity_of(scene, tally)
    return one.value, one.standard_error


def from_bins(scene: Scene, tally: Tally) -> tuple[float, float]:  # noqa: ARG001  # as the other reader
    """Smallest over largest of the row of raw bins next to y = 0."""
    row = cells.relative_maps(tally, RAW_BINS).mean(axis=0)[RAW_BINS // 2]
    return float(row.min() / row.max()), 0.0


def solve(scene: Scene, make: Make, read: Read, each: int, seeds: range) -> Found:
    """Replicas with these seeds, `each` histories a group."""
    make(scene, 10_000).run_to(BLOCK)  # compiled, and the caches warm
    rows, cpu_s = [], []
    for seed in seeds:
        with cells.Clock() as clock:
            rows.append(read(scene, make(scene, seed).run_to(each)))
        cpu_s.append(clock.cpu_s)
    values, errors = np.array(rows).T
    return Found(values, errors, float(np.median(cpu_s)))


def ways(scene: Scene, each: int, seeds: range) -> dict[str, tuple[Make, Read]]:
    """Each row's solver and reader; the first is what is shipped."""
    walk = cells.full_walk
    exits = {seed: make_exits(scene, seed, each) for seed in (10_000, *seeds)}
    rows: dict[str, tuple[Make, Read]] = {
        "shipped full walk": (walk, from_modes),
        "face by face, not unfolded": (partial(plain, unfold=False, cones=True), from_modes),
        "eight symmetries not folded": (lambda scene, seed: cells.unfolded(walk(scene, seed)), from_modes),
        "raw 64 x 64 bins, not modes": (walk, from_bins),
        "analog receiver, as in nature": (partial(walk, survival=ANALOG), from_modes),
        "implicit receiver, always on": (partial(walk, survival=IMPLICIT), from_modes),
        "one direction off the substrate, no fan": (partial(walk, fan=1), from_modes),
        "random, not Sobol": (partial(walk, sobol=False), from_modes),
        "born everywhere, not in cones": (plain, from_modes),
        "none of all these": (
            lambda scene, seed: cells.unfolded(plain(scene, seed, unfold=False, sobol=False, survival=ANALOG)),
            from_bins,
        ),
        "expected-value splitting added": (SplitMonteCarlo, from_modes),
        "stored exits, in memory": (lambda scene, seed: cells.landing(scene, exits[seed], seed), from_modes),
    }
    if not cells.full_walk(scene, 1).arrays.flags[CONES]:
        del rows["born everywhere, not in cones"]
    return rows


def gains(environment: Environment, each: int, seeds: range) -> tuple[list[tuple[str, ...]], float]:
    """Rows of the table, and the truth that biases are taken from."""
    scene = cells.scene_for(environment, cells.DESIGNS["S_b3"])
    found = {name: solve(scene, make, read, each, seeds) for name, (make, read) in ways(scene, each, seeds).items()}
    shipped = found["shipped full walk"]
    truth = float(shipped.values.mean())
    rows = []
    for name, one in found.items():
        sign = -1.0 if "added" in name or "stored" in name else 1.0
        bias = 0.0 if one.errors.any() else float(one.values.mean()) - truth
        both = ((one.cost(b) / shipped.cost()) ** sign for b in (0.0, bias))
        rows.append((name, *shown(one, truth), *(f"{gain:.2f}" for gain in both)))
    return rows, truth


def shown(one: Found, truth: float) -> tuple[str, ...]:
    """Columns of a row, in points."""
    stated = f"{100.0 * np.sqrt(np.mean(one.errors**2)):.2f}" if one.errors.any() else ""
    return (
        f"{100.0 * (one.values.mean() - truth):+.2f}", f"{100.0 * one.values.std(ddof=1):.2f}", stated,
        f"{one.cpu_s:.3f}",
    )  # fmt: skip


def common_numbers(environment: Environment, each: int, seeds: range) -> tuple[float, float, float]:
    """Standard deviation of U(S 500) - U(S 510), points, with the same seed and with others; their ratio^2."""
    design = cells.DESIGNS["S_b3"]
    both = [cells.scene_for(environment, d) for d in (design, design.model_copy(update={"spacing_um": WIDER_UM}))]
    near, wide = (
        [from_modes(scene, cells.full_walk(scene, seed).run_to(each))[0] for seed in seeds] for scene in both
    )
    same = np.subtract(near, wide)
    apart = float(np.sqrt(np.var(near, ddof=1) + np.var(wide, ddof=1)))
    return 100.0 * float(same.std(ddof=1)), 100.0 * apart, float(apart**2 / same.var(ddof=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", choices=sorted(cells.MODELS), default=["clear_chip", "paper"])
    parser.add_argument("--histories", type=int, default=262_144, help="of each replica")
    parser.add_argument("--replicas", type=int, default=12)
    options = parser.parse_args()
    each = max(1, options.histories // (BLOCK * GROUPS)) * BLOCK
    seeds = range(1, 1 + options.replicas)
    heads = ("what is different", "off, points", "spread", "stated", "CPU s", "gain", "and bias")
    for name in options.models:
        print(cells.load())
        rows, truth = gains(cells.MODELS[name], each, seeds)
        table(f"{name}, S_b3: U {100.0 * truth:.2f} by {options.replicas} x {GROUPS * each:,} histories", rows, heads)
        same, apart, ratio = common_numbers(cells.MODELS[name], each, range(1, 1 + 3 * options.replicas))
        both = f"same seed {same:.2f}, different seeds {apart:.2f} points"
        print(f"  spread of U(S 500) - U(S {WIDER_UM:g}): {both}: gain {ratio:.2f}")
    print(cells.load())


if __name__ == "__main__":
    main()
