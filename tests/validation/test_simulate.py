"""Data sets made from models: what is written can be read, fits the model it came from, and can be made again."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner, Result

from luxloop.errors import InputError
from luxloop.model_file import find_model, read_model
from tests.validation.workers import Workers
from validation.dataset.checks import check
from validation.dataset.folder import SUMS, read_dataset, read_sums, sha256_of_file
from validation.dataset.simulate import PART, simulate, write_dataset
from validation.dataset.simulated_images import PEAK_SHARE, expected_images, light_seen, told_noise, views_of
from validation.dataset.simulation_plan import DECLARED, Plan, paper_plan, read_plan, with_camera
from validation.fit.problem import wrapped_deg
from validation.measured import measured_far_fields, measured_images, measured_spectra
from validation.noise import variance_dn2

OXIDE = '[[films.layers]]\nmaterial = "SiO2"\nthickness_nm = 100.0\n'
PLAN = """
name = "one chip and four"
[[samples]]
id = "one"
layout = "single"
distance_um = 180.0
width_um = 40.0
spacing_um = 400.0
thickness_um = 20.0
dbr_pairs = 0.0
[[samples]]
id = "four"
layout = "array"
rows = 2
columns = 2
distance_um = 180.0
width_um = 40.0
spacing_um = 400.0
thickness_um = 20.0
dbr_pairs = 2.5
"""
Run = Callable[..., Result]


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan file."""
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.fixture(scope="module")
def workers(tmp_path_factory: pytest.TempPathFactory) -> Workers:
    """Both, in this process."""
    return Workers(tmp_path_factory.mktemp("films"))


@pytest.fixture
def run(workers: Workers, plan: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """The command with options; its workers are those of this process."""

    @contextmanager
    def here(*_: Any, **__: Any) -> Any:
        yield workers

    monkeypatch.setattr("luxloop.client.Client", here)
    app = typer.Typer()
    app.command()(simulate)
    common = ["--plan", str(plan), "--solver", "twin", "--pixels", "24", "--pixel-um", "20"]
    return lambda out, *options: CliRunner().invoke(app, [str(out), *common, *map(str, options)])


def bytes_of(folder: Path) -> dict[str, bytes]:
    """All files of a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_seed_gives_the_same_bytes(run: Run, tmp_path: Path) -> None:
    """Monte Carlo too; another seed has other images of the same samples."""
    options = ("--solver", "monte_carlo", "--histories", 40_000, "--keep-truth")
    for name, seed in (("one", 3), ("same", 3), ("other", 4)):
        assert run(tmp_path / name, *options, "--seed", seed).exit_code == 0
    one, same, other = (bytes_of(tmp_path / name) for name in ("one", "same", "other"))
    assert one == same
    assert one.keys() == other.keys()
    assert one["images/four.tif"] != other["images/four.tif"]


def test_what_is_written_is_a_data_set(run: Run, tmp_path: Path) -> None:
    """It is read back with its hashes; the camera is the declared one but for what was changed."""
    done = run(tmp_path / "set", "--prnu-percent", 1, "--frames", 4, "--json")
    told = json.loads(done.stdout)
    assert (told["shots"], told["solver"], told["histories"]) == (["one", "four"], "twin", None)
    found = read_dataset(tmp_path / "set")
    assert found.manifest.name.endswith("; seed 1")
    camera = found.manifest.camera
    assert camera == DECLARED.model_copy(update={"pixel_um": 20.0, "prnu_percent": 1.0})
    assert [(shot.sample, shot.frames_averaged) for shot in found.manifest.images()] == [("one", 4), ("four", 4)]
    sums = read_sums(tmp_path / "set")
    assert set(sums) == set(bytes_of(tmp_path / "set")) - {SUMS}
    assert all(sha256_of_file(tmp_path / "set" / name) == stated for name, stated in sums.items())


def test_the_truth_stays_at_home_unless_asked_for(run: Run, tmp_path: Path) -> None:
    """Neither a file nor the manifest tells the model; with --keep-truth it can be read back."""
    assert run(tmp_path / "blind", "--model", "clear_chip").exit_code == 0
    assert set(bytes_of(tmp_path / "blind")) == {"dataset.toml", SUMS, "images/one.tif", "images/four.tif"}
    assert "clear" not in (tmp_path / "blind/dataset.toml").read_text()
    assert run(tmp_path / "open", "--model", "clear_chip", "--keep-truth", "--shift-px", 0.5).exit_code == 0
    truth = tomllib.loads((tmp_path / "open/truth.toml").read_text())
    assert read_dataset(tmp_path / "open").manifest.name.endswith("; model clear chip, seed 1")
    assert read_model(tmp_path / "open" / truth["model"]).sha256 == find_model("clear_chip").sha256
    assert [one["id"] for one in truth["images"]] == ["one", "four"]
    assert all(0.0 < abs(one["shift_px"][0]) < 3.0 for one in truth["images"])


@pytest.fixture(scope="module")
def lit(workers: Workers, plan: Path) -> tuple[Plan, list[Any], list[Any]]:
    """The plan at 128 x 128 coarse pixels, its views, what they see."""
    chosen = read_plan(plan)
    views = views_of(chosen, 1, 64, 64)
    light = light_seen(workers, find_model("paper"), views, solver="twin")
    return chosen, views, [one.irradiance_per_mm2 for one in light]


def test_spectra_and_far_fields_have_the_noise_that_was_asked_for(run: Run, tmp_path: Path) -> None:
    """They are a data set that checks; two draws differ by their noise, delta lies in [0, 360), the peak is 1."""
    options = ("--no-images", "--spectra", "R,delta", "--angle", "50,70", "--wavelengths", "400:600:5",
               "--sigma", 0.01, "--sigma-deg", 0.5, "--far-field", "--far-sigma", 0.05, "--histories", 40_000,
               "--json")  # fmt: skip
    told = json.loads(run(tmp_path / "one", *options, "--seed", 3).stdout)
    assert told["shots"] == ["gan-on-sapphire-R", "gan-on-sapphire-delta", "one-far", "four-far"]
    assert told["far_field_model_error"] > 0.0
    assert run(tmp_path / "same", *options, "--seed", 3).exit_code == 0
    assert run(tmp_path / "other", *options, "--seed", 4).exit_code == 0
    assert bytes_of(tmp_path / "one") == bytes_of(tmp_path / "same")
    one, other = (read_dataset(tmp_path / name) for name in ("one", "other"))
    assert check(tmp_path / "one") == []
    assert one.manifest.camera is None
    for first, second in zip(measured_spectra(one), measured_spectra(other), strict=True):
        apart = wrapped_deg(first.table.value - second.table.value)
        assert apart.std() == pytest.approx(np.sqrt(2.0) * first.table.sigma[0], rel=0.2)
        assert first.table.value.min() >= (0.0 if first.shot.quantity == "delta" else -0.05)
        assert sorted(set(first.table.aoi_deg)) == [50.0, 70.0]
    for curve in measured_far_fields(one):
        assert curve.table.value.max() == pytest.approx(1.0, abs=0.2)
        assert set(curve.table.sigma) == {0.05}


@pytest.mark.parametrize(
    ("options", "field"),
    [
        (("--no-images",), "--no-images"),
        (("--spectra", "R,X"), "--spectra"),
        (("--spectra", "psi"), "--angle"),
        (("--spectra", "R", "--wavelengths", "400:"), "--wavelengths"),
        (("--spectra", "R", "--wavelengths", "400:800:0"), "--wavelengths"),
        (("--spectra", "R", "--angle", "90"), "--angle"),
        (("--spectra", "R", "--sigma", "0"), "--sigma"),
        (("--far-field", "--far-sigma", "nan"), "--far-sigma"),
        (("--shift-px", "inf"), "--shift-px"),
        (("--shift-px", "12.5"), "--shift-px"),
        (("--rotation-deg", "inf"), "--rotation-deg"),
    ],
)
def test_curves_that_cannot_be_taken_are_refused_by_option(
    run: Run, tmp_path: Path, options: Sequence[str], field: str
) -> None:
    """Before anything is asked of the workers or written."""
    failed = run(tmp_path / "out", *options)
    assert isinstance(failed.exception, InputError)
    assert failed.exception.field == field
    assert not (tmp_path / "out").exists()


def test_all_images_are_exposed_to_the_same_peak(lit: tuple[Plan, list[Any], list[Any]]) -> None:
    """At a share of the full well here, with one gain per exposure for all; the brightest has 8 ms."""
    _, views, light = lit
    found = expected_images(views, light, DECLARED)
    peaks = [one.signal_dn.max() for one in found]
    np.testing.assert_allclose(peaks, PEAK_SHARE * 0.38 * 10_000.0, rtol=1e-3)
    gains = [one.signal_dn.max() / (one.irradiance_per_mm2.max() * one.exposure_ms) for one in found]
    assert gains[0] == pytest.approx(gains[1])
    assert min(one.exposure_ms for one in found) == 8.0
    small = DECLARED.model_copy(update={"full_well_e": 1e6})
    assert expected_images(views, light, small, 0.5)[0].signal_dn.max() == pytest.approx(0.5 * (4095 - 64), rel=1e-3)


def test_what_the_light_itself_errs_by_is_told(run: Run, plan: Path, workers: Workers, tmp_path: Path) -> None:
    """By sample, in the camera's noise: as much as runs with other seeds scatter."""
    few = run(tmp_path / "few", "--solver", "monte_carlo", "--histories", 40_000, "--json")
    own = json.loads(few.stdout)["images_own_noise"]
    chosen = with_camera(read_plan(plan), pixel_um=20.0)
    views, camera = views_of(chosen, 1, 24, 24), chosen.camera
    seeds = [light_seen(workers, find_model("paper"), views, histories=40_000, seed=seed) for seed in range(2, 18)]
    for number, view in enumerate(views):
        runs = [one[number].irradiance_per_mm2 for one in seeds]
        (mean,) = expected_images([view], [np.mean(runs, axis=0)], camera)
        apart_dn = mean.gain_dn * np.std(runs, axis=0, ddof=1)
        seen = np.sqrt(np.mean(apart_dn**2 / variance_dn2(mean.signal_dn, camera)))
        assert 0.9 < own[view.sample.id] / seen < 1.4  # it counts the light that may be lost, too


def test_too_few_histories_are_told_with_how_many_would_do(run: Run, tmp_path: Path) -> None:
    """As the square says for three sigma of all pixels together; below them, and of the twin, nothing is told."""
    options = ("--solver", "monte_carlo", "--histories", 40_000)
    told = run(tmp_path / "few", *options).stdout
    found = re.search(
        r"errs by ([\d.]+) sigma .* by pixel ([\d.]+) \(one\) to ([\d.]+) \(four\) of.*--histories (\d+)", told
    )
    assert found is not None, told
    sigma, one, four = map(float, found.groups()[:3])
    assert sigma == pytest.approx(24 * math.hypot(one, four), rel=0.05)
    assert int(found[4]) == pytest.approx(40_000 * (sigma / 3.0) ** 2, rel=0.2)
    as_json = json.loads(run(tmp_path / "same", *options, "--json").stdout)
    assert as_json["images_own_sigma"] == pytest.approx(sigma, rel=0.05)
    assert list(told_noise({"one": 0.1, "four": 0.05}, 2.7, 40_000)) == []
    assert "1.2 (one) of" in next(told_noise({"one": 1.2}, 30.0, 40_000))
    twin = json.loads(run(tmp_path / "twin", "--json").stdout)
    assert (twin["images_own_noise"], twin["images_own_sigma"]) == ({"one": None, "four": None}, None)


def test_measured_images_scatter_about_the_expected_ones(
    lit: tuple[Plan, list[Any], list[Any]], tmp_path: Path
) -> None:
    """Many noise draws of one truth: whitened by the variance that a fit uses, they have mean 0 and variance 1."""
    plan, views, light = lit
    expected = expected_images(views, light, plan.camera)
    for number in range(3):
        write_dataset(tmp_path / str(number), plan, expected, seed=number, frames=1 + number)
        images = measured_images(read_dataset(tmp_path / str(number)), plan.camera.pixel_um)
        for image, one in zip(images, expected, strict=True):
            assert image.used.all()
            white = (image.signal_dn - one.signal_dn) / np.sqrt(image.variance_dn2(one.signal_dn))
            assert abs(white.mean()) < 5.0 / np.sqrt(white.size)
            assert white.var() == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / white.size))


def test_shifts_and_turns_are_the_seeds_own() -> None:
    """Each image has its own, with the sds that were asked for; none asked for, none drawn."""
    plan = paper_plan()
    assert [view.pose.shift_px for view in views_of(plan, 1)] == [(0.0, 0.0)] * 6
    one, other = (views_of(plan, seed, shift_px=0.5, rotation_deg=0.2) for seed in (1, 2))
    assert one[0].pose != other[0].pose
    assert len({view.pose for view in one}) == 6
    drawn = [v.pose for seed in range(200) for v in views_of(plan, seed, shift_px=0.5, rotation_deg=0.2)]
    assert np.std([pose.shift_px for pose in drawn]) == pytest.approx(0.5, rel=0.1)
    assert np.std([pose.rotation_deg for pose in drawn]) == pytest.approx(0.2, rel=0.1)


def test_the_papers_groups_are_six() -> None:
    """Single chips and 5 x 5 of them, with 0, 2.5 and 5.5 pairs, at the declared camera."""
    plan = paper_plan()
    groups = [(one.rows, one.columns, one.dbr_pairs) for one in plan.samples]
    assert groups == [(n, n, pairs) for n in (1, 5) for pairs in (0.0, 2.5, 5.5)]
    assert plan.camera == DECLARED
    assert {view.centre_px for view in views_of(plan, 1)} == {(63.5, 63.5)}


def wrong_plan(tmp_path: Path, text: str) -> Sequence[str]:
    """Options that name a plan file with this text."""
    (tmp_path / "wrong.toml").write_text(text)
    return ("--plan", str(tmp_path / "wrong.toml"))


def test_a_plan_of_films_alone_is_enough_for_spectra(run: Run, tmp_path: Path) -> None:
    """What it leaves out is the paper's; the data set has the film alone."""
    (tmp_path / "films.toml").write_text('[[films]]\nid = "oxide"\nexit = "Si"\n' + OXIDE)
    assert read_plan(tmp_path / "films.toml").samples == paper_plan().samples
    options = ("--plan", tmp_path / "films.toml", "--no-images", "--spectra", "R", "--wavelengths", "400:700:10")
    told = json.loads(run(tmp_path / "out", *options, "--json").stdout)
    assert told["shots"] == ["oxide-R"]
    assert [film.id for film in read_dataset(tmp_path / "out").manifest.films] == ["oxide"]


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("name = 1,5", "wrong.toml: line 1"),
        ("name = 'empty'\nsamples = []", "wrong.toml: samples"),
        (PLAN.replace("180.0", "20.0"), "wrong.toml: samples.0.distance_um"),
        (PLAN.replace('"four"', '"one"'), "wrong.toml: samples"),
        (PLAN.replace("rows", "row"), "wrong.toml: samples.1.row"),
        (PLAN + "colour = 'red'", "wrong.toml: samples.1.colour"),
    ],
)
def test_a_wrong_plan_is_refused_by_name(run: Run, tmp_path: Path, text: str, field: str) -> None:
    """Field and value; nothing is asked of the workers, nothing written."""
    failed = run(tmp_path / "out", *wrong_plan(tmp_path, text))
    assert isinstance(failed.exception, InputError)
    assert failed.exception.field == field
    assert not (tmp_path / "out").exists()


def test_one_folder_is_made_by_one_command_at_a_time(
    run: Run, workers: Workers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second one is refused while the first computes, and takes nothing from it; both had claimed success."""
    refused: list[Result] = []

    @contextmanager
    def meanwhile(*_: Any, **__: Any) -> Any:
        assert [path.name for path in (tmp_path / "set").iterdir()] == [PART]
        refused.append(run(tmp_path / "set", "--seed", 2))
        yield workers

    monkeypatch.setattr("luxloop.client.Client", meanwhile)
    assert run(tmp_path / "set", "--seed", 1).exit_code == 0
    assert isinstance(refused[0].exception, InputError)
    assert refused[0].exception.field == "OUT"
    assert PART in refused[0].exception.mend
    assert not (tmp_path / "set" / PART).exists()
    assert "seed 1" in read_dataset(tmp_path / "set").manifest.name
    assert all(finding.field == "pitch" for finding in check(tmp_path / "set"))


def test_what_is_cut_short_leaves_no_part_of_a_data_set(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder is as it was, so that the same command can be given once more: not there, or empty."""

    def stopped(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("validation.dataset.simulate.write_sums", stopped)
        assert run(tmp_path / "set").exit_code != 0
        assert not (tmp_path / "set").exists()
        (tmp_path / "mine").mkdir()
        assert run(tmp_path / "mine").exit_code != 0
    assert list((tmp_path / "mine").iterdir()) == []
    assert run(tmp_path / "set").exit_code == 0


def test_a_folder_with_something_in_it_is_left_alone(run: Run, tmp_path: Path) -> None:
    """As are impossible cameras and shares of full scale."""
    (tmp_path / "notes.txt").write_text("mine")
    failures = [
        run(tmp_path), run(tmp_path / "a", "--peak-share", 1.5), run(tmp_path / "b", "--prnu-percent", 99),
    ]  # fmt: skip
    assert [one.exception.field for one in failures] == ["OUT", "peak_share", "camera: prnu_percent"]  # type: ignore[union-attr]
    assert bytes_of(tmp_path) == {"notes.txt": b"mine"}


def test_the_plans_that_the_docs_name_are_there() -> None:
    """One small camera: three single chips of the diagnosis' example, the paper's six samples of the blind test."""
    root = Path(__file__).parents[2]
    three, six = (read_plan(root / name) for name in ("examples/three-chips.toml", "docs/blind/plan.toml"))
    assert [one.id for one in three.samples] == ["bare", "few-pairs", "many-pairs"]
    assert six.samples == paper_plan().samples
    assert three.camera == six.camera
