"""A user's own effect from its first line to a simulation with it, through real processes."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from luxloop.model_file import find_model, to_toml
from luxloop.settings import Settings, as_environment
from tests import forks
from tests.conftest import free_endpoint, wait_for
from tests.running_set import RunningSet
from validation import effects_command
from validation.effects.confusing import Confusion

BRIGHT = """
from containers.effect import DetectorEffect, parameter

class Bright(DetectorEffect):
    '''Light is made.'''
    name = "bright"
    formula = "E"
    reference = "a test"
    share: float = parameter("s", unit="", lower=0.0, upper=0.5, off=0.0)

    def light(self, image, camera):
        return image * (1.0 + self.share)
"""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSet]:
    """A set with both workers, whose folder of effects is its own."""
    folder = tmp_path_factory.mktemp("set")
    folders = {name: folder / name for name in ("cache", "runs", "effects")}
    at = RunningSet(Settings(router=free_endpoint(), **folders))
    try:
        for role in ("thin-film", "ray-tracing"):
            at.add("-m", "luxloop", "serve", role, "--quiet")
        wait_for(
            lambda: len(at.client.status(5.0).workers) == 2, "two workers", limit_s=300.0
        )  # kernels are compiled
        yield at
    finally:
        at.close()


def luxloop(at: RunningSet, *argv: str) -> subprocess.CompletedProcess[str]:
    """A command on the running set, in the folder that holds all."""
    return forks.luxloop(*argv, env=as_environment(at.settings), cwd=at.settings.effects.parent, timeout=1200.0)


def said(at: RunningSet, *argv: str) -> dict[str, Any]:
    """The one object that a command prints with --json."""
    done = luxloop(at, *argv, "--json")
    assert done.returncode == 0, done.stderr + done.stdout
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def simulated(at: RunningSet, stanza: str) -> subprocess.CompletedProcess[str]:
    """A short simulation by the twin of the paper's model with what stands in a stanza."""
    file = at.settings.effects.parent / "with.toml"
    file.write_text(to_toml(find_model("paper")) + "\n" + stanza + "\n")
    design = ("--design", "180,40,500,20,2.5", "--method", "twin", "--json")
    return luxloop(at, "simulate", *design, "--model", str(file))


def test_effects_that_calibration_imitates_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A map with nothing else was dropped without a word; a picture of it is refused after all was told."""
    specs = {name: SimpleNamespace(name=name) for name in ("gone", "odd")}
    at = SimpleNamespace(known=SimpleNamespace(spec=specs.get), predictor=None, say=None)
    maps = [Confusion("films", (), np.eye(0), {"gone": 0.0}, ("gone",), (), {"odd": "no film"}),
            Confusion("images", (), np.eye(0), {}, (), (), {})]  # fmt: skip
    monkeypatch.setattr(effects_command, "_asked", lambda *_: nullcontext(at))
    monkeypatch.setattr("validation.effects.confusing.grounds", lambda *_: range(2))
    monkeypatch.setattr("validation.effects.confusing.confusion", lambda ground, *_: maps[ground])
    app = typer.Typer()
    app.command()(effects_command.confusion)
    done = CliRunner().invoke(app, ["--only", "gone,odd", "--page", str(tmp_path / "map.png")])
    assert done.exit_code == 2, done.output
    assert "On films" in done.stdout
    assert "On images" not in done.stdout
    assert "Wholly imitated by calibration: gone\nnot predicted: odd: no film" in done.stdout
    assert done.stderr.startswith("luxloop: --page: got")


@pytest.mark.slow
def test_an_effect_is_written_checked_and_simulated(running: RunningSet) -> None:
    """`effects new`, `check` with all its findings, the stanza into a model file, `simulate` with another result."""
    written = said(running, "effects", "new", "my_warmth", "--stage", "module", "--no-local")
    assert Path(written["file"]) == running.settings.effects / "my_warmth.py"
    checked = said(running, "effects", "check", "my_warmth", "--quick", "--no-local")
    assert checked["ok"]
    names = [one["check"] for one in checked["findings"]]
    assert names == ["import", "spec", "off", "acts", "again", "derivative", "random numbers"]
    sha256 = next(one for one in checked["stanza"].splitlines() if one.startswith("source_sha256"))
    done = simulated(running, checked["stanza"])
    assert done.returncode == 0, done.stderr
    off = simulated(running, re.sub("warmth = .*", "warmth = 0.0", checked["stanza"]))
    light = [json.loads(one.stdout)["metrics"]["mean_illuminance_lx"]["value"] for one in (done, off)]
    assert light[0] < light[1]
    assert light[1] == json.loads(simulated(running, "").stdout)["metrics"]["mean_illuminance_lx"]["value"]
    other = simulated(running, checked["stanza"].replace(sha256, f'source_sha256 = "{"0" * 64}"'))
    assert other.returncode == 2
    failure = json.loads(other.stdout)["error"]
    assert failure["code"] == "unknown_effect"
    assert "0" * 64 in failure["message"]
    assert sha256.split('"')[1] in failure["allowed"]
    builtin = simulated(running, '[[effects]]\nname = "distance_error"\n[effects.parameters]\ndistance_um = 5.0')
    assert builtin.returncode == 0, builtin.stderr


@pytest.mark.slow
def test_a_file_that_is_broken_or_changes_while_the_worker_runs_is_found(running: RunningSet) -> None:
    """It is listed with its reason and the worker answers; once it is mended it is known, without a restart."""
    running.settings.effects.mkdir(exist_ok=True)
    file = running.settings.effects / "bright.py"
    file.write_text(BRIGHT)
    listed = said(running, "effects", "list", "--no-local")
    assert "it would create" in listed["refused"]["bright.py"] or "at most 1" in listed["refused"]["bright.py"]
    assert "camera_psf" in [spec["name"] for spec in listed["effects"]]
    failed = luxloop(running, "effects", "check", "bright", "--no-local")
    assert failed.returncode == 1
    assert "FAILED  acts" in failed.stdout
    file.write_text(BRIGHT.replace("1.0 + self.share", "1.0 - self.share"))
    assert "bright" in [spec["name"] for spec in said(running, "effects", "list", "--no-local")["effects"]]


@pytest.mark.slow
def test_a_name_that_is_taken_and_a_file_that_is_there_are_refused(running: RunningSet) -> None:
    """`effects new` writes over nothing, and takes no name of the catalogue."""
    taken = luxloop(running, "effects", "new", "camera_psf", "--stage", "detector", "--no-local")
    assert taken.returncode == 2
    assert "no effect has" in taken.stderr
    running.settings.effects.mkdir(exist_ok=True)
    there = running.settings.effects / "mine.py"
    there.write_text("x = 1\n")
    again = luxloop(running, "effects", "new", "mine", "--stage", "detector", "--no-local")
    assert again.returncode == 2
    assert there.read_text() == "x = 1\n"
    wrong = luxloop(running, "effects", "new", "My Effect", "--stage", "detector", "--no-local")
    assert wrong.returncode == 2


@pytest.mark.slow
def test_show_draws_images_and_curves(running: RunningSet) -> None:
    """A picture for an effect on images and for one on a film; an unknown name says which is near."""
    shown = said(running, "effects", "show", "distance_error", "--value", "distance_um=5", "--no-local")
    assert shown["values"] == {"distance_um": 5.0}
    assert shown["kind"] == "image"
    assert shown["rms_percent"] > 0.1
    assert (running.settings.effects.parent / shown["picture"]).read_bytes()[:4] == b"\x89PNG"
    film = said(running, "effects", "show", "film_dispersion", "--no-local")
    assert film["kind"] == "curve"
    assert (running.settings.effects.parent / film["picture"]).stat().st_size > 10_000
    unknown = luxloop(running, "effects", "show", "distance_eror", "--no-local")
    assert unknown.returncode == 2
    assert "distance_error" in unknown.stderr
