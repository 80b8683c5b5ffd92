"""Level 2, the controller's part: the environment-control agent is driven again by the journal, step by step.

    /step ─▶ the action it came of ─▶ EnvironmentAgent ─▶ the task it wants ─▶ its reply on record ─▶ Tell: the same?

Designs of final steps take their seeds from their requests: which seed they should have, level 3 says.
"""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from typing import Any

import numpy as np

from env_controller import actions as a
from env_controller.environment import EnvironmentAgent
from env_controller.events import Command
from env_controller.trials import Lane, Run
from luxloop import __version__
from luxloop.audit import Compared, Place
from luxloop.campaign import Action, Cut, Plan, Step
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import ReplyRecord, RequestRecord
from luxloop.messages import Task
from luxloop.model import flat

TOPICS = ("/request/film", "/request/ray", "/reply/film", "/reply/ray", "/map/sim", "/step")
CUT = {"cut_x_um": "x_um", "cut_lx": "illuminance_lx", "cut_error_lx": "illuminance_error_lx"}
LAST_BITS = 1e-12
"""Of a reward: powers are rounded by each system's own library."""
TURNS = 8  # a film, its rays, and both again where the film has gone
LEAVES = 3  # of two documents that differ, shown
ABSENT = "not there"


def re_derive(journal: RunJournal, say: Callable[[Compared], None], *, same_machine: bool) -> None:  # noqa: ARG001  # bits count on any machine
    """Compares requests, design, state, feasibility, reward and figures of every step with what follows from its move
    and the replies.

    And the maps and cut lines on record with the hashes in the replies. No bit of it depends on the machine.
    """
    past = Replayed(journal.attached("plan.json", Plan))
    for entry in journal.records(*TOPICS):
        if entry.topic == "/step":
            past.step(entry.value, Place.of(say, entry.sequence, entry.value), entry.sequence)
        elif entry.topic == "/map/sim":
            past.map_sha256[entry.sequence] = sha256(np.ascontiguousarray(entry.value, "<f4").tobytes()).hexdigest()
        elif entry.topic.startswith("/request/"):
            past.requests[entry.value.task_id], past.version = entry.value, entry.value.version
        else:
            past.replies[entry.value.task_id] = entry.value


class Replayed:
    """A run that is derived once more: the agent, and what of the journal it has not used yet."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.agent, self.version = plan, EnvironmentAgent(), __version__
        self.agent.handle(a.Opened(0.0, plan))
        self.requests: dict[str, RequestRecord] = {}
        self.replies: dict[str, ReplyRecord] = {}
        self.map_sha256: dict[int, str] = {}
        self._logged_ids: dict[str, str] = {}  # of this release's tasks, as the journal's release named them

    @property
    def _run(self) -> Run:
        return self.agent.runs[self.plan.run]

    def step(self, logged: Step, at: Place, sequence: int) -> None:
        """Compare one step, and go on from what was derived."""
        lane = self._run.lanes.setdefault(logged.lane, Lane())
        reply = self.replies.get(logged.task_id or "")
        self._arrays(logged, reply, at, sequence)
        try:
            action = self._action(logged)
            now, tasks = self._told(action, logged)
        except InputError as error:
            at.scored("action", "differs", str(logged.design), "refused", str(error))
            lane.follow(logged)
            return
        if now is None:
            at.nothing("step", "its task has no reply on record")
            lane.follow(logged)
            return
        self._requests(logged, tasks, at)
        at.exact("design", *first_leaves(logged.design.model_dump(), now.design.model_dump()))
        at.exact("state", logged.state, now.state)
        at.exact("feasibility", (logged.feasible, logged.reason), (now.feasible, now.reason))
        at.exact("failure", logged.failure, now.failure)
        tolerance = LAST_BITS * max(1.0, abs(now.reward))
        at.near("reward", logged.reward, now.reward, tolerance, "the last bits of a power")
        figures = (logged.uniformity, logged.uniformity_error), (now.uniformity, now.uniformity_error)
        at.exact("uniformity", *figures)
        at.exact("figures", *first_leaves(logged.figures, now.figures))
        if logged.failure is None and reply is not None:
            del self.replies[reply.task_id]
        self.requests.pop(logged.task_id or "", None)

    def _action(self, step: Step) -> Action:
        """The action that a step says it came of: a move is rewarded as one, a design that was asked for begins."""
        words = {"run": step.run, "designer": "auditor", "lane": step.lane, "number": step.number}
        if step.final:
            request = self.requests.get(step.task_id or "")
            seed = str(request.inputs.get("seed", "1")) if request else "1"
            return Action(**words, design=step.design, final=True, seed=seed, role=step.role)
        return Action(**words, move=step.move) if step.move else Action(**words, design=step.design)

    def _told(self, action: Action, logged: Step) -> tuple[Step | None, list[Task]]:
        """What the agent tells, and the tasks it wanted on the way; None where the journal lacks a reply."""
        tasks: list[Task] = []
        commands = self.agent.handle(a.Acted(0.0, action))
        for _ in range(TURNS):
            told = _step_of(commands, action)
            want = next((one.task for one in commands if isinstance(one, a.Want) and not one.ahead), None)
            if told is not None or want is None:
                return told, tasks
            tasks.append(want)
            reply = self._reply(want, logged)
            if reply is None:
                gone = Failure(code="not_found", message="no reply on record")
                self.agent.handle(a.Ended(0.0, want.id, None, gone))
                return None, tasks
            commands = self.agent.handle(a.Ended(0.0, want.id, reply.result, reply.failure))
        return None, tasks

    def _reply(self, task: Task, logged: Step) -> ReplyRecord | None:
        """The reply to a task; where it has none, the reply that the step on record names."""
        own = self._logged_id(task)
        other = logged.film_task_id if task.kind == "film" else logged.task_id
        return self.replies.get(own) or self.replies.get(other or "")

    def _logged_id(self, task: Task) -> str:
        """The task's id in the release that wrote the journal."""
        if task.id not in self._logged_ids:
            self._logged_ids[task.id] = Task(kind=task.kind, inputs=task.inputs, version=self.version).id
        return self._logged_ids[task.id]

    def _requests(self, logged: Step, tasks: list[Task], at: Place) -> None:
        """The tasks that the step names are those that follow from plan, design and film."""
        for kind, named in (("film", logged.film_task_id), ("ray", logged.task_id)):
            for task in [task for task in tasks if task.kind == kind][-1:]:
                if named == self._logged_id(task):
                    at.exact(f"{kind} request", named, named)
                    continue
                request = self.requests.get(named or "")
                leaf = first_leaves(request.inputs, task.inputs) if request else (named, self._logged_id(task))
                if request and request.version != __version__ and _leaves(request.inputs) != _leaves(task.inputs):
                    at.nothing(f"{kind} request", f"release {request.version} asked in other words")
                else:
                    at.exact(f"{kind} request", *leaf)

    def _arrays(self, logged: Step, reply: ReplyRecord | None, at: Place, sequence: int) -> None:
        """Map and cut on record against the hashes of what the worker sent."""
        seen = self.map_sha256.pop(sequence, None)
        if reply is None:
            return
        if seen is not None and "map_lx" in reply.arrays:
            at.exact("map", reply.arrays["map_lx"], seen, "SHA-256 of its pixels, logged with the reply")
        if logged.cut is not None:
            names = [name for name in CUT if name in reply.arrays]
            at.exact("cut", [reply.arrays[name] for name in names], [_sha256(logged.cut, name) for name in names])


def first_leaves(logged: dict[str, Any], now: dict[str, Any]) -> tuple[Any, Any]:
    """The two; where they differ, the first leaves that do, by dotted path: so that a person can read it."""
    if logged == now:
        return logged, now
    ours, theirs = flat(logged), flat(now)
    names = [name for name in {**ours, **theirs} if ours.get(name, ABSENT) != theirs.get(name, ABSENT)][:LEAVES]
    if not names:  # an empty group here, none there
        return logged, now
    return {name: ours.get(name, ABSENT) for name in names}, {name: theirs.get(name, ABSENT) for name in names}


def _leaves(inputs: dict[str, Any]) -> set[str]:
    return set(flat(inputs))


def _step_of(commands: list[Command], action: Action) -> Step | None:
    """The step that an action's end tells."""
    told = (command.step for command in commands if isinstance(command, a.Tell))
    return next((step for step in told if (step.lane, step.number) == (action.lane, action.number)), None)


def _sha256(cut: Cut, name: str) -> str:
    return sha256(np.array(getattr(cut, CUT[name]), "<f8").tobytes()).hexdigest()
