"""What was asked of the workers, on record: nothing is lost, everything is short, what was altered is found."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.audit import Compared, Place
from luxloop.client import Answer, as_task
from luxloop.film import FilmTableRequest
from luxloop.messages import Task
from luxloop.model import Environment
from luxloop.words import canonical
from tests.validation import analytic as spots
from tests.validation.test_comparing import observed
from validation.asked import COMMAND, MOST_BYTES, Asking, asked_in, digest, shortened, whole
from validation.auditor import decided
from validation.comparing import Solver, compared
from validation.reexecute import Again, same_answer, with_seed, with_tables


class Client:
    """Answers each task by its id; counts."""

    def __init__(self, scale: float = 1.0) -> None:
        self.scale, self.asked = scale, list[Task]()

    def run(self, request: Any, **_: Any) -> Answer:
        """An image whose level is its scale."""
        task = as_task(request)
        self.asked.append(task)
        image = self.scale * np.full((2, 4, 4), 3.0)
        arrays = {"images_per_mm2": image, "noise_per_mm2": np.full((5, 2, 4, 4), 0.01)}
        return Answer({"shots": 2, "known": len(self.asked) > 1}, arrays, "here", 1, 0.0)

    def map(self, requests: Any, **_: Any) -> Iterator[tuple[int, Answer]]:
        """One after the other."""
        for number, request in enumerate(requests):
            yield number, self.run(request)


def requests(count: int) -> list[FilmTableRequest]:
    """Requests that share their environment."""
    return [FilmTableRequest(environment=Environment(), dbr_pairs=0.5 * (1 + number)) for number in range(count)]


def journal_of(asking: Asking) -> Any:
    """A journal with what was asked."""
    entries = [
        SimpleNamespace(value=SimpleNamespace(command=COMMAND, document=document), sequence=7)
        for document in asking.records()
    ]
    return SimpleNamespace(records=lambda _: entries)


def test_a_request_comes_back_whole() -> None:
    """Long parts are kept once; ids of restored tasks are those that were asked."""
    asking = Asking(Client())  # type: ignore[arg-type]
    list(asking.map(requests(20)))
    (document,) = asking.records()
    assert canonical(document).count(b'"n_gan"') == 1
    back = asked_in(journal_of(asking))
    assert [one.task_id for one in back] == list(asking.tasks)
    assert all(one.is_whole and one.answer["arrays"] for one in back)


def test_many_requests_are_several_short_records(monkeypatch: pytest.MonkeyPatch) -> None:
    """None longer than a message may be; parts of an earlier record are not repeated."""
    monkeypatch.setattr("validation.asked.MOST_BYTES", 4_000)
    asking = Asking(Client())  # type: ignore[arg-type]
    list(asking.map(requests(40)))
    documents = list(asking.records())
    assert len(documents) > 3
    assert all(len(canonical(one)) < 10_000 < MOST_BYTES for one in documents)
    names = [name for one in documents for name in one["parts"]]
    assert len(names) == len(set(names))
    assert all(one.is_whole for one in asked_in(journal_of(asking)))


def test_shortening_is_undone() -> None:
    """Of any JSON value, nested ones too."""
    long = {f"parameter_{n}": n / 7.0 for n in range(30)}
    value = {"a": [long, {"b": long, "c": None}], "d": "x" * 500, "e": []}
    parts: dict[str, Any] = {}
    short = shortened(value, parts)
    assert len(canonical(short)) < 700
    assert whole(short, parts) == value


def verdicts(compare: Any) -> dict[str, str]:
    """What a comparison says, by what it is of."""
    told: list[Compared] = []
    compare(Place(told.append))
    return {one.what: one.verdict for one in told}


def test_an_answer_with_other_bits_differs_where_bits_are_demanded() -> None:
    """Elsewhere its mean is held to its standard error; with none of its own, to rounding."""
    one, near, far = (Client(scale).run(requests(1)[0]) for scale in (1.0, 1.001, 1.1))
    logged, close, off = (digest(answer.result, answer.arrays) for answer in (one, near, far))

    def say(now: Any, **how: bool) -> list[tuple[str, str]]:
        told: list[Compared] = []
        same_answer(logged, now, Place(told.append), **how)
        return [(one.what, one.verdict) for one in told]

    bits, same, new = ({"same_bits": one, "same_seed": other} for one, other in ((1, 1), (0, 1), (0, 0)))
    assert {verdict for _, verdict in say(logged, **bits)} == {"identical"}
    assert ("array", "differs") in say(close, **bits)
    assert ("mean of array", "within tolerance") in say(close, **new)
    assert ("mean of array", "differs") in say(off, **same)
    assert ("array", "not comparable") in say(
        digest({}, {"images_per_mm2": 2.0 * one.arrays["images_per_mm2"]}), **new
    )


def test_a_new_seed_changes_monte_carlo_only() -> None:
    """Of an anchor with histories, of a simulation; a twin's request is as it was, and tables are followed."""
    twin = {"shots": [], "anchor": None}
    assert with_seed(twin, "5") == twin
    assert with_seed({"anchor": {"histories": 0, "seed": "1"}}, "5")["anchor"]["seed"] == "1"
    assert with_seed({"anchor": {"histories": 9, "seed": "1"}}, "5")["anchor"]["seed"] == "5"
    assert with_seed({"seed": "1"}, "5") == {"seed": "5"}
    table = {"sha256": "a" * 64, "bytes": 10}
    now = with_tables([{"film": table}], {"a" * 64: {"table_sha256": "b" * 64, "table_bytes": 11}})
    assert now == [{"film": {"sha256": "b" * 64, "bytes": 11}}]


def test_all_requests_are_asked_once_more() -> None:
    """Fresh ones, and answers that are the same say so."""
    asking = Asking(Client())  # type: ignore[arg-type]
    list(asking.map(requests(5)))
    told: list[Compared] = []
    client = Client()
    found = Again(client, told.append, True, False).all(asked_in(journal_of(asking)))  # type: ignore[arg-type]
    assert set(found) == set(asking.tasks)
    assert {one.verdict for one in told} == {"identical"}
    assert len(client.asked) == 5
    other: list[Compared] = []
    Again(Client(1.5), other.append, True, False).all(asked_in(journal_of(asking)))  # type: ignore[arg-type]
    assert {one.verdict for one in other if "images" in one.why} == {"differs"}


def test_a_decision_that_does_not_follow_from_its_numbers_is_found() -> None:
    """The sentence, p in words, trust and orders follow; each that was altered is named."""
    document = compared(spots.MODEL, observed(), spots.Spots(), Solver(None)).document()
    assert set(verdicts(lambda at: decided(document, at)).values()) == {"identical"}

    def altered(change: Any) -> set[str]:
        other, told = copy.deepcopy(document), list[Compared]()
        change(other)
        decided(other, Place(told.append))
        return {one.what for one in told if one.verdict == "differs"}

    first = document["shots"][0]["p"]
    assert altered(lambda one: one["shots"][0].update(p=0.5 if first < 0.01 else 1e-4)) >= {"sentence"}
    assert altered(lambda one: one["structure"].update(p_text="0.9", p=0.02)) >= {"p in words"}
    assert altered(lambda one: one.update(trusted=not one["trusted"])) == {"trusted"}
    assert altered(lambda one: one["regions"].reverse()) == {"regions, the least likely first"}
    assert altered(lambda one: one["structure"].update(statistic=99.0)) == {"families, the largest first"}
    assert altered(lambda one: one["structure"].update(statistic=1e9, pattern=1e9)) == set()  # it has a vote
    assert altered(lambda one: one["structure"].update(place=1e9)) == {"families, the largest first"}

    def older(one: Any) -> None:
        del one["structure"]["place"], one["structure"]["pattern"]
        one["structure"]["statistic"] = 1e9

    assert altered(older) == set()


def test_the_statistic_of_noise_is_what_places_or_patterns_or_families_have() -> None:
    """Regression: of images of noise one in five was told as altered, for a single place had the largest vote."""
    for seed in range(6):
        seen = replace(observed(), images=tuple(spots.two_images(seed)))
        document = compared(spots.TRUTH, seen, spots.Spots(), Solver(None)).document()
        assert set(verdicts(lambda at, of=document: decided(of, at)).values()) == {"identical"}


def test_the_least_error_of_a_calibration_is_found_again() -> None:
    """Eq. 2 over all kinds and reflectances."""
    curves = [
        {"label": "Gaussian 0 deg", "x": [0.93, 0.94], "mse": [3e-5, 2e-5]},
        {"label": "Lambertian", "x": [0.93, 0.94], "mse": [1e-5, 4e-5]},
    ]
    stage = {"name": "single chips", "curves": curves, "best": {"label": "Lambertian", "x": 0.93, "mse": 1e-5}}
    assert verdicts(lambda at: decided({"stages": [stage]}, at)) == {"least MSE, single chips": "identical"}
    stage["best"] = {"label": "Gaussian 0 deg", "x": 0.94, "mse": 2e-5}
    assert verdicts(lambda at: decided({"stages": [stage]}, at)) == {"least MSE, single chips": "differs"}
