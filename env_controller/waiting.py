"""Tasks of one kind that wait for a worker: whose turn it is. Pure."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator

from luxloop.messages import Task
from luxloop.words import sha256_of

LOOK_AHEAD = 8  # tasks of a share among which one of the worker's last group is preferred


def group_of(task: Task) -> str:
    """What a worker computes once for all tasks of a group: the Monte Carlo of a prediction's anchor; "": nothing."""
    anchor = task.inputs.get("anchor")
    if not isinstance(anchor, dict) or not anchor.get("histories"):
        return ""
    exits = [task.inputs.get(name) for name in ("exit_histories", "exit_seed")]
    return sha256_of([anchor, exits, anchor.get("shots") or task.inputs.get("shots")])


class Queue:
    """Three lines: what comes back from a worker, then the shares in turn, then what is only wanted ahead of time.

    A share is whoever wants tasks, a campaign or a client: two campaigns get task for task, however many each has
    waiting. Within a share the oldest goes first, but a task of the `group` (a film, an anchor) that the worker had
    last may overtake up to `LOOK_AHEAD` - 1 others, and as often is the oldest overtaken at most.
    """

    def __init__(self) -> None:
        self._again: OrderedDict[str, str] = OrderedDict()  # task -> group, the one that came back last is first
        self._shares: OrderedDict[str, OrderedDict[str, str]] = OrderedDict()
        self._ahead: OrderedDict[str, str] = OrderedDict()
        self._line: dict[str, OrderedDict[str, str]] = {}  # task -> where it waits
        self._overtaken: dict[str, int] = {}  # task -> how often, while it was the oldest of its share

    def add(self, task_id: str, share: str, group: str, *, ahead: bool = False, again: bool = False) -> None:
        """A new task at the end of its share's line; one that comes back (`again`) before all others."""
        line = self._again if again else self._ahead if ahead else self._shares.setdefault(share, OrderedDict())
        line[task_id] = group
        if again:
            line.move_to_end(task_id, last=False)
        self._line[task_id] = line

    def take(self, group: str = "", may: Callable[[str], bool] = lambda _: True) -> str | None:
        """The task whose turn it is, for a worker that had `group` last; None where there is none for it.

        `may` says of a task that came back whether that worker may have it.
        """
        task_id = next(filter(may, self._again), None)
        if task_id is None:
            task_id = self._next_new(group) if self._shares else next(iter(self._ahead), None)
        if task_id is not None:
            self.discard(task_id)
        return task_id

    def _next_new(self, group: str) -> str:
        """Of the share whose turn it is."""
        share, line = next(iter(self._shares.items()))
        self._shares.move_to_end(share)
        oldest = next(iter(line))
        past = self._overtaken.get(oldest, 0)
        ahead = range(LOOK_AHEAD if group and past < LOOK_AHEAD - 1 else 0)
        alike = (task for _, (task, own) in zip(ahead, line.items(), strict=False) if own == group)
        task_id = next(alike, oldest)
        if task_id != oldest:
            self._overtaken[oldest] = past + 1
        return task_id

    def discard(self, task_id: str) -> None:
        """Take a task out of its line; nothing happens where it does not wait."""
        line = self._line.pop(task_id, None)
        self._overtaken.pop(task_id, None)
        if line is None:
            return
        del line[task_id]
        for share in [share for share, waiting in self._shares.items() if not waiting]:
            del self._shares[share]

    def __contains__(self, task_id: object) -> bool:
        return task_id in self._line

    def __iter__(self) -> Iterator[str]:
        yield from list(self._line)

    def __len__(self) -> int:
        return len(self._line)
