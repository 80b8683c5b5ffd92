"""The S_b3 unit cell by Mitsuba 3: mean, cut, histories/s and the time to 1 % per bin, beside the reference values.

    python benchmarks/mitsuba_cell.py [--histories 300000] [--path-samples 16000000] [--threads 2] [--json]

Case A: Lambertian emission from the chip's top face. Case B: isotropic emission in the chip's volume. Clear chip
without DBR, its bottom in optical contact with the substrate. `particles` is a Dr.Jit loop of the same physics with
Mitsuba's intersections, `path` Mitsuba's own integrator with the substrate's lobe as a BSDF (case A only: from inside
a dielectric it finds no light but by chance). Errors come from the spread between batches.

Optional: needs `pip install mitsuba` and a libLLVM of version 19 or newer. Mitsuba may live in an environment of its
own, named by LUXLOOP_MITSUBA_PYTHON; a libLLVM in an unusual place is named by DRJIT_LIBLLVM_PATH.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.processes import table

OLDEST_LLVM = 19  # with 15 the loop ends in "Cannot select fmaximum" and an abort
LIBRARY_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
)
INSTALL = (
    f"pip install mitsuba (or LUXLOOP_MITSUBA_PYTHON=python with it) and libLLVM >= {OLDEST_LLVM}, "
    "on Debian apt install libllvm19 (or DRJIT_LIBLLVM_PATH=file)"
)
CUT_BINS = 16  # bins per pitch of the reference cuts

Maps = NDArray[np.float64]


@dataclass(frozen=True)
class Asked:
    """One run of Mitsuba: what is traced, how much of it. The defaults are S_b3 without DBR."""

    code: str = "particles"
    case: str = "A"
    D_um: float = 180.0
    W_um: float = 28.0
    S_um: float = 500.0
    T_um: float = 35.0
    n_gan: float = 2.4869
    sigma_deg: float = 5.0
    substrate_reflectance: float = 0.97
    receiver_reflectance: float = 0.35
    histories: int = 300_000
    segment_limit: int = 1_000_000
    bins: int = 64
    batches: int = 32
    lanes: int = 1024
    threads: int = 2
    seed: int = 5


class MitsubaError(RuntimeError):
    """Mitsuba's process ended without a result."""


def libllvm(folders: Iterable[str] = LIBRARY_FOLDERS) -> Path | None:
    """The newest libLLVM of version 19 or more: the one DRJIT_LIBLLVM_PATH names, else from the usual folders."""
    named = Path(os.environ.get("DRJIT_LIBLLVM_PATH") or ".")
    if named.is_file():  # a name that tells no version is trusted
        return named if llvm_version(named) not in range(1, OLDEST_LLVM) else None
    found = [path for folder in folders for path in Path("/").glob(f"{folder.lstrip('/')}/libLLVM*") if path.exists()]
    fit = [path for path in found if llvm_version(path) >= OLDEST_LLVM]
    return max(fit, key=llvm_version, default=None)


def llvm_version(path: Path) -> int:
    """Major version in the name of a libLLVM or of the file it links to, 0 if there is none."""
    names = re.search(r"libLLVM(?:-|\.so\.|\.)(\d+)", f"{path.name} {path.resolve().name}")
    return int(names[1]) if names else 0


def interpreter() -> str:
    """The Python that has Mitsuba."""
    return os.environ.get("LUXLOOP_MITSUBA_PYTHON", sys.executable)


def missing() -> str | None:
    """What keeps Mitsuba from running here and how to mend it; None if nothing does."""
    if libllvm() is None:
        return f"no libLLVM >= {OLDEST_LLVM} found; {INSTALL}"
    try:
        _child(["-c", "import mitsuba; mitsuba.set_variant('llvm_ad_mono'); print(mitsuba.Float(1) + 1)"], 60.0)
    except MitsubaError as error:
        return f"{error}; {INSTALL}"
    return None


def mitsuba_version() -> str:
    """The version of the Mitsuba that runs."""
    return _child(["-c", "import mitsuba; print(mitsuba.__version__)"], 60.0).strip()


def _child(argv: list[str], limit_s: float) -> str:
    """Standard output of Mitsuba's Python, in a process of its own: an abort there is an error here."""
    python = interpreter()
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": str(libllvm() or "")}
    try:
        done = subprocess.run([python, *argv], env=environment, capture_output=True, text=True, timeout=limit_s)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise MitsubaError(f"{python}: {error}") from error
    if done.returncode:
        last = done.stderr.strip().splitlines()[-3:] or ["nothing on stderr"]
        raise MitsubaError(f"{python} ended with {done.returncode}: {' | '.join(last)}")
    return done.stdout


def run(asked: Asked, limit_s: float = 600.0) -> tuple[Maps, dict[str, Any]]:
    """Maps (batch, row y, column x) of relative illuminance, row 0 at the lowest y, and what else the run tells.

    Raises `MitsubaError` where the process fails, is aborted or takes more than `limit_s`.
    """
    script = Path(__file__).with_name("mitsuba_scene.py")
    told = json.loads(_child([str(script), json.dumps(asdict(asked))], limit_s))
    maps = np.array(told.pop("maps")).reshape(asked.batches, asked.bins, asked.bins)
    return maps, told


def folded(maps: Maps) -> Maps:
    """Maps (..., y, x) averaged over the eight symmetries of the cell."""
    maps = (maps + maps[..., ::-1]) / 2
    maps = (maps + maps[..., ::-1, :]) / 2
    return (maps + maps.swapaxes(-1, -2)) / 2


def coarser(maps: Maps, bins: int) -> Maps:
    """Maps (..., bins, bins) of the means over blocks of finer bins."""
    step = maps.shape[-1] // bins
    blocks: Maps = maps.reshape(*maps.shape[:-2], bins, step, bins, step)
    return np.asarray(blocks.mean((-3, -1)))


def cut(maps: Maps) -> Maps:
    """The row next to y = 0 of 16 x 16 folded bins, chip centre -> cell edge, (..., 8)."""
    half = CUT_BINS // 2
    return folded(coarser(maps, CUT_BINS))[..., half, half:]


def with_error(batches: Maps) -> tuple[Maps, Maps]:
    """Mean over the first axis and its standard error from the spread along it."""
    return batches.mean(0), batches.std(0, ddof=1) / np.sqrt(len(batches))


def seconds_to_one_percent(maps: Maps, seconds: float) -> float:
    """Time after which the rms over the bins (not folded) of the relative standard error would be 1 %."""
    _, error = with_error(maps)
    relative = error / folded(maps.mean(0))
    return float(seconds * np.mean(relative**2) / 0.01**2)


def row(case: str, code: str, maps: Maps, histories: int, seconds: float, **more: float) -> dict[str, Any]:
    """One row of the table, from independent maps (batch, y, x) of relative illuminance; lost and truncated weight
    are per history."""
    mean, mean_se = with_error(maps.mean((1, 2)))
    along, along_se = with_error(cut(maps))
    return {
        "case": case,
        "code": code,
        "histories": histories,
        "mean": float(mean),
        "mean_se": float(mean_se),
        "cut": along.tolist(),
        "cut_se": along_se.tolist(),
        "seconds": seconds,
        "histories_per_s": histories / seconds,
        "seconds_to_one_percent": seconds_to_one_percent(maps, seconds),
        **more,
    }


def mitsuba_row(asked: Asked) -> dict[str, Any]:
    """The row of one run of Mitsuba."""
    maps, told = run(asked)
    return row(asked.case, f"Mitsuba {asked.code}", maps, **told)


def shown(found: dict[str, Any]) -> list[str]:
    """A row as it is printed."""
    return [
        found["case"],
        found["code"],
        f"{found['histories']:,}",
        f"{found['mean']:.4f} +- {found['mean_se']:.4f}",
        f"{found['seconds']:.2f}",
        f"{found['histories_per_s']:,.0f}",
        f"{found['seconds_to_one_percent']:,.0f}",
        f"{found.get('lost', 0.0) + found.get('truncated', 0.0):.1e}",
        " ".join(f"{value:.3f}" for value in found["cut"]),
        f"{max(found['cut_se']):.3f}",
    ]


HEADS = (
    "case",
    "code",
    "histories",
    "mean",
    "s",
    "histories/s",
    "s to 1 % per bin",
    "lost",
    "cut",
    "error of a bin <=",
)


def asked_runs(options: argparse.Namespace) -> list[Asked]:
    """The runs of Mitsuba that the command line asks for."""
    base = Asked(histories=options.histories, threads=options.threads, seed=options.seed)
    particles = [replace(base, case=case) for case in options.cases]
    path = [replace(base, code="path", histories=options.path_samples)] if "A" in options.cases else []
    return path + particles


def main() -> None:
    """Run, print one table, or one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=["A", "B"], default=["A", "B"])
    parser.add_argument("--histories", type=int, default=300_000, help="of each particle loop")
    parser.add_argument("--path-samples", type=int, default=16_000_000, help="of the path integrator")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    reason = missing()
    try:
        rows = [] if reason else [mitsuba_row(asked) for asked in asked_runs(options)]
    except MitsubaError as error:  # it is there but failed: not the same as absent
        sys.exit(f"Mitsuba failed: {error}")
    # Rows of other codes of the same cases, made by `row`, join the list here.
    if options.json:
        print(json.dumps({"mitsuba": None if reason else mitsuba_version(), "missing": reason, "rows": rows}))
        return
    if reason:
        print(f"Mitsuba does not run here: {reason}")
    if rows:
        table(f"S_b3 without DBR, {options.threads} threads", [shown(found) for found in rows], HEADS)


if __name__ == "__main__":
    main()
