"""Level 3 of a replay: designers decide the same from a journal, and what differs is found where it begins."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from agent.auditor import re_decide
from agent.campaign import Runner
from agent.config import Campaign, Stop
from agent.designers import designer
from agent.moves import Space
from agent.progress import WalkEnd
from env_controller.notes import note_records
from luxloop.audit import Compared
from luxloop.campaign import Action, AgentRecord, Begin, Note, Plan, Step
from luxloop.design import Bounds, Design
from luxloop.errors import InputError
from luxloop.journal.chain import Mark
from luxloop.journal.journal import Journal
from luxloop.journal.reader import RunJournal
from luxloop.journal.segment import Segment
from luxloop.journal.topics import Close, NoteRecord, Record, log_record, opening, record, step_record
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
BY_TIME = "time: 5 s"


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
        asked = {"move": action.move, "final": action.final, "role": action.role}
        step = self._controller.act(action).model_copy(update=asked)
        self.records.append(step_record(step, place, START_NS + place))
        if action.agent is not None:
            note = Note(run=self.run, designer="d", agent=action.agent)
            self.records += note_records(note, place, START_NS + place)
        return step


def recorded(folder: Path, name: str, *, lanes: int = 1, failing: int | None = None, keep: int | None = None,
             time_after: int | None = None, **changes: Any) -> RunJournal:  # fmt: skip
    """A run of a designer on disk, ended by its time after so many steps; killed after its first `keep` records."""
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
    found = runner.run(campaign.finalists, without_dbr=kind == "campaign")
    end = ends[0]
    if time_after is not None:
        end, found = end._replace(reason=BY_TIME), replace(found, reason=BY_TIME)
    begin = Begin(plan=plan, designer="d", attachments={"campaign.json": canonical(campaign).decode()})
    note = Note(run=folder.name, designer="d", result=found.summary(), log=end.line)
    at = len(door.records), START_NS
    last = [*note_records(note, *at), log_record(Close(found.reason, complete=True).line, *at)]
    return written(folder, begin, [*door.records, *last] if keep is None else door.records[:keep])


def written(folder: Path, begin: Begin, records: list[Record]) -> RunJournal:
    """A journal of these records."""
    run, attachments = opening(begin)
    journal = Journal(folder, {"run": run, "environment": {}}, attachments)
    journal.put(records, lambda _: None)
    journal.finish()
    journal.close()
    return RunJournal(folder)


def forged(journal: RunJournal, change: Callable[[Record], Record | None], **files: bytes) -> RunJournal:
    """The same run with changed records and files and a chain that is right: what a forger with our code can make."""
    folder, segment = journal.folder.with_name("forged"), journal.segments[0]
    folder.mkdir()
    metadata, attachments = dict(segment.opening[0]), dict(segment.opening[1])
    out = Segment(folder / "audit-0001.mcap", Mark(), metadata, attachments | files)
    for entry in filter(None, map(change, segment.records())):
        out.write(entry)
        out.commit()
    out.finish()
    return RunJournal(folder)


def step_as(at: tuple[int, int], **values: Any) -> Callable[[Record], Record]:
    """Changes the step of a lane and number."""

    def change(entry: Record) -> Record:
        if entry.topic != "/step" or (entry.value.lane, entry.value.number) != at:
            return entry
        return step_record(entry.value.model_copy(update=values), entry.sequence, entry.log_time_ns)

    return change


def first_of(said: list[Compared]) -> Compared:
    """The first difference in the order of the journal."""
    return min((one for one in said if one.verdict == "differs"), key=lambda one: one.sequence % (1 << 32))


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
    assert sum(one.what.startswith("result, ") for one in said) == 8


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


@pytest.mark.parametrize("older", [False, True])
def test_a_saturation_is_counted_again_also_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, older: bool
) -> None:
    """Older runs counted episodes that had only begun; a count that is neither is named."""
    now = Runner.saturation
    with monkeypatch.context() as patch:
        if older:
            patch.setattr(Runner, "saturation", lambda runner, _: now(runner, 0))
        stop = {"evaluations": 200, "episodes_without_gain": 3}
        journal = recorded(tmp_path / "r", "ddqn-fast", lanes=3, stop=stop)
    assert {one.verdict for one in compared(journal)} == {"identical"}

    def change(entry: Record) -> Record:
        if entry.topic != "/log" or "saturation" not in entry.value.message or "after" not in entry.value.message:
            return entry
        line = entry.value.message.replace(" in 3 episodes", " in 4 episodes")
        return log_record(line, entry.sequence, entry.log_time_ns, name=entry.value.name)

    found = first_of(compared(forged(journal, change)))
    assert found.what == ("proposal" if older else "end of the walk"), "an older walk goes on by the count of today"


def test_a_run_that_was_killed_is_decided_as_far_as_it_goes(tmp_path: Path) -> None:
    """Half of its records: all of them are the same, nothing is said of the rest."""
    journal = recorded(tmp_path / "r", "ddqn-fast", lanes=2, keep=26)
    said = compared(journal)
    assert {one.verdict for one in said} == {"identical"}
    assert len(verdicts(said, "proposal")) == len(list(journal.steps())) > 5


@pytest.mark.parametrize("name", ["ddqn-fast", "pattern", "random"])
def test_a_run_that_was_killed_while_its_first_lane_was_behind_is_the_same(tmp_path: Path, name: str) -> None:
    """A slow design: three other lanes' steps of the round are on record, and were asked for."""
    whole = recorded(tmp_path / "whole", name, lanes=4)
    files = {"campaign.json": whole.attachments()["campaign.json"].decode()}
    begin = Begin(plan=whole.attached("plan.json", Plan), designer="d", attachments=files)
    kept = [one for one in whole.records("/step", "/agent") if one.value.number < 3 + (one.value.lane > 0)]
    said = compared(written(tmp_path / "killed", begin, kept))
    assert {one.verdict for one in said} == {"identical"}
    assert len(verdicts(said, "proposal")) == 4 * 3 + 3


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
    last = max((entry.value for entry in RunJournal(tmp_path / "r").records("/agent")), key=lambda one: one.number)
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


def test_a_step_under_another_number_differs(tmp_path: Path) -> None:
    """The designer comes to a hole, and never asks for what is behind it: neither is the journal's end."""
    journal = recorded(tmp_path / "r", "random", lanes=2)
    said = compared(forged(journal, step_as((1, 1), number=70_000)))
    first = first_of(said)
    assert (first.what, first.step) == ("proposal", "step 3 (lane 1, action 70000)")
    assert first.now == "the designer never asks for it"
    hole = [one for one in said if one.logged == "not on record"]
    assert [(one.verdict, one.step) for one in hole] == [("differs", "lane 1, action 1")]


def test_steps_behind_a_hole_differ_in_a_killed_run_too(tmp_path: Path) -> None:
    """Nobody can have asked for them."""
    journal = recorded(tmp_path / "r", "random", lanes=2, keep=20)
    said = compared(forged(journal, lambda one: None if one.sequence == 3 else one))
    assert verdicts(said, "proposal").count("differs") == 10 - 1 - 4  # all behind it but for what was under way
    assert first_of(said).now == "the designer never asks for it"


@pytest.mark.parametrize("left", ["/note", "/log", "both"])
def test_a_final_step_that_is_missing_differs_where_the_run_was_over(tmp_path: Path, left: str) -> None:
    """Its result on record or the last line of its log says so; without either it was killed there."""
    journal = recorded(tmp_path / "r", "random")
    last = max(one.sequence for one in journal.records("/step"))
    gone = {"/note": {"/log"}, "/log": {"/note"}, "both": set[str]()}[left]

    def change(entry: Record) -> Record | None:
        return None if entry.topic in gone or (entry.topic == "/step" and entry.sequence == last) else entry

    (found,) = [
        one for one in compared(forged(journal, change)) if one.verdict == "differs" and one.what == "proposal"
    ]
    assert (found.logged, found.why) == ("not on record", "the run is over")
    assert "without_dbr" in found.now


def test_a_run_that_was_stopped_may_end_anywhere(tmp_path: Path) -> None:
    """`stopped:` in its log: it may be gone on with."""
    journal = recorded(tmp_path / "r", "random", keep=20)
    begin = Begin(plan=journal.attached("plan.json", Plan), designer="d")
    stopped = log_record(Close("interrupted", complete=False).line, 10, START_NS)
    written(tmp_path / "r", begin, [stopped])
    assert {one.verdict for one in compared(RunJournal(tmp_path / "r"))} == {"identical"}


def test_another_move_differs(tmp_path: Path) -> None:
    """A move that is said to have been a design that was asked for would be rewarded as a beginning."""
    journal = recorded(tmp_path / "r", "ddqn-fast")
    moved = next(step for step in journal.steps() if step.move)
    said = compared(forged(journal, step_as((0, moved.number), move=None)))
    (found,) = [one for one in said if one.verdict == "differs"]
    assert (found.what, found.sequence) == ("move", moved.number)
    assert found.now.startswith(moved.move.variable if moved.move else "")


def test_a_learner_that_left_nothing_differs(tmp_path: Path) -> None:
    """Every designer sends a record with each step of its walk: all of them were removed."""
    journal = recorded(tmp_path / "r", "ddqn-fast")
    said = compared(forged(journal, lambda one: None if one.topic == "/agent" else one))
    walked = sum(not step.final for step in journal.steps())
    assert verdicts(said, "learner") == ["differs"] * walked
    assert first_of(said).logged == "nothing of the learner on record"


@pytest.mark.parametrize(("number", "final"), [(3, False), (70_000, False), (31, True)])
def test_one_more_record_of_the_learner_differs(tmp_path: Path, number: int, final: bool) -> None:
    """A second one with a step, one without a step, one with a final step."""
    journal = recorded(tmp_path / "r", "random")
    assert final is any(step.final for step in journal.steps() if step.number == number)
    begin = Begin(plan=journal.attached("plan.json", Plan), designer="d")
    more = Note(run="r", designer="d", agent=AgentRecord(lane=0, number=number, episode=9))
    said = compared(written(tmp_path / "r", begin, note_records(more, 35, START_NS)))
    (found,) = [one for one in said if one.verdict == "differs"]
    assert (found.what, found.step) == ("learner", f"step 35 (lane 0, action {number})")
    assert found.logged == "one more record, of episode 9"


@pytest.mark.parametrize(("name", "value"), [
    ("reason", "budget: 31 evaluations"), ("steps", 31), ("evaluations", 29), ("episodes", 7), ("start", None),
    ("best", {"uniformity": 0.99}), ("without_dbr", {}), ("finalists", []),
])  # fmt: skip
def test_a_changed_result_is_named(tmp_path: Path, name: str, value: Any) -> None:
    """What is said to have been found is what the designer finds again."""

    def change(entry: Record) -> Record:
        if entry.topic != "/note":
            return entry
        told = entry.value.result[name]
        values = {**told, **value} if isinstance(told, dict) and value else value
        words = NoteRecord(run="r", designer="d", result={**entry.value.result, name: values})
        return record("/note", words, entry.sequence, entry.log_time_ns)

    said = compared(forged(recorded(tmp_path / "r", "ddqn-fast"), change))
    (found,) = [one for one in said if one.verdict == "differs"]
    assert found.what == f"result, {name}"
    if name == "best":
        assert found.logged == {"best.uniformity": 0.99}


@pytest.mark.parametrize("topic", ["/note", "/log"])
def test_a_result_and_an_end_that_are_gone_differ(tmp_path: Path, topic: str) -> None:
    """Of a run that was over."""
    journal = recorded(tmp_path / "r", "random")

    def change(entry: Record) -> Record | None:
        gone = entry.topic == topic and (topic == "/note" or not entry.value.message.startswith("ended:"))
        return None if gone else entry

    differs = [one for one in compared(forged(journal, change)) if one.verdict == "differs"]
    assert {one.what.partition(",")[0] for one in differs} == {"result" if topic == "/note" else "end of the walk"}


def test_an_end_by_time_is_not_believed_where_no_time_was_set(tmp_path: Path) -> None:
    """Else a forger could end any walk where he likes."""
    journal = recorded(tmp_path / "r", "random", time_after=9)
    found = first_of(compared(journal))
    assert (found.what, found.sequence) == ("proposal", 9)
    assert "final (finalist)" in found.logged
    assert "final" not in found.now


@pytest.mark.parametrize("name", ["plan.json", "campaign.json"])
@pytest.mark.parametrize("data", [b"{not json", b"\xff\xfe", b'{"run":"x"}'])
def test_a_file_that_is_none_is_named(tmp_path: Path, name: str, data: bytes) -> None:
    """Its name, and no traceback."""
    journal = forged(recorded(tmp_path / "r", "random"), lambda one: one, **{name: data})
    with pytest.raises(InputError, match=name):
        compared(journal)
