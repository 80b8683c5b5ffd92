"""Level 3 of a replay: the designer is built anew and told what the journal says; does it decide the same again?

    campaign.json, plan.json ─▶ designer ─▶ Runner ──action──▶ a door that answers from the journal
                                                 ◀──step────

Each action is compared with the step that came of it: the design, the move, what the learner was like (epsilon, Q,
loss, number of updates, hash of its weights), a finalist's seed; at the end why the walk ended, and what was found.
Every step on record must have been asked for, and in a run that was over every step that is asked for must be on
record. After an action that differs nothing can be compared: the designer would be told of a design that it did not
propose.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from agent.campaign import Runner
from agent.config import Campaign
from agent.designers import designer
from agent.moves import Space
from agent.progress import Found, Past, WalkEnd
from luxloop.audit import Compared, Place
from luxloop.campaign import Action, AgentRecord, Move, Plan, Step
from luxloop.design import Design
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import ENDED, VALIDATION
from luxloop.model import flat

EXACT = ("episode", "greedy", "updates")
REAL = ("epsilon", "q", "loss")
OTHER_MACHINE = 1e-3
"""Relative: how far Q and loss may be off where packages or processor are others; float32 rounds by 6e-8."""
NEEDED = ("plan.json", "campaign.json")
RESULT = ("reason", "steps", "evaluations", "episodes", "start", "best", "without_dbr", "finalists")
"""Of what was found: all that no clock decides."""
TIME = "time:"
NOWHERE, NEVER_ASKED, HAS_ENDED = "not on record", "the designer never asks for it", "none: the designer has ended"


class JournalEnds(Exception):  # noqa: N818  no error: a run that was killed or goes on is re-decided as far as it goes
    """The designer asks for what is not on record."""


class Diverged(Exception):  # noqa: N818  it is told as a comparison
    """The designer asks for another design than on record."""


def re_decide(journal: RunJournal, say: Callable[[Compared], None], *, same_machine: bool) -> None:
    """Compares every proposal of the designer, what its learner was like, and what it found, with the journal.

    Raises InputError where plan or settings on record are none.
    """
    if journal.metadata("run").get("kind") == VALIDATION:
        return  # nobody proposes there
    attachments = journal.attachments()
    for name in NEEDED:
        if name not in attachments:
            Place(say).nothing("proposal", f"there is no {name}: it is not a run of `luxloop campaign run` or `grid`")
            return
    plan, campaign = journal.attached("plan.json", Plan), journal.attached("campaign.json", Campaign)
    past = read_back(journal)
    door = RecordedDoor(plan, past, say, same_machine)
    chooser = designer(
        campaign.designer, Space.of(plan), seed=campaign.seed, lanes=campaign.lanes, start=campaign.start,
        learning=campaign.learner,
    )  # fmt: skip
    timed = past.end is not None and past.end.reason.startswith(TIME) and campaign.stop.time_s is not None
    walked = sum(not one.step.final for one in past.steps.values())
    runner = AsCounted(
        door, chooser, campaign.stop.model_copy(update={"time_s": None}), lanes=campaign.lanes, seed=campaign.seed,
        past=Past(walked, end=past.end if timed else None), on_walk_end=lambda end: walk_end(past, end, Place(say)),
    )  # fmt: skip
    runner.recorded = past.end
    try:
        found = runner.run(campaign.finalists, without_dbr=plan.kind == "campaign")
    except (Diverged, JournalEnds):
        found = None
    left_over(door, found, say)
    if found is not None and not door.diverged:
        result(past, found, Place(say))


class AsCounted(Runner):
    """A runner that counts episodes without a gain as today or, where the record says so, as once: all begun ones."""

    recorded: WalkEnd | None = None

    def saturation(self, under_way: int) -> str:
        """As a runner says it; of an older run at its end by the count of then."""
        end, then = self.recorded, super().saturation(0)
        if end is not None and (self.progress.steps, then) == (end.steps, end.reason):
            return then
        return super().saturation(under_way)


def walk_end(past: Record, now: WalkEnd, at: Place) -> None:
    """Compares when and why the walk ended; a run that was killed at that moment does not say it."""
    if past.end is not None or past.over:
        at.exact("end of the walk", past.end.line if past.end else NOWHERE, now.line)


def left_over(door: RecordedDoor, found: Found | None, say: Callable[[Compared], None]) -> None:
    """Compares what is on record and never came of the designer, and what was asked for and is not on record.

    Of a run that is not over the journal may end before its designer does.
    """
    for one in door.left():
        if door.diverged:
            one.place(say).nothing("proposal", "an earlier proposal differs")
        else:
            now = NEVER_ASKED if found is None else HAS_ENDED
            one.place(say).exact("proposal", words(one.step.design, one.step.final, one.step.role), now)
    for sequence, agent in door.past.strays:
        at = Place(say, sequence, f"step {sequence} (lane {agent.lane}, action {agent.number})")
        at.exact("learner", f"one more record, of episode {agent.episode}", "one with each step of the walk")
    for action in door.missing if door.past.over and not door.diverged else ():
        at = Place(say, step=f"lane {action.lane}, action {action.number}")
        at.exact("proposal", NOWHERE, words(door.aim(action), action.final, action.role), "the run is over")


def result(past: Record, found: Found, at: Place) -> None:
    """Compares what was found with every result on record; a run that is over has one."""
    now = found.summary()
    for logged in past.results or [{}] * past.over:
        for name in RESULT:
            at.exact(f"result, {name}", *differing({name: logged.get(name, NOWHERE)}, {name: now[name]}))


def differing(logged: dict[str, Any], now: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Those leaves of two documents that are not the same, by dotted path; of a list the places are names."""
    ours, theirs = (flat(_by_place(one)) for one in (logged, now))
    names = [name for name in {**ours, **theirs} if ours.get(name) != theirs.get(name)]
    return {name: ours.get(name) for name in names}, {name: theirs.get(name) for name in names}


def _by_place(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _by_place(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return {str(place): _by_place(item) for place, item in enumerate(value)}
    return value


@dataclass(frozen=True)
class OnRecord:
    """A step, its place in the journal, what the designer was like, the seed of its request."""

    step: Step
    sequence: int
    agent: AgentRecord | None = None
    seed: str | None = None

    def place(self, say: Callable[[Compared], None]) -> Place:
        """Where a comparison is made."""
        return Place.of(say, self.sequence, self.step)


@dataclass(frozen=True)
class Record:
    """A run's steps by (lane, number), how its walk ended, what was found; `over`: its designer had nothing more."""

    steps: dict[tuple[int, int], OnRecord] = field(default_factory=dict)
    end: WalkEnd | None = None
    results: list[dict[str, Any]] = field(default_factory=list)
    over: bool = False
    strays: list[tuple[int, AgentRecord]] = field(default_factory=list)
    """Of the learner: what belongs to no step of the walk, or is there twice."""


def read_back(journal: RunJournal) -> Record:
    """What the designer was told, and what it said."""
    steps: dict[tuple[int, int], tuple[Step, int]] = {}
    agents: dict[tuple[int, int], tuple[int, AgentRecord]] = {}
    strays: list[tuple[int, AgentRecord]] = []
    seeds: dict[str, str] = {}
    lines: list[str] = []
    results: list[dict[str, Any]] = []
    for entry in journal.records("/request/ray", "/step", "/agent", "/note", "/log"):
        match entry.topic:
            case "/request/ray":
                seeds[entry.value.task_id] = str(entry.value.inputs.get("seed", ""))
            case "/step":
                steps[entry.value.lane, entry.value.number] = entry.value, entry.sequence
            case "/agent":
                told = entry.sequence, entry.value
                if agents.setdefault((entry.value.lane, entry.value.number), told) is not told:
                    strays.append(told)
            case "/note":
                results.append(entry.value.result)
            case _:
                lines.append(entry.value.message)
    found = {
        key: OnRecord(step, sequence, agents[key][1] if key in agents else None, seeds.get(step.task_id or ""))
        for key, (step, sequence) in steps.items()
    }
    strays += [told for key, told in agents.items() if key not in steps or steps[key][0].final]
    over = bool(results) or any(line.startswith(ENDED) for line in lines)
    return Record(found, WalkEnd.among(lines), results, over, strays)


class RecordedDoor:
    """Answers actions from a journal, and compares them with what was asked then. Lanes act from several threads."""

    designer = "auditor"

    def __init__(self, plan: Plan, past: Record, say: Callable[[Compared], None], same_machine: bool) -> None:
        self.run = plan.run
        self.past, self.missing, self.diverged = past, list[Action](), False
        self._plan, self._say, self._same = plan, say, same_machine
        self._lane_at: dict[int, Design] = {}
        self._seen: set[tuple[int, int]] = set()
        self._lock = threading.Lock()

    def act(self, action: Action) -> Step:
        """The step on record. Raises JournalEnds where there is none, Diverged where it is of another design."""
        key = action.lane, action.number
        one = self.past.steps.get(key)
        with self._lock:
            if one is None:
                self.missing.append(action)
                raise JournalEnds
            self._seen.add(key)
            if not self._proposal(action, one):
                self.diverged = True
                raise Diverged
            if action.agent is not None:
                self._learner(action.agent, one)
        return one.step

    def left(self) -> list[OnRecord]:
        """What was never asked for."""
        return [one for key, one in self.past.steps.items() if key not in self._seen]

    def _proposal(self, action: Action, one: OnRecord) -> bool:
        """Compare what is asked for: design and move, whether it is a final one and for what, a final one's seed."""
        step, at = one.step, one.place(self._say)
        design = self.aim(action)
        if not step.final:
            self._lane_at[action.lane] = step.design
        logged = words(step.design, step.final, step.role)
        margin = "" if action.agent is None or action.agent.q is None else f"chosen with Q = {action.agent.q:.6g}"
        same = at.exact("proposal", logged, words(design, action.final, action.role), margin)
        if same:
            at.exact("move", _moved(step.move), _moved(action.move))
            if action.final and one.seed is not None:
                at.exact("seed", one.seed, action.seed)
        return same

    def aim(self, action: Action) -> Design:
        """The design that an action leads to; a move out of the bounds leaves its lane where it is."""
        if action.design is not None or action.move is None:
            assert action.design is not None  # noqa: S101  # an action has a design or a move
            return action.design
        here = self._lane_at[action.lane]
        return self._plan.bounds.moved(here, action.move.variable, action.move.steps) or here

    def _learner(self, now: AgentRecord, one: OnRecord) -> None:
        """Compare what the learner is like with what it was like."""
        logged, at = one.agent, one.place(self._say)
        if logged is None:
            at.exact("learner", "nothing of the learner on record", f"episode {now.episode}, epsilon {now.epsilon:g}")
            return
        then, again = ([getattr(record, name) for name in EXACT] for record in (logged, now))
        at.exact("episode, greedy, updates", then, again)
        for name in REAL:
            self._real(name, getattr(logged, name), getattr(now, name), at)
        if self._same or logged.weights_sha256 == now.weights_sha256:
            at.exact("weights_sha256", logged.weights_sha256, now.weights_sha256)
        else:
            at.nothing("weights_sha256", "other packages or another processor round otherwise")

    def _real(self, name: str, logged: float | None, now: float | None, at: Place) -> None:
        if self._same or logged is None or now is None:
            at.exact(name, logged, now)
        else:
            at.near(name, logged, now, OTHER_MACHINE * abs(logged), "other packages or another processor")


def words(design: Design, final: bool, role: Any) -> str:
    """A proposal in words."""
    return f"{design}{f', final ({role})' if final else ''}"


def _moved(move: Move | None) -> str:
    return f"{move.variable} by {move.steps:+d} steps" if move else "none: a design is asked for"
