"""Files of people: what cannot be read is told with its mend, what is written is there whole or not at all."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from luxloop.errors import InputError, LuxloopError, shown
from luxloop.files import MAX_BYTES, read_text, toml_of, whole
from luxloop.run_folders import runs_in

DIGITS = "7" * 5000


def test_a_folder_of_runs_that_cannot_be_is_told() -> None:
    """A name from luxloop.toml may hold what no name of a file can."""
    with pytest.raises(LuxloopError, match="embedded null byte"):
        runs_in(Path("a\0b"))


def told(path: Path) -> InputError:
    """What is said of a file that cannot be read."""
    with pytest.raises(InputError) as caught:
        read_text(path, "--config", "a TOML file", "write one")
    return caught.value


def test_what_is_no_text_is_told(tmp_path: Path) -> None:
    """Nothing there, a folder, links in a ring, a name that no file can have, an endless file, one of Latin-1."""
    (tmp_path / "ring").symlink_to("ring")
    (tmp_path / "latin").write_bytes(b"a = 1 # \xb5m")
    missing = told(tmp_path / "missing")
    assert (missing.field, missing.allowed, missing.mend) == ("--config", "a TOML file", "write one")
    assert told(tmp_path).mend == "Is a directory"
    assert told(tmp_path / "ring").mend == "Too many levels of symbolic links"
    assert told(tmp_path / "a\0b").mend == "embedded null byte"
    assert told(Path("/dev/zero")).value == f"more than {MAX_BYTES:,} bytes"
    assert (told(tmp_path / "latin").field, told(tmp_path / "latin").allowed) == ("latin", "UTF-8 text")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
def test_a_file_that_one_may_not_read_is_told(tmp_path: Path) -> None:
    """By a process that is nobody: for root every file may be read."""
    path = tmp_path / "own.toml"
    path.write_text("a = 1")
    path.chmod(0o600)
    tmp_path.chmod(0o755)
    code = f"import os, luxloop.files as f, pathlib; os.chdir({str(tmp_path)!r}); os.setuid(65534)\n"
    code += "try: f.read_text(pathlib.Path('own.toml'), '--config', 'TOML')\nexcept ValueError as error: print(error)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "a file that can be read; Permission denied" in done.stdout


@pytest.mark.parametrize(
    ("text", "line", "mend"),
    [
        ("a = 1\nb = ", 2, "Invalid value"),
        ("a = 1\nb = 0,5", 2, "write decimals with a point"),
        (f"a = 1\nb = {DIGITS}\nc = 2", 2, "a number has at most 4,300 digits"),
        (f"a = 1\nb = 0x{'f' * 5000}\nc = 2", 2, "a number has at most 4,300 digits"),
        (f"a = 1\n{'b.' * 3000}b = 1\nc = 2", 2, "names by dots"),
        (f"a = 1\n{'b.' * 300_000}b = 1\nc = 2", 2, "names by dots"),
        (f"a = 1\n[[{'b . ' * 200_000}b]]\nc = 2", 2, "names by dots"),
        ("a = 1\nb = {c = 1, " + '"d \\" e".' * 50_000 + "f = 1}\nc = 2", 2, "names by dots"),
        ("a = 1\n" + "'b.c'." * 100_000 + "f = 1\nc = 2", 2, "names by dots"),
        ("a = 1\nb = " + "[" * 5000 + "]" * 5000 + "\nc = 2", 2, "nest a hundredfold at most"),
        ("a = 1\nb = " + "{a = " * 5000 + "1" + "}" * 5000 + "\nc = 2", 2, "nest a hundredfold at most"),
    ],
)
def test_what_is_no_toml_is_told_with_its_line(text: str, line: int, mend: str) -> None:
    """The line in at most 80 characters, also where Python says no line."""
    with pytest.raises(InputError) as caught:
        toml_of(text, "x.toml")
    assert caught.value.field == f"x.toml: line {line}"
    assert caught.value.value == text.split("\n")[line - 1]
    assert mend in caught.value.mend
    assert len(str(caught.value)) < 300


def test_numbers_with_points_and_names_of_some_depth_are_toml() -> None:
    """Many points in a line are no depth: it is names that nest."""
    numbers, name = ", ".join(["0.5"] * 500), ".".join("a" * 50)
    data = toml_of(f"a.b = [{numbers}]  # {'1.' * 500}\n{name}.b = '{'x. ' * 500}'", "x.toml")
    assert data["a"]["b"] == [0.5] * 500


def test_any_value_can_be_told() -> None:
    """Also those that Python refuses to write out: it ended in a traceback, about the message instead of the file."""
    deep: list[object] = []
    for _ in range(100_000):
        deep = [deep]
    assert shown(1 << 20_000, 10) == "0x10000..."
    assert shown(deep) == "a list too large to show"
    assert shown("a" * 100, 10) == "'aaaaaa..."
    error = InputError("x" * 5000, 1 << 20_000, "less")
    assert len(str(error)) < 1000
    while deep:  # freed from the outside: as a whole it would be too deep for some releases of Python
        deep = deep[0]  # type: ignore[assignment]  # a list in a list


def test_a_file_is_replaced_as_a_whole(tmp_path: Path) -> None:
    """While it is written, and where that fails, the one before stays; a link and the rights stay as they are."""
    path, link = tmp_path / "kept.png", tmp_path / "link.png"
    path.write_text("before")
    path.chmod(0o640)
    link.symlink_to(path.name)
    with pytest.raises(OSError, match="disk"), whole(link) as fresh:  # noqa: PT012  it fails amid the writing
        assert fresh.suffix == ".png"
        fresh.write_text("af")
        raise OSError("disk")
    assert path.read_text() == "before"
    with whole(link) as fresh:
        fresh.write_text("after")
        assert path.read_text() == "before"
    assert (path.read_text(), link.is_symlink(), path.stat().st_mode & 0o777) == ("after", True, 0o640)
    assert {one.name for one in tmp_path.iterdir()} == {"kept.png", "link.png"}


def test_two_that_write_into_one_folder_at_once_do_not_meet(tmp_path: Path) -> None:
    """Two threads, or one within the other, had one name for what they wrote: one's text became the other's file."""
    with whole(tmp_path / "a.json") as one, whole(tmp_path / "b.json") as other, whole(tmp_path / "b.json") as again:
        assert len({one, other, again}) == 3
        for fresh in (one, other, again):
            fresh.write_text(fresh.name)
        names = one.name, other.name
    assert ((tmp_path / "a.json").read_text(), (tmp_path / "b.json").read_text()) == names
    assert {path.name for path in tmp_path.iterdir()} == {"a.json", "b.json"}


def test_a_pipe_is_written_to(tmp_path: Path) -> None:
    """It is not replaced by a file."""
    pipe = tmp_path / "pipe.svg"
    os.mkfifo(pipe)
    heard: list[str] = []
    reader = threading.Thread(target=lambda: heard.append(pipe.read_text()))
    reader.start()
    with whole(pipe) as fresh:
        fresh.write_text("<svg>")
    reader.join(20)
    assert heard == ["<svg>"]
    assert pipe.is_fifo()
