"""The page of a calibration: whole, alone, the document's numbers, warnings in words, the same bytes twice."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.pages import Parsed, loads_nothing, picture_loads_nothing
from viewer.calibration import draw, page_of
from viewer.calibration_figures import all_stages, error_figure

COMMAND = "luxloop calibrate data --model model.toml"
BEGINNINGS = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}
KINDS = ("Gaussian 0 deg", "Gaussian 5 deg", "Gaussian 10 deg", "Gaussian 15 deg", "Lambertian")
SHOTS = [f"{kind}-{pairs}" for kind in ("single", "array") for pairs in ("0", "2.5", "5.5")]
PATHS = ("environment.substrate.reflectance", "environment.receiver.reflectance",
         "environment.chip_absorption_per_cm")  # fmt: skip


def stage(name: str, parameter: str, grid: Any, best: tuple[str, float]) -> dict[str, Any]:
    """Curves with their smallest value at `best`, each kind of scatter a little above another."""
    apart = {kind: 0.2 * abs(i - KINDS.index(best[0])) for i, kind in enumerate(KINDS)}
    curves = [
        {"label": kind, "x": [*grid], "mse": [0.7 + rise + 900.0 * (x - best[1]) ** 2 for x in grid],
         "chi2_per_pixel": [1.0 + rise + 1200.0 * (x - best[1]) ** 2 for x in grid]} for kind, rise in apart.items()
    ]  # fmt: skip
    return {"name": name, "parameter": parameter, "curves": curves,
            "best": {"label": best[0], "x": best[1], "mse": 0.7}}  # fmt: skip


def parameter(path: str, value: float, error: float, **changes: Any) -> dict[str, Any]:
    """A fitted parameter with its interval and prior."""
    return {"path": path, "unit": "1/cm" if path.endswith("per_cm") else "1", "start": 0.9 * value, "value": value,
            "error": error, "lower95": value - 1.96 * error, "upper95": value + 1.96 * error,
            "prior_mean": 0.95 * value, "prior_sd": 0.1 * value, "at_limit": False} | changes  # fmt: skip


def calibration(**changes: Any) -> dict[str, Any]:
    """What `luxloop calibrate` hands to the viewer."""
    parameters = [parameter(PATHS[0], 0.9703, 0.0012), parameter(PATHS[1], 0.352, 0.004),
                  parameter(PATHS[2], 21.0, 3.0)]  # fmt: skip
    profiles = [
        {"path": one["path"], "x": [*(one["value"] + one["error"] * np.linspace(-3.0, 3.0, 13))],
         "chi2": [*(24_000.0 + np.linspace(-3.0, 3.0, 13) ** 2)]} for one in parameters
    ]  # fmt: skip
    noise = {shot: 2.7 if shot.startswith("single") else 0.5 for shot in SHOTS}
    return {
        "command": COMMAND, "sentence": "Substrate: Gaussian 5 deg with 97 %; receiver: Lambertian with 35 %",
        "model": {"file": "model.toml", "name": "paper", "sha256": "a" * 64},
        "dataset": {"path": "data", "name": "paper-like set", "sha256": "b" * 64},
        "solver": {"method": "twin", "histories": None, "seed": 7}, "trusted": True, "reason": "",
        "stages": [
            stage("single chips: the substrate", PATHS[0], np.arange(93, 100) / 100.0, (KINDS[1], 0.97)),
            stage("arrays: the receiver", PATHS[1], np.arange(20, 41, 5) / 100.0, (KINDS[4], 0.35)),
        ],
        "rounds": [{"round": i, "substrate": "Gaussian 5 deg, 97 %", "receiver": "Lambertian, 35 %", "mse": 0.8 / i}
                   for i in (1, 2)],
        "fit": {"parameters": parameters, "correlation": [[1.0, -0.971, 0.2], [-0.971, 1.0, 0.1], [0.2, 0.1, 1.0]],
                "profiles": profiles, "chi2_per_pixel": 1.003, "iterations": 6, "gap": 2e-7},
        "errors": [
            {"model": "before", "rms_error_percent": {shot: 3.1 * noise[shot] for shot in SHOTS},
             "noise_percent": noise},
            {"model": "after", "rms_error_percent": {shot: 1.02 * noise[shot] for shot in SHOTS},
             "noise_percent": noise},
        ],
    } | changes  # fmt: skip


@pytest.fixture(scope="module")
def whole() -> tuple[Parsed, str]:
    """The page of a calibration with all there can be, taken apart, and as written."""
    page = page_of(calibration(), {})
    return Parsed(page), page


def test_a_page_is_whole_and_loads_nothing(whole: tuple[Parsed, str]) -> None:
    """All sections, each led to; two pictures per stage, the pulls, a profile per parameter, the errors."""
    parsed = loads_nothing(whole[1])
    assert parsed.attributes("id") == ["stages", "best", "fit", "correlation", "errors", "provenance"]
    assert len(parsed.pictures) == 2 * 2 + 1 + 3 + 1
    for picture in parsed.pictures:
        picture_loads_nothing(picture)


def test_the_numbers_are_those_of_the_document(whole: tuple[Parsed, str]) -> None:
    """Arg min, fit and paper in one row; interval, prior, rounds, noise, digests and the command."""
    text = whole[0].text
    for told in ("High-reflectivity white bottom surface Gaussian 5 deg, 97 % 97.03 ± 0.12 % Gaussian 5°, 97 %",
                 "Receiver reflectivity Lambertian, 35 % 35.20 ± 0.40 % Lambertian, 35 %", "0.96795 to 0.97265",
                 "0.9218 ± 0.097", "2 Gaussian 5 deg, 97 % Lambertian, 35 % 0.4",
                 "single-0 8.37 % 2.7 % 2.75 % 2.7 %",
                 "6 iterations", "a" * 64, "b" * 64, COMMAND, "twin (deterministic"):  # fmt: skip
        assert told in text


def test_a_strong_correlation_is_said_in_words(whole: tuple[Parsed, str]) -> None:
    """The pair and the number; the third parameter is in no warning."""
    told = [line for line in re.findall(r'<p class="note">(.*?)</p>', whole[1]) if "correlated" in line]
    assert len(told) == 1
    assert "substrate, reflectance and receiver, reflectance are correlated by -0.971" in told[0]
    calm = calibration()
    calm["fit"]["correlation"] = np.eye(3).tolist()
    text = Parsed(page_of(calm, {})).text
    assert "are correlated" not in text
    assert "None is above 0.95" in text


def test_every_figure_says_its_error_and_its_command(whole: tuple[Parsed, str]) -> None:
    """Each caption names an error, an interval or noise, and the command."""
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", whole[1], re.DOTALL)
    assert len(captions) == 2 + 1 + 1 + 1
    for caption in captions:
        assert re.search("error|interval|noise", caption)
        assert COMMAND in caption


def test_the_arg_min_is_marked_where_it_lies() -> None:
    """A ring at the smallest MSE of each stage, and axes in percent."""
    figure = all_stages(calibration())
    for axes, (x, mse) in zip(figure.axes, ((0.97, 0.7), (0.35, 0.7)), strict=True):
        (ring,) = [line for line in axes.get_lines() if line.get_fillstyle() == "none"]
        assert ring.get_xydata() == pytest.approx(np.array([[x, mse]]))
        assert axes.xaxis.get_major_formatter()(0.35).endswith("%")


@pytest.mark.parametrize("ending", sorted(BEGINNINGS))
def test_a_picture_is_of_the_kind_its_name_says(tmp_path: Path, ending: str) -> None:
    """The curves of Fig. 5 as PNG, PDF and SVG, the same bytes twice."""
    paths = [tmp_path / f"{name}{ending}" for name in "ab"]
    for path in paths:
        draw(calibration(), {}, path)
    assert paths[0].read_bytes().startswith(BEGINNINGS[ending])
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_the_same_document_gives_the_same_bytes(tmp_path: Path, whole: tuple[Parsed, str]) -> None:
    """Twice the same page, and that is what lies in the file."""
    draw(calibration(), {}, tmp_path / "one.html")
    assert (tmp_path / "one.html").read_bytes() == whole[1].encode()


def test_a_parameter_at_its_limit_is_not_trusted() -> None:
    """Said at the top with the reason, and in the table."""
    document = calibration(trusted=False, reason="the substrate's reflectance is at its limit")
    document["fit"]["parameters"][0]["at_limit"] = True
    text = Parsed(page_of(document, {})).text
    assert "The fit itself is not trustworthy: the substrate's reflectance is at its limit. Mend this first." in text
    assert text.count("at its limit") == 2 + 1  # and once in the caption, with a capital


def test_warnings_are_said_at_the_top() -> None:
    """Of faults of the data; documents of earlier versions have none."""
    page = page_of(calibration(warnings=["look"]), {})
    assert page.index("Warning: look.") < page.index("<nav>")
    assert "Warning" not in page_of(calibration(), {})


def test_the_grid_alone_and_the_fit_alone_have_pages() -> None:
    """No section stands empty where a part was not asked for."""
    grid = loads_nothing(page_of(calibration(fit=None, errors=[]), {}))
    assert grid.attributes("id") == ["stages", "best", "provenance"]
    assert "not free" in grid.text
    fit = loads_nothing(page_of(calibration(stages=[], rounds=[]), {}))
    assert fit.attributes("id") == ["fit", "correlation", "errors", "provenance"]


def test_a_parameter_without_a_prior_is_said_to_have_none() -> None:
    """It has a row, and no place among the pulls."""
    document = calibration()
    for one in document["fit"]["parameters"]:
        one |= {"prior_mean": None, "prior_sd": None}
    parsed = Parsed(page_of(document, {}))
    assert "none" in parsed.text
    assert len(parsed.pictures) == 2 * 2 + 3 + 1


def test_words_of_others_cannot_break_the_page() -> None:
    """Markup in the name of a stage is shown as it is."""
    document = calibration()
    document["stages"][0]["name"] = "<script>alert(1)</script> & more"
    parsed = loads_nothing(page_of(document, {}))
    assert "<script>alert(1)</script> & more" in parsed.text


def test_errors_of_angles_are_told_in_degrees() -> None:
    """Their shots have axes of their own, and their unit in the table."""
    document = calibration(shots=[{"id": SHOTS[0], "unit": "deg"}, {"id": SHOTS[1], "unit": "1"}])
    text = Parsed(page_of(document, {})).text
    assert f"{SHOTS[0]} 8.37 deg 2.7 deg 2.75 deg 2.7 deg" in text
    assert f"{SHOTS[1]} 8.37 % 2.7 %" in text
    figure = error_figure({one["model"]: one for one in document["errors"]}, {SHOTS[0]: "deg"})
    assert [axes.get_xlabel() for axes in figure.axes] == ["rms error (deg)", "rms error (%)"]
    assert [len(axes.get_yticks()) for axes in figure.axes] == [1, len(SHOTS) - 1]


def test_the_picture_of_a_fit_alone_is_of_its_errors(tmp_path: Path) -> None:
    """There are no curves of Fig. 5 then: each shot before and after, under the sentence."""
    document = calibration(stages=[], rounds=[], shots=[{"id": SHOTS[0], "unit": "deg"}])
    draw(document, {}, tmp_path / "fit.svg")
    picture = (tmp_path / "fit.svg").read_text(encoding="utf-8")
    for told in (*SHOTS, "rms error (deg)", "rms error (%)", "before", document["sentence"]):
        assert f">{told}</text>" in picture
