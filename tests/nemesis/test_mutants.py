"""The checker finds each of three mutants, and nothing where the same happens to the product."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import pytest

from tests.conftest import wait_for
from tests.nemesis.checker import Broken, check_history
from tests.nemesis.history import Seen
from tests.nemesis.lab import Lab

pytestmark = pytest.mark.slow
EVALUATIONS = 2000  # far more than a scenario lasts
QUIET_S = 6.0


def invariants(broken: list[Broken]) -> set[str]:
    """Which of them."""
    return {one.invariant for one in broken}


def computing(history: list[Seen]) -> list[Seen]:
    """The computations that are under way, the oldest first."""
    under_way: dict[tuple[int, str], Seen] = {}
    for seen in history:
        if seen["what"] == "computes":
            under_way[seen["pid"], seen["inputs"]] = seen
        elif seen["what"] == "computed":
            under_way.pop((seen["pid"], seen["inputs"]), None)
    return list(under_way.values())


def walking(lab: Lab, steps: int, lanes: int = 4) -> None:
    """A campaign of random designs under way, so many steps of which have been told."""
    lab.begin("run", "random", EVALUATIONS, lanes)
    wait_for(lambda: lab.told() >= steps, f"{steps} steps; see {lab.folder}/logs", 60.0)


@pytest.mark.parametrize("mutant", ["-", "acknowledge-before-fsync"])
def test_acknowledged_before_it_is_on_the_disk(tmp_path: Path, mutant: str) -> None:
    """The controller is killed as soon as one more step has been told."""
    with Lab(tmp_path, mutant=mutant) as lab:
        walking(lab, 8)
        before = lab.told()
        wait_for(lambda: lab.told() > before, "one more step")
        lab.kill("controller")
        wait_for(lambda: any(seen["what"] == "on record" for seen in lab.history.read()), "the controller's restart")
        broken = check_history(lab.history.read())
    assert invariants(broken) == (set() if mutant == "-" else {"what was told is on record"})


@pytest.mark.parametrize("mutant", ["-", "no-requeue"])
def test_a_lost_workers_task_is_not_queued_again(tmp_path: Path, mutant: str) -> None:
    """A ray worker is killed while it computes; the other one, and the next, have nothing to do."""
    with Lab(tmp_path, mutant=mutant, nap_s=0.4) as lab:
        walking(lab, 4)
        ray = lab.processes["ray-1"].pid
        wait_for(lambda: any(seen["pid"] == ray for seen in computing(lab.history.read())), "a computation")
        lab.kill("ray-1")
        time.sleep(QUIET_S + 2.0)
        lab.history.note("looked")
        broken = check_history(lab.history.read(), quiet_s=QUIET_S)
    assert invariants(broken) == (set() if mutant == "-" else {"an accepted task ends"})


@pytest.mark.parametrize("mutant", ["-", "no-fencing"])
def test_a_late_answer_of_a_lost_attempt(tmp_path: Path, mutant: str) -> None:
    """A worker is stopped in its attempt, which will be a lie; it delivers while a second attempt is under way."""
    with Lab(tmp_path, mutant=mutant) as lab:
        walking(lab, 4, lanes=1)
        lab.order("ray", json.dumps({"nap_s": 1.0, "lie": True}))
        lab.order("ray", json.dumps({"nap_s": 15.0}))
        liar = wait_for_liar(lab)
        name = next(name for name in ("ray-1", "ray-2") if lab.processes[name].pid == liar["pid"])
        lab.signal(name, signal.SIGSTOP)
        stopped_s = time.monotonic()
        wait_for(lambda: second_attempt(lab, liar), "the second attempt", 20.0)
        # that may be a hedge, and the first lease stand still: until its worker was silent for too long
        time.sleep(max(0.0, stopped_s + lab.settings.silence_s + 1.5 - time.monotonic()))
        lab.signal(name, signal.SIGCONT)
        wait_for(lambda: delivered(lab, 1), "the late answer", 10.0)
        time.sleep(1.0)  # what comes of it is noted a moment later
        broken = check_history(lab.history.read())
        late = [seen for seen in lab.history.read() if seen["what"] == "delivered" and not seen["stood"]]
    assert invariants(broken) == (set() if mutant == "-" else {"nothing old enters"})
    assert [seen["taken"] for seen in late] == [mutant != "-"]


def wait_for_liar(lab: Lab) -> Seen:
    """The computation that will be a lie, once it is under way."""
    wait_for(lambda: any(seen["lie"] for seen in computing(lab.history.read())), "the lie")
    return next(seen for seen in computing(lab.history.read()) if seen["lie"])


def second_attempt(lab: Lab, first: Seen) -> bool:
    """Whether another process computes the same."""
    return any(
        seen["inputs"] == first["inputs"] and seen["pid"] != first["pid"] for seen in computing(lab.history.read())
    )


def delivered(lab: Lab, count: int) -> bool:
    """Whether so many results came of whoever did not hold the task any longer."""
    late = [seen for seen in lab.history.read() if seen["what"] == "delivered" and not seen["stood"]]
    return len(late) >= count
