"""The unit cell by Mitsuba, another program with other intersections: optional, in a process that may abort.

Runs where `benchmarks/mitsuba_cell.py` finds Mitsuba and a libLLVM >= 19, is skipped with the reason elsewhere. What
needs no Mitsuba (the way to it, the folding) is tested everywhere.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import mitsuba_cell
from benchmarks.mitsuba_cell import Asked, MitsubaError, cut, folded, libllvm, mitsuba_row, row, run

GOLDEN = Path(__file__).parents[1] / "golden" / "ray_tracing.json"
GOLDEN_MEAN_SE = {"A": 0.0004, "B": 0.0006}  # both stated in the golden file's note
GOLDEN_CUT_SE = {"A": 0.003, "B": 0.005}  # A relative ("about 0.3 %"), B absolute ("0.002-0.005")
missing = cache(mitsuba_cell.missing)


@pytest.fixture
def mitsuba() -> None:
    """Skip where Mitsuba does not run."""
    reason = missing()
    if reason:
        pytest.skip(reason)


@cache
def traced(case: str) -> dict[str, Any]:
    """The particle loop's row of a golden case, traced once."""
    return mitsuba_row(Asked(case=case, histories=300_000))


def golden(case: str) -> dict[str, Any]:
    """The golden record of a case."""
    return dict(json.loads(GOLDEN.read_text())[f"case_{case}"])


@pytest.mark.usefixtures("mitsuba")
def test_every_photon_lands_once_in_a_white_furnace() -> None:
    """With a white substrate and a black receiver each photon of a clear chip arrives exactly once, or is booked."""
    asked = Asked(case="B", histories=2_048, substrate_reflectance=1.0, receiver_reflectance=0.0)
    maps, told = run(asked)
    assert maps.mean() + told["lost"] + told["truncated"] == pytest.approx(1.0, abs=1e-6)
    assert told["lost"] + told["truncated"] < 2e-3


@pytest.mark.usefixtures("mitsuba")
def test_mitsuba_meets_the_golden_mean_and_cut_of_a_lambertian_top() -> None:
    """Case A: mean and each bin of the cut within three and four joint standard errors of the golden program."""
    found, expected = traced("A"), golden("A")
    off = found["mean"] - expected["mean"]["own Monte Carlo, 8 M histories"]
    assert abs(off) < 3 * np.hypot(found["mean_se"], GOLDEN_MEAN_SE["A"])
    wanted = np.array(expected["cut"]["own Monte Carlo"])
    assert np.all(abs(found["cut"] - wanted) < 4 * np.hypot(found["cut_se"], GOLDEN_CUT_SE["A"] * wanted))


@pytest.mark.slow
@pytest.mark.usefixtures("mitsuba")
def test_mitsuba_meets_the_golden_mean_and_cut_of_volume_emission() -> None:
    """Case B without a cap: mean and cut as for case A; what was lost or truncated is far below the error."""
    found, expected = traced("B"), golden("B")
    off = found["mean"] - expected["mean"]["own Monte Carlo, no bounce cap"]
    assert abs(off) < 3 * np.hypot(found["mean_se"], GOLDEN_MEAN_SE["B"])
    wanted = np.array(expected["cut"]["own Monte Carlo, 1 M"])
    assert np.all(abs(found["cut"] - wanted) < 4 * np.hypot(found["cut_se"], GOLDEN_CUT_SE["B"]))
    assert found["lost"] + found["truncated"] < 0.2 * found["mean_se"]


@pytest.mark.slow
@pytest.mark.usefixtures("mitsuba")
def test_the_built_in_path_integrator_agrees_with_the_particle_loop() -> None:
    """Traced backwards by Mitsuba alone, with the lobe's roles exchanged, case A has the same mean to 4 errors."""
    path = mitsuba_row(Asked(code="path", histories=8_000_000))
    forward = traced("A")
    assert abs(path["mean"] - forward["mean"]) < 4 * np.hypot(path["mean_se"], forward["mean_se"])
    assert path["mean_se"] < 0.02


def test_a_process_that_aborts_is_an_error_here_and_no_end_of_this_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """An abort in Mitsuba's process is told with its last words, and makes Mitsuba missing."""
    aborting = tmp_path / "python"
    aborting.write_text("#!/bin/sh\necho 'LLVM ERROR: Cannot select' >&2\nkill -ABRT $$\n")
    aborting.chmod(0o755)
    monkeypatch.setenv("LUXLOOP_MITSUBA_PYTHON", str(aborting))
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(aborting))
    with pytest.raises(MitsubaError, match=r"ended with -6: LLVM ERROR"):
        run(Asked())
    assert "libllvm19" in str(mitsuba_cell.missing())


def test_only_a_new_enough_libllvm_is_taken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of several libraries the newest from 19 on is taken, a named one before it; 15 is none, even if named."""
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    old, new = tmp_path / "libLLVM-15.so.1", tmp_path / "libLLVM.so.19.1"
    old.touch()
    assert libllvm([str(tmp_path)]) is None
    new.touch()
    (tmp_path / "libLLVM.so.22.1").touch()
    assert libllvm([str(tmp_path)]) == tmp_path / "libLLVM.so.22.1"
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(new))
    assert libllvm([str(tmp_path)]) == new
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(old))
    assert libllvm([str(tmp_path)]) is None


def test_folding_keeps_the_mean_and_makes_the_map_symmetric() -> None:
    """A random map folded has the same mean, is its own mirror image and transpose, and folds onto itself."""
    maps = np.random.default_rng(3).random((2, 64, 64))
    once = folded(maps)
    assert once.mean((1, 2)) == pytest.approx(maps.mean((1, 2)))
    for image in (once[:, ::-1], once[:, :, ::-1], once.swapaxes(1, 2), folded(once)):
        assert image == pytest.approx(once)


def test_the_cut_runs_from_the_chip_to_the_cells_edge_beside_the_line_through_the_chips() -> None:
    """A map that falls with |x| + |y| from the chip has a falling cut whose first bin holds the middle of the map."""
    middle = abs(np.arange(64) - 31.5)
    along = cut(-(middle[:, None] + middle[None, :])[None])[0]
    assert np.diff(along) == pytest.approx(np.full(7, -4.0))
    assert along[0] == pytest.approx(-2 * 1.5 - 1.0)


def test_the_time_to_one_percent_is_that_of_poisson_counts() -> None:
    """Counts of 100 in each bin from all batches have 10 % error: 1 % takes 100 times as long."""
    counts = np.random.default_rng(4).poisson(100 / 32, (32, 64, 64)) * 32 / 100
    found = row("A", "counts", counts, histories=100 * 64 * 64, seconds=2.0)
    assert found["seconds_to_one_percent"] == pytest.approx(200.0, rel=0.02)
    assert found["mean"] == pytest.approx(1.0, abs=4 * found["mean_se"])
