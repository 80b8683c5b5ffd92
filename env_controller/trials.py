"""What is known in a run, and what is under way: lanes, trials, the tasks that an evaluation takes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from luxloop.campaign import Action, Plan, Step
from luxloop.design import Design
from luxloop.film import FilmTableRequest, Spectrum
from luxloop.journal.chain import Mark
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

    def follow(self, step: Step) -> None:
        """Go where a step leads; a final one leaves the lane where it was, after a failed one nothing is compared."""
        self.number, self.busy = step.number, False
        if not step.final:
            self.design, self.uniformity = step.design, None if step.failure else step.uniformity
            self.uniformity_error, self.figures = step.uniformity_error, step.figures


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


@dataclass(frozen=True)
class Past:
    """What is on record of a run: steps by (lane, number), films by pairs, the next step's place in its sequence.

    `mark` is how far the chain had come when the journal was verified, `ends` how its last segment ended then.
    """

    steps: dict[tuple[int, int], Step] = field(default_factory=dict)
    films: dict[float, tuple[Task, Film]] = field(default_factory=dict)
    sequence: int = 0
    mark: Mark | None = None
    ends: tuple[str, int] | None = None

    @property
    def results(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """The figures of every design that was evaluated, by ray task."""
        return ((step.task_id, step.figures) for step in self.steps.values() if step.task_id and not step.failure)


@dataclass
class Run:
    """What is known in a run."""

    plan: Plan
    past: Past = field(default_factory=Past)
    lanes: dict[int, Lane] = field(default_factory=dict)
    films: dict[float, tuple[Task, Film]] = field(default_factory=dict)
    results: OrderedDict[str, dict[str, Any]] = field(default_factory=OrderedDict)
    """The figures of a step, by ray task."""

    def __post_init__(self) -> None:
        self.films |= self.past.films
        self.results.update(self.past.results)

    def lane(self, number: int, action: int) -> Lane:
        """A lane before its action of this number: as far as its steps are on record it is taken there.

        A designer that goes on begins where its checkpoint is, or at the beginning.
        """
        lane = self.lanes.setdefault(number, Lane())
        while not lane.busy and lane.number + 1 < action and (number, lane.number + 1) in self.past.steps:
            lane.follow(self.past.steps[number, lane.number + 1])
        return lane


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
