"""Large arrays by their content: files named by SHA-256 under the cache folder, bounded in size.

A file is written under another name and renamed, so a killed process leaves no half a blob under a hash; what is
read is hashed again, and a file that does not match is dropped. The least recently used go first.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from luxloop.errors import InputError

MAX_BYTES = 2 << 30
VERIFIED = 16
HEX = frozenset("0123456789abcdef")


class BlobStore:
    """The blobs of this host's processes in `folder`; all methods may be called from any thread or process."""

    def __init__(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        self._folder, self._max_bytes = folder, max_bytes
        self._written_bytes = max_bytes  # many a process writes little: the first blob of each is reason to prune
        self._verified: tuple[tuple[str, int, int], ...] = ()

    def keep(self, raw: bytes) -> str:
        """Store `raw` and return its SHA-256."""
        sha256 = hashlib.sha256(raw).hexdigest()
        path = self._path(sha256)
        try:
            os.utime(path)
        except FileNotFoundError:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, fresh = tempfile.mkstemp(dir=path.parent, prefix=".new-")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(raw)
                Path(fresh).replace(path)
            except BaseException:
                Path(fresh).unlink(missing_ok=True)
                raise
            self._written_bytes += len(raw)
            if self._written_bytes > self._max_bytes // 16:
                self.prune()
        return sha256

    def get(self, sha256: str) -> bytes | None:
        """The bytes with this hash, or None where they are not held here (or no longer match it)."""
        path = self._path(sha256)
        with suppress(OSError):  # not there, or not readable: as good as not held
            raw = path.read_bytes()
            if hashlib.sha256(raw).hexdigest() == sha256:
                os.utime(path)
                return raw
            path.unlink(missing_ok=True)
        return None

    def piece(self, sha256: str, offset: int, length: int) -> tuple[bytes, int] | None:
        """`length` bytes from `offset`, and the size of the whole; None where it is not held here.

        The whole is hashed once for each state of its file, not for each piece: the latest `VERIFIED` are remembered.
        """
        path = self._path(sha256)
        try:
            state = path.stat()
            if (sha256, state.st_size, state.st_ctime_ns) not in self._verified:
                if self.get(sha256) is None:
                    return None
                state = path.stat()  # reading it noted the use
                self._verified = (*self._verified[1 - VERIFIED :], (sha256, state.st_size, state.st_ctime_ns))
            with path.open("rb") as file:
                file.seek(offset)
                return file.read(length), state.st_size
        except OSError:
            return None

    def prune(self) -> None:
        """Drop the least recently used blobs until the store is within its bound."""
        self._written_bytes = 0
        found = []
        for path in self._folder.glob("*/*"):
            with suppress(OSError):  # another process pruned it first
                state = path.stat()
                being_written = path.name.startswith(".new-") and time.time() - state.st_mtime < 3600.0
                found += [] if being_written else [(state.st_mtime, state.st_size, path)]
        total = sum(size for _, size, _ in found)
        for _, size, path in sorted(found):
            if total <= self._max_bytes:
                break
            path.unlink(missing_ok=True)
            total -= size

    def _path(self, sha256: str) -> Path:
        if len(sha256) != 64 or not set(sha256) <= HEX:
            raise InputError("sha256", sha256, "64 lower-case hex digits")
        return self._folder / sha256[:2] / sha256
