"""Designers beside each other: equal budgets, several seeds, every run a journal of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from agent.config import Campaign
from agent.progress import Found
from luxloop.errors import InputError

WITHIN_POINTS = 0.5
"""A run has come near where a design of its walk is this near to the best that any run of the comparison found."""


@dataclass(frozen=True)
class Trial:
    """One run of one designer: the walk's uniformities in the order of its evaluations, and what was found."""

    designer: str
    seed: int
    uniformity: tuple[float, ...]
    episodes: int
    found: Found


def refuse_own(campaign: Campaign) -> None:
    """InputError for what only one designer could have: each is compared as its preset, with its own reward."""
    for field, value in (("learning", campaign.learning), ("reward", campaign.reward)):
        if value is not None:
            mend = "leave it out; one designer with settings of its own: luxloop campaign run --config"
            raise InputError(f"--config: {field}", value, "none: every designer has its own", mend)


def compare(
    campaign: Campaign, names: Sequence[str], seeds: Sequence[int], run: Callable[[Campaign, str], tuple[Found, Any]]
) -> list[Trial]:
    """Every designer with every seed; `run` takes the campaign and a name for its run, and returns what was found
    and the uniformities of its walk. Raises InputError for settings that one designer alone could have."""
    refuse_own(campaign)
    trials = []
    for name in names:
        for seed in seeds:
            chosen = campaign.model_copy(update={"designer": name, "seed": seed})
            found, walk = run(chosen, f"{name}-{seed}")
            trials.append(Trial(name, seed, tuple(walk), found.progress.episodes, found))
    return trials


def rows(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """A row a designer: best of the finalists (median, worst, best of the seeds), evaluations to come near, time.

    Of a run none of whose finalists could be evaluated no best is counted.
    """
    finals = [trial.found.sound_best.uniformity for trial in trials if trial.found.sound_best]
    target = max((max(trial.uniformity, default=0.0) for trial in trials), default=0.0) - WITHIN_POINTS / 100.0
    table = []
    for name in dict.fromkeys(trial.designer for trial in trials):
        own = [trial for trial in trials if trial.designer == name]
        best = [trial.found.sound_best.uniformity for trial in own if trial.found.sound_best]
        near = [evaluations_to(trial.uniformity, target) for trial in own]
        came = [count for count in near if count is not None]
        table.append(
            {
                "designer": name,
                "runs": len(own),
                "best_median": median(best) if best else None,
                "best_worst": min(best, default=None),
                "best_best": max(best, default=None),
                "near": len(came),
                "evaluations_to_near": median(came) if came else None,
                "evaluations": median(len(trial.uniformity) for trial in own),
                "wall_s": median(trial.found.progress.wall_s for trial in own),
                "target": target,
                "best_of_all": max(finals, default=None),
            }
        )
    return table


def evaluations_to(uniformity: Sequence[float], target: float) -> int | None:
    """How many evaluations it took to reach the target; None where it was not reached."""
    return next((count for count, found in enumerate(uniformity, 1) if found >= target), None)
