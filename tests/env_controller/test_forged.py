"""`luxloop audit replay`: what was changed in a journal with a right chain is found and named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from luxloop.errors import InputError
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import Record as Entry
from luxloop.journal.topics import map_record, record
from tests.env_controller.golden_runs import (
    BEST,
    GOLDEN,
    NAMES,
    WALK,
    app,
    ask,
    named,
    planted,
    seed_changed,
    step_at,
    step_changed,
)


def test_a_changed_reward_is_named_at_level_2(tmp_path: Path) -> None:
    """The chain is right; the step and both rewards are told."""
    reward = step_at(WALK).reward
    folder = planted(tmp_path / "r", step_changed(WALK, reward=reward + 0.01))
    assert ask(folder, 1)[0] == 0
    code, document = ask(folder, 2)
    assert (code, named(document), document["counts"]["differs"]) == (4, (WALK, "reward"), 1)
    assert document["first_difference"]["logged"] == pytest.approx(document["first_difference"]["now"] + 0.01)
    assert "lane 0, action 1" in document["first_difference"]["step"]


def test_a_changed_pixel_is_named_at_level_2(tmp_path: Path) -> None:
    """One pixel of one map, by its last bit: the hash that came with the reply is another."""

    def change(entry: Entry) -> Entry:
        if entry.topic != "/map/sim" or entry.sequence != WALK:
            return entry
        pixels = entry.value.copy()
        pixels[3, 5] = np.nextafter(pixels[3, 5], np.float32(0.0))
        return map_record(pixels, WALK, entry.log_time_ns)

    folder = planted(tmp_path / "r", change)
    assert ask(folder, 1)[0] == 0
    code, document = ask(folder, 2)
    assert (code, named(document), document["counts"]["differs"]) == (4, (WALK, "map"), 1)


def test_a_changed_action_is_named_at_levels_2_and_3(tmp_path: Path) -> None:
    """Another design, with the state that belongs to it: its move does not lead there, nor was it proposed."""
    step = step_at(WALK)
    design = step.design.model_copy(update={"width_um": step.design.width_um + 2.0})
    state = (step.state[0], step.state[1] + 2.0 / 45.0, *step.state[2:])
    folder = planted(tmp_path / "r", step_changed(WALK, design=design, state=state))
    assert ask(folder, 1)[0] == 0
    code, document = ask(folder, 2)
    assert (code, named(document), document["counts"]["differs"]) == (4, (WALK, "design"), 2)
    assert document["first_difference"]["now"] == {"width_um": step.design.width_um}
    code, document = ask(folder, 3)
    assert (code, named(document)) == (4, (WALK, "proposal"))
    assert str(design) in document["first_difference"]["logged"]
    assert document["reasons"]["proposal, not comparable"] == {"an earlier proposal differs": 8}


def test_a_design_that_was_not_asked_of_the_workers_is_named_at_level_2(tmp_path: Path) -> None:
    """Said to have been asked for as a design, so that no move tells: its request is of another one."""
    step = step_at(WALK)
    design = step.design.model_copy(update={"width_um": step.design.width_um + 2.0})
    state = (step.state[0], step.state[1] + 2.0 / 45.0, *step.state[2:])
    code, document = ask(planted(tmp_path / "r", step_changed(WALK, design=design, state=state, move=None)), 2)
    assert (code, named(document)) == (4, (WALK, "ray request"))
    assert document["first_difference"]["logged"] == {"design.width_um": step.design.width_um}


@pytest.mark.parametrize("name", NAMES)
def test_a_move_is_no_beginning(tmp_path: Path, name: str) -> None:
    """All rewards of moves set to 0, as a beginning has it, and all that the learner left removed: both levels."""
    moved = [
        one.sequence for one in RunJournal(GOLDEN / name).records("/step") if one.value.move and one.value.reward
    ]
    assert len(moved) >= 3

    def change(entry: Entry) -> Entry | None:
        return None if entry.topic == "/agent" else step_changed(entry.sequence, reward=0.0)(entry)

    folder = planted(tmp_path / "r", change, name)
    assert ask(folder, 1)[0] == 0
    code, document = ask(folder, 2)
    assert (code, named(document)) == (4, (moved[0], "reward"))
    assert document["counts"]["differs"] == len(moved)
    code, document = ask(folder, 3)
    assert (code, document["compared"]["learner"]) == (4, {"differs": 6})
    assert document["first_difference"]["logged"] == "nothing of the learner on record"


def test_a_final_step_that_was_removed_is_named_at_level_3(tmp_path: Path) -> None:
    """The last one, with all its records: nothing is missing in the sequence, but the run was over."""
    last = max(one.sequence for one in RunJournal(GOLDEN / NAMES[0]).records("/step"))
    keep = ("/note", "/log")
    folder = planted(tmp_path / "r", lambda one: None if one.sequence == last and one.topic not in keep else one)
    assert ask(folder, 1)[0] == ask(folder, 2)[0] == 0
    code, document = ask(folder, 3)
    assert (code, document["counts"]["differs"]) == (4, 1)
    first = document["first_difference"]
    assert (first["step"], first["what"], first["logged"]) == (f"lane 0, action {last}", "proposal", "not on record")


def test_a_step_under_another_number_breaks_the_journal(tmp_path: Path) -> None:
    """It is level 1 that finds it, of whatever level was asked for: nothing is compared."""
    folder = planted(tmp_path / "r", step_changed(5, number=70_000))
    for level in (1, 2, 3):
        code, document = ask(folder, level)
        assert (code, document["counts"]["identical"]) == (5, 0)
        found = " ".join(one["found"] for one in document["findings"] if one["verdict"] == "broken")
        assert "step 5 is action 70,000 of lane 0, where action 5 is due" in found


@pytest.mark.parametrize("topic", ["/step", "/agent"])
def test_a_record_that_is_none_breaks_the_journal(tmp_path: Path, topic: str) -> None:
    """With exit 5, and no usage error."""
    folder = planted(
        tmp_path / "r",
        lambda one: replace(one, data=b"{not json") if one.topic == topic and one.sequence == 1 else one,
    )
    for level in (1, 2, 3):
        assert ask(folder, level)[0] == 5


def test_a_journal_of_another_format_is_not_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It says in which it was written."""
    with monkeypatch.context() as patch:
        patch.setattr("luxloop.journal.segment.FORMAT", "2")
        folder = planted(tmp_path / "r", lambda one: one)
    code, document = ask(folder, 2)
    assert (code, document["counts"]["identical"]) == (5, 0)
    assert any(one["found"] == "written in format 2; this release reads 1" for one in document["findings"])


def test_a_result_that_was_changed_is_named_at_level_3(tmp_path: Path) -> None:
    """A hundredth of a point on the best uniformity."""

    def change(entry: Entry) -> Entry:
        if entry.topic != "/note":
            return entry
        result = json.loads(json.dumps(entry.value.result))
        result["best"]["uniformity"] += 1e-4
        words = entry.value.model_copy(update={"result": result})
        return record("/note", words, entry.sequence, entry.log_time_ns)

    folder = planted(tmp_path / "r", change)
    assert ask(folder, 2)[0] == 0
    code, document = ask(folder, 3)
    assert (code, document["counts"]["differs"]) == (4, 1)
    first = document["first_difference"]
    assert first["what"] == "result, best"
    assert first["logged"]["best.uniformity"] == pytest.approx(first["now"]["best.uniformity"] + 1e-4)


@pytest.mark.parametrize("level", [2, 3])
@pytest.mark.parametrize("data", [b"{not json", b"\xff\xfe", b'{"run":"x"}'])
def test_a_plan_that_is_none_is_named(tmp_path: Path, level: int, data: bytes) -> None:
    """Its name, and no traceback."""
    folder = planted(tmp_path / "r", lambda one: one, files={"plan.json": data})
    with pytest.raises(InputError, match=r"plan\.json"):
        ask(folder, level)


def test_a_list_of_packages_that_is_no_text_is_no_trouble(tmp_path: Path) -> None:
    """What the controller noted itself is what counts."""
    folder = planted(tmp_path / "r", lambda one: one, files={"packages.txt": b"\xff\xfe"})
    assert ask(folder, 2)[0] == 0


def test_a_changed_seed_has_not_the_id_of_its_request(tmp_path: Path) -> None:
    """Level 1 of any replay ends it: exit 5, nothing is compared."""
    folder = planted(tmp_path / "r", seed_changed(str(step_at(WALK).task_id), "77", forged=False))
    code, document = ask(folder, 2)
    assert (code, sum(document["counts"].values())) == (5, 0)
    assert any("has not the id of its inputs" in one["found"] for one in document["findings"])


def test_a_changed_seed_of_the_walk_is_named_at_level_2(tmp_path: Path) -> None:
    """Id, reply and step agree with the forged request; the plan does not."""
    folder = planted(tmp_path / "r", seed_changed(str(step_at(WALK).task_id), "77", forged=True))
    assert ask(folder, 1)[0] == 0
    code, document = ask(folder, 2)
    assert (code, named(document)) == (4, (WALK, "ray request"))
    assert document["first_difference"]["now"] == {"exit_seed": "1", "seed": "1"}


def test_a_changed_seed_of_a_finalist_is_named_at_level_3(tmp_path: Path) -> None:
    """The seed of a final evaluation follows from the campaign's: the designer knows it."""
    step = step_at(BEST)
    assert step.role == "best"
    folder = planted(tmp_path / "r", seed_changed(str(step.task_id), "77", forged=True))
    assert ask(folder, 2)[0] == 0
    code, document = ask(folder, 3)
    assert (code, named(document)) == (4, (BEST, "seed"))
    assert document["first_difference"]["logged"] == "77"


def test_a_changed_uniformity_is_named_by_its_cut(tmp_path: Path) -> None:
    """Step and reply agree on a uniformity 1e-6 too high; the line of Eq. 8 on record does not."""
    step = step_at(BEST)
    told = {**step.figures["uniformity"], "value": step.uniformity + 1e-6}

    def change(entry: Entry) -> Entry:
        if entry.topic == "/reply/ray" and entry.value.task_id == step.task_id:
            result = json.loads(json.dumps(entry.value.result))
            result["metrics"]["uniformity"] = told
            return record(entry.topic, entry.value.model_copy(update={"result": result}), BEST, entry.log_time_ns)
        figures = {**step.figures, "uniformity": told}
        return step_changed(BEST, uniformity=told["value"], figures=figures)(entry)

    code, document = ask(planted(tmp_path / "r", change), 2)
    assert (code, named(document), document["counts"]["differs"]) == (4, (BEST, "uniformity, cut"), 1)


def test_for_people_the_first_difference_is_named(tmp_path: Path) -> None:
    """A table of verdicts, then step, name, both values, and the verdict in a sentence."""
    folder = planted(tmp_path / "r", step_changed(WALK, reward=0.5))
    text = CliRunner().invoke(app, [str(folder), "--level", "2"]).stdout
    assert "first difference: step 1 (lane 0, action 1), reward: logged 0.5, now 0.0327" in text
    assert "verdict      it differs: 1 of " in text
