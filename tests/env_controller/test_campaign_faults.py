"""Runs at the controller that meet answers that cannot be, and disks that do not take what is told."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from env_controller import campaigns
from luxloop.campaign import Ended, Move, Note, Step
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.messages import Receipt
from tests.env_controller.desk import DESIGN, Desk, plan, refusal, written


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    """A controller whose runs lie in a folder of their own."""
    desk = Desk(tmp_path / "runs")
    yield desk
    desk.controller._campaigns.stop()


@pytest.mark.parametrize(
    ("result", "arrays"),
    [
        ({"metrics": {"uniformity": {"value": 7.0, "standard_error": 0.01}}}, None),
        ({"metrics": {"uniformity": {"value": -0.1, "standard_error": 0.01}}}, None),
        ({"metrics": {"uniformity": {"value": 0.5}}}, None),
        ({"metrics": {"uniformity": {"value": 0.5, "standard_error": 0.1}}, "ledger_defect": 0.1}, None),
        (None, {"map_lx": np.array([[1.0, np.nan]])}),
        (None, {"map_lx": np.array([[1.0, 1e39]])}),
        (None, {"map_lx": np.ones(4)}),
        (None, {}),
        ({"histories": 7}, {"map_lx": np.ones((4, 4))}),
    ],
)
def test_an_answer_that_cannot_be_is_tried_again_elsewhere(desk: Desk, result: Any, arrays: Any) -> None:
    """Uniformity out of range or missing, an open ledger, NaN in the map or none: the third time the step failed."""
    desk.begin()
    question = desk.act()
    desk.work("film")
    answer = result or desk.answer("ray")
    for _ in range(3):
        assert question.message is None
        assert desk.work("ray", answer, arrays if arrays is not None else {}) is not None
    step = question.wait()
    assert isinstance(step, Step)
    assert step.failure is not None
    assert "does not hold" in step.failure.message
    desk.uniformity = 0.8
    assert desk.evaluated(1, move=Move(variable="width_um", steps=1)).failure is None


def test_a_crash_of_many_words_is_a_step_that_failed(desk: Desk) -> None:
    """A compiler's pages, three times: the run goes on without that design."""
    desk.begin()
    question = desk.act()
    for _ in range(3):
        desk.work("film", failure=Failure.of(RuntimeError("x" * 5000)))
    step = question.wait()
    assert isinstance(step, Step)
    assert step.failure is not None
    assert step.failure.code == "crashed"
    assert desk.evaluated(1, move=Move(variable="width_um", steps=1)).failure is None


@pytest.mark.parametrize(
    "result",
    [
        {"table_bytes": 9},
        {"table_sha256": "f" * 64},
        {"table_sha256": "F" * 64, "table_bytes": 9},
        {"table_sha256": "f" * 64, "table_bytes": 0},
        {"table_sha256": "f" * 64, "table_bytes": 1 << 40},
        {"table_sha256": 7, "table_bytes": 9},
    ],
)
def test_a_film_without_its_table_is_an_answer_that_cannot_be(desk: Desk, result: dict[str, Any]) -> None:
    """No hash, no size, or none that a table has: that worker's answer does not hold, and the run goes on."""
    desk.begin()
    question = desk.act()
    for _ in range(3):
        assert question.message is None
        assert isinstance(desk.work("film", result), Receipt)
    step = question.wait()
    assert isinstance(step, Step)
    assert step.failure is not None
    assert "the answer of film-1 does not hold" in step.failure.message
    assert desk.evaluated(1, design=DESIGN).failure is None


def test_nothing_is_computed_in_less_than_no_time(desk: Desk) -> None:
    """Such an answer does not hold; the next one may."""
    desk.begin()
    question = desk.act()
    desk.work("film", compute_s=-1.0)
    desk.work("film")
    desk.work("ray", compute_s=-1.0)
    desk.work("ray")
    step = question.wait()
    assert isinstance(step, Step)
    assert step.physics_s == pytest.approx(0.2)


def test_what_a_run_cannot_take_closes_it_and_the_controller_goes_on(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Something of ours is broken: who waits is told so, the journal is finished, other runs are not touched."""
    desk.begin()
    desk.begin(plan("two"))
    question = desk.act()
    with monkeypatch.context() as patched:
        patched.setattr(desk.controller._campaigns.agent, "_keep_film", lambda *_: 1 / 0)
        assert desk.work("film") == Receipt(accepted=True)
    failure = refusal(question.message)
    assert (failure.code, failure.mend) == ("crashed", "luxloop campaign resume one")
    assert "ZeroDivisionError" in failure.message
    assert (tmp_path / "runs" / "one" / "audit.sha256").exists()
    assert desk.controller._campaigns.runs == ("two",)
    other = desk.act(run="two")
    assert desk.work("ray") is not None
    assert isinstance(other.wait(), Step)


def test_another_tasks_result_is_not_taken(desk: Desk) -> None:
    """Fenced; the task goes on waiting for its own."""
    desk.begin()
    question = desk.act()
    desk.work("film")
    receipt = desk.work("ray", task_id="0" * 64, result=desk.answer("ray"))
    assert isinstance(receipt, Receipt)
    assert not receipt.accepted
    assert question.message is None


def test_a_full_disk_ends_the_run_and_keeps_what_was_told(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The step that could not be written is told as a failure with folder and mend, and so is every later one."""
    desk.begin()
    told = desk.evaluated(0)

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(desk.controller._campaigns._runs["one"].journal._segment, "commit", full)
    question = desk.act(1, move=Move(variable="width_um", steps=1))
    desk.work("ray")
    failure = refusal(question.wait())
    assert "No space left" in failure.message
    assert str(tmp_path) in failure.message
    assert refusal(desk.act(2, move=Move(variable="width_um", steps=1)).wait()).message == failure.message
    assert refusal(desk.end()).message == failure.message
    steps = [record.value for record in written(tmp_path) if record.topic == "/step"]
    assert steps[0] == told


class Crowded:
    """A journal that is said to have no room, for as long as `full` is set."""

    def __init__(self, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
        self.full = True
        journal = desk.controller._campaigns._runs["one"].journal
        self._put = journal.put
        monkeypatch.setattr(journal, "put", self.put)

    def put(self, records: Any, done: Any) -> None:
        if self.full:
            raise RemoteError(Failure(code="busy", message="too much waits for the journal's disk"))
        self._put(records, done)


@pytest.mark.parametrize("by", ["the next tick", "the next note"])
def test_what_the_journal_has_no_room_for_is_written_later(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, by: str
) -> None:
    """In its order, before anything else is acknowledged: nothing is told meanwhile, nothing is lost."""
    desk.begin()
    journal = Crowded(desk, monkeypatch)
    question, other = desk.act(), desk.act(lane=1, design=DESIGN.model_copy(update={"width_um": 40.0}))
    for kind in ("film", "ray", "ray"):
        desk.work(kind)
    note = Note(run="one", designer="d", log="later")
    assert refusal(desk.put("note", note, name="one").message).code == "busy"
    assert refusal(desk.end()).code == "busy"
    assert (question.message, other.message) == (None, None)
    journal.full = False
    if by == "the next tick":
        desk.controller._campaigns.tick(time.monotonic())
    else:
        assert desk.put("note", note, name="one").wait() == Receipt(accepted=True)
    told = [question.wait(), other.wait()]
    assert desk.put("note", note, name="one").wait() == Receipt(accepted=True)
    assert isinstance(desk.evaluated(1, move=Move(variable="width_um", steps=1)), Step)
    assert isinstance(desk.end(), Ended)
    records = written(tmp_path)
    topics = [record.topic for record in records if record.topic != "/chain"]
    assert topics[:4] == ["/request/film", "/reply/film", "/request/ray", "/reply/ray"]
    assert [record.value for record in records if record.topic == "/step"][:2] == told
    assert topics.index("/step") < topics.index("/log")


def test_a_journal_without_room_for_long_closes_its_run(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Who waits is told that for good, and how to go on; what was told before is on record."""
    desk.begin()
    before = desk.evaluated(0)
    Crowded(desk, monkeypatch)
    desk.act(1, move=Move(variable="width_um", steps=1))
    desk.work("ray")
    desk.controller._campaigns.tick(time.monotonic() + campaigns.FULL_S - 1.0)
    assert desk.controller._campaigns.runs == ("one",)
    question = desk.act(1, move=Move(variable="width_um", steps=1))  # the hold of the first one is over
    desk.controller._campaigns.tick(time.monotonic() + campaigns.FULL_S + 1.0)
    failure = refusal(question.message)
    assert (failure.code, failure.mend) == ("refused", "luxloop campaign resume one")
    assert "no room" in failure.message
    assert desk.controller._campaigns.runs == ()
    assert [record.value for record in written(tmp_path) if record.topic == "/step"] == [before]
