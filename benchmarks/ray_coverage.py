"""How often the stated 95 % interval of U holds the truth: full walk, and stored exits.

    python benchmarks/ray_coverage.py [--seeds 20] [--designs 6] [--histories 131072] [--times 50]

The paper's four designs and random ones of its grid, the shipped models in turn, with 20 seeds each. Truth is a full
walk of another seed with 50 times the histories; its own error, a seventh of a trial's, is left in. Stored exits are
made afresh for every trial, landed with one seed for all trials or with a fresh one. The last way has one set of
exits per design, landed with fresh seeds: its trials share the exits' error, so they count as few, without interval.
Coverage with the 95 % interval of Clopper and Pearson; `off` is the mean error, `spread` its standard deviation, both
in stated standard errors.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from benchmarks import cells
from benchmarks.processes import table
from containers.ray_tracing.estimate import Estimate
from containers.ray_tracing.exits import make_exits
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.stopping import Solver
from containers.ray_tracing.tally import GROUPS
from containers.scene import Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]
TRUTH_SEED, FIRST_SEED = 987_654_321, 1
Way = Callable[[Scene, int, int], Solver]


def fresh_exits(scene: Scene, seed: int, each: int) -> Solver:
    """New exits, the same landing."""
    return cells.landing(scene, make_exits(scene, seed, each), FIRST_SEED)


def fresh_exits_and_landing(scene: Scene, seed: int, each: int) -> Solver:
    """New exits, a new landing."""
    return cells.landing(scene, make_exits(scene, seed, each), seed)


def fresh_landing(scene: Scene, seed: int, each: int) -> Solver:
    """The design's one set of exits, a new landing."""
    return cells.landing(scene, make_exits(scene, FIRST_SEED, each), seed)


def full_walk(scene: Scene, seed: int, each: int) -> Solver:  # noqa: ARG001  # as the other ways
    """Whole histories."""
    return cells.full_walk(scene, seed)


WAYS: dict[str, Way] = {
    "full walk": full_walk,
    "stored exits, fresh exit seeds": fresh_exits,
    "stored exits, fresh exit and landing seeds": fresh_exits_and_landing,
    "one set of exits, fresh landing seeds": fresh_landing,
}


def scenes(random: int, seed: int) -> dict[str, Scene]:
    """The designs of the trials, the models in turn."""
    named = list(cells.DESIGNS.items()) + [(str(design), design) for design in cells.random_designs(random, seed)]
    models = list(cells.MODELS.items())
    chosen = [(name, design, models[i % len(models)]) for i, (name, design) in enumerate(named)]
    return {f"{model}: {name}": cells.scene_for(of, design) for name, design, (model, of) in chosen}


def trial(scene: Scene, way: Way, seed: int, each: int) -> Estimate | None:
    """U of one trial; None where it has too few histories to be told."""
    try:
        return cells.uniformity_of(scene, way(scene, seed, each).run_to(each))
    except InputError as error:
        if error.field != "histories":
            raise
        return None


def held(found: list[Estimate], truth: float) -> tuple[int, Real]:
    """How many intervals hold the truth, and the errors in stated standard errors."""
    ends = [one.interval() for one in found]
    errors = np.array([(one.value - truth) / one.standard_error for one in found])
    return sum(low <= truth <= high for low, high in ends), errors


def clopper_pearson(hits: int, trials: int) -> tuple[float, float]:
    """Ends of the 95 % interval of a share."""
    low = beta.ppf(0.025, hits, trials - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, trials - hits) if hits < trials else 1.0
    return float(low), float(high)


def rows_of(of: dict[str, Scene], truths: dict[str, float], way: str, each: int, seeds: range) -> tuple[str, ...]:
    """The row of a way over all designs and seeds, and a line for each design."""
    hits, trials, errors, lines = 0, 0, [], []
    with cells.Clock() as clock:
        for name, scene in of.items():
            found = [one for seed in seeds if (one := trial(scene, WAYS[way], seed, each)) is not None]
            inside, normal = held(found, truths[name])
            hits, trials = hits + inside, trials + len(found)
            errors.append(normal)
            lines.append(f"{inside}/{len(found)}")
    together = np.concatenate(errors)
    low, high = clopper_pearson(hits, trials)
    between = f"{100.0 * low:.1f} to {100.0 * high:.1f}" if way != "one set of exits, fresh landing seeds" else ""
    return (
        way, f"{hits}/{trials}", f"{100.0 * hits / trials:.1f}", between, f"{together.mean():+.2f}",
        f"{together.std(ddof=1):.2f}", " ".join(lines), f"{clock.wall_s:.0f}",
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--designs", type=int, default=6, help="random ones, beside the paper's four")
    parser.add_argument("--histories", type=int, default=131_072, help="of a trial")
    parser.add_argument("--times", type=int, default=50, help="as many for the truth")
    options = parser.parse_args()
    each = max(1, options.histories // (BLOCK * GROUPS)) * BLOCK
    of = scenes(options.designs, seed=3)
    print(cells.load())
    truths, rows = {}, []
    with cells.Clock() as clock:
        for name, scene in of.items():
            one = cells.uniformity_of(scene, cells.full_walk(scene, TRUTH_SEED).run_to(options.times * each))
            truths[name] = one.value
            rows.append((name, cells.points(one)))
    table(f"truth, {options.times * each * GROUPS:,} histories each, {clock.wall_s:.0f} s", rows, ("design", "U"))
    seeds = range(FIRST_SEED + 1, FIRST_SEED + 1 + options.seeds)
    heads = ("way", "hold", "%", "Clopper-Pearson", "off", "spread", "by design", "s")
    found = [rows_of(of, truths, way, each, seeds) for way in WAYS]
    table(f"95 % intervals of {len(of)} designs x {len(seeds)} seeds, {each * GROUPS:,} histories each", found, heads)
    print(cells.load())


if __name__ == "__main__":
    main()
