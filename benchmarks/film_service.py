"""PC2 as a service: cold start, memory, and the time of a table request through the controller.

    python benchmarks/film_service.py [--cold]

Cold start: from the start of the worker process to the first reply at the client, router and controller running,
kernels compiled before; with `--cold` also with an empty kernel cache. Memory: after the first table.
"""

from __future__ import annotations

import argparse
import os
import time

from benchmarks.processes import THIN_FILM, Processes, memory_mb, percentile, table
from luxloop.film import FilmTableRequest
from luxloop.model import Environment


def request(number: int) -> FilmTableRequest:
    """A film that was not asked for before: the layer thickness makes it new."""
    return FilmTableRequest(environment=Environment(gan_layer_nm=45.0 + 1e-4 * number), dbr_pairs=6.5)


def first_reply_s(processes: Processes) -> float:
    """Seconds from the start of a worker to its first table at the client."""
    begin = time.monotonic()
    processes.workers.append(processes.start(*THIN_FILM))
    processes.client.run(request(0))
    return time.monotonic() - begin


def request_ms(processes: Processes, requests: list[FilmTableRequest]) -> list[float]:
    """Milliseconds of each request, one after the other."""
    took = []
    for one in requests:
        begin = time.perf_counter()
        processes.client.run(one)
        took.append(1e3 * (time.perf_counter() - begin))
    return took


def spread(took_ms: list[float]) -> str:
    """Median and 99th percentile."""
    return f"p50 {percentile(took_ms, 50):.2f} ms, p99 {percentile(took_ms, 99):.2f} ms"


def main(cold: bool) -> None:
    """Print the table."""
    rows: list[list[object]] = []
    with Processes() as processes:
        first_reply_s(processes)  # compiles where that has not been done
    starts = []
    for _ in range(3):
        with Processes() as processes:
            starts.append(first_reply_s(processes))
    rows.append(["worker start to first reply, kernels compiled", f"{percentile(starts, 50):.2f} s", "<= 3 s"])
    if cold:
        kept = os.environ.get("LUXLOOP_KERNELS")
        with Processes() as processes:
            os.environ["LUXLOOP_KERNELS"] = str(processes.settings.cache_dir / "no kernels yet")
            rows.append(["the same, empty kernel cache", f"{first_reply_s(processes):.2f} s", "-"])
        os.environ.pop("LUXLOOP_KERNELS") if kept is None else os.environ.update(LUXLOOP_KERNELS=kept)
    with Processes(THIN_FILM) as processes:
        resident, anonymous = memory_mb(processes.workers[0].pid)
        rows.append(["idle worker memory, before its first task", f"{resident:.0f} MB", "<= 150 MB"])
        new = request_ms(processes, [request(n) for n in range(400)])
        rows.append(["table request, computed and stored", spread(new), "p50 <= 3 ms"])
        coarse = [request(n).model_copy(update={"effects": ()}) for n in range(400)]
        rows.append(["the same requests again (controller's results)", spread(request_ms(processes, coarse)), "-"])
        time.sleep(1.5)
        resident, anonymous = memory_mb(processes.workers[0].pid)
        rows.append(
            ["idle worker memory, after 400 tables", f"{resident:.0f} MB ({anonymous:.0f} MB its own)", "<= 150 MB"]
        )
        rows.append(["controller memory, after 400 tables", f"{memory_mb(processes.controller.pid)[0]:.0f} MB", "-"])
        rows.append(["router memory", f"{memory_mb(processes.router.pid)[0]:.0f} MB", "-"])
    table("the thin-film worker as a service", rows, ["what", "measured", "target"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--cold", action="store_true")
    main(parser.parse_args().cold)
