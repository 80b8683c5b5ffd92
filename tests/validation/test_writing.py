"""What cannot be written: refused before work begins, and told by option after all that was found was printed."""

from __future__ import annotations

import errno
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from luxloop.errors import InputError
from validation import add_command, effects_command
from validation.dataset.folder import write_sums
from validation.dataset.sheet import write_sheet
from validation.writing import view_of, written


@pytest.mark.parametrize(
    "page", ["/proc/x.html", "/proc/version.html/x.html", "folder.html", "x.txt", "", "n" * 300 + ".html"]
)
def test_a_page_that_cannot_be_written_is_refused_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, page: str
) -> None:
    """Rights alone do not tell: root may all, and cannot make a file in /proc."""
    monkeypatch.chdir(tmp_path)
    Path("folder.html").mkdir()
    with pytest.raises(InputError, match="--page"):
        view_of("ladder", Path(page))
    assert [path.name for path in tmp_path.iterdir()] == ["folder.html"]


def test_asking_leaves_a_page_that_is_there_as_it_is(tmp_path: Path) -> None:
    """And makes none where there is none."""
    old = tmp_path / "old.html"
    old.write_text("mine")
    for page in (old, tmp_path / "new.html"):
        view_of("ladder", page)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"old.html": "mine"}


@pytest.mark.parametrize("as_json", [False, True])
def test_a_page_that_fails_at_the_end_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    """What was found is printed first; then --page is named on stderr, and the command ends with 2."""

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", ".whole-1.html")

    monkeypatch.setattr(add_command, "view_of", lambda *_: full)
    monkeypatch.setattr("validation.diagnose.ladder.ladder", lambda *_: {"rungs": []})
    monkeypatch.setattr("validation.told_diagnosis.ladder", lambda _: ["the table"])
    app = typer.Typer()
    app.command()(add_command.ladder)
    monkeypatch.chdir(tmp_path)  # for its name alone: a long path would be told shortened
    done = CliRunner().invoke(app, ["--model", "paper", "--page", "page.html", *["--json"] * as_json])
    assert done.exit_code == 2
    assert ('"rungs": []' if as_json else "the table") in done.stdout
    assert done.stderr.startswith("luxloop: --page: got 'page.html'")
    assert "No space left on device: all else is done" in done.stderr
    assert ".whole" not in done.stderr


@pytest.mark.parametrize("write", [write_sums, lambda folder: write_sheet(folder / "a.csv", ["a.tif"], {})])
def test_a_folder_that_takes_nothing_is_told_without_the_name_of_a_temporary_file(write: Any) -> None:
    """Hashes of a data set and tables of an import: field, value, mend."""
    with pytest.raises(InputError) as refused:
        write(Path("/proc/self/fdinfo"))
    assert refused.value.field in ("SHA256SUMS", "--write-table")
    assert "/proc/self/fdinfo" in str(refused.value.value)
    assert "where you may write" in refused.value.mend
    assert ".whole" not in str(refused.value)


def test_an_effect_is_not_written_where_no_folder_can_be_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """The option that names another folder is told."""

    @contextmanager
    def nobody(*_: Any) -> Any:
        yield SimpleNamespace(known=SimpleNamespace(specs=[]))

    monkeypatch.setattr(effects_command, "_asked", nobody)
    with pytest.raises(InputError, match=r"--effects: got '/proc/effects/haze\.py'") as refused:
        effects_command.new("haze", "detector", effects=Path("/proc/effects"))
    assert "LUXLOOP_EFFECTS" in refused.value.mend


def test_only_the_system_is_translated() -> None:
    """An InputError inside stays what it is."""
    inner = InputError("inner", 1, "2")
    with pytest.raises(InputError) as raised, written("outer", Path(), ""):
        raise inner
    assert raised.value is inner
