"""The checker sees what it is made for, and nothing in a history where all is well."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from luxloop.journal.reader import RunJournal, segments_of
from luxloop.journal.scan import Scan
from tests.campaign_runs import START, RunOnDisk, whole_run
from tests.nemesis.checker import check_history, check_run, content
from tests.nemesis.faults import tear
from tests.nemesis.history import History, Seen, digests_of


def seen(*lines: tuple[str, dict[str, Any]]) -> list[Seen]:
    """A history, a second between two lines."""
    return [{"what": what, "time_s": float(i), "pid": 7} | facts for i, (what, facts) in enumerate(lines)]


def told(step: str = "0:0", digest: str = "a") -> tuple[str, dict[str, Any]]:
    """A step is told."""
    return "told", {"run": "r", "step": step, "digest": digest}


def on_record(what: str = "on record", **steps: str) -> tuple[str, dict[str, Any]]:
    """What the journal holds; keys like s0_1 are lane 0, number 1."""
    return what, {"run": "r", "steps": {key[1:].replace("_", ":"): digest for key, digest in steps.items()}}


def core(what: str, **facts: Any) -> tuple[str, dict[str, Any]]:
    """Something in epoch e about task t."""
    return what, {"epoch": "e", "task": "t"} | facts


GRANT = core("granted", worker="w", attempt=1, held=1, slots=1)
DONE = core("ended", code="done", history=[])
TAKEN = {"worker": "w", "attempt": 1, "of_epoch": "e", "taken": True, "stood": True}
WELL = [core("epoch"), core("accepted"), GRANT, core("delivered", **TAKEN), DONE, told(), on_record(s0_0="a")]


def test_nothing_is_found_where_all_is_well() -> None:
    """Also where a step is told again, and where a tail was lost and its step is told once more."""
    lost = [told("0:1", "b"), on_record("tail lost", s0_0="a"), on_record(s0_0="a"), told("0:1", "b")]
    assert check_history(seen(*WELL, told(), *lost), quiet_s=0.0) == []


@pytest.mark.parametrize(
    ("more", "invariant"),
    [
        ([told(digest="b")], "what was told stays"),
        ([told("0:1"), on_record(s0_0="a")], "what was told is on record"),
        ([on_record(s0_0="other")], "what was told is on record"),
        ([DONE], "a task ends once"),
        ([core("accepted"), core("ended", code="worker_lost", history=[])], "a failed task has its reason"),
        ([core("accepted")], "an accepted task ends"),
        ([core("delivered", **TAKEN | {"stood": False})], "nothing old enters"),
        ([core("delivered", **TAKEN | {"of_epoch": "d"})], "nothing old enters"),
        ([core("granted", worker="w", attempt=2, held=2, slots=1)], "no more than its slots"),
        ([("computes", {}), ("computes", {})], "no more than its slots"),
    ],
)
def test_each_broken_invariant_is_found(more: list[tuple[str, dict[str, Any]]], invariant: str) -> None:
    """That one, and no other."""
    assert {one.invariant for one in check_history(seen(*WELL, *more), quiet_s=0.0)} == {invariant}


def test_a_task_under_way_is_no_fault_while_it_may_go_on() -> None:
    """Only after the quiet time, and only of the last controller."""
    waiting = seen(*WELL, core("accepted", task="u"), told())
    assert check_history(waiting) == check_history(waiting, quiet_s=5.0) == []
    assert check_history([*waiting, *seen(core("epoch", epoch="f"))], quiet_s=0.0) == []


def test_a_journal_is_checked_against_a_clean_one_and_against_what_was_told(tmp_path: Path) -> None:
    """A sound run passes; another content, a step that is not there, a root that was told otherwise are found."""
    whole_run(tmp_path / "r")
    clean = content(tmp_path / "r")
    steps = digests_of(RunJournal(tmp_path / "r").steps())
    history = seen(*(told(step, digest) for step, digest in steps.items()))
    assert check_run(tmp_path / "r", history, clean) == []
    (other,) = check_run(tmp_path / "r", history, "0" * 64)
    assert other.invariant == "the same content as a clean run"
    (missing,) = check_run(tmp_path / "r", [*history, *seen(told("9:9"))], clean)
    assert missing.invariant == "what was told is on record"
    root = ("finished", {"run": "r", "records": 5, "root": "0" * 64})
    (altered,) = check_run(tmp_path / "r", [*history, *seen(root)], clean)
    assert altered.invariant == "the journal is whole"


def test_a_history_is_read_in_the_order_of_writing(tmp_path: Path) -> None:
    """By two writers; tellings are counted once."""
    one, two = History(tmp_path / "h"), History(tmp_path / "h")
    for writer in (one, two, one):
        writer.note("told", run="r", step="0:0", digest="a")
    two.note("told", run="r", step="0:1", digest="b")
    assert [line["step"] for line in one.read()] == ["0:0"] * 3 + ["0:1"]
    assert [line["step"] for line in one.tellings("r")] == ["0:0", "0:1"]
    one.close()
    two.close()


@pytest.mark.parametrize("seed", range(40))
def test_a_torn_write_is_no_commit(tmp_path: Path, seed: int) -> None:
    """Wherever it is cut: the segment holds the commits that it held, something is left over, nothing is wrong."""
    run = RunOnDisk(tmp_path / "run")
    for uniformity in (0.5, 0.6, 0.7):
        run.evaluated(START, uniformity)
    run.close()
    (path,) = segments_of(tmp_path / "run")
    before = [commit.mark for commit in Scan(path)]
    tear(path, random.Random(seed))
    torn = Scan(path)
    assert [commit.mark for commit in torn] == before
    assert torn.torn
    assert torn.left_bytes > 0
    assert not torn.fault
