"""No-op tasks per second with two workers, and the time one task takes, beside dask.distributed where installed.

    python benchmarks/dispatch_throughput.py [--tasks 4000]

Each task goes client -> controller -> worker -> controller -> client over the router as a process of its own; a task
is answered when its result is back at the client. dask: two worker processes of one thread, the same in-flight count.
"""

from __future__ import annotations

import argparse
import time

from benchmarks.processes import SLEEPY, Processes, percentile, table
from luxloop import __version__
from luxloop.client import Answer
from luxloop.messages import Task


def noop(number: int, run: int) -> Task:
    """A task that does nothing; numbers make it a new one."""
    return Task(kind="sleepy", inputs={"what": "nothing", "number": number, "run": run}, version=__version__)


def spread(took_ms: list[float]) -> str:
    """Median and 99th percentile."""
    return f"p50 {percentile(took_ms, 50):.2f} p99 {percentile(took_ms, 99):.2f} ms"


def ours(tasks: int) -> list[list[object]]:
    """Rows of the table: throughput by lanes, latency with one."""
    rows: list[list[object]] = []
    with Processes((SLEEPY,), (SLEEPY,)) as processes:
        client = processes.client
        for run, lanes in enumerate((2, 4, 8, 16)):
            begin = time.perf_counter()
            answers = client.map((noop(i, run) for i in range(tasks)), lanes=lanes)
            done = sum(isinstance(answer, Answer) for _, answer in answers)
            rows.append([f"luxloop, {lanes} in flight", f"{done / (time.perf_counter() - begin):.0f}/s", ""])
        took = []
        for i in range(500):
            begin = time.perf_counter()
            client.run(noop(i, 99))
            took.append(1e3 * (time.perf_counter() - begin))
        rows.append(["luxloop, one at a time", "", spread(took)])
    return rows


def dask(tasks: int) -> list[list[object]]:
    """The same with dask.distributed."""
    try:
        from distributed import Client, LocalCluster, as_completed
    except ImportError:
        return [["dask.distributed", "not installed", "pip install distributed"]]
    cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with cluster, Client(cluster) as client:
        client.submit(lambda x: x, -1).result()
        begin = time.perf_counter()
        waiting = as_completed([client.submit(lambda x: x, i, pure=False) for i in range(8)])
        done = 0
        for _ in waiting:
            done += 1
            if done + 7 < tasks:
                waiting.add(client.submit(lambda x: x, done, pure=False))
        rate = done / (time.perf_counter() - begin)
        took = []
        for i in range(200):
            begin = time.perf_counter()
            client.submit(lambda x: x, i, pure=False).result()
            took.append(1e3 * (time.perf_counter() - begin))
    return [
        ["dask.distributed, 8 in flight", f"{rate:.0f}/s", ""],
        ["dask.distributed, one at a time", "", spread(took)],
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--tasks", type=int, default=4000)
    count = parser.parse_args().tasks
    table("no-op tasks, two workers", ours(count) + dask(count), ["what", "throughput", "latency"])
