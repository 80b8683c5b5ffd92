"""What the journal of a run holds for its report: read once, whether the run has ended, goes on, or was killed."""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.moves import key_of
from luxloop.campaign import AgentRecord, Plan, Step
from luxloop.errors import InputError
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import CHAIN, Close

Document = dict[str, Any]


@dataclass(frozen=True, eq=False)  # a step is itself; comparing thousands by value takes seconds
class Told:
    """A step as it was told: its place in the journal (from 0), when (Unix time), what the designer was like."""

    step: Step
    sequence: int
    time_ns: int
    agent: AgentRecord | None

    @property
    def evaluated(self) -> bool:
        """Whether its uniformity is that of its design: it was computed, or known from before."""
        return self.step.feasible and self.step.failure is None and not self.step.reason


@dataclass(frozen=True)
class Recorded:
    """A run as its journal has it.

    `notes` are the results that designers put on record, `lines` its log, `command_lines` those of its starts, the
    first one first, `close` why it was closed (None where it goes on, or was killed), `state` finished, being
    written, or not finished; `records` and `root` of the chain at the last commit.
    """

    folder: Path
    plan: Plan
    facts: dict[str, str]
    environment: dict[str, str]
    attachments: dict[str, bytes]
    told: list[Told]
    notes: list[Document]
    lines: list[str]
    command_lines: list[str]
    close: Close | None
    state: str
    records: int
    root: str

    @property
    def walk(self) -> list[Told]:
        """The steps of the search, in their order."""
        return [told for told in self.told if not told.step.final]

    @property
    def finals(self) -> list[Told]:
        """What was evaluated again at the end, with the final fidelity and fresh seeds."""
        return [told for told in self.told if told.step.final and told.evaluated]

    @property
    def begun_ns(self) -> int:
        """When the first action came, Unix time; 0 before that."""
        return min((told.time_ns - round(told.step.controller_s * 1e9) for told in self.told), default=0)


@dataclass
class Details:
    """Large records of a few steps: results and seeds by ray task, maps (y, x) in lx by the step's sequence."""

    results: dict[str, Document] = field(default_factory=dict)
    requests: dict[str, Document] = field(default_factory=dict)
    maps: dict[int, NDArray[np.float64]] = field(default_factory=dict)


def recorded(folder: Path) -> Recorded:
    """The run in a folder. Raises InputError where there is no journal, or no plan in it."""
    journal = RunJournal(folder)
    attachments = journal.attachments()
    if "plan.json" not in attachments:
        raise InputError(str(folder), sorted(attachments), "a run with its plan", "was it written by luxloop?")
    learner: dict[tuple[int, int], AgentRecord] = {}
    steps, notes, lines = [], [], []
    for entry in journal.records("/step", "/agent", "/note", "/log"):
        match entry.topic:
            case "/step":
                steps.append(entry)
            case "/agent":
                learner[entry.value.lane, entry.value.number] = entry.value
            case "/note":
                notes.append(entry.value.result)
            case _:
                lines.append(entry.value.message)
    told = []
    for entry in steps:
        step = entry.value
        agent = learner.get((step.lane, step.number)) if not step.final else None
        told.append(Told(step, entry.sequence, entry.log_time_ns, agent))
    chain = [entry.value for entry in journal.last(CHAIN, 1)]
    finished = journal.segments[-1].index is not None
    return Recorded(
        folder=folder,
        plan=journal.attached("plan.json", Plan),
        facts=journal.metadata("run"),
        environment=journal.metadata("environment"),
        attachments=attachments,
        told=told,
        notes=notes,
        lines=lines,
        command_lines=list(_command_lines(journal)),
        close=journal.close,
        state="finished" if finished else "being written" if journal.being_written else "not finished",
        records=chain[0].records if chain else 0,
        root=chain[0].root if chain else "0" * 64,
    )


def object_in(text: str | bytes, name: str) -> Document:
    """The JSON object in a text that a journal holds; `name` says which. Raises InputError where it is none."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError(
            name, text[:60], "a JSON object", "luxloop audit verify says whether it is as it was written"
        )
    return found


def begun_by(facts: Document) -> str:
    """The command line by which a run was begun, as its facts have it; empty where they do not say."""
    argv = facts.get("argv")
    return shlex.join(["luxloop", *map(str, argv)]) if argv and isinstance(argv, list) else ""


def details(folder: Path, wanted: Collection[Told]) -> Details:
    """Results, requests and maps of a few steps."""
    found = Details()
    tasks = {told.step.task_id for told in wanted if told.step.task_id}
    sequences = {told.sequence for told in wanted}
    for entry in RunJournal(folder).records("/request/ray", "/reply/ray", "/map/sim"):
        if entry.topic == "/map/sim":
            if entry.sequence in sequences:
                found.maps[entry.sequence] = np.asarray(entry.value, dtype=np.float64)
            continue
        for task in _named(tasks, entry.data):
            if entry.topic == "/request/ray":
                found.requests[task] = entry.value.inputs
            elif entry.value.result is not None:
                found.results[task] = entry.value.result
    return found


def distinct(walk: Iterable[Told]) -> list[Told]:
    """The evaluations of different designs, the first of each, in their order."""
    first: dict[tuple[float, ...], Told] = {}
    for told in walk:
        if told.evaluated:
            first.setdefault(key_of(told.step.design), told)
    return list(first.values())


def has_episodes(walk: Iterable[Told]) -> bool:
    """Whether the designer counts episodes: a search knows but one."""
    return any(told.agent is not None and told.agent.episode > 0 for told in walk)


def wall_s(told: Iterable[Told]) -> float:
    """For how long the run had something under way: pauses between its starts do not count."""
    total_ns = reached_ns = 0
    for one in sorted(told, key=lambda one: one.time_ns):
        begun_ns = max(reached_ns, one.time_ns - round(one.step.controller_s * 1e9))
        total_ns, reached_ns = total_ns + one.time_ns - begun_ns, one.time_ns
    return total_ns / 1e9


def _command_lines(journal: RunJournal) -> Iterator[str]:
    """What the run was begun by, then what it was gone on with by; a controller's new start is none."""
    designer = None
    for run in journal.starts("run"):
        line = begun_by(object_in(run.get("facts") or "{}", "facts"))
        if line and run.get("designer") != designer:
            designer = run.get("designer")
            yield line


def _named(tasks: Collection[str], data: bytes) -> Iterator[str]:
    """The tasks that a record speaks of: looked for in its bytes, since decoding thousands takes seconds."""
    return (task for task in tasks if task.encode() in data)
