"""The tutorials of docs/, walked on the data sets that are shipped: what they print is what comes out."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from luxloop.settings import Settings
from tests.running_set import local_set
from tests.validation.diagnose.test_diagnose_loop import told

HOUSE = Path(__file__).parents[2]
WAFER = HOUSE / "examples" / "wafer"
SEALED = HOUSE / "examples" / "sealed"
BEFORE, AFTER = "D 180, W 44, S 340, T 40 um, 6.5 pairs", "D 140, W 26, S 320, T 50 um, 8 pairs"
DESIGNS = {BEFORE: "180,44,340,40,6.5", AFTER: "140,26,320,50,8"}
"""Winners of the tutorial's campaigns, as it prints them and as `simulate` takes them."""
FOUND = {
    "environment.chip_absorption_per_cm": (197.1, 7.1),
    "environment.substrate.reflectance": (0.9606, 0.0094),
    "environment.receiver.reflectance": (0.3525, 0.0058),
}
"""Values and errors that the tutorial prints after `add`. Another way there (two effects to choose from) ends about
another Monte Carlo, and so within an error of it: an anchor moved by 0.4 of one moves a fit by up to 0.6
(decision 27)."""


@pytest.fixture
def one_set(settings: Settings) -> Iterator[None]:
    """Processes that stay from command to command: what one has had computed the next need not."""
    with local_set(settings):
        yield


@pytest.mark.slow
@pytest.mark.usefixtures("one_set")
def test_the_wafers_spread_is_named_and_the_error_falls_to_the_noise(settings: Settings, tmp_path: Path) -> None:
    """Spectra by tmm of a film that is not even; the page's sentence is the one that is said."""
    tutorial = (HOUSE / "docs" / "tutorial-spectra.md").read_text(encoding="utf-8")
    model = ("--model", "wafer.toml")
    before = told(settings, tmp_path, "compare", str(WAFER), *model)
    assert all(shot["chi2_per_pixel"] > 100.0 for shot in before["shots"])
    found = told(settings, tmp_path, "diagnose", *model)
    assert found["verdict"] == "one_effect"
    assert found["sentence"] in tutorial
    added = told(settings, tmp_path, "add", "film_thickness_spread", *model)
    (size,) = (row for row in added["fitted"] if row["path"] == "effects.film_thickness_spread.spread_ratio")
    assert size["value"] == pytest.approx(0.00208, abs=0.00001)
    assert added["after"]["held_out_percent"] < 1.02 * added["after"]["noise_percent"]
    after = told(settings, tmp_path, "compare", str(WAFER), *model)
    assert after["structure"]["p"] > 0.05
    rungs = told(settings, tmp_path, "ladder", *model)["rungs"]
    assert [rung["effects"] for rung in rungs] == [[], ["film_thickness_spread"]]


@pytest.mark.slow
@pytest.mark.usefixtures("one_set")
def test_the_mirrors_layers_are_named_and_the_best_design_moves(settings: Settings, tmp_path: Path) -> None:
    """Images of the blind test's forward model; the page's winners are the better ones, each under its model."""
    tutorial = (HOUSE / "docs" / "tutorial-images.md").read_text(encoding="utf-8")
    model, how = ("--model", "mine.toml"), ("--histories", "500000")
    most = ("--most-histories", "2000000")  # the page's last anchors have up to eight million: minutes more
    before = told(settings, tmp_path, "compare", str(SEALED / "sets" / "set-1"), *model, *how)
    fits = {shot["id"]: shot["p"] > 0.01 for shot in before["shots"]}
    assert fits == {"chip-bare": True, "chip-mirror": False, "module-bare": True, "module-mirror": False}
    among = ("--among", "dbr_layer_order,receiver_btdf")
    found = told(settings, tmp_path, "diagnose", *model, *how, *most, *among)
    assert (found["verdict"], found["set"]) == ("one_effect", ["dbr_layer_order"])
    said = "One effect explains the misfit: dbr_layer_order, order aln_first."
    assert found["sentence"].startswith(said)
    assert said in tutorial
    shown = {one["path"]: one["with"] for one in found["parameters"]}
    for path, (value, error) in FOUND.items():
        assert f"{path} {value:g} +- {error:g}" in tutorial.replace(" 1/cm", "")
        assert abs(shown[path] - value) < error
    shutil.copy(tmp_path / "mine.toml", tmp_path / "before.toml")
    added = told(settings, tmp_path, "add", "dbr_layer_order", *model, *how, *most)
    for row in added["fitted"]:
        value, error = FOUND[row["path"]]
        assert abs(row["value"] - value) < error
    assert added["before"]["held_out_percent"] > 1.4 * added["after"]["held_out_percent"]
    assert added["after"]["held_out_percent"] < 1.02 * added["after"]["noise_percent"]
    fits = told(settings, tmp_path, "compare", str(SEALED / "sets" / "set-1"), *model, *how)
    assert fits["structure"]["p"] > 0.01
    rungs = told(settings, tmp_path, "ladder", *model)["rungs"]
    assert [rung["effects"] for rung in rungs] == [[], ["dbr_layer_order"]]
    for better, worse, under in ((BEFORE, AFTER, "before.toml"), (AFTER, BEFORE, "mine.toml")):
        assert better in tutorial
        good, bad = (
            told(settings, tmp_path, "simulate", "--design", DESIGNS[one], "--model", under)["metrics"]["uniformity"]
            for one in (better, worse)
        )
        error = (good["standard_error"] ** 2 + bad["standard_error"] ** 2) ** 0.5
        assert good["value"] - bad["value"] > 3.0 * error


def test_the_sealed_answer_of_the_tutorial_is_the_one_in_its_data() -> None:
    """By a hash program alone, as the page says."""
    opening = json.loads((SEALED / "answers" / "set-1.json").read_text(encoding="utf-8"))
    text = json.dumps(opening["answer"], sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    found = hashlib.sha256(bytes.fromhex(opening["salt"]) + text.encode()).hexdigest()
    assert found == json.loads((SEALED / "sets" / "set-1" / "seal.json").read_text(encoding="utf-8"))["sha256"]
    assert [one["kind"] for one in opening["answer"]["hidden"]] == ["swapped_layers"]
    assert found in (HOUSE / "docs" / "tutorial-images.md").read_text(encoding="utf-8")
