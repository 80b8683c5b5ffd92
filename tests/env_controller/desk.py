"""A controller that tests ask message by message: its desk, questions, and what a run has on record."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from env_controller.dispatcher import Dispatcher
from luxloop import __version__
from luxloop.bus import Asked
from luxloop.bus.frame import decode, encode
from luxloop.bus.keys import at
from luxloop.campaign import Action, Begin, End, Fidelity, Plan, Step
from luxloop.design import Bounds, Design
from luxloop.failure import Failure
from luxloop.journal import reader
from luxloop.journal.topics import Record
from luxloop.messages import Describe, Done, Hello, Lease, Outcome, Pull
from luxloop.model import Environment
from luxloop.settings import Settings
from luxloop.words import Words
from tests.local_bus import LocalBus, LocalRouter

DESIGN = Design.from_vector((150.0, 30.0, 500.0, 20.0, 5.5))
WAIT_S = 5.0


def plan(run: str = "one", **changes: Any) -> Plan:
    """A campaign on the bounds of Table 3."""
    given: dict[str, Any] = {
        "run": run, "environment": Environment(), "bounds": Bounds.preset("paper-table3"), "lanes": 2,
        "walk": Fidelity(target_error_points=1.0), "final": Fidelity(target_error_points=0.3),
    }  # fmt: skip
    return Plan(**(given | changes))


class Question:
    """A question that was put, and what was answered; None while it is held."""

    def __init__(self, key: str, frame: bytes) -> None:
        self.frames: list[bytes] = []
        self.asked = Asked(key, frame, self.frames.append, lambda: None)

    @property
    def message(self) -> Words | None:
        assert len(self.frames) <= 1, "answered twice"
        return decode(self.frames[0]).message if self.frames else None

    def wait(self) -> Words:
        """What is answered once it is on the disk."""
        end_s = time.monotonic() + WAIT_S
        while not self.frames and time.monotonic() < end_s:
            time.sleep(0.002)
        assert self.message is not None, "no answer"
        return self.message


class Desk:
    """A controller whose inbox we are, with one worker of each kind that answers by hand."""

    def __init__(self, folder: Path) -> None:
        self.router = LocalRouter()
        self.controller = Dispatcher(LocalBus(self.router), Settings(runs=folder))
        self.uniformity = 0.8
        for kind in ("film", "ray"):
            self.hello(kind)

    def put(self, row: str, message: Words, arrays: Any = None, **parts: str) -> Question:
        question = Question(at("luxloop", row, **parts), encode(message, arrays))
        self.controller.take(question.asked)
        return question

    def hello(self, kind: str) -> None:
        describe = Describe(worker=f"{kind}-1", kind=kind, version=__version__, host="h", pid=1)
        self.put("hello", Hello(describe=describe), kind=kind)

    def begin(self, one: Plan | None = None, designer: str = "d", **more: Any) -> Words | None:
        return self.put("begin", Begin(plan=one or plan(), designer=designer, **more)).message

    def act(self, number: int = 0, lane: int = 0, run: str = "one", designer: str = "d", **what: Any) -> Question:
        what = what or {"design": DESIGN}
        action = Action(run=run, designer=designer, lane=lane, number=number, **what)
        return self.put("act", action, name=run)

    def work(
        self, kind: str, result: dict[str, Any] | None = None, arrays: Any = None, **outcome: Any
    ) -> Words | None:
        """Let the worker of a kind take a task and answer it; its receipt, None where there was no task."""
        worker = f"{kind}-1"
        pulled = self.put("pull", Pull(worker=worker, kind=kind, epoch=self.controller.epoch), kind=kind)
        lease = pulled.message
        if not isinstance(lease, Lease):
            return None
        if "failure" not in outcome:
            outcome |= {"result": result or self.answer(kind)}
            arrays = {"map_lx": np.full((4, 4), 7.0)} if kind == "ray" and arrays is None else arrays
        done = Done(
            worker=worker, kind=kind, attempt=lease.attempt, epoch=lease.epoch,
            outcome=Outcome(**{"task_id": lease.task.id, "worker": worker, "compute_s": 0.1} | outcome),
        )  # fmt: skip
        return self.put("done", done, arrays, kind=kind).message

    def answer(self, kind: str) -> dict[str, Any]:
        if kind == "film":
            return {"table_sha256": "f" * 64, "table_bytes": 9}
        return {"metrics": {"uniformity": {"value": self.uniformity, "standard_error": 0.01}}, "ledger_defect": 0.0}

    def evaluated(self, number: int = 0, **what: Any) -> Step:
        """The step of an action, its tasks answered by the workers."""
        question = self.act(number, **what)
        while question.message is None and (self.work("film") or self.work("ray")):
            pass
        step = question.wait()
        assert isinstance(step, Step), step
        return step

    def end(self, run: str = "one", designer: str = "d") -> Words | None:
        return self.put("end", End(run=run, designer=designer, reason="enough"), name=run).message


def written(folder: Path, run: str = "one") -> list[Record]:
    """The records of a run."""
    return list(reader.RunJournal(folder / "runs" / run).records())


def refusal(message: Words | None) -> Failure:
    """The failure that an answer is."""
    assert isinstance(message, Failure), message
    return message
