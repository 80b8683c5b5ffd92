"""The environment-control agent: from an action to a state and its reward. Pure: an event in, commands out, no I/O.

    Acted ─▶ design ─▶ can it be built? ─no─────────────────────────────▶ Tell(uniformity 0, the reason)
                            │ yes
                            ▼
                    is its film's table known? ─no─▶ Want(film) ··· Ended ─┐
                            │ yes                                          │
                            ▼◀─────────────────────────────────────────────┘
                    is the design's result known? ─no─▶ Want(ray) ··· Ended ─▶ Record, Tell(state, reward)
                            │ yes
                            └──────────────────────────────────────────▶ Tell(the same again, cached)

Lanes are independent, so workers of both kinds have work at once. Films of the neighbouring pair counts are wanted
ahead of time. `story` tells what happened to an action.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from env_controller import actions as a
from env_controller.events import Command, Event
from env_controller.rewards import reward_of
from env_controller.trials import Lane, Run, Trial, film_task, ray_task
from luxloop.campaign import Action, Plan, Step
from luxloop.design import Design
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.ray import Film

NEIGHBOURS = (-0.5, 0.5, -1.0, 1.0)  # pairs: the films that a next step may need
FILM_RETRIES = 2  # a table may have gone with who held it
STORIES = 1000
KNOWN = 100_000  # designs of a run whose figures are kept, 2 kB each


class EnvironmentAgent:
    """All runs that are open. `handle` is the only way to change it."""

    def __init__(self) -> None:
        self.runs: dict[str, Run] = {}
        self._trials: dict[str, list[Trial]] = {}  # by the task they wait for
        self._ahead: dict[str, set[tuple[str, float]]] = {}  # runs and pairs, by film task
        self._stories: OrderedDict[tuple[str, int, int], list[str]] = OrderedDict()
        self._rules: dict[type[Event], Callable[[Any], list[Command]]] = {
            a.Opened: self._opened,
            a.Acted: self._acted,
            a.Ended: self._ended,
            a.Closed: self._closed,
        }

    def handle(self, event: Event) -> list[Command]:
        """The commands that follow from one event. Raises InputError for an action that cannot be meant."""
        return self._rules[type(event)](event)

    def story(self, run: str, lane: int, number: int) -> list[str]:
        """What happened to an action, one line each, oldest first."""
        return list(self._stories.get((run, lane, number), []))

    def wanting(self, task_id: str) -> list[str]:
        """The runs that wait for a task, or want it ahead of time."""
        waiting = [trial.run for trial in self._trials.get(task_id, ())]
        return list(dict.fromkeys([*waiting, *(run for run, _ in self._ahead.get(task_id, ()))]))

    def _opened(self, event: a.Opened) -> list[Command]:
        self.runs[event.plan.run] = Run(event.plan, event.past)
        return []

    def _closed(self, event: a.Closed) -> list[Command]:
        """What that run alone waited for or wanted ahead is of no use any more."""
        self.runs.pop(event.run, None)
        wanted = dict.fromkeys([*self._trials, *self._ahead])
        self._trials = {
            task_id: waiting
            for task_id, trials in self._trials.items()
            if (waiting := [trial for trial in trials if trial.run != event.run])
        }
        self._ahead = {
            task_id: left
            for task_id, wishes in self._ahead.items()
            if (left := {wish for wish in wishes if wish[0] != event.run})
        }
        return [a.Unwant(task_id) for task_id in wanted if not self.wanting(task_id)]

    def _acted(self, event: a.Acted) -> list[Command]:
        action = event.action
        run = self._run(action.run)
        lane = self._lane(run, action)
        design = self._aim(run.plan, lane, action)
        on_record = run.past.steps.get((action.lane, action.number))
        if on_record is not None:
            return [self._again(lane, action, design, on_record)]
        if design is None:
            return self._blocked(event, run, lane)
        lane.number, lane.busy = action.number, True
        trial = Trial(action.run, action, design, event.at_s)
        self._tell(trial, event.at_s, f"to be evaluated: {design}")
        reason = design.feasibility(run.plan.environment.distance_from, run.plan.environment.spacing_is)
        if reason is not None:
            return [self._told(run, trial, event.at_s, uniformity=0.0, feasible=False, reason=reason)]
        return self._film_first(run, trial, event.at_s)

    @staticmethod
    def _again(lane: Lane, action: Action, design: Design | None, step: Step) -> a.Again:
        """The step on record, where it is of the same design: a designer that walks otherwise is another one."""
        asked = (design or lane.design, action.move, action.final, action.role)
        if asked != (step.design, step.move, step.final, step.role):
            mend = "its settings, its checkpoint or its code are not those of the run: begin a new one"
            raise InputError("design", str(asked[0]), f"{step.design}, as on record", mend)
        lane.follow(step)
        return a.Again(step)

    def _run(self, name: str) -> Run:
        if name not in self.runs:
            raise InputError("run", name, "a run that is open here", "begin it first")
        return self.runs[name]

    def _lane(self, run: Run, action: Action) -> Lane:
        if action.lane >= run.plan.lanes:
            raise InputError("lane", action.lane, f"0 to {run.plan.lanes - 1}, as planned")
        lane = run.lane(action.lane, action.number)
        if lane.busy or action.number != lane.number + 1:
            allowed = f"{lane.number + 1} once {lane.number} is answered" if lane.busy else str(lane.number + 1)
            raise InputError("number", action.number, allowed, "a lane's actions are numbered from 0, one at a time")
        return lane

    def _aim(self, plan: Plan, lane: Lane, action: Action) -> Design | None:
        """The design that an action asks for; None for a move out of the bounds."""
        if action.design is not None:
            if not action.final and not plan.bounds.contains(action.design):
                allowed = f"from {plan.bounds.low} to {plan.bounds.high}"
                raise InputError("design", str(action.design), allowed, "stay within the run's bounds")
            return action.design
        if lane.design is None or action.move is None:
            raise InputError("move", str(action.move), "a design", "a lane begins with a design")
        return plan.bounds.moved(lane.design, action.move.variable, action.move.steps)

    def _blocked(self, event: a.Acted, run: Run, lane: Lane) -> list[Command]:
        """A move out of the bounds: the lane stays where it is."""
        action, design = event.action, lane.design
        assert design is not None  # noqa: S101  # `_moved` looked
        lane.number, lane.busy = action.number, True
        trial = Trial(action.run, action, design, event.at_s)
        reason = f"the move leads out of the bounds of {action.move.variable}" if action.move else ""
        self._tell(trial, event.at_s, reason)
        if lane.uniformity is None:
            mend = "begin anew with a design"
            unknown = Failure(code="refused", message="the lane's design could not be evaluated before", mend=mend)
            return [self._told(run, trial, event.at_s, uniformity=0.0, failure=unknown)]
        known = {"uniformity_error": lane.uniformity_error, "figures": lane.figures, "cached": True}
        return [self._told(run, trial, event.at_s, uniformity=lane.uniformity, reason=reason, **known)]

    def _film_first(self, run: Run, trial: Trial, at_s: float) -> list[Command]:
        pairs = trial.design.dbr_pairs
        if pairs == 0.0:
            return self._ray(run, trial, None, at_s)
        ahead = self._films_ahead(run, pairs)
        if pairs in run.films:
            trial.film_task, film = run.films[pairs]
            return [*self._ray(run, trial, film, at_s), *ahead]
        trial.film_task = film_task(run.plan, pairs)
        self._trials.setdefault(trial.film_task.id, []).append(trial)
        self._tell(trial, at_s, f"waits for the film of {pairs:g} pairs")
        return [a.Want(trial.run, trial.film_task), *ahead]

    def _films_ahead(self, run: Run, pairs: float) -> list[Command]:
        """Films that a next step may need, those within the bounds that are neither known nor wanted."""
        low, high = run.plan.bounds.low.dbr_pairs, run.plan.bounds.high.dbr_pairs
        commands: list[Command] = []
        for near in (pairs + change for change in NEIGHBOURS):
            if not max(low, 0.5) <= near <= high or near in run.films:
                continue
            task, wish = film_task(run.plan, near), (run.plan.run, near)
            wishes = self._ahead.setdefault(task.id, set())
            if wish not in wishes:
                wishes.add(wish)
                commands.append(a.Want(run.plan.run, task, ahead=True))
        return commands

    def _ray(self, run: Run, trial: Trial, film: Film | None, at_s: float) -> list[Command]:
        trial.ray_task = ray_task(run.plan, trial.action, trial.design, film)
        known = run.results.get(trial.ray_task.id)
        if known is not None:
            return [self._evaluated(run, trial, known, at_s)]
        self._trials.setdefault(trial.ray_task.id, []).append(trial)
        self._tell(trial, at_s, "waits for its rays")
        return [a.Want(trial.run, trial.ray_task, group=film.sha256 if film else "")]

    def _ended(self, event: a.Ended) -> list[Command]:
        commands: list[Command] = [a.Record(run, event.task_id) for run in self.wanting(event.task_id)]
        trials = self._trials.pop(event.task_id, [])
        ahead = self._ahead.pop(event.task_id, set())
        if any(trial.ray_task is None for trial in trials) or ahead:
            self._keep_film(event, trials, ahead)
        counted: set[str] = set()
        for trial in trials:
            again = trial.run in counted  # one computation counts once in a run, with the first who waited
            commands += self._go_on(self.runs[trial.run], trial, replace(event, kept=True) if again else event)
            counted.add(trial.run)
        return commands

    def _keep_film(self, event: a.Ended, trials: list[Trial], ahead: set[tuple[str, float]]) -> None:
        if event.result is None:
            return
        film = Film(sha256=event.result["table_sha256"], bytes=event.result["table_bytes"])
        wishes = ahead | {(trial.run, trial.design.dbr_pairs) for trial in trials}
        for name, pairs in wishes:
            if name in self.runs:
                self.runs[name].films[pairs] = film_task(self.runs[name].plan, pairs), film

    def _go_on(self, run: Run, trial: Trial, event: a.Ended) -> list[Command]:
        """What follows for one action from a task's end."""
        trial.physics_s += 0.0 if event.kept else event.compute_s
        if trial.ray_task is None and event.failure is None:
            self._tell(trial, event.at_s, "has its film")
            return self._ray(run, trial, run.films[trial.design.dbr_pairs][1], event.at_s)
        if event.failure is None and event.result is not None:
            trial.computed = not event.kept
            run.results[event.task_id] = figures_of(event.result["metrics"])
            while len(run.results) > KNOWN:
                run.results.popitem(last=False)
            return [self._evaluated(run, trial, run.results[event.task_id], event.at_s)]
        failure = event.failure or Failure(code="crashed", message="no result")
        lost_film = failure.code == "not_found" and failure.field == "film"
        if lost_film and trial.film_task is not None and trial.film_tries < FILM_RETRIES:
            trial.film_tries += 1
            trial.ray_task = None
            run.films.pop(trial.design.dbr_pairs, None)
            self._trials.setdefault(trial.film_task.id, []).append(trial)
            self._tell(trial, event.at_s, "its film has gone, it is computed again")
            return [a.Want(trial.run, trial.film_task, fresh=True)]
        self._tell(trial, event.at_s, f"failed: {failure.text()}")
        return [self._told(run, trial, event.at_s, uniformity=0.0, failure=failure)]

    def _evaluated(self, run: Run, trial: Trial, figures: dict[str, Any], at_s: float) -> a.Tell:
        found = figures["uniformity"]
        return self._told(
            run,
            trial,
            at_s,
            uniformity=float(found["value"]),
            uniformity_error=float(found["standard_error"]),
            figures=figures,
            cached=not trial.computed,
        )

    def _told(self, run: Run, trial: Trial, at_s: float, **found: Any) -> a.Tell:
        """The step of an action, and the lane where it leads; a finalist leaves its lane where it was."""
        action = trial.action
        lane = run.lanes[action.lane]
        failed = found.get("failure") is not None
        uniformity = found["uniformity"]
        before = None if action.move is None else lane.uniformity  # a beginning: nothing was gained
        worth = 0.0 if failed or action.final else reward_of(run.plan.reward, uniformity, before)
        self._tell(trial, at_s, f"uniformity {uniformity:.4f}, reward {worth:.4f}")
        x = np.clip(run.plan.bounds.normalise(trial.design), -1.0, 1.0)
        step = Step(
            run=action.run,
            lane=action.lane,
            number=action.number,
            design=trial.design,
            move=action.move,
            state=tuple(map(float, x)),
            reward=worth,
            final=action.final,
            role=action.role,
            task_id=trial.ray_task.id if trial.ray_task else None,
            film_task_id=trial.film_task.id if trial.film_task else None,
            physics_s=trial.physics_s,
            controller_s=max(at_s - trial.since_s, 0.0),
            **found,
        )
        lane.follow(step)
        return a.Tell(step)

    def _tell(self, trial: Trial, at_s: float, what: str) -> None:
        key = trial.run, trial.action.lane, trial.action.number
        self._stories.setdefault(key, []).append(f"{at_s:.3f} {what}")
        while len(self._stories) > STORIES:
            self._stories.popitem(last=False)


def figures_of(metrics: dict[str, Any]) -> dict[str, Any]:
    """The metrics of a ray result that a step carries; of the uniformity its bias and truncation, too."""
    return {name: metrics[name] for name in Step.FIGURES if name in metrics}
