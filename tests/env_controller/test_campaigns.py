"""Runs at the controller, message by message: opened, acted in, recorded, ended; whoever does what wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from env_controller import campaigns, past
from env_controller.audit.checks import verify
from env_controller.trials import Past
from luxloop.bus import Asked, Presence
from luxloop.bus.frame import decode, encode
from luxloop.bus.keys import HOLD_S, at
from luxloop.campaign import Action, AgentRecord, Begin, Begun, End, Ended, Move, Note, Step
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.journal.journal import Journal
from luxloop.journal.segment import SIDE_FILE
from luxloop.journal.topics import ValidationStep, opening
from luxloop.messages import Nothing, Receipt
from luxloop.words import Words
from tests.env_controller.desk import DESIGN, WAIT_S, Desk, plan, refusal, written
from tests.local_bus import LocalBus


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    """A controller whose runs lie in a folder of their own."""
    desk = Desk(tmp_path / "runs")
    yield desk
    desk.controller._campaigns.stop()


def test_a_run_from_begin_to_end_is_on_record(desk: Desk, tmp_path: Path) -> None:
    """Request, reply and map of each task, the steps in order, the learner's notes, the end and its reason."""
    begun = desk.begin(attachments={"model.toml": "x = 1"}, facts={"argv": ["campaign"]})
    assert isinstance(begun, Begun)
    first = desk.evaluated(0)
    desk.uniformity = 0.85
    second = desk.evaluated(1, move=Move(variable="width_um", steps=1))
    agent = AgentRecord(lane=0, number=1, epsilon=0.5, loss=0.25)
    noted = desk.put("note", Note(run="one", designer="d", agent=agent, log="hello"), name="one").wait()
    assert noted == Receipt(accepted=True)
    ended = desk.end()
    assert isinstance(ended, Ended)
    records = written(tmp_path)
    topics = [record.topic for record in records if record.topic != "/chain"]
    assert [topic for topic in topics if topic == "/step"] == ["/step"] * 2
    assert topics.index("/request/film") < topics.index("/reply/film") < topics.index("/request/ray")
    assert topics.index("/reply/ray") < topics.index("/step")
    assert {"/map/sim", "/agent", "/log"} <= set(topics)
    steps = [record.value for record in records if record.topic == "/step"]
    assert steps == [first, second]
    assert [record.sequence for record in records if record.topic == "/step"] == [0, 1]
    assert second.reward == pytest.approx(0.5)
    assert ended.records >= len(records)


def test_a_comparison_with_measurements_is_on_record_with_its_residuals(desk: Desk, tmp_path: Path) -> None:
    """The step as it was told; a map per shot, named by it; what is no such step is refused."""
    desk.begin(plan(kind="validation"))
    told = {
        "command": "compare", "model_sha256": "a" * 64, "dataset_sha256": "b" * 64,
        "seed": "1", "tasks": ("c" * 64,), "document": {"structure": {"p": 0.25}},
    }  # fmt: skip
    maps = {"array-5.5": ((0.5, -1.5), (2.0, 0.0), (1.0, 3.0))}
    note = Note(run="one", designer="d", validation=told, residual_maps=maps)
    assert desk.put("note", note, name="one").wait() == Receipt(accepted=True)
    wrong = Note(run="one", designer="d", validation=told | {"dataset_sha256": "none"})
    assert refusal(desk.put("note", wrong, name="one").wait()).field == "validation: dataset_sha256"
    desk.end()
    records = {record.topic: record for record in written(tmp_path)}
    assert records["/validation"].value == ValidationStep(run="one", **told)
    np.testing.assert_array_equal(records["/map/residual"].value, maps["array-5.5"])
    assert b"array-5.5" in records["/map/residual"].data


def test_a_note_asked_twice_is_on_record_once(desk: Desk, tmp_path: Path) -> None:
    """Its answer was lost; another number is another note, also of the same text; so is each without one."""
    desk.begin()
    for number in (0, 0, 1, None, None):
        note = Note(run="one", designer="d", number=number, log="the walk ended")
        assert desk.put("note", note, name="one").wait() == Receipt(accepted=True)
    desk.end()
    lines = [record.value.message for record in written(tmp_path) if record.topic == "/log"]
    assert lines.count("the walk ended") == 4


def test_a_step_is_told_only_once_it_is_on_the_disk(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """While the journal still writes, the question stays open."""
    desk.begin()
    put, held = desk.controller._campaigns._runs["one"].journal.put, []
    monkeypatch.setattr(desk.controller._campaigns._runs["one"].journal, "put", lambda r, d: held.append((r, d)))
    question = desk.act()
    desk.work("film")
    desk.work("ray")
    assert question.message is None
    for records, done in held:
        put(records, done)
    assert isinstance(question.wait(), Step)


def test_an_action_that_comes_before_the_disk_has_the_last_one_gets_its_own_step(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each question is answered with the step of its number."""
    desk.begin()
    journal = desk.controller._campaigns._runs["one"].journal
    put, held = journal.put, []
    monkeypatch.setattr(journal, "put", lambda records, done: held.append((records, done)))
    first = desk.act(0)
    desk.work("film")
    desk.work("ray")
    second = desk.act(1, move=Move(variable="width_um", steps=1))
    monkeypatch.undo()
    for records, done in held:
        put(records, done)
    assert getattr(first.wait(), "number", None) == 0
    assert second.message is None
    desk.work("ray")
    assert getattr(second.wait(), "number", None) == 1


def test_an_action_asked_twice_is_one(desk: Desk) -> None:
    """The older question is let go; asked again later, the same step comes at once."""
    desk.begin()
    first = desk.act()
    second = desk.act()
    assert first.message == Nothing()
    desk.work("film")
    desk.work("ray")
    step = second.wait()
    assert desk.act().message == step
    assert desk.work("ray") is None
    other = desk.act(design=DESIGN.model_copy(update={"width_um": 40.0})).message
    assert refusal(other).code == "refused"


def test_a_question_is_let_go_when_its_hold_is_over(desk: Desk) -> None:
    """The designer asks again and loses nothing."""
    desk.begin()
    question = desk.act()
    desk.controller._campaigns.tick(time.monotonic() + HOLD_S + 1.0)
    assert question.message == Nothing()
    again = desk.act()
    desk.work("film")
    desk.work("ray")
    assert isinstance(again.wait(), Step)


def test_a_run_that_exists_is_not_opened_again(desk: Desk) -> None:
    """Not while it is open, not by another designer, not after its end; the same begin twice is one."""
    assert desk.begin() == desk.begin()
    assert refusal(desk.begin(designer="other")).code == "refused"
    assert refusal(desk.act(designer="other").message).message.count("in use by d") == 1
    desk.end()
    assert "exists" in refusal(desk.begin()).message
    assert refusal(desk.act().message).code == "not_found"


def test_an_end_asked_twice_is_one(desk: Desk) -> None:
    """The second answer is the first."""
    desk.begin()
    assert desk.end() == desk.end()
    assert refusal(desk.end(designer="other")).code == "not_found"


def test_a_run_may_end_for_a_reason_of_4000_letters(desk: Desk) -> None:
    """Who waits in one of its lanes is told so in fewer."""
    desk.begin()
    waits = desk.act()
    ended = desk.put("end", End(run="one", designer="d", reason="x" * 4000), name="one").message
    assert isinstance(ended, Ended)
    assert refusal(waits.message).code == "refused"


def test_what_the_controller_kept_of_an_earlier_run_costs_a_later_one_nothing(desk: Desk, tmp_path: Path) -> None:
    """Known before: no computing time; what came of it is on record all the same, with its map."""
    desk.begin(plan("one", maps=True))
    first = desk.evaluated(run="one")
    desk.begin(plan("two", maps=True))
    second = desk.act(run="two").wait()
    assert isinstance(second, Step)
    assert (first.cached, first.physics_s) == (False, pytest.approx(0.2))
    assert (second.cached, second.physics_s) == (True, 0.0)
    assert second.content() == first.content()
    desk.end("two")
    assert {"/reply/film", "/reply/ray", "/map/sim"} <= {record.topic for record in written(tmp_path, "two")}


def test_two_runs_at_once_have_their_own_journals(desk: Desk, tmp_path: Path) -> None:
    """One computation serves both; each has it on record."""
    desk.begin(plan("one"))
    desk.begin(plan("two"))
    one, two = desk.act(run="one"), desk.act(run="two")
    desk.work("film")
    desk.work("ray")
    assert isinstance(one.wait(), Step)
    assert isinstance(two.wait(), Step)
    assert desk.work("ray") is None
    desk.end("one")
    desk.end("two")
    assert {path.name for path in (tmp_path / "runs").iterdir()} == {"one", "two"}


def test_a_folder_that_cannot_be_written_is_refused_at_the_begin(tmp_path: Path) -> None:
    """Before anything is computed, naming the folder."""
    (tmp_path / "runs").write_text("a file")
    desk = Desk(tmp_path / "runs")
    failure = refusal(desk.begin())
    assert str(tmp_path / "runs") in failure.message
    assert failure.mend


def test_a_designer_that_has_gone_ends_its_run(desk: Desk, tmp_path: Path) -> None:
    """Nothing heard of it, no question open: the journal is finished with the reason, its tasks are withdrawn."""
    desk.begin()
    desk.act()
    later_s = time.monotonic() + HOLD_S + 1.0
    desk.controller._campaigns.tick(later_s)
    assert desk.controller._campaigns.runs == ("one",)
    desk.controller._campaigns.tick(later_s + campaigns.SILENT_S)
    assert desk.controller._campaigns.runs == ()
    assert desk.controller.core.tasks == {}
    lines = [record.value for record in written(tmp_path) if record.topic == "/log"]
    assert "nothing heard of its designer" in str(lines[-1])


def test_a_silent_designer_that_lives_keeps_its_run(desk: Desk) -> None:
    """A fit with Monte Carlo asks workers for minutes, and tells its run nothing; without its token it has gone."""
    campaigns_of = desk.controller._campaigns
    desk.begin(plan(kind="validation"))
    later_s = time.monotonic() + 10.0 * campaigns.SILENT_S
    with LocalBus(desk.router) as bus:
        bus.announce(at("luxloop", "alive", role="designer", name="d"))
        campaigns_of.tick(later_s)
        assert "one" in campaigns_of.runs
    campaigns_of.tick(later_s)
    assert not campaigns_of.runs


def test_no_run_is_closed_while_the_router_does_not_say_who_is_there(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A router that is started again answers nobody for a moment: its designers are not gone."""

    def silent(*_: object) -> None:
        raise RemoteError(Failure(code="no_router", message="no router"))

    campaigns_of = desk.controller._campaigns
    desk.begin()
    with monkeypatch.context() as patched:
        patched.setattr(LocalBus, "present", silent)
        campaigns_of.tick(time.monotonic() + 10.0 * campaigns.SILENT_S)
        assert "one" in campaigns_of.runs
    campaigns_of.tick(time.monotonic() + 10.0 * campaigns.SILENT_S)
    assert not campaigns_of.runs


def test_the_end_of_a_run_that_was_closed_for_silence_is_its_own(tmp_path: Path) -> None:
    """Opened again by its designer it ends anew: records and root of the whole, not those it was closed with."""
    desk = Desk(tmp_path)
    desk.begin()
    desk.controller._campaigns.tick(time.monotonic() + 2.0 * campaigns.SILENT_S)
    question = desk.put("begin", Begin(plan=plan(), designer="d", resume=True))
    event = desk.controller._inbox.take(WAIT_S)  # asked once more when the journal has been read
    assert event is not None
    desk.controller.take(event)
    assert isinstance(question.wait(), Begun)
    assert desk.put("note", Note(run="one", designer="d", log="late"), name="one").wait() == Receipt(accepted=True)
    ended = desk.end()
    assert isinstance(ended, Ended)
    assert not desk.controller._campaigns.runs
    assert (tmp_path / "one" / "audit.sha256").read_text().split() == [ended.root, str(ended.records)]
    assert desk.end() == ended


def test_a_controller_that_stops_finishes_its_journals(desk: Desk, tmp_path: Path) -> None:
    """Root and count are in the file."""
    desk.begin()
    desk.evaluated(0)
    desk.controller._campaigns.stop()
    assert (tmp_path / "runs" / "one" / "audit.sha256").exists()


def test_a_controller_that_is_taken_over_from_finishes_its_journals(desk: Desk, tmp_path: Path) -> None:
    """Whatever ends it; and who waits is told only when the next one may open the run."""
    desk.begin()
    side_file = tmp_path / "runs" / "one" / "audit.sha256"
    told: list[tuple[Words, bool]] = []

    def answer(frame: bytes) -> None:
        told.append((decode(frame).message, side_file.exists()))

    action = Action(run="one", designer="d", lane=0, number=0, design=DESIGN)
    desk.controller.take(Asked(at("luxloop", "act", name="one"), encode(action), answer, lambda: None))
    later = at("luxloop", "alive", role="controller", kind="controller", name="z")
    desk.controller._inbox.offer(Presence(later, alive=True))
    with pytest.raises(RemoteError, match="has taken over"):
        desk.controller.run(threading.Event())
    ((message, finished),) = told
    assert refusal(message).code == "not_found"
    assert finished


def test_a_finalist_has_its_line_on_record(desk: Desk, tmp_path: Path) -> None:
    """With the errors of its points; a step of the walk has none."""
    desk.begin()
    arrays = {"map_lx": np.ones((4, 4)), "cut_x_um": np.arange(3.0), "cut_lx": np.ones(3), "cut_error_lx": np.ones(3)}
    question = desk.act(0, design=DESIGN, final=True, seed="7")
    desk.work("film")
    desk.work("ray", arrays=arrays)
    step = question.wait()
    assert isinstance(step, Step)
    assert step.cut is not None
    assert step.cut.x_um == (0.0, 1.0, 2.0)
    assert [record.value for record in written(tmp_path) if record.topic == "/step"] == [step]
    assert desk.evaluated(1, design=DESIGN).cut is None


def test_a_grid_keeps_the_maps_of_its_best(desk: Desk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of those that were among the best so far; every step is on record all the same."""
    monkeypatch.setattr(campaigns, "BEST_MAPS", 2)
    desk.begin(plan(kind="grid", maps=False))
    for number, uniformity in enumerate((0.5, 0.6, 0.4, 0.7, 0.3)):
        desk.uniformity = uniformity
        desk.evaluated(number, design=DESIGN.model_copy(update={"width_um": 30.0 + 2.0 * number}))
    desk.end()
    records = written(tmp_path)
    assert [record.sequence for record in records if record.topic == "/map/sim"] == [0, 1, 3]
    assert sum(record.topic == "/step" for record in records) == 5


def test_a_begin_whose_answer_was_lost_with_its_controller_is_answered_by_the_next(tmp_path: Path) -> None:
    """The same designer goes on in a second segment; to another one the id is taken."""
    first = Desk(tmp_path)
    assert isinstance(first.begin(), Begun)
    first.controller._campaigns._runs["one"].journal.close()  # as a kill leaves it
    second = Desk(tmp_path)
    assert "exists" in getattr(second.begin(designer="e"), "message", "")
    question = second.put("begin", Begin(plan=plan(), designer="d"))
    event = second.controller._inbox.take(WAIT_S)  # asked once more when the journal has been read
    assert event is not None
    second.controller.take(event)
    begun = question.wait()
    assert isinstance(begun, Begun)
    assert (begun.segment, begun.steps) == (2, 0)
    second.controller._campaigns.stop()


@pytest.mark.parametrize("written_since", [False, True])
def test_a_run_goes_on_from_where_its_journal_was_verified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written_since: bool
) -> None:
    """In the controller's thread nothing is read; where somebody has written since then, it is verified once more."""
    first = Desk(tmp_path)
    first.begin()
    first.evaluated()
    first.controller._campaigns.stop()
    second = Desk(tmp_path)
    question = second.put("begin", Begin(plan=plan(), designer="e", resume=True))
    event = second.controller._inbox.take(WAIT_S)
    assert event is not None
    if written_since:
        facts, files = opening(Begin(plan=plan(), designer="x"))
        journal = Journal(tmp_path / "one", {"run": facts, "environment": {}}, files)
        journal.finish()
        journal.close()
    monkeypatch.setattr("luxloop.journal.journal.tail_of", lambda _: pytest.fail("its last segment was read"))
    second.controller.take(event)
    if written_since:
        assert question.message is None
        event = second.controller._inbox.take(WAIT_S)
        assert event is not None
        second.controller.take(event)
    begun = question.wait()
    assert isinstance(begun, Begun)
    assert begun.segment == 2 + written_since
    second.evaluated(1, designer="e", move=Move(variable="width_um", steps=1))
    second.end(designer="e")
    assert {finding.verdict for finding in verify(tmp_path / "one", None, None).findings} == {"ok"}


def test_who_asks_for_a_run_whose_journal_takes_long_to_read_comes_back(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Answered within the hold; the journal is read once; what nobody comes back for is not kept."""
    desk.begin()
    desk.end()
    read, reads = threading.Event(), list[str]()

    def slow(folder: Path, begin: Begin) -> Past:
        reads.append(begin.designer)
        assert read.wait(WAIT_S)
        raise RemoteError(Failure(code="refused", message="read"))

    monkeypatch.setattr(past, "read_back", slow)
    reader = desk.controller._campaigns._reader
    first = desk.put("begin", Begin(plan=plan(), designer="d", resume=True))
    desk.controller._campaigns.tick(time.monotonic() + HOLD_S + 1.0)
    assert first.message == Nothing()
    second = desk.put("begin", Begin(plan=plan(), designer="d", resume=True))
    read.set()
    event = desk.controller._inbox.take(WAIT_S)
    assert event is not None
    assert len(reader._pasts) == 1
    desk.controller._campaigns.tick(time.monotonic() + past.KEPT_S + 1.0)
    assert not reader._pasts
    assert (second.message, reads) == (None, ["d"])


@pytest.mark.parametrize("segments", [1, 2])
def test_an_end_whose_side_file_was_not_written_is_told_by_the_journal(
    desk: Desk, tmp_path: Path, segments: int
) -> None:
    """A controller that was killed between the two: none is there, or that of the segment before."""
    desk.begin()
    desk.evaluated(0)
    folder, before = tmp_path / "runs" / "one", b""
    if segments == 2:
        desk.put("end", End(run="one", designer="d", reason="interrupted", complete=False), name="one").wait()
        before = (folder / SIDE_FILE).read_bytes()
        question = desk.put("begin", Begin(plan=plan(), designer="e", resume=True))
        event = desk.controller._inbox.take(WAIT_S)  # asked once more when the journal has been read
        assert event is not None
        desk.controller.take(event)
        assert isinstance(question.wait(), Begun)
        desk.evaluated(1, designer="e", move=Move(variable="width_um", steps=1))
    designer = "e" if segments == 2 else "d"
    end = End(run="one", designer=designer, reason="enough", complete=True)
    ended = desk.put("end", end, name="one").wait()
    assert isinstance(ended, Ended)
    side, true = folder / SIDE_FILE, (folder / SIDE_FILE).read_bytes()
    side.write_bytes(before) if before else side.unlink()
    assert past.ended_before(folder, end) == ended
    assert side.read_bytes() == true


def test_a_run_that_lies_elsewhere_is_told_so(tmp_path: Path) -> None:
    """Not that its journal is damaged: this controller keeps its runs in another folder."""
    with pytest.raises(RemoteError, match=f"its runs in {tmp_path}, where there is no folder of a run elsewhere"):
        past.read_back(tmp_path / "elsewhere", Begin(plan=plan(), designer="d", resume=True))


def test_a_taken_id_is_refused_without_reading_its_steps(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first commit says that there is a run."""
    desk.begin()
    desk.evaluated()
    desk.end()
    monkeypatch.setattr("luxloop.journal.reader.Scan", lambda _: pytest.fail("its journal was read"))
    assert "exists" in refusal(desk.begin(designer="e")).message


@pytest.mark.parametrize("text", [b"what is this", b"f00 7\n", b"\xff"])
def test_an_end_with_a_damaged_side_file_is_not_known(tmp_path: Path, text: bytes) -> None:
    """Asked again at the next controller: not found, as where there is none."""
    first = Desk(tmp_path)
    first.begin()
    first.end()
    (tmp_path / "one" / "audit.sha256").write_bytes(text)
    assert refusal(Desk(tmp_path).end()).code == "not_found"


@pytest.mark.parametrize("committed", [False, True])
def test_an_id_of_which_nothing_was_committed_is_free(tmp_path: Path, committed: bool) -> None:
    """A controller that died within its first write takes no id away; one that had committed does."""
    first = Desk(tmp_path)
    first.begin()
    first.controller._campaigns.stop()
    segment = tmp_path / "one" / "audit-0001.mcap"
    segment.write_bytes(segment.read_bytes()[: None if committed else 100])
    second = Desk(tmp_path)
    answer = second.begin(designer="e")
    if committed:
        assert "luxloop campaign resume one" in refusal(answer).mend
    else:
        assert isinstance(answer, Begun)
        assert answer.segment == 2
    second.controller._campaigns.stop()
