"""Time of the store's put and get for 2 M exits of 40 bytes, beside numpy's own files of the same arrays.

python benchmarks/array_store.py [folder]
"""

from __future__ import annotations

import hashlib
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.array_store import ArrayStore

EXITS = 2_000_000
REPEATS = 7


def main() -> None:
    """Print the best and the median time of each, every array being read once in full after it was opened."""
    parent = sys.argv[1] if len(sys.argv) > 1 else None
    arrays = exits()
    key = hashlib.sha256(b"chip, seed, count").hexdigest()
    size = sum(array.nbytes for array in arrays.values())
    with tempfile.TemporaryDirectory(dir=parent) as name:
        folder = Path(name)
        store = ArrayStore(folder / "exits")
        store.put(key, arrays, {"chip": "benchmark"})
        store.get(key)
        np.savez(folder / "exits.npz", **arrays)  # type: ignore[arg-type]  # its stub takes the names for options
        row("put (hash, fsync, rename)", lambda: store.put(key, arrays, {"chip": "benchmark"}))
        row("first get in a process (hash)", lambda: ArrayStore(folder / "exits").get(key))
        row("later get", lambda: store.get(key))
        row("later get, and sum every array", lambda: total(store.get(key) or {}))
        row("numpy.savez, no fsync", lambda: np.savez(folder / "exits.npz", **arrays))  # type: ignore[arg-type]
        row("numpy.load of it, and sum", lambda: total(dict(np.load(folder / "exits.npz"))))
        row("SHA-256 alone", lambda: [hashlib.sha256(array.data).digest() for array in arrays.values()])
        print(f"{EXITS:,} exits, {size / 1e6:.0f} MB of arrays, median and best of {REPEATS}")


def exits() -> dict[str, NDArray[Any]]:
    """Arrays as a worker stores them, 40 bytes an exit."""
    rng = np.random.default_rng(1)
    return {
        "position_um": rng.random((EXITS, 3), np.float32),
        "direction": rng.random((EXITS, 3), np.float32),
        "weight": rng.random(EXITS, np.float32),
        "path_um": rng.random(EXITS, np.float32),
        "bottom_hits": rng.integers(0, 1000, EXITS, np.uint32),
        "top_hits": rng.integers(0, 1000, EXITS, np.uint32),
    }


def total(arrays: dict[str, NDArray[Any]]) -> float:
    """A sum that touches every page."""
    return float(sum(array.sum(dtype=float) for array in arrays.values()))


def row(what: str, work: Callable[[], object]) -> None:
    """A line of the table."""
    times_s = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times_s.append(time.perf_counter() - start)
    print(f"{what:<36} {np.median(times_s) * 1e3:9.2f} ms {min(times_s) * 1e3:9.2f} ms")


if __name__ == "__main__":
    main()
