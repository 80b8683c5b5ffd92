"""The loop as a person walks it: a data set, compare, where, over real processes; on record and in a page."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from luxloop.journal.reader import RunJournal
from luxloop.model_file import read_model
from luxloop.settings import Settings, as_environment
from tests import forks
from tests.running_set import local_set

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
