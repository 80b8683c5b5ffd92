"""Which running task is so slow that a second worker, idle otherwise, should try it too. Pure."""

from __future__ import annotations

from collections import deque
from statistics import median

KNOWN = 8  # durations of a kind before anything is called slow
KEPT = 64
SLOW = 4.0  # times the median
LEAST_S = 2.0  # what is shorter is not worth a second worker


class Durations:
    """How long the tasks of each kind took lately."""

    def __init__(self) -> None:
        self._of_kind: dict[str, deque[float]] = {}

    def note(self, kind: str, took_s: float) -> None:
        """An attempt of this kind was finished."""
        self._of_kind.setdefault(kind, deque(maxlen=KEPT)).append(took_s)

    def slow_after_s(self, kind: str) -> float | None:
        """Time after which an attempt of this kind is slow; None while too little is known."""
        known = self._of_kind.get(kind, ())
        return max(SLOW * median(known), LEAST_S) if len(known) >= KNOWN else None
