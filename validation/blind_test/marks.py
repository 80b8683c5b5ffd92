"""Marks: each verdict beside its answer, seals opened; nothing is decided here that could be decided otherwise.

A named effect is exact where it is one of the kind's right answers; of the right group where it shares a fixed group
(`groups.GROUPS`) or a group that the diagnosis itself found (cosine above 0.9) with one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from luxloop.errors import InputError
from validation.blind_test.alone import refuse_busy
from validation.blind_test.bound import chain_of, check_maps, check_root, refuse_opened
from validation.blind_test.folders import Entry, Index, read_index
from validation.blind_test.groups import group_of
from validation.blind_test.records import read_record, record_path
from validation.blind_test.seals import Answer, has_data, opened, refuse_other_entry
from validation.diagnose.held_out import Change
from validation.effects.confounding import TOLD_APART

NAMING = ("one_effect", "cannot_tell_apart")
SAME_SIZE: dict[str, tuple[str, str]] = {
    "wrong_spacer": ("distance_error", "distance_um"),
    "wrong_scale": ("magnification", "scale_error"),
}
"""Kinds whose amount is a parameter of the catalogue's effect, of one meaning and unit: there the form is right."""


@dataclass(frozen=True, eq=False)
class Marked:
    """A set's verdict and its answer."""

    folder: Path
    answer: Answer
    record: Mapping[str, Any]
    is_checked: bool = True
    """Whether its data lie here and are those that were sealed; records that are kept have none."""

    @property
    def id(self) -> str:
        """Of the set."""
        return self.answer.id

    @property
    def verdict(self) -> str:
        """One of the five."""
        return str(self.record["verdict"])

    @property
    def is_nothing(self) -> bool:
        """Whether nothing is hidden."""
        return not self.answer.hidden

    @property
    def is_outside(self) -> bool:
        """Whether what is hidden is outside of the catalogue."""
        return bool(self.answer.hidden) and not any(one.right for one in self.answer.hidden)

    @property
    def is_one(self) -> bool:
        """Whether one effect of the catalogue is hidden."""
        return len(self.answer.hidden) == 1 and not self.is_outside

    @property
    def is_two(self) -> bool:
        """Whether two are."""
        return len(self.answer.hidden) == 2

    @property
    def right(self) -> tuple[str, ...]:
        """Effects that are a right answer to any of what is hidden."""
        return tuple(name for one in self.answer.hidden for name in one.right)

    @property
    def truth(self) -> str:
        """What is hidden, by the catalogue's name; the kind's own where it is outside."""
        words = [" or ".join(one.right) or f"outside: {one.kind}" for one in self.answer.hidden]
        return " + ".join(sorted(words)) or "nothing"

    @property
    def said(self) -> str:
        """The effect that is named first, else the verdict."""
        return self.named[0] if self.named else self.verdict

    @property
    def named(self) -> tuple[str, ...]:
        """The reported set: effects that explain within 10 % of the best."""
        return tuple(self.record["set"]) if self.verdict in NAMING else ()

    @property
    def is_seen(self) -> bool:
        """Whether the diagnosis says that something is wrong; a fit that it does not trust is no such thing."""
        return self.verdict not in ("nothing_visible", "fit_not_trustworthy")

    @property
    def is_exact(self) -> bool:
        """One effect, and a right one."""
        return self.verdict == "one_effect" and self.named[0] in self.right

    @property
    def in_set(self) -> bool:
        """Whether the reported set has a right one."""
        return bool(set(self.named) & set(self.right))

    @property
    def in_group(self) -> bool:
        """Whether the effect that is named first is right, or of the right group."""
        return bool(self.named) and self._is_of(self.named[0], self.right)

    @property
    def both_found(self) -> bool:
        """Whether each of two hidden things is named, or one of its group, by an effect of its own."""
        names = [str(one["name"]) for one in self.record["added"]] if self.verdict in NAMING else []
        fits = [[name for name in names if self._is_of(name, one.right)] for one in self.answer.hidden]
        return len(fits) == 2 and any(one != other for one in fits[0] for other in fits[1])

    def _is_of(self, name: str, right: Iterable[str]) -> bool:
        own = next((group for group in self.record["groups"] if name in group), [name])
        return any(one in own or group_of(one) == group_of(name) for one in right)

    @property
    def sigma_rival(self) -> float | None:
        """What is left of the only hidden thing beside its nearest rival; None where that was not measured."""
        rivals = self.answer.hidden[0].rivals if self.is_one or self.is_outside else {}
        return min(rivals.values(), default=None)

    @property
    def told_apart(self) -> bool | None:
        """Whether the data can tell it from all others."""
        return None if self.sigma_rival is None else self.sigma_rival >= TOLD_APART

    @property
    def is_taken(self) -> bool:
        """Whether what is named first takes all but `TOLD_APART` sigma of the only hidden thing."""
        rivals = self.answer.hidden[0].rivals
        return bool(self.named) and rivals.get(self.named[0], TOLD_APART) < TOLD_APART

    @property
    def size_pull(self) -> float | None:
        """(size - truth) / error of a named effect whose form is right; None where there is no such thing."""
        if not (self.is_one and self.is_exact) or self.answer.hidden[0].kind not in SAME_SIZE:
            return None
        effect, parameter = SAME_SIZE[self.answer.hidden[0].kind]
        rows = [one for one in self.record["effects"] if one["name"] == effect]
        found = rows[0]["size"].get(parameter) if rows else None
        if found is None or not found["error"]:
            return None
        return float((found["value"] - self.answer.hidden[0].amount) / found["error"])

    @cached_property
    def held_out(self) -> tuple[bool | None, list[bool]]:
        """Whether the held-out error falls with the best right effect; the same of each tried one outside its group.

        A fall is one beyond twice its own error, as the diagnosis counts it, where the record has that error.
        """
        falls: bool | None = None
        others = []
        for one in self.record["effects"]:
            if one["held_out_before"] is None:
                continue
            fell = _fell(one)
            if one["name"] in self.right:
                falls = fell if falls is None else falls
            elif not self._is_of(one["name"], self.right):
                others.append(fell)
        return falls, others

    @property
    def is_missed(self) -> bool:
        """Whether the verdict is wrong: an alarm, a name of another group, a known effect for an unknown one."""
        if self.is_nothing:
            return self.verdict != "nothing_visible"
        if self.is_outside:
            return self.verdict != "none_of_the_known"
        return not (self.both_found if self.is_two else self.in_group)

    def document(self) -> dict[str, Any]:
        """As plain values: a row of the list of all sets."""
        return {
            "id": self.id, "folder": str(self.folder), "truth": self.truth, "said": self.said,
            "verdict": self.verdict, "set": list(self.named), "sigma": self.answer.sigma,
            "asked_sigma": self.answer.asked_sigma, "sigma_rival": self.sigma_rival, "missed": self.is_missed,
            "hidden": [one.model_dump(mode="json", exclude={"rivals"}) for one in self.answer.hidden],
            "sentence": self.record["sentence"], "follows": self.answer.follows,
            "p_structure": self.record["structure"]["p"], "p_scores": self.record["scores_p"],
            "light": self.answer.light, "data_checked": self.is_checked,
            "seconds_made": self.answer.seconds, "seconds_diagnosed": self.record["seconds"],
        }  # fmt: skip


def _fell(effect: Mapping[str, Any]) -> bool:
    """Whether the held-out error falls with an effect, beyond its error where there is one."""
    change, error = effect.get("held_out_density_change"), effect.get("held_out_density_error")
    if change is None or error is None:
        return float(effect["held_out_after"]) < float(effect["held_out_before"])
    return Change(float(change), float(error)).falls


def marked(folders: Sequence[Path]) -> list[Marked]:
    """All sets of all folders that have a verdict; only their seals are opened.

    Raises InputError where there is no verdict at all, where a diagnosis works in a folder, where two sets have one
    seal, the same data, or follow one set, and what `bound.check_root`, `refuse_opened`, `chain_of`,
    `seals.opened` and `refuse_other_entry` do.
    """
    found: list[Marked] = []
    seen: dict[str, str] = {}
    for folder in folders:
        for entry in _judged(folder):
            record = read_record(folder, entry.id)
            check_maps(folder, entry.id, record)
            one = Marked(folder, opened(folder, entry.id, record), record, has_data(folder, entry.id))
            refuse_other_entry(entry, one.answer)
            _count_once(one, seen)
            found.append(one)
    return found


def _judged(folder: Path) -> list[Entry]:
    """The sets of a folder that have a verdict, once nothing was changed or taken away."""
    index: Index = read_index(folder)
    refuse_busy(folder)
    check_root(folder, index)
    refuse_opened(folder, index)
    chain_of(folder, index)
    judged = [one for one in index.sets if record_path(folder, one.id).exists()]
    if not judged:
        mend = f"luxloop blind diagnose {folder} comes first: no seal is opened before"
        raise InputError("FOLDER", str(folder), "sets with verdicts on record", mend)
    return judged


def _count_once(one: Marked, seen: dict[str, str]) -> None:
    """Raises InputError for a set that is there already, made again by the same seed, or with a second image."""
    where = f"{one.folder}: {one.id}"
    same = {
        f"seal {one.record['seal']}": ("each set once", "it is {}, too"),
        f"data {one.answer.dataset_sha256}": ("each set once", "its data are those of {}, made by the same seed"),
    }
    if one.answer.follows:
        allowed = "one further set of each"
        same[f"follows {one.answer.follows}"] = (allowed, "{} follows the same set: score one of them")
    for key, (allowed, mend) in same.items():
        if key in seen:
            raise InputError("FOLDER", where, allowed, mend.format(seen[key]))
        seen[key] = where
