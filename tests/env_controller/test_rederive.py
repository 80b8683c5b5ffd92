"""Level 2 of a replay: whatever an environment-control agent tells follows again from the journal."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from env_controller import actions as a
from env_controller.audit.rederive import re_derive
from env_controller.environment import EnvironmentAgent
from env_controller.events import Command
from luxloop import __version__
from luxloop.audit import Compared
from luxloop.campaign import Action, Begin, Plan, Step
from luxloop.design import Bounds, Design
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.journal.journal import Journal
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import Record, opening, reply_record, request_record, step_record
from luxloop.messages import Outcome, Task
from luxloop.words import sha256_of
from tests.campaign_runs import plan_of
from tests.journals import START_NS

BOUNDS = Bounds(
    low=Design.from_vector((100.0, 20.0, 300.0, 5.0, 0.0)),
    high=Design.from_vector((140.0, 100.0, 340.0, 100.0, 1.0)),
    step=Design.from_vector((20.0, 20.0, 20.0, 19.0, 0.5)),
)
"""Few designs, so that lanes come to known ones, to the edge of the box, and to chips as high as the receiver."""


class Run:
    """A controller without bus and disk: answers actions, and keeps what would be on record."""

    def __init__(self, plan: Plan, failing: int) -> None:
        self.plan, self.agent, self.records = plan, EnvironmentAgent(), list[Record]()
        self._failing, self._tasks, self._sequence = failing, 0, 0
        self.agent.handle(a.Opened(0.0, plan))

    def act(self, action: Action) -> Step:
        """The step; its tasks are answered one after the other, every so manieth with a failure."""
        commands = self.agent.handle(a.Acted(0.0, action))
        while True:
            told = [one.step for one in commands if isinstance(one, a.Tell)]
            if told:
                self.records.append(step_record(told[0], self._sequence, START_NS))
                self._sequence += 1
                return told[0]
            commands = self._answered(next(one.task for one in commands if isinstance(one, a.Want) and not one.ahead))

    def _answered(self, task: Task) -> list[Command]:
        self._tasks += 1
        fails = self._tasks % self._failing == 0
        failure = Failure(code="worker_lost", message="three attempts") if fails else None
        outcome = Outcome(task_id=task.id, result=None if fails else self._result(task), failure=failure)
        at = self._sequence, START_NS
        self.records += [request_record(task, *at), reply_record(task.kind, outcome, {}, *at)]
        return self.agent.handle(a.Ended(0.0, task.id, outcome.result, failure, 0.5))

    @staticmethod
    def _result(task: Task) -> dict[str, Any]:
        if task.kind == "film":
            return {"table_sha256": task.id, "table_bytes": 9}
        value = int(sha256_of(task.inputs)[:8], 16) / 0xFFFFFFFF
        return {"metrics": {"uniformity": {"value": value, "standard_error": 0.01, "bias": 0.0}}}

    def journal(self, folder: Path, version: str = __version__) -> RunJournal:
        """What was kept, on disk."""
        run, attachments = opening(Begin(plan=self.plan, designer="d"))
        journal = Journal(folder, {"run": run | {"version": version}, "environment": {}}, attachments)
        journal.put(self.records, lambda _: None)
        journal.finish()
        journal.close()
        return RunJournal(folder)


def a_walk(reward: str, seed: int, failing: int = 9, count: int = 150) -> tuple[Run, list[Step]]:
    """Two lanes that begin anew now and then, and else move, out of the bounds too; two final steps at the end."""
    run, draw = Run(plan_of("one", bounds=BOUNDS, reward=reward), failing), random.Random(seed)
    steps: list[Step] = []
    for place in range(count):
        lane, number = place % 2, place // 2
        words: dict[str, Any] = {"run": "one", "designer": "d", "lane": lane, "number": number}
        if place >= count - 2:
            words |= {"design": steps[0].design, "final": True, "seed": str(place), "role": "finalist"}
        elif place < 2 or draw.random() < 0.1:
            values = [draw.choice(BOUNDS.values(name)) for name in Design.FIELDS]
            words |= {"design": Design.from_vector(values)}
        else:
            words |= {"move": {"variable": draw.choice(Design.FIELDS), "steps": draw.choice((-2, -1, 1, 2))}}
        steps.append(run.act(Action.model_validate(words)))
    return run, steps


def compared(journal: RunJournal) -> list[Compared]:
    """What is compared."""
    said: list[Compared] = []
    re_derive(journal, said.append, same_machine=False)
    return said


def differences(journal: RunJournal) -> list[Compared]:
    """What differs, in the order of the journal."""
    return sorted((one for one in compared(journal) if one.verdict == "differs"), key=lambda one: one.sequence)


def forge(run: Run, step: Step, place: int) -> None:
    """Puts another step in the place of one."""
    forged = step_record(step, place, START_NS)
    run.records = [forged if one.topic == "/step" and one.sequence == place else one for one in run.records]


@pytest.mark.parametrize("reward", ["gain", "r1", "r2", "r3"])
def test_all_that_an_agent_tells_follows_again(tmp_path: Path, reward: str) -> None:
    """Known designs, moves that lead out, what cannot be built, lost workers, new beginnings, finalists."""
    run, steps = a_walk(reward, seed=3)
    said = compared(run.journal(tmp_path / "one"))
    assert [one for one in said if one.verdict != "identical"] == []
    assert sum(one.what == "reward" for one in said) == len(steps)
    reasons = " ".join(step.reason for step in steps)
    assert "leads out of the bounds" in reasons
    assert "the receiver needs 5 um above the chip" in reasons
    assert any(step.failure and step.task_id for step in steps)
    assert any(step.failure and not step.task_id for step in steps)
    assert any(step.cached and not step.reason for step in steps)


@pytest.mark.parametrize("seed", range(4))
def test_other_walks_too(tmp_path: Path, seed: int) -> None:
    """Whatever the moves, and however many workers are lost."""
    run, _ = a_walk("r1", seed=seed, failing=2 + seed)
    assert {one.verdict for one in compared(run.journal(tmp_path / "one"))} == {"identical"}


def test_a_reply_that_is_missing_is_not_comparable(tmp_path: Path) -> None:
    """Its step cannot be derived; the others can."""
    run, steps = a_walk("r2", seed=5, failing=1000)
    place, lost = next((i, step) for i, step in enumerate(steps) if step.task_id and i > 10)
    run.records = [
        one for one in run.records if not (one.topic == "/reply/ray" and one.value.task_id == lost.task_id)
    ]
    said = compared(run.journal(tmp_path / "one"))
    assert [one.sequence for one in said if one.verdict == "not comparable"][:1] == [place]
    assert [one for one in said if one.verdict == "differs"] == []


def test_what_an_agent_would_refuse_differs(tmp_path: Path) -> None:
    """A step outside the bounds of its plan was never told by a controller."""
    run, steps = a_walk("r2", seed=5)
    outside = steps[4].design.model_copy(update={"distance_um": 500.0})
    forge(run, steps[4].model_copy(update={"design": outside, "move": None}), 4)
    first = differences(run.journal(tmp_path / "one"))[0]
    assert (first.what, first.sequence) == ("action", 4)
    assert "stay within the run's bounds" in first.why


def test_a_design_to_which_its_move_does_not_lead_differs(tmp_path: Path) -> None:
    """Design and state agree; the move on record leads elsewhere."""
    run, steps = a_walk("gain", seed=5, failing=1000)
    place = next(i for i, step in enumerate(steps) if step.move and step.design != steps[i - 2].design)
    forge(
        run,
        steps[place].model_copy(update={"design": steps[place - 2].design, "state": steps[place - 2].state}),
        place,
    )
    found = differences(run.journal(tmp_path / "one"))
    assert {one.what for one in found} == {"design", "state"}
    assert {one.sequence for one in found} == {place}


@pytest.mark.parametrize("reward", ["gain", "r1"])
def test_a_move_is_not_rewarded_as_a_beginning(tmp_path: Path, reward: str) -> None:
    """All rewards of the walk set to that of a beginning: every move that gained or lost is found, and only these."""
    run, steps = a_walk(reward, seed=3)
    for place, step in enumerate(steps):
        forge(run, step.model_copy(update={"reward": 0.0}), place)
    found = differences(run.journal(tmp_path / "one"))
    assert {one.what for one in found} == {"reward"}
    assert [one.sequence for one in found] == [place for place, step in enumerate(steps) if step.reward]
    assert len(found) > len(steps) / 3


def test_a_beginning_is_not_rewarded_as_a_move(tmp_path: Path) -> None:
    """A design that was asked for one step from where the lane was: nothing was gained by it."""
    run, steps = a_walk("gain", seed=3)
    place = next(i for i, step in enumerate(steps) if i > 1 and not step.move and not step.failure)
    forge(run, steps[place].model_copy(update={"reward": 0.25}), place)
    (found,) = differences(run.journal(tmp_path / "one"))
    assert (found.what, found.sequence, found.now) == ("reward", place, 0.0)


@pytest.mark.parametrize("data", [b"{not json", b"\xff\xfe", b'{"run":"x"}'])
def test_a_plan_that_is_none_is_named(tmp_path: Path, data: bytes) -> None:
    """Its name, and no traceback."""
    journal = a_walk("gain", seed=3, count=4)[0].journal(tmp_path / "one")
    journal.attachments = lambda: {"plan.json": data}  # type: ignore[method-assign]  # as if it had been written so
    with pytest.raises(InputError, match=r"plan\.json"):
        compared(journal)


def test_requests_of_another_release_keep_their_names(tmp_path: Path) -> None:
    """Ids hold the release: they are computed with the one that wrote the journal."""
    run, _ = a_walk("r2", seed=5)
    ids: dict[str, str] = {}
    for one in run.records:
        if one.topic.startswith("/request/"):
            ids[one.value.task_id] = Task(kind=one.value.kind, inputs=one.value.inputs, version="0.0.9").id
    texts = {old.encode(): new.encode() for old, new in ids.items()}
    for i, one in enumerate(run.records):
        data = one.data
        for old, new in texts.items():
            data = data.replace(old, new)
        if one.topic.startswith("/request/"):
            data = data.replace(f'"version":"{__version__}"'.encode(), b'"version":"0.0.9"')
        run.records[i] = Record(one.topic, one.sequence, one.log_time_ns, data)
    said = compared(run.journal(tmp_path / "one", "0.0.9"))
    requests = [one.verdict for one in said if one.what.endswith("request") and one.sequence < 1]
    assert requests
    assert set(requests) == {"identical"}
