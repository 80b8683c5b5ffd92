"""The start of a run and its end: what is refused before anything begins, what waits, what is told, exit codes."""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import typer

from agent import launch as launch_module
from agent.config import Campaign, read_campaign
from agent.designers import SEARCHES, WITHOUT_START
from agent.launch import Launched, refuse_unready, to_go_on_with
from agent.telling import as_text, run_argument, tell
from agent.waiting import workers_watched
from luxloop.campaign import Ended
from luxloop.client import Client
from luxloop.design import Bounds
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.model_file import find_model
from luxloop.settings import load_settings
from tests.agent.test_campaign import Door, found
from tests.luxloop.test_door import ACTION, door


def launched(failing: tuple[int, ...], evaluations: int = 8) -> Launched:
    """A campaign whose evaluations of these numbers fail."""
    result, runner = found(Door(failing=failing), evaluations=evaluations)
    ended = Ended(run="one", folder="runs/one", records=1, root="0" * 64)
    return Launched("one", result, ended, False, (), tuple(runner.failures.most_common()))


def test_why_steps_failed_is_told_with_how_many() -> None:
    """On the terminal and in the document; nothing where none failed."""
    some, why = launched((1, 2, 5)), Failure(code="worker_lost", message="three attempts").text()
    assert some.document()["failures"] == [{"why": why, "steps": 3}]
    assert f"failed       3 steps, 3 of them: {why}" in as_text(some.document())
    assert not any(line.startswith("failed ") for line in as_text(launched(()).document()))


def test_a_campaign_that_could_evaluate_nothing_failed(capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 1, with the reason; one that found something ends as it did."""
    with pytest.raises(typer.Exit) as end:
        tell(launched(tuple(range(1, 1000))), as_json=False)
    assert end.value.exit_code == 1
    assert "three attempts" in capsys.readouterr().out
    tell(launched((1,)), as_json=False)


def test_a_start_that_cannot_be_built_is_refused_before_the_run() -> None:
    """In the file, or the learner's own: else the journal is begun, and its id taken."""
    low = Bounds.preset("paper-grid").low
    flat = low.model_copy(update={"distance_um": 20.0, "thickness_um": 35.0})
    for name in ("pattern", "ddqn-fast"):
        campaign = Campaign(designer=name, bounds=Bounds.preset("paper-grid"), start=flat)
        with pytest.raises(InputError, match=r"start: got .*a design in the bounds that can be built"):
            refuse_unready(campaign, campaign.plan("one", find_model("paper"), "paper"))
    campaign = Campaign(designer="random")
    refuse_unready(campaign, campaign.plan("one", find_model("paper"), "paper"))


def test_a_learner_without_its_package_is_refused_before_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the extra that brings it; those that do not learn go without."""
    monkeypatch.setattr(launch_module, "find_spec", lambda _: None)
    for name in ("ddqn-fast", "ddqn-fast-random", "pattern"):
        campaign = Campaign(designer=name)
        plan = campaign.plan("one", find_model("paper"), "paper")
        if name == "ddqn-fast":
            with pytest.raises(InputError, match=r"designer: got 'ddqn-fast'.*luxloop\[designer\]"):
                refuse_unready(campaign, plan)
        else:
            refuse_unready(campaign, plan)


@pytest.mark.parametrize("name", SEARCHES)
def test_a_start_is_for_those_who_begin_somewhere(name: str, tmp_path: Path) -> None:
    """random and grid look everywhere: a start that they do not look at is refused."""
    path = tmp_path / "campaign.toml"
    start = "distance_um = 100.0\nwidth_um = 10.0\nspacing_um = 440.0\nthickness_um = 10.0\ndbr_pairs = 6.5"
    path.write_text(f"designer = '{name}'\n[start]\n{start}")
    assert (name in WITHOUT_START) == (name != "pattern")
    if name in WITHOUT_START:
        with pytest.raises(InputError, match=r"start: got .*with pattern or a learner"):
            read_campaign(path)
    else:
        assert read_campaign(path).start is not None


def test_an_option_over_what_is_no_table_names_it(tmp_path: Path) -> None:
    """No traceback where the file has a number for a table."""
    path = tmp_path / "campaign.toml"
    path.write_text("stop = 100")
    with pytest.raises(InputError, match=r"stop: got 100, allowed: a table; write it under \[stop\]"):
        read_campaign(path, stop__evaluations=50)


def test_a_run_elsewhere_is_named_with_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the command that goes on with it finds it."""
    monkeypatch.setenv("LUXLOOP_RUNS", str(tmp_path / "here"))
    assert run_argument(load_settings().runs_dir / "one") == "one"
    assert run_argument(tmp_path / "a b" / "one") == f"one --runs '{tmp_path / 'a b'}'"


class Watched:
    """A controller whose film worker goes, and which cannot be reached at times."""

    def __init__(self) -> None:
        self.looked = threading.Semaphore(0)
        self.kinds: set[str] = {"film", "ray"}
        self.away = False

    def status(self) -> Any:
        """Who works."""
        self.looked.release()
        if self.away:
            raise RemoteError(Failure(code="no_controller", message="away"))
        return SimpleNamespace(workers=[SimpleNamespace(describe=SimpleNamespace(kind=kind)) for kind in self.kinds])

    def looks(self, count: int) -> None:
        """Wait until it was asked so often."""
        for _ in range(count):
            assert self.looked.acquire(timeout=10.0)


def test_a_run_that_waits_for_a_worker_says_so() -> None:
    """Of which kind, again and again; not while both are there, nor where nobody knows."""
    told: list[str] = []
    watched = Watched()
    with workers_watched(cast(Client, watched), told.append, look_s=0.01, say_s=0.04):
        watched.looks(5)
        assert told == []
        watched.away = True
        watched.looks(20)
        assert told == []
        watched.away, watched.kinds = False, {"ray"}
        watched.looks(60)
        assert len(told) >= 2
        assert all(line.startswith("no film worker for ") for line in told)
        watched.kinds = {"film", "ray"}
        watched.looks(3)
        count = len(told)
        watched.looks(20)
        assert len(told) == count


def test_a_run_that_lost_its_controller_says_how_it_goes_on() -> None:
    """After the mend that the error has, with the folder of runs; other errors are as they were."""
    opened, _ = door("not_found", "refused")
    again = "luxloop campaign resume one --runs /runs"
    for failure, mend in (
        (Failure(code="no_router", message="nobody answers", mend="is it running?"), f"is it running?; then {again}"),
        (Failure(code="no_controller", message="nobody answers"), again),
        (Failure(code="crashed", message="broken", mend="look"), "look"),
        (Failure(code="refused", message="closed", mend="luxloop campaign resume one"), again),
    ):
        with pytest.raises(RemoteError) as caught, to_go_on_with(opened):
            raise RemoteError(failure)
        assert (caught.value.failure.code, caught.value.failure.mend) == (failure.code, mend)
    with pytest.raises(RemoteError) as caught, to_go_on_with(opened):
        opened.act(ACTION)  # the controller is there again, and cannot go on with the run
    assert (caught.value.failure.code, caught.value.failure.mend) == ("worker_lost", again)
