"""Pictures of effects: every kind is drawn, the page of cosines loads nothing and says its groups."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxloop.errors import InputError
from viewer.effects import _images, draw, draw_confusion, page_of

MAP = {
    "ground": "six example images", "names": ["a_like", "b_like", "alone"], "alike": 0.9, "failed": {},
    "cosines": [[1.0, 0.97, 0.1], [0.97, 1.0, 0.2], [0.1, 0.2, 1.0]], "imitated": ["gone"],
    "sigma": {"a_like": 12.3, "b_like": 4.5, "alone": 6.7}, "groups": [["a_like", "b_like"], ["alone"]],
}  # fmt: skip


def test_an_image_and_a_curve_are_drawn(tmp_path: Path) -> None:
    """A PNG each; by the name's ending a page that loads and runs nothing."""
    base = np.outer(np.hanning(9), np.hanning(9)) + 0.1
    axis = np.linspace(-100.0, 100.0, 9)
    facts = {"effect": "mine", "formula": "$E_$", "values": {"a": 0.1, "gain": [0.1, -0.1], "law": "flat"}}
    document: dict[str, Any] = facts | {"kind": "image", "rms_percent": 1.0, "mean_percent": 0.1}
    draw(document, {"base": base, "with": 1.1 * base, "x_um": axis, "y_um": axis}, tmp_path / "image.png")
    curves = {f"{name}/{which}": np.ones(5) for name in ("R", "T", "psi", "delta") for which in ("base", "with")}
    draw(facts | {"kind": "curve"}, curves | {"wavelength_nm": np.arange(5.0)}, tmp_path / "curve.png")
    draw(facts | {"kind": "curve"}, curves | {"wavelength_nm": np.arange(5.0)}, tmp_path / "curve.html")
    page = (tmp_path / "curve.html").read_text(encoding="utf-8")
    assert "What mine does" in page
    assert "<svg" in page
    assert "<script" not in page
    for name in ("image.png", "curve.png"):
        assert (tmp_path / name).read_bytes()[:4] == b"\x89PNG"


def test_an_image_ends_where_its_last_pixels_do() -> None:
    """Five pixels of 50 um are 0.25 mm, not the 0.2 mm between their centres."""
    base, axis = np.ones((5, 5)), np.linspace(-100.0, 100.0, 5)
    document = {"rms_percent": 1.0, "mean_percent": 0.1}
    figure = _images(document, {"base": base, "with": 1.1 * base, "x_um": axis, "y_um": axis + 10.0})
    ends = [axes.images[0].get_extent() for axes in figure.axes if axes.images and axes.get_xlabel() == "x (mm)"]
    assert len(ends) == 3
    np.testing.assert_allclose(ends, [[-0.125, 0.125, -0.115, 0.135]] * 3)


def test_the_page_of_cosines_has_groups_and_map(tmp_path: Path) -> None:
    """The same document gives the same bytes; no script runs."""
    document = {"model": "paper", "maps": [MAP]}
    page = page_of(document)
    assert page == page_of(document)
    assert "a_like, b_like" in page
    assert "Wholly imitated by calibration: gone" in page
    assert "<script" not in page
    draw_confusion(document, {}, tmp_path / "map.png")
    draw_confusion(document, {}, tmp_path / "map.html")
    assert (tmp_path / "map.html").read_text(encoding="utf-8") == page


def test_where_no_effect_is_left_the_page_says_why_and_a_picture_is_refused(tmp_path: Path) -> None:
    """Imitated and refused effects are told; the picture ended with a traceback."""
    nothing = {"names": [], "cosines": [], "sigma": {}, "groups": [], "failed": {"odd": "no <film>"}}
    document = {"model": "paper", "maps": [MAP | nothing]}
    page = page_of(document)
    assert "Wholly imitated by calibration: gone" in page
    assert "Not predicted: odd: no &lt;film&gt;" in page
    assert "<svg" not in page
    for maps in ([], document["maps"]):
        with pytest.raises(InputError, match="a map with at least one effect"):
            draw_confusion({"maps": maps}, {}, tmp_path / "map.png")
    draw_confusion({"maps": [document["maps"][0], MAP]}, {}, tmp_path / "map.png")
