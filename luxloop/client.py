"""The one way to a worker: submit a request to the controller and wait for its outcome.

    with Client(settings) as client:
        answer = client.run(request)

A running set is used where one answers at `settings.router`; otherwise, for a loopback endpoint, router, controller
and workers are started as processes of their own (`luxloop serve local`) and stopped again at the end.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any
from uuid import uuid4

from luxloop.bus import Interrupt, ask_for
from luxloop.bus.blobs import fetcher
from luxloop.bus.frame import Array, Parcel
from luxloop.bus.identity import Identity, answering
from luxloop.bus.keys import KEYS, at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.endpoint import free_loopback, is_loopback, listening
from luxloop.errors import LuxloopError, RemoteError
from luxloop.failure import Failure
from luxloop.messages import Outcome, Pending, Request, Status, StatusAsked, Submit, Task, Withdraw
from luxloop.settings import Settings, as_environment
from luxloop.store import BlobStore
from luxloop.words import Words

START_S = 60.0  # for router and controller to answer, on a machine that has much else to do; a second or two else
STOP_S = 8.0
AGAIN = ("no_router", "no_controller", "busy", "timed_out", "refused")  # asking again may help
LOOK = "run `luxloop serve local` by hand to see why"


@dataclass(frozen=True)
class Answer:
    """What a worker computed: plain values, arrays by name, and who computed it how."""

    result: Mapping[str, Any]
    arrays: Mapping[str, Array]
    worker: str
    attempt: int
    compute_s: float


class Client:
    """A session with the controller. Thread-safe; leave it by `with` so that what it started is stopped."""

    _local: subprocess.Popen[bytes] | None = None  # the set that was started here

    def __init__(
        self, settings: Settings, *, local: bool = True, patience_s: float = 30.0, ray_workers: int = 1
    ) -> None:
        """Finds the set at `settings.router`, or starts one with so many ray-tracing workers where `local` allows."""
        self._patience_s = patience_s
        self._asker = f"{os.getpid()}-{uuid4().hex[:8]}"
        self._closing = Interrupt()
        self._stack = ExitStack()
        try:
            if not answering(settings, Identity.of(settings, "client")):
                if not (local and is_loopback(settings.router)):
                    raise _no_router(f"no router at {settings.router}")
                settings = self._start_local(settings, ray_workers)
            self.settings = settings
            self._bus = self._stack.enter_context(ZenohBus(settings))
            self._fetch = fetcher(self._bus, settings.realm, BlobStore(settings.cache_dir / "blobs"))
            self.status(START_S if self._local else KEYS["status"].time_limit_s)
        except BaseException:
            self.close()
            raise

    def run(
        self,
        request: Request | Task,
        *,
        limit_s: float = 600.0,
        fresh: bool = False,
        until: Interrupt | None = None,
        on_pending: Callable[[Pending], None] | None = None,
    ) -> Answer:
        """The worker's answer. Raises RemoteError with the typed failure where there is none.

        `limit_s` bounds one attempt's computation; `fresh` computes again what the controller still has; `until` ends
        the waiting when it is set; `on_pending` is told every 5 s how far it is.
        """
        task, until = as_task(request), until or self._closing
        row, key = KEYS["submit"], at(self.settings.realm, "submit", kind=as_task(request).kind)
        submit = Submit(task=task, asker=self._asker, fresh=fresh, patience_s=self._patience_s, limit_s=limit_s)
        lost_since_s: float | None = None
        while True:
            try:
                parcel = ask_for(self._bus, key, submit, row.time_limit_s, cancelled=until, fetch=self._fetch)
            except RemoteError as error:
                if error.failure.code == "not_found" and not fresh:  # large arrays have gone with their holder
                    fresh, submit = True, submit.model_copy(update={"fresh": True})
                    continue
                if until.is_set():
                    raise
                lost_since_s = lost_since_s or time.monotonic()
                self._wait_a_little(error, lost_since_s + self._patience_s, 0.2)
                continue
            if not isinstance(parcel.message, Pending):
                return _answer(parcel)
            lost_since_s, submit = None, submit.model_copy(update={"fresh": False})  # what ends now is fresh
            if on_pending is not None:
                on_pending(parcel.message)

    def map(
        self, requests: Iterable[Request | Task], *, lanes: int = 8, limit_s: float = 600.0, **options: Any
    ) -> Iterator[tuple[int, Answer | RemoteError]]:
        """(number, answer or failure) of each request as they come in, `lanes` of them under way at once.

        `options` are those of `run`, which is called in several threads. Left early, what is under way is withdrawn.
        """
        numbered, left = enumerate(requests), Interrupt()
        pool = ThreadPoolExecutor(lanes, thread_name_prefix="lane")
        under_way: dict[Future[Answer], tuple[int, Task]] = {}
        with self._closing.ends(left.set):
            try:
                while True:
                    while len(under_way) < lanes and (item := next(numbered, None)) is not None:
                        number, task = item[0], as_task(item[1])
                        under_way[pool.submit(self.run, task, limit_s=limit_s, until=left, **options)] = number, task
                    if not under_way:
                        return
                    finished, _ = wait(under_way, return_when=FIRST_COMPLETED)
                    for future in finished:
                        yield under_way.pop(future)[0], _answer_or_failure(future)
            finally:
                self._give_up([task for _, task in under_way.values()])
                left.set()
                pool.shutdown(wait=True, cancel_futures=True)

    def _give_up(self, tasks: list[Task]) -> None:
        """Withdraw what nobody here waits for any more; a controller that is not there forgets it by itself."""
        for task in tasks:
            try:
                self.withdraw(task)
            except LuxloopError:
                return

    def fetch(self, sha256: str, size: int) -> bytes:
        """The blob of `size` bytes with this hash, from whoever holds it. Raises RemoteError not_found."""
        return self._fetch(sha256, size)

    def ask(self, row: str, message: Words, parts: Mapping[str, str], until: Interrupt | None = None) -> Parcel:
        """The controller's answer to a question of that row of the table of keys. Raises RemoteError."""
        key, limit_s = at(self.settings.realm, row, **parts), KEYS[row].time_limit_s
        return ask_for(self._bus, key, message, limit_s, cancelled=until or self._closing, fetch=self._fetch)

    def announce(self, designer: str) -> None:
        """Let it be seen that a designer lives; that ends with this client."""
        self._bus.announce(at(self.settings.realm, "alive", role="designer", kind="run", name=designer))

    def withdraw(self, request: Request | Task) -> None:
        """Take this client's wish back; the task is cancelled unless another client waits for it."""
        withdraw = Withdraw(task_id=as_task(request).id, asker=self._asker)
        ask_for(self._bus, at(self.settings.realm, "withdraw"), withdraw, KEYS["withdraw"].time_limit_s)

    def status(self, patience_s: float = 0.0) -> Status:
        """How things stand at the controller; waits up to `patience_s` for one to be there."""
        end_s = time.monotonic() + patience_s
        key, row = at(self.settings.realm, "status"), KEYS["status"]
        while True:
            try:
                return ask_for(self._bus, key, StatusAsked(), row.time_limit_s).expect(Status)
            except RemoteError as error:
                self._wait_a_little(error, end_s, 0.05)

    def _wait_a_little(self, error: RemoteError, end_s: float, pause_s: float) -> None:
        """Before the same is tried again. Raises `error` where that cannot help, or that the set begun here ended."""
        if error.failure.code not in AGAIN or time.monotonic() > end_s:
            raise error
        if self._local is not None and self._local.poll() is not None:
            raise _no_router("the local set of processes has ended", LOOK) from error
        time.sleep(pause_s)

    def close(self) -> None:
        """Let go of everything held, and stop what was started."""
        self._closing.set()
        self._stack.close()

    def _start_local(self, settings: Settings, ray_workers: int) -> Settings:
        """Start a private set on a free port; it ends with this process even if this is killed."""
        settings = settings.model_copy(update={"router": free_loopback(settings.router)})
        self._local = subprocess.Popen(
            [sys.executable, "-m", "luxloop", "serve", "local", "--quiet", "--ray-tracing", str(ray_workers)],
            env=as_environment(settings) | {"LUXLOOP_WITH_PARENT": str(os.getpid())},
            stdin=subprocess.DEVNULL, stdout=2,  # own effects may print: not beside our answer
            start_new_session=True,  # Ctrl-C is for us: we finish what we hold, then end the set
        )  # fmt: skip
        self._stack.callback(_stop, self._local)
        end_s = time.monotonic() + START_S
        late = _no_router(f"the local set of processes did not start within {START_S:g} s", LOOK)
        while not listening(settings.router):
            self._wait_a_little(late, end_s, 0.01)
        return settings

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def as_task(request: Request | Task) -> Task:
    """The task that a typed request makes; a task is one already."""
    return request if isinstance(request, Task) else Task.of(request)


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _answer(parcel: Parcel) -> Answer:
    """A decoded outcome as an answer; a failure is raised."""
    outcome = parcel.expect(Outcome)
    if outcome.failure is not None:
        raise RemoteError(outcome.failure)
    return Answer(outcome.result or {}, parcel.arrays, outcome.worker, outcome.attempt, outcome.compute_s)


def _answer_or_failure(future: Future[Answer]) -> Answer | RemoteError:
    try:
        return future.result()
    except RemoteError as error:
        return error
    except LuxloopError as error:
        return RemoteError(Failure.of(error))


def _no_router(message: str, mend: str = "start one there, or set LUXLOOP_ROUTER to where it is") -> RemoteError:
    return RemoteError(Failure(code="no_router", message=message, mend=mend, where=f"pid {os.getpid()}"))
