"""The commands as a user types them: output, `--json`, exit codes, errors with field, value, range and mend."""

from __future__ import annotations

import json
import os
import pty
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from luxloop import __version__
from luxloop.cli import main
from luxloop.model_file import find_model, to_toml
from luxloop.settings import Settings, as_environment
from tests import forks
from tests.conftest import free_endpoint, processes_at, processes_with, start, wait_for

Refused = Callable[..., tuple[object, str, str]]
GOLDEN = json.loads((Path(__file__).parent / "golden" / "thin_film.json").read_text())["tables"]


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Settings]:
    """A set kept warm by `luxloop serve local`."""
    settings = Settings(router=free_endpoint(), cache=tmp_path_factory.mktemp("cache"))
    process = start(settings, "-m", "luxloop", "serve", "local", "--quiet")
    try:
        wait_for(lambda: luxloop(settings, "doctor").returncode == 0, "the set to be healthy", 120.0)
        yield settings
    finally:
        process.terminate()
        assert process.wait(10) == 0
        assert processes_at(settings.router) == []


@pytest.fixture
def nobody(settings: Settings) -> Settings:
    """Settings with a router on an address that is nobody's: whoever asks a worker fails, and starts none."""
    return settings.model_copy(update={"router": "tcp/192.0.2.1:7447"})


def luxloop(settings: Settings, *argv: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """`luxloop ARGV` as a process of its own."""
    return forks.luxloop(*argv, env=as_environment(settings) | {"NO_COLOR": "1"} | environment)


@pytest.fixture
def refused(nobody: Settings, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Exit code, stdout and stderr of `luxloop ARGV` in this process, where one of its own is not the point."""

    def run(*argv: str, **environment: str) -> tuple[object, str, str]:
        for name, value in (as_environment(nobody) | {"NO_COLOR": "1"} | environment).items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(sys, "argv", ["luxloop", *argv])
        monkeypatch.setattr(sys, "excepthook", sys.excepthook)  # typer puts its own there
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        return ended.value.code, said.out, said.err

    return run


def in_bash(settings: Settings, line: str) -> subprocess.CompletedProcess[str]:
    """`luxloop LINE` as a shell reads it."""
    return subprocess.run(
        ["bash", "-c", f"{shlex.quote(sys.executable)} -m luxloop {line}"],
        env=as_environment(settings) | {"NO_COLOR": "1"},
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
    assert {film["table"]["wavelengths"] for film in found["films"]} == {31}


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
        (["film", "--pairs", "5.5", "--stack", "Si | air"], "--pairs"),
        (["film", "--pairs", "5.3"], "--pairs"),
        (["film", "--pairs", "-1"], "--pairs"),
        (["film", "--pairs", "nan"], "--pairs"),
        (["film", "--pairs", "5.5", "--angles", "90"], "--angles"),
        (["film", "--pairs", "5.5", "--angles", "0:80:0"], "--angles"),
        (["film", "--pairs", "5.5", "--angles", "0:80:1e-320"], "--angles"),
        (["film", "--pairs", "5.5", "--angles", "-1e308:1e308:1"], "--angles"),
        (["film", "--pairs", "5.5", "--wavelengths", "0:1e308:1e-9"], "--wavelengths"),
        (["film", "--pairs", "0:1e308:1e-9"], "--pairs"),
        (["film", "--pairs", "5.5", "--bandwidth", "nan"], "--bandwidth"),
        (["film", "--pairs", "5.5", "--tables", "--quantity", "psi"], "--tables"),
        (["film", "--pairs", "5.5", "--bandwidth", "-1"], "--bandwidth"),
        (["film", "--pairs", "5.5", "--plot", "no/such/folder/x.png"], "--plot"),
        (["film", "--pairs", "5.5", "--plot", "x.jpg"], ".png"),
        (["film", "--pairs", "5.5", "--model", "nowhere.toml"], "nowhere.toml"),
        (["film", "--pairs", "5.5,6", "--export", "both.xml"], "--export"),
        (["film", "--pairs", "5.5", "--export", "mirror.txt"], "--export"),
        (["film", "--stack", "Si | air", "--export", "mirror.xml"], "--export"),
        (["film", "--stack", "Si"], "--stack"),
        (["film", "--stack", "Si | SiO2 | air"], "SiO2"),
        (["film", "--stack", "Si | SiO2 -5 | air"], "a thickness of 0 to"),
        (["film", "--stack", "Si | Unobtainium 5 | air"], "Unobtainium"),
        (["film", "--stack", "Si | air", "--against", "wavelength", "--wavelengths", "100:200:50"], "248"),
        (["materials", "show", "gan"], "GaN"),
        (["materials", "show", "GaN", "--wavelengths", "200"], "350"),
    ],
)
def test_bad_input_ends_with_2_naming_what_is_wrong(refused: Refused, argv: list[str], named: str) -> None:
    """One line with what was wrong, one object on stdout; found out before any worker is asked for."""
    code, out, err = refused(*argv, "--json")
    assert code == 2
    (line,) = err.splitlines()
    assert named in line
    assert json.loads(out)["error"]["code"] == "bad_input"


@pytest.mark.parametrize(
    ("argv", "named", "with_json"),
    [
        (["--nonsense"], "--nonsense", "--nonsense"),
        (["nonsense"], "nonsense", "nonsense"),
        (["film", "--nonsense"], "--nonsense", "--nonsense"),
        (["film", "--quantity", "Q"], "--quantity", "--quantity"),
        (["materials", "show"], "'name'", "'name'"),
        (["serve", "local", "--thin-film", "65"], "--thin-film", "--json"),  # which it does not know
    ],
)
def test_bad_usage_ends_with_2_and_is_one_object_with_json(
    refused: Refused, argv: list[str], named: str, with_json: str
) -> None:
    """Without --json the usage and a hint on stderr, with it one object that names the help to ask for."""
    code, out, err = refused(*argv)
    assert (code, out) == (2, "")
    assert "Error" in err
    assert named in err
    code, out, err = refused(*argv, "--json")
    assert code == 2
    error = json.loads(out)["error"]
    assert error["code"] == "bad_usage"
    assert error["mend"].endswith("--help")
    assert with_json in error["message"]


def test_version(refused: Refused) -> None:
    """Once "Missing command"."""
    assert refused("--version") == (0, f"{__version__}\n", "")


@pytest.mark.parametrize("option", ["--plot", "--export"])
def test_a_file_that_cannot_be_written_is_said_before_anything_is_computed(
    refused: Refused, tmp_path: Path, option: str
) -> None:
    """A folder, and a folder that is not there."""
    ending = ".png" if option == "--plot" else ".xml"
    (tmp_path / f"folder{ending}").mkdir()
    for name, why in {f"folder{ending}": "Is a directory", f"no/x{ending}": "No such file or directory"}.items():
        code, _, err = refused("film", "--pairs", "5.5", option, str(tmp_path / name))
        assert code == 2
        (line,) = err.splitlines()
        assert option in line
        assert why in line


@pytest.mark.parametrize("cache", ["~no-such-user/x", "/dev/null", "/proc/x"])
@pytest.mark.parametrize("argv", [["film", "--pairs", "5.5"], ["serve", "thin-film"], ["serve", "local"]])
def test_an_unusable_cache_is_said_at_once(refused: Refused, cache: str, argv: list[str]) -> None:
    """Exit 2 with one line, where a worker would wait for a router that never comes."""
    code, _, err = refused(*argv, LUXLOOP_CACHE=cache)
    assert code == 2
    (line,) = err.splitlines()
    assert repr(cache) in line


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        ("materials list > /dev/full", 1, "No space left on device"),
        ("--version > /dev/full", 1, "No space left on device"),
        ("film --pairs 5.3 --json > /dev/full", 2, "--pairs"),
        ("film --pairs 5.3 2> /dev/full", 2, ""),
        ("film --pairs 5.3 --json | true; exit ${PIPESTATUS[0]}", 2, "--pairs"),
        ("materials list | true; exit ${PIPESTATUS[0]}", 0, ""),
        ("model show paper | true; exit ${PIPESTATUS[0]}", 0, ""),
        ("materials list >&-", 0, ""),
    ],
)
def test_output_that_nobody_takes(nobody: Settings, line: str, code: int, said: str) -> None:
    """A full disk is one line and exit 1, a reader that has gone is no error, an error stays one."""
    done = in_bash(nobody, line)
    assert done.returncode == code
    assert done.stderr.count("\n") == bool(said)
    assert said in done.stderr


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


@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.05, 0.1, 0.2])
def test_ctrl_c_right_at_the_start_ends_with_130_and_no_traceback(nobody: Settings, delay_s: float) -> None:
    """From when `main` has taken charge of it on, also while modules are being imported."""
    code = (
        "import luxloop.cli as door; whole = door.app;"
        "door.app = lambda words: (print('ready', flush=True), whole(words))[1]; door.main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, "serve", "thin-film"],
        env=as_environment(nobody),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(delay_s)  # what is tested
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=20)[1] == b""
    assert process.returncode == 130


@pytest.mark.parametrize("reader", ["head -1", "true"])
def test_a_closed_pipe_is_no_error(warm: Settings, reader: str) -> None:
    """`luxloop film | head -1` ends quietly, with 0 of ours."""
    done = in_bash(warm, f"film --pairs 0:20:1 --angles 0:20:0.02 | {reader}; exit ${{PIPESTATUS[0]}}")
    assert (done.returncode, done.stderr) == (0, "")
    assert ("R of DBR" in done.stdout) == (reader == "head -1")


@pytest.mark.parametrize(("option", "talks"), [([], True), (["--quiet"], False), (["--json"], False)])
def test_a_terminal_is_told_what_is_waited_for(warm: Settings, option: list[str], talks: bool) -> None:
    """A line while the workers are found, a bar while films come; nothing with --quiet or --json."""
    ours, theirs = pty.openpty()
    done = subprocess.run(
        [sys.executable, "-m", "luxloop", "film", "--pairs", "5.5", "--tables", *option],
        env=as_environment(warm) | {"TERM": "xterm", "COLUMNS": "60"},
        stdout=subprocess.PIPE,
        stderr=theirs,
        timeout=60,
        check=False,
    )
    os.write(theirs, b"end")
    said = os.read(ours, 1 << 20).decode()
    os.close(ours)
    os.close(theirs)
    assert done.returncode == 0
    assert ("finding the workers" in said and "films" in said) == talks
    assert (said == "end") == (not talks)
    assert b"\x1b" not in done.stdout


def test_json_is_utf8_wherever_it_is_written(tmp_path: Path) -> None:
    """In a Latin-1 locale, too, where a letter that it lacks would become an escape that JSON does not know."""
    file = tmp_path / "m.toml"
    file.write_text(
        to_toml(find_model("paper").model_copy(update={"notes": "\U0001f4a1 and \xb5"})), encoding="utf-8"
    )
    argv = [sys.executable, "-m", "luxloop", "model", "show", str(file), "--json"]
    done = subprocess.run(argv, env=os.environ | {"PYTHONIOENCODING": "latin-1"}, capture_output=True, check=True)
    assert json.loads(done.stdout.decode("utf-8"))["notes"] == "\U0001f4a1 and \xb5"


def test_a_home_of_nobody_is_a_folder_like_any_other(settings: Settings, tmp_path: Path) -> None:
    """As a shell takes it: `~nosuch/x` is what it says where there is no such user."""
    for argv, made in ((("certs", "--out"), "ca.pem"), (("effects", "list", "--effects"), None)):
        done = forks.luxloop(*argv, "~nosuch/x", env=as_environment(settings), cwd=tmp_path)
        assert "Traceback" not in done.stderr
        assert done.returncode == 0, done.stderr
        assert made is None or (tmp_path / "~nosuch" / "x" / made).exists()
