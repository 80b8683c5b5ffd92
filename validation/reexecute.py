"""Level 4 of a replay of comparisons: the workers are asked the same again, and the fit is made on their answers.

    requests on record ──▶ workers ──▶ digests against those on record
                              └──▶ model file and data as they were compared ──fit──▶ the document that was told

Where packages and processor are those of the record equal bits are demanded; elsewhere, and with a new seed, means of
images and far fields are compared in their standard errors, and of what has none nothing is said. The fit needs the
data where they were, unchanged.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from luxloop import __version__
from luxloop.audit import Compared, Place, Verdict
from luxloop.client import Answer, Client, as_task
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.journal.reader import RunJournal
from luxloop.messages import Task
from luxloop.model import Model
from luxloop.model_file import parse_toml
from luxloop.words import sha256_of
from validation.adding import changed, told_of
from validation.asked import OnRecord, Plain, asked_in, digest
from validation.auditor import same_data
from validation.comparing import Solver, compared
from validation.dataset.folder import read_dataset
from validation.diagnose.document import document as diagnosis_document
from validation.diagnosing import Diagnosing
from validation.effects.known import Known
from validation.observed import Observed
from validation.prediction import Predictor
from validation.redeciding import shots_in_words

LIMIT_S = 86_400.0
LANES = 4
AGREES = 4.0
"""Standard errors, beyond which two runs of the same thing differ."""
ROUNDING = 1e-6
"""Of an array's rms: how far the mean of what has no noise may be off on another processor."""
ROUNDS = "other packages or another processor round otherwise"
NO_REQUESTS = "the journal names its requests by their ids only"
PARTS = (
    "verdict", "sentence", "set", "trusted", "reason", "structure", "shots", "regions", "fourier", "parameters",
    "effects", "scores", "added", "candidates", "before", "after", "errors", "fitted", "diff", "after_sha256",
)  # fmt: skip
"""Of a document: what commands find, without where they found it."""


def re_execute(
    journal: RunJournal,
    say: Callable[[Compared], None],
    *,
    same_machine: bool,
    client: Client,
    new_seed: bool = False,
) -> None:
    """Has every request on record answered once more and compares; then fits once more and compares what is told.

    Raises RemoteError where no worker can be had.
    """
    asked = asked_in(journal)
    if not asked:
        Place(say).nothing("request", NO_REQUESTS)
        return
    again = Again(client, say, same_machine and not new_seed, new_seed)
    answers = FromAnswers(again.all(asked), again.failures)
    if not new_seed:
        for entry in journal.records("/validation"):
            if entry.value.command in FITS:
                step = entry.value
                at = Place(say, entry.sequence, f"{step.command} of {step.dataset_sha256[:12]}")
                fitted(journal, step, answers, at)


@dataclass(frozen=True)
class Again:
    """Asks the workers what they were asked."""

    client: Client
    say: Callable[[Compared], None]
    same_bits: bool
    new_seed: bool
    failures: dict[str, RemoteError] = field(default_factory=dict)
    """What a worker refused, by the ids on record: in a diagnosis effects that its samples cannot have."""

    def all(self, asked: Sequence[OnRecord]) -> dict[str, Answer]:
        """The answers by the ids on record: tables of films first, for others need them."""
        found: dict[str, Answer] = {}
        tables: dict[str, Mapping[str, Any]] = {}
        for one in asked:
            if one.answer.get("table_sha256"):
                answer = self._answer(one, one.task)
                if answer is not None:
                    found[one.task_id] = answer
                    tables[one.answer["table_sha256"]] = answer.result
        rest = [one for one in asked if one.task_id not in found and not one.answer.get("table_sha256")]
        with ThreadPoolExecutor(LANES, thread_name_prefix="replay") as pool:
            answers = pool.map(lambda one: self._answer(one, self._task(one, tables)), rest)
            found |= {one.task_id: answer for one, answer in zip(rest, answers, strict=True) if answer is not None}
        return found

    def _task(self, one: OnRecord, tables: Mapping[str, Mapping[str, Any]]) -> Task:
        """The task of today: with the tables as they came, and with other seeds where these are wanted."""
        inputs = with_tables(one.task.inputs, tables)
        if self.new_seed:
            inputs = with_seed(inputs, str(int(sha256_of({"new seed of": one.task_id})[:15], 16)))
        return Task(kind=one.task.kind, inputs=inputs, version=__version__)

    def _answer(self, one: OnRecord, task: Task) -> Answer | None:
        at = Place(self.say, one.sequence, f"request {one.task_id[:12]}")
        try:
            answer = self.client.run(task, limit_s=LIMIT_S, fresh=True)
        except RemoteError as error:
            if error.failure.code not in ("bad_input", "crashed"):
                raise
            self.failures[one.task_id] = error
            at.nothing("answer", f"the {task.kind} worker says: {error.failure.text()}"[:300])
            return None
        same_seed = not self.new_seed or task.inputs == one.task.inputs
        now = digest(answer.result, answer.arrays)
        same_answer(one.answer, now, at, same_bits=self.same_bits, same_seed=same_seed)
        return answer


def same_answer(
    logged: Mapping[str, Any], now: Mapping[str, Any], at: Place, *, same_bits: bool, same_seed: bool
) -> None:
    """Compares two digests of an answer: by bits, or by means in their standard errors."""
    if not logged:
        at.nothing("answer", "it had failed, or was not waited for")
        return
    if same_bits or (same_seed and logged["arrays"] == now["arrays"]):
        at.exact("answer", logged["result_sha256"], now["result_sha256"], "SHA-256 of its document")
        for name, one in logged["arrays"].items():
            at.exact("array", one["sha256"], now["arrays"].get(name, {}).get("sha256"), f"SHA-256 of {name}")
        return
    for name, one in logged["arrays"].items():
        _same_mean(name, one, now["arrays"].get(name, {}), at, same_seed)


def _same_mean(name: str, one: Mapping[str, Any], other: Mapping[str, Any], at: Place, same_seed: bool) -> None:
    """Compares the means of an array in their standard errors; one without errors may be off by rounding."""
    why = f"{name}: {ROUNDS if same_seed else 'a new seed, so noise'}"
    errors = [each.get("error_of_mean", 0.0) for each in (one, other)]
    if all(errors):
        z = (other["mean"] - one["mean"]) / (errors[0] ** 2 + errors[1] ** 2) ** 0.5
        then, again = (f"{each['mean']:.6g} +- {each['error_of_mean']:.2g}" for each in (one, other))
        verdict: Verdict = "within tolerance" if abs(z) <= AGREES else "differs"
        at.scored("mean of array", verdict, then, again, why, z)
    elif same_seed and "mean" in one and abs(other.get("mean", np.inf) - one["mean"]) <= ROUNDING * one["rms"]:
        at.near("mean of array", one["mean"], other["mean"], ROUNDING * one["rms"], why)
    else:
        at.nothing("array", f"{why}, and it has no standard error")


@dataclass(frozen=True)
class FromAnswers:
    """Answers what was answered; what was never asked it does not know."""

    answers: Mapping[str, Answer]
    failures: Mapping[str, RemoteError] = field(default_factory=dict)

    def run(self, request: Any, *, fresh: bool = False) -> Answer:
        """The answer; RemoteError for another request than those on record."""
        del fresh
        task = as_task(request)
        if task.id in self.failures:
            raise self.failures[task.id]
        if task.id not in self.answers:
            raise RemoteError(Failure(code="refused", message=f"request {task.id[:12]} is not on record"))
        return self.answers[task.id]

    def map(self, requests: Sequence[Any], **_: Any) -> Iterator[tuple[int, Answer | RemoteError]]:
        """As `Client.map`, one after the other."""
        for number, request in enumerate(requests):
            yield number, self.run(request)


def fitted(journal: RunJournal, step: Any, answers: FromAnswers, at: Place) -> None:
    """Compares the document of a command with that of the same fits on the answers of today."""
    document = step.document
    if not same_data(document, step.dataset_sha256, at):
        return
    try:
        model = parse_toml(journal.attachments()["model.toml"].decode(), "model.toml")
        found = FITS[step.command](step, model, answers)
    except (InputError, KeyError, RemoteError) as error:
        at.nothing("the fit anew", f"{error}"[:300])
        return
    now = json.loads(json.dumps(found))  # as the journal has it
    for part in [part for part in PARTS if part in document and part in now]:
        at.exact(f"the fit anew, {part}", document[part], _told_then(document[part], now[part]))


def _told_then(old: Any, now: Any) -> Any:
    """What is told now, without what documents have been given since the old one was written."""
    if isinstance(old, dict) and isinstance(now, dict):
        return {name: _told_then(old[name], value) for name, value in now.items() if name in old}
    if isinstance(old, list) and isinstance(now, list) and len(old) == len(now):
        return [_told_then(*pair) for pair in zip(old, now, strict=True)]
    return now


def compared_again(step: Any, model: Model, answers: FromAnswers) -> Plain:
    """The document of a comparison."""
    observed, solver = _asked(step)
    found = compared(model, observed, Predictor(answers), solver).document()
    return found | {"sentence": shots_in_words(found, step.document["sentence"])}


def diagnosed_again(step: Any, model: Model, answers: FromAnswers) -> Plain:
    """The document of a diagnosis."""
    engine = _engine(step, model, answers)
    return diagnosis_document(engine.diagnosed(), engine.solver.seed)


def changed_again(step: Any, model: Model, answers: FromAnswers) -> Plain:
    """The document of an effect that was added, or removed: the errors of the ladder among it."""
    return told_of(model, *changed(_engine(step, model, answers), step.command, step.document["effect"]))


FITS: dict[str, Callable[[Any, Model, FromAnswers], Plain]] = {
    "compare": compared_again, "where": compared_again, "diagnose": diagnosed_again, "add": changed_again,
    "remove": changed_again,
}  # fmt: skip
"""What does the work of a command once more."""


def _engine(step: Any, model: Model, answers: FromAnswers) -> Diagnosing:
    observed, solver = _asked(step)
    told = step.document
    return Diagnosing(
        model,
        observed,
        Predictor(answers),
        Known.ask(answers),
        solver,
        tuple(told["free"]),
        among=tuple(told["among"]),
    )


def _asked(step: Any) -> tuple[Observed, Solver]:
    """The data and the solver that a command was asked to use."""
    of, told = step.document["dataset"], step.document["solver"]
    observed = Observed.of(read_dataset(Path(of["path"])), of.get("pixel_um"), of.get("film"))
    return observed, Solver(told["histories"], told["seed"], told.get("most_histories", 0))


def with_tables(inputs: Any, tables: Mapping[str, Mapping[str, Any]]) -> Any:
    """The inputs of a task with each film's table replaced by the one that came now."""
    if isinstance(inputs, list):
        return [with_tables(one, tables) for one in inputs]
    if not isinstance(inputs, dict):
        return inputs
    if inputs.keys() == {"sha256", "bytes"} and inputs["sha256"] in tables:
        now = tables[inputs["sha256"]]
        return {"sha256": now["table_sha256"], "bytes": now["table_bytes"]}
    return {name: with_tables(one, tables) for name, one in inputs.items()}


def with_seed(inputs: Mapping[str, Any], seed: str) -> dict[str, Any]:
    """The inputs with another seed of Monte Carlo: of an anchor, or of a simulation; the twin has none."""
    found = dict(inputs)
    if found.get("anchor") and found["anchor"]["histories"]:
        found["anchor"] = {**found["anchor"], "seed": seed}
    return found | ({"seed": seed} if "seed" in found else {})
