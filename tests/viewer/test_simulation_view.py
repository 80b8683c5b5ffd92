"""The picture of a simulation: its map lies as the light does, with no warning, in the format of its name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from viewer.simulation import draw

BEGINNINGS = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}
ENDS = ("chip", "substrate", "dbr", "receiver", "edge", "trapped", "roulette", "emitted")


def document(**changes: Any) -> dict[str, Any]:
    """What `luxloop simulate` hands to the viewer."""
    one = {"value": 0.9, "standard_error": 0.003, "bias": -0.001, "truncation": 0.0}
    return {
        "design": {
            "distance_um": 180.0,
            "width_um": 28.0,
            "spacing_um": 500.0,
            "thickness_um": 35.0,
            "dbr_pairs": 6.5,
        },
        "array": None,
        "model": {"name": "paper"},
        "histories": 32768,
        "metrics": {"uniformity": one, "mean_illuminance_lx": one | {"value": 1e5, "standard_error": 20.0}},
        "ledger": {name: {"value": 0.1, "standard_error": 0.001} for name in ENDS},
        "map": {"x_um": [-500.0, 500.0], "y_um": [-250.0, 250.0]},
        "cut": {"y_um": 0.0, "window_um": [-250.0, 250.0]},
    } | changes


def arrays(level: float = 1e5) -> dict[str, Any]:
    """A map (y, x) that is brightest at the lowest y, and a cut with a maximum."""
    x_um = np.linspace(-500.0, 500.0, 401)
    lx = level * (1.0 - 0.2 * (x_um / 500.0) ** 2)
    rows = level * np.linspace(1.0, 0.8, 16)[:, None] * np.ones(32)
    return {
        "map_lx": rows.astype(np.float32),
        "map_error_lx": (0.01 * rows).astype(np.float32),
        "cut_x_um": x_um,
        "cut_lx": lx,
        "cut_error_lx": 0.01 * lx,
    }


def test_a_name_is_no_formula(tmp_path: Path) -> None:
    """What stands between two $ in a model's name is drawn as it is."""
    draw(document(model={"name": "a$x_$b"}), arrays(), tmp_path / "map.svg")
    assert "a$x_$b" in (tmp_path / "map.svg").read_text()


@pytest.mark.parametrize("ending", sorted(BEGINNINGS))
@pytest.mark.parametrize("array", [None, {"rows": 1, "columns": 2}])
def test_a_picture_is_of_the_kind_its_name_says(tmp_path: Path, ending: str, array: Any) -> None:
    """PNG, PDF and SVG, of a cell and of a module."""
    path = tmp_path / f"map{ending}"
    draw(document(array=array), arrays(), path)
    assert path.read_bytes().startswith(BEGINNINGS[ending])


@pytest.mark.parametrize("level", [1e5, 0.0])
def test_the_map_lies_as_the_light_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, level: float) -> None:
    """Row 0 at the lowest y, a colour bar in lx; the cut with its window, the ledger with all ends; dark too."""
    seen: dict[str, Any] = {}

    def save(figure: Figure, path: Path, **_: Any) -> None:
        seen.update(axes=figure.axes)
        path.touch()

    monkeypatch.setattr("viewer.simulation.Figure.savefig", save)
    draw(document(), arrays(level), tmp_path / "x.png")
    by_label = {axes.get_xlabel() or axes.get_ylabel(): axes for axes in seen["axes"]}
    (image,) = by_label["x (µm)"].get_images()
    assert image.origin == "lower"
    assert image.get_extent() == [-500.0, 500.0, -250.0, 250.0]
    np.testing.assert_array_equal(image.get_array(), arrays(level)["map_lx"])
    assert "illuminance (lx)" in by_label
    cut = by_label["x (µm) at y = 0 µm"]
    assert cut.get_lines()[0].get_ydata() == pytest.approx(arrays(level)["cut_lx"])
    assert cut.patches[0].get_extents().transformed(cut.transData.inverted()).intervalx == pytest.approx(
        [-250.0, 250.0]
    )
    assert len(by_label["% of the emitted light"].patches) == 6
