"""What a comparison says beside its verdict: faults of the data, and errors that are stated too large."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.validation.datasets import PEAK_DN, light, photographed, put, write_dataset
from tests.validation.workers import Workers
from validation import compare_command, session
from validation.cautions import faults_of, overstated
from validation.dataset.folder import write_sums
from validation.prediction import Predictor
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


@pytest.fixture
def compare(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[str, str]]:
    """`luxloop compare --twin` on workers of this process: stdout and stderr."""

    @contextmanager
    def here(*_: Any, **__: Any) -> Iterator[Any]:
        door = SimpleNamespace(run="run", begun=SimpleNamespace(folder="runs/run"))
        predictor = Predictor(Workers(tmp_path))
        yield SimpleNamespace(door=door, predictor=predictor, record=lambda *_: None)

    monkeypatch.setattr(session, "session", here)

    def run(data: Path, **how: Any) -> tuple[str, str]:
        compare_command.compare(data, model=str(tmp_path / "model.toml"), twin=True, histories=1, **how)
        return tuple(capsys.readouterr())  # type: ignore[return-value]

    return run


def test_compare_tells_both_on_its_own(tmp_path: Path, compare: Callable[..., tuple[str, str]]) -> None:
    """The wafer with a sigma of fifty times its noise, and a file that is missing: agreement, with two warnings."""
    data = tmp_path / "wafer"
    (data / "spectra").mkdir(parents=True)
    for name in ("dataset.toml", "spectra/R.csv", "spectra/T.csv"):
        text = (WAFER / name).read_text(encoding="utf-8")
        (data / name).write_text(text.replace(",0.002\n", ",0.1\n"), encoding="utf-8")
    (data / "gone.txt").write_text("here")
    write_sums(data)
    (data / "gone.txt").unlink()
    out, err = compare(data)
    assert "none of the 2 shots differs" in out
    assert "Warning: wafer-R: chi2/value is " in out
    assert "the data have errors" in err
    assert f"luxloop dataset check {data}" in err
    out, err = compare(data, as_json=True)
    assert err == ""
    assert "gone.txt" in out


def test_warnings_are_printed_below_the_sentence() -> None:
    """Documents of earlier versions have none."""
    document = {
        "shots": [], "parameters": [], "sentence": "fine", "trusted": True, "solver": {"method": "twin"},
    }  # fmt: skip
    assert list(comparison(document)) == ["", "fine."]
    assert list(comparison(document | {"warnings": ["look"]})) == ["", "fine.", "Warning: look."]
