"""What was dear to make outlives what was cheap: a cache that weighs what an entry cost against what room it takes.

    worth = clock + cost / size, anew at each use;   what is worth least goes, and the clock is then its worth

So an anchor of 32 million histories is not pushed out by the many small runs of a catalogue's columns, and yet goes
in the end, when enough was asked for since (GreedyDual-Size: Cao and Irani, USENIX Symp. Internet Tech., 1997).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

Value = TypeVar("Value")


class _Entry(NamedTuple, Generic[Value]):
    value: Value
    worth: float
    size: float


class Kept(Generic[Value]):
    """Values by key, of sizes that add up to `most` at most; the last one that was asked for is kept in any case."""

    def __init__(self, most: float, size_of: Callable[[Value], float] = lambda _: 1.0) -> None:
        self._most, self._size_of, self._clock = most, size_of, 0.0
        self._held: dict[str, _Entry[Value]] = {}

    def __contains__(self, key: str) -> bool:
        """Whether nothing has to be made for it."""
        return key in self._held

    def __len__(self) -> int:
        """How many are held."""
        return len(self._held)

    def of(self, key: str, cost: float, make: Callable[[], Value]) -> Value:
        """What is held under a key, or made now at that cost, in any one unit."""
        value = self._held.pop(key).value if key in self._held else make()
        size = max(self._size_of(value), 1.0)
        self._held[key] = _Entry(value, self._clock + cost / size, size)
        while len(self._held) > 1 and sum(one.size for one in self._held.values()) > self._most:
            least = min((one for one in self._held if one != key), key=lambda one: self._held[one].worth)
            self._clock = max(self._clock, self._held.pop(least).worth)
        return value
