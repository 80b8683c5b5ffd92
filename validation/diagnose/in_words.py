"""What a verdict says besides names: sizes that would have been seen, and what is left where nothing explains it."""

from __future__ import annotations

from collections.abc import Sequence

from scipy.special import ndtri  # scipy.stats takes half a second to import

from validation.contrasts import Region
from validation.diagnose.explanation import FOLLOWS, LEVEL, Explanation
from validation.diagnose.ground import Ground
from validation.diagnose.refitted import limits_of
from validation.diagnose.score import Scores
from validation.diagnose.verdict import HALF
from validation.fit import Fit
from validation.fit.anchored_fit import WORTH_MORE
from validation.fit.result import MOST_HISTORIES, wanted_histories

POWER = 0.9
FEW = 3
"""Limits and regions that a sentence names; tables have them all."""


def limits_in_words(scored: Scores) -> list[str]:
    """Above which size the most visible effects would have been seen with 90 % power, and how many more there are."""
    found = limits(scored)
    words = [f"{name} {value:.2g} {unit}".rstrip() for name, _, value, unit in found[:FEW]]
    return words + ([f"{len(found) - FEW} more in the table"] if len(found) > FEW else [])


def limits(scored: Scores) -> list[tuple[str, str, float, str]]:
    """(effect, parameter, value, unit) of the size that is seen with 90 % power, of all that can be tested."""
    count = max(len(scored.effects), 1)
    found = []
    for one in scored.effects:
        candidate = one.best.candidate
        if candidate.is_switch or candidate.is_group:
            continue
        lower, upper = limits_of(candidate.parameter)
        off = candidate.parameter.off if isinstance(candidate.parameter.off, float) else 0.0
        wanted = float(ndtri(POWER) - ndtri(LEVEL / 4.0 / count / one.shapes))  # its shapes are paid for, too
        value = abs(candidate.value(wanted * one.best.error) - off)
        if value <= max(upper - off, off - lower):
            found.append((value / (upper - lower), one.name, candidate.words, value, candidate.parameter.unit))
    return [entry[1:] for entry in sorted(found)]


def more_in_words(fit: Fit) -> str:
    """How more would be seen, where the Monte Carlo's own noise hides it; else nothing (decision 43)."""
    anchor = fit.problem.anchor
    if anchor is None or not anchor.histories:
        return ""
    needed = min(max(wanted_histories(fit.problem, fit.whitening).values()), MOST_HISTORIES)
    if needed < WORTH_MORE * anchor.histories:
        return ""
    return (
        f" The Monte Carlo's own noise is {fit.noise_share:.2f} of the camera's by pixel, and more of it along what"
        f" is smooth: --most-histories {needed} would show smaller ones."
    )


def left_in_words(ground: Ground, tried: Sequence[Explanation] = (), most: int = FEW) -> str:
    """What is left: the regions that are least like noise, on which samples it depends, what follows the field."""
    regions = [f"{one.z:+.1f} sigma at {one.place}" for one in _distinct(ground.structure.where)[:most]]
    by_pairs: dict[float, list[float]] = {}
    for image in ground.fit.problem.images:
        by_pairs.setdefault(image.sample.dbr_pairs, []).append(ground.structure.shots[image.shot.id].z)
    pairs = ", ".join(f"{n:g} pairs z {max(z):.1f}" for n, z in sorted(by_pairs.items()))
    return "; ".join(regions) + (f"; by DBR: {pairs}." if len(by_pairs) > 1 else ".") + _of_field_in_words(tried)


def _of_field_in_words(tried: Sequence[Explanation]) -> str:
    """That a group would take most of it, but for where its members are: a hint at camera and optics."""
    found = [one for one in tried if one.why_not == FOLLOWS and one.share.value > HALF]
    best = max(found, key=lambda one: one.drop, default=None)
    if best is None:
        return ""
    return (
        f" {best.name} would take {100.0 * best.share.value:.0f} % of it, but chips by chance do not follow the field"
        f" as it asks (p {best.by_place:.2g}): look at the camera and the optics."
    )


def _distinct(regions: Sequence[Region]) -> list[Region]:
    """One of each family."""
    return list({one.family: one for one in reversed(regions)}.values())[::-1]
