"""A replay of a run: levels 1 to 4, what came of each comparison, and the exit code.

    1 verify       the file is what was written (`checks`); it comes first at every level, and a broken chain ends it
    2 re-derive    what follows from the replies on record follows again
    3 re-decide    the designer, told the same, decides the same
    4 re-execute   the workers, asked the same, answer the same

Levels 2 and 3 are done by the rooms' auditors, found by the entry points `luxloop.auditors`; so is level 4 of runs
that compare models with measurements, whose requests came from elsewhere than the environment-control agent.
"""

from __future__ import annotations

import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from env_controller.audit import checks, scores
from env_controller.audit.machine import other_bits
from luxloop.audit import VERDICTS, Compared, Verdict
from luxloop.journal.reader import RunJournal

SAME, FAILED, DIFFERS, BROKEN = 0, 1, 4, 5
"""Exit codes."""
KEPT = 1000  # differences of which the first are shown
SHOWN = 10
ON_THE_WAY = frozenset({"film", "film arrays"})
"""Compared at level 4 on the way to a campaign's evaluations: alone they say nothing of it."""
Document = dict[str, Any]


class Auditor(Protocol):
    """What an entry point names: looks through a journal and says what it compared.

    `same_machine`: the packages and the processor that count are those of the record, so bits may be demanded.
    """

    def __call__(self, journal: RunJournal, say: Callable[[Compared], None], *, same_machine: bool) -> None: ...


@dataclass
class Tally:
    """What was compared so far, by what it is. Takes from several threads."""

    counts: dict[str, Counter[Verdict]] = field(default_factory=lambda: defaultdict(Counter))
    whys: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    z: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    differences: list[Compared] = field(default_factory=list)
    look: Callable[[Compared], object] = lambda _: None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def take(self, one: Compared) -> None:
        """Count a comparison."""
        with self._lock:
            self.counts[one.what][one.verdict] += 1
            if one.why and one.verdict != "identical":
                self.whys[f"{one.what}, {one.verdict}"][one.why] += 1
            if one.z is not None:
                self.z[one.what].append(one.z)
            if one.verdict == "differs":
                self.differences.append(one)
                if len(self.differences) > 2 * KEPT:
                    self.differences = self.first(KEPT)
            self.look(one)

    @property
    def total(self) -> Counter[Verdict]:
        """All comparisons by verdict."""
        return sum(self.counts.values(), Counter())

    def first(self, count: int) -> list[Compared]:
        """The first differences in the order of the journal; what is of no step comes last."""
        return sorted(self.differences, key=lambda one: (one.sequence < 0, one.sequence))[:count]

    @property
    def agreed(self) -> int:
        """Comparisons of what the replay is about that came out the same."""
        about = [of_it for what, of_it in self.counts.items() if what not in ON_THE_WAY]
        return sum(of_it["identical"] + of_it["within tolerance"] for of_it in about)

    @property
    def exit_code(self) -> int:
        """0 where nothing differs, 4 where something does, 1 where nothing could be compared but films."""
        return DIFFERS if self.total["differs"] else SAME if self.agreed else FAILED


@dataclass(frozen=True)
class Replay:
    """What a replay came to; `other` names what may change last bits and is not as it was."""

    folder: Path
    level: int
    audit: checks.Audit
    tally: Tally
    other: dict[str, tuple[str, str]]

    @property
    def broken(self) -> bool:
        """Whether the journal is not what was written: nothing is compared then."""
        return checks.exit_code(self.audit) == BROKEN

    @property
    def exit_code(self) -> int:
        """That of verify at level 1 and for a broken chain, else that of the comparisons."""
        return checks.exit_code(self.audit) if self.level == 1 or self.broken else self.tally.exit_code

    def document(self) -> Document:
        """As one object for machines."""
        total, first = self.tally.total, self.tally.first(SHOWN)
        return {
            "command": "audit replay",
            "folder": str(self.folder),
            "level": self.level,
            "exit": self.exit_code,
            "chain": {"records": self.audit.mark.records, "root": self.audit.mark.root},
            "findings": [asdict(one) for one in self.audit.findings],
            "counts": {verdict: total[verdict] for verdict in VERDICTS},
            "compared": {what: dict(of_it) for what, of_it in sorted(self.tally.counts.items())},
            "reasons": {what: dict(of_it.most_common(SHOWN)) for what, of_it in sorted(self.tally.whys.items())},
            "first_difference": _plain(first[0]) if first else None,
            "differences": [_plain(one) for one in first],
            "environment": {name: {"logged": then, "now": now} for name, (then, now) in self.other.items()},
            "z": {what: scores.summary(z) for what, z in sorted(self.tally.z.items())},
        }


def verified(folder: Path, level: int, look: Callable[[Compared], object] = lambda _: None) -> Replay:
    """A replay after its level 1. Raises InputError where there is no journal."""
    audit = checks.verify(folder, None, None)
    other: dict[str, tuple[str, str]] = {}
    for facts in () if checks.exit_code(audit) == BROKEN else facts_of(RunJournal(folder)):
        other |= other_bits(facts)
    return Replay(folder, level, audit, Tally(look=look), other)


def audit_rooms(replay: Replay, same_place: bool = True, **given: Any) -> None:
    """Levels 2 and 3: every auditor of that level looks through the journal. At level 4 it is `given` the workers'
    client too, and whether seeds are to be new; `same_place`: the workers are on this machine."""
    points = [one for one in entry_points(group="luxloop.auditors") if one.name.startswith(f"level{replay.level}.")]
    for point in sorted(points, key=lambda one: one.name):
        auditor: Auditor = point.load()
        same = same_place and not replay.other
        auditor(RunJournal(replay.folder), replay.tally.take, same_machine=same, **given)


def facts_of(journal: RunJournal) -> Iterator[dict[str, str]]:
    """Where each start of a run was made: the controller's facts, and what it lacks from the designer's packages."""
    files = [file for segment in journal.segments for file in segment.opening[1]]
    listed = [data for name, data in files if name == "packages.txt"] or [b""]
    for number, environment in enumerate(journal.starts("environment")):
        lines = listed[min(number, len(listed) - 1)].decode(errors="replace").lower().splitlines()
        packages = dict(line.split("==", 1) for line in lines if "==" in line)
        yield packages | {name: fact for name, fact in environment.items() if fact != "not installed"}


def _plain(one: Compared) -> Document:
    """A comparison as JSON values: what is compared may be of any kind, a reader wants its text."""
    plain = asdict(one)
    return plain | {name: _jsonable(plain[name]) for name in ("logged", "now")}


def _jsonable(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(item) for item in value]
    return value if isinstance(value, str | int | float | bool | None) else str(value)
