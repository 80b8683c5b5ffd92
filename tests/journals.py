"""What the tests of the journal share: records of a small run, and a journal that is written step by step."""

from __future__ import annotations

import resource
import sys
import threading
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from env_controller.notes import note_records
from luxloop.campaign import AgentRecord, Note, Step
from luxloop.design import Design
from luxloop.errors import LuxloopError
from luxloop.journal.journal import Journal
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import (
    Record,
    map_record,
    reply_record,
    request_record,
    step_record,
)
from luxloop.messages import Outcome, Task

RUN = "a-run"
DESIGN = Design(distance_um=180.0, width_um=28.0, spacing_um=500.0, thickness_um=35.0, dbr_pairs=6.5)
METADATA = {"run": {"run": RUN, "kind": "campaign"}, "environment": {"python": "3"}}
ATTACHMENTS = {"model.toml": b"name = 'clear chip'\n", "empty": b""}
START_NS = 1_790_000_000_000_000_000


def a_step(number: int, uniformity: float = 0.5, **more: object) -> Step:
    """A step of lane 0."""
    figures = {"mean_illuminance_lx": {"value": 109_814.25, "standard_error": None}}
    state = (1.0, -0.5, 0.0, 0.25, -1.0)
    plain = {"run": RUN, "lane": 0, "number": number, "design": DESIGN, "state": state, "uniformity": uniformity}
    return Step.model_validate({**plain, "reward": -0.125, "figures": figures, **more})


def a_map(number: int) -> NDArray[np.float32]:
    """A map (y, x), a different one for each number."""
    return np.random.default_rng(number).random((5, 7), np.float32) * np.float32(1e5)


def records_of_step(number: int, uniformity: float = 0.5) -> list[Record]:
    """All that is written of one step: request, reply, map, step, learner, a line of text."""
    at_ns = START_NS + number * 1_000_000
    task = Task(kind="ray", inputs={"seed": "9007199254740993", "number": number, "power": 0.1}, version="0.1.0")
    outcome = Outcome(task_id=task.id, result={"uniformity": {"value": uniformity}}, worker="ray-1", compute_s=0.5)
    note = Note(
        run=RUN, designer="ddqn", agent=AgentRecord(lane=0, number=number, q=0.5), log=f"step {number}: µ-LED"
    )
    return [
        request_record(task, number, at_ns),
        reply_record("ray", outcome, {"map_lx": a_map(number)}, number, at_ns + 1),
        map_record(a_map(number), number, at_ns + 2),
        step_record(a_step(number, uniformity), number, at_ns + 3),
        *note_records(note, number, at_ns + 4),
    ]


def put(journal: Journal, records: list[Record]) -> None:
    """Have the records written; returns when they are durable, raises what the journal says otherwise."""
    told: list[BaseException | None] = []
    done = threading.Event()

    def tell(error: BaseException | None) -> None:
        told.append(error)
        done.set()

    journal.put(records, tell)
    assert done.wait(20), "the journal never told"
    if told[0] is not None:
        raise told[0]


def open_journal(folder: Path, **options: int) -> Journal:
    """A journal as the controller opens one."""
    return Journal(folder, METADATA, ATTACHMENTS, **options)


def write_run(folder: Path, steps: int, first: int = 0, finish: bool = True) -> list[Record]:
    """What was written of a run with so many steps, each one committed by itself."""
    journal = open_journal(folder)
    written: list[Record] = []
    for number in range(first, first + steps):
        records = records_of_step(number, uniformity=0.5 + 0.01 * number)
        put(journal, records)
        written += records
    if finish:
        journal.finish()
    journal.close()
    return written


def messages(folder: Path) -> list[Record]:
    """All records of a run, the chain's own excepted."""
    return list(RunJournal(folder).records())


def held_up(journal: Journal) -> threading.Event:
    """The writer's thread is busy with step 0 until the event is set: what is put meanwhile waits."""
    begun, over = threading.Event(), threading.Event()

    def hold(_: LuxloopError | None) -> None:
        begun.set()
        over.wait(20)

    journal.put(records_of_step(0), hold)
    assert begun.wait(20)
    return over


def main() -> None:
    """Write steps into the folder of the first argument until killed, each acknowledged on stdout.

    A second argument limits the file's size: to the writer that is a disk on which a write fails.
    """
    journal = open_journal(Path(sys.argv[1]))
    if len(sys.argv) > 2:
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
    for number in count():
        try:
            put(journal, records_of_step(number))
        except LuxloopError as error:
            say(f"{type(error).__name__} {error}")
            return
        say(str(number))


def say(line: str) -> None:
    """A line on stdout, at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
