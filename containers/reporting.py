"""What a long computation calls between its parts: whoever listens may raise there to end it."""

from __future__ import annotations

from collections.abc import Callable

Report = Callable[[], None]


def nothing() -> None:
    """A report that nobody hears."""
