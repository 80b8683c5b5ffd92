"""The film database of PC2: packed tables by their SHA-256, found by the key of the request; one SQLite file in WAL.

A write is one transaction, so a process killed in the middle of it leaves the database as it was. What is read is
hashed again: an entry that does not match is dropped and reported as missing, and the worker computes it anew. One
connection behind a lock: threads of one process may share an object, processes may share the file.
"""

from __future__ import annotations

import hashlib
import sqlite3
import threading
import time
from pathlib import Path
from types import TracebackType

from luxloop.errors import InputError

MAX_BYTES = 1 << 30
SCHEMA = 1
APPLICATION = 0x4C58464C  # "LXFL", so that another program's SQLite file is recognised
TABLES = """
CREATE TABLE IF NOT EXISTS blobs (sha256 TEXT PRIMARY KEY, packed BLOB NOT NULL, used_unix_s REAL NOT NULL);
CREATE TABLE IF NOT EXISTS films (key TEXT PRIMARY KEY, sha256 TEXT NOT NULL);
CREATE INDEX IF NOT EXISTS films_by_blob ON films (sha256);
"""


class FilmDatabase:
    """An open database; `corrupted` counts entries that were dropped because they did not match their hash."""

    def __init__(self, path: Path, max_bytes: int = MAX_BYTES) -> None:
        self._path, self._max_bytes = path, max_bytes
        self._lock = threading.RLock()
        self._used: set[str] = set()
        self.corrupted = 0
        self._connection = _connect(path)

    def get(self, key: str) -> tuple[str, bytes] | None:
        """(hash, packed table) of a request's key, or None where it is not there or no longer what it was."""
        with self._lock:
            row = self._connection.execute("SELECT sha256 FROM films WHERE key = ?", (key,)).fetchone()
            packed = self.blob(row[0]) if row else None
            return (str(row[0]), packed) if packed is not None else None

    def blob(self, sha256: str) -> bytes | None:
        """The packed table with this hash, or None."""
        with self._lock:
            row = self._connection.execute("SELECT packed FROM blobs WHERE sha256 = ?", (sha256,)).fetchone()
            if row is None:
                return None
            packed = bytes(row[0])
            if hashlib.sha256(packed).hexdigest() != sha256:
                self._drop(sha256)
                return None
            self._used.add(sha256)
            return packed

    def put(self, key: str, packed: bytes) -> str:
        """Keep a packed table under a request's key; its hash."""
        sha256 = hashlib.sha256(packed).hexdigest()
        now = time.time()
        with self._lock, self._connection:
            self._connection.execute("INSERT OR REPLACE INTO blobs VALUES (?, ?, ?)", (sha256, packed, now))
            self._connection.execute("INSERT OR REPLACE INTO films VALUES (?, ?)", (key, sha256))
            self._note_use(now)
            self._evict(keep=sha256)
        return sha256

    def entries(self) -> list[tuple[str, str, int]]:
        """(key, hash, bytes) of every entry."""
        with self._lock:
            query = "SELECT key, films.sha256, length(packed) FROM films JOIN blobs USING (sha256) ORDER BY key"
            return [(str(key), str(sha256), int(size)) for key, sha256, size in self._connection.execute(query)]

    def close(self) -> None:
        """Write the noted uses and let go of the file."""
        with self._lock:
            with self._connection:
                self._note_use(time.time())
            self._connection.close()

    def __enter__(self) -> FilmDatabase:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _drop(self, sha256: str) -> None:
        self.corrupted += 1
        with self._connection:
            self._connection.execute("DELETE FROM blobs WHERE sha256 = ?", (sha256,))
            self._connection.execute("DELETE FROM films WHERE sha256 = ?", (sha256,))

    def _note_use(self, now: float) -> None:
        """Uses are noted with the next write: a write for each read would cost more than the read."""
        self._connection.executemany(
            "UPDATE blobs SET used_unix_s = ? WHERE sha256 = ?", [(now, sha256) for sha256 in self._used]
        )
        self._used.clear()

    def _evict(self, keep: str) -> None:
        """Drop the least recently used tables until the rest is within the bound."""
        (total,) = self._connection.execute("SELECT coalesce(sum(length(packed)), 0) FROM blobs").fetchone()
        query = "SELECT sha256, length(packed) FROM blobs WHERE sha256 != ? ORDER BY used_unix_s"
        for sha256, size in self._connection.execute(query, (keep,)).fetchall() if total > self._max_bytes else ():
            self._connection.execute("DELETE FROM blobs WHERE sha256 = ?", (sha256,))
            self._connection.execute("DELETE FROM films WHERE sha256 = ?", (sha256,))
            total -= size
            if total <= self._max_bytes:
                return


def open_database(path: Path, max_bytes: int = MAX_BYTES) -> FilmDatabase:
    """The database at `path`, made where there is none.

    Raises InputError for a file that is not a film database, is of another schema, or cannot be written.
    """
    return FilmDatabase(path, max_bytes)


def _connect(path: Path) -> sqlite3.Connection:
    connection = None
    try:
        connection = sqlite3.connect(path, timeout=10.0, check_same_thread=False)
        version, application = (
            connection.execute(f"PRAGMA {n}").fetchone()[0] for n in ("user_version", "application_id")
        )
        fresh = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] == 0
        if not fresh and application != APPLICATION:
            raise InputError(
                "film database", str(path), "a luxloop film database", "it is another program's: move it"
            )
        if not fresh and version != SCHEMA:
            raise InputError("film database", f"{path} of schema {version}", f"schema {SCHEMA}", "move it away")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        with connection:
            connection.executescript(TABLES)
            connection.execute(f"PRAGMA application_id = {APPLICATION}")
            connection.execute(f"PRAGMA user_version = {SCHEMA}")
    except sqlite3.Error as error:
        if connection is not None:
            connection.close()
        mend = "move it away; it is made anew" if "not a database" in str(error) else "choose a folder you may write"
        raise InputError(
            "film database", str(path), "a SQLite file that can be written", f"{error}; {mend}"
        ) from error
    except InputError:
        if connection is not None:
            connection.close()
        raise
    return connection
