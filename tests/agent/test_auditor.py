"""Level 3 of a replay: designers decide the same from a journal, and what differs is found where it begins."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from agent.auditor import re_decide
from agent.campaign import Runner, WalkEnd
from agent.config import Campaign, Stop
from agent.designers import designer
from agent.moves import Space
from luxloop.audit import Compared
from luxloop.campaign import Action, Begin, Note, Plan, Step
from luxloop.design import Bounds, Design
from luxloop.journal.journal import Journal
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import Record, log_record, note_records, opening, step_record
from luxloop.model import Model
from luxloop.words import canonical
from tests.journals import START_NS
from tests.objectives import Controller

SMALL = Bounds(
    low=Design.from_vector((150.0, 20.0, 400.0, 10.0, 5.0)),
    high=Design.from_vector((180.0, 60.0, 500.0, 20.0, 6.0)),
    step=Design.from_vector((10.0, 20.0, 50.0, 10.0, 0.5)),
)
"""216 designs."""


class Door:
    """A controller in this process that notes what it would put on record; one action of lane 0 fails."""

    designer = "d"

    def __init__(self, run: str, plan: Plan, failing: int | None) -> None:
        self.run, self.records, self._lock = run, list[Record](), threading.Lock()
        self._controller = Controller("A", plan.bounds, plan.reward)
        self._controller.failing = {(0, failing)} if failing is not None else set()

    def act(self, action: Action) -> Step:
        """The step of an action."""
        with self._lock:
            return self._act(action)

    def _act(self, action: Action) -> Step:
        place = sum(one.topic == "/step" for one in self.records)
        step = self._controller.act(action).model_copy(update={"final": action.final, "role": action.role})
        self.records.append(step_record(step, place, START_NS + place))
        if action.agent is not None:
            note = Note(run=self.run, designer="d", agent=action.agent)
            self.records += note_records(note, place, START_NS + place)
        return step


def recorded(folder: Path, name: str, *, lanes: int = 1, failing: int | None = None, keep: int | None = None,
             time_after: int | None = None, **changes: Any) -> RunJournal:  # fmt: skip
    """A run of a designer on disk; of its records the first `keep`, ended by its time after so many steps."""
    words = {
        "designer": name,
        "bounds": SMALL,
        "lanes": lanes,
        "finalists": 2,
        "stop": Stop(evaluations=30),
    } | changes
    campaign = Campaign.model_validate(words)
    kind = "grid" if name == "grid" else "campaign"
    plan = campaign.plan(folder.name, Model(name="m"), "m", kind=kind)  # type: ignore[arg-type]  # one of two words
    door = Door(folder.name, plan, failing)
    chooser = designer(name, Space.of(plan), seed=campaign.seed, lanes=lanes, learning=campaign.learner)
    stop = campaign.stop if time_after is None else campaign.stop.model_copy(update={"steps": time_after})
    ends: list[WalkEnd] = []
    runner = Runner(door, chooser, stop, lanes=lanes, seed=campaign.seed, on_walk_end=ends.append)
    runner.run(campaign.finalists, without_dbr=kind == "campaign")
    begin = Begin(plan=plan, designer="d", attachments={"campaign.json": canonical(campaign).decode()})
    run, attachments = opening(begin)
    journal = Journal(folder, {"run": run, "environment": {}}, attachments)
    end = ends[0] if time_after is None else ends[0]._replace(reason="time: 5 s")
    lines = [log_record(end.line, len(door.records), START_NS)] if keep is None else []
    journal.put([*door.records[:keep], *lines], lambda _: None)
    journal.finish()
    journal.close()
    return RunJournal(folder)


def compared(journal: RunJournal, same_machine: bool = True) -> list[Compared]:
    """What is compared."""
    said: list[Compared] = []
    re_decide(journal, said.append, same_machine=same_machine)
    return said


def verdicts(said: list[Compared], what: str) -> list[str]:
    """Of one kind of comparison."""
    return [one.verdict for one in said if one.what == what]


@pytest.mark.parametrize(("name", "lanes"), [("ddqn-fast", 1), ("ddqn-fast", 3), ("ddqn-paper", 2), ("random", 2),
                                             ("pattern", 2), ("grid", 2)])  # fmt: skip
def test_every_designer_decides_the_same(tmp_path: Path, name: str, lanes: int) -> None:
    """All proposals of walk and finals, and why the walk ended."""
    journal = recorded(tmp_path / "r", name, lanes=lanes)
    said = compared(journal)
    assert {one.verdict for one in said} == {"identical"}
    assert len(verdicts(said, "proposal")) == len(list(journal.steps()))
    assert len(verdicts(said, "end of the walk")) == 1


def test_a_lost_worker_changes_nothing(tmp_path: Path) -> None:
    """A failed step on record begins its lane anew in the replay, too."""
    said = compared(recorded(tmp_path / "r", "ddqn-fast", lanes=2, failing=7))
    assert {one.verdict for one in said} == {"identical"}


def test_a_walk_that_its_time_ended_ends_there_again(tmp_path: Path) -> None:
    """The clock is not asked: the walk's end is taken from the journal, the finals follow it."""
    stop = {"evaluations": 30, "time_s": 1e-6}
    journal = recorded(tmp_path / "r", "ddqn-fast", lanes=2, time_after=9, stop=stop)
    said = compared(journal)
    assert {one.verdict for one in said} == {"identical"}
    assert len(verdicts(said, "proposal")) == len(list(journal.steps()))


def test_a_run_that_was_killed_is_decided_as_far_as_it_goes(tmp_path: Path) -> None:
    """Half of its records: all of them are the same, nothing is said of the rest."""
    journal = recorded(tmp_path / "r", "ddqn-fast", lanes=2, keep=26)
    said = compared(journal)
    assert {one.verdict for one in said} == {"identical"}
    assert len(verdicts(said, "proposal")) == len(list(journal.steps())) > 5


def test_another_seed_is_found_at_the_first_proposal(tmp_path: Path) -> None:
    """The campaign's settings on record were changed: its first design differs, the rest cannot be compared."""
    journal = recorded(tmp_path / "r", "random")
    attachments = journal.attachments()
    campaign = json.loads(attachments["campaign.json"])
    changed = attachments | {"campaign.json": json.dumps({**campaign, "seed": 2}).encode()}
    journal.attachments = lambda: changed  # type: ignore[method-assign]  # as if it had been written so
    said = compared(journal)
    first = said[0]
    assert (first.what, first.verdict, first.sequence) == ("proposal", "differs", 0)
    assert set(verdicts(said[1:], "proposal")) == {"not comparable"}
    assert len(said) == len(list(journal.steps()))


class Changed(RunJournal):
    """A journal one of whose learner's records is another."""

    def __init__(self, folder: Path, number: int, **values: Any) -> None:
        super().__init__(folder)
        self._number, self._values = number, values

    def records(self, *topics: str) -> Any:
        for entry in super().records(*topics):
            if entry.topic != "/agent" or entry.value.number != self._number:
                yield entry
                continue
            plain = json.loads(entry.data) | self._values
            yield replace(entry, data=json.dumps(plain).encode())


@pytest.mark.parametrize(("values", "what"), [
    ({"weights_sha256": "0" * 64}, "weights_sha256"), ({"epsilon": 0.123}, "epsilon"),
    ({"updates": 3}, "episode, greedy, updates"),
])  # fmt: skip
def test_a_changed_learner_is_named(tmp_path: Path, values: dict[str, Any], what: str) -> None:
    """Its proposals stay the same; the record of what it was like does not."""
    recorded(tmp_path / "r", "ddqn-fast")
    said = compared(Changed(tmp_path / "r", 12, **values))
    (found,) = [one for one in said if one.verdict == "differs"]
    assert (found.what, found.step) == (what, "step 12 (lane 0, action 12)")


def test_elsewhere_the_last_bits_of_a_learner_say_nothing(tmp_path: Path) -> None:
    """Other packages: another hash is not comparable, a loss within a thousandth is within tolerance."""
    recorded(tmp_path / "r", "ddqn-fast", stop={"evaluations": 60})
    last = max(RunJournal(tmp_path / "r").learner(), key=lambda one: one.number)
    assert last.loss is not None
    values = {"weights_sha256": "0" * 64, "loss": last.loss * 1.0001}
    said = compared(Changed(tmp_path / "r", last.number, **values), same_machine=False)
    assert [one.what for one in said if one.verdict == "not comparable"] == ["weights_sha256"]
    assert [one.what for one in said if one.verdict == "within tolerance"] == ["loss"]
    assert not [one for one in said if one.verdict == "differs"]


def test_steps_that_were_never_proposed_differ(tmp_path: Path) -> None:
    """A step added at the end of a finished run: the designer has ended before it."""
    journal = recorded(tmp_path / "r", "random")
    steps = list(journal.steps())
    extra = steps[-1].model_copy(update={"number": steps[-1].number + 1})
    again = Journal(tmp_path / "r", {"run": {}}, {})
    again.put([step_record(extra, len(steps), START_NS)], lambda _: None)
    again.finish()
    again.close()
    (found,) = [one for one in compared(RunJournal(tmp_path / "r")) if one.verdict == "differs"]
    assert (found.what, found.sequence) == ("proposal", len(steps))
    assert found.now == "none: the designer has ended"


def test_a_run_of_others_is_not_comparable(tmp_path: Path) -> None:
    """Without the settings of a campaign nobody knows its designer."""
    journal = recorded(tmp_path / "r", "random")
    journal.attachments = dict  # type: ignore[method-assign]  # as if it had none
    (found,) = compared(journal)
    assert (found.verdict, "plan.json" in found.why) == ("not comparable", True)
