"""Runs that are interrupted or killed, and gone on with: they end as if nothing had happened."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from agent.checkpoints import FOLDER
from agent.config import Campaign, Stop
from agent.launch import Launched, launch
from agent.recorded import Told, recorded, wall_s
from agent.resume import resume
from env_controller.audit.checks import exit_code, verify
from env_controller.audit.contents import Contents
from luxloop.bus.keys import at
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.campaign import Step
from luxloop.client import Client
from luxloop.design import Design
from luxloop.door import RunDoor
from luxloop.errors import InputError, RemoteError
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import CHAIN
from luxloop.model_file import find_model, to_toml
from luxloop.settings import Settings, as_environment
from tests import forks
from tests.conftest import start, stop, wait_for
from tests.running_set import RunningSet

PRETEND = str(Path(__file__).parents[1] / "pretend_worker.py")
EVALUATIONS = 64
DESIGN = Design.from_vector((150.0, 30.0, 500.0, 20.0, 5.5))


@pytest.fixture
def running(settings: Settings) -> Iterator[RunningSet]:
    """A set with one worker of each kind that pretends, the ray worker taking a little while."""
    made = RunningSet(settings)
    made.add(PRETEND, "film", "0.0")
    made.add(PRETEND, "ray", "0.01")
    made.ready(2)
    yield made
    made.close()


def begun(running: RunningSet, run: str, *more: str) -> subprocess.Popen[str] | forks.Telling:
    """A campaign as a process of its own."""
    argv = ("campaign", "run", "--no-local", "--id", run, "--evaluations", str(EVALUATIONS), "--json", *more)
    return forks.begin(*argv, env=as_environment(running.settings))


def undisturbed(running: RunningSet, run: str = "calm", **changes: Any) -> Launched:
    """The same campaign, never disturbed."""
    campaign = Campaign(**{"stop": Stop(evaluations=EVALUATIONS)} | changes)
    return launch(running.settings, campaign, "paper", run, local=False)


def went_on(running: RunningSet, run: str, **how: Any) -> Launched:
    """The rest of a run."""
    return resume(running.settings, running.settings.runs_dir / run, local=False, **how)


def steps_in(folder: Path) -> int:
    """How many steps are on record so far; 0 before the journal has begun."""
    try:
        return len(list(RunJournal(folder).steps()))
    except InputError:
        return 0


def content(running: RunningSet, run: str) -> str:
    """What a run decided and found, all weights among it; its journal must be whole."""
    folder = running.settings.runs_dir / run
    assert exit_code(verify(folder, None, None)) in (0, 3)
    journal = RunJournal(folder)
    return Contents(folder).all_of([Contents(one.path).read() for one in journal.segments]).content


def killed(running: RunningSet, run: str, after: int) -> None:
    """A campaign that was killed after so many steps."""
    process = begun(running, run)
    folder = running.settings.runs_dir / run
    wait_for(lambda: steps_in(folder) >= after, f"{after} steps")
    stop(process)
    process.communicate()


@pytest.mark.parametrize("after", [1, 60])
def test_a_killed_designer_is_gone_on_with(running: RunningSet, after: int) -> None:
    """Before its first checkpoint and after it: designs, rewards, weights and choices are those of a calm run."""
    killed(running, "stormy", after)
    result = went_on(running, "stormy")
    assert result.found.best is not None
    undisturbed(running)
    assert content(running, "stormy") == content(running, "calm")
    assert len(RunJournal(running.settings.runs_dir / "stormy").segments) == 2


def test_all_processes_killed(running: RunningSet) -> None:
    """Designer, controller, router and workers at once; a new set goes on."""
    undisturbed(running)
    process = begun(running, "stormy")
    wait_for(lambda: steps_in(running.settings.runs_dir / "stormy") >= 30, "steps")
    for one in [process, *running.workers, running.controller, running.router]:
        stop(one)  # type: ignore[arg-type]  # text or bytes, it is killed alike
    process.communicate()
    running.client.close()
    again = RunningSet(running.settings)
    try:
        again.add(PRETEND, "film", "0.0")
        again.add(PRETEND, "ray", "0.0")
        went_on(again, "stormy")
    finally:
        again.close()
    assert content(running, "stormy") == content(running, "calm")


def test_a_designer_outlives_its_controller(running: RunningSet) -> None:
    """The controller is killed twice and started again: the run goes on by itself."""
    undisturbed(running)
    process = begun(running, "stormy")
    folder = running.settings.runs_dir / "stormy"
    for after in (20, 50):
        wait_for(lambda after=after: steps_in(folder) >= after, f"{after} steps")  # type: ignore[misc]  # bound now
        stop(running.controller)
        running.controller = start(running.settings, "-m", "luxloop", "serve", "controller", "--quiet")
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert json.loads(out)["reason"].startswith("budget")
    assert len(RunJournal(folder).segments) == 3
    assert content(running, "stormy") == content(running, "calm")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_says_how_to_go_on(running: RunningSet, number: signal.Signals) -> None:
    """Exit 130 with the command; what was under way is on record; resumed it ends as a calm one."""
    process = begun(running, "stormy")
    wait_for(lambda: steps_in(running.settings.runs_dir / "stormy") >= 20, "steps")
    os.kill(process.pid, number)
    out, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "luxloop campaign resume stormy" in said
    assert json.loads(out)["reason"] == "interrupted"
    went_on(running, "stormy")
    undisturbed(running)
    assert content(running, "stormy") == content(running, "calm")


@pytest.mark.parametrize("name", ["pattern", "ddqn-paper"])
def test_every_designer_can_be_gone_on_with(running: RunningSet, name: str) -> None:
    """Searches and the paper's learner, twice interrupted."""
    undisturbed(running, designer=name)
    process = begun(running, "stormy", "--designer", name)
    folder = running.settings.runs_dir / "stormy"
    wait_for(lambda: steps_in(folder) >= 15, "steps")
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=30)
    if not any(step.final for step in RunJournal(folder).steps()):
        went_on(running, "stormy")
    assert content(running, "stormy") == content(running, "calm")


def test_a_run_is_gone_on_with_by_one_designer_only(running: RunningSet) -> None:
    """While the first lives its owner is named; a run that has ended is not gone on with."""
    process = begun(running, "mine")
    wait_for(lambda: steps_in(running.settings.runs_dir / "mine") >= 5, "steps")
    with pytest.raises(RemoteError, match="in use by the designer"):
        went_on(running, "mine")
    process.communicate(timeout=60)
    with pytest.raises(InputError, match="has ended"):
        went_on(running, "mine")


def test_a_changed_model_is_refused_with_the_difference(running: RunningSet, tmp_path: Path) -> None:
    """The field, before and after; --as-recorded goes on with what the journal holds."""
    file = tmp_path / "model.toml"
    model = find_model("paper")
    file.write_text(to_toml(model))
    process = begun(running, "stormy", "--model", str(file))
    wait_for(lambda: steps_in(running.settings.runs_dir / "stormy") >= 10, "steps")
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=30)
    file.write_text(to_toml(model.with_value("environment.peak_nm", 460.0)))
    with pytest.raises(InputError, match=r"peak_nm.*460"):
        went_on(running, "stormy")
    went_on(running, "stormy", as_recorded=True)
    undisturbed(running)
    assert content(running, "stormy") == content(running, "calm")


def test_a_checkpoint_that_is_damaged_is_left_aside(running: RunningSet, capsys: pytest.CaptureFixture[str]) -> None:
    """Told with the reason; the journal alone leads to the same end."""
    killed(running, "stormy", 55)
    (newest,) = sorted((running.settings.runs_dir / "stormy" / FOLDER).glob("*.npz"))[-1:]
    newest.write_bytes(newest.read_bytes()[:-200])
    went_on(running, "stormy")
    assert "is left aside" in capsys.readouterr().err
    undisturbed(running, "calm")
    assert content(running, "stormy") == content(running, "calm")


def test_a_run_of_another_release_or_none_is_refused(
    running: RunningSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder without a journal, an id that nobody has, a plan that differs, another release: what to do is said."""
    with pytest.raises(InputError, match="the folder of a run"):
        resume(running.settings, tmp_path / "nothing", local=False)
    killed(running, "stormy", 5)
    plan = Campaign(seed=5).plan("stormy", find_model("paper"), "paper")
    with Client(running.settings, local=False) as client:
        with pytest.raises(RemoteError, match="another plan: walk differ"):
            RunDoor.begin(client, plan, resume=True)
        nobody = plan.model_copy(update={"run": "nobody"})
        with pytest.raises(RemoteError, match="folder of a run"):
            RunDoor.begin(client, nobody, resume=True)
    monkeypatch.setattr("agent.resume.__version__", "9.9")
    with pytest.raises(InputError, match=r"install that release.*9\.9"):
        went_on(running, "stormy")


def test_the_time_that_counts_is_that_with_something_under_way() -> None:
    """Two lanes at once, a pause of an hour, one more step: 3 s, then 2 s."""
    step = Step(run="a", lane=0, number=0, design=DESIGN, state=(0.0,) * 5, uniformity=0.5, reward=0.0)
    times = ((1.5, 1.5), (3.0, 2.5), (3603.0, 2.0))
    told = [Told(step.model_copy(update={"controller_s": took}), 0, round(1e9 * at), None) for at, took in times]
    assert wall_s(told) == pytest.approx(5.0)
    assert wall_s([]) == 0.0


def test_a_finished_run_stays_as_it_is(running: RunningSet) -> None:
    """Not by a copy of it as it was, under its name or another, nor by a designer that was stopped meanwhile."""
    folder = running.settings.runs_dir / "stormy"
    killed(running, "stormy", 20)
    for name in ("elsewhere/stormy", "copy"):
        shutil.copytree(folder, folder.parent.parent / name if "/" in name else folder.with_name(name))
    went_on(running, "stormy")
    root = (folder / "audit.sha256").read_text()
    with pytest.raises(RemoteError, match="has ended"):
        resume(running.settings, folder.parent.parent / "elsewhere" / "stormy", local=False)
    with pytest.raises(InputError, match=r"move .*stormy away, then rename"):
        went_on(running, "copy")
    assert (folder / "audit.sha256").read_text() == root


def test_another_journal_than_the_one_that_was_read_is_not_gone_on_with(running: RunningSet) -> None:
    """The controller's must hold the root of the one that is named; an earlier one of its own will do."""
    killed(running, "stormy", 20)
    run = recorded(running.settings.runs_dir / "stormy")
    with Client(running.settings, local=False) as client:
        with pytest.raises(RemoteError, match="not the one that is to be gone on with"):
            RunDoor.begin(client, run.plan, resume=True, root="f" * 64)
        first = next(RunJournal(run.folder).records(CHAIN)).value.root
        with RunDoor.begin(client, run.plan, resume=True, root=first) as door:
            assert door.begun.steps >= len(run.told)


def test_a_designer_that_was_taken_over_from_is_refused(running: RunningSet) -> None:
    """Stopped for so long that it is given up, then woken when another one has gone on: it writes nothing more."""
    process = begun(running, "stormy", "--quiet")
    folder = running.settings.runs_dir / "stormy"
    wait_for(lambda: steps_in(folder) >= 10, "steps")
    process.send_signal(signal.SIGSTOP)
    alive = at(running.settings.realm, "alive", role="designer")
    with ZenohBus(running.settings) as bus:
        wait_for(lambda: not bus.present(alive), "the designer to be given up", 30.0)
    went_on(running, "stormy")
    root = (folder / "audit.sha256").read_text()
    process.send_signal(signal.SIGCONT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "has ended" in said
    assert (folder / "audit.sha256").read_text() == root
    undisturbed(running)
    assert content(running, "stormy") == content(running, "calm")
