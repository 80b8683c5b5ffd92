"""Values that are reckoned once and go, at the next look, with what they were made of."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Any, Generic, TypeVar
from weakref import ref

Value = TypeVar("Value")


class Held(Generic[Value]):
    """Values by key, the latest ones, of so many bytes; it only saves time.

    A key says all that decides a value, and which source it is of by its id.
    """

    def __init__(self, most_bytes: int, bytes_of: Callable[[Value], int]) -> None:
        self._lock, self._most_bytes, self._bytes_of = Lock(), most_bytes, bytes_of
        self._held: OrderedDict[str, tuple[ref[Any], Value]] = OrderedDict()
        self._bytes = 0

    def __len__(self) -> int:
        """How many are held."""
        return len(self._held)

    def of(self, key: str, source: object, make: Callable[[], Value]) -> Value:
        """What is held under a key of this source, or made now; others may have got the id of some that are gone."""
        with self._lock:
            for gone in [one for one, (its, _) in self._held.items() if its() is None]:
                self._drop(gone)
            if (held := self._held.get(key)) is not None and held[0]() is source:
                self._held.move_to_end(key)
                return held[1]
        made = make()
        with self._lock:
            if key in self._held:
                self._drop(key)
            self._held[key], self._bytes = (ref(source), made), self._bytes + self._bytes_of(made)
            while len(self._held) > 1 and self._bytes > self._most_bytes:
                self._drop(next(iter(self._held)))
        return made

    def _drop(self, key: str) -> None:
        self._bytes -= self._bytes_of(self._held.pop(key)[1])
