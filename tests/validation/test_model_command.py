"""`luxloop model new|show|diff|undo`, called as the front door calls them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import typer
from click.testing import Result
from typer.testing import CliRunner

from luxloop.errors import InputError
from luxloop.model import Environment
from luxloop.model_file import find_model, read_model, to_toml
from validation import model_command
from validation.model_versions import versions


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder of its own, no width of a terminal."""
    monkeypatch.delenv("COLUMNS", raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*argv: str) -> Result:
    """The outcome of `luxloop model ARGV`."""
    app = typer.Typer(pretty_exceptions_enable=False)
    for command in (model_command.new, model_command.show, model_command.diff, model_command.undo):
        app.command()(command)
    return CliRunner().invoke(app, argv)


def told(*argv: str) -> dict[str, Any]:
    """The one JSON object that `luxloop model ARGV --json` prints on stdout, and nothing else."""
    result = run(*argv, "--json")
    assert result.exit_code == 0, result.exception
    return dict(json.loads(result.stdout))


def refusal(*argv: str) -> InputError:
    """The bad input that `luxloop model ARGV` tells of."""
    result = run(*argv)
    assert isinstance(result.exception, InputError), result.output
    assert result.stdout == ""
    return result.exception


def edit(file: Path, old: str, new: str) -> None:
    """An edit by hand."""
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_new_writes_the_papers_model_by_default(folder: Path) -> None:
    """model.toml, named after its file, with the paper's environment, kept as version 1."""
    result = run("new")
    model = read_model(folder / "model.toml")
    assert result.exit_code == 0
    assert "model.toml written from paper" in result.stdout
    assert (model.name, model.environment) == ("model", find_model("paper").environment)
    assert [version.command for version in versions(folder / "model.toml")] == ["model new --from paper"]


def test_new_from_another_model_has_its_hash(folder: Path) -> None:
    """From a shipped name or from a file: what changes results is the same."""
    assert told("new", "--from", "clear_chip", "a.toml")["sha256"] == find_model("clear_chip").sha256
    edit(folder / "a.toml", "n_gan = 2.4869", "n_gan = 2.5")
    assert told("new", "--from", "a.toml", "b.toml")["sha256"] == read_model(folder / "a.toml").sha256
    assert read_model(folder / "b.toml").environment == Environment(n_gan=2.5)


def test_new_keeps_a_file_unless_forced_and_then_too(folder: Path) -> None:
    """Refused without --force; with it the old text stays as a version, one undo away."""
    (folder / "model.toml").write_text(to_toml(find_model("clear_chip")), encoding="utf-8")
    assert "--force" in refusal("new").mend
    assert run("new", "--force").exit_code == 0
    assert run("undo").exit_code == 0
    assert read_model(folder / "model.toml") == find_model("clear_chip")


def test_show_tells_every_parameter_with_value_unit_and_meaning(folder: Path) -> None:
    """Also the prior, the limits and the free ones; without a terminal there is no colour and no box."""
    result = run("show", "paper")
    assert result.exit_code == 0
    for name, field in Environment.model_fields.items():
        assert name in result.stdout
        assert str(field.description).split()[0] in result.stdout
    row = next(line for line in result.stdout.splitlines() if line.startswith("chip_absorption_per_cm"))
    assert "200 1/cm" in row
    assert "free, 0 to 500" in row
    assert "5 +- 2.5 deg" in result.stdout
    assert find_model("paper").sha256[:12] in result.stdout
    assert "\x1b" not in result.stdout


def test_show_tells_effects_and_versions(folder: Path) -> None:
    """An effect's parameters with their units, and a line per version."""
    run("new")
    more = '\n[[effects]]\nname = "camera_psf"\n[effects.parameters]\nwidth_um = 12.5\nshape = "moffat"\n'
    with (folder / "model.toml").open("a", encoding="utf-8") as file:
        file.write(more)
    shown = run("show").stdout
    assert "camera_psf" in shown
    assert "12.5 um" in shown
    assert "model new --from paper" in shown


def test_show_as_json_is_the_model_with_hash_and_versions(folder: Path) -> None:
    """One object; its environment parses back."""
    run("new", "--from", "clear_chip")
    shown = told("show")
    assert Environment.model_validate(shown["environment"]) == Environment()
    assert shown["sha256"] == find_model("clear_chip").sha256
    assert [version["number"] for version in shown["versions"]] == [1]


def test_diff_between_two_models_names_what_differs(folder: Path) -> None:
    """A line per leaf, with the unit; the hash decides whether results change."""
    result = told("diff", "clear_chip", "paper")
    paths = {change["path"]: (change["before"], change["after"]) for change in result["changes"]}
    assert paths["environment.chip_absorption_per_cm"] == (0.0, 200.0)
    assert not result["same_results"]
    assert "environment.chip_absorption_per_cm: 0 -> 200 1/cm" in run("diff", "clear_chip", "paper").stdout


def test_diff_of_a_file_alone_is_against_its_version_before(folder: Path) -> None:
    """An edit by hand shows, and undo shows the other way round."""
    run("new")
    edit(folder / "model.toml", "sigma_deg = 5.0", "sigma_deg = 7.5")
    assert "environment.substrate.sigma_deg: 5 -> 7.5 deg" in run("diff", "model.toml").stdout
    run("undo")
    assert "environment.substrate.sigma_deg: 7.5 -> 5 deg" in run("diff", "model.toml").stdout


def test_a_difference_in_words_only_changes_no_results(folder: Path) -> None:
    """Name and notes are for people."""
    run("new")
    edit(folder / "model.toml", 'name = "model"', 'name = "other"')
    assert told("diff", "model.toml")["same_results"]
    assert "1 difference, none that changes results" in run("diff", "model.toml").stdout


def test_undo_says_that_what_came_back_is_no_model(folder: Path) -> None:
    """An edit by hand that cannot be read is somebody's work: it comes back, not as if it had a hash."""
    run("new")
    edit(folder / "model.toml", "n_gan = 2.4869", "n_gan = much")
    assert run("new", "--force").exit_code == 0
    said = run("undo").stdout
    assert "but it is no model: model.toml" in said
    assert ", ;" not in said
    run("undo")
    assert "model.toml: line" in told("undo")["fault"]
    assert told("undo")["fault"] is None


def test_a_width_in_columns_is_kept_where_output_is_piped(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without one a pipe gets tables 160 wide."""
    for columns, wide in (("40", 40), ("", 160), ("many", 160)):
        monkeypatch.setenv("COLUMNS", columns)
        assert max(map(len, run("show", "paper").stdout.splitlines())) == wide


def test_undo_can_be_undone_and_goes_to_any_version(folder: Path) -> None:
    """Undo twice is where one was; --to names a version."""
    run("new", "--from", "clear_chip")
    run("new", "--from", "paper", "--force")
    file = folder / "model.toml"
    assert told("undo")["version"] == 3
    assert read_model(file).environment == Environment()
    run("undo")
    assert read_model(file).environment == find_model("paper").environment
    assert told("undo", "--to", "1")["sha256"] == find_model("clear_chip").sha256
    assert read_model(file).environment == Environment()


@pytest.mark.parametrize(
    ("argv", "told_mend"),
    [
        (("show",), "luxloop model new"),
        (("show", "papr"), "did you mean paper?"),
        (("diff", "paper", "nothing.toml"), "luxloop model new"),
        (("new", "--from", "clear"), "did you mean clear_chip?"),
        (("new", "paper"), "--from paper"),
        (("undo", "nothing.toml"), "luxloop model new"),
        (("undo", "paper"), "a shipped model never changes"),
        (("diff", "paper"), "name two models"),
    ],
)
def test_what_is_not_there_is_refused_with_the_mend(folder: Path, argv: tuple[str, ...], told_mend: str) -> None:
    """Exit code 2 at the front door; nothing on stdout, nothing written."""
    error = refusal(*argv)
    assert told_mend in error.mend
    assert error.exit_code == 2
    assert list(folder.glob("*.toml")) == []


def test_a_model_with_an_unknown_key_is_refused_by_every_command(folder: Path) -> None:
    """Named with file, path and the word that was meant; undo still mends it."""
    run("new")
    edit(folder / "model.toml", "n_gan =", "n_gam =")
    for argv in (("show",), ("diff", "model.toml"), ("new", "--from", "model.toml", "b.toml")):
        error = refusal(*argv)
        assert error.field == "model.toml: environment.n_gam"
        assert error.mend == "did you mean n_gan?"
    assert run("undo").exit_code == 0
    assert run("show").exit_code == 0
