"""Outcomes that are kept, and for whom; how long a run lets a worker compute."""

from __future__ import annotations

import pytest

from env_controller.actions import Want
from env_controller.outcomes import OF_BUDGET, RUN_LIMIT_S, Results, run_limit_s
from luxloop import __version__
from luxloop.messages import Lease, Outcome, Pending, Task
from tests.env_controller.test_dispatcher import OTHER, TASK, Desk


def test_a_failure_is_for_those_who_waited_for_it_and_for_a_while() -> None:
    """Each of them once. A campaign's first step failed at once by what somebody had asked an hour ago: the worker
    was there long since, and the walk was no function of its seed."""
    results = Results(1000)
    results.put("a", b"failed", once=["one", "two"], until_s=30.0)
    assert results.get("a", "another", 5.0) is None
    assert results.get("a", "", 5.0) is None  # a run
    assert results.get("a", "one", 5.0) == b"failed"
    assert results.get("a", "one", 6.0) is None
    assert results.get("a", "two", 31.0) is None
    results.put("b", b"failed", once=["one"], until_s=30.0)
    assert results.get("b", "one", 30.0) == b"failed"
    assert results.get("b", "one", 30.0) is None
    results.put("c", b"done")
    assert results.get("c", "anybody", 1e9) == results.get("c") == b"done"


def test_what_is_kept_is_bounded() -> None:
    """What is handed out or put anew counts no more."""
    results = Results(10)
    for number in range(5):
        results.put(f"{number}", b"12345", once=["one"], until_s=9.0)
    assert [results.get(f"{number}", "one") for number in range(5)] == [None, None, None, b"12345", b"12345"]
    results.put("x", b"1234567890")
    assert results.get("x") == b"1234567890"


def test_a_task_that_hangs_ends_in_hours_not_in_a_day() -> None:
    """By the evaluation's own budget; of a film an hour."""

    def limit_s(**inputs: object) -> float:
        return run_limit_s(Task(kind="ray", inputs=dict(inputs), version=__version__))

    assert limit_s() == limit_s(budget_s=600.0) == RUN_LIMIT_S
    assert limit_s(budget_s=1800.0) == OF_BUDGET * 1800.0


def test_a_run_waits_for_a_worker_as_long_as_it_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A failure would be a step on record, which no resume tries again: workers may be away for a night. What a
    client asked for by itself ends after its patience."""
    desk = Desk(monkeypatch)
    impatient = desk.submit(OTHER)
    desk.controller._want(Want("one", TASK))
    desk.wait(1000.0)
    assert isinstance(impatient.message, Outcome | Pending)
    assert desk.status().queued == {"film": 1}
    desk.hello()
    lease = desk.pull().message
    assert isinstance(lease, Lease)
    assert lease.task == TASK
