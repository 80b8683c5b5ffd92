"""One command at a time in a folder: the second says who holds it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from luxloop.errors import InputError
from luxloop.settings import Settings
from tests.validation.blind_test.pretend import answer, folder_of, hiding
from tests.validation.test_loop import luxloop
from validation.blind_test.alone import alone, refuse_busy

HOLDER = """
import sys, pathlib
from validation.blind_test.alone import alone
with alone(pathlib.Path(sys.argv[1]), "make"):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_the_second_says_who_is_the_first(settings: Settings, tmp_path: Path) -> None:
    """make and diagnose end at once, with the process that works there; once that is gone the folder is free."""
    folder = folder_of(tmp_path / "sets", (answer("set-1", hiding("vignetting")), None))
    (tmp_path / "new").mkdir()
    for name, argv in ((folder.name, ("diagnose",)), ("new", ("make", "--sets", "1"))):
        holder = subprocess.Popen(
            [sys.executable, "-c", HOLDER, str(tmp_path / name)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(InputError, match=f"luxloop blind make .process {holder.pid} on"):
            alone(tmp_path / name, "score").__enter__()
        done = luxloop(settings, tmp_path, "blind", argv[0], name, *argv[1:])
        assert done.returncode == 2, done.stderr
        assert f"process {holder.pid}" in done.stderr
        assert "wait for its end" in done.stderr
        with pytest.raises(InputError, match=f"process {holder.pid} on"):
            refuse_busy(tmp_path / name)
        holder.communicate()
        with alone(tmp_path / name, "score"):
            pass
        refuse_busy(tmp_path / name)


def test_a_place_that_cannot_be_a_folder(tmp_path: Path) -> None:
    """A file lies there."""
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="a folder that can be written"):
        alone(tmp_path / "file", "make").__enter__()


def test_who_is_interrupted_is_told_how_it_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And the folder is free."""
    with pytest.raises(KeyboardInterrupt), alone(tmp_path / "sets", "make"):
        raise KeyboardInterrupt
    assert "blind make interrupted; the same command goes on" in capsys.readouterr().err
    refuse_busy(tmp_path / "sets")
