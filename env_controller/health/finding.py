"""One line of the doctor's report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """What was looked at, whether it is in order, what was seen, and how to mend it."""

    what: str
    verdict: Verdict
    found: str
    mend: str = ""
