"""The paper's experiment on its bounds: learners with each reward, the fast profile, rivals that do not learn.

    python benchmarks/paper_experiment.py [--evaluations 300] [--seeds 2] [--method monte_carlo] [--only NAMES]

Real workers, the shipped model `paper`, bounds `paper-table3`. Every run's five best designs are evaluated anew with
fresh seeds to 0.3 points, and only that counts as its result. `near`: runs whose best is within 0.5 points and twice
the combined error of the best of all runs; evaluations until the walk met it. The share is of the 106,920 designs of
the paper's grid; the paper's own run took 15 % of the evaluations and 17.9 % of the time.
"""

from __future__ import annotations

import argparse
import os
from statistics import median

from agent.comparison import Trial, best_of, evaluations_to_near
from agent.config import Campaign, Stop
from agent.launch import launch
from benchmarks.processes import Processes, table

FILM = ("-m", "luxloop", "serve", "thin-film", "--quiet")
RAY = ("-m", "luxloop", "serve", "ray-tracing", "--quiet")
ENTRIES = {
    "ddqn-paper r1": ("ddqn-paper", "r1"),
    "ddqn-paper r2": ("ddqn-paper", "r2"),
    "ddqn-paper r3": ("ddqn-paper", "r3"),
    "ddqn-fast": ("ddqn-fast", None),
    "ddqn-fast-random": ("ddqn-fast-random", None),
    "pattern": ("pattern", None),
    "random": ("random", None),
}
GRID = 106_920


def main() -> None:
    """Run all entries on one set of processes, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evaluations", type=int, default=300)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--method", choices=("monte_carlo", "twin"), default="monte_carlo")
    parser.add_argument("--walk-error", type=float, default=1.0)
    parser.add_argument("--only", nargs="+", choices=list(ENTRIES), default=list(ENTRIES))
    chosen = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    trials: dict[str, list[Trial]] = {}
    with Processes(FILM, RAY) as processes:
        for label in chosen.only:
            name, reward = ENTRIES[label]
            for seed in range(1, chosen.seeds + 1):
                campaign = Campaign(
                    designer=name, seed=seed, reward=reward, method=chosen.method,
                    walk_error_points=chosen.walk_error, stop=Stop(evaluations=chosen.evaluations),
                )  # fmt: skip
                run = f"{label.replace(' ', '-')}-{seed}"
                done = launch(processes.settings, campaign, "paper", run, local=False)
                trials.setdefault(label, []).append(Trial(label, seed, done.walk, 0, done.found))
    print(f"{chosen.evaluations} evaluations, {chosen.seeds} seeds, {chosen.method}")
    report(trials)


def report(trials: dict[str, list[Trial]]) -> None:
    """The table."""
    top = best_of([trial for own in trials.values() for trial in own])
    rows = []
    for label, own in trials.items():
        best = sorted(
            (trial.found.sound_best for trial in own if trial.found.sound_best), key=lambda step: step.uniformity
        )
        came = [evaluations_to_near(trial, top) for trial in own]
        reached = [count for count in came if count is not None]
        middle = best[len(best) // 2]
        wall_s = median(trial.found.progress.wall_s for trial in own)
        count = median(len(trial.walk) for trial in own)
        rows.append(
            [
                label, f"{100.0 * middle.uniformity:.2f} +- {100.0 * middle.uniformity_error:.2f}",
                f"{100.0 * best[0].uniformity:.2f} to {100.0 * best[-1].uniformity:.2f}",
                f"{len(reached)} of {len(own)}", f"{median(reached):g}" if reached else "-",
                f"{median(trial.found.progress.episodes for trial in own):g}", f"{count:g}", f"{wall_s:.0f}",
                f"{100.0 * count / GRID:.2f} %", str(best[-1].design),
            ]
        )  # fmt: skip
    heads = ("designer", "best, % (median)", "over seeds", "near", "evaluations to it", "episodes", "evaluations",
             "walk, s", "of the grid", "best design")  # fmt: skip
    table("finalists by Monte Carlo with fresh seeds", rows, heads)


if __name__ == "__main__":
    main()
