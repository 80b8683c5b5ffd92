"""The page of a blind test: whole, alone, its table and maps, the same bytes twice."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxloop.errors import InputError
from tests.pages import Parsed, loads_nothing
from tests.validation.blind_test.pretend import answer, folder_of, hiding, record
from validation.blind_test.folders import SEAL, SETS
from validation.blind_test.judging import packed
from validation.blind_test.records import maps_path
from validation.blind_test.scoring import maps_of, names_of, score
from validation.blind_test.seals import Hiding
from viewer.blind import confusion_figure, draw, page_of
from viewer.blind import maps_of as maps_of_set

HOSTILE = "<script>alert(1)</script>"


@pytest.fixture
def scored(tmp_path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """A right verdict, and a wrong one with its residuals."""
    folder = folder_of(
        tmp_path / "out",
        (answer("set-1", hiding("vignetting", rivals={"dead_chip": 4.0})), record("one_effect", "vignetting")),
        (answer("set-2", hiding(kind="coma")), record("one_effect", "camera_psf", sentence=HOSTILE)),
        (answer("set-3"), None),
    )
    random = np.random.default_rng(1)
    maps = {f"{shot}/{kind}": random.standard_normal((12, 12)).astype(np.float16)
            for shot in ("single-0", "array-0") for kind in ("z", "z_with")}  # fmt: skip
    maps_path(folder, "set-2").write_bytes(packed(maps))
    document = score([folder])
    return document, maps_of(document["misses"])


def test_the_page_tells_the_whole_score(scored: tuple[dict[str, Any], dict[str, Any]]) -> None:
    """Every row of the table, the missed set with its residuals, both confusions; nothing is loaded."""
    page = page_of(*scored)
    loads_nothing(page)
    for row in scored[0]["table"]:
        assert row["quantity"].replace(">", "&gt;").replace("<", "&lt;").replace("'", "&#x27;") in page
    assert scored[0]["sentence"] in page
    assert "set-2: outside: coma" in page
    assert "1 more that were asked for have no verdict" in page
    assert HOSTILE not in page
    assert len(re.findall(r"Residuals of [\w.-]+/set-2", page)) == 1
    assert "Residuals of set-1" not in page
    assert {"table", "confusion", "misses", "sets", "provenance"} <= set(Parsed(page).attributes("id"))
    assert page == page_of(*scored)


def test_sets_of_two_folders_are_told_apart(tmp_path: Path) -> None:
    """By as much of the paths as it takes; a further set is said to be one."""
    first = folder_of(tmp_path / "a" / "sets", (answer("set-1", hiding("vignetting")), record("nothing_visible")))
    follows = json.loads((first / SETS / "set-1" / SEAL).read_text())["sha256"]
    later = answer("set-1", hiding("vignetting"), follows=follows, dataset_sha256="e" * 64)
    further = folder_of(tmp_path / "b" / "sets", (later, record("one_effect", "vignetting")))
    page = page_of(score([first, further]), {})
    assert "<h1>Blind test of 1 sets</h1>" in page
    assert "1 further sets, with the image that a verdict proposed" in page
    assert "<h3>a/sets/set-1: vignetting</h3>" in page
    rows = dict(re.findall(r"<tr><td>([ab]/sets/set-1)</td>(.*?)</tr>", page))
    assert re.findall(r">(missed|further)<", rows["a/sets/set-1"]) == ["missed"]
    assert re.findall(r">(missed|further)<", rows["b/sets/set-1"]) == ["further"]
    assert names_of(["out", "sets/a"]) == {"out": "out", "sets/a": "a"}


def test_residuals_are_those_of_the_set(scored: tuple[dict[str, Any], dict[str, Any]]) -> None:
    """By shot, without and with the effect that was named; none for a set without maps."""
    document, arrays = scored
    (missed,) = document["misses"]
    without, with_it = maps_of_set(missed, arrays)
    assert set(without) == set(with_it) == {"single-0", "array-0"}
    assert not np.array_equal(without["single-0"], with_it["single-0"])
    assert maps_of_set(missed | {"id": "set-9"}, arrays) == []


def test_the_map_of_who_was_taken_for_whom(scored: tuple[dict[str, Any], dict[str, Any]], tmp_path: Path) -> None:
    """Counts stand in their cells; the picture is written by its name's ending."""
    figure = confusion_figure(scored[0]["confusion"]["effects"])
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["vignetting", "outside: coma"]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["vignetting", "camera_psf"]
    assert sorted((text.get_position(), text.get_text()) for text in axes.texts) == [((0, 0), "1"), ((1, 1), "1")]
    draw(*scored, tmp_path / "who.png")
    assert (tmp_path / "who.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("hidden", [(), (hiding("vignetting"), hiding("dead_chip"))])
def test_no_picture_of_sets_without_one_thing_hidden(tmp_path: Path, hidden: tuple[Hiding, ...]) -> None:
    """The map has no rows then; a page has all else."""
    folder = folder_of(tmp_path / "out", (answer("set-1", *hidden), record("nothing_visible")))
    document = score([folder])
    with pytest.raises(InputError, match=r"--page.*one thing hidden.*\.html"):
        draw(document, {}, tmp_path / "who.png")
    draw(document, {}, tmp_path / "who.html")
