"""How far a campaign is, what is on record of it when it goes on, and what it came to."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from agent.in_words import plain
from luxloop.campaign import Step

WALK, FINALISTS = "walk", "finalists"
COUNTS = ("steps", "evaluations", "episodes", "physics_s", "learner_s", "epsilon", "gained_episode", "stage")
STEPS = ("first", "best", "gained", "last")
"""What a `Progress` is made of, clocks aside."""


@dataclass
class Progress:
    """How far a campaign is, for whoever looks on."""

    steps: int = 0
    evaluations: int = 0
    episodes: int = 0
    physics_s: float = 0.0
    learner_s: float = 0.0
    before_s: float = 0.0  # of earlier starts
    began_s: float = field(default_factory=time.monotonic)
    first: Step | None = None
    best: Step | None = None
    gained: Step | None = None  # the best at the last gain that counted
    last: Step | None = None
    epsilon: float | None = None
    gained_episode: int = 0
    stage: str = WALK

    @property
    def wall_s(self) -> float:
        """Of this start and those before it."""
        return self.before_s + time.monotonic() - self.began_s

    def plain(self) -> dict[str, Any]:
        """As JSON values."""
        steps = {name: getattr(self, name) for name in STEPS}
        return {name: getattr(self, name) for name in COUNTS} | {
            name: step and step.model_dump(mode="json") for name, step in steps.items()
        }

    @classmethod
    def of_plain(cls, plain: dict[str, Any], before_s: float) -> Progress:
        """What `plain` was made of, as from now on, after so many seconds of earlier starts."""
        steps: dict[str, Any] = {name: plain[name] and Step.model_validate(plain[name]) for name in STEPS}
        counts: dict[str, Any] = {name: plain[name] for name in COUNTS}
        return cls(**counts, **steps, before_s=before_s)


@dataclass(frozen=True)
class Found:
    """What a campaign came to."""

    reason: str
    progress: Progress
    finalists: tuple[Step, ...]
    """The best first."""
    start: Step | None
    best: Step | None
    """The best finalist, evaluated once more: the best of five noisy numbers is flattered, this one is not."""
    without_dbr: Step | None

    @property
    def sound_best(self) -> Step | None:
        """What is reported as the best: where its last evaluation failed, the best finalist that did not."""
        evaluated = (self.best, *self.finalists)
        return next((step for step in evaluated if step is not None and step.failure is None), None)

    def summary(self) -> dict[str, Any]:
        """The result as plain values, as it stands in the journal: with what failed."""
        seen = self.progress
        return {
            "reason": self.reason,
            "steps": seen.steps,
            "evaluations": seen.evaluations,
            "episodes": seen.episodes,
            "wall_s": seen.wall_s,
            "physics_s": seen.physics_s,
            "learner_s": seen.learner_s,
            "start": plain(self.start),
            "best": plain(self.best),
            "without_dbr": plain(self.without_dbr),
            "finalists": [plain(step) for step in self.finalists],
        }


@dataclass(frozen=True)
class Past:
    """What is on record of a walk that goes on: its steps, how long it took, how it ended if it did."""

    steps: int = 0
    wall_s: float = 0.0
    end: WalkEnd | None = None


class WalkEnd(NamedTuple):
    """After how many steps the walk was ended, and why: a limit of time is not met twice at the same step."""

    steps: int
    reason: str

    @property
    def line(self) -> str:
        """As it stands in the journal's log."""
        return f"the walk ended after {self.steps} steps: {self.reason}"

    @classmethod
    def among(cls, lines: Iterable[str]) -> WalkEnd | None:
        """The end that a log tells of; None where the walk goes on."""
        found = (re.fullmatch(r"the walk ended after (\d+) steps: (.*)", line) for line in lines)
        return next((cls(int(one[1]), one[2]) for one in found if one), None)
