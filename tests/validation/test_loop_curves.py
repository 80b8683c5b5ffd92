"""Spectra and far fields through the whole loop, over real processes: simulate, check, compare, where, replay."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from luxloop.settings import Settings
from tests.conftest import free_endpoint
from tests.running_set import local_set
from tests.validation.test_loop import luxloop
from validation.dataset.folder import read_dataset

PLAN = """
name = "a chip and a film"
[[samples]]
id = "chip"
layout = "single"
distance_um = 180.0
width_um = 40.0
spacing_um = 400.0
thickness_um = 20.0
dbr_pairs = 0.0
[[films]]
id = "oxide"
exit = "Si"
layers = [{ cauchy = [1.46, 0.004], thickness_nm = 2000.0, free = { thickness_nm = [1900.0, 2100.0] } }]
[[films]]
id = "oxide-in-two"
exit = "Si"
layers = [
  { cauchy = [1.46, 0.004], thickness_nm = 1000.0 },
  { fixed = [1.56, 0.0], thickness_nm = 1000.0 },
]
"""
SIMULATE = (
    "dataset", "simulate", "data", "--plan", "plan.toml", "--no-images", "--spectra", "R,psi,delta",
    "--angle", "55,65", "--wavelengths", "400:700:2.5", "--far-field", "--far-sigma", "0.05",
    "--histories", "1000000", "--seed", "5", "--keep-truth", "--json",
)  # fmt: skip

WAFER = Path(__file__).parents[2] / "examples" / "wafer"
CHI2 = "chi2 per value, oxide-psi"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Settings, Path]]:
    """A set of processes that is kept, and a folder with a simulated data set."""
    folder = tmp_path_factory.mktemp("curves")
    settings = Settings(router=free_endpoint(), **{name: folder / name for name in ("cache", "runs", "effects")})
    (folder / "plan.toml").write_text(PLAN)
    with local_set(settings):
        done = luxloop(settings, folder, *SIMULATE)
        assert done.returncode == 0, done.stderr
        yield settings, folder


def document(place: tuple[Settings, Path], *argv: str) -> dict[str, Any]:
    """What a command told with --json."""
    done = luxloop(*place, *argv, "--json")
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_a_simulated_data_set_is_one(place: tuple[Settings, Path]) -> None:
    """It checks, has the shots that were asked for, and keeps its truth."""
    assert luxloop(*place, "dataset", "check", "data").returncode == 0
    shots = [shot.id for shot in read_dataset(place[1] / "data").manifest.shots]
    films = ("oxide", "oxide-in-two")
    assert shots == [*(f"{film}-{quantity}" for film in films for quantity in ("R", "psi", "delta")), "chip-far"]
    assert (place[1] / "data" / "truth-model.toml").exists()


def test_the_model_that_made_them_differs_by_noise(place: tuple[Settings, Path]) -> None:
    """Every curve has its own row with chi2 about 1; the film that may move stays where it was."""
    found = document(place, "compare", "data", "--twin", "--page", "compare.html")
    assert found["structure"]["p"] > 1e-3
    for shot in found["shots"]:
        assert shot["kind"] == ("far_field" if shot["id"] == "chip-far" else "spectrum")
        assert shot["chi2_per_pixel"] == pytest.approx(1.0, abs=6.0 * math.sqrt(2.0 / shot["pixels"]))
    (thickness,) = found["parameters"]
    assert thickness["path"] == "films.oxide.layers.0.thickness_nm"
    assert abs(thickness["value"] - 2000.0) < 5.0 * thickness["error"]
    assert "residual against optical thickness" in (place[1] / "compare.html").read_text(encoding="utf-8")


def test_where_names_the_layer_that_a_wrong_film_lacks(place: tuple[Settings, Path]) -> None:
    """One layer in place of two: fringes at an optical thickness lead the ranking; the page draws them."""
    found = document(place, "where", "--twin", "--film", "oxide", "--page", "where.html")
    assert found["structure"]["p"] < 1e-3
    assert any(one["family"] == "optical thickness" for one in found["regions"][:6])
    peaks = [one["peak"] for one in found["fourier"] if one["shot"] == "oxide-in-two-delta"]
    assert len(peaks) == 2
    assert min(peak["log_chance"] for peak in peaks) < -10.0
    against = {one["against"] for one in found["profiles"]}
    assert {"wavelength", "angle of incidence", "theta", "phi"} <= against
    assert "Fringes equally spaced" in (place[1] / "where.html").read_text(encoding="utf-8")


def test_calibrate_fits_what_the_films_free(place: tuple[Settings, Path]) -> None:
    """Far fields see the module's parameters, spectra alone do not: those are told as unseen."""
    wafer = ("--model", "wafer.toml")
    assert luxloop(*place, "compare", str(WAFER), *wafer).returncode == 0
    found = document(place, "calibrate", *wafer, "--fit-only", "--dry-run", "--page", "calibration.html")
    assert [one["path"] for one in found["fit"]["parameters"]] == ["films.wafer.layers.0.thickness_nm"]
    assert "environment.substrate.reflectance" in found["fit"]["unseen"]
    assert found["trusted"]
    text = luxloop(*place, "calibrate", *wafer, "--fit-only", "--dry-run").stdout
    assert "not seen by these data: environment." in text
    assert "substrate Gaussian" not in text


def test_effects_are_told_apart_by_spectra(place: tuple[Settings, Path]) -> None:
    """Without images the map is that of the curves."""
    found = document(place, "effects", "confusion", str(WAFER))
    assert [one["ground"] for one in found["maps"]] == ["2 spectra"]


@pytest.mark.parametrize(("level", "row"), [("3", "sentence"), ("4", "the fit anew, sentence"), ("2", CHI2)])
def test_the_comparison_is_replayed(place: tuple[Settings, Path], level: str, row: str) -> None:
    """What was told follows again: from the record, and from workers that are asked the same."""
    run = document(place, "compare", "data", "--twin")["folder"]
    replayed = document(place, "audit", "replay", run, "--level", level)
    assert replayed["counts"]["differs"] == 0
    assert replayed["compared"][row] == {"within tolerance" if level == "2" else "identical": 1}
    assert replayed["exit"] == 0
    assert "proposal" not in replayed["compared"]  # nobody designs here
