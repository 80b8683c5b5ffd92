"""The workers as the controller knows them: how they described themselves, when and what they last said."""

from __future__ import annotations

import time
from dataclasses import dataclass

from env_controller.scheduler import Scheduler
from luxloop.messages import Describe, Heartbeat, WorkerStatus

GONE_S = 60.0  # a worker not heard of for so long is taken off the list


@dataclass
class Known:
    """A worker as it described itself and was last heard."""

    describe: Describe
    beat: Heartbeat | None = None
    heard_s: float = 0.0
    skew_s: float = 0.0


class Roster:
    """Who has said hello in this epoch and has not gone."""

    def __init__(self) -> None:
        self._workers: dict[str, Known] = {}

    def enter(self, describe: Describe, now_s: float) -> None:
        """A worker said hello, perhaps again; its catalogue, which nobody asks us for, is left out."""
        self._workers[describe.worker] = Known(describe.model_copy(update={"catalogue": {}}), heard_s=now_s)

    def strike(self, worker: str) -> None:
        """It has gone."""
        self._workers.pop(worker, None)

    def hear(self, beat: Heartbeat, now_s: float) -> bool:
        """Note a heartbeat; False where this worker is not known (any more)."""
        known = self._workers.get(beat.worker)
        if known is None:
            return False
        known.beat, known.heard_s, known.skew_s = beat, now_s, time.time() - beat.sent_unix_s
        return True

    def leave_out(self, deaf_s: float, now_s: float) -> None:
        """For so long nobody was listened to: that is no worker's silence."""
        for known in self._workers.values():
            known.heard_s = min(known.heard_s + deaf_s, now_s)

    def unheard(self, now_s: float) -> list[str]:
        """Those not heard of for `GONE_S`."""
        return [name for name, known in self._workers.items() if now_s - known.heard_s > GONE_S]

    def kind_of(self, worker: str) -> str | None:
        """Its kind, None where it is not known."""
        known = self._workers.get(worker)
        return known.describe.kind if known else None

    def beat_about(self, worker: str, task_id: str) -> Heartbeat | None:
        """The worker's last heartbeat where it spoke of this task."""
        known = self._workers.get(worker)
        return known.beat if known and known.beat and known.beat.task_id == task_id else None

    def statuses(self, core: Scheduler, now_s: float) -> tuple[WorkerStatus, ...]:
        """Every worker for a person to look at: what it has leased, else what it says it does."""
        return tuple(self._status(known, core, now_s) for known in self._workers.values())

    @staticmethod
    def _status(known: Known, core: Scheduler, now_s: float) -> WorkerStatus:
        name, beat = known.describe.worker, known.beat
        lease, record = next(iter(core.held_by(name)), None), core.workers.get(name)
        return WorkerStatus(
            describe=known.describe,
            task_id=lease.task_id if lease else (beat.task_id or "") if beat else "",
            attempt=lease.attempt if lease else beat.attempt if beat else 0,
            progress_ratio=beat.progress_ratio if beat else 0.0,
            heard_s_ago=now_s - known.heard_s,
            clock_skew_s=known.skew_s,
            finished=record.finished if record else 0,
            resident_mb=beat.resident_mb if beat else 0.0,
        )
