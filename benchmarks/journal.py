"""What the journal costs: a step's CPU and wall time, its bytes, and how fast 16,000 steps open; beside plain mcap.

python benchmarks/journal.py [folder] [steps]

A step is request, reply, a 64 x 64 map with 1 % noise, the step itself and what the learner was like. The peer is the
Writer of the mcap package as it comes, fed the same bytes in the same schemas, without flush and without fdatasync:
it loses what is in its memory when it is killed.
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from env_controller.audit.checks import exit_code, verify
from env_controller.notes import note_records
from luxloop.campaign import AgentRecord, Note, Step
from luxloop.design import Design
from luxloop.journal.image import descriptor_set
from luxloop.journal.journal import Journal
from luxloop.journal.reader import RunJournal
from luxloop.journal.schemas import flat_schema
from luxloop.journal.topics import (
    TOPICS,
    Record,
    map_record,
    reply_record,
    request_record,
    step_record,
)
from luxloop.messages import Outcome, Task
from luxloop.words import canonical

STEPS = 16_000
TIMED = 1_000
LANES = 4
START_NS = 1_790_000_000_000_000_000
DESIGN = Design(distance_um=180.0, width_um=28.0, spacing_um=500.0, thickness_um=35.0, dbr_pairs=6.5)
METADATA: dict[str, dict[str, str]] = {"run": {"run": "benchmark"}, "environment": {}}


class Maker:
    """Makes the records of step after step."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(1)
        y, x = np.mgrid[-1:1:64j, -1:1:64j]
        self._map = 1e5 * (1.0 - 0.2 * (x**2 + y**2))
        environment = {f"parameter_{number}": 0.1 * number for number in range(25)}
        self._inputs: dict[str, Any] = {"environment": environment, "design": DESIGN.model_dump(), "seed": "1"}
        self._noise = [self._rng.normal(1.0, 0.01, (64, 64)).astype(np.float32) for _ in range(64)]

    def records(self, number: int) -> list[Record]:
        """All records of a step."""
        at_ns = START_NS + number * 10_000_000
        task = Task(kind="ray", inputs={**self._inputs, "number": number}, version="0.1.0")
        metrics = {f"metric_{n}": {"value": 0.1 * n + number, "standard_error": 0.001} for n in range(12)}
        lx = self._map * self._noise[number % len(self._noise)] * (1.0 + 1e-6 * number)
        outcome = Outcome(task_id=task.id, result={"metrics": metrics}, worker="ray-1", compute_s=0.1)
        step = Step(
            run="benchmark", lane=number % LANES, number=number // LANES, design=DESIGN,
            state=(1.0, -0.5, 0.0, 0.25, -1.0), uniformity=0.8, reward=0.1, task_id=task.id,
            figures={name: metrics[name] for name in ("metric_1", "metric_2", "metric_3")},
        )  # fmt: skip
        learner = AgentRecord(lane=0, number=number, q=0.5, loss=0.01, weights_sha256="0" * 64)
        return [
            request_record(task, number, at_ns),
            reply_record("ray", outcome, {"map_lx": lx}, number, at_ns),
            map_record(lx, number, at_ns),
            step_record(step, number, at_ns),
            *note_records(Note(run="benchmark", designer="ddqn", agent=learner), number, at_ns),
        ]


def main() -> None:
    """Print the tables."""
    parent = sys.argv[1] if len(sys.argv) > 1 else None
    steps = int(sys.argv[2]) if len(sys.argv) > 2 else STEPS
    maker = Maker()
    batches = [maker.records(number) for number in range(TIMED)]
    size = sum(len(entry.data) for entry in batches[0])
    print(f"a step: {len(batches[0])} records, {size:,} bytes, made in {making_us(maker):.0f} us of CPU\n")
    heads = ("CPU us/step", "wall ms/step", "p50 ms", "p99 ms", "bytes/step")
    print(f"{f'writing {TIMED:,} steps':<44}" + "".join(f"{head:>13}" for head in heads))
    with tempfile.TemporaryDirectory(dir=parent) as name:
        folder = Path(name)
        write_row("journal, fdatasync, 1 lane", lambda: through_journal(folder / "1", batches, 1))
        write_row(
            f"journal, fdatasync, {LANES} lanes in groups", lambda: through_journal(folder / "4", batches, LANES)
        )
        write_row("mcap Writer, no flush, no fdatasync", lambda: through_mcap(folder / "plain.mcap", batches))
        sync_row(folder / "probe", size)
        print(f"\nreading {steps:,} steps, written by groups of {LANES}")
        run = folder / "run"
        journal = Journal(run, METADATA, {})
        append(journal, maker, steps)
        read_rows(run, "while it is written")
        journal.finish()
        read_rows(run, "finished")
        path = run / "audit-0001.mcap"
        row("  the mcap package's reader: last 10 steps", lambda: last_by_mcap(path, steps))
        row("audit verify, all levels of its chain", lambda: exit_code(verify(run, None, None)))
        print(f"{path.stat().st_size / 1e6:.1f} MB")


def making_us(maker: Maker) -> float:
    """CPU time to make the records of a step, before they are handed over."""
    start_s = time.process_time()
    for number in range(200):
        maker.records(number)
    return (time.process_time() - start_s) / 200 * 1e6


def through_journal(folder: Path, batches: list[list[Record]], lanes: int) -> tuple[list[float], int]:
    """Latency of each step, s; bytes. Each lane waits for its acknowledgement before its next step."""
    journal = Journal(folder, METADATA, {})
    latencies_s: list[float] = []

    def lane(first: int) -> None:
        for batch in batches[first::lanes]:
            done = threading.Event()
            start_s = time.perf_counter()
            journal.put(batch, lambda _, done=done: done.set())  # type: ignore[misc]
            done.wait()
            latencies_s.append(time.perf_counter() - start_s)

    threads = [threading.Thread(target=lane, args=(first,)) for first in range(lanes)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    journal.finish()
    return latencies_s, (folder / "audit-0001.mcap").stat().st_size


def through_mcap(path: Path, batches: list[list[Record]]) -> tuple[list[float], int]:
    """The same records by the plain writer."""
    latencies_s = []
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for batch in batches:
            start_s = time.perf_counter()
            for entry in batch:
                if entry.topic not in channels:
                    channels[entry.topic] = registered(writer, entry.topic)
                at_ns = entry.log_time_ns
                writer.add_message(channels[entry.topic], at_ns, entry.data, at_ns, entry.sequence)
            latencies_s.append(time.perf_counter() - start_s)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves its return type open
    return latencies_s, path.stat().st_size


def registered(writer: Writer, topic: str) -> int:
    """The number of a new channel."""
    kind = TOPICS[topic]
    if isinstance(kind, str):
        return writer.register_channel(
            topic, "protobuf", writer.register_schema(kind, "protobuf", descriptor_set(kind))
        )
    schema = writer.register_schema(kind.__name__, "jsonschema", canonical(flat_schema(kind)))
    return writer.register_channel(topic, "json", schema)


def sync_row(path: Path, size: int) -> None:
    """What the disk itself takes for as many bytes."""
    times_s = []
    with path.open("wb", buffering=0) as file:
        for _ in range(200):
            start_s = time.perf_counter()
            file.write(bytes(size))
            os.fdatasync(file.fileno())
            times_s.append(time.perf_counter() - start_s)
    line("write and fdatasync of as many bytes alone", float("nan"), float(np.mean(times_s)), times_s, size)


def line(what: str, cpu_s: float, wall_s: float, latencies_s: list[float], size_bytes: float) -> None:
    """A line of the table of writers, all for one step."""
    p50, p99 = np.percentile(latencies_s, [50, 99]) * 1e3
    print(f"{what:<44}{cpu_s * 1e6:>13.0f}{wall_s * 1e3:>13.3f}{p50:>13.2f}{p99:>13.2f}{size_bytes:>13,.0f}")


def append(journal: Journal, maker: Maker, steps: int) -> None:
    """Write steps in groups, as lanes do."""
    for first in range(0, steps, LANES):
        done = threading.Event()
        group = [maker.records(number) for number in range(first, min(first + LANES, steps))]
        for batch in group[:-1]:
            journal.put(batch, lambda _: None)
        journal.put(group[-1], lambda _, done=done: done.set())  # type: ignore[misc]
        done.wait()


def read_rows(run: Path, state: str) -> None:
    """How long a reader takes, each time from a fresh start."""
    print(f"{state}:")
    row("  open, and read the facts", lambda: RunJournal(run).metadata("run"))
    row("  open, and read the last 10 steps", lambda: [entry.value for entry in RunJournal(run).last("/step", 10)])
    row("  open, and read all steps", lambda: sum(1 for _ in RunJournal(run).steps()))
    row(
        "  open, and read all maps",
        lambda: sum(entry.value.size > 0 for entry in RunJournal(run).records("/map/sim")),
    )


def last_by_mcap(path: Path, steps: int) -> int:
    """The last 10 steps by the package's own reader, by their time."""
    with path.open("rb") as file:
        after_ns = START_NS + (steps - 10) * 10_000_000
        return sum(1 for _ in make_reader(file).iter_messages("/step", starting_at=after_ns))


def write_row(what: str, work: Callable[[], tuple[list[float], int]]) -> None:
    """A line of the table of writers."""
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    latencies_s, size = work()
    cpu_s, wall_s = time.process_time() - cpu_s, time.perf_counter() - wall_s
    count = len(latencies_s)
    line(what, cpu_s / count, wall_s / count, latencies_s, size / count)


def row(what: str, work: Callable[[], object]) -> None:
    """A line of the table of readers: the best of three."""
    times_s = []
    for _ in range(3):
        start_s = time.perf_counter()
        work()
        times_s.append(time.perf_counter() - start_s)
    print(f"{what:<44}{min(times_s) * 1e3:>12.1f} ms")


if __name__ == "__main__":
    main()
