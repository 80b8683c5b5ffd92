"""A campaign: a designer's proposals become actions, steps come back, the finalists are evaluated anew.

Lanes take turns in a fixed order, so what a designer proposes does not depend on which worker is faster: step s of
lane 0 is told, then of lane 1, and so on, while the other lanes' designs are under evaluation.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

from agent.ask_tell import Checkpoint, Designer, Proposal
from agent.config import Stop
from agent.progress import FINALISTS, Found, Past, Progress, WalkEnd
from luxloop.campaign import Action, Role, Step
from luxloop.design import Design
from luxloop.words import sha256_of

INTERRUPTED = "interrupted"
NOTHING_TOLD = "0" * 64
SIGMAS = 2.0  # a gain above so many of its standard errors counts; that designs share their seed is left out


class Door(Protocol):
    """Where actions are carried out: a run at the controller, or something like it in a test."""

    run: str
    designer: str

    def act(self, action: Action) -> Step:
        """The step that comes of an action."""
        ...


class Interrupted(Exception):  # noqa: N818  no error: somebody wants to go on later
    """The campaign was stopped before its end; what was under way has been waited for."""


class Runner:
    """Runs one campaign through a door. `stop_wanted` is looked at between steps.

    `past` is what the door knows already: walked again, those steps come back as they were. `on_turn` is called with
    the runner where its `state` can be taken, `on_walk_end` when the walk has ended for good, `on_leave` when `run`
    is left: after an error it lets go of what the door is still asked.
    """

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
        past: Past | None = None,
        on_turn: Callable[[Runner], None] = lambda _: None,
        on_walk_end: Callable[[WalkEnd], None] = lambda _: None,
        on_leave: Callable[[], None] = lambda: None,
    ) -> None:
        self._door, self.designer, self._stop, self._look = door, designer, stop, look
        self._lanes, self._seed, self._stop_wanted = lanes, seed, stop_wanted
        self._past, self._on_turn, self._on_walk_end = past or Past(), on_turn, on_walk_end
        self._on_leave = on_leave
        self._numbers = [0] * lanes
        self._turn, self._end = 0, WalkEnd(0, "")
        self._under_way: dict[int, tuple[Proposal, Future[Step]]] = {}
        self.digests = [NOTHING_TOLD] * lanes
        """Of each lane's steps so far, in their order."""
        self.progress = Progress(before_s=self._past.wall_s)
        self.failures: Counter[str] = Counter()  # why steps of this start failed

    def state(self) -> Checkpoint:
        """All that runner and designer are, between two turns."""
        chooser = self.designer.state()
        words = {
            "turn": self._turn,
            "numbers": list(self._numbers),
            "told": [number - (lane in self._under_way) for lane, number in enumerate(self._numbers)],
            "digests": list(self.digests),
            "end": list(self._end),
            "progress": self.progress.plain(),
            "designer": chooser.words,
        }
        return Checkpoint(words, chooser.arrays)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Become what `state` was taken from. Raises InputError where that was of another designer."""
        words = checkpoint.words
        self.designer.restore(Checkpoint(words["designer"], checkpoint.arrays))
        self._turn, self._end = words["turn"], WalkEnd(*words["end"])
        self._numbers, self.digests = list(words["numbers"]), list(words["digests"])
        self.progress = Progress.of_plain(words["progress"], self._past.wall_s)

    def run(self, finalists: int, *, without_dbr: bool = True) -> Found:
        """Walk until a reason to stop, then evaluate the best designs anew; they are told nobody but the journal.

        Left with an error, a second Ctrl-C among them, nothing under way is waited for.
        """
        pool = ThreadPoolExecutor(self._lanes, thread_name_prefix="lane")
        try:
            self._resend(pool)
            self._walk(pool)
            if self._past.end is None:
                self._on_walk_end(self._end)
            return self._finals(pool, self._end.reason, finalists, without_dbr)
        except Interrupted:
            return Found(INTERRUPTED, self.progress, (), None, None, None)
        finally:
            self._on_leave()
            pool.shutdown(wait=True)  # not cancelled: an audit asks for all that its designer decided

    def _resend(self, pool: ThreadPoolExecutor) -> None:
        """What was under way when the state was taken is asked for once more."""
        for lane in range(self._lanes):
            proposal = self.designer.awaited(lane)
            if proposal is not None:
                action = self._action(lane, proposal, self._numbers[lane] - 1)
                self._under_way[lane] = proposal, pool.submit(self._door.act, action)

    def _walk(self, pool: ThreadPoolExecutor) -> None:
        """Turn after turn. Interrupted, what is under way is waited for and not told: `state` has it to be sent."""
        while True:
            self._on_turn(self)
            if self._stop_wanted():
                for _, future in self._under_way.values():
                    future.result()
                raise Interrupted
            lane = self._turn % self._lanes
            self._turn += 1
            if lane in self._under_way:
                proposal, future = self._under_way[lane]
                self._learn()
                step = future.result()
                del self._under_way[lane]
                self._take(lane, proposal, step)
                if not self._end.reason:
                    self._end = WalkEnd(self.progress.steps, self._reason())
            if not self._end.reason and self.progress.evaluations + len(self._under_way) < self._stop.evaluations:
                proposed = self._ask(lane)
                if proposed is not None:
                    action = self._action(lane, proposed, self._next_number(lane))
                    self._under_way[lane] = proposed, pool.submit(self._door.act, action)
            if not self._under_way:
                if not self._end.reason:
                    self._end = WalkEnd(self.progress.steps, "complete: the designer has proposed all it had")
                return

    def _learn(self) -> None:
        """What the designer has to compute, while answers are awaited."""
        began_s = time.thread_time()
        self.designer.learn()
        self.progress.learner_s += time.thread_time() - began_s

    def _ask(self, lane: int) -> Proposal | None:
        began_s = time.thread_time()
        proposal = self.designer.ask(lane)
        self.progress.learner_s += time.thread_time() - began_s
        return proposal

    def _next_number(self, lane: int) -> int:
        """The next number of a lane's actions."""
        number, self._numbers[lane] = self._numbers[lane], self._numbers[lane] + 1
        return number

    def _action(self, lane: int, proposal: Proposal, number: int) -> Action:
        how = {"design": proposal.design, "move": proposal.move, "agent": proposal.record}
        return Action(run=self._door.run, designer=self._door.designer, lane=lane, number=number, **how)

    def _take(self, lane: int, proposal: Proposal, step: Step) -> None:
        began_s = time.thread_time()
        self.designer.tell(lane, step)
        self.digests[lane] = digest_after(self.digests[lane], step)
        seen = self.progress
        seen.learner_s += time.thread_time() - began_s
        seen.steps, seen.last, seen.epsilon = seen.steps + 1, step, proposal.record.epsilon
        seen.evaluations, seen.physics_s = self.designer.known.evaluations, seen.physics_s + step.physics_s
        seen.episodes = max(seen.episodes, proposal.record.episode + 1)
        self._count_failure(step)
        if step.failure is None and step.feasible:
            seen.first = seen.first or step
            if seen.best is None or step.uniformity > seen.best.uniformity:
                seen.best = step
            if seen.gained is None or _gain(step, seen.gained) > SIGMAS * _error(step, seen.gained):
                seen.gained, seen.gained_episode = step, seen.episodes
        self._look(seen)

    def _count_failure(self, step: Step) -> None:
        if step.failure is not None:
            self.failures[step.failure.text()] += 1

    def _reason(self) -> str:
        """Why to stop now; empty to go on. What was decided before is decided again."""
        seen, stop = self.progress, self._stop
        if self._past.end is not None and seen.steps <= self._past.end.steps:
            return self._past.end.reason if seen.steps == self._past.end.steps else ""
        if seen.evaluations >= stop.evaluations:
            return f"budget: {seen.evaluations} evaluations"
        if seen.steps >= stop.most_steps:
            return f"steps: {seen.steps}, of {seen.evaluations} designs"
        if stop.time_s is not None and seen.wall_s >= stop.time_s and seen.steps > self._past.steps:
            return f"time: {seen.wall_s:.0f} s"
        return self.saturation(self._lanes)

    def saturation(self, under_way: int) -> str:
        """Whether so many episodes without a gain are over that it is enough; `under_way` are not: one of a lane."""
        seen, enough = self.progress, self._stop.episodes_without_gain
        quiet = seen.episodes - under_way - seen.gained_episode
        if enough is None or quiet < enough:
            return ""
        return f"saturation: no gain above twice its error in {quiet} episodes"

    def _finals(self, pool: ThreadPoolExecutor, reason: str, count: int, without_dbr: bool) -> Found:
        """The best of the walk and where it began, then the winner once more and without its mirror.

        All with seeds of their own at the final fidelity. Finalists that failed come last; where all have, the first
        is tried once more.
        """
        self.progress.stage = FINALISTS
        self._look(self.progress)
        known = self.designer.known
        best = [key for key in known.best_first() if known.uniformity[key] > 0.0][:count]
        start = self.progress.first
        wanted: list[tuple[Role, Design]] = [("finalist", Design.from_vector(key)) for key in best]
        first = self._evaluated(pool, [*wanted, ("start", start.design)] if start else wanted)
        began = first.pop() if start else None
        finalists = tuple(sorted(first, key=lambda step: (step.failure is not None, -step.uniformity)))
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
            if self._stop_wanted():
                raise Interrupted
            futures = []
            for lane, (role, design) in enumerate(wanted[begin : begin + self._lanes]):
                seed = fresh_seed(self._seed, role, begin + lane)
                action = Action(
                    run=self._door.run, designer=self._door.designer, lane=lane, number=self._next_number(lane),
                    design=design, final=True, seed=seed, role=role,
                )  # fmt: skip
                futures.append(pool.submit(self._door.act, action))
            for future in futures:
                step = future.result()
                self.progress.physics_s += step.physics_s
                self.progress.last = step
                self._count_failure(step)
                self._look(self.progress)
                steps.append(step)
        return steps


def digest_after(digest: str, step: Step) -> str:
    """The digest of a lane's steps that now ends with this one: of what is the same in any run of plan and seed."""
    return sha256_of({"before": digest, "step": step.content()})


def fresh_seed(seed: int, what: str, number: int) -> str:
    """A seed that no step of the walk had: of the campaign's seed, what it is for and its number there."""
    return str(int(sha256_of({"seed": str(seed), "what": what, "number": number})[:15], 16))


def _gain(step: Step, best: Step) -> float:
    return step.uniformity - best.uniformity


def _error(step: Step, best: Step) -> float:
    return float((step.uniformity_error**2 + best.uniformity_error**2) ** 0.5)
