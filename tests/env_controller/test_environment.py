"""The environment-control agent alone: stories of actions, no bus, no clock, no worker."""

from __future__ import annotations

from typing import Any

import pytest

from env_controller import actions as a
from env_controller.environment import EnvironmentAgent
from env_controller.events import Command
from env_controller.rewards import reward_of
from env_controller.trials import Past, film_task
from luxloop.campaign import Action, Move, Plan, Step
from luxloop.design import Bounds, Design
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.ray import Film
from tests.env_controller.desk import DESIGN
from tests.env_controller.desk import plan as campaign


def plan(run: str = "one", **changes: Any) -> Plan:
    """A campaign of four lanes."""
    return campaign(run, **({"lanes": 4} | changes))


class Story:
    """An agent, and workers that answer when told to."""

    def __init__(self, *plans: Plan) -> None:
        self.agent, self.now = EnvironmentAgent(), 0.0
        self.numbers: dict[tuple[str, int], int] = {}
        for one in plans or (plan(),):
            self.agent.handle(a.Opened(0.0, one))

    def act(self, lane: int = 0, run: str = "one", **what: Any) -> list[Command]:
        number = self.numbers.get((run, lane), 0)
        commands = self.agent.handle(
            a.Acted(self.now, Action(run=run, designer="d", lane=lane, number=number, **what))
        )
        self.numbers[run, lane] = number + 1
        return commands

    def film(self, want: a.Want, sha256: str = "f" * 64) -> list[Command]:
        return self.agent.handle(
            a.Ended(self.now, want.task.id, {"table_sha256": sha256, "table_bytes": 9}, compute_s=0.25)
        )

    def ray(self, want: a.Want, uniformity: float = 0.8) -> list[Command]:
        self.now += 1.0
        figure = {"value": uniformity, "standard_error": 0.01}
        metrics = {"uniformity": figure, "mean_illuminance_lx": {"value": 9e4, "standard_error": 10.0}}
        return self.agent.handle(a.Ended(self.now, want.task.id, {"metrics": metrics}, compute_s=0.5))

    def fail(self, want: a.Want, **failure: Any) -> list[Command]:
        return self.agent.handle(a.Ended(self.now, want.task.id, None, Failure(**failure)))


def wanted(commands: list[Command], kind: str) -> a.Want:
    """The one task of a kind that is wanted now."""
    (want,) = [c for c in commands if isinstance(c, a.Want) and c.task.kind == kind and not c.ahead]
    return want


def told(commands: list[Command]) -> list[Step]:
    """The steps that are told."""
    return [command.step for command in commands if isinstance(command, a.Tell)]


def evaluated(story: Story, uniformity: float = 0.8, lane: int = 0, **what: Any) -> Step:
    """The step of an action whose film may have to be computed first."""
    commands = story.act(lane, **what)
    if told(commands):
        return told(commands)[0]
    films = [c for c in commands if isinstance(c, a.Want) and c.task.kind == "film" and not c.ahead]
    if films:
        commands = story.film(films[0])
    return told(story.ray(wanted(commands, "ray"), uniformity))[0]


def test_an_action_becomes_a_film_then_rays_then_a_step() -> None:
    """Film first, its hash in the ray task, both on record, then state and reward."""
    story = Story()
    first = story.act(design=DESIGN)
    film = wanted(first, "film")
    assert film.task.inputs["dbr_pairs"] == 5.5
    second = story.film(film)
    assert second[0] == a.Record("one", film.task.id)
    ray = wanted(second, "ray")
    assert ray.task.inputs["film"] == {"sha256": "f" * 64, "bytes": 9}
    assert ray.group == "f" * 64
    third = story.ray(ray, 0.81)
    assert third[0] == a.Record("one", ray.task.id)
    (step,) = told(third)
    assert (step.design, step.uniformity, step.uniformity_error) == (DESIGN, 0.81, 0.01)
    assert step.state == pytest.approx((0.25, -5 / 9, 0.0, -0.4, -0.6))
    assert (step.physics_s, step.controller_s, step.cached) == (0.75, 1.0, False)
    assert step.figures["mean_illuminance_lx"] == {"value": 9e4, "standard_error": 10.0}
    assert [line.split(" ", 1)[1] for line in story.agent.story("one", 0, 0)] == [
        f"to be evaluated: {DESIGN}", "waits for the film of 5.5 pairs", "has its film", "waits for its rays",
        "uniformity 0.8100, reward 0.0000",
    ]  # fmt: skip


def test_what_is_computed_once_counts_once_in_a_run() -> None:
    """A film that two lanes wait for, rays of one design; another run has it on its own account."""
    story = Story(plan(), plan("two"))
    film = wanted(story.act(0, design=DESIGN), "film")
    story.act(1, design=DESIGN)
    story.act(2, design=DESIGN.model_copy(update={"width_um": 40.0}))
    story.act(0, run="two", design=DESIGN)
    wants = [one for one in story.film(film) if isinstance(one, a.Want) and not one.ahead]
    rays = {one.task.id: one for one in wants}
    steps = [step for ray in rays.values() for step in told(story.ray(ray))]
    assert [(step.run, step.lane, step.physics_s, step.cached) for step in steps] == [
        ("one", 0, 0.75, False), ("one", 1, 0.0, True), ("two", 0, 0.75, False), ("one", 2, 0.5, False),
    ]  # fmt: skip


def test_films_of_neighbouring_pair_counts_are_wanted_ahead_once() -> None:
    """A half and a whole pair away, within the bounds; a step there needs no film of its own any more."""
    story = Story()
    commands = story.act(design=DESIGN.model_copy(update={"dbr_pairs": 4.5}))
    ahead = [c for c in commands if isinstance(c, a.Want) and c.ahead]
    assert [c.task.inputs["dbr_pairs"] for c in ahead] == [5.0, 5.5]
    story.film(wanted(commands, "film"))
    assert story.film(ahead[0], "e" * 64) == [a.Record("one", ahead[0].task.id)]
    again = story.act(lane=1, design=DESIGN.model_copy(update={"dbr_pairs": 5.0}))
    assert wanted(again, "ray").group == "e" * 64
    assert [c.task.inputs["dbr_pairs"] for c in again if isinstance(c, a.Want) and c.ahead] == [6.0]


def test_a_chip_without_dbr_needs_no_film() -> None:
    """Rays at once."""
    story = Story()
    (want,) = story.act(design=DESIGN.model_copy(update={"dbr_pairs": 0.0}), final=True, seed="7")
    assert isinstance(want, a.Want)
    assert (want.task.kind, want.task.inputs["film"], want.task.inputs["seed"]) == ("ray", None, "7")
    assert want.task.inputs["target_error_points"] == 0.3


def test_what_cannot_be_built_is_told_at_once() -> None:
    """Uniformity 0 with the reason, no task."""
    roomy = Bounds.preset("paper-grid")
    story = Story(plan(bounds=roomy, reward="r2"))
    (command,) = story.act(design=Design.from_vector((10.0, 30.0, 500.0, 25.0, 5.5)))
    (step,) = told([command])
    assert (step.feasible, step.uniformity, step.task_id) == (False, 0.0, None)
    assert "below 30" in step.reason
    assert step.reward == pytest.approx(-421.875)


def test_a_move_goes_from_where_the_lane_is() -> None:
    """By the bounds' steps; the reward is what it gained."""
    story = Story()
    evaluated(story, 0.80, design=DESIGN)
    step = evaluated(story, 0.83, move=Move(variable="width_um", steps=-2))
    assert step.design == DESIGN.model_copy(update={"width_um": 26.0})
    assert step.reward == pytest.approx(0.3)
    pairs = evaluated(story, 0.81, move=Move(variable="dbr_pairs", steps=2))
    assert pairs.design.dbr_pairs == 6.5
    assert pairs.reward == pytest.approx(-0.2)


def test_a_move_out_of_the_bounds_leads_nowhere() -> None:
    """The lane stays, with its uniformity; no task; the next move starts there."""
    story = Story()
    evaluated(story, 0.80, design=DESIGN)
    (step,) = told(story.act(move=Move(variable="distance_um", steps=4)))
    assert (step.design, step.uniformity, step.reward, step.cached) == (DESIGN, 0.8, 0.0, True)
    assert "distance_um" in step.reason
    assert evaluated(story, 0.8, move=Move(variable="distance_um", steps=3)).design.distance_um == 180.0


def test_a_design_evaluated_before_is_known() -> None:
    """No task, the same numbers, cached; the reward is of this step."""
    story = Story()
    evaluated(story, 0.80, design=DESIGN)
    evaluated(story, 0.83, move=Move(variable="width_um", steps=1))
    (step,) = told(story.act(move=Move(variable="width_um", steps=-1)))
    assert (step.design, step.uniformity, step.cached) == (DESIGN, 0.80, True)
    assert step.reward == pytest.approx(-0.3)


def test_two_lanes_on_one_design_wait_for_one_task() -> None:
    """Each gets its step."""
    story = Story()
    film = wanted(story.act(0, design=DESIGN), "film")
    story.act(1, design=DESIGN)
    rays = [c for c in story.film(film) if isinstance(c, a.Want)]
    assert len({want.task.id for want in rays}) == 1
    assert [step.lane for step in told(story.ray(rays[0]))] == [0, 1]


def test_two_runs_do_not_share_lanes_or_designers() -> None:
    """The same task serves both, on both records."""
    story = Story(plan("one"), plan("two"))
    film = wanted(story.act(run="one", design=DESIGN), "film")
    story.act(run="two", design=DESIGN)
    commands = story.film(film)
    assert {c.run for c in commands if isinstance(c, a.Record)} == {"one", "two"}
    steps = told(story.ray(next(c for c in commands if isinstance(c, a.Want))))
    assert {step.run for step in steps} == {"one", "two"}


@pytest.mark.parametrize("reward", ["gain", "r2", "r3"])
def test_finalists_have_their_own_seed_and_leave_the_lane_where_it_was(reward: str) -> None:
    """Evaluated anew, never from the walk's results; nothing is earned by it, also where a level and no gain pays."""
    story = Story(plan(reward=reward))
    evaluated(story, 0.80, design=DESIGN)
    other = DESIGN.model_copy(update={"width_um": 50.0})
    step = evaluated(story, 0.9, design=other, final=True, seed="11")
    assert (step.final, step.cached, step.reward) == (True, False, 0.0)
    assert evaluated(story, 0.8, move=Move(variable="width_um", steps=1)).design.width_um == 32.0


def test_a_failed_evaluation_is_a_step_with_its_failure() -> None:
    """No reward, and the lane goes on from there; the next gain is not reckoned from it."""
    story = Story()
    film = wanted(story.act(design=DESIGN), "film")
    ray = wanted(story.film(film), "ray")
    (step,) = told(story.fail(ray, code="worker_lost", message="three attempts"))
    assert step.failure is not None
    assert (step.failure.code, step.reward) == ("worker_lost", 0.0)
    assert evaluated(story, 0.7, move=Move(variable="width_um", steps=1)).reward == 0.0


def test_a_film_that_has_gone_is_computed_again() -> None:
    """The worker that held its table ended: afresh, twice at most, then it is a failure."""
    story = Story()
    film = wanted(story.act(design=DESIGN), "film")
    ray = wanted(story.film(film), "ray")
    for _ in range(2):
        commands = story.fail(ray, code="not_found", message="nobody holds it", field="film")
        again = wanted(commands, "film")
        assert again.fresh
        assert again.task.id == film.task.id
        ray = wanted(story.film(again), "ray")
    assert told(story.fail(ray, code="not_found", message="nobody holds it", field="film"))[0].failure is not None


def test_a_closed_run_wants_nothing_more() -> None:
    """Its tasks are given back, but for those another run waits for; late results are nobody's."""
    story = Story(plan("one"), plan("two"))
    film = wanted(story.act(run="one", design=DESIGN), "film")
    ray = wanted(story.film(film), "ray")
    other = wanted(story.act(run="two", design=DESIGN), "film")
    commands = story.agent.handle(a.Closed(1.0, "one"))
    assert a.Unwant(ray.task.id) in commands
    assert a.Unwant(other.task.id) not in commands
    assert story.ray(ray) == []


@pytest.mark.parametrize(("closed", "left"), [("waits", "ahead"), ("ahead", "waits")])
def test_a_film_that_another_run_wants_is_not_given_back(closed: str, left: str) -> None:
    """One waits for it, the other wants it ahead of time: it is of use until both are closed, whichever is first."""
    story = Story(plan("waits"), plan("ahead"))
    near = story.act(run="ahead", design=DESIGN.model_copy(update={"dbr_pairs": 5.0}))
    film = wanted(story.act(run="waits", design=DESIGN), "film")
    assert any(c.task.id == film.task.id and c.ahead for c in near if isinstance(c, a.Want))
    assert a.Unwant(film.task.id) not in story.agent.handle(a.Closed(1.0, closed))
    assert a.Record(left, film.task.id) in story.film(film)


def test_what_several_runs_wanted_is_given_back_once() -> None:
    """With the last of them."""
    story = Story(plan("one"), plan("two"))
    story.act(run="one", design=DESIGN.model_copy(update={"dbr_pairs": 5.0}))
    film = wanted(story.act(run="two", design=DESIGN), "film")
    commands = [command for run in ("one", "two") for command in story.agent.handle(a.Closed(1.0, run))]
    assert commands.count(a.Unwant(film.task.id)) == 1
    assert len(commands) == len(set(map(str, commands)))


def test_a_blocked_move_says_again_what_is_known_of_the_lane() -> None:
    """Uniformity with its error; after a failed evaluation nothing is known, so it fails, too."""
    story = Story()
    evaluated(story, 0.80, design=DESIGN)
    (step,) = told(story.act(move=Move(variable="distance_um", steps=4)))
    assert (step.uniformity, step.uniformity_error) == (0.8, 0.01)
    film = wanted(story.act(1, design=DESIGN.model_copy(update={"dbr_pairs": 9.5})), "film")
    story.fail(film, code="worker_lost", message="gone")
    (unknown,) = told(story.act(1, move=Move(variable="distance_um", steps=4)))
    assert unknown.failure is not None
    assert unknown.reward == 0.0


@pytest.mark.parametrize(
    ("what", "field"),
    [
        ({"run": "none", "design": DESIGN}, "run"),
        ({"lane": 4, "design": DESIGN}, "lane"),
        ({"number": 1, "design": DESIGN}, "number"),
        ({"move": Move(variable="width_um", steps=1)}, "move"),
        ({"design": DESIGN.model_copy(update={"width_um": 200.0})}, "design"),
    ],
)
def test_actions_that_cannot_be_meant_are_refused(what: dict[str, Any], field: str) -> None:
    """And leave the lane as it was."""
    story = Story()
    action = Action(**({"run": "one", "designer": "d", "lane": 0, "number": 0} | what))
    with pytest.raises(InputError) as caught:
        story.agent.handle(a.Acted(0.0, action))
    assert caught.value.field == field
    assert evaluated(story, design=DESIGN).number == 0


def test_the_same_events_give_the_same_commands() -> None:
    """Nothing hides in clocks or order."""

    def live() -> list[list[Command]]:
        story = Story()
        found = [story.act(lane, design=DESIGN) for lane in range(3)]
        film = wanted(found[0], "film")
        found.append(story.film(film))
        found.append(story.ray(next(c for c in found[-1] if isinstance(c, a.Want))))
        return found

    assert live() == live()


@pytest.mark.parametrize(
    ("name", "uniformity", "before", "reward"),
    [
        ("r1", 0.85, 0.80, 0.05),
        ("r2", 0.8651, 0.1, 1.5248),
        ("r3", 0.9032, 0.1, 1.4506),
        ("gain", 0.85, 0.80, 0.5),
        ("r1", 0.85, None, 0.0),
        ("r3", 0.0, 0.5, -493.039),
    ],
)
def test_rewards_are_those_of_the_paper(name: Any, uniformity: float, before: float | None, reward: float) -> None:
    """Hand-computed from Eqs. 3 to 5, the best states of Table 6 among them."""
    assert reward_of(name, uniformity, before) == pytest.approx(reward, abs=1e-4)


MOVES: tuple[dict[str, Any], ...] = (
    {"design": DESIGN},
    {"move": Move(variable="distance_um", steps=1)},
    {"move": Move(variable="thickness_um", steps=1000)},  # out of the bounds
    {"move": Move(variable="dbr_pairs", steps=1)},
    {"move": Move(variable="distance_um", steps=-1)},
    {"design": DESIGN, "final": True, "seed": "77", "role": "best"},
    {"move": Move(variable="width_um", steps=1)},
)


def walked(story: Story, moves: tuple[dict[str, Any], ...], first: int = 0) -> list[Step]:
    """The steps of some actions, uniformities by their number."""
    return [evaluated(story, 0.5 + 0.01 * (first + i), **what) for i, what in enumerate(moves)]


def gone_on(steps: list[Step]) -> Story:
    """An agent that has read these steps back."""
    story = Story()
    film = Film(sha256="f" * 64, bytes=9)
    films = {pairs: (film_task(plan(), pairs), film) for pairs in {step.design.dbr_pairs for step in steps}}
    past = Past({(step.lane, step.number): step for step in steps}, films, sequence=len(steps))
    story.agent.handle(a.Opened(0.0, plan(), past))
    return story


@pytest.mark.parametrize("known", range(len(MOVES) + 1))
def test_a_run_that_is_gone_on_with_tells_the_same_steps(known: int) -> None:
    """What is on record is told again and not wanted; what follows is as if the agent had never ended."""
    calm = walked(Story(), MOVES)
    story = gone_on(calm[:known])
    for step, what in zip(calm[:known], MOVES, strict=False):
        assert story.act(**what) == [a.Again(step)]
    rest = walked(story, MOVES[known:], known)
    assert [step.content() for step in rest] == [step.content() for step in calm[known:]]


def test_a_designer_may_go_on_where_its_checkpoint_is() -> None:
    """The lane is taken to where the steps before led; what was computed is not computed again."""
    calm = walked(Story(), MOVES)
    story = gone_on(calm)
    story.numbers["one", 0] = 4
    assert story.act(**MOVES[4]) == [a.Again(calm[4])]
    story.numbers["one", 0] = len(MOVES)
    (again,) = told(story.act(design=calm[1].design))
    assert again.cached
    assert again.uniformity == calm[1].uniformity


def test_a_designer_that_walks_otherwise_is_refused() -> None:
    """The design it asks for, the one on record; asked for rightly it goes on."""
    calm = walked(Story(), MOVES)
    story = gone_on(calm)
    with pytest.raises(InputError, match="as on record"):
        story.act(design=DESIGN.model_copy(update={"distance_um": 140.0}))
    assert story.act(**MOVES[0]) == [a.Again(calm[0])]
    story.numbers["one", 0] = len(MOVES) + 3
    with pytest.raises(InputError, match="numbered from 0"):
        story.act(design=DESIGN)
