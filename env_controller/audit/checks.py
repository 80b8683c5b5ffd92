"""Whether a journal is still what was written: its structure, its chain over all segments, its steps, its replies.

A chain does not see a tail that was cut off an unfinished segment, nor a file written anew as a whole: for these a
root and a count that left the machine are compared.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Literal

from luxloop.campaign import Step
from luxloop.errors import InputError
from luxloop.journal.chain import Link, Mark
from luxloop.journal.reader import left_over, number_of, segments_of
from luxloop.journal.scan import Commit, Scan
from luxloop.journal.segment import FORMAT, PATTERN, SIDE_FILE, being_written
from luxloop.journal.topics import Record, RequestRecord
from luxloop.messages import Task

Verdict = Literal["ok", "note", "lost", "broken"]
EXIT: dict[Verdict, int] = {"ok": 0, "note": 0, "lost": 3, "broken": 5}
SHOWN = 5  # of many alike
OUT_OF_STEP = -1  # a lane whose numbers are wrong already
GIVEN = "the given root and count"


@dataclass(frozen=True)
class Finding:
    """One line of the verdict: `note` is no fault, `lost` says that something may be missing, `broken` that it is not
    what was written."""

    what: str
    verdict: Verdict
    found: str


@dataclass
class Expected:
    """A mark that somebody kept: whose, how many records (none: any number), which root (none: any)."""

    who: str
    records: int | None
    root: str | None
    met: bool = False
    seen_root: str = ""

    def look(self, mark: Mark) -> None:
        """Compare with how far the chain has come."""
        if self.records is None or self.records == mark.records:
            self.seen_root = mark.root
            self.met = self.met or self.root in (None, mark.root)


@dataclass
class Audit:
    """What was read so far, and what was found."""

    findings: list[Finding] = field(default_factory=list)
    mark: Mark = field(default_factory=Mark)
    steps: Counter[int] = field(default_factory=Counter)
    lanes: Counter[int] = field(default_factory=Counter)
    """The number that each lane's next step must have."""
    asked: set[str] = field(default_factory=set)
    answered: set[str] = field(default_factory=set)
    topics: Counter[str] = field(default_factory=Counter)

    def say(self, what: str, verdict: Verdict, found: str) -> None:
        """Put a finding on record."""
        self.findings.append(Finding(what, verdict, found))


def verify(
    folder: Path, root: str | None, records: int | None, progress: Callable[[int], object] = lambda _: None
) -> Audit:
    """The audit of a run; `progress` is told the bytes read. Raises InputError where there is no journal."""
    paths = segments_of(folder)
    if not paths:
        raise InputError("RUN", str(folder), "the folder of a run with its journal", f"there is no {PATTERN} in it")
    audit = Audit()
    expected = [Expected(GIVEN, records, root)] if root or records else []
    expected += _side_file(folder, audit)
    scans = _read_all(paths, audit, expected, progress)
    whole: Verdict = "note" if exit_code(audit) else "ok"
    audit.say("chain", whole, f"{audit.mark.records:,} records, root {audit.mark.root}")
    for kept in expected:
        _compare(kept, audit)
    vouchers = {kept.who for kept in expected if kept.met and kept.records == audit.mark.records}
    _last_segment(scans[-1], vouchers, audit)
    _steps(audit)
    unanswered = audit.asked - audit.answered
    open_end = not scans[-1].finished
    if unanswered:
        verdict: Verdict = "note" if open_end else "lost"
        audit.say(
            "requests", verdict, f"{len(unanswered)} of {len(audit.asked):,} without a reply: {_some(unanswered)}"
        )
    else:
        audit.say("requests", "ok", f"{len(audit.asked):,}, each with a reply")
    return audit


def exit_code(audit: Audit) -> int:
    """0 as it was written, 3 where something may be missing, 5 where it is not what was written."""
    return max((EXIT[finding.verdict] for finding in audit.findings), default=0)


def _read_all(
    paths: list[Path], audit: Audit, expected: list[Expected], progress: Callable[[int], object]
) -> list[Scan]:
    scans: list[Scan] = []
    read_bytes = place = 0
    again = left_over(paths)
    for path in paths:
        name, size_bytes = path.name, path.stat().st_size
        if path in again:
            audit.say(name, "note", how_left(path))
            place = number_of(path)  # a start since then has the number behind it
            continue
        place += 1
        if number_of(path) != place:
            audit.say(name, "broken", f"segment {place} is missing before it")
        scan = Scan(path)
        _read(scan, audit, expected, lambda size, before=read_bytes: progress(before + size))  # type: ignore[misc]
        read_bytes += size_bytes
        scans.append(scan)
        if scan.fault:
            audit.say(name, "broken", f"damaged after {scan.read_bytes:,} bytes: {scan.fault}")
        elif path != paths[-1] and not scan.finished:
            audit.say(name, "note", f"was not finished; the run went on in the next{_left(scan)}")
        elif scan.finished:
            audit.say(name, "ok", f"finished, {size_bytes:,} bytes, checksums hold")
    return scans


def how_left(path: Path) -> str:
    """Why a segment counts for nothing that the run's first one holds too, and the mend."""
    return f"left by an interrupted compaction; luxloop audit compact {path.parent} ends it"


def _read(scan: Scan, audit: Audit, expected: list[Expected], progress: Callable[[int], object]) -> None:
    first = True
    for commit in scan:
        if first and scan.before != audit.mark:
            found = f"goes on after {scan.before.records:,} records, where {audit.mark.records:,} lie before it"
            same = scan.before.records == audit.mark.records
            audit.say(scan.path.name, "broken", f"{found}{', of another root' if same else ''}")
            audit.mark = scan.before
        first = False
        _take(commit, scan.path.name, audit, expected)
        progress(scan.read_bytes)
    if scan.finished and scan.final != audit.mark:
        audit.say(scan.path.name, "broken", f"ends with {audit.mark.records:,} records, states another root or count")


def _take(commit: Commit, name: str, audit: Audit, expected: list[Expected]) -> None:
    before = audit.mark
    for link in commit.links:
        audit.mark = audit.mark.then([link])
        for kept in expected:
            kept.look(audit.mark)
        _count(link, name, audit)
    if audit.mark != commit.mark:
        audit.say(
            name, "broken", f"records {before.records + 1:,} to {commit.mark.records:,} are not what was written"
        )
        audit.mark = commit.mark


def _count(link: Link, name: str, audit: Audit) -> None:
    if not isinstance(link, Record):
        _look_at_format(link, name, audit)
        return
    audit.topics[link.topic] += 1
    if link.topic == "/step":
        audit.steps[link.sequence] += 1
    try:
        words = link.value
    except (InputError, RecursionError) as error:
        audit.say(name, "broken", f"{link.topic} of step {link.sequence}: {error}")
        return
    if link.topic == "/step":
        _look_at_number(link, words, name, audit)
    elif link.topic.startswith("/reply/"):
        audit.answered.add(words.task_id)
    elif link.topic.startswith("/request/"):
        _look_at_request(words, name, audit)


def _look_at_format(link: Link, name: str, audit: Audit) -> None:
    """Records of another format may mean something else: whether they hold together, this release cannot say."""
    if link.topic == "metadata/run":
        written = json.loads(link.data).get("journal", "unknown")
        if written != FORMAT:
            audit.say(name, "broken", f"written in format {written}; this release reads {FORMAT}")


def _look_at_number(link: Record, step: Step, name: str, audit: Audit) -> None:
    """A lane's steps are numbered 0, 1, 2, ... in their order; of each lane the first that is not is told."""
    due = audit.lanes[step.lane]
    if due == OUT_OF_STEP:
        return
    audit.lanes[step.lane] = due + 1
    if step.number != due:
        found = f"step {link.sequence} is action {step.number:,} of lane {step.lane}, where action {due:,} is due"
        audit.say(name, "broken", found)
        audit.lanes[step.lane] = OUT_OF_STEP


def _look_at_request(words: RequestRecord, name: str, audit: Audit) -> None:
    audit.asked.add(words.task_id)
    if Task(kind=words.kind, inputs=words.inputs, version=words.version).id != words.task_id:
        audit.say(name, "broken", f"request {words.task_id[:12]} has not the id of its inputs")


def _compare(kept: Expected, audit: Audit) -> None:
    if kept.met:
        more = audit.mark.records - (kept.records or audit.mark.records)
        audit.say(kept.who, "ok", f"the journal holds it{f', and {more:,} records after it' if more else ''}")
    elif kept.records is not None and kept.records > audit.mark.records:
        audit.say(
            kept.who, "broken", f"{kept.records:,} records were there, {audit.mark.records:,} are: a tail is cut off"
        )
    elif kept.seen_root and kept.records is not None:
        audit.say(kept.who, "broken", f"after {kept.records:,} records the root is {kept.seen_root}, not {kept.root}")
    else:
        audit.say(kept.who, "broken", f"no such root in {audit.mark.records:,} records")


def _last_segment(scan: Scan, vouchers: set[str], audit: Audit) -> None:
    """Whether the run's end is there; `vouchers` kept a root and a count that are just what was read."""
    name = scan.path.name
    if scan.finished or scan.fault:
        return
    if being_written(scan.path):
        audit.say(name, "note", "is being written")
    elif SIDE_FILE in vouchers and scan.read_bytes:
        audit.say(
            name, "broken", f"was finished, as {SIDE_FILE} says, and breaks off after {scan.read_bytes:,} bytes"
        )
    elif vouchers:
        audit.say(name, "note", f"was not finished; nothing that counts is missing{_left(scan)}")
    else:
        found = "was not finished: whether a tail is missing only a root and a count kept elsewhere can tell"
        audit.say(name, "lost", f"{found} (--root, --records){_left(scan)}")


def _left(scan: Scan) -> str:
    return f"; {scan.left_bytes:,} bytes of a batch that was never acknowledged" if scan.left_bytes else ""


def _steps(audit: Audit) -> None:
    steps = audit.steps
    missing = max(steps, default=-1) + 1 - len(steps)
    twice = sorted(sequence for sequence, times in steps.items() if times > 1)
    if missing:
        first = next(sequence for sequence in count() if sequence not in steps)
        audit.say("steps", "broken", f"{missing:,} missing in the sequence, the first is {first:,}")
    if twice:
        audit.say("steps", "broken", f"{len(twice):,} numbers are there twice: {_some(twice)}")
    if not missing and not twice:
        audit.say("steps", "ok", f"{len(steps):,}, none missing in the sequence")


def _side_file(folder: Path, audit: Audit) -> list[Expected]:
    """What the run's own side file says."""
    try:
        mark = read_side_file(folder)
    except (OSError, ValueError) as error:
        audit.say(SIDE_FILE, "broken", f"it cannot be read: {error}")
        return []
    return [] if mark is None else [Expected(SIDE_FILE, mark.records, mark.root)]


def read_side_file(folder: Path) -> Mark | None:
    """The mark in the side file; None where there is none. Raises ValueError or OSError where it cannot be read."""
    with suppress(FileNotFoundError):
        root, _, records = (folder / SIDE_FILE).read_text().strip().partition(" ")
        return Mark(int(records), root)
    return None


def _some(items: set[str] | list[int]) -> str:
    shown = [str(item)[:12] for item in sorted(items)[:SHOWN]]
    return ", ".join(shown) + (", ..." if len(items) > SHOWN else "")
