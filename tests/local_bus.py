"""The bus inside one process: the same contract as over zenoh, no network, for tests.

A `LocalRouter` is what all `LocalBus` of a set share; killing one (`close`) makes its tokens vanish and its open
queries end without an answer, as on zenoh.
"""

from __future__ import annotations

import threading
from types import TracebackType

from luxloop.bus import Asked, Heard, Inbox, Interrupt, Presence, busy, too_large
from luxloop.bus.frame import FRAME_BYTES
from luxloop.bus.keys import KEYS, name_of
from luxloop.errors import RemoteError
from luxloop.failure import Failure


def matches(expression: str, key: str) -> bool:
    """Whether a key expression with `*` (one part) and a final `**` (any parts) covers a key."""
    want, have = expression.split("/"), key.split("/")
    if want[-1] == "**":
        want, have = want[:-1], have[: len(want) - 1]
    return len(want) == len(have) and all("*" in (w, h) or w == h for w, h in zip(want, have, strict=True))


class LocalRouter:
    """What the buses of one set share: who answers, who listens, who is present."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.buses: list[LocalBus] = []


class LocalBus:
    """One party on a `LocalRouter`."""

    def __init__(self, router: LocalRouter) -> None:
        self._router = router
        self._answers: list[tuple[str, Inbox]] = []
        self._listens: list[tuple[str, Inbox]] = []
        self._watches: list[tuple[str, Inbox]] = []
        self._tokens: set[str] = set()
        self._open: set[_Question] = set()
        with router.lock:
            router.buses.append(self)

    def ask(self, key: str, frame: bytes, timeout_s: float, cancelled: Interrupt | None = None) -> bytes:
        with self._router.lock:
            asked = [(bus, inbox) for bus in self._router.buses for expr, inbox in bus._answers if matches(expr, key)]
        question = _Question(len(asked))
        for bus, inbox in asked:
            with self._router.lock:
                bus._open.add(question)
            if len(frame) > FRAME_BYTES:
                question.answer(too_large(len(frame), FRAME_BYTES, key))
            elif not inbox.offer(Asked(key, frame, question.answer, question.drop)):
                question.answer(busy(key))
        return question.wait(key, timeout_s, cancelled, self._somebody(key))

    def answer(self, key_expr: str, inbox: Inbox) -> None:
        with self._router.lock:
            self._answers.append((key_expr, inbox))

    def publish(self, key: str, frame: bytes) -> None:
        with self._router.lock:
            inboxes = [inbox for bus in self._router.buses for expr, inbox in bus._listens if matches(expr, key)]
        for inbox in inboxes:
            inbox.offer(Heard(key, frame))

    def subscribe(self, key_expr: str, inbox: Inbox) -> None:
        with self._router.lock:
            self._listens.append((key_expr, inbox))

    def announce(self, key: str) -> None:
        with self._router.lock:
            self._tokens.add(key)
            self._tell(key, alive=True)

    def present(self, key_expr: str) -> frozenset[str]:
        with self._router.lock:
            return frozenset(key for bus in self._router.buses for key in bus._tokens if matches(key_expr, key))

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        with self._router.lock:
            self._watches.append((key_expr, inbox))
            for key in self.present(key_expr):
                inbox.offer(Presence(key, alive=True))

    def connected(self) -> bool:
        return True

    def close(self) -> None:
        with self._router.lock:
            if self not in self._router.buses:
                return
            self._router.buses.remove(self)
            for key in self._tokens:
                self._tell(key, alive=False)
            for question in self._open:
                question.drop()

    def __enter__(self) -> LocalBus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _tell(self, key: str, *, alive: bool) -> None:
        for bus in self._router.buses:
            for expr, inbox in bus._watches:
                if matches(expr, key):
                    inbox.offer(Presence(key, alive))

    def _somebody(self, key: str) -> bool:
        role = KEYS[name_of(key)].answered_by
        return any(token.split("/")[3] == role for bus in self._router.buses for token in bus._tokens)


class _Question:
    """One open query: the first answer wins; it ends when everybody who could answer has dropped it."""

    def __init__(self, parties: int) -> None:
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._left = parties
        self._frame: bytes | None = None
        if not parties:
            self._ended.set()

    def answer(self, frame: bytes) -> None:
        with self._lock:
            self._frame = self._frame if self._frame is not None else frame
        self._ended.set()

    def drop(self) -> None:
        with self._lock:
            self._left -= 1
            if self._left <= 0:
                self._ended.set()

    def wait(self, key: str, timeout_s: float, cancelled: Interrupt | None, somebody: bool) -> bytes:
        left_s = timeout_s
        while not self._ended.wait(min(0.05, max(left_s, 0.0))):
            left_s -= 0.05
            if cancelled is not None and cancelled.is_set():
                raise RemoteError(Failure(code="cancelled", message="the question was withdrawn", where=key))
            if left_s <= 0:
                raise RemoteError(Failure(code="timed_out", message=f"no answer within {timeout_s:g} s", where=key))
        if self._frame is not None:
            return self._frame
        if name_of(key) == "blob":
            raise RemoteError(Failure(code="not_found", message=f"nobody answers at {key}"))
        if somebody:
            raise RemoteError(Failure(code="refused", message="the question was dropped", where=key))
        raise RemoteError(Failure(code="no_controller", message=f"nobody answers at {key}"))
