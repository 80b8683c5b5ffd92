"""The page of a campaign: whole, alone, the journal's numbers, the same bytes twice; of every kind of run."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from agent.report import document_of
from agent.report_command import OF_A_RUN
from luxloop.design import Design
from tests.campaign_runs import START, RunOnDisk, whole_run
from tests.pages import Parsed, loads_nothing, picture_loads_nothing
from viewer.campaign import SECTIONS, draw, page_of


def report(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Document and arrays as the command hands them to the viewer."""
    document, arrays = document_of(folder)
    document["runs"] = [{name: document[name] for name in OF_A_RUN}]
    names = ("walk_evaluations", "walk_best", "walk_best_error")
    more = {f"run_0_{name}": arrays[name] for name in names}
    document |= {"under": None, "report_command": ["luxloop", "campaign", "report", folder.name]}
    return document, arrays | more


def begun(folder: Path) -> None:
    """A run that stopped before its first step."""
    RunOnDisk(folder).close()


def killed(folder: Path) -> None:
    """A run that stopped amid its walk."""
    run = RunOnDisk(folder)
    run.evaluated(START, 0.7)
    run.infeasible(START.model_copy(update={"thickness_um": 55.0, "distance_um": 55.0}), lane=1)
    run.close()


def all_failed(folder: Path) -> None:
    """A run that ended without a result."""
    run = RunOnDisk(folder)
    run.failed(START)
    run.infeasible(START, lane=1)
    run.finish()


def by_the_twin(folder: Path) -> None:
    """A run whose replies have no ledger."""
    run = RunOnDisk(folder)
    run.evaluated(START, 1.0, error=0.0, method="twin")
    run.finish()


RUNS: dict[str, Callable[[Path], object]] = {
    "whole": whole_run, "begun": begun, "killed": killed, "failed": all_failed, "twin": by_the_twin,
}  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Parsed, str]:
    """Document, page taken apart and page of a run with all there can be."""
    folder = tmp_path_factory.mktemp("runs") / "trial"
    whole_run(folder)
    document, arrays = report(folder)
    page = page_of(document, arrays)
    return document, Parsed(page), page


@pytest.mark.parametrize("kind", RUNS)
def test_every_run_has_a_whole_page_that_loads_nothing(tmp_path: Path, kind: str) -> None:
    """All sections, each led to; every tag closed; no script, no address but of what is inside."""
    RUNS[kind](tmp_path / "trial")
    page = page_of(*report(tmp_path / "trial"))
    parsed = loads_nothing(page)
    assert set(parsed.attributes("id")) == set(SECTIONS)
    assert len(page) < 1_000_000


def test_the_pictures_load_nothing_either(whole: tuple[dict[str, Any], Parsed, str]) -> None:
    """Each is well-formed SVG; what it refers to is within it."""
    _, parsed, _ = whole
    assert len(parsed.pictures) == 6
    for picture in parsed.pictures:
        picture_loads_nothing(picture)


def test_the_numbers_are_those_of_the_journal(whole: tuple[dict[str, Any], Parsed, str]) -> None:
    """The steps' values and errors, the combined ones, and the root, as a person reads them."""
    document, parsed, _ = whole
    text = parsed.text
    for row in ("91.20 ± 0.40", "90.50 ± 0.30", "69.51 ± 0.20", "65.00 ± 0.30"):
        assert row in text
    assert "+21.69 ± 0.45 points" in text
    assert "+26.20 ± 0.50 points" in text
    assert "73.120 ± 0.010 %" in text  # absorbed in the chips
    assert "3.120 ± 0.010 %" in text  # through the top
    assert document["chain"]["root"] in text
    assert document["model"]["sha256"] in text
    assert "luxloop campaign run --id trial" in text
    assert "15 steps, 12 different designs" in text


def test_every_figure_says_its_error_and_where_it_comes_from(whole: tuple[dict[str, Any], Parsed, str]) -> None:
    """Each caption names an error and a record or a command."""
    _, _, page = whole
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page, re.DOTALL)
    assert len(captions) == 6
    for caption in captions:
        assert "error" in caption
        assert "Record" in caption


def test_the_same_document_gives_the_same_bytes(tmp_path: Path) -> None:
    """Twice the same page, and that is what lies in the file."""
    whole_run(tmp_path / "trial")
    document, arrays = report(tmp_path / "trial")
    draw(document, arrays, tmp_path / "one.html")
    again, more = report(tmp_path / "trial")
    draw(again, more, tmp_path / "two.html")
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()


def test_what_a_run_lacks_is_said(tmp_path: Path) -> None:
    """Without finalists the best is called what it is: chosen by the noisy numbers that are shown."""
    killed(tmp_path / "trial")
    text = Parsed(page_of(*report(tmp_path / "trial"))).text
    assert "This run was not ended" in text
    assert "No finalist was evaluated anew" in text
    assert "without its DBR was not evaluated" in text


def test_a_run_that_was_gone_on_with_says_by_what(tmp_path: Path) -> None:
    """Beside the command that made it."""
    RunOnDisk(tmp_path / "trial").close()
    RunOnDisk(tmp_path / "trial", argv=["campaign", "resume", "trial"], designer="2-test").close()
    text = Parsed(page_of(*report(tmp_path / "trial"))).text
    assert "luxloop campaign run --id trial" in text
    assert "gone on with by: luxloop campaign resume trial" in " ".join(text.split())


def test_failures_are_told(whole: tuple[dict[str, Any], Parsed, str]) -> None:
    """How many, which and why."""
    assert "1 evaluations failed and are in no figure" in whole[1].text
    assert "ray-1 died three times" in whole[1].text


def test_words_of_others_cannot_break_the_page(tmp_path: Path) -> None:
    """A reason with markup in it is shown as it is."""
    run = RunOnDisk(tmp_path / "trial")
    run.finish("<script>alert(1)</script> & more")
    parsed = Parsed(page_of(*report(tmp_path / "trial")))
    assert "<script>alert(1)</script> & more" in parsed.text
    assert "script" not in {tag for tag, _ in parsed.seen}


def test_winners_under_other_models_stand_with_their_errors(tmp_path: Path) -> None:
    """A row per winner and model, one that cannot be built with its reason, the difference with its error."""
    whole_run(tmp_path / "trial")
    document, arrays = report(tmp_path / "trial")
    estimate = {"value": 0.9, "standard_error": 0.003}
    row = {"run": "trial", "design": START.model_dump(), "f": START.f, "model": "a.toml", "model_sha256": "a" * 64,
           "seed": "5", "reason": "", "uniformity": estimate, "mean_illuminance_lx": estimate,
           "optical_efficiency": estimate, "hot_spot_ratio": estimate, "histories": 1}  # fmt: skip
    change = {"between": "models", "of": "trial", "from": "a.toml", "to": "b.toml",
              "uniformity": {"value": -0.02, "standard_error": 0.005}, "significant": True}  # fmt: skip
    document["under"] = {
        "models": [{"name": name, "sha256": name[0] * 64} for name in ("a.toml", "b.toml")],
        "rows": [row, row | {"model": "b.toml", "reason": "chips overlap"}],
        "differences": [change],
    }
    text = Parsed(page_of(document, arrays)).text
    assert "a.toml 90.00 ± 0.30 %" in text
    assert "b.toml chips overlap" in text
    assert "trial: b.toml minus a.toml -2.00 ± 0.50 yes" in text


def test_several_runs_are_compared(tmp_path: Path) -> None:
    """Two runs give one figure more, and a row each."""
    whole_run(tmp_path / "trial")
    document, arrays = report(tmp_path / "trial")
    document["runs"] = [document["runs"][0], document["runs"][0] | {"run": "other"}]
    arrays |= {name.replace("run_0", "run_1"): arrays[name] for name in list(arrays) if name.startswith("run_0")}
    parsed = Parsed(page_of(document, arrays))
    assert len(parsed.pictures) == 7
    assert "other: ddqn-fast" in parsed.text


def test_thousands_of_steps_stay_small(tmp_path: Path) -> None:
    """What has many points is drawn as pixels: the page of 3,000 steps is below a megabyte."""
    run = RunOnDisk(tmp_path / "trial")
    run.evaluated(START, 0.7)
    run.finish()
    document, arrays = report(tmp_path / "trial")
    many = {
        name: values.repeat(3000)
        for name, values in arrays.items()
        if name.startswith(("walk_", "pareto_", "run_0_")) and len(values) == 1
    }
    document["counts"]["steps"] = 3000
    assert Design(**document["best"]["design"]) == START
    assert len(page_of(document, arrays | many)) < 1_000_000
