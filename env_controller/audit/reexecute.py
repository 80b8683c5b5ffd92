"""Level 4: logged requests go to the workers once more, with their logged seeds; are the answers the same?

    /request/film ─▶ worker ─▶ its table ─▶ /request/ray ─▶ worker ─▶ document and arrays against the /reply on record

Where packages and processor are those of the record, equal bits are demanded. Elsewhere, and with a new seed, the
numbers are compared in their standard errors.
"""

from __future__ import annotations

import os
import platform
import random
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env_controller.audit.rederive import first_leaves
from env_controller.audit.scores import AGREES, AGREES_PIXEL, z_of
from luxloop import __version__
from luxloop.audit import Compared, Place, Verdict
from luxloop.bus import Interrupt
from luxloop.campaign import LIMIT_S, Step
from luxloop.client import Answer, Client
from luxloop.endpoint import listening
from luxloop.errors import LuxloopError, RemoteError
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import ReplyRecord, RequestRecord
from luxloop.messages import Task
from luxloop.process import usable_cores
from luxloop.settings import Settings
from luxloop.words import sha256_of

SMALL_RUN = 200  # evaluations; of larger runs a sample is taken
SAMPLE = 0.02
PATIENCE_S = 300.0  # a worker that starts for the first time compiles its kernels
OF_FIGURES = ("uniformity", "mean_illuminance_lx", "optical_efficiency")
CHANCE = {"known"}  # of a film's answer: whether its worker had it in its database
LOST = "its request, or a reply with a result, is not on record"
ROUNDS = "other packages or another processor round otherwise"
WORST, DRAWN = "worst pixel", "one pixel of each map"
Say = Callable[[Compared], None]


@dataclass(frozen=True)
class Choice:
    """Which evaluations are done again: all, a share of them, or the best one's; with new seeds or the logged."""

    share: float | None = None
    best: bool = False
    new_seed: bool = False


@dataclass(frozen=True)
class Question:
    """An evaluation on record: its request, the reply, its map if there is one."""

    step: Step
    sequence: int
    request: RequestRecord
    reply: ReplyRecord
    map_lx: NDArray[np.float32] | None

    def place(self, say: Say) -> Place:
        """Where a comparison is made."""
        return Place.of(say, self.sequence, self.step)


@dataclass(frozen=True)
class Record:
    """The chosen evaluations in the order of the journal, and the films they need by the hash of their table.

    `lost`: steps whose request or reply is not on record, with their place in the journal.
    """

    questions: list[Question]
    films: dict[str, tuple[RequestRecord, ReplyRecord]]
    lost: list[tuple[int, Step]]


def re_execute(
    record: Record, settings: Settings, say: Say, *, same_machine: bool, new_seed: bool = False, local: bool = True
) -> None:
    """Has the chosen evaluations done again and compares them, the films first.

    Where no set runs at `settings.router` and `local` allows it, one is started whose caches are empty. Raises
    RemoteError where no worker can be had.
    """
    for sequence, step in record.lost:
        Place.of(say, sequence, step).nothing("result", LOST)
    if not record.questions:
        if not record.lost:
            Place(say).nothing("result", "nothing was evaluated")
        return
    with fresh_client(settings, local=local) as client:
        workers, here = client.status().workers, at_home(client)
        asked = Asked(client, say, same_machine and here, new_seed)
        tables = {sha: asked.film(*film) for sha, film in record.films.items()}
        lanes = max(2, 2 * sum(worker.describe.kind == "ray" for worker in workers), 2 * usable_cores())
        asked.rays(record.questions, tables, lanes)


def chosen(journal: RunJournal, choice: Choice) -> Record:
    """What is to be done again. The sample is drawn by the chain's root, so it is the same every time."""
    steps: dict[str, tuple[int, Step]] = {}
    for entry in journal.records("/step"):
        step: Step = entry.value
        if step.task_id and step.failure is None:
            steps.setdefault(step.task_id, (entry.sequence, step))
    if not steps:
        return Record([], {}, [])
    wanted = _wanted(steps, choice, str(journal.last("/chain", 1)[-1].value.root))
    return _read(journal, {task: steps[task] for task in wanted})


def _wanted(steps: Mapping[str, tuple[int, Step]], choice: Choice, root: str) -> list[str]:
    """The ids of the tasks to be done again."""
    if choice.best:
        best = {"best": 2, "finalist": 1}
        return [max(steps, key=lambda task: (best.get(steps[task][1].role or "", 0), steps[task][1].uniformity))]
    share = choice.share if choice.share is not None else 1.0 if len(steps) <= SMALL_RUN else SAMPLE
    count = max(1, round(share * len(steps)))
    return random.Random(root).sample(list(steps), count) if count < len(steps) else list(steps)


def _read(journal: RunJournal, steps: Mapping[str, tuple[int, Step]]) -> Record:
    """Requests, replies and maps of some steps, and the films on record."""
    sequences = {sequence for sequence, _ in steps.values()}
    maps: dict[int, NDArray[np.float32]] = {}
    requests: dict[str, RequestRecord] = {}
    replies: dict[str, ReplyRecord] = {}
    for entry in journal.records("/request/film", "/reply/film", "/request/ray", "/reply/ray", "/map/sim"):
        if entry.topic == "/map/sim":
            if entry.sequence in sequences:
                maps[entry.sequence] = entry.value
        elif entry.topic.endswith("film") or entry.value.task_id in steps:
            held = requests if entry.topic.startswith("/request/") else replies
            held[entry.value.task_id] = entry.value
    found = [
        Question(step, sequence, requests[task], replies[task], maps.get(sequence))
        for task, (sequence, step) in steps.items()
        if task in requests and task in replies and replies[task].result is not None
    ]
    needed = {question.request.inputs["film"]["sha256"] for question in found if question.request.inputs["film"]}
    films = {
        str(reply.result["table_sha256"]): (requests[task], reply)
        for task, reply in replies.items()
        if reply.kind == "film" and reply.result is not None and task in requests
    }
    lost = sorted({sequence for sequence, _ in steps.values()} - {one.sequence for one in found})
    step_at = dict(steps.values())
    return Record(
        sorted(found, key=lambda one: one.sequence),
        {sha: films[sha] for sha in films if sha in needed},
        [(sequence, step_at[sequence]) for sequence in lost],
    )


@contextmanager
def fresh_client(settings: Settings, *, local: bool) -> Iterator[Client]:
    """Workers to ask, of a running set or of one of our own that finds nothing computed before.

    Raises RemoteError where none can be had.
    """
    with fresh_cache(settings) as used, Client(
        used, local=local, patience_s=PATIENCE_S, ray_workers=usable_cores()
    ) as client:  # fmt: skip
        yield client


def at_home(client: Client) -> bool:
    """Whether all workers run on this host."""
    return all(worker.describe.host == platform.node() for worker in client.status().workers)


@contextmanager
def fresh_cache(settings: Settings) -> Iterator[Settings]:
    """Settings whose workers, where we start them, find nothing but compiled kernels: nothing is answered from
    before. A set that runs already has caches of its own."""
    if listening(settings.router):
        yield settings
        return
    before = os.environ.get("LUXLOOP_KERNELS")
    os.environ["LUXLOOP_KERNELS"] = before or str(settings.cache_dir / "kernels")
    try:
        with tempfile.TemporaryDirectory(prefix="luxloop-audit-") as folder:
            yield settings.model_copy(update={"cache": Path(folder)})
    finally:
        if before is None:
            del os.environ["LUXLOOP_KERNELS"]


@dataclass(frozen=True)
class Asked:
    """Asks the workers and compares their answers. `same_bits`: equal bits are demanded."""

    client: Client
    say: Say
    same_bits: bool
    new_seed: bool

    def film(self, request: RequestRecord, reply: ReplyRecord) -> dict[str, Any] | None:
        """A film's table once more: what a ray request must name; None where no table came."""
        at = Place(self.say, step=f"film {request.task_id[:12]}")
        answer = self._answer("film", request.inputs, at)
        if answer is None:
            return None
        then, now = ({name: one for name, one in result.items() if name not in CHANCE}
                     for result in (reply.result or {}, answer.result))  # fmt: skip
        bits = {name: array_sha256(answer.arrays[name]) for name in reply.arrays if name in answer.arrays}
        if (then, reply.arrays) != (now, bits) and not self.same_bits:
            at.nothing("film", f"{ROUNDS}; what it does to the rays is seen there")
        elif at.exact("film", *first_leaves(then, now)):
            at.exact("film arrays", *first_leaves(reply.arrays, bits))
        return {"sha256": now["table_sha256"], "bytes": now["table_bytes"]}

    def rays(self, questions: list[Question], tables: Mapping[str, dict[str, Any] | None], lanes: int) -> None:
        """All evaluations once more, several at once. Left early, what is under way is let go."""
        left = Interrupt()
        with ThreadPoolExecutor(lanes, thread_name_prefix="replay") as pool:
            futures = [pool.submit(self._ray, question, tables, left) for question in questions]
            try:
                for future in as_completed(futures):
                    future.result()
            finally:
                left.set()
                pool.shutdown(wait=True, cancel_futures=True)

    def _ray(self, question: Question, tables: Mapping[str, dict[str, Any] | None], left: Interrupt) -> None:
        at, inputs = question.place(self.say), dict(question.request.inputs)
        if inputs["film"]:
            table = tables.get(inputs["film"]["sha256"])
            if table is None:
                at.nothing("result", "its film could not be had again")
                return
            inputs["film"] = table
        if self.new_seed:
            inputs |= new_seeds(question.request)
        answer = self._answer("ray", inputs, at, left)
        if answer is not None:
            compare(question, answer, at, same_bits=self.same_bits, new_seed=self.new_seed)

    def _answer(self, kind: str, inputs: dict[str, Any], at: Place, left: Interrupt | None = None) -> Answer | None:
        """A worker's fresh answer; None, and a word on it, where this release cannot be asked that."""
        task = Task(kind=kind, inputs=inputs, version=__version__)
        try:
            return self.client.run(task, limit_s=LIMIT_S, fresh=True, until=left)
        except RemoteError as error:
            if left is not None and left.is_set():
                with suppress(LuxloopError):  # a controller that is not there forgets it by itself
                    self.client.withdraw(task)
            if error.failure.code not in ("bad_input", "crashed"):
                raise
            at.nothing("result", f"the {kind} worker says: {error.failure.text()}"[:300])
            return None


def compare(question: Question, answer: Answer, at: Place, *, same_bits: bool, new_seed: bool) -> None:
    """Documents and arrays bit by bit; where these may differ, figures and pixels in their standard errors."""
    logged, now = question.reply.result or {}, dict(answer.result)
    then, bits = question.reply.arrays, {name: array_sha256(array) for name, array in answer.arrays.items()}
    equal = logged == now and all(bits.get(name) == sha for name, sha in then.items())
    if not new_seed and (same_bits or equal):
        at.exact("result", *first_leaves(logged, now))
        for name, sha in then.items():  # those above 1 MB went by hash and are not on record
            at.exact(f"array {name}", sha, bits.get(name), "SHA-256")
        if question.map_lx is not None:
            at.exact("map on record", array_sha256(question.map_lx), bits.get("map_lx"), "SHA-256")
        return
    why = "a new seed: noise" if new_seed else ROUNDS
    for name in OF_FIGURES:
        _figure(name, logged["metrics"].get(name), now["metrics"].get(name), at, why)
    _pixels(question, answer.arrays, at, why)


def _figure(name: str, logged: Any, now: Any, at: Place, why: str) -> None:
    if logged is None or now is None:
        return
    what = name.removesuffix("_lx").replace("_", " ")
    z = z_of(now["value"], now["standard_error"], logged["value"], logged["standard_error"])
    agrees = z is not None and abs(z) <= AGREES
    then, again = (f"{one['value']:.6g} +- {one['standard_error']:.2g}" for one in (logged, now))
    at.scored(what, "within tolerance" if agrees else "differs", then, again, why, z)


def _pixels(question: Question, now: Mapping[str, NDArray[Any]], at: Place, why: str) -> None:
    """The map on record, with the error of the new one on both sides: the worst pixel, which decides, and one that
    is drawn by the task's id, whose z from map to map show whether the errors are right."""
    logged = question.map_lx
    if logged is None or "map_error_lx" not in now or logged.shape != now["map_lx"].shape:
        at.nothing(WORST, "no map on record" if logged is None else "a map of another size")
        return
    error = np.sqrt(2.0) * np.maximum(now["map_error_lx"].astype(np.float64), np.finfo(np.float64).tiny)
    z = (now["map_lx"].astype(np.float64) - logged) / error
    drawn = int(question.request.task_id[:8], 16) % z.size
    for what, pixel, limit in ((WORST, int(np.argmax(np.abs(z))), AGREES_PIXEL), (DRAWN, drawn, AGREES)):
        place = np.unravel_index(pixel, z.shape)
        verdict: Verdict = "within tolerance" if abs(z[place]) <= limit else "differs"
        then, again = (
            f"{float(one[place]):.6g} lx, row {place[0]}, column {place[1]}" for one in (logged, now["map_lx"])
        )
        at.scored(what, verdict, then, again, why, float(z[place]) if what == DRAWN else None)


def new_seeds(request: RequestRecord) -> dict[str, str]:
    """Seeds that the run did not use: one for each task, of its id."""
    digits = sha256_of({"new seed of": request.task_id})
    return {"seed": str(int(digits[:15], 16)), "exit_seed": str(int(digits[15:30], 16))}


def array_sha256(array: NDArray[Any]) -> str:
    """SHA-256 of an array's raw little-endian bytes, as the journal has it."""
    return sha256(np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes()).hexdigest()
