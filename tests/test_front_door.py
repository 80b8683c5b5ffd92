"""The commands as a user types them: output, `--json`, exit codes, errors with field, value, range and mend."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from luxloop.settings import Settings, as_environment
from tests.conftest import free_endpoint, processes_at, processes_with, start, wait_for

GOLDEN = json.loads((Path(__file__).parent / "golden" / "thin_film.json").read_text())["tables"]


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Settings]:
    """A set kept warm by `luxloop serve local`."""
    settings = Settings(router=free_endpoint(), cache=tmp_path_factory.mktemp("cache"))
    process = start(settings, "-m", "luxloop", "serve", "local", "--quiet")
    try:
        wait_for(lambda: luxloop(settings, "doctor").returncode == 0, "the set to be healthy", 30.0)
        yield settings
    finally:
        process.terminate()
        assert process.wait(10) == 0
        assert processes_at(settings.router) == []


def luxloop(settings: Settings, *argv: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """`luxloop ARGV` as a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "luxloop", *argv],
        env=as_environment(settings) | {"NO_COLOR": "1"} | environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def result(settings: Settings, *argv: str) -> dict[str, Any]:
    """The one JSON object on stdout of a command that succeeds."""
    done = luxloop(settings, *argv, "--json")
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_film_prints_the_golden_reflectance(warm: Settings) -> None:
    """The DBR of the default model from the chip's side, averaged over its line, is the independent program's."""
    golden = GOLDEN["GaN|GaN-first|5.5"]
    angles = ",".join(map(str, golden["deg"]))
    found = result(warm, "film", "--pairs", "5.5", "--angles", angles)
    assert found["films"][0]["values"] == pytest.approx(golden["R"], abs=5e-8)
    assert found["side"] == "inside"


def test_film_draws_and_compares_its_tables(warm: Settings, tmp_path: Path) -> None:
    """With --tables and --plot there is a PNG, and the tables agree with the exact values."""
    picture = tmp_path / "film.png"
    found = result(warm, "film", "--pairs", "4.5:9.5:0.5", "--tables", "--plot", str(picture))
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert len(found["films"]) == 11
    assert max(film["table"]["largest_difference"] for film in found["films"]) < 5e-4
    assert {film["table"]["wavelengths"] for film in found["films"]} == {61}


def test_film_of_any_stack_against_wavelength(warm: Settings) -> None:
    """A stack written as a sentence; a quarter wave of 1.38 on 1.52 gives the closed form at its wavelength."""
    found = result(
        warm, "film", "--stack", "1.52 | 1.38 99.6377 | air", "--against", "wavelength", "--wavelengths", "550"
    )
    closed = ((1.52 - 1.38**2) / (1.52 + 1.38**2)) ** 2
    assert found["films"][0]["values"][0] == pytest.approx(closed, rel=1e-6)
    text = luxloop(warm, "film", "--stack", "1.52 | 1.38 99.6377 | air", "--quantity", "psi")
    assert "psi in deg of 1.52 | 1.38(99.6377 nm) | 1" in text.stdout


@pytest.mark.parametrize("ending", ["coated", "bsdf", "xml"])
def test_film_exports_a_table(warm: Settings, tmp_path: Path, ending: str) -> None:
    """One DBR as a file of another program; what was lost is said with its size."""
    file = tmp_path / f"mirror.{ending}"
    found = result(warm, "film", "--pairs", "5.5", "--side", "outside", "--angles", "0", "--export", str(file))
    assert len(file.read_text()) > 10_000
    assert found["export"]["lost"]


def test_doctor_sees_the_worker(warm: Settings) -> None:
    """Every line is ok, a film worker of this release among them."""
    findings = result(warm, "doctor")["findings"]
    assert {finding["verdict"] for finding in findings} == {"ok"}
    assert any(finding["what"].startswith("film-") for finding in findings)


def test_doctor_without_a_router_fails_and_says_what_to_do(settings: Settings) -> None:
    """Exit 1, the endpoint, the mend."""
    done = luxloop(settings, "doctor")
    assert done.returncode == 1
    assert settings.router in done.stdout
    assert "LUXLOOP_ROUTER" in done.stdout


def test_materials_are_listed_and_shown(settings: Settings) -> None:
    """Ten materials with their ranges; n of GaN at 450 nm is the paper's 2.4869."""
    names = [row["name"] for row in result(settings, "materials", "list")["materials"]]
    assert set(names) == {"GaN", "AlN", "TiO2", "SiO2", "Al2O3", "PMMA", "Ag", "Al", "Si", "air"}
    assert result(settings, "materials", "show", "GaN", "--wavelengths", "450")["n"][0] == pytest.approx(
        2.4869, abs=5e-5
    )


def test_a_model_is_made_and_undone(settings: Settings, tmp_path: Path) -> None:
    """`model new` writes a file that `model show` reads; a nonsense key is refused with its name."""
    file = tmp_path / "model.toml"
    assert luxloop(settings, "model", "new", str(file)).returncode == 0
    assert result(settings, "model", "show", str(file))["environment"]["n_gan"] == 2.4869
    file.write_text(file.read_text() + "\n[colour]\nblue = 1\n")
    broken = luxloop(settings, "model", "show", str(file))
    assert broken.returncode == 2
    assert "colour" in broken.stderr
    assert file.name in broken.stderr


@pytest.mark.parametrize(
    ("argv", "named"),
    [
        (["film"], "--pairs"),
        (["film", "--pairs", "5.3"], "dbr_pairs"),
        (["film", "--pairs", "-1"], "dbr_pairs"),
        (["film", "--pairs", "nan"], "--pairs"),
        (["film", "--pairs", "5.5", "--angles", "90"], "aoi_deg"),
        (["film", "--pairs", "5.5", "--angles", "0:80:0"], "--angles"),
        (["film", "--pairs", "5.5", "--bandwidth", "-1"], "bandwidth_nm"),
        (["film", "--pairs", "5.5", "--plot", "no/such/folder/x.png"], "--plot"),
        (["film", "--pairs", "5.5", "--plot", "x.jpg"], ".png"),
        (["film", "--pairs", "5.5", "--model", "nowhere.toml"], "nowhere.toml"),
        (["film", "--pairs", "5.5,6", "--export", "both.xml"], "--export"),
        (["film", "--pairs", "5.5", "--export", "mirror.txt"], "--export"),
        (["film", "--stack", "Si | air", "--export", "mirror.xml"], "--tables"),
        (["film", "--stack", "Si"], "--stack"),
        (["film", "--stack", "Si | SiO2 | air"], "SiO2"),
        (["film", "--stack", "Si | SiO2 -5 | air"], "thickness_nm"),
        (["film", "--stack", "Si | Unobtainium 5 | air"], "Unobtainium"),
        (["film", "--stack", "Si | air", "--against", "wavelength", "--wavelengths", "100:200:50"], "248"),
        (["materials", "show", "gan"], "GaN"),
        (["materials", "show", "GaN", "--wavelengths", "200"], "350"),
    ],
)
def test_bad_input_ends_with_2_naming_what_is_wrong(warm: Settings, argv: list[str], named: str) -> None:
    """No traceback: one line with what was wrong; the same as one object on stdout with --json."""
    done = luxloop(warm, *argv)
    assert done.returncode == 2
    assert named in done.stderr
    assert "Traceback" not in done.stderr
    with_json = luxloop(warm, *argv, "--json")
    assert with_json.returncode == 2
    assert json.loads(with_json.stdout)["error"]["code"] == "bad_input"


def test_settings_come_from_command_line_environment_and_file(settings: Settings, tmp_path: Path) -> None:
    """A bad value is named with its place; a file luxloop.toml counts, and loses to the environment."""
    (tmp_path / "luxloop.toml").write_text('router = "tcp/127.0.0.1:2"\n')
    environment = {key: value for key, value in os.environ.items() if not key.startswith("LUXLOOP_")}
    asked = [sys.executable, "-m", "luxloop", "doctor", "--json"]
    run = {"cwd": tmp_path, "capture_output": True, "text": True, "check": False}
    from_file = subprocess.run(asked, env=environment, **run)  # type: ignore[call-overload]  # options in a dict
    assert "tcp/127.0.0.1:2" in from_file.stdout
    both = subprocess.run(asked, env=environment | {"LUXLOOP_ROUTER": "tcp/127.0.0.1:3"}, **run)  # type: ignore[call-overload]  # the same
    assert "tcp/127.0.0.1:3" in both.stdout
    bad = luxloop(settings, "doctor", LUXLOOP_ROUTER="http://x")
    assert bad.returncode == 2
    assert "router" in bad.stderr


def test_ctrl_c_ends_with_130_and_leaves_nothing(settings: Settings) -> None:
    """Interrupted while its set starts or computes, a command ends its processes too."""
    process = subprocess.Popen(
        [sys.executable, "-m", "luxloop", "film", "--pairs", "0:100:0.5"],
        env=as_environment(settings),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    time.sleep(1.5)  # any moment will do
    process.send_signal(signal.SIGINT)
    assert process.wait(20) in (130, 0)
    wait_for(lambda: not processes_with(f"LUXLOOP_CACHE={settings.cache}"), "its processes to end", 15.0)


def test_a_closed_pipe_is_no_error(warm: Settings) -> None:
    """`luxloop film | head -1` ends quietly."""
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m luxloop film --pairs 0:20:1 --angles 0:20:0.02 | head -1"],
        env=as_environment(warm),
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in done.stderr
    assert "R of DBR" in done.stdout
