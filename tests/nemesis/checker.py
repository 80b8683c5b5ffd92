"""The invariants, checked on a history and on the journals: what is broken, one line each; none where all hold."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from env_controller.audit.checks import verify
from env_controller.audit.contents import Contents
from env_controller.past import past_of
from luxloop.campaign import Plan, Step
from luxloop.errors import LuxloopError
from luxloop.journal.reader import RunJournal, segments_of
from luxloop.journal.scan import Scan
from luxloop.words import parse
from tests.nemesis.history import Seen, Steps, digest_of, digests_of, name_of

PREFIXES = 12
"""Places of a journal at which it is cut and read back."""
HISTORY_NEEDED = ("crashed", "worker_lost", "timed_out")


@dataclass(frozen=True)
class Broken:
    """An invariant that does not hold, and what shows it."""

    invariant: str
    what: str


def check_history(history: Sequence[Seen], quiet_s: float | None = None) -> list[Broken]:
    """All that a history alone shows. With `quiet_s` every task of the last controller that was accepted so long
    before the history's end must have ended."""
    open_at_end = [] if quiet_s is None else _never_ended(history, quiet_s)
    return [*_told_stays(history), *_ends_once(history), *open_at_end, *_fenced(history), *_slots(history)]


def check_run(folder: Path, history: Iterable[Seen], clean: str) -> list[Broken]:
    """All that the journal of a finished run shows; `clean` is the content of one that was never disturbed."""
    name = folder.name
    history = list(history)
    broken = [Broken("the journal is whole", f"{name}: {one}") for one in _unsound(folder, history)]
    if content(folder) != clean:
        broken.append(Broken("the same content as a clean run", f"{name}: {_failures(folder)}"))
    steps = digests_of(RunJournal(folder).steps())
    broken += [
        Broken("what was told is on record", f"{name}: step {seen['step']} at the end")
        for seen in _standing(history, name)
        if steps.get(seen["step"]) != seen["digest"]
    ]
    return broken + [Broken("every prefix is a consistent run", f"{name}: {one}") for one in _prefixes(folder)]


def content(folder: Path) -> str:
    """What a run decided and found."""
    journal = RunJournal(folder)
    return Contents(folder).all_of([Contents(one.path).read() for one in journal.segments]).content


def _unsound(folder: Path, history: Iterable[Seen]) -> list[str]:
    """What an audit finds, against the last root that a designer was told, if it lived to be told one."""
    finished = [seen for seen in history if seen["what"] == "finished" and seen["run"] == folder.name]
    known = (finished[-1]["root"], finished[-1]["records"]) if finished else (None, None)
    return [f"{one.what}: {one.found}" for one in verify(folder, *known).findings if one.verdict == "broken"]


def _failures(folder: Path) -> str:
    """The first step that failed, which makes a run another one; else nothing to say."""
    failed = [step for step in RunJournal(folder).steps() if step.failure is not None]
    return f"step {name_of(failed[0])} failed: {failed[0].failure}" if failed else "another one"


def _told_stays(history: Iterable[Seen]) -> list[Broken]:
    """A step that was told is never told otherwise, and is on record whenever the controller has died."""
    broken: list[Broken] = []
    told: dict[str, Steps] = {}
    for seen in history:
        if seen["what"] == "told":
            before = told.setdefault(seen["run"], {}).setdefault(seen["step"], seen["digest"])
            if before != seen["digest"]:
                broken.append(Broken("what was told stays", f"{seen['run']}: step {seen['step']} told otherwise"))
        elif seen["what"] == "on record":
            for step, digest in told.get(seen["run"], {}).items():
                if seen["steps"].get(step) != digest:
                    text = f"{seen['run']}: step {step}, after the controller died"
                    broken.append(Broken("what was told is on record", text))
        elif seen["what"] == "tail lost":
            kept = told.get(seen["run"], {})
            told[seen["run"]] = {step: kept[step] for step in kept if step in seen["steps"]}
    return broken


def _standing(history: Iterable[Seen], run: str) -> list[Seen]:
    """The tellings of a run that no lost tail excuses."""
    standing: list[Seen] = []
    for seen in history:
        if seen.get("run") != run:
            continue
        if seen["what"] == "told":
            standing.append(seen)
        elif seen["what"] == "tail lost":
            standing = [one for one in standing if one["step"] in seen["steps"]]
    return standing


def _ends_once(history: Iterable[Seen]) -> list[Broken]:
    """In each epoch: what ends was accepted and had not ended; a failure has its reason."""
    broken: list[Broken] = []
    under_way: set[tuple[str, str]] = set()
    for seen in history:
        key = seen.get("epoch", ""), seen.get("task", "")
        if seen["what"] == "accepted":
            under_way.add(key)
        elif seen["what"] == "ended":
            if key not in under_way:
                broken.append(Broken("a task ends once", f"{key[1][:12]} ended without being under way"))
            under_way.discard(key)
            if seen["code"] in HISTORY_NEEDED and not seen["history"]:
                broken.append(Broken("a failed task has its reason", f"{key[1][:12]}: {seen['code']}"))
    return broken


def _never_ended(history: Sequence[Seen], quiet_s: float) -> list[Broken]:
    """Tasks of the last controller that were accepted long ago and did not end."""
    epoch = next((seen["epoch"] for seen in reversed(history) if seen["what"] == "epoch"), "")
    waiting: dict[str, float] = {}
    for seen in history:
        if seen["what"] == "accepted" and seen["epoch"] == epoch:
            waiting[seen["task"]] = seen["time_s"]
        elif seen["what"] == "ended":
            waiting.pop(seen["task"], None)
    end_s = history[-1]["time_s"] if history else 0.0
    return [
        Broken("an accepted task ends", f"{task[:12]} did not in {end_s - since_s:.1f} s")
        for task, since_s in waiting.items()
        if end_s - since_s >= quiet_s
    ]


def _fenced(history: Iterable[Seen]) -> list[Broken]:
    """A result is taken only of who holds the task, of this epoch, and of an attempt that was handed out."""
    broken: list[Broken] = []
    for seen in history:
        if seen["what"] != "delivered" or not seen["taken"]:
            continue
        if not seen["stood"] or seen["of_epoch"] != seen["epoch"]:
            about = f"{seen['task'][:12]}: attempt {seen['attempt']} of {seen['worker']}, epoch {seen['of_epoch']}"
            broken.append(Broken("nothing old enters", about))
    return broken


def _slots(history: Iterable[Seen]) -> list[Broken]:
    """As the controller counts, and as the workers themselves know."""
    broken: list[Broken] = []
    computing: Counter[int] = Counter()
    for seen in history:
        if seen["what"] == "granted" and seen["held"] > seen["slots"]:
            broken.append(Broken("no more than its slots", f"{seen['worker']} holds {seen['held']}"))
        elif seen["what"] in ("computes", "computed"):
            computing[seen["pid"]] += 1 if seen["what"] == "computes" else -1
            if computing[seen["pid"]] > 1:
                broken.append(Broken("no more than its slots", f"process {seen['pid']} computes two at once"))
    return broken


def _prefixes(folder: Path) -> list[str]:
    """What is wrong with the run as it was after some of its commits, spread over all segments."""
    whole = {(step.lane, step.number): step for step in RunJournal(folder).steps()}
    plan = parse(Plan, json.loads(RunJournal(folder).attachments()["plan.json"]), "plan.json")
    ends = [(path, end) for path in segments_of(folder) for end in _commits(path)]
    chosen = ends[:: max(1, len(ends) // PREFIXES)]
    wrong, before = [], 0
    with tempfile.TemporaryDirectory() as name:
        for path, end in chosen:
            try:
                steps = _as_of(folder, path, end, Path(name) / folder.name, plan)
            except LuxloopError as error:
                wrong.append(f"{path.name} up to {end}: {error}")
                continue
            if len(steps) < before:
                wrong.append(f"{path.name} up to {end}: {len(steps)} steps where there were {before}")
            before = len(steps)
            if any(digest_of(steps[key]) != digest_of(whole[key]) for key in steps):
                wrong.append(f"{path.name} up to {end}: a step of other content")
            wrong += [f"{path.name} up to {end}: lane {lane} has a hole" for lane in _holes(steps)]
    return wrong


def _commits(path: Path) -> list[int]:
    """Where in the file the commits end, the last one aside: that is the whole segment."""
    scan = Scan(path)
    return [scan.read_bytes for _ in scan][1:]  # at each commit: where the one before it ended


def _as_of(folder: Path, path: Path, end: int, copy: Path, plan: Plan) -> dict[tuple[int, int], Step]:
    """The steps of a run whose journal ends there."""
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir()
    for segment in segments_of(folder):
        if segment.name <= path.name:
            data = segment.read_bytes()
            (copy / segment.name).write_bytes(data[:end] if segment == path else data)
    return dict(past_of(RunJournal(copy), plan).steps)


def _holes(steps: Iterable[tuple[int, int]]) -> list[int]:
    """Lanes whose steps are not numbered from 0 without a gap."""
    numbers: dict[int, set[int]] = {}
    for lane, number in steps:
        numbers.setdefault(lane, set()).add(number)
    return [lane for lane, found in numbers.items() if found != set(range(len(found)))]
