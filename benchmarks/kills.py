"""Random kills over campaigns: is anything lost that was acknowledged, does any run end otherwise, how long it takes.

    python benchmarks/kills.py [--kills 100] [--seed 1]

Each kill is SIGKILL of one process of a running set, each kind in turn in a shuffled order, at a random moment of a
campaign; what died is started again 0.4 s later, a designer by `luxloop campaign resume`. Ray workers pretend, 0.1 s
an evaluation. The time to go on is from the kill to the next step that had not been told before.
"""

from __future__ import annotations

import argparse
import random
import tempfile
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.processes import percentile, table
from tests.nemesis.checker import Broken, check_history, check_run, content
from tests.nemesis.history import Seen
from tests.nemesis.lab import MEMBERS, Lab

DESIGNERS = ("ddqn-fast", "pattern", "random")
EVALUATIONS = 120
BEFORE = 4  # steps told before the first kill of a campaign
GAP_S = (0.0, 1.5)
LIMIT_S = 60.0


def victims(kills: int, seed: int) -> list[str]:
    """Whom to kill, each kind as often as the others."""
    whom = [MEMBERS[i % len(MEMBERS)] for i in range(kills)]
    random.Random(seed).shuffle(whom)
    return whom


def told_since(lab: Lab, since_s: float) -> Seen | None:
    """The first telling of a new step after a moment."""
    return next((seen for seen in lab.history.tellings(lab.run) if seen["time_s"] > since_s), None)


def killed(lab: Lab, name: str) -> float | None:
    """Seconds from a kill to the next new step; None where the campaign had none left to tell."""
    since_s = time.time()
    lab.history.note("fault", kind="kill", target=name)
    lab.kill(name)
    end_s = time.monotonic() + LIMIT_S
    while time.monotonic() < end_s:
        found = told_since(lab, since_s)
        if found is not None:
            return float(found["time_s"] - since_s)
        if lab.finished.is_set():
            return None
        time.sleep(0.05)
    raise TimeoutError(f"no step for {LIMIT_S:g} s after the kill of {name}")


@dataclass
class Toll:
    """What the kills did."""

    took_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    hits: Counter[str] = field(default_factory=Counter)
    runs: int = 0
    told: int = 0
    broken: list[Broken] = field(default_factory=list)


def calm(lab: Lab, designer: str) -> str:
    """The content of a run that nobody disturbs."""
    lab.complete(f"calm-{designer}", designer, EVALUATIONS)
    return content(lab.settings.runs_dir / lab.run)


def harassed(lab: Lab, designer: str, whom: list[str], rng: random.Random, toll: Toll) -> None:
    """A campaign during which some of `whom` are killed, which are then taken off the list."""
    lab.begin(f"killed-{toll.runs}-{designer}", designer, EVALUATIONS)
    toll.runs += 1
    while lab.told() < BEFORE and not lab.finished.is_set():
        time.sleep(0.05)
    while whom and not lab.finished.wait(rng.uniform(*GAP_S)):
        victim = whom.pop()
        toll.hits[victim] += 1
        spent_s = killed(lab, victim)
        if spent_s is not None:
            toll.took_s[victim].append(spent_s)
    if not lab.finished.wait(LIMIT_S):
        raise TimeoutError(f"{lab.run} did not end")
    toll.told += lab.told()


def tell(toll: Toll) -> None:
    """Print the tables."""
    rows = [
        [who, toll.hits[who], f"{percentile(spent, 50):.2f} s", f"{max(spent):.2f} s"]
        for who in MEMBERS
        if (spent := toll.took_s[who])
    ]
    table("kills: from the kill to the next new step", rows, ["killed", "times", "p50", "most"])
    found = Counter(one.invariant for one in toll.broken)
    results: list[list[object]] = [
        ["kills, over campaigns", f"{toll.hits.total()}, {toll.runs}"],
        ["steps acknowledged", f"{toll.told:,}"],
        ["acknowledged steps lost", found.pop("what was told is on record", 0)],
        ["runs whose final content is not the clean run's", found.pop("the same content as a clean run", 0)],
        ["other invariants broken", found.total()],
    ]
    table("what they did", results, ["what", "found"])
    for one in toll.broken:
        print(f"  {one.invariant}: {one.what}")


def main(kills: int, seed: int) -> None:
    """Kill, check, print."""
    rng, whom, toll = random.Random(f"when {seed}"), victims(kills, seed), Toll()
    with tempfile.TemporaryDirectory() as name, Lab(Path(name)) as lab:
        clean = {designer: calm(lab, designer) for designer in DESIGNERS}
        while whom:
            designer = DESIGNERS[toll.runs % len(DESIGNERS)]
            harassed(lab, designer, whom, rng, toll)
            toll.broken += check_run(lab.settings.runs_dir / lab.run, lab.history.read(), clean[designer])
        lab.history.note("looked")
        toll.broken += check_history(lab.history.read(), quiet_s=5.0)
    tell(toll)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    main(chosen.kills, chosen.seed)
