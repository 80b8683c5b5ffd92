"""What the tests of a replay share: the recorded campaigns, and such with changed records whose chain is right."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer
from typer.testing import CliRunner

from env_controller.audit.replay_command import replay
from luxloop.campaign import Step
from luxloop.journal.chain import Mark
from luxloop.journal.reader import RunJournal
from luxloop.journal.segment import Segment
from luxloop.journal.topics import Record as Entry
from luxloop.journal.topics import RequestRecord, record, step_record
from luxloop.messages import Task

GOLDEN = Path(__file__).parents[1] / "golden" / "runs"
NAMES = ("paper-mc", "fast-twin")
WALK, BEST = 1, 8  # steps of `paper-mc`: a move of the walk, the best finalist's last evaluation
app = typer.Typer()
app.command()(replay)


def ask(folder: Path, level: int, *more: object) -> tuple[int, dict[str, Any]]:
    """Exit code and document of a replay."""
    argv = [str(folder), "--level", str(level), "--json", *map(str, more)]
    done = CliRunner().invoke(app, argv, catch_exceptions=False)
    return done.exit_code, json.loads(done.stdout)


def planted(to: Path, change: Callable[[Entry], Entry | None], name: str = NAMES[0],
            files: dict[str, bytes] | None = None) -> Path:  # fmt: skip
    """A golden run with changed records and files and a chain that is right: what a forger with our code can make."""
    (segment,) = RunJournal(GOLDEN / name).segments
    metadata, attachments = dict(segment.opening[0]), dict(segment.opening[1])
    to.mkdir()
    out = Segment(to / "audit-0001.mcap", Mark(), metadata, attachments | (files or {}))
    for entry in filter(None, map(change, segment.records())):
        out.write(entry)
        out.commit()
    out.finish()
    return to


def step_changed(sequence: int, **values: Any) -> Callable[[Entry], Entry]:
    """Changes one step."""

    def change(entry: Entry) -> Entry:
        if entry.topic != "/step" or entry.sequence != sequence:
            return entry
        return step_record(entry.value.model_copy(update=values), sequence, entry.log_time_ns)

    return change


def seed_changed(task_id: str, to: str, forged: bool) -> Callable[[Entry], Entry]:
    """Another seed in one request; `forged`: its id, its reply and its step agree with that."""

    def again(entry: Entry, words: Any) -> Entry:
        return record(entry.topic, words, entry.sequence, entry.log_time_ns)

    new_id = task_id

    def change(entry: Entry) -> Entry:
        nonlocal new_id
        if entry.topic not in ("/request/ray", "/reply/ray", "/step") or entry.value.task_id != task_id:
            return entry
        words = entry.value
        if isinstance(words, RequestRecord):
            inputs = {**words.inputs, "seed": to, "exit_seed": to}
            if forged:
                new_id = Task(kind=words.kind, inputs=inputs, version=words.version).id
            return again(entry, words.model_copy(update={"inputs": inputs, "task_id": new_id}))
        return again(entry, words.model_copy(update={"task_id": new_id}))

    return change


def step_at(sequence: int, name: str = NAMES[0]) -> Step:
    """A step of a golden run."""
    step: Step = next(one.value for one in RunJournal(GOLDEN / name).records("/step") if one.sequence == sequence)
    return step


def named(document: dict[str, Any]) -> tuple[int, str]:
    """Step and name of the first difference."""
    return document["first_difference"]["sequence"], document["first_difference"]["what"]
