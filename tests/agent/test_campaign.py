"""The campaign's loop, with a controller in this process: order of turns, reasons to stop, finalists."""

from __future__ import annotations

import random
import threading
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agent import campaign_command, designers_command
from agent.campaign import Runner, fresh_seed
from agent.comparison import Trial, compare, rows
from agent.config import Campaign, Stop, read_campaign
from agent.ddqn import Learning
from agent.designers import SEARCHES, designer
from agent.launch import Launched
from agent.moves import Space, key_of
from agent.progress import Found, Progress
from agent.telling import as_text
from luxloop.campaign import Action, Ended, Step
from luxloop.design import Bounds, Design
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.model import Model
from luxloop.model_file import find_model, to_toml
from tests.objectives import Controller

BOUNDS = Bounds.preset("paper-table3")


class Door:
    """A controller that answers after a random while, and notes who asked for what."""

    def __init__(self, delays: int | None = None, failing: tuple[int, ...] = (), **options: Any) -> None:
        self.run, self.designer = "one", "d"
        self.controller = Controller("A", **options)
        self.actions: list[Action] = []
        self._random = None if delays is None else random.Random(delays)
        self._failing, self._lock = failing, threading.Lock()

    def act(self, action: Action) -> Step:
        if self._random is not None:
            time.sleep(self._random.random() * 0.004)
        with self._lock:
            self.actions.append(action)
            step = self.controller.act(action)
            if len(self.actions) in self._failing:
                failure = Failure(code="worker_lost", message="three attempts")
                step = step.model_copy(update={"failure": failure, "uniformity": 0.0})
            return step


def found(door: Door, name: str = "ddqn-fast", lanes: int = 3, seed: int = 5, **stop: Any) -> tuple[Found, Runner]:
    """What a campaign came to."""
    stop = stop or {"evaluations": 60}
    campaign = Campaign(designer=name, lanes=lanes, seed=seed, stop=Stop(**stop))
    chooser = designer(name, Space(BOUNDS), seed=seed, lanes=lanes, learning=campaign.learner)
    runner = Runner(door, chooser, campaign.stop, lanes=lanes, seed=seed)
    return runner.run(campaign.finalists), runner


def walked(door: Door) -> list[tuple[int, int, Any, Any]]:
    """The actions of the walk by lane and number: what was proposed, with which weights."""
    walk = [action for action in door.actions if not action.final]
    rows = [(a.lane, a.number, a.design or a.move, a.agent.weights_sha256 if a.agent else "") for a in walk]
    return sorted(rows, key=lambda row: row[:2])


def test_the_trajectory_does_not_depend_on_who_answers_first() -> None:
    """Every proposal and every weight hash is the same with other delays."""
    doors = [Door(), Door(delays=1), Door(delays=2)]
    for door in doors:
        found(door)
    assert walked(doors[0]) == walked(doors[1]) == walked(doors[2])
    assert len(walked(doors[0])) >= 60


def test_another_seed_goes_another_way() -> None:
    """And its finalists have other random numbers."""
    one, other = Door(), Door()
    found(one, seed=5)
    found(other, seed=6)
    assert walked(one) != walked(other)
    assert {a.seed for a in one.actions if a.final}.isdisjoint({a.seed for a in other.actions if a.final})


def test_the_best_are_evaluated_anew_and_they_alone_are_reported() -> None:
    """Five different designs, the best of the walk, each with its own seed; the best of them is the result."""
    door = Door()
    result, runner = found(door)
    finals = [action for action in door.actions if action.final]
    assert [action.role for action in finals] == ["finalist"] * 5 + ["start", "best", "without_dbr"]
    assert len({action.seed for action in finals}) == 8
    best_of_walk = sorted(runner.designer.known.uniformity.values(), reverse=True)[:5]
    assert len(result.finalists) == 5
    assert [step.uniformity for step in result.finalists] == sorted(
        (step.uniformity for step in result.finalists), reverse=True
    )
    assert result.best is not None
    assert result.best.design == result.finalists[0].design
    assert result.best.number != result.finalists[0].number
    keys = {tuple(step.design.as_vector()) for step in result.finalists}
    assert {runner.designer.known.uniformity[key] for key in keys} == set(best_of_walk)
    assert result.start is not None
    assert result.start.design == runner.progress.first.design  # type: ignore[union-attr]
    assert result.without_dbr is not None
    assert result.without_dbr.design == result.best.design.model_copy(update={"dbr_pairs": 0.0})  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("stop", "reason"),
    [
        ({"evaluations": 7}, "budget: 7 evaluations"),
        ({"evaluations": 10_000, "time_s": 1e-6}, "time: 0 s"),
        ({"evaluations": 10_000, "steps": 9}, "steps: 9, of "),
        ({"evaluations": 10_000, "episodes_without_gain": 3}, "saturation"),
    ],
)
def test_a_campaign_ends_for_a_stated_reason(stop: dict[str, Any], reason: str) -> None:
    """Budget, time, saturation; what is under way then is still taken."""
    door = Door()
    result, runner = found(door, **stop)
    assert result.reason.startswith(reason)
    assert runner.progress.steps == len([a for a in door.actions if not a.final])


def test_a_slow_climb_is_no_saturation() -> None:
    """A point an episode at an error of 0.9: no single step gains twice its error, all together do."""

    class Climbing(Door):
        def act(self, action: Action) -> Step:
            step = super().act(action)
            return step.model_copy(update={"uniformity": 0.3 + 0.001 * len(self.actions), "uniformity_error": 0.009})

    result, _ = found(Climbing(), evaluations=250, episodes_without_gain=5)
    assert result.reason.startswith("budget")

    class Flat(Door):
        def act(self, action: Action) -> Step:
            return super().act(action).model_copy(update={"uniformity": 0.5, "uniformity_error": 0.009})

    assert found(Flat(), evaluations=250, episodes_without_gain=5)[0].reason.startswith("saturation")


def test_only_episodes_that_are_over_count_as_quiet() -> None:
    """The best design comes first: with four lanes, three episodes have ended without a gain before the walk ends."""

    class BestFirst(Door):
        def act(self, action: Action) -> Step:
            seen = 0.9 if (action.lane, action.number) == (0, 0) else 0.5
            return super().act(action).model_copy(update={"uniformity": seen, "uniformity_error": 0.009})

    door = BestFirst()
    result, _ = found(door, lanes=4, evaluations=250, episodes_without_gain=3)
    begun = [[a.agent.episode for a in door.actions if a.agent and a.lane == lane] for lane in range(4)]
    over = {episode for episodes in begun for episode in episodes if episode != episodes[-1]}
    assert len(over - {0}) >= 3, "episode 0 has the gain"
    assert result.reason == "saturation: no gain above twice its error in 3 episodes"


def test_a_grid_ends_when_all_of_it_was_seen() -> None:
    """Every design that can be built, once."""
    bounds = BOUNDS.model_copy(update={"step": Design.from_vector((80.0, 45.0, 200.0, 25.0, 2.5))})
    door = Door()
    runner = Runner(door, designer("grid", Space(bounds), seed=1, lanes=2), Stop(evaluations=10**6), lanes=2, seed=1)
    result = runner.run(3, without_dbr=False)
    seen = [tuple(a.design.as_vector()) for a in door.actions if a.design and not a.final]
    assert len(seen) == len(set(seen)) == bounds.count
    assert result.reason.startswith("complete")
    assert result.without_dbr is None


def test_failed_steps_are_survived_and_never_the_best() -> None:
    """Their lanes begin anew; the campaign ends as planned."""
    door = Door(failing=(1, 2, 9, 20))
    result, runner = found(door)
    assert result.reason == "budget: 60 evaluations"
    assert runner.progress.evaluations == 60
    assert all(step.failure is None for step in result.finalists)


def test_an_interrupted_campaign_waits_for_what_is_under_way() -> None:
    """No finalists, the reason says so; what was under way is not told, the state has it to be sent again."""
    door = Door()
    chooser = designer("random", Space(BOUNDS), seed=1, lanes=2)
    runner = Runner(door, chooser, Stop(evaluations=50), lanes=2, seed=1, stop_wanted=lambda: len(door.actions) > 9)
    result = runner.run(5)
    assert result.reason == "interrupted"
    assert result.finalists == ()
    told = runner.state().words["told"]
    assert sum(told) == runner.progress.steps == len(door.actions) - 2
    assert [chooser.awaited(lane) is not None for lane in (0, 1)] == [True, True]


@pytest.mark.parametrize("last", [False, True])
def test_left_at_once_a_campaign_waits_for_nothing(last: bool) -> None:
    """A second Ctrl-C in the walk or among the finalists: what is under way is let go of."""
    left, let_go = threading.Event(), list[bool]()

    class Slow(Door):
        def act(self, action: Action) -> Step:
            if action.lane and action.final == last:
                let_go.append(left.wait(60.0))
            return super().act(action).model_copy(update={"final": action.final})

    def look(progress: Progress) -> None:
        if progress.last is not None and progress.last.final == last:
            raise KeyboardInterrupt

    chooser = designer("random", Space(BOUNDS), seed=1, lanes=3)
    runner = Runner(Slow(), chooser, Stop(evaluations=9), lanes=3, seed=1, look=look, on_leave=left.set)
    with pytest.raises(KeyboardInterrupt):
        runner.run(5)
    assert left.is_set()
    assert all(let_go), "what was under way was waited for before it was let go of"


def final_failures(*roles: str) -> Found:
    """What a campaign came to whose final evaluations for these purposes failed."""

    class Failing(Door):
        def act(self, action: Action) -> Step:
            step = super().act(action)
            failure = Failure(code="worker_lost", message="three attempts")
            return step.model_copy(update={"failure": failure, "uniformity": 0.0}) if action.role in roles else step

    return found(Failing(), evaluations=20)[0]


def text_of(result: Found) -> str:
    """What a person is told of it."""
    ended = Ended(run="one", folder="runs/one", records=1, root="0" * 64)
    return "\n".join(as_text(Launched("one", result, ended, interrupted=False).document()))


def test_a_best_that_failed_is_told_as_the_best_finalist() -> None:
    """Not as 0 %: with the reason, in the document too; the journal holds what happened."""
    result = final_failures("best")
    document = Launched("one", result, Ended(run="one", folder="f", records=1, root="0" * 64), False).document()
    assert result.summary()["best"]["failure"]
    assert document["best"] == document["finalists"][0]
    assert not document["best"]["failure"]
    assert "once more, it failed" in text_of(result)
    assert "gained       +" in text_of(result)
    (row,) = rows([trial_of("a", result)])
    assert row["best_worst"] == row["best_of_all"] == result.finalists[0].uniformity


@pytest.mark.parametrize("roles", [("start",), ("best", "finalist")])
def test_what_failed_is_no_number(roles: tuple[str, ...]) -> None:
    """No gain over a start that failed; no best where all failed, and nothing of it in a comparison."""
    result = final_failures(*roles)
    text = text_of(result)
    assert "gained" not in text
    assert "failed: worker_lost" in text
    if "best" in roles:
        assert "best   " not in text
        assert "finalist 1   failed" in text
        (row,) = rows([trial_of("a", result)])
        assert row["best_median"] is None
        assert (row["near"], row["best_of_all"]) == (0, None)
        assert "near:" not in "\n".join(designers_command.as_text([row]))


def trial_of(designer: str, result: Found, *designs: Design) -> Trial:
    """A run of a comparison; its walk met these designs, then its best."""
    met = [*designs, *([result.sound_best.design] if result.sound_best else [])]
    return Trial(designer, 1, tuple(key_of(design) for design in met), 1, result)


def test_near_is_judged_by_what_was_evaluated_anew() -> None:
    """Two runs with the same optimum, 99.0 and 99.1 +- 0.3 %, are both near, whatever the walks saw; 97.0 is not."""
    result, _ = found(Door(), evaluations=12)
    assert result.best is not None
    others = [step.design for step in result.finalists[1:]]

    def came_to(uniformity: float) -> Found:
        best = result.best.model_copy(update={"uniformity": uniformity, "uniformity_error": 0.003})  # type: ignore[union-attr]  # it has one
        return replace(result, best=best)

    one, two, far = rows([
        trial_of("a", came_to(0.990), *others[:2]), trial_of("b", came_to(0.991), *others),
        trial_of("c", came_to(0.970)),
    ])  # fmt: skip
    assert [(row["near"], row["evaluations_to_near"]) for row in (one, two, far)] == [(1, 3), (1, 5), (0, None)]
    assert (far["best_of_all"], far["best_of_all_error"]) == (0.991, 0.003)
    last = "\n".join(designers_command.as_text([one, two, far]))
    assert "within 0.5 points and twice the combined error of the best of all, 99.10 +- 0.30 %" in last


def test_a_door_that_breaks_ends_the_campaign_with_its_error() -> None:
    """Nothing hangs."""

    class Broken(Door):
        def act(self, action: Action) -> Step:
            raise RuntimeError(f"gone, {action.lane} too")

    with pytest.raises(RuntimeError, match="gone"):
        found(Broken())


def test_fresh_seeds_are_fresh() -> None:
    """Of campaign, purpose and number; within the bounds of a seed."""
    seeds = {fresh_seed(seed, what, number) for seed in (1, 2) for what in ("a", "b") for number in range(20)}
    assert len(seeds) == 80
    assert all(0 <= int(seed) < 10**19 for seed in seeds)


def test_a_plan_says_what_the_controller_must_know() -> None:
    """Reward of the learner, seed of all designs, fidelities; a grid keeps no maps but the best."""
    model = find_model("paper")
    assert isinstance(model, Model)
    plan = Campaign(designer="ddqn-paper", seed=9).plan("one", model, "paper")
    assert (plan.reward, plan.walk.seed, plan.walk.target_error_points) == ("r1", "9", 1.0)
    assert Campaign(method="twin").plan("one", model, "paper").walk.histories == 131_072
    assert not Campaign(designer="grid").plan("one", model, "paper", kind="grid").maps


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("designer = 'nobody'", "designer"),
        ("colour = 1", "colour"),
        ("lanes = 0", "lanes"),
        ("[stop]\nevaluations = 0", "stop.evaluations"),
        ("designer = 'pattern'\n[learning]\ngamma = 0.5", "learning"),
        ("learning = 3", "learning"),
        ("[learning]\nrandom_actions = true", "learning"),
        ("designer = 'ddqn-paper'\n[learning]\nprofile = 'fast'", "learning"),
        ("designer = 'ddqn-paper'\n[learning]\npatience = 5", "learning.patience"),
        ("[learning]\nrestart = 'start'", "learning.restart"),
        ("[learning]\nreplay = 16", "learning.batch"),
        ("method = 'twin'\nwalk_error_points = 1.0", "walk_error_points"),
        ("twin_histories = 4096", "twin_histories"),
        *((f"designer = '{name}'\n[stop]\nepisodes_without_gain = 3", "episodes_without_gain") for name in SEARCHES),
        ("bounds = 'none'", "bounds"),
        ("lanes = ", "campaign.toml: line 1"),
        (f"lanes = {'7' * 5000}", "campaign.toml: line 1"),
        (f"lanes = 0x{'f' * 5000}", "campaign.toml: line 1"),
        (f"lanes = 0x{'f' * 1000}", "campaign.toml: lanes"),
        ("lanes = 2 # \ud800", "campaign.toml"),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(text: str, field: str, tmp_path: Any) -> None:
    """By file, field, value and range."""
    path = tmp_path / "campaign.toml"
    path.write_text(text, errors="surrogatepass")
    with pytest.raises(InputError) as caught:
        read_campaign(path)
    assert field in caught.value.field
    assert len(str(caught.value)) < 1000


def test_all_that_is_wrong_is_named(tmp_path: Any) -> None:
    """The first with its value, the others by their names."""
    path = tmp_path / "campaign.toml"
    path.write_text("colour = 1\nlanes = 0\n[stop]\nsize = 2")
    with pytest.raises(InputError, match=r"2 more wrong: (stop\.size, colour|lanes, colour|stop\.size, lanes)$"):
        read_campaign(path)


def test_options_go_over_the_file(tmp_path: Any) -> None:
    """Those that are given; the rest of the file stands."""
    path = tmp_path / "campaign.toml"
    path.write_text("seed = 4\nlanes = 2\n[stop]\nevaluations = 9\ntime_s = 5.0")
    campaign = read_campaign(path, seed=7, lanes=None, stop__evaluations=11)
    assert (campaign.seed, campaign.lanes, campaign.stop.evaluations, campaign.stop.time_s) == (7, 2, 11, 5.0)
    path.write_text("method = 'twin'\ntwin_histories = 4096\n[stop]\nepisodes_without_gain = 3")
    campaign = read_campaign(path, designer="pattern", method="monte_carlo")
    assert "twin_histories" not in campaign.model_fields_set, "what only the file's method looks at goes with it"
    assert campaign.stop.episodes_without_gain is None
    path.write_text("designer = 'ddqn-fast'\n[learning]\ngamma = 0.9")
    assert read_campaign(path, designer="pattern").learning is None
    path.write_text("designer = 'pattern'\n[stop]\nepisodes_without_gain = 3")
    with pytest.raises(InputError, match="episodes_without_gain"):
        read_campaign(path, designer="pattern")
    assert read_campaign(path, compared=True).stop.episodes_without_gain == 3


@pytest.mark.parametrize("name", ["ddqn-fast", "ddqn-fast-random", "ddqn-paper", "ddqn-paper-random"])
def test_a_learner_s_settings_go_over_the_preset_of_its_name(name: str, tmp_path: Path) -> None:
    """What is not said is the designer's own, and it is the designer that the run is called after."""
    path = tmp_path / "campaign.toml"
    path.write_text("[learning]\ngamma = 0.6")
    plain = read_campaign(None, designer=name)
    learner = read_campaign(path, designer=name).learner
    assert learner is not None
    assert learner.name == name
    assert learner == plain.learner.model_copy(update={"gamma": 0.6})  # type: ignore[union-attr]  # it learns


def test_another_rule_of_restart_leaves_the_preset_s_patience_behind(tmp_path: Path) -> None:
    """It belongs to the rule; a start may be said in two places."""
    path = tmp_path / "campaign.toml"
    path.write_text("[learning]\nrestart = 'random'")
    assert read_campaign(path).learner.patience is None  # type: ignore[union-attr]  # it learns
    path.write_text("[learning]\nrestart = 'start'")
    assert read_campaign(path, start=BOUNDS.high).learner.restart == "start"  # type: ignore[union-attr]  # it learns


def test_a_run_on_record_is_what_it_was() -> None:
    """Settings that would be refused now are read back as they were, so that the run can be walked again."""
    learning = Learning(patience=5)
    recorded = Campaign(designer="ddqn-fast-random", learning=learning).model_dump(mode="json")
    assert Campaign.model_validate(recorded).learner == learning
    idle = Campaign(designer="grid", method="twin", walk_error_points=2.0, stop=Stop(episodes_without_gain=3))
    assert Campaign.model_validate(idle.model_dump(mode="json")) == idle


@pytest.mark.parametrize("option", [{"evaluations": 0}, {"time_s": 0.0}])
def test_a_quick_campaign_takes_no_nought_for_nothing_said(
    option: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is refused, as without --quick."""
    monkeypatch.setattr(campaign_command, "_launched", lambda *_: pytest.fail("a campaign was begun"))
    with pytest.raises(InputError, match=next(iter(option))):
        campaign_command.run(quick=True, **option)


@pytest.mark.parametrize("changes", [{"learning": Learning(profile="fast")}, {"reward": "r2"}])
def test_a_comparison_refuses_what_one_designer_alone_could_have(changes: dict[str, Any]) -> None:
    """Before any run."""
    with pytest.raises(InputError, match=next(iter(changes))):
        compare(Campaign(**changes), ["random"], [1], lambda *_: pytest.fail("a run"))


def test_the_command_refuses_it_before_a_set_is_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of the file is dropped in silence."""
    monkeypatch.setattr("agent.launch.running_set", lambda *_, **__: pytest.fail("a set"))
    path = tmp_path / "campaign.toml"
    path.write_text("[learning]\ngamma = 0.6")
    with pytest.raises(InputError, match="--config: learning"):
        designers_command.compare(config=path)


@pytest.mark.parametrize(
    ("text", "option", "evaluations"), [("", None, 100), ("[stop]\nevaluations = 9", None, 9), ("", 11, 11)]
)
def test_a_comparison_tells_what_of_its_file_is_not_used(
    text: str,
    option: int | None,
    evaluations: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Designer and seed; the budget of the file counts where no option says otherwise."""

    class BegunError(Exception):
        """The first run was begun."""

    def begun(_: object, campaign: Campaign, *more: object, **options: object) -> None:
        assert (campaign.designer, campaign.seed, campaign.stop.evaluations) == ("random", 1, evaluations)
        raise BegunError

    monkeypatch.setattr("agent.launch.running_set", lambda *_, **__: nullcontext())
    monkeypatch.setattr("agent.launch.launch", begun)
    path = tmp_path / "campaign.toml"
    path.write_text(f"designer = 'pattern'\nseed = 7\n{text}")
    with pytest.raises(BegunError):
        designers_command.compare(designers="random", config=path, evaluations=option)
    told = capsys.readouterr().err
    assert "designer = 'pattern' is not used: --designers" in told
    assert "seed = 7 is not used: each designer runs with the seeds 1 to --seeds" in told


def test_designers_are_compared_by_one_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that is edited while they run is not read again."""
    path, used = tmp_path / "mine.toml", []
    path.write_text(to_toml(find_model("paper")))

    def begun(_: object, campaign: Campaign, model: str, run: str, *, chosen: Model, **options: object) -> object:
        path.write_text(to_toml(find_model("clear_chip")))
        used.append((model, chosen))
        found = SimpleNamespace(progress=SimpleNamespace(episodes=0))
        return SimpleNamespace(interrupted=len(used) > 1, run=run, found=found, walk=())

    monkeypatch.setattr("agent.launch.running_set", lambda *_, **__: nullcontext())
    monkeypatch.setattr("agent.launch.launch", begun)
    with pytest.raises(KeyboardInterrupt):
        designers_command.compare(designers="random,pattern", model=str(path), seeds=1)
    assert used == [(str(path), find_model("paper"))] * 2


def test_bounds_without_a_feasible_design_are_refused() -> None:
    """When the plan is made, naming why."""
    low = Design.from_vector((10.0, 10.0, 300.0, 30.0, 4.5))
    bounds = Bounds(low=low, high=low.model_copy(update={"distance_um": 20.0}), step=BOUNDS.step)
    with pytest.raises(ValueError, match="a box with a feasible design"):
        Campaign(bounds=bounds).plan("one", find_model("paper"), "paper")
