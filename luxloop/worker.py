"""What every worker is: pull a task, compute it, deliver until acknowledged; say every second that it is alive.

Two threads. The working thread pulls, computes and delivers. The main thread beats, takes signals and cancels,
serves blobs, and sees the worker out: on SIGTERM the task in hand is finished if that takes no more than
`FINISH_S`, else stopped at its next checkpoint and handed back; after `LEAVE_S` the process ends in any case.
"""

from __future__ import annotations

import logging
import os
import platform
import signal
import threading
import time
from collections.abc import Mapping
from typing import Any
from uuid import uuid4

import numpy as np

from luxloop import __version__
from luxloop import messages as m
from luxloop.bus import Asked, Bus, Heard, Inbox, Interrupt, ask_for
from luxloop.bus.blobs import serve_piece
from luxloop.bus.frame import Array, decode, encode
from luxloop.bus.keys import KEYS, at
from luxloop.computation import Computation, Progress, Stopped
from luxloop.errors import LuxloopError, RemoteError
from luxloop.failure import Failure
from luxloop.process import orphaned, resident_mb
from luxloop.settings import Settings
from luxloop.store import BlobStore

log = logging.getLogger(__name__)

FINISH_S = 2.5
LEAVE_S = 4.0
GRACE_S = 10.0  # a cancelled computation that goes on for so long is ended with its process
WAITABLE = ("no_router", "no_controller", "timed_out", "busy", "refused", "cancelled")


class Worker:
    """One worker process around a `Computation`."""

    def __init__(self, computation: Computation, bus: Bus, settings: Settings) -> None:
        self._computation, self._bus, self._settings = computation, bus, settings
        self.name = f"{computation.kind}-{uuid4().hex[:8]}"
        self._kind, self._realm = computation.kind, settings.realm
        self._store = BlobStore(settings.cache_dir / "blobs")
        self._inbox = Inbox()
        self._epoch = ""
        self._leaving = Interrupt()
        self._lease: m.Lease | None = None
        self._began_s = 0.0
        self._progress = Progress()
        self._stopped: m.Lease | None = None  # the attempt that was cancelled, and when
        self._stopped_s = float("inf")
        self._error: BaseException | None = None

    def run(self) -> None:
        """Work until SIGTERM or SIGINT, or until the process that it is to end with has gone."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: self._leaving.set())
        self._bus.subscribe(self._key("cancel"), self._inbox)
        self._bus.answer(at(self._realm, "blob", worker=self.name), self._inbox)
        self._bus.announce(at(self._realm, "alive", role="worker", kind=self._kind, name=self.name))
        working = threading.Thread(target=self._work, name="work", daemon=True)
        working.start()
        self._attend(working)
        self._leave(working)
        if self._error is not None:
            raise self._error

    def _attend(self, working: threading.Thread) -> None:
        """Beat, serve and listen until it is time to leave."""
        next_beat_s = time.monotonic()
        while not self._leaving.is_set() and working.is_alive() and not orphaned():
            if time.monotonic() >= next_beat_s:
                self._beat()
                next_beat_s = time.monotonic() + self._settings.heartbeat_s
            event = self._inbox.take(min(0.25, max(next_beat_s - time.monotonic(), 0.001)))
            try:
                if isinstance(event, Asked):
                    serve_piece(event, self._piece, self.name)
                elif isinstance(event, Heard):
                    self._hear(event.frame)
            except Exception:
                log.exception("%s: what arrived could not be handled", self.name)
            if time.monotonic() - self._stopped_s > GRACE_S and self._lease is self._stopped:
                self._error = LuxloopError(f"{self.name}: a cancelled computation did not end within {GRACE_S:g} s")
                return

    def _leave(self, working: threading.Thread) -> None:
        """Finish what is nearly done, hand back the rest, and go within `LEAVE_S`."""
        self._leaving.set()
        begin_s = time.monotonic()
        working.join(FINISH_S)
        self._progress.stop.set()
        working.join(LEAVE_S - (time.monotonic() - begin_s))
        if working.is_alive() and self._lease is not None:
            self._hand_back(self._lease)
        self._bus.close()
        if working.is_alive():  # a computation that never looks up: nothing else ends it
            os._exit(0 if self._error is None else 1)

    def _work(self) -> None:
        try:
            self._pull_and_compute()
        except BaseException as error:  # noqa: BLE001  refused for good, or a fault: the main thread ends and says why
            self._error = error

    def _pull_and_compute(self) -> None:
        lease: m.Lease | None = None
        while not self._leaving.is_set():
            lease = lease or self._pull()
            if lease is None:
                continue
            done = self._attempt(lease)
            lease = self._deliver(lease, done) if done is not None else None
        if lease is not None:
            self._hand_back(lease)

    def _pull(self) -> m.Lease | None:
        """The next lease, or None: nothing to do, nobody there (after a short wait), or leaving."""
        try:
            if not self._epoch:
                self._epoch = self._say_hello()
            pull = m.Pull(worker=self.name, kind=self._kind, epoch=self._epoch)
            message = ask_for(
                self._bus, self._key("pull"), pull, KEYS["pull"].time_limit_s, cancelled=self._leaving
            ).message
            return message if isinstance(message, m.Lease) else None
        except RemoteError as error:
            if error.failure.code == "stale":
                self._epoch = ""
                return None
            if error.failure.code == "version":
                raise
            self._leaving.wait(0.3)
            return None

    def _say_hello(self, holding: m.Lease | None = None) -> str:
        """Introduce this worker, with what it computes at the moment; the controller's epoch."""
        describe = m.Describe(
            worker=self.name,
            kind=self._kind,
            version=__version__,
            host=platform.node(),
            pid=os.getpid(),
            catalogue=self._computation.catalogue(),
        )
        held = [m.Held(task_id=o.task.id, attempt=o.attempt, epoch=o.epoch) for o in [holding] if o is not None]
        hello = m.Hello(describe=describe, holding=tuple(held))
        key = at(self._realm, "hello", kind=self._kind)
        return ask_for(self._bus, key, hello, KEYS["hello"].time_limit_s).expect(m.Welcome).epoch

    def _attempt(self, lease: m.Lease) -> bytes | None:
        """Compute a lease; the frame to deliver, or None where it was stopped."""
        self._progress = Progress()
        self._began_s, self._lease = time.monotonic(), lease
        try:
            if lease.task.version != __version__:
                raise RemoteError(_other_version(lease.task.version))
            result, arrays = self._computation.compute(lease.task.inputs, self._progress)
        except Stopped:
            if self._leaving.is_set():
                self._hand_back(lease)
            self._lease = None
            return None
        except RemoteError as error:
            return self._failed(lease, error.failure)
        except BaseException as error:  # noqa: BLE001  whatever it raises, SystemExit too, becomes a Failure
            return self._failed(lease, Failure.of(error, self.name))
        try:
            _refuse_nan(arrays)
            outcome = self._outcome(lease, result=result)
            return encode(self._done(lease, outcome), arrays, self._store.keep)
        except Exception as error:  # noqa: BLE001  a result that cannot be sent is this side's fault, not the asker's
            return self._failed(lease, Failure(code="crashed", message=str(error), where=self.name))

    def _failed(self, lease: m.Lease, failure: Failure) -> bytes:
        return encode(self._done(lease, self._outcome(lease, failure=failure)))

    def _outcome(
        self, lease: m.Lease, result: dict[str, Any] | None = None, failure: Failure | None = None
    ) -> m.Outcome:
        return m.Outcome(
            task_id=lease.task.id,
            result=result,
            failure=failure,
            worker=self.name,
            attempt=lease.attempt,
            compute_s=time.monotonic() - self._began_s,
        )

    def _done(self, lease: m.Lease, outcome: m.Outcome | None) -> m.Done:
        """The delivery of what came of a lease; without an outcome the lease is handed back."""
        return m.Done(
            worker=self.name,
            kind=self._kind,
            attempt=lease.attempt,
            epoch=lease.epoch,
            outcome=outcome,
            handed_back=None if outcome else lease.task.id,
            wants_next=not self._leaving.is_set(),
        )

    def _deliver(self, lease: m.Lease, done: bytes) -> m.Lease | None:
        """Put a result again and again until the controller has it or will never want it; the next lease if given."""
        receipt: m.Receipt | None = None
        give_up_s = float("inf")
        while receipt is None and time.monotonic() < give_up_s:
            try:
                receipt = ask_for(self._bus, self._key("done"), done, KEYS["done"].time_limit_s).expect(m.Receipt)
            except RemoteError as error:
                if error.failure.code not in WAITABLE:  # it will never be taken as it is: say so instead
                    done = self._failed(lease, error.failure)
                if self._leaving.is_set():
                    give_up_s = min(give_up_s, time.monotonic() + FINISH_S)
                time.sleep(0.2)
        self._lease = None
        return receipt.next if receipt else None

    def _hand_back(self, lease: m.Lease) -> None:
        try:
            ask_for(self._bus, self._key("done"), self._done(lease, None), 1.0)
        except LuxloopError:  # the vanishing token will say it
            return

    def _beat(self) -> None:
        lease = self._lease
        beat = m.Heartbeat(
            worker=self.name,
            kind=self._kind,
            task_id=lease.task.id if lease else None,
            attempt=lease.attempt if lease else 0,
            progress_ratio=self._progress.ratio if lease else 0.0,
            note=self._progress.note if lease else "",
            busy_s=time.monotonic() - self._began_s if lease else 0.0,
            resident_mb=resident_mb(),
            sent_unix_s=time.time(),
        )
        self._bus.publish(at(self._realm, "heartbeat", kind=self._kind, worker=self.name), encode(beat))

    def _hear(self, frame: bytes) -> None:
        """The controller says: drop an attempt, or introduce yourself with what you hold."""
        try:
            message = decode(frame).message
            if isinstance(message, m.Introduce):
                self._epoch = self._say_hello(self._lease)
        except LuxloopError:
            return  # not a message of ours, or nobody there to say hello to: the next beat is answered again
        lease = self._lease
        if (
            isinstance(message, m.Cancel)
            and lease is not None
            and (lease.task.id, lease.attempt) == (message.task_id, message.attempt)
        ):
            self._progress.stop.set()
            self._stopped, self._stopped_s = lease, time.monotonic()

    def _piece(self, sha256: str, offset: int, length: int) -> tuple[bytes, int] | None:
        """A piece of a blob: of the large arrays sent, or of the computation's own store."""
        held = self._store.piece(sha256, offset, length)
        if held is None and (whole := self._computation.blob(sha256)) is not None:
            held = whole[offset : offset + length], len(whole)
        return held

    def _key(self, row: str) -> str:
        return at(self._realm, row, kind=self._kind, worker=self.name)


def _refuse_nan(arrays: Mapping[str, Array]) -> None:
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ArithmeticError(f"the computation returned NaN or infinity in {name}")


def _other_version(version: str) -> Failure:
    message = f"the task is of release {version}, this worker of {__version__}"
    return Failure(code="version", message=message, mend="run the same release of luxloop on all sides")
