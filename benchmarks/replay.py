"""What a replay of a finished campaign costs, level by level; and whether level 4 gives equal bits however it is run.

    python benchmarks/replay.py [--evaluations 60]

A campaign with real physics (Monte Carlo at 1 point, `ddqn-fast`, 4 lanes, finalists) is recorded, then replayed by
`luxloop audit replay` as anybody would call it: times are those of whole commands. Level 4 is done by one worker of 1
and of 2 threads and by two workers, all with empty caches but for the compiled kernels, and with new seeds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from agent.config import Campaign, Stop
from agent.launch import launch
from benchmarks.processes import Processes, table
from luxloop.settings import as_environment

FILM = ("-m", "luxloop", "serve", "thin-film", "--quiet")
RAY = ("-m", "luxloop", "serve", "ray-tracing", "--quiet")


def replayed(folder: Path, level: int, environment: dict[str, str], *options: str) -> tuple[list[object], Any]:
    """A row of the table, and the document."""
    began_s = time.perf_counter()
    argv = [
        sys.executable,
        "-m",
        "luxloop",
        "audit",
        "replay",
        str(folder),
        "--level",
        str(level),
        "--json",
        *options,
    ]
    done = subprocess.run(argv, env=environment, capture_output=True, text=True)
    wall_s = time.perf_counter() - began_s
    assert done.stdout, done.stderr
    document = json.loads(done.stdout)
    return [f"{wall_s:.1f}", done.returncode, *document["counts"].values()], document


def main(evaluations: int) -> None:
    """Record a campaign, replay it, print the tables."""
    rows: list[list[object]] = []
    with Processes(FILM, RAY) as recording:
        campaign = Campaign(designer="ddqn-fast", stop=Stop(evaluations=evaluations))
        began_s = time.perf_counter()
        done = launch(recording.settings, campaign, "paper", "run", local=False)
        took_s = time.perf_counter() - began_s
        folder, alone = Path(done.ended.folder), as_environment(recording.settings)
        steps, size = done.found.progress.steps, sum(path.stat().st_size for path in folder.glob("*.mcap"))
        print(f"recorded: {evaluations} designs in {steps} steps and finals, {took_s:.1f} s, {size / 1e6:.2f} MB")
        for level, name in ((1, "verify"), (2, "re-derive"), (3, "re-decide")):
            rows.append([f"{level} {name}", *replayed(folder, level, alone)[0]])
        for workers, threads in ((1, 1), (1, 2), (2, 1)):
            os.environ["LUXLOOP_THREADS"] = str(threads)
            with Processes(FILM, *([RAY] * workers)) as again:
                asked = as_environment(again.settings)
                name = f"4 re-execute, {workers} worker(s) of {threads} thread(s)"
                rows.append([name, *replayed(folder, 4, asked, "--no-local")[0]])
        with Processes(FILM, RAY, RAY) as again:
            row, fresh = replayed(folder, 4, as_environment(again.settings), "--no-local", "--new-seed")
            rows.append(["4 with new seeds, 2 workers of 1 thread", *row])
    heads = ("level", "s", "exit", "identical", "within tolerance", "differs", "not comparable")
    table("replays of that campaign", rows, heads)
    scores = [[what, one["count"], *(f"{one[name]:.2f}" for name in ("chi2_per_count", "chi2_error", "largest"))]
              for what, one in fresh["z"].items()]  # fmt: skip
    table("new seeds", scores, ("z of", "compared", "chi2/n", "+-, if independent", "largest |z|"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evaluations", type=int, default=60)
    chosen = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    main(chosen.evaluations)
