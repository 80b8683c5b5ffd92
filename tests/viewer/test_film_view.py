"""The picture of a film: all that was asked for is in it, in the format of its name, with no warning."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from viewer.film import draw

BEGINNINGS = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}


def document(axis: list[float], *curves: list[float], **changes: Any) -> dict[str, Any]:
    """What `luxloop film` hands to the viewer."""
    films = [{"dbr_pairs": 4.5 + number / 2.0, "curve": curve} for number, curve in enumerate(curves)]
    return {
        "films": films,
        "against": "angle",
        "curve_axis": axis,
        "side": "outside",
        "quantity": "R",
        "unit": "1",
        "polarisation": "u",
        "bandwidth_nm": 18.0,
        "wavelength_nm": [445.0],
        "angle_deg": axis,
        "model": {"name": "paper"},
    } | changes


@pytest.mark.parametrize("ending", sorted(BEGINNINGS))
@pytest.mark.parametrize("curves", [[[0.1, 0.2]], [[0.1, 0.9]] * 3])
def test_a_picture_is_of_the_kind_its_name_says(tmp_path: Path, ending: str, curves: list[list[float]]) -> None:
    """PNG, PDF and SVG, of one film and of several."""
    path = tmp_path / f"film{ending}"
    draw(document([0.0, 10.0], *curves), path)
    assert path.read_bytes().startswith(BEGINNINGS[ending])


def test_a_name_is_no_formula(tmp_path: Path) -> None:
    """What stands between two $ in a model's name is drawn as it is."""
    draw(document([0.0, 10.0], [0.1, 0.2], model={"name": "a$x_$b"}), tmp_path / "film.svg")
    assert "a$x_$b" in (tmp_path / "film.svg").read_text()


def test_a_single_angle_is_a_point(tmp_path: Path) -> None:
    """One value is drawn as a mark (warnings are errors here)."""
    draw(document([0.0], [0.6]), tmp_path / "one.svg")
    assert "<use" in (tmp_path / "one.svg").read_text()


@pytest.mark.parametrize(("curve", "top"), [([0.02, 0.013, 0.02], 0.022), ([0.2, 0.9, 0.3], 1.02)])
def test_a_coating_fills_the_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, curve: list[float], top: float
) -> None:
    """A few per cent are not drawn as a flat line at the bottom, and in any order of the axis all of it is seen."""
    seen: dict[str, Any] = {}

    def save(figure: Figure, path: Path, **_: Any) -> None:
        seen.update(axes=figure.axes[0])
        path.touch()

    monkeypatch.setattr("viewer.film.Figure.savefig", save)
    draw(document([60.0, 0.0, 30.0], curve), tmp_path / "x.png")
    assert seen["axes"].get_xlim() == (0.0, 60.0)
    assert seen["axes"].get_ylim() == pytest.approx((0.0, top))
