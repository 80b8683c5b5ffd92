"""Campaigns with real physics: how busy PC3 is, where a step's time goes, one ray worker against two.

    python benchmarks/campaign_physics.py [--evaluations 150] [--lanes 4]

Monte Carlo at 1 point in the walk, the paper's model and bounds. `busy` is the computing time of the ray workers over
the wall time and their number. Workers are warm before the clock starts. All rows have the same seed: their walks are
equal to the last bit, which is checked.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

from agent.config import Campaign, Stop
from agent.launch import launch
from benchmarks.processes import Processes, table
from luxloop.journal.reader import RunJournal

FILM = ("-m", "luxloop", "serve", "thin-film", "--quiet")
RAY = ("-m", "luxloop", "serve", "ray-tracing", "--quiet")


def row(workers: int, threads: int, lanes: int, evaluations: int) -> tuple[list[object], object]:
    """A campaign on so many ray workers of so many threads; its row, and its weights step by step."""
    os.environ["LUXLOOP_THREADS"] = str(threads)
    with Processes(FILM, *([RAY] * workers)) as processes:
        few = Stop(evaluations=4 * workers)
        warm = Campaign(designer="random", seed=99, lanes=2 * workers, finalists=1, stop=few)
        launch(processes.settings, warm, "paper", "warm", local=False)
        campaign = Campaign(designer="ddqn-fast", lanes=lanes, stop=Stop(evaluations=evaluations))
        began_s = time.perf_counter()
        done = launch(processes.settings, campaign, "paper", "run", local=False)
        whole_s = time.perf_counter() - began_s
        journal = RunJournal(Path(done.ended.folder))
        walk = [step for step in journal.steps() if not step.final]
        rays_s = sum(step.physics_s for step in walk if not step.cached)
        wall_s = (max(r.log_time_ns for r in journal.records("/step") if r.sequence < len(walk))
                  - min(r.log_time_ns for r in journal.records("/step"))) / 1e9  # fmt: skip
        learner = (entry.value for entry in journal.records("/agent"))
        weights = sorted((one.lane, one.number, one.weights_sha256) for one in learner)
    seen, best = done.found.progress, done.found.best
    return [
        workers, threads, lanes, len(walk), f"{wall_s:.1f}", f"{len(walk) / wall_s:.1f}",
        f"{100.0 * rays_s / wall_s / workers:.1f} %", f"{1e3 * rays_s / len(walk):.0f}",
        f"{1e3 * seen.learner_s / len(walk):.2f}", f"{100.0 * seen.learner_s / wall_s:.1f} %", f"{whole_s:.1f}",
        f"{100.0 * best.uniformity:.2f} +- {100.0 * best.uniformity_error:.2f}" if best else "-",
    ], weights  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evaluations", type=int, default=150)
    parser.add_argument("--lanes", type=int, default=4)
    chosen = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    found = [row(workers, threads, chosen.lanes, chosen.evaluations) for workers, threads in ((1, 2), (2, 1), (1, 1))]
    heads = ("ray workers", "threads each", "lanes", "steps", "walk, s", "steps/s", "busy", "rays, ms a step",
             "learner, ms", "learner", "with finalists, s", "best, %")  # fmt: skip
    table("campaigns with real physics", [one[0] for one in found], heads)
    print("walks and weights are equal:", found[0][1] == found[1][1] == found[2][1])
