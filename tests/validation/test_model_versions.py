"""Versions of a model file: kept, undone, and safe against kills and against each other."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from luxloop.errors import InputError
from luxloop.model import Model
from luxloop.model_file import read_model, to_toml
from validation import model_versions
from validation.model_versions import BY_HAND, previous, save, undo, version_text, versions

SAVING = """
import sys
from pathlib import Path
from luxloop.model import Model
from validation.model_versions import save
path, first, end = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
for i in range(first, end):
    save(path, Model(name=f"model {i}"), f"save {i}")
    if i == first:
        print("saving", flush=True)
"""


def saver(path: Path, first: int, end: int) -> subprocess.Popen[str]:
    """A process that saves models `first`..`end` - 1 one after the other; it is at it when this returns."""
    argv = [sys.executable, "-c", SAVING, str(path), str(first), str(end)]
    process = subprocess.Popen(argv, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process.stdout as said:
        assert said.readline() == "saving\n"
    return process


def assert_whole(path: Path) -> None:
    """Every version is readable and hashes as its line says; the file holds one of them."""
    known = versions(path)
    assert [version.number for version in known] == sorted({version.number for version in known})
    texts = [version_text(path, version.number) for version in known]
    assert path.read_text(encoding="utf-8") in texts
    for version in known:
        stored = path.parent / ".luxloop" / "models" / f"{version.number:03d}.toml"
        assert read_model(stored).sha256 == version.sha256


def test_a_save_is_kept_with_command_hash_and_errors(tmp_path: Path) -> None:
    """The file, the version's own file and its line agree."""
    path, model = tmp_path / "model.toml", Model(name="a")
    version = save(path, model, "model new", {"held_out_rms_percent": 1.5})
    assert versions(path) == [version]
    assert (version.number, version.command, version.sha256) == (1, "model new", model.sha256)
    assert version.errors == {"held_out_rms_percent": 1.5}
    assert read_model(path) == model
    assert (tmp_path / ".luxloop" / "models" / "001.toml").read_text(encoding="utf-8") == to_toml(model)


def test_undo_goes_back_and_undo_again_forth(tmp_path: Path) -> None:
    """It makes a new version with the errors of the old one; nothing is ever removed."""
    path = tmp_path / "model.toml"
    save(path, Model(name="a"), "one", {"rms": 1.0})
    save(path, Model(name="b"), "two", {"rms": 2.0})
    assert undo(path).errors == {"rms": 1.0}
    assert read_model(path).name == "a"
    assert undo(path).errors == {"rms": 2.0}
    assert read_model(path).name == "b"
    assert undo(path, to=1).number == 5
    assert read_model(path).name == "a"
    assert len(versions(path)) == 5


def test_undo_after_a_save_that_was_killed_before_the_file_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its version is there, its text in no file: undo goes back from what the file holds, never forth to that."""
    path = tmp_path / "model.toml"
    save(path, Model(name="a"), "one")
    save(path, Model(name="b"), "two")
    write = model_versions._write_atomically

    def killed(at: Path, text: str) -> None:
        if at == path:
            raise KeyboardInterrupt
        write(at, text)

    with monkeypatch.context() as patch:
        patch.setattr(model_versions, "_write_atomically", killed)
        with pytest.raises(KeyboardInterrupt):
            save(path, Model(name="c"), "killed")
    assert [version.command for version in versions(path)] == ["one", "two", "killed"]
    assert previous(path) == 1
    undo(path)
    assert read_model(path).name == "a"


@pytest.mark.parametrize("put_back", ["written", "copied with its time", "moved"])
def test_undo_after_a_file_was_put_back_by_hand(tmp_path: Path, put_back: str) -> None:
    """The text is that of the version before, but came there after the last one: no save was killed. Whatever the
    time of its contents: `cp -p` and `mv` keep that of the copy that was made then."""
    path, kept = tmp_path / "model.toml", tmp_path / "kept.toml"
    save(path, Model(name="a"), "one")
    shutil.copy2(path, kept)
    save(path, Model(name="b"), "two")
    time.sleep(0.02)  # the clock of a file system has steps
    if put_back == "written":
        path.write_text(kept.read_text(encoding="utf-8"), encoding="utf-8")
    elif put_back == "moved":
        kept.replace(path)
    else:
        shutil.copy2(kept, path)
    assert previous(path) == 2
    for file in (tmp_path / ".luxloop" / "models").iterdir() if put_back == "written" else ():
        file.chmod(0o640)  # changes the time of its entry
    assert previous(path) == 2
    undo(path)
    assert read_model(path).name == "b"
    undo(path)
    assert read_model(path).name == "a"


def test_what_was_edited_by_hand_is_kept_before_it_is_replaced(tmp_path: Path) -> None:
    """Even where the edit is no model, undo brings it back letter by letter."""
    path = tmp_path / "model.toml"
    save(path, Model(name="a"), "one")
    spoilt = path.read_text(encoding="utf-8") + "\nnot toml at all"
    path.write_text(spoilt, encoding="utf-8")
    assert previous(path) == 1
    undo(path)
    assert read_model(path).name == "a"
    assert [(version.command, version.sha256 == "") for version in versions(path)] == [
        ("one", False),
        (BY_HAND, True),
        ("undo", False),
    ]
    undo(path)
    assert path.read_text(encoding="utf-8") == spoilt


def test_a_file_that_was_there_before_is_kept_too(tmp_path: Path) -> None:
    """`new --force` over a file that no command has written."""
    path = tmp_path / "model.toml"
    path.write_text(to_toml(Model(name="mine")), encoding="utf-8")
    save(path, Model(name="a"), "new --force")
    undo(path)
    assert read_model(path).name == "mine"


def test_a_deleted_file_is_brought_back(tmp_path: Path) -> None:
    """By its last version."""
    path = tmp_path / "model.toml"
    save(path, Model(name="a"), "one")
    path.unlink()
    undo(path)
    assert read_model(path).name == "a"


def test_two_model_files_of_a_folder_have_histories_of_their_own(tmp_path: Path) -> None:
    """Numbers are shared, versions are not."""
    one, two = tmp_path / "one.toml", tmp_path / "two.toml"
    save(one, Model(name="one"), "new")
    save(two, Model(name="two"), "new")
    save(one, Model(name="uno"), "rename")
    assert [version.number for version in versions(one)] == [1, 3]
    assert [version.number for version in versions(two)] == [2]
    with pytest.raises(InputError, match="earlier version"):
        undo(two)
    undo(one)
    assert (read_model(one).name, read_model(two).name) == ("one", "two")


def test_there_must_be_something_to_go_back_to(tmp_path: Path) -> None:
    """No file, no version before, no version of that number: each named."""
    path = tmp_path / "model.toml"
    with pytest.raises(InputError, match="luxloop model new"):
        undo(path)
    save(path, Model(name="a"), "one")
    with pytest.raises(InputError, match="nothing to go back to"):
        undo(path)
    with pytest.raises(InputError, match=r"model\.toml: 1"):
        undo(path, to=7)
    assert len(versions(path)) == 1


def test_a_spoilt_list_of_versions_is_named_by_line(tmp_path: Path) -> None:
    """Not passed over in silence: the versions' files are still there."""
    path = tmp_path / "model.toml"
    save(path, Model(name="a"), "one")
    log = tmp_path / ".luxloop" / "models" / "versions.jsonl"
    log.write_text(log.read_text(encoding="utf-8") + '{"number": 2', encoding="utf-8")
    with pytest.raises(InputError, match=r"versions\.jsonl: line 2"):
        save(path, Model(name="b"), "two")
    assert read_model(path).name == "a"


def test_a_list_of_versions_that_is_no_text_is_told(tmp_path: Path) -> None:
    """As any file that cannot be read."""
    path = tmp_path / "model.toml"
    save(path, Model(name="a"), "model new")
    (tmp_path / ".luxloop" / "models" / "versions.jsonl").write_bytes(b"\xb5")
    with pytest.raises(InputError, match=r"versions\.jsonl: .*UTF-8 text"):
        versions(path)


def test_a_text_that_a_kill_left_without_a_line_is_never_written_over(tmp_path: Path) -> None:
    """The next number counts files as well as lines."""
    path = tmp_path / "model.toml"
    save(path, Model(name="a"), "one")
    orphan = tmp_path / ".luxloop" / "models" / "002.toml"
    orphan.write_text("somebody's work", encoding="utf-8")
    assert save(path, Model(name="b"), "two").number == 3
    assert orphan.read_text(encoding="utf-8") == "somebody's work"


def test_a_link_to_a_model_stays_a_link_and_its_rights_stay(tmp_path: Path) -> None:
    """What is replaced is the text of the file it names."""
    (tmp_path / "shared").mkdir()
    real, link = tmp_path / "shared" / "model.toml", tmp_path / "model.toml"
    save(real, Model(name="a"), "one")
    real.chmod(0o660)
    link.symlink_to(real)
    save(link, Model(name="b"), "two")
    assert link.is_symlink()
    assert read_model(real).name == "b"
    assert real.stat().st_mode & 0o777 == 0o660


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    """As bad input, with the operating system's reason."""
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="can be written"):
        save(tmp_path / "model.toml", Model(name="a"), "one")


def test_a_file_where_the_folder_should_be_is_told(tmp_path: Path) -> None:
    """As bad input, with the operating system's reason."""
    (tmp_path / ".luxloop").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="can be written"):
        save(tmp_path / "model.toml", Model(name="a"), "one")


def test_two_processes_that_save_at_once_lose_nothing(tmp_path: Path) -> None:
    """2 x 15 saves make 30 versions with 30 numbers."""
    path = tmp_path / "model.toml"
    both = [saver(path, first, first + 15) for first in (0, 100)]
    assert [process.wait(60) for process in both] == [0, 0]
    assert_whole(path)
    commands = {version.command for version in versions(path)}
    assert commands == {f"save {i}" for i in (*range(15), *range(100, 115))}


@pytest.mark.parametrize("kills", [3, pytest.param(40, marks=pytest.mark.slow)])
def test_a_kill_at_any_moment_leaves_everything_whole(tmp_path: Path, kills: int) -> None:
    """Killed at random moments while saving: no version lost, none half, the next save goes on."""
    path, moments = tmp_path / "model.toml", random.Random(20)
    save(path, Model(name="model -1"), "save -1")
    known = versions(path)
    for round_ in range(1, kills + 1):
        process = saver(path, 1000 * round_, 1000 * round_ + 1000)
        time.sleep(moments.uniform(0.0, 0.05))
        process.send_signal(signal.SIGKILL)
        process.wait(10)
        assert_whole(path)
        assert versions(path)[: len(known)] == known
        known = versions(path)
    assert len(known) > kills
    save(path, Model(name="last"), "last")
    assert_whole(path)
