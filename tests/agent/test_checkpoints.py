"""The state of a walk between two turns, and the files that keep it."""

from __future__ import annotations

import io
import os
import zipfile
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent import checkpoints as c
from agent.ask_tell import Checkpoint
from agent.campaign import Runner
from agent.checkpoints import Checkpoints
from agent.config import Campaign, Stop
from agent.designers import designer
from agent.moves import Space
from agent.progress import Found, Past, WalkEnd
from luxloop.campaign import Action, Step
from luxloop.errors import InputError
from tests.agent.test_campaign import BOUNDS, Door
from tests.campaign_runs import plan_of

PLAN = plan_of("one")
LANES = 3


class Remembering(Door):
    """A door that gives a known action its known step, as a controller does that has read its journal."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.steps: dict[tuple[int, int], Step] = {}
        self.computed = 0

    def act(self, action: Action) -> Step:
        known = self.steps.get((action.lane, action.number))
        if known is not None:
            return known
        self.computed += 1
        self.steps[action.lane, action.number] = super().act(action)
        return self.steps[action.lane, action.number]


def a_runner(door: Door, name: str = "ddqn-fast", stop: Stop | None = None, **options: Any) -> Runner:
    """A fresh designer and its runner."""
    stop = stop or Stop(evaluations=40)
    campaign = Campaign(designer=name, lanes=LANES, seed=5, stop=stop)
    chooser = designer(name, Space(BOUNDS), seed=5, lanes=LANES, learning=campaign.learner)
    return Runner(door, chooser, stop, lanes=LANES, seed=5, **options)


def told(found: Found, door: Remembering) -> Any:
    """All that a campaign was and came to, but for its clocks."""
    walk = {key: (step.design, step.uniformity, step.reward) for key, step in door.steps.items()}
    return walk, [step.design for step in found.finalists], found.best, found.progress.evaluations


@pytest.mark.parametrize("name", ["ddqn-fast", "ddqn-paper", "pattern", "random", "grid"])
def test_from_any_turn_the_walk_goes_on_as_it_would_have(name: str) -> None:
    """The state of every fifth turn, restored into a fresh designer, leads to the same end."""
    door, states = Remembering(), []
    calm = a_runner(door, name, on_turn=lambda runner: states.append(runner.state()))
    expected = told(calm.run(3), door)
    weights = calm.designer.state().arrays
    for state in states[::5]:
        again = Remembering()
        for action in (one for one in door.actions if one.number < state.words["told"][one.lane]):
            again.steps[action.lane, action.number] = again.controller.act(action)
        runner = a_runner(again, name)
        runner.restore(Checkpoint.from_bytes(state.to_bytes()))
        assert told(runner.run(3), again) == expected
        assert again.computed == len(door.steps) - sum(state.words["told"])
        now = runner.designer.state().arrays
        assert all((now[key] == weights[key]).all() or key == "loss" for key in weights)


def test_a_limit_of_time_is_met_where_it_was_met() -> None:
    """The step at which a walk ended is on record; walked again it ends there, however fast."""
    door, ends = Remembering(delays=1), list[WalkEnd]()
    stop = Stop(evaluations=10_000, time_s=0.2)
    first = a_runner(door, stop=stop, on_walk_end=ends.append)
    expected = told(first.run(3), door)
    (end,) = ends
    assert WalkEnd.among(["something else", end.line]) == end
    steps = sum(not step.final for step in door.steps.values())
    again = a_runner(door, stop=stop, past=Past(steps, 0.2, end), on_walk_end=ends.append)
    assert told(again.run(3), door) == expected
    assert ends == [end]


def test_time_that_earlier_starts_took_counts() -> None:
    """After 100 s of a walk that may take 100 s, it ends with the first step that is new."""
    door = Remembering()
    a_runner(door, stop=Stop(evaluations=20)).run(1)
    door.steps = {key: step for key, step in door.steps.items() if not step.final}
    known = len(door.steps)
    runner = a_runner(door, stop=Stop(evaluations=1000, time_s=100.0), past=Past(known, 100.0))
    assert runner.run(1).reason == "time: 100 s"
    assert runner.progress.steps - known <= LANES


def test_interrupted_among_the_finalists_it_ends_there_and_goes_on() -> None:
    """No result; the second time the same finalists as undisturbed."""
    door = Remembering()
    stopped = a_runner(door, stop_wanted=lambda: sum(action.final for action in door.actions) >= 2)
    assert stopped.run(5).reason == "interrupted"
    result = a_runner(door).run(5)
    calm = Remembering()
    assert told(result, door) == told(a_runner(calm).run(5), calm)


def kept(folder: Path, door: Remembering, warnings: list[str]) -> Checkpoints:
    """The checkpoints of a whole walk."""
    checkpoints = Checkpoints(folder, PLAN, warnings.append)
    a_runner(door, stop=Stop(evaluations=300), on_turn=checkpoints.on_turn).run(1)
    return checkpoints


def test_the_last_few_are_kept_and_the_newest_is_taken(tmp_path: Path) -> None:
    """Three of them; the runner is where the newest was."""
    door, warnings = Remembering(), list[str]()
    checkpoints = kept(tmp_path, door, warnings)
    names = sorted(path.name for path in (tmp_path / c.FOLDER).iterdir())
    assert len(names) == c.KEPT
    runner = checkpoints.restored(lambda: a_runner(door, stop=Stop(evaluations=300)), list(door.steps.values()))
    assert names[-1] == f"checkpoint-{runner.progress.steps:08}.npz"
    assert warnings == []


@pytest.mark.parametrize("harm", ["cut", "flipped", "empty", "another", "ahead", "edited"])
def test_what_does_not_fit_is_left_aside_for_an_older_one(tmp_path: Path, harm: str) -> None:
    """Damaged, of another plan, of more steps than the journal has, of other steps: named, and the next is taken."""
    door, warnings = Remembering(), list[str]()
    checkpoints = kept(tmp_path, door, warnings)
    newest, older, _ = sorted((tmp_path / c.FOLDER).iterdir(), reverse=True)
    data, steps = newest.read_bytes(), dict(door.steps)
    last = int(newest.stem.rpartition("-")[2])
    match harm:
        case "cut":
            newest.write_bytes(data[: len(data) // 2])
        case "flipped":
            newest.write_bytes(data[:5000] + bytes([data[5000] ^ 1]) + data[5001:])
        case "empty":
            newest.write_bytes(b"")
        case "another":
            elsewhere = tmp_path / "two"
            elsewhere.mkdir()
            Checkpoints(elsewhere, plan_of("two"), warnings.append).save(a_runner(door))
            (elsewhere / c.FOLDER / "checkpoint-00000000.npz").replace(newest)
        case "ahead":
            steps = {key: step for key, step in steps.items() if key[1] < (last - 3) // LANES}
        case _:
            key = (0, last // LANES - 2)
            steps[key] = steps[key].model_copy(update={"reward": 0.123})
    runner = checkpoints.restored(lambda: a_runner(door, stop=Stop(evaluations=300)), list(steps.values()))
    assert runner.progress.steps == int(older.stem.rpartition("-")[2])
    assert len(warnings) == 1
    assert newest.name in warnings[0]
    assert "left aside" in warnings[0]


def test_a_checkpoint_with_a_wrong_byte_is_an_input_error_or_the_same() -> None:
    """Each byte, three ways: sizes, flags and versions of its entries among them; some bytes say nothing."""
    data = Checkpoint({"a": 1}, {"w": np.arange(40.0)}).to_bytes()
    refused = 0
    for place, flip in product(range(len(data)), (0x01, 0x40, 0xFF)):
        harmed = bytearray(data)
        harmed[place] ^= flip
        try:
            assert Checkpoint.from_bytes(bytes(harmed)).words == {"a": 1}
        except InputError:
            refused += 1
    assert refused > len(data)


def test_what_is_packed_or_no_archive_is_no_checkpoint() -> None:
    """A few bytes could unpack to any number; an array alone, words that are text, words that nest too deeply."""
    packed, alone, text, deep = (io.BytesIO() for _ in range(4))
    np.savez_compressed(packed, words=np.frombuffer(b"{}", np.uint8))
    np.save(alone, np.arange(3))
    with zipfile.ZipFile(text, "w") as file:
        file.writestr("words.npy", "{}")
    np.savez(deep, words=np.frombuffer(b"[" * 100_000, np.uint8))
    for one in (packed, alone, text, deep):
        with pytest.raises(InputError, match="checkpoint"):
            Checkpoint.from_bytes(one.getvalue())


def test_checkpoints_ahead_of_a_recovered_journal_make_room_for_new_ones(tmp_path: Path) -> None:
    """Left aside under another name; what is saved afterwards, of fewer steps, is there the next time."""
    door, warnings = Remembering(), list[str]()
    kept(tmp_path, door, warnings)
    steps = [step for key, step in door.steps.items() if key[1] < 10]
    checkpoints = Checkpoints(tmp_path, PLAN, warnings.append)
    runner = checkpoints.restored(lambda: a_runner(door), steps)
    assert (runner.progress.steps, len(warnings)) == (0, c.KEPT)
    assert {path.suffix for path in (tmp_path / c.FOLDER).iterdir()} == {c.ASIDE}
    checkpoints.save(runner)
    assert checkpoints.restored(lambda: a_runner(door), steps).progress.steps == 0
    assert len(warnings) == c.KEPT


def test_arrays_of_another_shape_are_left_aside(tmp_path: Path) -> None:
    """Of a learner that has been changed since, under the same version: torch's own error ended the resume."""
    door, warnings = Remembering(), list[str]()
    checkpoints = kept(tmp_path, door, warnings)
    newest, older, _ = sorted((tmp_path / c.FOLDER).iterdir(), reverse=True)
    words, arrays = c._read(newest)
    newest.write_bytes(Checkpoint(words, arrays | {"theta_0": arrays["theta_0"][:, :4]}).to_bytes())
    runner = checkpoints.restored(lambda: a_runner(door, stop=Stop(evaluations=300)), list(door.steps.values()))
    assert runner.progress.steps == int(older.stem.rpartition("-")[2])
    assert len(warnings) == 1


def test_what_was_just_saved_is_not_the_oldest(tmp_path: Path) -> None:
    """Whatever lies there of more steps."""
    door = Remembering()
    kept(tmp_path, door, [])
    Checkpoints(tmp_path, PLAN, pytest.fail).save(a_runner(door))
    names = sorted(path.name for path in (tmp_path / c.FOLDER).iterdir())
    assert names[0] == "checkpoint-00000000.npz"
    assert len(names) == c.KEPT


def test_a_disk_that_is_full_is_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run goes on; nothing half written is left."""

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    warnings: list[str] = []
    kept(tmp_path, Remembering(), warnings)
    assert len(warnings) == 1
    assert "No space left" in warnings[0]
    assert "make room" in warnings[0]
    assert list((tmp_path / c.FOLDER).iterdir()) == []


def test_a_folder_out_of_reach_keeps_none(tmp_path: Path) -> None:
    """The controller is on another machine: the journal alone will do."""
    checkpoints = Checkpoints(None, PLAN, lambda text: pytest.fail(text))
    door = Remembering()
    a_runner(door, on_turn=checkpoints.on_turn).run(1)
    assert checkpoints.restored(lambda: a_runner(door), []).progress.steps == 0
    assert list(tmp_path.iterdir()) == []


def test_a_checkpoint_of_another_designer_is_refused() -> None:
    """Its settings are named."""
    door = Remembering()
    with pytest.raises(InputError, match="checkpoint"):
        a_runner(door, "ddqn-paper").restore(a_runner(door).state())
