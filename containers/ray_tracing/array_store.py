"""Stored arrays: a folder of files, each named by the key of the inputs that its arrays were computed from.

    magic (8 bytes) | length of the header (uint64) | header, JSON | arrays, raw, each at a multiple of 64 | SHA-256

All little-endian, nothing pickled. The header holds the key, what the caller adds, and name, dtype and shape of each
array; the hash at the end is over everything before it. A file is written under another name, synced and renamed, so
a process killed at any time leaves no half file under a key. What it does leave is under a lock that died with it,
and the next to open or write the store takes it away. A file that does not hash to its end is removed, and what it
held is computed again.

Reading maps the file, so processes share its pages, and an array stays valid after its file was evicted. The whole is
hashed once for each file and object of this class; afterwards a get costs a few system calls, and damage done inside
a file that was already verified is not seen. `max_bytes` bounds the folder; the least recently used (mtime, which a
get touches) go first. Several processes may use one folder: what one evicts, another computes again.

The store never stands in the way of the work: where the folder cannot be made or written, or the disk is full, it
keeps nothing and says so in `problem`.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import mmap
import os
import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import BufferedReader, BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from luxloop.words import canonical

Arrays = dict[str, NDArray[Any]]

MAX_BYTES = 8 << 30
MAGIC = b"LXEXIT\x00\x01"
"""The last byte is the version of the layout: a file of another one is computed again."""
WRITING = ".new-"
ALIGN = 64
HASH_BYTES = 32
MAX_HEADER_BYTES = 1 << 20
KINDS = frozenset("biuf")
PIECE_BYTES = 1 << 20
HEX = frozenset("0123456789abcdef")


class Damaged(Exception):  # noqa: N818  # a finding, caught where the file is opened
    """A file that is not what was written under its key; the text says how one sees it."""


@dataclass(frozen=True)
class _Layout:
    """Where the arrays of a file lie."""

    header: Mapping[str, Any]
    arrays: Mapping[str, tuple[np.dtype[Any], tuple[int, ...], int]]
    """dtype, shape and offset of each."""
    file_bytes: int


class ArrayStore:
    """The stored arrays in `folder`; all methods may be called from any thread, and any number of processes.

    `what` they are ends the names of files: no two sorts in one folder.

    `problem` is the last thing that kept it from reading or keeping something ("" when all went well); `warn` is told
    each. `damaged` counts the files that were removed because they were not what had been written.
    """

    def __init__(
        self,
        folder: Path,
        max_bytes: int = MAX_BYTES,
        warn: Callable[[str], None] | None = None,
        *,
        what: str = "arrays",
    ) -> None:
        if max_bytes <= 0:
            raise InputError("max_bytes", max_bytes, "above 0")
        self.problem, self.damaged = "", 0
        self._folder, self._max_bytes, self._warn, self._what = folder, max_bytes, warn, what
        self._verified: dict[str, tuple[int, int, int, bytes]] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._make_room(0)
        except OSError as error:
            self._note(f"the store cannot be used: {error}")

    def get(self, key: str) -> Arrays | None:
        """The arrays kept under `key`, read-only and mapped, or None where they are not there or were damaged.

        numba compiles a kernel a second time for read-only arrays: set `flags.writeable = False` on fresh ones too.
        """
        found = self._open(key)
        if found is None:
            return None
        layout, raw = found
        return {
            name: np.frombuffer(raw, dtype, count=int(np.prod(shape)), offset=offset).reshape(shape)
            for name, (dtype, shape, offset) in layout.arrays.items()
        }

    def header(self, key: str) -> Mapping[str, Any] | None:
        """What the caller of `put` said about the arrays under `key`, or None as `get`."""
        found = self._open(key)
        return None if found is None else found[0].header

    def put(self, key: str, arrays: Mapping[str, NDArray[Any]], header: Mapping[str, Any]) -> bool:
        """Keep `arrays` under `key`; False where they could not be kept, and `problem` says why.

        Parameters
        ----------
        key : SHA-256 of the inputs from which the arrays were computed, 64 lower-case hex digits.
        arrays : by name; numbers or booleans, any shape.
        header : JSON values, for people and for checks: chip, seed, count, versions.

        Raises
        ------
        InputError : a key that is no SHA-256, an array of objects or words, a header that is no JSON.
        """
        path = self._path(key)
        plain = {name: _little_endian(name, array) for name, array in arrays.items()}
        beginning = _beginning(key, plain, header)
        size = _layout(beginning[16:], key).file_bytes
        if size > self._max_bytes:
            self._note(f"{size} bytes are more than the store may hold ({self._max_bytes}): not kept")
            return False
        try:
            self._make_room(size)
            self._write(path, beginning, plain)
            self._make_room(0, keep=path)
        except OSError as error:
            self._note(f"not kept: {error}")
            return False
        return True

    def _open(self, key: str) -> tuple[_Layout, mmap.mmap] | None:
        path = self._path(key)
        try:
            with path.open("rb") as file:
                layout, raw = self._mapped(file, key)
        except FileNotFoundError:
            self._verified.pop(key, None)
            return None
        except Damaged as error:
            self.damaged += 1
            self._verified.pop(key, None)
            self._note(f"{path.name} was damaged, its arrays are computed again: {error}")
            with contextlib.suppress(OSError):  # a read-only store: found damaged again by the next
                path.unlink(missing_ok=True)
            return None
        except OSError as error:
            self._note(f"{path.name} cannot be read: {error}")
            return None
        with contextlib.suppress(OSError):  # a read-only store: its order of use is another's matter
            _touch(path)
        return layout, raw

    def _mapped(self, file: BufferedReader, key: str) -> tuple[_Layout, mmap.mmap]:
        """The layout and the mapped bytes of an open file, hashed where this object has not seen the file yet.

        Hashed by reading and not through the map: a bad disk then is an error, where the map would end the process.
        """
        state = os.fstat(file.fileno())
        if state.st_size < len(MAGIC) + 8 + HASH_BYTES:
            raise Damaged(f"{state.st_size} bytes")
        file.seek(-HASH_BYTES, os.SEEK_END)
        seen = (state.st_dev, state.st_ino, state.st_size, file.read(HASH_BYTES))
        if self._verified.get(key) != seen and _hash(file, state.st_size - HASH_BYTES) != seen[-1]:
            raise Damaged("its SHA-256 does not match")
        raw = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        length = int.from_bytes(raw[8:16], "little")
        if raw[:8] != MAGIC or length > MAX_HEADER_BYTES:
            raise Damaged("not a file of stored arrays of this version")
        layout = _layout(raw[16 : 16 + length], key)
        if layout.file_bytes != state.st_size:
            raise Damaged(f"{state.st_size} bytes where its header asks for {layout.file_bytes}")
        self._verified[key] = seen
        return layout, raw

    def _write(self, path: Path, beginning: bytes, arrays: Arrays) -> None:
        """One file, whole or not at all. The lock tells others that its writer lives, and dies with it."""
        file, new = self._new_file()
        try:
            with file:
                _write_all(file, beginning, arrays)
                file.flush()
                os.fsync(file.fileno())
                _touch(new)
                new.replace(path)
        finally:
            new.unlink(missing_ok=True)
        folder = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(folder)  # the name, too, is on the disk
        finally:
            os.close(folder)

    def _new_file(self) -> tuple[BufferedWriter, Path]:
        """A new locked file and its path; another one where somebody took it for abandoned before it was locked."""
        while True:
            path = self._folder / f"{WRITING}{secrets.token_hex(8)}"
            file = path.open("xb")
            fcntl.flock(file, fcntl.LOCK_EX)
            if path.exists():
                return file, path
            file.close()

    def _make_room(self, wanted_bytes: int, keep: Path | None = None) -> None:
        """Take away what dead writers left, then the least recently used until `wanted_bytes` fit."""
        found, total = [], wanted_bytes
        for path in self._folder.iterdir():
            with contextlib.suppress(FileNotFoundError):  # another process took it away
                if path.name.startswith(WRITING) and _gone_if_abandoned(path):
                    continue
                if path.suffix == self._ending or path.name.startswith(WRITING):
                    state = path.stat()
                    total += state.st_size
                    found.append((state.st_mtime_ns, path, state.st_size))
        for _, path, size in sorted(found):
            if total <= self._max_bytes:
                return
            if path != keep and path.suffix == self._ending:
                path.unlink(missing_ok=True)  # arrays mapped from it stay: the file goes with the last of them
                self._verified.pop(path.name.removesuffix(self._ending), None)
                total -= size

    @property
    def _ending(self) -> str:
        return f".{self._what}"

    def _path(self, key: str) -> Path:
        if len(key) != 64 or not set(key) <= HEX:
            raise InputError("key", key, "a SHA-256, 64 lower-case hex digits")
        return self._folder / (key + self._ending)

    def _note(self, problem: str) -> None:
        self.problem = f"stored {self._what} in {self._folder}: {problem}"
        if self._warn is not None:
            self._warn(self.problem)


def _little_endian(name: str, array: NDArray[Any]) -> NDArray[Any]:
    """The same numbers as they lie in a file; InputError for what has no place in one."""
    array = np.asarray(array)
    if array.dtype.kind not in KINDS or array.dtype.itemsize > 8:
        raise InputError(f"arrays.{name}", str(array.dtype), "booleans, integers or floats of at most 64 bits")
    return np.asarray(array, array.dtype.newbyteorder("<"), order="C")


def _beginning(key: str, arrays: Arrays, header: Mapping[str, Any]) -> bytes:
    """Magic, length and header of a file."""
    described = [{"name": name, "dtype": array.dtype.str, "shape": array.shape} for name, array in arrays.items()]
    try:
        text = canonical({"key": key, "header": dict(header), "arrays": described})
    except (TypeError, ValueError) as error:
        raise InputError("header", header, "JSON values", str(error)) from error
    if len(text) > MAX_HEADER_BYTES:
        raise InputError("header", f"{len(text)} bytes", f"at most {MAX_HEADER_BYTES} bytes")
    return MAGIC + len(text).to_bytes(8, "little") + text


def _layout(text: bytes, key: str) -> _Layout:
    """Where things lie in the file with this header; Damaged where it is not one of ours, or another key's."""
    try:
        header = json.loads(text)
        if header["key"] != key:
            raise Damaged("it belongs to another key")
        end, arrays = 16 + len(text), {}
        for one in header["arrays"]:
            dtype, shape = np.dtype(str(one["dtype"])), tuple(int(size) for size in one["shape"])
            if dtype.kind not in KINDS or any(size < 0 for size in shape):
                raise Damaged(f"array {one['name']!r} cannot be")
            start = -(-end // ALIGN) * ALIGN
            arrays[str(one["name"])] = (dtype, shape, start)
            end = start + dtype.itemsize * int(np.prod(shape, dtype=object))  # exact: a shape may be nonsense
        return _Layout(dict(header["header"]), arrays, end + HASH_BYTES)
    except (KeyError, TypeError, ValueError) as error:
        raise Damaged(f"its header cannot be read: {error}") from error


def _write_all(file: BufferedWriter, beginning: bytes, arrays: Arrays) -> None:
    """A file's bytes, hashed on the way."""
    digest, end = hashlib.sha256(beginning), len(beginning)
    file.write(beginning)
    for array in arrays.values():
        for piece in (bytes(-end % ALIGN), array.reshape(-1).view(np.uint8).data):
            file.write(piece)
            digest.update(piece)
            end += len(piece)
    file.write(digest.digest())


def _hash(file: BufferedReader, size: int) -> bytes:
    """SHA-256 of a file's first `size` bytes."""
    digest, piece = hashlib.sha256(), memoryview(bytearray(PIECE_BYTES))
    file.seek(0)
    while size > 0:
        read = file.readinto(piece[: min(size, PIECE_BYTES)])
        if not read:
            break  # it became shorter meanwhile
        digest.update(piece[:read])
        size -= read
    return digest.digest()


def _gone_if_abandoned(path: Path) -> bool:
    """Take a file away that nobody alive is writing, and whether it was one: a lock ends with its process.

    Under the lock, for whoever has just begun a file locks it next, and looks whether it is still there.
    """
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        path.unlink()
    return True


def _touch(path: Path) -> None:
    """Note a use now; the clock's nanoseconds, since the file system's own would tie uses within 4 ms."""
    now = time.time_ns()
    os.utime(path, ns=(now, now))
