"""Time of the film database's get and put for a 600 kB table, beside a plain file of the same bytes.

python benchmarks/film_database.py
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from containers.thin_film.database import open_database

TABLE_BYTES = 600_000
TABLES = 300


def main() -> None:
    """Print p50 and p99 of put and get, with SHA-256 checked on each read, and of a bare file."""
    rng = np.random.default_rng(1)
    tables = [rng.bytes(TABLE_BYTES) for _ in range(TABLES)]
    keys = [hashlib.sha256(f"request {k}".encode()).hexdigest() for k in range(TABLES)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with open_database(folder / "films.sqlite") as database:
            rows = {
                "database put": timed(lambda k: database.put(keys[k], tables[k])),
                "database get": timed(lambda k: database.get(keys[k])),
                "database get, absent": timed(lambda k: database.get(keys[k][::-1])),
            }
        rows["file write, no fsync"] = timed(lambda k: (folder / keys[k]).write_bytes(tables[k]))
        rows["file read, no hash"] = timed(lambda k: (folder / keys[k]).read_bytes())
        rows["SHA-256 alone"] = timed(lambda k: hashlib.sha256(tables[k]).digest())
    print(f"{TABLES} tables of {TABLE_BYTES} bytes {'p50 ms':>18} {'p99 ms':>8}")
    for what, times_s in rows.items():
        p50, p99 = np.percentile(np.array(times_s) * 1e3, [50, 99])
        print(f"{what:<36} {p50:10.3f} {p99:8.3f}")


def timed(work: Callable[[int], object]) -> list[float]:
    """Seconds of each call of `work` with 0, 1, ..."""
    times_s = []
    for k in range(TABLES):
        start = time.perf_counter()
        work(k)
        times_s.append(time.perf_counter() - start)
    return times_s


if __name__ == "__main__":
    main()
