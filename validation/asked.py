"""What a command of this room asked of the workers, for the record: every request, and the digest of its answer.

    client --requests--> Asking --> /validation records of command `asked`: parts, requests, digests of answers

Requests repeat themselves: six images of one model name its environment six times, and so does the next step of a
fit. What is long and comes again is kept once, by its hash, in `parts`. Answers are kept as SHA-256 of each array,
with mean and rms, and the standard error of the mean where there is one: enough to say whether they come again.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

from luxloop.client import Client, as_task
from luxloop.errors import RemoteError
from luxloop.messages import Task
from luxloop.words import canonical

if TYPE_CHECKING:
    from luxloop.bus.frame import Array
    from luxloop.client import Answer
    from luxloop.journal.reader import RunJournal

Plain = dict[str, Any]

COMMAND = "asked"
"""Of the records that hold requests."""
MOST_BYTES = 400_000
"""Of one record: a message of the bus has room for twice as much."""
LONG = 200
"""Characters of JSON from which a part of a request is kept once for all."""
PART = "$"
CHANCE = ("known",)
"""Of a film's answer: whether its worker had it in its database."""
ERRORS = {"images_per_mm2": "noise_per_mm2", "far_module_per_sr": "far_module_error_per_sr"}
"""Where an array's error is."""


@dataclass
class Asking:
    """A client that remembers what it asked, and digests of what it heard. Thread-safe."""

    client: Client
    tasks: dict[str, Task] = field(default_factory=dict)
    heard: dict[str, Plain] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def map(self, requests: Sequence[Any], **options: Any) -> Iterator[tuple[int, Answer | RemoteError]]:
        """As `Client.map`."""
        tasks = [as_task(request) for request in requests]
        for number, answer in self.client.map(tasks, **options):
            self._note(tasks[number], answer)
            yield number, answer

    def run(self, request: Any, **options: Any) -> Answer:
        """As `Client.run`."""
        task = as_task(request)
        answer = self.client.run(task, **options)
        self._note(task, answer)
        return answer

    def records(self) -> Iterator[Plain]:
        """Documents for the journal, each short enough for a message: `parts` by hash, and `requests`."""
        parts: Plain = {}
        rows: list[Plain] = []
        size, known = 0, set[str]()
        for name, task in self.tasks.items():
            new: Plain = {}
            short = shortened(task.inputs, new)
            new = {key: part for key, part in new.items() if key not in known}
            row = {
                "task_id": name, "kind": task.kind, "version": task.version, "inputs": short,
                "answer": self.heard.get(name, {}),
            }  # fmt: skip
            long = len(canonical(row)) + len(canonical(new))
            if rows and size + long > MOST_BYTES:
                yield {"parts": parts, "requests": rows}
                parts, rows, size = {}, [], 0
            known |= new.keys()
            parts, size = parts | new, size + long
            rows.append(row)
        if rows:
            yield {"parts": parts, "requests": rows}

    def _note(self, task: Task, answer: Answer | RemoteError) -> None:
        with self._lock:
            self.tasks.setdefault(task.id, task)
            if not isinstance(answer, RemoteError):
                self.heard.setdefault(task.id, digest(answer.result, answer.arrays))


@dataclass(frozen=True)
class OnRecord:
    """A request on record, and the digest of its answer; empty where it had none."""

    task: Task
    answer: Plain
    task_id: str
    sequence: int

    @property
    def is_whole(self) -> bool:
        """Whether the request is what its id says."""
        return self.task.id == self.task_id


def asked_in(journal: RunJournal) -> list[OnRecord]:
    """The requests of a run in the order of their answers; none where it names ids only."""
    parts: Plain = {}
    found = []
    for entry in journal.records("/validation"):
        if entry.value.command != COMMAND:
            continue
        document = entry.value.document
        parts |= document["parts"]
        for row in document["requests"]:
            task = Task(kind=row["kind"], inputs=whole(row["inputs"], parts), version=row["version"])
            found.append(OnRecord(task, row["answer"], row["task_id"], entry.sequence))
    return found


def shortened(value: Any, parts: Plain) -> Any:
    """The value with its long dicts replaced by {"$": hash}, which go to `parts`."""
    if isinstance(value, list | tuple):
        return [shortened(one, parts) for one in value]
    if not isinstance(value, dict):
        return value
    short = {key: shortened(one, parts) for key, one in value.items()}
    text = canonical(short)
    if len(text) < LONG:
        return short
    name = sha256(text).hexdigest()[:16]
    parts[name] = short
    return {PART: name}


def whole(value: Any, parts: Mapping[str, Any]) -> Any:
    """The value as it was before `shortened`; KeyError where a part is missing."""
    if isinstance(value, list):
        return [whole(one, parts) for one in value]
    if not isinstance(value, dict):
        return value
    if value.keys() == {PART}:
        return whole(parts[value[PART]], parts)
    return {key: whole(one, parts) for key, one in value.items()}


def digest(result: Mapping[str, Any], arrays: Mapping[str, Array]) -> Plain:
    """Of an answer: the SHA-256 of its document and of each array, with the arrays' sizes in numbers."""
    kept = {name: one for name, one in result.items() if name not in CHANCE}
    return {
        "result_sha256": sha256(canonical(json.loads(json.dumps(kept)))).hexdigest(),
        "table_sha256": result.get("table_sha256", ""),
        "arrays": {name: _of_array(name, arrays) for name in arrays},
    }


def _of_array(name: str, arrays: Mapping[str, Array]) -> Plain:
    array = np.asarray(arrays[name])
    little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    found: Plain = {"sha256": sha256(little.tobytes()).hexdigest()}
    if array.size and array.dtype.kind == "f" and np.isfinite(array).all():
        real = array.astype(np.float64)
        found |= {"mean": float(real.mean()), "rms": float(np.sqrt(np.mean(real**2)))}
        error = arrays.get(ERRORS.get(name, ""))
        if error is not None and np.size(error):
            found["error_of_mean"] = _error_of_mean(name, np.asarray(error, np.float64))
    return found


def _error_of_mean(name: str, error: Any) -> float:
    """Standard error of an array's mean; of a far field an upper limit, as if all directions erred together."""
    if name == "images_per_mm2":  # (function, shot, row, column): functions are independent, and so are samples
        of_shots = error.mean(axis=(-2, -1))
        return float(np.sqrt((of_shots**2).sum(axis=0)).mean())
    return float(error.mean())
