"""The table of the blind test: hits of how many, the interval of Clopper and Pearson, met or shown.

    met    the share that was found reaches the target          shown    so does the whole 95 % interval

Alarms on draws of one light are not independent: their interval comes of whole truths drawn again (a cluster
bootstrap). That of a mean size is 1.96 standard errors to either side. Rows without sets stay in the table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import betaincinv  # scipy.stats takes half a second to import

from validation.blind_test.marks import Marked

LEVEL = 0.95
RESAMPLED = 10_000
AT = 0.15
"""Share by which a strength may miss the one that a row is of."""
IMAGES, MOST_SECONDS = 6, {"twin": 60.0, "anchored": 1800.0}
"""What the specification's limits are of: that many images, by each solver."""
EXACT, ERROR, REDRAWN = "Clopper-Pearson", "+- 1.96 s.e.", "Clopper-Pearson and truths drawn again, the wider"


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    quantity: str
    target: str
    hits: float
    of: int
    value: float | None
    low: float | None
    high: float | None
    least: float | None = None
    most: float | None = None
    unit: str = "share"
    interval: str = EXACT
    """How low and high were found."""

    @property
    def said(self) -> str:
        """shown, met, short; open where too few sets say; no sets; nothing for a row without a target."""
        if self.value is None or self.low is None or self.high is None:
            return "no sets"
        if self.least is None and self.most is None:
            return ""
        least, most = self.least or 0.0, np.inf if self.most is None else self.most
        if self.most is not None and self.value < least <= self.high:  # e.g. no alarm in 40 sets
            return "open"
        if not least <= self.value <= most:
            return "short"
        return "shown" if least <= self.low and self.high <= most else "met"

    def document(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "quantity": self.quantity, "target": self.target, "hits": self.hits, "of": self.of, "value": self.value,
            "low": self.low, "high": self.high, "unit": self.unit, "interval": self.interval,
            "said": self.said,
        }  # fmt: skip


def interval(hits: int, of: int, level: float = LEVEL) -> tuple[float, float]:
    """The exact interval of Clopper and Pearson of a share; (0, 1) of nothing."""
    tail = (1.0 - level) / 2.0
    low = float(betaincinv(hits, of - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, of - hits, 1.0 - tail)) if hits < of else 1.0
    return low, high


def table(sets: Sequence[Marked]) -> list[Row]:
    """All rows, with their targets."""
    later = {each.answer.follows: each for each in sets if each.answer.follows}
    sets = [each for each in sets if not each.answer.follows]
    one = [each for each in sets if each.is_one]
    strong = [each for each in one if _at_least(each, 20.0)]
    apart = [each for each in one if each.told_apart]
    alike = [each for each in one if each.told_apart is False]
    outside = [each for each in sets if each.is_outside]
    strange = [each for each in outside if each.told_apart]
    familiar = [each for each in outside if each.told_apart is False]
    two = [each for each in sets if each.is_two]
    pulls = [each.size_pull for each in one if each.size_pull is not None]
    falls = [each.held_out[0] for each in one if each.held_out[0] is not None]
    further = [_last(each, later) for each in apart if later and not _is_open(each, later)]
    others = [any(each.held_out[1]) for each in one if each.held_out[1]]
    return [
        alarms([each for each in sets if each.is_nothing]),
        _share("detection at 8 sigma", [each for each in one if _at(each, 8.0)], lambda each: each.is_seen, 0.95),
        _share("detection at 20 sigma or more", strong, lambda each: each.is_seen, None),
        _share("exact name, sigma_rival >= 5", apart, lambda each: each.is_exact, 0.8),
        _share("the same, with the proposed image", further, lambda each: each.is_exact, 0.9),
        _share(
            "cannot_tell_apart, sigma_rival < 5", alike, lambda each: each.verdict == "cannot_tell_apart", 0.9
        ),
        _share("right group, 20 sigma or more", strong, lambda each: each.in_group, 0.95),
        _share("true effect in the reported set", strong, lambda each: each.in_set, 0.95),
        sizes([len(each.named) for each in strong if each.named]),
        _share("outside, at 20 sigma: none_of_the_known", _of(outside, 20.0), _none_of_the_known, 0.9),
        _share("outside, at 40 sigma: none_of_the_known", _of(outside, 40.0), _none_of_the_known, 0.95),
        _share("outside, sigma_rival >= 5: none_of_the_known", strange, _none_of_the_known, None),
        _share("outside, sigma_rival < 5: such a rival named", familiar, lambda each: each.is_taken, None),
        _share("a known one called none_of_the_known", one, _none_of_the_known, None, 0.03),
        _share("two hidden, both named or their groups", two, lambda each: each.both_found, 0.8),
        _counted("size within 2 of its errors, form right", [abs(pull) < 2.0 for pull in pulls], 0.95),
        _counted("held-out error falls with the true effect", [bool(fell) for fell in falls], 0.95),
        _counted("sets without a held-out fall with another group's", [not fell for fell in others], 0.95),
        _fast("six images by the twin in 60 s or less", sets, "twin"),
        _fast("six images by Monte Carlo in 30 min or less", sets, "anchored"),
    ]  # fmt: skip


def alarms(sets: Sequence[Marked], seed: int = 1) -> Row:
    """False alarms on sets with nothing hidden; the interval by whole truths drawn again."""
    by_light: dict[str, list[bool]] = {}
    for one in sets:
        by_light.setdefault(f"{one.folder}/{one.answer.light}", []).append(one.verdict != "nothing_visible")
    hits, of = sum(map(sum, by_light.values())), len(sets)
    target = "0.2 to 2 %"
    quantity = f"alarms at 1 %, nothing hidden ({len(by_light)} truths)"
    if not of:
        return Row(quantity, target, 0, 0, None, None, None, 0.002, 0.02, interval=REDRAWN)
    low, high = interval(hits, of)
    if hits:
        sums = np.array([[sum(one), len(one)] for one in by_light.values()], float)
        drawn = np.random.default_rng(seed).integers(len(sums), size=(RESAMPLED, len(sums)))
        shares = sums[drawn].sum(axis=1)
        ends = np.quantile(shares[:, 0] / shares[:, 1], [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
        low, high = min(low, float(ends[0])), max(high, float(ends[1]))
    return Row(quantity, target, hits, of, hits / of, low, high, 0.002, 0.02, interval=REDRAWN)


def sizes(counts: Sequence[int]) -> Row:
    """The mean size of reported sets, with 1.96 times its standard error: no exact interval."""
    quantity, target = "mean size of the reported set", "<= 2.5"
    if not counts:
        return Row(quantity, target, 0, 0, None, None, None, None, 2.5, "effects", ERROR)
    mean = float(np.mean(counts))
    error = float(np.std(counts, ddof=1) / np.sqrt(len(counts))) if len(counts) > 1 else np.inf
    low, high = max(mean - 1.96 * error, 1.0), mean + 1.96 * error
    return Row(
        quantity, target, float(sum(counts)), len(counts), mean, low, min(high, 1e3), None, 2.5, "effects", ERROR
    )


def _fast(quantity: str, sets: Sequence[Marked], method: str) -> Row:
    """Diagnoses within the specification's limit: of six images, each the first of its light."""
    seconds = [
        float(each.record["seconds"]) for each in sets
        if each.record["first_of_light"] and each.record["solver"]["method"] == method
        and len(each.record["shots"]) == IMAGES
    ]  # fmt: skip
    return _counted(quantity, [one <= MOST_SECONDS[method] for one in seconds], None)


def _share(
    quantity: str,
    sets: Sequence[Marked],
    is_hit: Callable[[Marked], bool],
    least: float | None,
    most: float | None = None,
) -> Row:
    return _counted(quantity, [is_hit(each) for each in sets], least, most)


def _counted(quantity: str, hits: Sequence[bool], least: float | None, most: float | None = None) -> Row:
    target = f">= {100.0 * least:.0f} %" if least is not None else f"<= {100.0 * most:.0f} %" if most else "-"
    if not hits:
        return Row(quantity, target, 0, 0, None, None, None, least, most)
    count = sum(hits)
    return Row(quantity, target, count, len(hits), count / len(hits), *interval(count, len(hits)), least, most)


def _last(one: Marked, later: Mapping[str, Marked]) -> Marked:
    """The set with the last image that its verdicts proposed."""
    while one.record["seal"] in later:
        one = later[one.record["seal"]]
    return one


def _is_open(one: Marked, later: Mapping[str, Marked]) -> bool:
    """Whether an image was proposed that was not taken, or has no verdict yet."""
    return one.record["next_measurement"] is not None and one.record["seal"] not in later


def _none_of_the_known(one: Marked) -> bool:
    return one.verdict == "none_of_the_known"


def _at(one: Marked, sigma: float) -> bool:
    """Whether a hidden thing has that strength; a discrete one, which cannot be tuned, may have another."""
    return abs(one.answer.sigma / sigma - 1.0) <= AT


def _at_least(one: Marked, sigma: float) -> bool:
    return one.answer.sigma >= (1.0 - AT) * sigma


def _of(sets: Sequence[Marked], sigma: float) -> list[Marked]:
    return [each for each in sets if _at(each, sigma)]


# Who is taken for whom


@dataclass(frozen=True)
class Confused:
    """How often a truth (row) was called something (column)."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, pairs: Sequence[tuple[str, str]]) -> Confused:
        """From (truth, said); those outside are the last rows, what is a truth, too, the first columns."""
        rows = tuple(sorted({truth for truth, _ in pairs}, key=lambda one: (one.startswith("outside"), one)))
        said = {one for _, one in pairs}
        columns = (*(one for one in rows if one in said), *sorted(said - set(rows)))
        counts = tuple(tuple(pairs.count((row, column)) for column in columns) for row in rows)
        return cls(rows, columns, counts)

    def document(self) -> dict[str, Any]:
        """As plain values."""
        return {"rows": self.rows, "columns": self.columns, "counts": self.counts}
