"""What is said beside a verdict: faults of the data, and errors that are stated too large."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.validation.datasets import PEAK_DN, light, photographed, put, write_dataset
from tests.validation.workers import Workers
from validation import add_command, calibrate_command, compare_command, diagnose_command, session
from validation.cautions import faults_of, overstated
from validation.dataset.folder import write_sums
from validation.told import comparison

WAFER = Path(__file__).parents[2] / "examples" / "wafer"


def shot(chi2: float, pixels: int, **more: Any) -> dict[str, Any]:
    """A shot of a comparison's document."""
    return {"id": "a", "kind": "spectrum", "chi2_per_pixel": chi2, "pixels": pixels, **more}


def test_data_with_errors_are_told_with_the_command_that_lists_them(tmp_path: Path) -> None:
    """A gamma-encoded image, which a comparison can read."""
    folder = write_dataset(tmp_path)
    assert list(faults_of(folder)) == []
    signal = np.clip((photographed(PEAK_DN * light(3, 5), 2) - 64.0) / 4031.0, 0.0, None)
    put(folder, "images/array.tif", np.asarray(np.round(64.0 + 4031.0 * signal ** (1 / 2.2)), np.uint16))
    (told,) = faults_of(folder)
    assert "gamma-encoded" in told
    assert told.endswith(f"luxloop dataset check {folder}")


def test_noise_alone_is_hardly_ever_said_to_be_too_small() -> None:
    """Of 20,000 draws of chi2 about two are below the quantile, none when a camera's gain is a few percent off."""
    draws = np.random.default_rng(3).chisquare(200, 20_000) / 203
    said = [one for one in draws if list(overstated([shot(float(one) * 0.887, 203)], 3))]
    assert 0 < len(said) <= 8
    assert not list(overstated([shot(0.95, 16_384, kind="image", nuisances=[{}] * 5)], 3))
    assert not list(overstated([shot(0.0, 2)], 5))


@pytest.mark.parametrize("kind", ["image", "spectrum"])
def test_errors_stated_too_large_are_said(kind: str) -> None:
    """A sigma of ten times the noise leaves a hundredth of chi2, which every model would."""
    (told,) = overstated([shot(0.01, 200, kind=kind)], 3)
    assert told.startswith("a: chi2/")
    assert "errors are stated too large" in told
    assert ("gain" if kind == "image" else "sigma") in told.rpartition("look at")[2]


class Asking(Workers):
    """Workers of this process, of which nothing goes on record."""

    tasks: Sequence[str] = ()

    def records(self) -> Sequence[Any]:
        """None."""
        return ()


@pytest.fixture
def luxloop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[str, str]]:
    """A command by the twin, on workers of this process and a journal of nobody: stdout and stderr."""
    workers = Asking(tmp_path / "films")
    folder = SimpleNamespace(folder="runs/run", root="root")
    door = SimpleNamespace(run="run", begun=folder, note=lambda **_: None, end=lambda *_, **__: folder)
    monkeypatch.setenv("LUXLOOP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(session, "Client", lambda *_, **__: nullcontext(workers))
    monkeypatch.setattr(session, "Asking", lambda client: client)
    monkeypatch.setattr(session.RunDoor, "begin", lambda *_: nullcontext(door))

    def run(command: Callable[..., None], *words: Any, **how: Any) -> tuple[str, str]:
        command(*words, model=str(tmp_path / "model.toml"), twin=True, **how)
        return tuple(capsys.readouterr())  # type: ignore[return-value]

    return run


@pytest.fixture
def overstated_wafer(tmp_path: Path) -> Path:
    """The wafer with a sigma of fifty times its noise, and a file that is missing."""
    data = tmp_path / "wafer"
    (data / "spectra").mkdir(parents=True)
    for name in ("dataset.toml", "spectra/R.csv", "spectra/T.csv"):
        text = (WAFER / name).read_text(encoding="utf-8")
        (data / name).write_text(text.replace(",0.002\n", ",0.1\n"), encoding="utf-8")
    (data / "gone.txt").write_text("here")
    write_sums(data)
    (data / "gone.txt").unlink()
    return data


def test_compare_tells_both_on_its_own(overstated_wafer: Path, luxloop: Callable[..., tuple[str, str]]) -> None:
    """Agreement, with two warnings."""
    out, err = luxloop(compare_command.compare, overstated_wafer)
    assert "none of the 2 shots differs" in out
    assert "Warning: wafer-R: chi2/value is " in out
    assert "the data have errors" in err
    assert f"luxloop dataset check {overstated_wafer}" in err
    out, err = luxloop(compare_command.compare, overstated_wafer, as_json=True)
    assert err == ""
    assert "gone.txt" in out


@pytest.mark.parametrize(
    ("command", "words", "how"),
    [
        (calibrate_command.calibrate, (), {"fit_only": True}),
        (diagnose_command.diagnose, (), {"among": "film_interface_roughness"}),
        (add_command.add, ("film_interface_roughness",), {"dry_run": True}),
    ],
)
def test_commands_that_decide_by_the_data_tell_the_same(
    overstated_wafer: Path, luxloop: Callable[..., tuple[str, str]], command: Any, words: Any, how: Any
) -> None:
    """Only comparisons did: a diagnosis of faulty data said nothing of them. Each caution stands once in a text."""
    luxloop(compare_command.compare, overstated_wafer)
    out, err = luxloop(command, *words, **how)
    assert err.count("the data have errors") == out.count("Warning: the data have errors") == 1
    assert out.count("Warning: wafer-R: chi2/value is ") == 1
    out, err = luxloop(command, *words, as_json=True, **how)
    assert err == ""
    told = json.loads(out)["warnings"]
    assert [name in one for name, one in zip(("gone.txt", "wafer-R", "wafer-T"), told, strict=True)] == [True] * 3


def test_warnings_are_printed_below_the_sentence() -> None:
    """Documents of earlier versions have none."""
    document = {
        "shots": [], "parameters": [], "sentence": "fine", "trusted": True, "solver": {"method": "twin"},
    }  # fmt: skip
    assert list(comparison(document)) == ["", "fine."]
    assert list(comparison(document | {"warnings": ["look"]})) == ["", "fine.", "Warning: look."]
