"""A campaign: a designer's proposals become actions, steps come back, the finalists are evaluated anew.

Lanes take turns in a fixed order, so what a designer proposes does not depend on which worker is faster: step s of
lane 0 is told, then of lane 1, and so on, while the other lanes' designs are under evaluation.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Protocol

from agent.ask_tell import Designer, Proposal
from agent.config import Stop
from agent.in_words import plain
from luxloop.campaign import Action, Role, Step
from luxloop.design import Design
from luxloop.words import sha256_of

SIGMAS = 2.0  # a gain above so many of its standard errors counts; that designs share their seed is left out


class Door(Protocol):
    """Where actions are carried out: a run at the controller, or something like it in a test."""

    run: str
    designer: str

    def act(self, action: Action) -> Step:
        """The step that comes of an action."""
        ...


@dataclass
class Progress:
    """How far a campaign is, for whoever looks on."""

    steps: int = 0
    evaluations: int = 0
    episodes: int = 0
    physics_s: float = 0.0
    learner_s: float = 0.0
    began_s: float = field(default_factory=time.monotonic)
    first: Step | None = None
    best: Step | None = None
    gained: Step | None = None  # the best at the last gain that counted
    last: Step | None = None
    epsilon: float | None = None
    gained_episode: int = 0
    stage: str = "walk"

    @property
    def wall_s(self) -> float:
        """Since the first action."""
        return time.monotonic() - self.began_s


@dataclass(frozen=True)
class Found:
    """What a campaign came to."""

    reason: str
    progress: Progress
    finalists: tuple[Step, ...]
    """The best first."""
    start: Step | None
    best: Step | None
    """The best finalist, evaluated once more: the best of five noisy numbers is flattered, this one is not."""
    without_dbr: Step | None

    def summary(self) -> dict[str, Any]:
        """The result as plain values, for the journal and for `--json`."""
        seen = self.progress
        return {
            "reason": self.reason,
            "steps": seen.steps,
            "evaluations": seen.evaluations,
            "episodes": seen.episodes,
            "wall_s": seen.wall_s,
            "physics_s": seen.physics_s,
            "learner_s": seen.learner_s,
            "start": plain(self.start),
            "best": plain(self.best),
            "without_dbr": plain(self.without_dbr),
            "finalists": [plain(step) for step in self.finalists],
        }


class Runner:
    """Runs one campaign through a door. `stop_wanted` is looked at between steps."""

    def __init__(
        self,
        door: Door,
        designer: Designer,
        stop: Stop,
        *,
        lanes: int,
        seed: int,
        look: Callable[[Progress], None] = lambda _: None,
        stop_wanted: Callable[[], bool] = lambda: False,
    ) -> None:
        self._door, self._designer, self._stop, self._look = door, designer, stop, look
        self._lanes, self._seed, self._stop_wanted = lanes, seed, stop_wanted
        self._numbers = [0] * lanes
        self.progress = Progress()

    def run(self, finalists: int, *, without_dbr: bool = True) -> Found:
        """Walk until a reason to stop, then evaluate the best designs anew; they are told nobody but the journal."""
        with ThreadPoolExecutor(self._lanes, thread_name_prefix="lane") as pool:
            reason = self._walk(pool)
            if self._stop_wanted():
                return Found(reason, self.progress, (), None, None, None)
            return self._finals(pool, reason, finalists, without_dbr)

    def _walk(self, pool: ThreadPoolExecutor) -> str:
        """Turn after turn; why it ended."""
        self.progress.began_s = time.monotonic()
        under_way: dict[int, tuple[Proposal, Future[Step]]] = {}
        reason = ""
        turn = 0
        while True:
            lane = turn % self._lanes
            turn += 1
            if lane in under_way:
                proposal, future = under_way.pop(lane)
                self._learn()
                self._take(lane, proposal, future.result())
                reason = reason or self._reason()
            if not reason and self.progress.evaluations + len(under_way) < self._stop.evaluations:
                proposed = self._ask(lane)
                if proposed is not None:
                    under_way[lane] = proposed, pool.submit(self._door.act, self._action(lane, proposed))
            if not under_way:
                return reason or "complete: the designer has proposed all it had"

    def _learn(self) -> None:
        """What the designer has to compute, while answers are awaited."""
        began_s = time.thread_time()
        self._designer.learn()
        self.progress.learner_s += time.thread_time() - began_s

    def _ask(self, lane: int) -> Proposal | None:
        began_s = time.thread_time()
        proposal = self._designer.ask(lane)
        self.progress.learner_s += time.thread_time() - began_s
        return proposal

    def _action(self, lane: int, proposal: Proposal) -> Action:
        return self._numbered(lane, design=proposal.design, move=proposal.move, agent=proposal.record)

    def _numbered(self, lane: int, **what: Any) -> Action:
        number, self._numbers[lane] = self._numbers[lane], self._numbers[lane] + 1
        return Action(run=self._door.run, designer=self._door.designer, lane=lane, number=number, **what)

    def _take(self, lane: int, proposal: Proposal, step: Step) -> None:
        began_s = time.thread_time()
        self._designer.tell(lane, step)
        seen = self.progress
        seen.learner_s += time.thread_time() - began_s
        seen.steps, seen.last, seen.epsilon = seen.steps + 1, step, proposal.record.epsilon
        seen.evaluations, seen.physics_s = self._designer.known.evaluations, seen.physics_s + step.physics_s
        seen.episodes = max(seen.episodes, proposal.record.episode + 1)
        if step.failure is None and step.feasible:
            seen.first = seen.first or step
            if seen.best is None or step.uniformity > seen.best.uniformity:
                seen.best = step
            if seen.gained is None or _gain(step, seen.gained) > SIGMAS * _error(step, seen.gained):
                seen.gained, seen.gained_episode = step, seen.episodes
        self._look(seen)

    def _reason(self) -> str:
        """Why to stop now; empty to go on."""
        seen, stop = self.progress, self._stop
        if self._stop_wanted():
            return "interrupted"
        if seen.evaluations >= stop.evaluations:
            return f"budget: {seen.evaluations} evaluations"
        if seen.steps >= stop.most_steps:
            return f"steps: {seen.steps}, of {seen.evaluations} designs"
        if stop.time_s is not None and seen.wall_s >= stop.time_s:
            return f"time: {seen.wall_s:.0f} s"
        quiet = seen.episodes - seen.gained_episode
        if stop.episodes_without_gain is not None and quiet >= stop.episodes_without_gain:
            return f"saturation: no gain above twice its error in {quiet} episodes"
        return ""

    def _finals(self, pool: ThreadPoolExecutor, reason: str, count: int, without_dbr: bool) -> Found:
        """The best of the walk and where it began, then the winner once more and without its mirror.

        All with seeds of their own at the final fidelity.
        """
        self.progress.stage = "finalists"
        self._look(self.progress)
        known = self._designer.known
        best = [key for key in known.best_first() if known.uniformity[key] > 0.0][:count]
        start = self.progress.first
        wanted: list[tuple[Role, Design]] = [("finalist", Design.from_vector(key)) for key in best]
        first = self._evaluated(pool, [*wanted, ("start", start.design)] if start else wanted)
        began = first.pop() if start else None
        finalists = tuple(sorted(first, key=lambda step: -step.uniformity))
        if not finalists:
            return Found(reason, self.progress, (), began, None, None)
        winner = finalists[0].design
        last: list[tuple[Role, Design]] = [("best", winner)]
        if without_dbr and winner.dbr_pairs > 0.0:
            last.append(("without_dbr", winner.model_copy(update={"dbr_pairs": 0.0})))
        again, *bare = self._evaluated(pool, last)
        return Found(reason, self.progress, finalists, began, again, bare[0] if bare else None)

    def _evaluated(self, pool: ThreadPoolExecutor, wanted: Sequence[tuple[Role, Design]]) -> list[Step]:
        """The steps of some designs at the final fidelity, each with a seed of its own; several lanes at once."""
        steps: list[Step] = []
        for begin in range(0, len(wanted), self._lanes):
            futures = []
            for lane, (role, design) in enumerate(wanted[begin : begin + self._lanes]):
                seed = fresh_seed(self._seed, role, begin + lane)
                action = self._numbered(lane, design=design, final=True, seed=seed, role=role)
                futures.append(pool.submit(self._door.act, action))
            for future in futures:
                step = future.result()
                self.progress.physics_s += step.physics_s
                self.progress.last = step
                self._look(self.progress)
                steps.append(step)
        return steps


def fresh_seed(seed: int, what: str, number: int) -> str:
    """A seed that no step of the walk had: of the campaign's seed, what it is for and its number there."""
    return str(int(sha256_of({"seed": str(seed), "what": what, "number": number})[:15], 16))


def _gain(step: Step, best: Step) -> float:
    return step.uniformity - best.uniformity


def _error(step: Step, best: Step) -> float:
    return float((step.uniformity_error**2 + best.uniformity_error**2) ** 0.5)
