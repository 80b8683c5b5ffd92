"""What the processes of a lab put into the history, by wrapping four functions of theirs.

The product knows nothing of it, and no function does anything else than before.
"""

from __future__ import annotations

from typing import Any

from tests.nemesis.history import History, digest_of, name_of


def watch_designer(history: History) -> None:
    """Every action that is asked, the step that is told, the root of the finished journal."""
    from luxloop.campaign import Action, Ended, Step
    from luxloop.door import RunDoor

    plain, finish = RunDoor.act, RunDoor.end

    def act(self: RunDoor, action: Action, *more: Any) -> Step:
        about = {"run": action.run, "step": f"{action.lane}:{action.number}"}
        history.note("asked", **about)
        try:
            step = plain(self, action, *more)
        except Exception as error:
            history.note("failed", **about, why=str(error)[:300])
            raise
        history.note("told", run=action.run, step=name_of(step), digest=digest_of(step))
        return step

    def end(self: RunDoor, *why: Any, **more: Any) -> Ended:
        ended = finish(self, *why, **more)
        history.note("finished", run=self.run, records=ended.records, root=ended.root)
        return ended

    RunDoor.end = end  # type: ignore[method-assign]
    RunDoor.act = act  # type: ignore[method-assign,assignment]


def watch_core(history: History) -> None:
    """Every task that the controller's core takes up, hands out, gets back, ends."""
    from env_controller import events as e
    from env_controller.scheduler import Scheduler

    begin, plain = Scheduler.__init__, Scheduler.handle

    def init(self: Scheduler, epoch: str, **more: Any) -> None:
        begin(self, epoch, **more)
        history.note("epoch", epoch=epoch)

    def handle(self: Scheduler, event: e.Event) -> list[e.Command]:
        if isinstance(event, e.Submitted) and event.task_id not in self.tasks:
            history.note("accepted", epoch=self.epoch, task=event.task_id)
        stood = isinstance(event, e.Delivered) and event.epoch == self.epoch and _stands(self, event)
        commands = plain(self, event)
        for command in commands:
            if isinstance(command, e.Grant):
                about = {"worker": command.worker, "attempt": command.attempt}
                held, slots = len(self.held_by(command.worker)), self.workers[command.worker].slots
                history.note("granted", epoch=self.epoch, task=command.task_id, **about, held=held, slots=slots)
            elif isinstance(command, e.Finish):
                why = {"code": command.code, "history": list(command.history)}
                history.note("ended", epoch=self.epoch, task=command.task_id, **why)
            elif isinstance(command, e.Receive) and isinstance(event, e.Delivered):
                about = {"worker": event.worker, "attempt": event.attempt, "of_epoch": event.epoch}
                verdict = {"taken": command.accepted, "stood": stood}
                history.note("delivered", epoch=self.epoch, task=event.task_id, **about, **verdict)
        return commands

    def _stands(core: Scheduler, event: e.Delivered) -> bool:
        leases = (core.leases.get(event.task_id), core.hedges.get(event.task_id))
        return (event.worker, event.attempt) in [(one.worker, one.attempt) for one in leases if one is not None]

    Scheduler.__init__ = init  # type: ignore[method-assign]
    Scheduler.handle = handle  # type: ignore[method-assign]
