"""What is known in a run, and what is under way: lanes, trials, the tasks that an evaluation takes."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

from luxloop.campaign import Action, Plan
from luxloop.design import Design
from luxloop.film import FilmTableRequest, Spectrum
from luxloop.messages import Task
from luxloop.ray import Film, RayRequest


@dataclass
class Lane:
    """Where a lane of a run is."""

    design: Design | None = None
    uniformity: float | None = None
    uniformity_error: float = 0.0
    figures: dict[str, Any] = field(default_factory=dict)
    number: int = -1
    busy: bool = False


@dataclass
class Trial:
    """An action under way."""

    run: str
    action: Action
    design: Design
    since_s: float
    physics_s: float = 0.0
    film_task: Task | None = None
    ray_task: Task | None = None
    film_tries: int = 0
    computed: bool = False


@dataclass
class Run:
    """What is known in a run."""

    plan: Plan
    lanes: dict[int, Lane] = field(default_factory=dict)
    films: dict[float, tuple[Task, Film]] = field(default_factory=dict)
    results: OrderedDict[str, dict[str, Any]] = field(
        default_factory=OrderedDict
    )  # the figures of a step, by ray task


def film_task(plan: Plan, pairs: float) -> Task:
    """The task of a run's film: all that decides its table."""
    line = Spectrum(peak_nm=plan.environment.peak_nm, fwhm_nm=plan.environment.fwhm_nm)
    request = FilmTableRequest(environment=plan.environment, dbr_pairs=pairs, effects=plan.effects, spectrum=line)
    return Task.of(request)


def ray_task(plan: Plan, action: Action, design: Design, film: Film | None) -> Task:
    """The task of a design's evaluation, at the action's fidelity."""
    how = plan.final if action.final else plan.walk
    seed = action.seed or how.seed
    request = RayRequest(
        environment=plan.environment,
        design=design,
        film=film,
        effects=plan.effects,
        method=how.method,
        histories=how.histories,
        target_error_points=how.target_error_points,
        budget_s=how.budget_s,
        stored_exits=how.stored_exits,
        seed=seed,
        exit_seed=seed,
    )
    return Task.of(request)
