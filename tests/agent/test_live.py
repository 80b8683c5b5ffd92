"""What a person sees while a campaign runs."""

from __future__ import annotations

import io
from typing import Any

from rich.console import Console

from agent.in_words import line, plain
from agent.live import View, live
from agent.progress import Progress
from luxloop.campaign import Step
from luxloop.design import Design
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.messages import Describe, Status, WorkerStatus

DESIGN = Design.from_vector((180.0, 28.0, 500.0, 35.0, 6.5))


def step(**changes: Any) -> Step:
    """A step of the walk."""
    given: dict[str, Any] = {
        "run": "one", "lane": 0, "number": 3, "design": DESIGN, "state": (1.0, 0.0, 0.0, 0.0, 0.0),
        "uniformity": 0.9032, "uniformity_error": 0.0051, "reward": 0.1,
        "figures": {"mean_illuminance_lx": {"value": 109_814.0, "standard_error": 55.0}},
    }  # fmt: skip
    return Step(**(given | changes))


class Controller:
    """Answers with two ray workers, one of them busy; or not at all."""

    def __init__(self, there: bool = True) -> None:
        self.there, self.asked = there, 0

    def status(self) -> Status:
        self.asked += 1
        if not self.there:
            raise RemoteError(Failure(code="no_controller", message="nobody"))
        workers = tuple(
            WorkerStatus(
                describe=Describe(worker=f"ray-{i}", kind="ray", version="1", host="h", pid=i), task_id="t" * i
            )
            for i in range(2)
        )
        return Status(
            epoch="e", version="1", up_s=1.0, now_unix_s=1.0, workers=workers, queued={}, running=1, done=0, failed=0,
            requeued=0, fenced=0, resident_mb=1.0,
        )  # fmt: skip


def shown(view: View, progress: Progress) -> str:
    """The table as text."""
    console = Console(file=io.StringIO(), width=150)
    console.print(view.table(progress))
    return console.file.getvalue()  # type: ignore[attr-defined]  # it is ours


def test_the_table_says_where_a_campaign_is() -> None:
    """Evaluations of the budget, the last and the best design with errors, epsilon, workers, pace, time left."""
    progress = Progress(steps=20, evaluations=10, episodes=2, last=step(), best=step(uniformity=0.95), epsilon=0.25)
    progress.began_s -= 40.0
    text = shown(View("one", 40, Controller()), progress)  # type: ignore[arg-type]  # a stand-in
    for wanted in (
        "10 of 40, 2 episodes", "90.32 +- 0.51 %", "95.00 +- 0.51 %", str(DESIGN), "25 %", "1 of 2 ray busy",
        "0.5 steps/s", "about 120 s left",
    ):  # fmt: skip
        assert wanted in text, wanted


def test_nothing_yet_and_nobody_there_are_told() -> None:
    """Before the first step, with a controller that does not answer."""
    text = shown(View("one", 40, Controller(there=False)), Progress())  # type: ignore[arg-type]
    assert "the controller does not answer" in text
    assert "0 of 40" in text


def test_the_controller_is_not_asked_at_every_step() -> None:
    """Only now and then."""
    controller = Controller()
    view = View("one", 40, controller)  # type: ignore[arg-type]
    for _ in range(5):
        shown(view, Progress())
    assert controller.asked == 1


def test_nothing_is_drawn_where_nobody_looks() -> None:
    """The look is a function that does nothing."""
    with live(False, "one", 40, Controller()) as look:  # type: ignore[arg-type]
        look(Progress())


def test_a_step_in_a_line() -> None:
    """With its light; why it could not be evaluated or built; nothing for none."""
    assert line(plain(step())) == f"90.32 +- 0.51 %, 109,814 +- 55 lx  {DESIGN}"
    assert line(plain(step(feasible=False, uniformity=0.0))) == f"cannot be built: {DESIGN}"
    failed = step(failure=Failure(code="worker_lost", message="three attempts"))
    assert "three attempts" in line(plain(failed))
    assert line(plain(None)) == "-"


def test_the_finals_are_told_from_the_walk() -> None:
    """Once the walk is over, the table says that designs are evaluated anew, and what for."""
    progress = Progress(stage="finalists", last=step(final=True, role="without_dbr"))
    assert "finalists, evaluated anew: without dbr" in shown(View("trial", 10, None), progress)
    assert "anew" not in shown(View("trial", 10, None), Progress(last=step()))
