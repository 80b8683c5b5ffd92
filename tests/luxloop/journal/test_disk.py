"""The journal and its disk: what it promises is on it, and what it says where that fails."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from luxloop.errors import LuxloopError, RemoteError
from luxloop.journal import segment as segment_module
from luxloop.journal.reader import RunJournal
from luxloop.journal.scan import Scan
from tests.journals import held_up, messages, open_journal, put, records_of_step, write_run


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system with room for 64 KiB; skipped where none may be mounted."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = shutil.which("mount")
    if mount is None or os.geteuid() != 0:
        pytest.skip("mounting a small file system needs root")
    command = [mount, "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("a small file system cannot be mounted here")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=False)


def test_a_full_disk_is_said_and_nothing_acknowledged_is_lost(tiny_disk: Path) -> None:
    """ENOSPC of a real file system, then room is made and the run goes on in a new segment."""
    ballast = tiny_disk / "ballast"
    ballast.write_bytes(bytes(32 << 10))
    folder = tiny_disk / "run"
    journal = open_journal(folder)
    acknowledged = []

    def fill() -> None:
        for number in range(1000):
            put(journal, records_of_step(number))
            acknowledged.append(number)

    with pytest.raises(RemoteError, match="No space left") as caught:
        fill()
    assert "make room" in caught.value.failure.mend
    assert str(folder) in str(caught.value)
    for again in (lambda: put(journal, records_of_step(0)), journal.finish):
        with pytest.raises(RemoteError, match="No space left"):
            again()
    journal.close()
    assert [step.number for step in RunJournal(folder).steps()] == acknowledged
    ballast.unlink()
    write_run(folder, 1, first=len(acknowledged))
    assert [step.number for step in RunJournal(folder).steps()] == [*acknowledged, len(acknowledged)]


@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC, errno.EROFS])
def test_the_first_failure_of_the_disk_is_final(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    """fdatasync fails once and would work again: what it lost cannot be known, so nothing more is acknowledged."""
    journal = open_journal(tmp_path)
    put(journal, records_of_step(0))
    with monkeypatch.context() as patch:

        def fails(_: int) -> None:
            raise OSError(code, os.strerror(code))

        patch.setattr(os, "fdatasync", fails)
        with pytest.raises(RemoteError, match=os.strerror(code)):
            put(journal, records_of_step(1))
    with pytest.raises(RemoteError, match=os.strerror(code)):
        put(journal, records_of_step(2))
    with pytest.raises(RemoteError, match=os.strerror(code)):
        journal.finish()
    journal.close()
    assert messages(tmp_path) == records_of_step(0)


def test_what_came_while_the_disk_failed_is_not_written_though_it_recovers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A batch taken while the sync before it was failing is told the same error, and is not in the journal."""
    journal = open_journal(tmp_path)
    put(journal, records_of_step(0))
    failing, over, works = threading.Event(), threading.Event(), os.fdatasync

    def fails_once(_: int) -> None:
        monkeypatch.setattr(os, "fdatasync", works)
        failing.set()
        over.wait(20)
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fdatasync", fails_once)
    told: list[LuxloopError | None] = []
    journal.put(records_of_step(1), told.append)
    assert failing.wait(20)
    journal.put(records_of_step(2), told.append)
    over.set()
    journal.close()
    assert [os.strerror(errno.EIO) in str(error) for error in told] == [True, True]
    assert messages(tmp_path) == records_of_step(0)
    scan = Scan(journal.folder / "audit-0001.mcap")
    assert len(list(scan)) == 2  # the opening and step 0
    assert (scan.torn, scan.fault, scan.left_bytes) == (True, "", 0)


def test_batches_that_wait_when_the_disk_fails_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for ever."""
    journal = open_journal(tmp_path)
    told: list[LuxloopError | None] = []
    busy = held_up(journal)
    for number in range(1, 4):
        journal.put(records_of_step(number), told.append)
    monkeypatch.setattr(
        segment_module._DurableFile, "sync", lambda _: (_ for _ in ()).throw(OSError(errno.EIO, "gone"))
    )
    busy.set()
    journal.close()
    assert [type(error) for error in told] == [RemoteError] * 3
    assert all("gone" in str(error) for error in told)


def test_a_folder_that_is_removed_is_noticed(tmp_path: Path) -> None:
    """Writing to a removed file succeeds, and nobody would ever find it."""
    folder = tmp_path / "run"
    journal = open_journal(folder)
    put(journal, records_of_step(0))
    shutil.rmtree(folder)
    with pytest.raises(RemoteError, match="removed"):
        put(journal, records_of_step(1))
    journal.close()


def test_a_journal_that_could_not_begin_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same id can be taken once there is room: no folder, no empty segment."""

    def fails(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", fails)
        with pytest.raises(RemoteError, match="No space left"):
            open_journal(tmp_path / "run")
    assert not (tmp_path / "run").exists()
    assert write_run(tmp_path / "run", 1) == messages(tmp_path / "run")


@pytest.mark.parametrize("place", ["/proc/run", "{}/file/run", "{}/file"])
def test_a_folder_that_cannot_be_written_is_said_at_once(tmp_path: Path, place: str) -> None:
    """With its name and a mend, before anything is computed."""
    (tmp_path / "file").write_text("in the way")
    folder = Path(place.format(tmp_path))
    with pytest.raises(RemoteError, match="cannot be written") as caught:
        open_journal(folder)
    assert str(folder) in caught.value.failure.message
    assert "another results folder" in caught.value.failure.mend


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_read_only_folder_is_said_at_once(tmp_path: Path) -> None:
    """By its permissions."""
    tmp_path.chmod(0o500)
    with pytest.raises(RemoteError, match="Permission denied"):
        open_journal(tmp_path)
    tmp_path.chmod(0o700)


def test_names_are_made_durable_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of new folders, of the segment, of the side file once it is whole: a power cut would lose what has no name."""
    folder = tmp_path / "results" / "run"
    side, synced = folder / segment_module.SIDE_FILE, list[tuple[int, bool]]()
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append((os.fstat(handle).st_ino, side.exists())))
    journal = open_journal(folder)
    assert synced == [(place.stat().st_ino, False) for place in (tmp_path, folder.parent, folder)]
    synced.clear()
    put(journal, records_of_step(0))
    journal.finish()
    assert synced == [(side.stat().st_ino, False), (folder.stat().st_ino, True)]
