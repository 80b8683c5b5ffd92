"""A soak: python -m tests.nemesis --seconds 600 --seed 1 [--spare controller]"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.nemesis.faults import CANDIDATES
from tests.nemesis.lab import MEMBERS, SERVERS
from tests.nemesis.storm import Weather, storm


def lines(weather: Weather) -> Iterator[str]:
    """What a storm was, for people."""
    faults = ", ".join(f"{weather.faults[kind]} {kind}" for kind in CANDIDATES if weather.faults[kind])
    yield f"seed                {weather.seed}, {weather.seconds:.0f} s"
    yield f"faults              {weather.faults.total()}: {faults}"
    yield from (f"not permitted       {why}" for why in weather.not_permitted)
    yield f"campaigns finished  {weather.campaigns}, with {weather.steps:,} steps told"
    yield f"tasks accepted      {weather.tasks:,} in {weather.epochs} epochs; {weather.attempts:,} handed out"
    yield f"late results fenced {weather.fenced}"
    yield f"invariants broken   {len(weather.broken)}"
    yield from (f"  {one.invariant}: {one.what}" for one in weather.broken)
    if len(weather.resident_mb) == 3:
        first, most, last = weather.resident_mb
        yield "resident memory, MB    start     most      end   age s of that process"
        for name in SERVERS:
            figures = "".join(f"{seen.get(name, 0.0):9.1f}" for seen in (first, most, last))
            yield f"  {name:17}{figures}{weather.ages_s.get(name, 0.0):9.0f}"


def main() -> int:
    """Blow, print; exit code 1 where an invariant is broken."""
    parser = argparse.ArgumentParser(prog="python -m tests.nemesis", description="Faults against a real set.")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--spare", action="append", default=[], choices=MEMBERS, help="never hit by kill, stop, ...")
    parser.add_argument("--keep", type=Path, help="an empty folder for journals, logs and the history")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="nemesis-") as name:
        folder = chosen.keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        told = sys.stderr.isatty()
        weather = storm(
            folder, chosen.seconds, chosen.seed, spared=tuple(chosen.spare),
            tell=lambda text: told and sys.stderr.write(f"{text}\n"),
        )  # fmt: skip
        sys.stdout.write("\n".join(lines(weather)) + "\n")
    return 1 if weather.broken else 0


if __name__ == "__main__":
    sys.exit(main())
