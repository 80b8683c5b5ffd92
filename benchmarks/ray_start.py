"""Time to the first result of the ray tracer in a fresh process, kernels compiled before or not, and its memory.

    python benchmarks/ray_start.py

Every row is a process of its own: `empty folder` compiles all kernels (LUXLOOP_KERNELS names a new folder), `compiled
before` finds them there. Times from the start of the process; the first result is U of S_b3 from one block of each
group. Memory is resident at the end, and the most there was: after U, and after a result with a map of 256 x 256
points of light whose bins are 256 x 256 for each of the 32 groups, not folded.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.processes import table

MAP = 256
WIDE = (100.0, 30.0, 700.0, 20.0, 5.5)
"""A design whose modes need 256 bins a pitch."""


def child(way: str, began_s: float) -> dict[str, float]:
    """What a fresh process finds; its own times from the start of the process."""
    from benchmarks import cells  # the import is part of what is measured
    from containers.ray_tracing.exits import make_exits
    from containers.ray_tracing.monte_carlo import BLOCK
    from containers.ray_tracing.outcome import outcome, solved
    from luxloop.design import Design

    found = {"imported_s": time.time() - began_s}
    design = Design.from_vector(WIDE) if way == "map" else cells.DESIGNS["S_b3"]
    scene = cells.scene_for(cells.CLEAR, design)
    if way == "stored exits":
        cells.uniformity_of(scene, cells.landing(scene, make_exits(scene, 1, BLOCK), 1).run_to(BLOCK))
    elif way == "map":
        tally = cells.unfolded(cells.full_walk(scene, 1)).run_to(16 * BLOCK)
        assert tally.bins.shape[-2:] == (MAP, MAP)
        outcome(solved(scene, tally), cells.CLEAR, MAP)
    else:
        cells.uniformity_of(scene, cells.full_walk(scene, 1).run_to(BLOCK))
    found["first_result_s"] = time.time() - began_s
    status = Path("/proc/self/status").read_text()
    kb = {line.split(":")[0]: line.split()[1] for line in status.splitlines() if line.startswith("Vm")}
    return found | {"resident_mb": int(kb["VmRSS"]) / 1e3, "most_mb": int(kb["VmHWM"]) / 1e3}


def fresh(way: str, kernels: str) -> dict[str, float]:
    """The same from a new process with its kernels in a folder."""
    environment = {**os.environ, "LUXLOOP_KERNELS": kernels}
    argv = [sys.executable, __file__, "--child", way, str(time.time())]
    done = subprocess.run(argv, env=environment, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--child", nargs=2, metavar=("WAY", "BEGAN"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(child(options.child[0], float(options.child[1]))))
        return
    rows = []
    with tempfile.TemporaryDirectory() as kernels:
        for way, state in (
            ("full walk", "empty folder"), ("full walk", "compiled before"), ("stored exits", "its kernels not yet"),
            ("stored exits", "compiled before"), ("map", "compiled before"),
        ):  # fmt: skip
            found = fresh(way, kernels)
            size_mb = sum(path.stat().st_size for path in Path(kernels).rglob("*") if path.is_file()) / 1e6
            times = (f"{found['imported_s']:.2f}", f"{found['first_result_s']:.2f}")
            rows.append(
                (way, state, *times, f"{found['resident_mb']:.0f}", f"{found['most_mb']:.0f}", f"{size_mb:.1f}")
            )
    heads = ("way", "kernels", "imported, s", "first result, s", "resident, MB", "most, MB", "folder, MB")
    table(f"fresh processes, load {os.getloadavg()[0]:.1f}", rows, heads)


if __name__ == "__main__":
    main()
