"""What going on with a killed run costs: until its first new step, with its checkpoint and with its journal alone.

    python benchmarks/resume.py [--steps 3000]

Workers answer at once, everything else is real. The journal is read back and verified by the controller, the designer
is restored or walks all steps again.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from agent.checkpoints import FOLDER
from benchmarks.processes import Processes, table
from luxloop.errors import LuxloopError
from luxloop.journal.reader import RunJournal
from luxloop.settings import as_environment

PRETEND = "tests/pretend_worker.py"
NAME = "ddqn-paper"


def main() -> None:
    """Kill, resume twice, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=3000)
    steps = parser.parse_args().steps
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    rows = []
    with Processes((PRETEND, "film"), (PRETEND, "ray")) as processes:
        settings = processes.settings
        argv = [sys.executable, "-m", "luxloop", "campaign"]
        environment = as_environment(settings)
        process = subprocess.Popen(
            [*argv, "run", "--no-local", "--id", "killed", "--designer", NAME, "--evaluations", "1000000", "--quiet"],
            env=environment, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        folder = settings.runs_dir / "killed"
        while count(folder) < steps:
            time.sleep(0.5)
        process.kill()
        process.wait()
        for label, keep in (("checkpoint", True), ("journal alone", False)):
            if not keep:
                shutil.rmtree(folder / FOLDER)
            before = count(folder)
            began_s = time.monotonic()
            process = subprocess.Popen(
                [*argv, "resume", "killed", "--no-local", "--quiet"], env=environment, stdout=subprocess.DEVNULL
            )
            while count(folder, last=True) <= before:
                time.sleep(0.05)
            took_s = time.monotonic() - began_s
            process.kill()
            process.wait()
            rows.append([label, f"{before:,}", f"{took_s:.1f}", f"{1e3 * took_s / before:.2f}"])
    table("from the command to the first new step", rows, ("by", "steps on record", "s", "ms a step"))


def count(folder: Path, last: bool = False) -> int:
    """Steps on record; with `last` by the newest segment alone, which is read often."""
    try:
        journal = RunJournal(folder)
        if last:
            found = journal.segments[-1].last("/step", 1)
            return found[-1].sequence + 1 if found else 0
        return sum(1 for _ in journal.records("/step"))
    except LuxloopError:
        return 0


if __name__ == "__main__":
    main()
