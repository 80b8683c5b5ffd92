"""What it costs to start each process: CPU time and time by the clock until it can work, kernels compiled before.

    python benchmarks/process_starts.py

Each row is the least of several fresh processes. The designer is ready after its first update; beside it stands a
single step by torch's own class of Adam and its own switch for deterministic kernels, which import torch's compiler.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time

from benchmarks.processes import table

LEARN = "from agent.ddqn import PRESETS, Learner\nlearner = Learner(PRESETS['fast'], 40, seed=1)\n"
PEER = """
import torch
torch.set_num_threads(1)
torch.use_deterministic_algorithms(True)
weights = [torch.zeros(64, 64, requires_grad=True)]
adam = torch.optim.Adam(weights, fused=True)
weights[0].square().sum().backward()
adam.step()
"""
FILMS = """
import containers.thin_film.worker
from containers.thin_film import warm_up
warm_up()
"""
RAYS = """
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.worker import warm_up
warm_up(ExitSource())
"""
PROCESSES = {
    "python alone": "pass",
    "a command's help (luxloop simulate --help)": "from luxloop.cli import app\napp(('simulate',))",
    "router, controller: their imports": "import luxloop.bus.zenoh_bus, env_controller.dispatcher",
    "thin-film worker, warm": FILMS,
    "ray-tracing worker, warm": RAYS,
    "torch alone": "import torch",
    "designer, after its first update": LEARN + "learner.update()",
    "a step of torch.optim.Adam": PEER,
}
"""What each process does, by name."""


def cost(code: str) -> tuple[float, float]:
    """CPU seconds and seconds of a fresh process."""
    began_s = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", code])
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"it failed:\n{code}")
    return used.ru_utime + used.ru_stime, time.perf_counter() - began_s


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=5, help="fresh processes a row")
    times = parser.parse_args().times
    rows = []
    for name, code in PROCESSES.items():
        cost(code)  # files are read from the disk once
        cpu, wall = (min(values) for values in zip(*(cost(code) for _ in range(times)), strict=True))
        rows.append([name, f"{cpu:.2f}", f"{wall:.2f}"])
    table("a process until it can work", rows, ["process", "CPU s", "s"])


if __name__ == "__main__":
    main()
