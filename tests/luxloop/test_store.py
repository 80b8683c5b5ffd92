"""The store of large arrays: what is found under a hash has that hash; its size is bounded."""

from __future__ import annotations

import hashlib
import os
import time
from pathlib import Path
from typing import IO, Any

import pytest

from luxloop.errors import InputError
from luxloop.store import BlobStore


def hash_of(raw: bytes) -> str:
    """SHA-256 in hex."""
    return hashlib.sha256(raw).hexdigest()


def file_of(folder: Path, sha256: str) -> Path:
    """Where the blob lies: the one file whose name is its hash."""
    (found,) = folder.rglob(sha256)
    return found


def test_what_is_kept_is_found_by_its_hash(tmp_path: Path) -> None:
    """Kept by one process's store, found by another's on the same folder; whole and in pieces."""
    sha256 = BlobStore(tmp_path).keep(b"0123456789")
    other = BlobStore(tmp_path)
    assert sha256 == hash_of(b"0123456789")
    assert other.get(sha256) == b"0123456789"
    assert other.piece(sha256, 4, 3) == (b"456", 10)
    assert other.piece(sha256, 8, 100) == (b"89", 10)
    assert other.get(hash_of(b"another")) is None
    assert other.piece(hash_of(b"another"), 0, 1) is None


@pytest.mark.parametrize("when", ["before the first piece", "between two pieces"])
def test_a_changed_file_is_noticed(tmp_path: Path, when: str) -> None:
    """A blob that no longer has its hash is not given out, and is dropped."""
    store = BlobStore(tmp_path)
    sha256 = store.keep(b"x" * 1000)
    if when == "between two pieces":
        assert store.piece(sha256, 0, 10) == (b"x" * 10, 1000)
    path = file_of(tmp_path, sha256)
    path.write_bytes(b"y" * 1000)
    assert store.piece(sha256, 10, 10) is None
    assert store.get(sha256) is None
    assert not path.exists()


def test_the_least_recently_used_go_first(tmp_path: Path) -> None:
    """Over its bound the store drops the oldest; reading or keeping it again makes a blob young."""
    store = BlobStore(tmp_path, max_bytes=3000)
    names = [store.keep(bytes([number]) * 1000) for number in range(3)]
    for age, name in enumerate(names):
        os.utime(file_of(tmp_path, name), (age, age))
    store.get(names[0])
    store.keep(bytes([1]) * 1000)
    store.keep(bytes([9]) * 1000)
    assert [store.get(name) is not None for name in names] == [True, True, False]


def test_many_short_processes_stay_within_the_bound(tmp_path: Path) -> None:
    """Each writes less than what one process may before it looks."""
    for number in range(40):
        BlobStore(tmp_path, max_bytes=1600).keep(bytes([number]) * 90)
    assert sum(path.stat().st_size for path in tmp_path.glob("*/*")) <= 1600


def test_a_blob_that_another_process_drops_meanwhile_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was there a moment ago, and is gone when its use is noted."""
    store = BlobStore(tmp_path)
    path = file_of(tmp_path, store.keep(b"x"))

    def pruned_first(*_: object) -> None:
        path.unlink()
        raise FileNotFoundError

    with monkeypatch.context() as patch:
        patch.setattr(os, "utime", pruned_first)
        store.keep(b"x")
    assert path.read_bytes() == b"x"


def test_a_blob_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    """Pruning drops what a killed process left an hour ago, not what somebody writes now."""
    store = BlobStore(tmp_path, max_bytes=10)
    folder = tmp_path / "ab"
    folder.mkdir()
    fresh, old = folder / ".new-fresh", folder / ".new-old"
    fresh.write_bytes(bytes(100))
    old.write_bytes(bytes(100))
    hours_ago = time.time() - 7200
    os.utime(old, (hours_ago, hours_ago))
    store.prune()
    assert fresh.exists()
    assert not old.exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no disk that is full")
def test_of_a_blob_that_could_not_be_written_nothing_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a full disk took of it would be in the way of the next one for an hour."""
    fdopen = os.fdopen

    def on_a_full_disk(handle: int, mode: str) -> IO[Any]:
        full = os.open("/dev/full", os.O_WRONLY)
        os.dup2(full, handle)
        os.close(full)
        return fdopen(handle, mode)

    monkeypatch.setattr(os, "fdopen", on_a_full_disk)
    with pytest.raises(OSError, match="No space left"):
        BlobStore(tmp_path).keep(bytes(1000))
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("name", ["", "../../etc/passwd", "A" * 64, "0" * 63])
def test_a_name_that_is_no_hash_is_refused(tmp_path: Path, name: str) -> None:
    """A key from the bus never becomes a path unless it is a hash."""
    with pytest.raises(InputError) as caught:
        BlobStore(tmp_path).get(name)
    assert caught.value.field == "sha256"


def test_blobs_fetched_by_turns_are_hashed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not for each piece: of two of 64 MB that was half a second a piece."""
    store = BlobStore(tmp_path)
    hashes = [store.keep(bytes([number]) * 100) for number in range(3)]
    read: list[str] = []
    get = store.get
    monkeypatch.setattr(store, "get", lambda sha256: read.append(sha256) or get(sha256))
    for offset in range(0, 100, 20):
        assert [store.piece(sha256, offset, 1) for sha256 in hashes] == [(bytes([n]), 100) for n in range(3)]
    assert read == hashes
