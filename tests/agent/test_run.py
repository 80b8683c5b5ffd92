"""Campaigns over a real router, a real controller and worker processes that answer without computing."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agent.config import Campaign, Stop
from agent.launch import Launched, launch
from luxloop.campaign import Action, Step
from luxloop.client import Client
from luxloop.door import RunDoor
from luxloop.errors import InputError, LuxloopError, RemoteError
from luxloop.journal.reader import RunJournal
from luxloop.model_file import find_model
from luxloop.settings import Settings, as_environment
from tests import forks
from tests.conftest import wait_for
from tests.forks import Process
from tests.running_set import RunningSet

PRETEND = str(Path(__file__).parents[1] / "pretend_worker.py")


class Set(RunningSet):
    """A set with workers that pretend."""

    def add_pretender(self, kind: str, nap_s: float = 0.0) -> Process:
        """One more worker, once it has introduced itself."""
        worker = self.add(PRETEND, kind, str(nap_s))
        self.ready(len(self.workers))
        return worker


@pytest.fixture
def running(settings: Settings) -> Iterator[Set]:
    """A set with one worker of each kind."""
    made = Set(settings)
    made.add_pretender("film")
    made.add_pretender("ray")
    yield made
    made.close()


def launched(running: Set, run: str, name: str = "ddqn-fast", evaluations: int = 40, **changes: Any) -> Launched:
    """A campaign on the set."""
    campaign = Campaign(designer=name, stop=Stop(evaluations=evaluations), **changes)
    return launch(running.settings, campaign, "paper", run, local=False)


def told(running: Set, run: str) -> list[tuple[int, int, Any, float, str]]:
    """What a run's journal says of its walk: designs, uniformities and weights, lane by lane."""
    journal = RunJournal(running.settings.runs_dir / run)
    learner = (entry.value for entry in journal.records("/agent"))
    weights = {(one.lane, one.number): one.weights_sha256 for one in learner}
    rows = [
        (step.lane, step.number, step.design, step.uniformity, weights[step.lane, step.number])
        for step in journal.steps()
        if not step.final
    ]
    return sorted(rows, key=lambda row: row[:2])


def steps_in(folder: Path) -> int:
    """How many steps are on record so far; 0 before the journal has begun."""
    try:
        return len(list(RunJournal(folder).steps()))
    except InputError:
        return 0


def test_a_campaign_leaves_a_journal_that_says_all(running: Set) -> None:
    """Every step with its learner's state, the result, the reason; the count is that of the file."""
    result = launched(running, "one")
    journal = RunJournal(running.settings.runs_dir / "one")
    steps = list(journal.steps())
    assert len(steps) == result.found.progress.steps + 8
    assert len(list(journal.records("/agent"))) == result.found.progress.steps
    assert {"model.toml", "campaign.json", "packages.txt", "plan.json"} <= set(journal.attachments())
    assert result.ended.root in (running.settings.runs_dir / "one" / "audit.sha256").read_text()
    assert result.found.best is not None
    (best,) = (step for step in steps if step.role == "best")
    assert result.document()["best"]["uniformity"] == best.uniformity


def test_one_and_two_ray_workers_give_the_same_walk_and_the_same_weights(running: Set) -> None:
    """To the last bit, with naps of different length."""
    launched(running, "one", seed=4)
    running.add_pretender("ray", 0.003)
    launched(running, "two", seed=4)
    assert told(running, "one") == told(running, "two")
    assert any(row[4] for row in told(running, "one"))


def test_two_campaigns_at_once_end_as_they_would_alone(running: Set) -> None:
    """Side by side in one results folder."""
    launched(running, "alone", seed=4)
    ends: dict[str, Launched] = {}

    def run(name: str, seed: int) -> None:
        ends[name] = launched(running, name, seed=seed)

    threads = [threading.Thread(target=run, args=one) for one in (("left", 4), ("right", 5))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert told(running, "left") == told(running, "alone")
    assert set(ends) == {"left", "right"}


def test_workers_and_router_that_are_killed_cost_no_step(running: Set) -> None:
    """kill -9 of a ray worker and of the router in the middle: the same walk as undisturbed."""
    launched(running, "calm", seed=7)
    running.add_pretender("ray", 0.05)
    ends: list[Launched] = []
    thread = threading.Thread(target=lambda: ends.append(launched(running, "storm", seed=7)))
    thread.start()
    journal = running.settings.runs_dir / "storm"
    wait_for(lambda: steps_in(journal) > 5, "some steps")
    running.workers[-1].send_signal(signal.SIGKILL)
    wait_for(lambda: steps_in(journal) > 15, "more steps")
    running.router.send_signal(signal.SIGKILL)
    running.router.wait(10)
    running.router = running.start_router()
    thread.join(90.0)
    assert ends
    assert told(running, "storm") == told(running, "calm")


def test_a_designer_that_is_killed_leaves_a_journal_of_all_its_steps(running: Set) -> None:
    """Every step that the process was told is in the file, although nobody ended the run."""
    argv = [sys.executable, "-m", "luxloop", "campaign", "run", "--no-local", "--id", "cut", "--evaluations", "5000"]
    process = subprocess.Popen(argv, env=as_environment(running.settings), stderr=subprocess.DEVNULL)
    journal = running.settings.runs_dir / "cut"
    wait_for(lambda: steps_in(journal) > 20, "some steps", 60.0)
    process.kill()
    process.wait(10)
    steps = list(RunJournal(journal).steps())
    assert len(steps) > 20
    shown = luxloop(running, "campaign", "status", "cut", "--json")
    assert json.loads(shown.stdout)["running"]


def test_ctrl_c_finishes_the_steps_under_way_and_the_journal(running: Set) -> None:
    """Exit code 130, a finished journal, the reason in it, what to do next on stdout."""
    argv = [sys.executable, "-m", "luxloop", "campaign", "run", "--no-local", "--id", "stop", "--evaluations", "5000"]
    process = subprocess.Popen(argv, env=as_environment(running.settings), stdout=subprocess.PIPE, text=True)
    journal = running.settings.runs_dir / "stop"
    wait_for(lambda: steps_in(journal) > 20, "some steps", 60.0)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "interrupted" in out
    assert "luxloop campaign resume stop" in out
    assert (journal / "audit.sha256").exists()
    assert "finished; left early: interrupted" in luxloop(running, "audit", "info", "stop").stdout


def test_a_second_ctrl_c_waits_for_no_evaluation(running: Set) -> None:
    """The only ray worker naps for minutes: exit at once, and the run is there to be gone on with."""
    running.workers[-1].kill()
    running.add(PRETEND, "ray", "300")
    argv = [sys.executable, "-m", "luxloop", "campaign", "run", "--no-local", "--id", "left"]
    process = subprocess.Popen(argv, env=as_environment(running.settings), stderr=subprocess.DEVNULL)
    with Client(running.settings, local=False) as client:
        wait_for(lambda: client.status().running > 0, "an evaluation under way", 60.0)
    process.send_signal(signal.SIGINT)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    assert process.wait(20) != 0
    assert "interrupted" in luxloop(running, "audit", "info", "left").stdout


def luxloop(running: Set, *argv: str) -> subprocess.CompletedProcess[str]:
    """A command as a user gives it."""
    return forks.luxloop(*argv, env=as_environment(running.settings), timeout=120.0)


def test_commands_find_the_run(running: Set) -> None:
    """list, status, audit info and audit verify, by its id."""
    launched(running, "seen", evaluations=10)
    assert "seen" in luxloop(running, "campaign", "list").stdout
    assert json.loads(luxloop(running, "campaign", "status", "seen", "--json").stdout)["finished"]
    assert "finished" in luxloop(running, "audit", "info", "seen").stdout
    assert luxloop(running, "audit", "verify", "seen").returncode == 0
    nothing = luxloop(running, "campaign", "status", "none")
    assert nothing.returncode == 2
    assert "seen" in nothing.stderr


def test_a_grid_sees_all_that_can_be_built(running: Set) -> None:
    """By the command, coarse steps; its best are evaluated anew."""
    shown = luxloop(
        running, "grid", "--no-local", "--bounds", "paper-table3", "--step", "80,45,200,25,2.5", "--id", "g", "--json"
    )
    found = json.loads(shown.stdout)
    assert found["evaluations"] == 2 * 3 * 3 * 3 * 3
    assert len(found["finalists"]) == 5


def test_designers_are_compared(running: Set) -> None:
    """A row each, on equal budgets, every run in the results folder."""
    shown = luxloop(
        running, "designers", "compare", "--no-local", "--designers", "pattern,random", "--seeds", "2",
        "--evaluations", "12", "--json",
    )  # fmt: skip
    rows = json.loads(shown.stdout)["designers"]
    assert [(row["designer"], row["runs"]) for row in rows] == [("pattern", 2), ("random", 2)]
    assert len(list(running.settings.runs_dir.iterdir())) == 4


def test_an_id_that_exists_is_refused(running: Set) -> None:
    """Before anything is computed; by the command with exit code 2 or 1, naming the id."""
    launched(running, "one", evaluations=5)
    with pytest.raises(LuxloopError, match="one"):
        launched(running, "one", evaluations=5)
    shown = luxloop(running, "campaign", "run", "--id", "one")
    assert shown.returncode == 2
    assert "one" in shown.stderr


def test_two_designers_on_one_run_are_refused(running: Set) -> None:
    """The second one is told who has it; the first goes on."""
    plan = Campaign().plan("one", find_model("paper"), "paper")
    with Client(running.settings, local=False) as client, RunDoor.begin(client, plan) as door:
        with pytest.raises(RemoteError, match="in use"):
            RunDoor.begin(client, plan)
        low = plan.bounds.low
        step = door.act(Action(run="one", designer=door.designer, lane=0, number=0, design=low))
        assert isinstance(step, Step)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("--designer", "nobody"), "ddqn-fast"),
        (("--evaluations", "0"), "stop.evaluations"),
        (("--lanes", "65"), "lanes"),
        (("--bounds", "nowhere"), "paper-table3"),
        (("--model", "nowhere.toml"), "nowhere.toml"),
        (("--id", "Not An Id"), "--id: got 'Not An Id', allowed: 1 to 60 small letters"),
        (("--walk-error", "0"), "walk_error_points"),
        (("--config", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_bad_options_are_named(argv: tuple[str, ...], said: str, settings: Settings) -> None:
    """Exit code 2 and the option's field, before any process is started."""
    shown = forks.luxloop("campaign", "run", *argv, env=as_environment(settings))
    assert shown.returncode == 2, shown.stderr
    assert said in shown.stderr


def test_no_router_and_no_local_says_so(settings: Settings) -> None:
    """Nothing is started; the mend is in the text."""
    with pytest.raises(RemoteError, match="no router"):
        launch(settings, Campaign(), "paper", "one", local=False)
    assert not settings.runs_dir.exists()


def test_a_results_folder_that_is_a_file_is_named(running: Set) -> None:
    """At the begin, before anything is computed."""
    running.settings.runs_dir.write_text("not a folder")
    with pytest.raises((InputError, RemoteError), match="runs"):
        launched(running, "one")


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("grid", "--step", "0,0,0,0,0"), "--step: distance_um"),
        (("grid", "--step", "nan,1,1,1,1"), "--step: distance_um"),
        (("grid", "--step", "1e-3,1e-3,1e-3,1e-3,0.5"), "a grid of at most 10,000,000 designs"),
        (("grid", "--step", "1e-310,10,50,10,0.5"), "--step: step.distance_um: got 1e-310"),
        (("grid", "--step", "20,20"), "five numbers"),
        (("designers", "compare", "--designers", "random,random"), "name each once"),
        (("designers", "compare", "--designers", ""), "--designers"),
        (("campaign", "run", "--runs", "/proc/version"), "--runs"),
        (("run", "--runs", "/proc/version"), "--runs"),
    ],
)
def test_bad_options_of_other_commands_are_named(argv: tuple[str, ...], said: str, settings: Settings) -> None:
    """Exit code 2, before any process is started."""
    shown = forks.luxloop(*argv, env=as_environment(settings))
    assert shown.returncode == 2, shown.stderr
    assert said in shown.stderr


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("grid", "paper-grid (default) or paper-table3"),
        ("campaign run", "paper-table3 (default) or paper-grid"),
    ],
)
def test_help_names_the_bounds_that_are_taken_without_any(command: str, said: str, settings: Settings) -> None:
    """A grid is the paper's entire loop, a campaign looks in Table 3."""
    shown = forks.luxloop(*command.split(), "--help", env=as_environment(settings) | {"COLUMNS": "200"})
    assert said in shown.stdout


def test_a_damaged_run_does_not_hide_the_others(running: Set) -> None:
    """The list names it, and how to look at it."""
    launched(running, "sound", evaluations=5)
    launched(running, "spoilt", evaluations=5)
    file = running.settings.runs_dir / "spoilt" / "audit-0001.mcap"
    file.write_bytes(b"nothing of ours")
    text = luxloop(running, "campaign", "list").stdout
    assert "sound" in text
    assert "audit verify" in next(row for row in text.splitlines() if row.startswith("spoilt"))


def test_a_run_that_lies_elsewhere_is_told(running: Set, tmp_path: Path) -> None:
    """The set keeps its own folder: where it is, and the next command with its path."""
    elsewhere = {**as_environment(running.settings), "LUXLOOP_RUNS": str(tmp_path / "mine")}
    shown = forks.luxloop("campaign", "run", "--id", "far", "--evaluations", "5", "--no-local", env=elsewhere)
    folder = running.settings.runs_dir / "far"
    assert f"keeps its runs elsewhere: {folder}" in shown.stderr
    assert f"luxloop campaign report {folder}" in shown.stdout
