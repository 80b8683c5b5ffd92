"""Every designer on equal budgets: steps until it is within 0.5 points of the best known, beside peers on the like.

    python benchmarks/designers.py [--objective A] [--seeds 10] [--steps 2000] [--lanes 1] [--only ddqn-fast ...]

The objectives are those of tests/objectives.py with 0.3 % noise; a hit is the first design visited whose value free
of noise is within 0.5 points of the best known: the best of 200 ascents from random designs, and of all the runs.
The lattice: D 10, W 2, S 10, T 5 um, pairs 0.5. Evaluations are different designs, steps include those known before.
The paper's agent has its epsilon laid out for --steps; quartiles are of all seeds, one that missed counts as "-".
Peers: medians (hits/seeds) of other programs on an objective made from the same description, measured once, not here.
"""

from __future__ import annotations

import argparse
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from agent.ask_tell import Designer
from agent.ddqn import DoubleDqn, Learning
from agent.designers import designer, learning_of
from agent.moves import Space
from benchmarks.processes import table
from luxloop.campaign import Action
from tests.objectives import BOUNDS, ENVIRONMENT, Controller, Objective, ascended

NOISE, NEAR = 0.003, 0.5
SPACE = Space(BOUNDS, ENVIRONMENT.distance_from, ENVIRONMENT.spacing_is)
RIVALS = (
    *("ddqn-paper r1", "ddqn-paper r2", "ddqn-paper r3", "ddqn-paper-random"),
    *("ddqn-fast", "ddqn-fast-random", "pattern", "random"),
)
PEERS: list[tuple[str, str, str, str]] = [
    ("GP-EI on the lattice, cap 150", "36 (10/10)", "47 (10/10)", "69 (10/10)"),
    ("Optuna GPSampler 5.0.0, cap 120", "32 (7/7)", "", "0/1"),
    ("pattern search 8-4-2-1, another program", "48 (10/10)", "98 (10/10)", "84 (8/8)"),
    ("DDQN with 40 actions, another program, cap 2,000", "146 (10/10)", "349 (8/10)", "158 (9/10)"),
    ("CMA-ES, cap 8,000", "250 (10/10)", "552 (9/10)", "666 (7/7)"),
    ("scipy DE, population 4", "490 (10/10)", "940 (6/10)", "206 (8/8)"),
    ("plain DDQN, reward 1, cap 16,000", "4/10", "4/10", "10,826 (4/6)"),
    ("stable-baselines3 DQN, defaults, cap 16,000", "0/2", "", ""),
]


@dataclass(frozen=True)
class Run:
    """One seed of a designer: value reached so far after each step, evaluations and episodes at each step, time."""

    best: tuple[float, ...]
    evaluations: tuple[int, ...]
    episodes: tuple[int, ...]
    took_s: float


def rival(name: str, steps: int, seed: int, lanes: int) -> tuple[Designer, Learning | None]:
    """The designer of a row, and its hyper-parameters where it has some."""
    base, _, reward = name.partition(" ")
    if not base.startswith("ddqn"):
        return designer(base, SPACE, seed=seed, lanes=lanes), None
    learning = learning_of(base)
    if reward:
        learning = learning.model_copy(update={"reward": reward, "budget": steps})
    return designer(base, SPACE, seed=seed, lanes=lanes, learning=learning), learning


def run(name: str, objective: Objective, steps: int, seed: int, lanes: int) -> Run:
    """A designer alone with the objective for so many steps, all lanes' designs under evaluation at once."""
    chooser, learning = rival(name, steps, seed, lanes)
    controller = Controller(objective, reward=learning.reward if learning else "gain", noise=NOISE, seed=seed)
    best: list[float] = []
    evaluations, episodes = [], []
    begin = time.perf_counter()
    asked = {lane: chooser.ask(lane) for lane in range(lanes)}
    for number in range(steps):
        lane = number % lanes
        proposal = asked[lane]
        if proposal is None:
            break
        action = {"design": proposal.design, "move": proposal.move, "number": proposal.record.number}
        step = controller.act(Action(run="compare", designer="x", lane=lane, **action))
        chooser.tell(lane, step)
        asked[lane] = chooser.ask(lane)
        best.append(max(controller.true_percent(step.design), best[-1] if best else -np.inf))
        evaluations.append(chooser.known.evaluations)
        episodes.append(chooser.episodes if isinstance(chooser, DoubleDqn) else 0)
    return Run(tuple(best), tuple(evaluations), tuple(episodes), time.perf_counter() - begin)


def best_known(objective: Objective) -> float:
    """The best value that 200 ascents from random designs find."""
    random = np.random.default_rng(1)
    starts = (SPACE.draw(random) for _ in range(200))
    return max(ascended(objective, start)[0] for start in starts if start is not None)


def quartiles(hits: list[float]) -> str:
    """Median and quartiles; "-" where it lies among the seeds that missed."""
    shown = ("-" if np.isinf(x) else f"{x:,.0f}" for x in np.percentile(hits, [50, 25, 75], method="inverted_cdf"))
    return "{} ({} to {})".format(*shown)


def row(name: str, runs: list[Run], top: float) -> list[object]:
    """A row of the table."""
    at = [next((i for i, value in enumerate(one.best) if value >= top - NEAR), None) for one in runs]

    def seen(counts: list[tuple[int, ...]]) -> list[float]:
        return [np.inf if i is None else float(count[i]) for i, count in zip(at, counts, strict=True)]

    episodes = quartiles(seen([one.episodes for one in runs])).split(" ")[0] if "ddqn" in name else ""
    return [
        name,
        f"{sum(i is not None for i in at)}/{len(runs)}",
        quartiles(seen([one.evaluations for one in runs])),
        episodes,
        f"{np.median([one.best[min(99, len(one.best) - 1)] for one in runs]):.2f}",
        f"{np.median([one.best[-1] for one in runs]):.2f}",
        f"{np.median([one.took_s for one in runs]):.1f}",
    ]


def main() -> None:
    """Runs all and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objective", choices=("A", "B", "C"), default="A")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--lanes", type=int, default=1, help="designs under evaluation at once")
    parser.add_argument("--processes", type=int, choices=(1, 2), default=2)
    parser.add_argument("--only", nargs="+", choices=RIVALS, default=RIVALS)
    asked = parser.parse_args()
    with ProcessPoolExecutor(asked.processes, mp_context=get_context("spawn")) as pool:
        seeds = range(asked.seeds)
        waiting = {
            name: [pool.submit(run, name, asked.objective, asked.steps, seed, asked.lanes) for seed in seeds]
            for name in asked.only
        }
        found = {name: [one.result() for one in runs] for name, runs in waiting.items()}
    top = max(best_known(asked.objective), *(one.best[-1] for runs in found.values() for one in runs))
    heads = ["designer", "hits", "evaluations (quartiles)", "episodes", "best@100", f"best@{asked.steps}", "s/seed"]
    steps = f"{asked.steps:,} steps, {asked.lanes} at once"
    title = f"objective {asked.objective}, best known {top:.2f}, {NOISE:.1%} noise, {steps}"
    table(title, [row(name, runs, top) for name, runs in found.items()], heads)
    column = "ABC".index(asked.objective) + 1
    table(
        "peers, on an objective of the same description",
        [[peer[0], peer[column]] for peer in PEERS],
        ["", "evaluations"],
    )


if __name__ == "__main__":
    main()
