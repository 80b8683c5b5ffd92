"""The document of a report: what the journal says, of runs that ended, go on, were killed, or found nothing."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from agent import campaign_command, report_command
from agent.launch import Launched
from agent.progress import Found, Progress
from agent.report import document_of
from agent.report_arrays import front_of, line_of
from agent.report_numbers import difference
from agent.report_under import Named, Winner, differences, questions, row_under
from env_controller.audit.compact import compact
from luxloop.campaign import Ended, Fidelity, Step
from luxloop.client import Answer
from luxloop.design import Design
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.journal.reader import RunJournal
from luxloop.model_file import find_model
from tests import campaign_runs
from tests.campaign_runs import ARGV, START, RunOnDisk, field_lx, map_of, plan_of, result_of, whole_run

WIDE = START.model_copy(update={"width_um": 40.0})


@pytest.fixture
def whole(tmp_path: Path) -> tuple[Path, dict[str, Step]]:
    """The folder of a run with all there can be, and its steps by name."""
    folder = tmp_path / "trial"
    return folder, whole_run(folder)


def of(row: dict[str, Any]) -> tuple[float, float]:
    """Value and standard error of a row's uniformity."""
    return row["uniformity"]["value"], row["uniformity"]["standard_error"]


def told(step: Step) -> tuple[float, float]:
    """The same of a step."""
    return step.uniformity, step.uniformity_error


def test_every_role_has_the_numbers_of_its_step(whole: tuple[Path, dict[str, Step]]) -> None:
    """Best, second, start and the best without its DBR, each with the error of its own evaluation."""
    folder, steps = whole
    document, _ = document_of(folder)
    assert of(document["best"]) == told(steps["best"])
    assert [of(row) for row in document["finalists"]] == [told(steps["best"]), told(steps["second"])]
    assert of(document["start"]) == told(steps["start"])
    assert of(document["dbr"]["without"]) == told(steps["bare"])
    assert document["dbr"]["with"] == document["best"]
    assert document["best_is_final"]
    assert [row["seed"] for row in document["finalists"]] == ["102", "101"]
    assert document["finalists"][1]["in_walk"]["value"] == steps["last"].uniformity
    assert document["finalists"][0]["in_walk"] is None  # the walk never had it: its evaluation failed


def test_differences_carry_combined_errors(whole: tuple[Path, dict[str, Step]]) -> None:
    """3 and 4 thousandths make 5; a ratio's relative errors add in the same way."""
    document, _ = document_of(whole[0])
    dbr = document["dbr"]
    assert dbr["uniformity"]["value"] == pytest.approx(0.262)
    assert dbr["uniformity"]["standard_error"] == pytest.approx(0.005)
    assert document["gain"]["uniformity"]["standard_error"] == pytest.approx(math.sqrt(20e-6))
    light, bare = (dbr[name]["mean_illuminance_lx"] for name in ("with", "without"))
    ratio = dbr["illuminance_ratio"]
    assert ratio["value"] * bare["value"] == pytest.approx(light["value"])
    low = (light["value"] - light["standard_error"]) / bare["value"]
    assert ratio["standard_error"] > ratio["value"] - low  # the other error comes on top


def test_steps_are_counted_by_what_came_of_them(whole: tuple[Path, dict[str, Step]]) -> None:
    """Fifteen steps of the walk, of which twelve evaluate different designs, and five finals."""
    document, arrays = document_of(whole[0])
    expected = {"steps": 15, "evaluations": 12, "infeasible": 1, "failed": 1, "finals": 5, "episodes": 4}
    assert expected.items() <= document["counts"].items()
    assert arrays["walk_evaluated"].sum() == 13
    assert arrays["walk_evaluations"][-1] == 12
    assert arrays["walk_infeasible"].sum() == 1
    assert len(document["failures"]) == 1
    assert "died three times" in document["failures"][0]["failure"]


def test_the_curve_is_what_the_journal_has_in_the_order_of_the_designer(whole: tuple[Path, dict[str, Step]]) -> None:
    """One value per step, lane by lane in turns; the best so far never falls and is one of them."""
    folder, steps = whole
    document, arrays = document_of(folder)
    walk = [step for step in RunJournal(folder).steps() if not step.final]
    by_turn = {(step.number, step.lane): step.uniformity for step in walk}
    assert arrays["walk_uniformity"].tolist() == [by_turn[key] for key in sorted(by_turn)]
    assert (np.diff(arrays["walk_best"]) >= 0.0).all()
    assert arrays["walk_best"][-1] == steps["last"].uniformity
    assert document["best_at"]["evaluations"] == 12
    assert document["best_at"]["episode"] == 2


def test_episodes_have_the_mean_of_their_steps(whole: tuple[Path, dict[str, Step]]) -> None:
    """Four steps 0.70 ... 0.76 make 0.73, its error half that of one step; the best is the last of them."""
    _, arrays = document_of(whole[0])
    assert arrays["episode_number"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert arrays["episode_mean"][0] == pytest.approx(0.73)
    assert arrays["episode_mean_error"][0] == pytest.approx(0.01)
    assert arrays["episode_best"][0] == pytest.approx(0.76)


def test_the_page_says_how_to_compute_its_maps_again(whole: tuple[Path, dict[str, Step]]) -> None:
    """The command has the design, the model, the fidelity and the seed of that very evaluation."""
    document, _ = document_of(whole[0])
    words = shlex.split(document["shown"]["bare"]["command"])
    options = dict(zip(words[2::2], words[3::2], strict=True))
    assert words[:2] == ["luxloop", "simulate"]
    assert options["--design"] == "150,40,500,20,0"
    assert options["--model"] == "paper"
    assert options["--seed"] == "104"
    assert options["--target-error"] == "0.3"


def test_provenance_is_that_of_the_journal(whole: tuple[Path, dict[str, Step]]) -> None:
    """Root and count are those of the side file, the model's hash is the shipped model's, argv is whole."""
    folder, _ = whole
    document, _ = document_of(folder)
    root, records = (folder / "audit.sha256").read_text().split()
    assert document["chain"] == {"records": int(records), "root": root}
    assert document["model"]["sha256"] == find_model("paper").sha256
    assert document["command_line"] == "luxloop " + " ".join(ARGV)
    assert document["state"] == "finished"
    assert document["ended"] == "budget: 12 evaluations"
    assert document["settings"]["seed"] == 7
    assert json.loads(json.dumps(document)) == document


def test_the_map_and_its_line_are_the_field(whole: tuple[Path, dict[str, Step]]) -> None:
    """The line through the chips, found from the map, is the field's own there; its ratio is Eq. 8's."""
    _, arrays = document_of(whole[0])
    np.testing.assert_allclose(arrays["best_map_lx"], map_of(WIDE), rtol=1e-6)
    x_um = arrays["best_cut_x_um"]
    assert (x_um[0], x_um[-1]) == (-500.0, 500.0)
    np.testing.assert_allclose(arrays["best_cut_lx"], field_lx(WIDE, x_um, np.zeros(1))[0], rtol=1e-6)


@settings(max_examples=20, derandomize=True)
@given(st.integers(0, 7), st.integers(0, 7), st.floats(-600.0, 600.0), st.floats(-200.0, 200.0), st.integers(16, 17))
def test_a_line_between_the_points_of_a_map_is_exact(k: int, m: int, x_um: float, y_um: float, bins: int) -> None:
    """For every mode that the points tell apart, anywhere, also beyond the cell."""
    at = ((np.arange(bins) + 0.5) / bins - 0.5) * 400.0
    wave = 2.0 * np.pi / 400.0
    cell = np.cos(m * wave * at)[:, None] * np.cos(k * wave * at)
    expected = math.cos(m * wave * y_um) * math.cos(k * wave * x_um)
    assert line_of(cell, 200.0, np.array([x_um]), y_um)[0] == pytest.approx(expected, abs=1e-9)


@settings(max_examples=50, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=12))
def test_nobody_beats_the_front_and_the_front_beats_all_others(points: list[tuple[int, int]]) -> None:
    """Pareto: by definition, point against point; of equal points the first one stands for all."""
    x, y = np.array(points, dtype=float).reshape(-1, 2).T
    front = front_of(x, y)
    above = [[a >= c and b >= d and (a, b) != (c, d) for a, b in points] for c, d in points]
    assert {points[i] for i in np.flatnonzero(front)} == {
        point for point, beaten in zip(points, above, strict=True) if not any(beaten)
    }


def test_a_run_just_begun_has_a_document(tmp_path: Path) -> None:
    """No step yet: nothing is best, nothing is drawn, the provenance is there."""
    run = RunOnDisk(tmp_path / "trial")
    document, arrays = document_of(tmp_path / "trial")
    run.close()
    assert document["best"] is None
    assert document["start"] is None
    assert document["counts"]["steps"] == 0
    assert document["state"] == "being written"
    assert arrays["walk_best"].shape == (0,)
    assert json.dumps(document)


def test_a_killed_run_shows_the_best_of_its_walk(tmp_path: Path) -> None:
    """Without finalists the best is the walk's, and the document says so; the chain is that of the last commit."""
    run = RunOnDisk(tmp_path / "trial")
    run.evaluated(START, 0.7)
    best = run.evaluated(WIDE, 0.8, lane=1)
    run.close()
    document, arrays = document_of(tmp_path / "trial")
    assert document["state"] == "not finished"
    assert of(document["best"]) == told(best)
    assert not document["best_is_final"]
    assert document["gain"] is None
    assert document["finalists"] == []
    assert document["chain"]["records"] > 0
    assert arrays["best_map_lx"].shape == (32, 32)


@pytest.mark.parametrize("in_one_file", [False, True])
def test_a_run_was_made_by_its_first_start(tmp_path: Path, in_one_file: bool) -> None:
    """Later ones are named beside it, a controller that was started again under the same designer is none."""
    folder, resume = tmp_path / "trial", ["campaign", "resume", "trial"]
    for argv, designer in ((ARGV, "1-test"), (ARGV, "1-test"), (resume, "2-test"), (resume, "3-test")):
        run = RunOnDisk(folder, argv=argv, designer=designer)
        run.journal.finish()
        run.close()
    if in_one_file:
        compact(folder)
    document, _ = document_of(folder)
    assert document["command_line"] == "luxloop " + " ".join(ARGV)
    assert document["later_command_lines"] == ["luxloop campaign resume trial"] * 2
    assert len(RunJournal(folder).segments) == (1 if in_one_file else 4)


def test_the_night_between_two_starts_is_no_time_of_the_run(tmp_path: Path) -> None:
    """Three steps of the walk and a final one, 0.6 s each, with eight hours after the first: 1.8 s, 2.4 s."""
    run = RunOnDisk(tmp_path / "trial")
    run.evaluated(START, 0.7)
    run.paused_ns = 8 * 3600 * campaign_runs.SECOND_NS
    run.evaluated(WIDE, 0.8)
    run.evaluated(START, 0.7)
    run.evaluated(WIDE, 0.8, seed="1")
    run.finish()
    times = document_of(tmp_path / "trial")[0]["times"]
    assert (times["walk_s"], times["wall_s"]) == pytest.approx((1.8, 2.4))


def test_a_run_of_failures_alone_has_no_best(tmp_path: Path) -> None:
    """Steps that failed or cannot be built are counted, and never the best."""
    run = RunOnDisk(tmp_path / "trial")
    run.failed(START)
    run.infeasible(WIDE, lane=1)
    run.finish()
    document, arrays = document_of(tmp_path / "trial")
    assert document["best"] is None
    assert document["counts"]["failed"] == document["counts"]["infeasible"] == 1
    assert np.isnan(arrays["walk_best"]).all()
    assert document["grid"]["projected_physics_s"] is None


@pytest.mark.parametrize("distance_from", ["substrate", "chip_top"])
@pytest.mark.parametrize("spacing_is", ["pitch", "gap"])
def test_the_grid_counts_what_can_be_built(tmp_path: Path, distance_from: Any, spacing_is: Any) -> None:
    """As many of the plan's grid as are feasible one by one (a coarse one, so that all can be asked)."""
    plan = plan_of()
    step = Design.from_vector((40.0, 45.0, 200.0, 25.0, 2.5))
    low = Design.from_vector((10.0, 10.0, 90.0, 5.0, 4.5))
    bounds = plan.bounds.model_copy(update={"low": low, "step": step})
    readings = {"distance_from": distance_from, "spacing_is": spacing_is}
    around = plan.environment.model_copy(update=readings)
    RunOnDisk(tmp_path / "trial", plan_of("trial", bounds=bounds, environment=around)).finish()
    document, _ = document_of(tmp_path / "trial")
    feasible = [design for design in bounds.grid() if design.feasibility(distance_from, spacing_is) is None]
    assert document["grid"]["designs"] == bounds.count
    assert document["grid"]["feasible"] == len(feasible)
    some_are_not = (distance_from, spacing_is) != ("chip_top", "gap")
    assert (len(feasible) < bounds.count) is some_are_not


def test_the_twin_has_no_ledger(tmp_path: Path) -> None:
    """What is not in the reply is None, not invented."""
    run = RunOnDisk(tmp_path / "trial")
    run.evaluated(START, 0.7, method="twin")
    run.finish()
    document, _ = document_of(tmp_path / "trial")
    assert document["shown"]["best"]["ledger"] is None


@pytest.mark.parametrize("missing", ["one", "other"])
def test_a_difference_needs_both(missing: str) -> None:
    """None where one design was not evaluated."""
    row = {"uniformity": {"value": 0.9, "standard_error": 0.01}, "mean_illuminance_lx": None}
    pair = {"one": row, "other": row} | {missing: None}
    assert difference(pair["one"], pair["other"]) is None


class Workers:
    """Answers films and rays as a client does; the uniformity is that of the model's receiver, so models differ."""

    def __init__(self, *, lost_films: int = 0) -> None:
        self.asked: list[Any] = []
        self.lost = lost_films

    def run(self, request: Any, **_: Any) -> Answer:
        """A table's hash, or a result; a table may have gone with who held it."""
        self.asked.append(request)
        if request.KIND == "film":
            return Answer({"table_sha256": "a" * 64, "table_bytes": 8}, {}, "film-1", 1, 0.0)
        if self.lost:
            self.lost -= 1
            raise RemoteError(Failure(code="not_found", message="the table has gone"))
        value = request.environment.receiver.reflectance
        estimates = {
            name: {"value": value, "standard_error": 0.003} for name in ("uniformity", "mean_illuminance_lx")
        }
        return Answer({"metrics": estimates, "histories": 32768}, {}, "ray-1", 1, 0.0)


def models() -> list[Named]:
    """Two models that differ in the receiver."""
    paper = find_model("paper")
    return [Named("a", paper), Named("b", paper.with_value("environment.receiver.reflectance", 0.4))]


def test_each_winner_is_asked_under_each_model() -> None:
    """Two winners, two models: four rows, each with a seed of its own, two differences of each kind."""
    winners, how = [Winner("one", START), Winner("two", WIDE)], Fidelity(target_error_points=0.3)
    workers = Workers()
    rows = [row_under(workers, winner, named, how) for winner, named in questions(winners, models())]  # type: ignore[arg-type]  # duck
    assert [(row["run"], row["model"]) for row in rows] == [("one", "a"), ("one", "b"), ("two", "a"), ("two", "b")]
    assert len({row["seed"] for row in rows}) == 4
    rays = [request for request in workers.asked if request.KIND == "ray"]
    assert {request.film.sha256 for request in rays} == {"a" * 64}
    assert {request.target_error_points for request in rays} == {0.3}
    found = differences(rows)
    assert [change["between"] for change in found] == ["models", "winners", "winners", "models"]
    assert found[0]["uniformity"]["value"] == pytest.approx(0.05)
    assert found[0]["uniformity"]["standard_error"] == pytest.approx(0.003 * math.sqrt(2.0))
    assert [change["significant"] for change in found] == [True, False, False, True]


def test_a_table_that_has_gone_is_computed_again() -> None:
    """Once; the row is there as if nothing had happened."""
    workers = Workers(lost_films=1)
    row = row_under(workers, Winner("one", START), models()[0], Fidelity(histories=32768))  # type: ignore[arg-type]  # duck
    assert [request.KIND for request in workers.asked] == ["film", "ray", "film", "ray"]
    assert row["uniformity"]["value"] == pytest.approx(0.35)


def test_a_winner_that_cannot_be_built_under_a_model_says_so() -> None:
    """Nobody is asked; it has a reason instead of numbers, and no difference."""
    flat = START.model_copy(update={"distance_um": 20.0})
    workers = Workers()
    row = row_under(workers, Winner("one", flat), models()[0], Fidelity(histories=1))  # type: ignore[arg-type]  # duck
    assert "receiver" in row["reason"]
    assert workers.asked == []
    assert differences([row, row | {"model": "b"}]) == []


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> typer.Typer:
    """`luxloop campaign report`; the page it draws says only of which run it is."""

    def draw(document: dict[str, Any], arrays: dict[str, Any], path: Path) -> None:
        path.write_text(f"{document['run']}, {len(arrays['walk_best'])} steps")

    monkeypatch.setattr(report_command, "view", lambda _: draw)
    application = typer.Typer()
    application.command()(report_command.report)
    return application


def test_the_page_is_written_for_those_who_ask_for_no_more(
    whole: tuple[Path, dict[str, Step]], command: typer.Typer
) -> None:
    """As the quick run does at its end."""
    assert report_command.write_report(whole[0]).read_text() == "trial, 15 steps"


def test_without_pictures_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No view of that name is installed."""
    monkeypatch.setattr(report_command, "entry_points", lambda **_: ())
    with pytest.raises(InputError, match="luxloop\\[viewer\\]"):
        report_command.view(tmp_path / "report.html")


def test_without_pictures_a_quick_run_does_not_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is said before minutes are spent, with a campaign that writes no report."""
    monkeypatch.setattr(report_command, "entry_points", lambda **_: ())
    monkeypatch.setattr(campaign_command, "_launched", lambda *_: pytest.fail("a campaign was begun"))
    with pytest.raises(InputError, match="luxloop campaign run --quick"):
        campaign_command.quick_run()


def test_a_quick_run_tells_what_it_found_where_the_page_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One object on stdout; why there is no page, and how to get one, on stderr; exit 1."""
    ended = Ended(run="one", folder=str(tmp_path), records=1, root="0" * 64)
    launched = Launched("one", Found("enough", Progress(), (), None, None, None), ended, interrupted=False)
    monkeypatch.setattr(campaign_command, "_launched", lambda *_: launched)
    application = typer.Typer()
    application.command()(campaign_command.quick_run)
    result = CliRunner().invoke(application, ["--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout)["root"] == ended.root
    assert "luxloop campaign report one --out FILE" in result.stderr


def test_the_command_writes_the_page_beside_the_journal(
    whole: tuple[Path, dict[str, Step]], command: typer.Typer
) -> None:
    """By id under --runs; with --json the document is printed, and where the page is."""
    folder, steps = whole
    result = CliRunner().invoke(command, ["trial", "--runs", str(folder.parent), "--json"], catch_exceptions=False)
    document = json.loads(result.stdout)
    assert document["page"] == str(folder / "report.html")
    assert of(document["best"]) == told(steps["best"])
    assert (folder / "report.html").exists()


def test_a_person_reads_result_and_page(whole: tuple[Path, dict[str, Step]], command: typer.Typer) -> None:
    """A few lines with the best, its error, the gain, and the path; another page where --out says."""
    folder, _ = whole
    page = folder.parent / "p.html"
    result = CliRunner().invoke(command, [str(folder), "--out", str(page)], catch_exceptions=False)
    assert "91.20 +- 0.40 %" in result.stdout
    assert "+21.69 +- 0.45 points over the start" in result.stdout
    assert result.stdout.rstrip().endswith(str(page))
    assert page.exists()


def test_several_runs_stand_side_by_side(tmp_path: Path, command: typer.Typer) -> None:
    """The first one's page, with all of them in its tables."""
    whole_run(tmp_path / "trial")
    other = RunOnDisk(tmp_path / "other", plan_of("other", reward="r3"))
    other.evaluated(START, 0.7)
    other.finish()
    arguments = ["trial", "other", "--runs", str(tmp_path), "--json"]
    document = json.loads(CliRunner().invoke(command, arguments, catch_exceptions=False).stdout)
    assert [run["run"] for run in document["runs"]] == ["trial", "other"]
    assert [run["reward"]["name"] for run in document["runs"]] == ["r2", "r3"]


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (["nothing"], "RUN"),
        (["trial", "--out", "page.pdf"], "--out"),
        (["trial", "--out", "no/such/folder/page.html"], "--out"),
        (["trial", "--under", "no-such-model"], "model"),
    ],
)
def test_what_cannot_be_used_is_named(
    tmp_path: Path, command: typer.Typer, monkeypatch: pytest.MonkeyPatch, arguments: list[str], field: str
) -> None:
    """Field, value and what is allowed; nothing is written."""
    monkeypatch.chdir(tmp_path)
    whole_run(tmp_path / "trial")
    with pytest.raises(InputError) as found:
        CliRunner().invoke(command, [*arguments, "--runs", str(tmp_path)], catch_exceptions=False)
    assert found.value.field == field
    assert found.value.allowed
    assert not list(tmp_path.rglob("*.html"))


def test_under_needs_a_winner(tmp_path: Path, command: typer.Typer) -> None:
    """A run in which nothing was evaluated has none, and no worker is started for it."""
    RunOnDisk(tmp_path / "trial").finish()
    with pytest.raises(InputError, match="--under"):
        CliRunner().invoke(command, ["trial", "--runs", str(tmp_path), "--under", "paper"], catch_exceptions=False)


def test_a_finalist_without_pairs_stays_a_finalist(tmp_path: Path) -> None:
    """Bounds may allow 0 pairs: the winner is then not taken for the winner without its mirror."""
    run = RunOnDisk(tmp_path / "bare")
    plain = START.model_copy(update={"dbr_pairs": 0.0})
    run.evaluated(START, 0.9, episode=0)
    first = run.evaluated(plain, 0.951, seed="1")
    run.evaluated(START.model_copy(update={"dbr_pairs": 0.5}), 0.929, seed="2")
    run.evaluated(START, 0.9, seed="3", role="start")
    run.finish()
    document, _ = document_of(tmp_path / "bare")
    assert [row["design"]["dbr_pairs"] for row in document["finalists"]] == [0.0, 0.5]
    assert document["best"]["uniformity"]["value"] == first.uniformity
    assert not document["best_is_confirmed"]
    assert document["dbr"]["without"] is None


@pytest.mark.parametrize("lacking", [("map",), ("cut",), ("map", "cut", "histories", "method", "warnings", "ledger")])
def test_a_result_without_its_map_has_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lacking: tuple[str, ...]
) -> None:
    """A worker that says less than ours: the page is written without what needs it."""

    def said(*of: Any) -> dict[str, Any]:
        return {name: value for name, value in result_of(*of).items() if name not in lacking}

    monkeypatch.setattr(campaign_runs, "result_of", said)
    whole_run(tmp_path / "trial")
    document, arrays = document_of(tmp_path / "trial")
    assert not any(name.endswith(("_map_lx", "_cut_lx")) for name in arrays)
    assert document["best"] is not None
    page = report_command.write_report(tmp_path / "trial").read_text()
    assert "Its map is not on record." in page
