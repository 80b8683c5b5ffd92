"""What is asked of a comparison and cannot be had is refused by its option, before anything is computed."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from luxloop.errors import InputError
from tests.validation.datasets import MANIFEST, PIXEL_UM, write_dataset
from validation import add_command, calibrate_command, compare_command, diagnose_command, effects_command
from validation.dataset.folder import Dataset, read_dataset, write_sums
from validation.observed import Observed


def data(folder: Path, *without: str) -> Dataset:
    """The small data set, without its shots of these kinds."""
    write_dataset(folder)
    head, *shots = MANIFEST.split("[[shots]]")
    kept = [shot for shot in shots if not any(f'kind = "{kind}"' in shot for kind in without)]
    (folder / "dataset.toml").write_text("[[shots]]".join([head, *kept]), encoding="utf-8")
    write_sums(folder)
    return read_dataset(folder)


@pytest.mark.parametrize(
    ("without", "pixel_um", "film", "field", "mend"),
    [
        (("spectrum",), None, "film", "--film", "leave it out"),
        ((), None, "foo", "--film", "[[films]]"),
        ((), 0.01, None, "--pixel-um", "no smaller one was measured"),
        (("image",), 48.0, None, "--pixel-um", "leave it out"),
    ],
)
def test_a_film_or_a_pixel_that_these_data_do_not_have_is_refused(
    tmp_path: Path, without: tuple[str, ...], pixel_um: float | None, film: str | None, field: str, mend: str
) -> None:
    """A film of images, a pixel of spectra were taken for nothing; a pixel below the camera's became the camera's."""
    with pytest.raises(InputError) as refused:
        Observed.of(data(tmp_path, *without), pixel_um, film)
    assert refused.value.field == field
    assert mend in refused.value.mend


def test_the_cameras_own_pixel_and_a_film_of_the_data_are_taken(tmp_path: Path) -> None:
    """Neither is refused."""
    observed = Observed.of(data(tmp_path), PIXEL_UM, "film")
    assert observed.images[0].binning == 1
    assert len(observed.shots) == 4


@pytest.mark.parametrize(
    ("argv", "field"),
    [
        (("diagnose", "--among", ""), "--among"),
        (("diagnose", "--among", " ,"), "--among"),
        (("confusion", "--only", ""), "--only"),
        (("diagnose", "--most-histories", "5"), "--most-histories"),
        (("calibrate", "--most-histories", "1000000"), "--most-histories"),
    ],
)
def test_options_that_say_nothing_or_less_than_another_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, argv: tuple[str, ...], field: str
) -> None:
    """No effects are not all effects, and the last anchor has no fewer histories than the first."""
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    for command in (diagnose_command.diagnose, effects_command.confusion, calibrate_command.calibrate):
        app.command()(command)
    done = CliRunner().invoke(app, [*argv, "--model", "paper"])
    assert isinstance(done.exception, InputError), done.output
    assert done.exception.field == field


@pytest.mark.parametrize(
    ("argv", "options"),
    [
        (("compare", "data"), ("--histories",)),
        (("where",), ("--histories",)),
        (("calibrate",), ("--histories", "--most-histories")),
        (("diagnose",), ("--histories", "--most-histories")),
        (("next", "vignetting", "distortion"), ("--histories", "--most-histories")),
        (("add", "vignetting"), ("--histories", "--most-histories")),
    ],
)
def test_histories_beside_the_twin_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, argv: tuple[str, ...], options: tuple[str, ...]
) -> None:
    """The twin traces none: they were taken and not used. It is said before anything is read."""
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    for command in (compare_command.compare, compare_command.where, diagnose_command.diagnose, add_command.add):
        app.command()(command)
    app.command()(calibrate_command.calibrate)
    app.command("next")(diagnose_command.next_)
    for option in options:
        done = CliRunner().invoke(app, [*argv, "--twin", option, "4000000"])
        assert isinstance(done.exception, InputError), done.output
        assert (done.exception.field, done.exception.value) == (option, 4_000_000)
        assert done.exception.allowed == "nothing beside --twin"


def test_without_the_twin_histories_are_those_asked_for_or_four_million() -> None:
    """None: the twin alone."""
    histories = compare_command.histories_traced
    assert [histories(False, None), histories(False, 32_768), histories(True, None)] == [4_000_000, 32_768, None]


@pytest.mark.parametrize(("first", "last"), [(4_000_000, 0), (4_000_000, None), (None, 5), (5, 5)])
def test_a_last_anchor_that_is_no_smaller_passes(first: int | None, last: int | None) -> None:
    """0: no other last anchor; None for the first: the twin alone."""
    calibrate_command.refuse_fewer(first, last)
