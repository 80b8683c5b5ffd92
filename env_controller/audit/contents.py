"""What a segment, or a whole run, holds: counts, sizes, times, the most uniform step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from luxloop.campaign import Step
from luxloop.journal.chain import Mark
from luxloop.journal.scan import Scan
from luxloop.journal.topics import CHAIN, Record
from luxloop.words import sha256_of

FIGURES = {"lane", "number", "design", "uniformity", "uniformity_error", "reward", "task_id"}
NEVER_NS = 1 << 63


@dataclass
class Contents:
    """Records by topic, from when to when (Unix time), how far the chain has come, the best step by `final`."""

    path: Path
    size_bytes: int = 0
    finished: bool = False
    topics: Counter[str] = field(default_factory=Counter)
    mark: Mark = field(default_factory=Mark)
    first_ns: int = NEVER_NS
    last_ns: int = 0
    best: dict[bool, Step] = field(default_factory=dict)
    told: dict[tuple[int, int, str], str] = field(default_factory=dict)

    @property
    def content(self) -> str:
        """SHA-256 over what was decided and found, lane by lane, without times, workers and ways.

        An interrupted and resumed run has the same as one that was never disturbed.
        """
        return sha256_of([[*key, digest] for key, digest in sorted(self.told.items())])

    def read(self) -> Contents:
        """Itself, after the segment was read from its beginning: a finished one, a broken one, one that grows."""
        scan = Scan(self.path)
        for commit in scan:
            self.mark = commit.mark
            self.topics[CHAIN] += 1
            for link in commit.links:
                if isinstance(link, Record):
                    self._take(link)
        self.size_bytes, self.finished = scan.read_bytes + scan.left_bytes, scan.finished
        return self

    def all_of(self, parts: Iterable[Contents]) -> Contents:
        """Itself, with what the parts hold, in their order."""
        for part in parts:
            self.size_bytes += part.size_bytes
            self.topics += part.topics
            self.mark = part.mark if part.mark.records else self.mark
            self.first_ns, self.last_ns = min(self.first_ns, part.first_ns), max(self.last_ns, part.last_ns)
            self.told |= part.told
            for step in part.best.values():
                self._look(step)
        return self

    def figures(self, final: bool) -> dict[str, Any] | None:
        """The best step of the walk, or of the finalists."""
        step = self.best.get(final)
        return step.model_dump(mode="json", include=FIGURES) if step else None

    def as_object(self) -> dict[str, Any]:
        """What is said of a segment."""
        facts = {"file": self.path.name, "size_bytes": self.size_bytes, "finished": self.finished}
        return facts | {"records": self.topics.total()}

    def _take(self, entry: Record) -> None:
        self.topics[entry.topic] += 1
        self.first_ns, self.last_ns = min(self.first_ns, entry.log_time_ns), max(self.last_ns, entry.log_time_ns)
        if entry.topic == "/step":
            step = entry.value
            self.told[step.lane, step.number, "step"] = sha256_of(step.content())
            self._look(step)
        elif entry.topic == "/agent":
            agent = entry.value
            self.told[agent.lane, agent.number, "agent"] = sha256_of(agent.model_dump(mode="json", exclude={"run"}))

    def _look(self, step: Step) -> None:
        best = self.best.get(step.final)
        if step.final and step.role not in ("finalist", "best"):
            return
        if step.role == "best":  # the best finalist once more: the number that is reported
            best = None
        elif best is not None and best.role == "best":
            return
        if step.feasible and step.failure is None and (best is None or step.uniformity > best.uniformity):
            self.best[step.final] = step
