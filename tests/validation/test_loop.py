"""The loop as a person walks it: a data set, compare, where, over real processes; on record and in a page."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from luxloop.effect import AppliedEffect
from luxloop.journal.reader import RunJournal
from luxloop.model_file import read_model
from luxloop.settings import Settings, as_environment
from tests import forks
from tests.running_set import local_set
from validation.calibrate_command import calibrate
from validation.compare_command import compare
from validation.session import Session, subject_of

EXAMPLE = Path(__file__).parents[2] / "examples" / "paper-like"


def luxloop(settings: Settings, folder: Path, *argv: str) -> subprocess.CompletedProcess[str]:
    """A command of the house in a folder of its own; it starts the processes that it needs."""
    return forks.luxloop(*argv, env=as_environment(settings), cwd=folder, timeout=1200.0)


@pytest.mark.slow
def test_compare_then_where_over_real_processes(settings: Settings, tmp_path: Path) -> None:
    """The example by the twin: a row per shot, the data in the model file, both steps in journals that verify."""
    compared = luxloop(settings, tmp_path, "compare", str(EXAMPLE), "--twin", "--json")
    assert compared.returncode == 0, compared.stderr
    document: dict[str, Any] = json.loads(compared.stdout)
    assert [shot["id"] for shot in document["shots"]] == [
        f"{layout}-{pairs}" for layout in ("single", "array") for pairs in ("0", "2.5", "5.5")
    ]
    model = read_model(tmp_path / "model.toml")
    assert model.data is not None
    assert model.data.sha256 == document["dataset"]["sha256"]
    with local_set(settings):
        looked = luxloop(settings, tmp_path, "where", "--twin", "--page", "where.html")
    assert looked.returncode == 0, looked.stderr
    assert document["sentence"] in looked.stdout
    assert "single-5.5" in (tmp_path / "where.html").read_text(encoding="utf-8")
    journal = RunJournal(Path(document["folder"]))
    *asked, step = [record.value for record in journal.records("/validation")]
    assert {one.command for one in asked} == {"asked"}
    assert (step.command, step.dataset_sha256) == ("compare", model.data.sha256)
    assert len(list(journal.records("/map/residual"))) == 6
    verified = luxloop(settings, tmp_path, "audit", "verify", document["folder"])
    assert verified.returncode == 0, verified.stdout
    for level, verdict in (("2", "within tolerance"), ("3", "identical"), ("4", "identical")):
        replayed = luxloop(settings, tmp_path, "audit", "replay", document["folder"], "--level", level)
        assert replayed.returncode == 0, replayed.stdout
        assert verdict in replayed.stdout.split("verdict")[-1]


@pytest.mark.slow
@pytest.mark.parametrize("argv", [("compare", str(EXAMPLE)), ("calibrate", "--fit-only")])
def test_a_model_file_edited_meanwhile_costs_nobody_what_was_found(
    settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, argv: tuple[str, ...]
) -> None:
    """It stays as it was edited, and the result is printed all the same; then the command says why it failed."""
    file = tmp_path / "model.toml"
    if argv[0] == "calibrate":
        subject = subject_of(str(file), EXAMPLE)
        subject.saved(subject.with_data, "compare", {})

    def edit(*_: Any) -> None:
        file.write_text(file.read_text() + "# mine\n")

    for name, value in as_environment(settings).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(Session, "record", edit)
    app = typer.Typer()
    app.command()(compare if argv[0] == "compare" else calibrate)
    with local_set(settings):
        done = CliRunner().invoke(app, [*argv[1:], "--model", str(file), "--twin", "--json"])
    assert done.exit_code == 2
    assert "nobody edits while a command runs" in done.stderr
    assert json.loads(done.stdout)["shots"][-1]["id"] == "array-5.5"  # one object: what was found
    assert file.read_text().endswith("# mine\n")


def test_a_model_file_that_cannot_be_written_is_told_before_anything_is_computed(
    settings: Settings, tmp_path: Path
) -> None:
    """Commands that would write it end with 2 and name it; with --dry-run they go on to a router that is gone."""
    subject = subject_of(str(tmp_path / "model.toml"), EXAMPLE)
    haze = AppliedEffect(name="veiling_glare", parameters={"share": 0.01})
    subject.saved(subject.with_data.model_copy(update={"effects": (haze,)}), "compare", {})
    shutil.copytree(EXAMPLE, tmp_path / "other")
    shutil.rmtree(tmp_path / ".luxloop")
    (tmp_path / ".luxloop").touch()  # where its versions would lie; rights alone do not stop root
    for argv in (("compare", "other"), ("calibrate",), ("add", "ambient_gradient"), ("remove", "veiling_glare")):
        done = luxloop(settings, tmp_path, *argv, "--no-local")
        assert done.returncode == 2, done.stderr
        assert "a place that can be written" in done.stderr
        if argv[0] != "compare":
            done = luxloop(settings, tmp_path, *argv, "--no-local", "--dry-run")
            assert done.returncode == 1, done.stderr
            assert "no router" in done.stderr


def test_where_needs_data_and_compare_a_data_set(settings: Settings, tmp_path: Path) -> None:
    """Each says what is missing and what to do, before anything is started."""
    (tmp_path / "folder.html").mkdir()
    for argv, words in (
        (("where", "--model", "paper"), "luxloop compare DATASET comes first"),
        (("where",), "model.toml"),
        (("compare", "nowhere"), "dataset"),
        (("compare", str(EXAMPLE), "--model", "no/such/model.toml"), "a folder that exists"),
        (("compare", str(EXAMPLE), "--page", "page.txt"), ".html"),
        (("compare", str(EXAMPLE), "--page", "folder.html"), "a file that can be written"),
        (("calibrate", "--model", "paper"), "luxloop compare DATASET comes first"),
    ):
        done = luxloop(settings, tmp_path, *argv)
        assert done.returncode == 2, done.stderr
        assert words in done.stderr
        assert "Traceback" not in done.stderr
    assert not (tmp_path / "no").exists()
    assert not (tmp_path / "model.toml").exists(), "no model is begun for data that are not there"
