"""What an auditor says of a run: comparisons of what is on record with what comes out now.

A room's auditors are found by the entry points `luxloop.auditors`; the name begins with the level of the replay that
they belong to, as `level3.designer`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

if TYPE_CHECKING:
    from luxloop.campaign import Step

Verdict = Literal["identical", "within tolerance", "differs", "not comparable"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)


@dataclass(frozen=True)
class Compared:
    """One comparison: of what, at which step of the journal, with which verdict and why; z in standard errors."""

    what: str
    verdict: Verdict
    sequence: int = -1
    step: str = ""
    logged: Any = None
    now: Any = None
    why: str = ""
    z: float | None = None


@dataclass(frozen=True)
class Place:
    """Says what was compared at one step."""

    say: Callable[[Compared], None]
    sequence: int = -1
    step: str = ""

    @classmethod
    def of(cls, say: Callable[[Compared], None], sequence: int, step: Step) -> Place:
        """At a step of the journal."""
        return cls(say, sequence, f"step {sequence} (lane {step.lane}, action {step.number})")

    def exact(self, what: str, logged: Any, now: Any, why: str = "") -> bool:
        """Identical or not; whether it is."""
        self._told(what, "identical" if logged == now else "differs", logged, now, why)
        return bool(logged == now)

    def near(self, what: str, logged: float, now: float, tolerance: float, why: str) -> None:
        """The same for numbers that may differ by `tolerance`, for the reason `why`."""
        if logged == now:
            self._told(what, "identical", logged, now)
        else:
            self._told(what, "within tolerance" if abs(logged - now) <= tolerance else "differs", logged, now, why)

    def scored(
        self, what: str, verdict: Verdict, logged: Any, now: Any, why: str = "", z: float | None = None
    ) -> None:
        """A verdict that was found otherwise, with a difference in standard errors where there is one."""
        self._told(what, verdict, logged, now, why, z)

    def nothing(self, what: str, why: str) -> None:
        """Nothing to compare with."""
        self._told(what, "not comparable", why=why)

    def _told(
        self, what: str, verdict: Verdict, logged: Any = None, now: Any = None, why: str = "", z: float | None = None
    ) -> None:
        self.say(Compared(what, verdict, self.sequence, self.step, logged, now, why, z))
