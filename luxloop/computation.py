"""What makes a worker a film worker or a ray worker: it computes, reports how far it is, and can be stopped."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from luxloop.bus.frame import Array
from luxloop.failure import printable


class Stopped(Exception):  # noqa: N818  not an error: the task was cancelled, or the worker leaves
    """Raised at a checkpoint of the computation."""


@dataclass
class Progress:
    """How far a computation is; it reports here between chunks, and is stopped here."""

    ratio: float = 0.0
    note: str = ""
    stop: threading.Event = field(default_factory=threading.Event)

    def report(self, ratio: float, note: str = "") -> None:
        """Note how far it is (0 to 1); raises Stopped where it is to end."""
        self.ratio = min(ratio, 1.0) if ratio > 0.0 else 0.0  # NaN becomes 0
        self.note = printable(note)[:200]
        if self.stop.is_set():
            raise Stopped


class Computation(Protocol):
    """What makes a worker a film worker or a ray worker."""

    kind: str

    def catalogue(self) -> dict[str, Any]:
        """What it can do, told to the controller once."""
        ...

    def compute(self, inputs: dict[str, Any], progress: Progress) -> tuple[dict[str, Any], Mapping[str, Array]]:
        """The result and its arrays. Raises InputError for a request that cannot be used."""
        ...

    def blob(self, sha256: str) -> bytes | None:
        """A blob of its own store, beside those sent as large arrays."""
        ...
