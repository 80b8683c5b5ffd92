"""Designers beside each other: equal budgets, several seeds, every run a journal of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from agent.campaign import SIGMAS
from agent.config import Campaign
from agent.moves import Key, key_of
from agent.progress import Found
from luxloop.campaign import Step
from luxloop.errors import InputError

WITHIN_POINTS = 0.5
"""A run has come near where its best is within so much, and twice the combined error, of the best of all runs."""


@dataclass(frozen=True)
class Trial:
    """One run of one designer: the walk's designs in the order of its evaluations, and what was found."""

    designer: str
    seed: int
    walk: tuple[Key, ...]
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
    and the designs of its walk. Raises InputError for settings that one designer alone could have."""
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
    top = best_of(trials)
    table = []
    for name in dict.fromkeys(trial.designer for trial in trials):
        own = [trial for trial in trials if trial.designer == name]
        best = [trial.found.sound_best.uniformity for trial in own if trial.found.sound_best]
        near = [evaluations_to_near(trial, top) for trial in own]
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
                "evaluations": median(len(trial.walk) for trial in own),
                "wall_s": median(trial.found.progress.wall_s for trial in own),
                "best_of_all": top and top.uniformity,
                "best_of_all_error": top and top.uniformity_error,
            }
        )
    return table


def best_of(trials: Sequence[Trial]) -> Step | None:
    """The best of all that was evaluated anew."""
    best = (trial.found.sound_best for trial in trials)
    return max((step for step in best if step), key=lambda step: step.uniformity, default=None)


def evaluations_to_near(trial: Trial, top: Step | None) -> int | None:
    """After how many evaluations of its walk a run met its best; None where that is not near the best of all.

    Both are held to what was evaluated anew: in a walk the luckiest noise is the best.
    """
    own = trial.found.sound_best
    if own is None or top is None:
        return None
    error = math.hypot(own.uniformity_error, top.uniformity_error)
    if top.uniformity - own.uniformity > WITHIN_POINTS / 100.0 + SIGMAS * error:
        return None
    return trial.walk.index(key_of(own.design)) + 1
