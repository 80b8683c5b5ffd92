"""The tutorials of docs/, walked on the data sets that are shipped: what they print is what comes out."""

from __future__ import annotations

from pathlib import Path

import pytest

from luxloop.settings import Settings
from tests.validation.diagnose.test_diagnose_loop import told

HOUSE = Path(__file__).parents[2]
WAFER = HOUSE / "examples" / "wafer"


@pytest.mark.slow
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
