"""The pages of a diagnosis and of a ladder: whole, alone, the document's words and numbers, the same bytes twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.pages import Parsed, loads_nothing, picture_loads_nothing
from viewer.diagnosis import draw, draw_ladder, page_of
from viewer.diagnosis_figures import ladder_figure, scores_figure
from viewer.look import GREY, ORANGE, svg

COMMAND = "luxloop diagnose --model model.toml --page diagnosis.html"
SENTENCE = "edge_walls explains 97 +- 2 %: reflectance 0.28 +- 0.01."
HELD = "But films.a.layers.0.thickness_nm is held at 28.76."
HOSTILE = "<script>alert(1)</script> & more"
SECTIONS = ["effects", "images", "where", "scores", "parameters", "confounding", "next", "provenance"]
BEGINNINGS = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}


def effect(name: str, drop: float, **changes: Any) -> dict[str, Any]:
    """An effect that was added and fitted."""
    return {"name": name, "stage": "geometry", "shape": {}, "chi2_drop": drop, "plausible": True, "why_not": "",
            "size": {"reflectance": {"value": 0.2812, "error": 0.0104, "unit": ""}},
            "explained_share": 0.97, "explained_share_error": 0.02, "held_out_before": 2.41, "held_out_after": 0.83,
            "held_out_density_change": 1.0, "held_out_density_error": 0.1, "log_evidence": 812.4, "p_left": 0.44,
            "sigma": 41.0, "sigma_rival": {}, "group": []} | changes  # fmt: skip


def score(name: str, z: float) -> dict[str, Any]:
    """An effect by itself."""
    return {"name": name, "stage": "geometry", "z": z, "p": 0.001, "chi2_drop": z * z, "size": 0.3, "error": 0.01,
            "score_variable": "value", "parameter": "reflectance", "left": 0.4}  # fmt: skip


def candidate(words: str, sigma: float) -> dict[str, Any]:
    """A measurement that could be made."""
    return {"words": words, "sample": {"id": "next"}, "exposure_ratio": 1.0, "expected_sigma": sigma,
            "now_sigma": 4.5, "stanza": '[[samples]]\nid = "next"'}  # fmt: skip


def diagnosis(**changes: Any) -> dict[str, Any]:
    """What `luxloop diagnose` hands to the viewer."""
    candidates = [candidate("an array at D = 100 um", 23.5), candidate("the same once more", 5.1)]
    return {
        "command": COMMAND, "verdict": "cannot_tell_apart", "sentence": SENTENCE,
        "model": {"file": "model.toml", "name": "paper", "sha256": "a" * 64},
        "dataset": {"path": "data", "name": "paper-like set", "sha256": "b" * 64},
        "solver": {"method": "anchored", "histories": 4_000_000, "seed": 1},
        "structure": {"p": 0.0001, "p_text": "< 1/10000", "z": 31.0, "statistic": 31.0,
                      "where": [{"shot": "array-0", "family": "field radius", "region": "edge", "z": 31.0}]},
        "effects": [
            effect("edge_walls", 1650.0),
            effect("vignetting", 900.0, plausible=False, why_not="implausible", log_evidence=None),
        ],
        "scores": [score("edge_walls", 40.6), score("vignetting", -30.0), score("dead_chip", 2.0)],
        "scores_p": 4e-187, "untestable": ["current_crowding"], "set": ["edge_walls", "vignetting"],
        "groups": [["edge_walls", "vignetting"]],
        "confounding": {"names": ["edge_walls", "vignetting", "dead_chip"],
                        "cosines": [[1.0, -0.93, 0.1], [-0.93, 1.0, 0.2], [0.1, 0.2, 1.0]]},
        "added": [], "next_measurement": candidates[0], "candidates": candidates, "known": 40,
        "limits": [{"name": "dead_chip", "parameter": "weakness", "value": 0.0123, "unit": ""}],
        "shots": [{"id": "array-0", "kind": "image", "sample": "array-0", "pixel_um": 24.0, "dbr_pairs": 2.5,
                   "centre_px": [5.5, 5.5], "binning": 4, "shift_um": [0.0, 0.0]}],
        "parameters": [{"path": "environment.receiver.reflectance", "value": 0.41, "error": 0.006, "at_limit": True,
                        "prior_mean": 0.35, "prior_sd": 0.05, "with": 0.352, "with_error": 0.004}],
        "seed": 1, "versions": {"luxloop": "0.1.0"}, "not_tested": [], "held": [{"words": HELD}],
    } | changes  # fmt: skip


def nothing(**changes: Any) -> dict[str, Any]:
    """A diagnosis that found nothing."""
    gone: dict[str, Any] = {"effects": [], "set": [], "groups": [], "candidates": [], "next_measurement": None}
    return diagnosis(verdict="nothing_visible", sentence="No missing effect visible.", **gone | changes)


def arrays() -> dict[str, NDArray[Any]]:
    """One image, its residuals without and with the best effect."""
    light = 100.0 + 50.0 * np.outer(np.hanning(12), np.hanning(12))
    z = np.random.default_rng(3).standard_normal(light.shape)
    return {"array-0/measured_dn": light + z, "array-0/model_dn": light, "array-0/z": 3.0 * z, "array-0/z_with": z}


def ladder(**changes: Any) -> dict[str, Any]:
    """What `luxloop ladder` hands to the viewer: before, with an effect, and a version that nobody tried held out."""
    rows = [(1, "compare data", 2.41, 2.5, 0.0001, []), (2, "add edge_walls", 0.83, 0.85, 0.42, ["edge_walls"]),
            (3, "calibrate", 0.82, None, 0.5, ["edge_walls"])]  # fmt: skip
    return {
        "model": {"file": "model.toml"},
        "rungs": [{"version": version, "command": command, "fitted_percent": fitted, "held_out_percent": held,
                   "noise_percent": 0.79, "p": p, "effects": effects}
                  for version, command, fitted, held, p, effects in rows],
        "parameters": [{"path": "environment.receiver.reflectance", "prior": "0.35 +- 0.05",
                        "values": ["0.41", "0.352", "0.351"]}],
    } | changes  # fmt: skip


@pytest.fixture(scope="module")
def whole() -> tuple[Parsed, str]:
    """The page of a diagnosis with all there can be, taken apart, and as written."""
    page = page_of(diagnosis(), arrays())
    return Parsed(page), page


def test_a_page_is_whole_and_loads_nothing(whole: tuple[Parsed, str]) -> None:
    """All sections, each led to; measured, model, three residuals, scores, cosines and what to measure."""
    parsed = loads_nothing(whole[1])
    assert parsed.attributes("id") == SECTIONS
    assert len(parsed.pictures) == 5 + 1 + 1 + 1
    maps = ["measured (DN)", "model (DN)", "noise alone, an example"]
    maps += [f"residual {with_it} edge_walls (sigma)" for with_it in ("without", "with")]
    assert parsed.attributes("alt")[:5] == maps
    for picture in parsed.pictures:
        picture_loads_nothing(picture)


def test_the_verdict_stands_first(whole: tuple[Parsed, str]) -> None:
    """The sentence before every section, as the lead of the page; numbers that are held follow at once."""
    assert f'<p class="lead">{SENTENCE}</p>' in whole[1]
    assert whole[1].index(SENTENCE) < whole[1].index(HELD) < whole[1].index("<nav>")


def test_warnings_stand_below_the_sentence() -> None:
    """Of faults of the data; documents of earlier versions have none."""
    page = page_of(diagnosis(warnings=["look at <data>"]), arrays())
    assert page.index(SENTENCE) < page.index("Warning: look at &lt;data&gt;.") < page.index("<nav>")
    assert "Warning" not in page_of(diagnosis(), arrays())


def test_the_tables_hold_the_numbers_of_the_document(whole: tuple[Parsed, str]) -> None:
    """Size, drop, share, held-out error, evidence, the parameter that moves back, the stanza, where it comes from."""
    for told in ("edge_walls reflectance 0.281 ± 0.01 1650 97 ± 2 2.41 → 0.83 812 0.44",
                 "vignetting (implausible)", "< 1e-09", "edge array-0 field radius +31.0", "< 1/10000",
                 "binned pixels: of the camera's, array-0 4 a side.",
                 "environment.receiver.reflectance 0.41 ± 0.006 (at its limit) 0.352 ± 0.004 0.35 ± 0.05",
                 "Not testable with these data: current_crowding", "Take an array at D = 100 um",
                 '[[samples]] id = "next"', "a" * 64, "b" * 64, COMMAND):  # fmt: skip
        assert told in whole[0].text, told


def test_a_held_out_test_that_was_not_possible_is_no_number() -> None:
    """A dash in the table, nothing among the highlights."""
    alone = effect("edge_walls", 1650.0, held_out_before=None, held_out_after=None)
    text = Parsed(page_of(diagnosis(effects=[alone], set=["edge_walls"]), {})).text
    assert "97 ± 2 - 812" in text
    assert "left out of the fit" not in text


def test_a_share_that_is_known_well_has_decimals() -> None:
    """Whole percents would say that it is known exactly."""
    for error, told in ((0.0095, "7 ± 1"), (0.0043, "7.1 ± 0.4"), (0.0004, "7.12 ± 0.04"), (0.0, "7.12 ± 0.00")):
        known = effect("edge_walls", 1650.0, explained_share=0.0712, explained_share_error=error)
        assert f"1650 {told} " in Parsed(page_of(diagnosis(effects=[known], set=["edge_walls"]), {})).text


def test_where_nothing_is_visible_the_page_says_what_would_have_been() -> None:
    """Limits instead of effects; no section stands empty, and without arrays none of images."""
    parsed = loads_nothing(page_of(nothing(), {}))
    assert "dead_chip weakness 0.0123" in parsed.text
    assert parsed.attributes("id") == [name for name in SECTIONS if name not in ("images", "next")]


def test_a_diagnosis_of_spectra_alone_has_a_page() -> None:
    """No image, one effect, nothing to be mistaken for."""
    lonely = {"names": ["film_interlayer"], "cosines": [[1.0]]}
    page = page_of(diagnosis(shots=[], confounding=lonely, groups=[], candidates=[], next_measurement=None), {})
    assert loads_nothing(page).attributes("id") == ["effects", "where", "scores", "parameters", "provenance"]


def test_words_of_others_cannot_break_the_page() -> None:
    """Markup in an effect's name, in a sentence, in a place: shown as it is, also within the pictures."""
    document = diagnosis(
        sentence=HOSTILE, effects=[effect(HOSTILE, 9.0)], scores=[score(HOSTILE, 3.0)], set=[HOSTILE]
    )
    document["structure"]["where"][0]["region"] = HOSTILE
    document["confounding"] = {"names": [HOSTILE, "dead_chip"], "cosines": [[1.0, 0.1], [0.1, 1.0]]}
    document["groups"] = []
    parsed = loads_nothing(page_of(document, arrays()))
    assert parsed.text.count(HOSTILE) >= 3
    for picture in parsed.pictures:
        picture_loads_nothing(picture)


def test_the_bars_are_the_scores_and_the_named_are_marked() -> None:
    """Their length is the root of chi2's drop, the strongest on top; named ones in one colour, not tried in grey."""
    (axes,) = scores_figure(diagnosis()).axes
    bars: list[Any] = list(axes.patches)
    assert [bar.get_width() for bar in bars] == [2.0, 30.0, 40.6]
    colours = [_hex(bar.get_facecolor()) for bar in bars]
    assert colours == [GREY, ORANGE, ORANGE]


def test_a_sign_that_an_effect_cannot_have_is_no_bar_and_the_named_are_always_drawn() -> None:
    """A loss of 8 sigma where only a gain can be stood among the strongest; the second named was the 16th of all."""
    scores = [score(f"effect_{k:02d}", 20.0 - k) for k in range(18)] + [score("gain", -8.0) | {"chi2_drop": 0.0}]
    (axes,) = scores_figure(diagnosis(scores=scores, set=["effect_00", "effect_15"], effects=[])).axes
    assert [label.get_text() for label in axes.get_yticklabels()][:2] == ["effect_15", "effect_13"]
    assert [bar.get_width() for bar in list(axes.patches)[:2]] == [5.0, 7.0]
    (axes,) = scores_figure(diagnosis(scores=scores[-3:])).axes
    assert [bar.get_width() for bar in axes.patches] == [0.0, 3.0, 4.0]


def test_only_pictures_of_the_page_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measured, model and noise; three more of each image had been drawn for nothing."""
    drawn = []

    def counted(figure: Any) -> bytes:
        drawn.append(figure)
        return svg(figure)

    monkeypatch.setattr("viewer.comparison_images.svg", counted)
    page_of(diagnosis(), arrays())
    assert len(drawn) == 3


def test_the_same_document_gives_the_same_bytes(tmp_path: Path, whole: tuple[Parsed, str]) -> None:
    """Twice the same page, and that is what lies in the file."""
    draw(diagnosis(), arrays(), tmp_path / "one.html")
    assert (tmp_path / "one.html").read_bytes() == whole[1].encode()


@pytest.mark.parametrize("ending", sorted(BEGINNINGS))
def test_a_picture_is_of_the_kind_its_name_says(tmp_path: Path, ending: str) -> None:
    """Scores and ladder as PNG, PDF and SVG, the same bytes twice."""
    for name, drawn, document in (("scores", draw, diagnosis()), ("ladder", draw_ladder, ladder())):
        paths = [tmp_path / f"{name}-{i}{ending}" for i in range(2)]
        for path in paths:
            drawn(document, {}, path)
        assert paths[0].read_bytes().startswith(BEGINNINGS[ending])
        assert paths[0].read_bytes() == paths[1].read_bytes()


def test_the_page_of_a_ladder_has_every_rung(tmp_path: Path) -> None:
    """A row per version with errors, noise and p, a dash for what was not tried, and what moved."""
    path = tmp_path / "ladder.html"
    draw_ladder(ladder(), {}, path)
    parsed = loads_nothing(path.read_text(encoding="utf-8"))
    for told in ("1 compare data 2.41 2.5 0.79 0.0001 -", "2 add edge_walls 0.83 0.85 0.79 0.42 edge_walls",
                 "3 calibrate 0.82 - 0.79 0.5 edge_walls",
                 "environment.receiver.reflectance 0.35 +- 0.05 0.41 0.352 0.351"):  # fmt: skip
        assert told in parsed.text, told
    (picture,) = parsed.pictures
    picture_loads_nothing(picture)


def test_the_page_of_a_ladder_has_the_curves_that_are_beside_images(tmp_path: Path) -> None:
    """Their error, held-out error and noise; a dash for a version that has none."""
    document, path = ladder(), tmp_path / "ladder.html"
    document["rungs"][1] |= {
        "curves_fitted_percent": 0.31,
        "curves_held_out_percent": 0.33,
        "curves_noise_percent": 0.3,
    }
    draw_ladder(document, {}, path)
    parsed = loads_nothing(path.read_text(encoding="utf-8"))
    for told in ("error of curves (%)", "1 compare data 2.41 2.5 0.79 - - - 0.0001 -",
                 "2 add edge_walls 0.83 0.85 0.79 0.31 0.33 0.3 0.42 edge_walls"):  # fmt: skip
        assert told in parsed.text, told


def test_the_bars_of_a_ladder_are_its_errors() -> None:
    """Fitted and held out by version, no bar where there is no number, the noise as a line."""
    (axes,) = ladder_figure(ladder()).axes
    bars: list[Any] = list(axes.patches)
    heights = [bar.get_height() for bar in bars]
    assert heights == pytest.approx([2.41, 0.83, 0.82, 2.5, 0.85, np.nan], nan_ok=True)
    (noise,) = axes.get_lines()
    assert list(np.asarray(noise.get_ydata())) == [0.79] * 3


def _hex(colour: Any) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in colour[:3])
