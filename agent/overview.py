"""What a run came to so far, and how it stands, from its journal alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agent.in_words import plain
from agent.recorded import begun_by, object_in
from agent.telling import run_argument
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import VALIDATION

RUNNING, OVER, STOPPED, KILLED = "running", "ended", "interrupted", "killed"


def overview(folder: Path) -> dict[str, Any]:
    """Id, kind, state, counts, start and best: as they were evaluated at the end, else as the walk saw them."""
    journal = RunJournal(folder)
    facts = journal.metadata("run")
    steps = list(journal.steps())
    sound = [step for step in steps if step.failure is None and step.feasible]
    finals = [step for step in sound if step.final]
    walk = [step for step in sound if not step.final]
    best = max(walk, key=lambda step: step.uniformity, default=None)
    best = max((step for step in finals if step.role == "finalist"), key=lambda step: step.uniformity, default=best)
    best = next((step for step in finals if step.role == "best"), best)
    start = next((step for step in finals if step.role == "start"), next(iter(walk), None))
    state, reason = state_of(journal)
    return {
        "run": facts.get("run", folder.name),
        "kind": facts.get("kind", ""),
        "model": facts.get("model", ""),
        "state": state,
        "reason": reason,
        "mend": _mend(facts, folder) if state in (STOPPED, KILLED) else "",
        "running": state == RUNNING,
        "finished": state == OVER,
        "steps": len(steps),
        "evaluations": len({tuple(step.design.as_vector()) for step in walk}),
        "failed": sum(step.failure is not None for step in steps),
        "folder": str(folder.resolve()),
        "start": plain(start),
        "best": plain(best),
    }


def _mend(facts: Mapping[str, str], folder: Path) -> str:
    """The command that goes on with a campaign or a grid; no other run can be gone on with: its own, given again."""
    if facts.get("kind") != VALIDATION:
        return f"luxloop campaign resume {run_argument(folder)}"
    return begun_by(object_in(facts.get("facts") or "{}", "facts"))


def state_of(journal: RunJournal) -> tuple[str, str]:
    """Whether a run is running, has ended, was interrupted, or was killed; and the reason on record.

    Killed: its last segment has no end, and nobody writes it. Interrupted: it was closed with something left to do.
    """
    if journal.being_written:
        return RUNNING, ""
    if journal.close is None:
        return KILLED, "its journal has no end, and nobody writes it"
    return (OVER if journal.close.complete else STOPPED), journal.close.reason
