"""What a bus is: ask and answer, publish and subscribe, announce and watch.

Over zenoh in `zenoh_bus.py`, and inside one process in tests; one suite holds both to it.

Nothing computes in a callback of the bus. Everything that arrives goes into an `Inbox`, a bounded queue that its
owner empties in a thread of its own; a query that finds it full is answered "busy", a publication is counted as
dropped. No answer is not an answer: `ask` returns a frame or raises `RemoteError` with a typed `Failure`.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

from luxloop.bus.frame import Parcel, decode, encode
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.words import Words

INBOX_ITEMS = 1024
INBOX_BYTES = 256 << 20


@dataclass(frozen=True)
class Asked:
    """A query that wants exactly one answer: `answer(frame)`; dropping it leaves the asker with nothing."""

    key: str
    frame: bytes
    answer: Callable[[bytes], None]
    drop: Callable[[], None]

    def reply(self, message: Words | bytes) -> None:
        """Answer with a message without arrays, or with a frame."""
        self.answer(message if isinstance(message, bytes) else encode(message))


@dataclass(frozen=True)
class Heard:
    """A publication."""

    key: str
    frame: bytes


@dataclass(frozen=True)
class Presence:
    """A process appeared at, or vanished from, a liveliness key."""

    key: str
    alive: bool


Event = Asked | Heard | Presence


class Interrupt(threading.Event):
    """An event that also ends questions that are being held: `set` calls whoever is registered."""

    def __init__(self) -> None:
        super().__init__()
        self._calls: set[Callable[[], object]] = set()

    def set(self) -> None:
        super().set()
        for call in list(self._calls):
            call()

    @contextmanager
    def ends(self, call: Callable[[], object]) -> Iterator[None]:
        """While inside, `call` runs as soon as the interrupt is set; at once where it is set already."""
        self._calls.add(call)
        if self.is_set():
            call()
        try:
            yield
        finally:
            self._calls.discard(call)


class Inbox:
    """A bounded queue between the bus's threads and its owner's: bounded in items and in bytes."""

    def __init__(self, items: int = INBOX_ITEMS, max_bytes: int = INBOX_BYTES) -> None:
        self._events: deque[Event] = deque()
        self._filled = threading.Condition()
        self._items, self._max_bytes, self._bytes = items, max_bytes, 0
        self.dropped = 0

    def offer(self, event: Event) -> bool:
        """Put an event without waiting; False where there is no room. Presence always has room.

        Losing a Presence would keep a dead worker's tasks for ever.
        """
        size = 0 if isinstance(event, Presence) else len(event.frame)
        with self._filled:
            full = len(self._events) >= self._items or self._bytes + size > self._max_bytes
            if full and not isinstance(event, Presence):
                self.dropped += 1
                return False
            self._events.append(event)
            self._bytes += size
            self._filled.notify()
        return True

    def take(self, timeout_s: float) -> Event | None:
        """The next event, or None after `timeout_s`."""
        with self._filled:
            if not self._filled.wait_for(lambda: self._events, timeout_s):
                return None
            event = self._events.popleft()
            self._bytes -= 0 if isinstance(event, Presence) else len(event.frame)
            return event

    def __len__(self) -> int:
        return len(self._events)


class Bus(Protocol):
    """One process's door to all others. Thread-safe; close it, or leave it by `with`."""

    def ask(self, key: str, frame: bytes, timeout_s: float, cancelled: Interrupt | None = None) -> bytes:
        """The one answer to a query. Raises RemoteError: no_router, no_controller, refused, timed_out, cancelled."""
        ...

    def answer(self, key_expr: str, inbox: Inbox) -> None:
        """Queries on `key_expr` arrive in `inbox` as `Asked`."""
        ...

    def publish(self, key: str, frame: bytes) -> None:
        """Tell whoever listens; nobody listening is no error."""
        ...

    def subscribe(self, key_expr: str, inbox: Inbox) -> None:
        """Publications on `key_expr` arrive in `inbox` as `Heard`."""
        ...

    def announce(self, key: str) -> None:
        """Hold a liveliness token at `key` for as long as this process lives."""
        ...

    def present(self, key_expr: str) -> frozenset[str]:
        """The liveliness keys that are held now, of expressions that this bus does not watch itself.

        Of those it does, zenoh's answer may be empty for some ms after a token has left. Raises RemoteError where the
        router does not say: silence is nobody's absence.
        """
        ...

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        """Tokens held now and from now on arrive in `inbox` as `Presence`."""
        ...

    def connected(self) -> bool:
        """Whether the others can be reached at this moment."""
        ...

    def close(self) -> None:
        """End all of it."""
        ...

    def __enter__(self) -> Bus: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def ask_for(
    bus: Bus,
    key: str,
    message: Words | bytes,
    timeout_s: float,
    *,
    cancelled: Interrupt | None = None,
    fetch: Callable[[str, int], bytes] | None = None,
) -> Parcel:
    """Ask and decode; an answer that is a `Failure` is raised as `RemoteError`."""
    frame = message if isinstance(message, bytes) else encode(message)
    parcel = decode(bus.ask(key, frame, timeout_s, cancelled), fetch)
    if isinstance(parcel.message, Failure):
        raise RemoteError(parcel.message)
    return parcel


def busy(where: str) -> bytes:
    """The answer of a full inbox, as a frame."""
    return encode(Failure(code="busy", message="queue full", mend="try again in a moment", where=where))


def too_large(size: int, limit: int, key: str) -> bytes:
    """The answer to a request over the limit, as a frame."""
    error = InputError("request", f"{size} bytes", f"at most {limit} bytes", "large arrays go by hash")
    return encode(Failure.of(error, key).model_copy(update={"code": "too_large"}))
