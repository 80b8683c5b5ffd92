"""The film database of PC2: packed tables by their SHA-256, found by the key of the request; one SQLite file in WAL.

A write is one transaction, so a process killed in the middle of it leaves the database as it was (synchronous =
NORMAL: a power cut may also take the last writes, which can be computed again). What is read is hashed again: an
entry that does not match is dropped and reported as missing, and the worker computes it anew. Where the file's own
pages are damaged it is begun anew, for SQLite can neither read nor drop what lies on them. One connection behind a
lock: threads of one process may share an object; processes may share the file, a writer waits 10 s for another.
"""

from __future__ import annotations

import contextlib
import hashlib
import sqlite3
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from luxloop.errors import InputError

MAX_BYTES = 1 << 30
SCHEMA = 1
APPLICATION = 0x4C58464C  # "LXFL", so that another program's SQLite file is recognised
TABLES = """
CREATE TABLE blobs (sha256 TEXT PRIMARY KEY, packed BLOB NOT NULL);
CREATE TABLE uses (sha256 TEXT PRIMARY KEY, bytes INTEGER NOT NULL, used_unix_s REAL NOT NULL) WITHOUT ROWID;
CREATE TABLE films (key TEXT PRIMARY KEY, sha256 TEXT NOT NULL) WITHOUT ROWID;
CREATE INDEX films_by_blob ON films (sha256)
"""
PAGE_BYTES = 16384
CHECKPOINT_PAGES = 256
WAL_BYTES = 16 << 20
BUSY_S = 10.0
HEX = frozenset("0123456789abcdef")
DAMAGE = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
T = TypeVar("T")


class _DamageError(Exception):
    """A page holds what was never written there."""


class FilmDatabase:
    """An open database; `corrupted` counts the entries that could not be read back as they were written."""

    def __init__(self, path: Path, max_bytes: int = MAX_BYTES) -> None:
        if max_bytes <= 0:
            raise InputError("max_bytes", max_bytes, "above 0")
        self._path, self._max_bytes = path, max_bytes
        self._lock = threading.RLock()
        self._used: set[str] = set()
        self.corrupted = 0
        self._connection = _connect(path)

    def get(self, key: str) -> tuple[str, bytes] | None:
        """(hash, packed table) of a request's key, or None where it is not there or no longer what it was."""
        _hex("key", key)
        with self._lock:
            return self._whole(lambda: self._get(key))

    def blob(self, sha256: str) -> bytes | None:
        """The packed table with this hash, or None."""
        _hex("sha256", sha256)
        with self._lock:
            return self._whole(lambda: self._blob(sha256))

    def put(self, key: str, packed: bytes) -> str:
        """Keep a packed table under a request's key; its hash. The least recently used go when the bound is passed.

        Raises InputError for a key that is no SHA-256 or a table above the bound, sqlite3.Error where the disk fails.
        """
        _hex("key", key)
        if len(packed) > self._max_bytes:
            raise InputError("table", f"{len(packed)} bytes", f"at most max_bytes = {self._max_bytes}")
        with self._lock:
            return self._whole(lambda: self._put(key, packed))

    def entries(self) -> list[tuple[str, str, int]]:
        """(key, hash, bytes) of every entry."""
        with self._lock:
            return self._whole(self._entries)

    def close(self) -> None:
        """Write the noted uses and let go of the file."""
        with self._lock, contextlib.closing(self._connection):
            self._whole(self._note_last_uses)

    def __enter__(self) -> FilmDatabase:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _whole(self, act: Callable[[], T]) -> T:
        """What `act` gives; in a damaged file once more, after it was begun anew."""
        try:
            return act()
        except (_DamageError, UnicodeDecodeError, sqlite3.DatabaseError) as error:
            if isinstance(error, sqlite3.Error) and not _is_damage(error):
                raise
            self.corrupted += 1
            _begin_anew(self._connection)
            return act()

    def _get(self, key: str) -> tuple[str, bytes] | None:
        found = self._connection.execute("SELECT key, sha256 FROM films WHERE key = ?", (key,)).fetchone()
        if found and found[0] != key:  # where the tree is out of order a search may end beside what it looks for
            raise _DamageError
        packed = self._blob(found[1]) if found else None
        return (found[1], packed) if packed is not None else None

    def _blob(self, sha256: str) -> bytes | None:
        found = self._connection.execute("SELECT packed FROM blobs WHERE sha256 = ?", (sha256,)).fetchone()
        if found is None:
            return None
        packed = found[0]
        if not isinstance(packed, bytes) or hashlib.sha256(packed).hexdigest() != sha256:
            self.corrupted += 1
            with self._connection:
                self._drop(sha256)
            return None
        self._used.add(sha256)
        return packed

    def _put(self, key: str, packed: bytes) -> str:
        sha256, now = hashlib.sha256(packed).hexdigest(), time.time()
        with self._connection:
            # a write comes first, so that the transaction waits for another process instead of failing half way
            self._connection.execute("INSERT OR REPLACE INTO films VALUES (?, ?)", (key, sha256))
            self._connection.execute("INSERT OR REPLACE INTO blobs VALUES (?, ?)", (sha256, packed))
            self._connection.execute("INSERT OR REPLACE INTO uses VALUES (?, ?, ?)", (sha256, len(packed), now))
            self._note_uses(now)
            self._evict(keep=sha256)
        return sha256

    def _entries(self) -> list[tuple[str, str, int]]:
        """Sizes as numbers: a damaged page may hold anything."""
        query = "SELECT key, sha256, CAST(bytes AS INTEGER) FROM films JOIN uses USING (sha256) ORDER BY key"
        return [(str(key), str(sha256), size) for key, sha256, size in self._connection.execute(query)]

    def _drop(self, sha256: str) -> None:
        for table in ("blobs", "uses", "films"):
            self._connection.execute(f"DELETE FROM {table} WHERE sha256 = ?", (sha256,))  # noqa: S608  # our own names

    def _note_uses(self, now: float) -> None:
        """Uses are noted with the next write: a write for each read would cost more than the read."""
        query = "UPDATE uses SET used_unix_s = ? WHERE sha256 = ?"
        self._connection.executemany(query, [(now, sha256) for sha256 in self._used])
        self._used.clear()

    def _note_last_uses(self) -> None:
        with self._connection:
            self._note_uses(time.time())

    def _evict(self, keep: str) -> None:
        (total,) = self._connection.execute("SELECT sum(CAST(bytes AS INTEGER)) FROM uses").fetchone()
        if total <= self._max_bytes:
            return
        query = "SELECT sha256, CAST(bytes AS INTEGER) FROM uses WHERE sha256 != ? ORDER BY used_unix_s"
        for sha256, size in self._connection.execute(query, (keep,)).fetchall():
            self._drop(sha256)
            total -= size
            if total <= self._max_bytes:
                return


def open_database(path: Path, max_bytes: int = MAX_BYTES) -> FilmDatabase:
    """The database at `path`, made where there is none; its tables together hold at most `max_bytes`.

    Raises InputError for a file that is not a film database, is of a newer schema, or cannot be written.
    """
    return FilmDatabase(path, max_bytes)


def _connect(path: Path) -> sqlite3.Connection:
    try:
        connection = sqlite3.connect(path, timeout=BUSY_S, check_same_thread=False)
    except sqlite3.Error as error:
        raise _unusable(path, error) from error
    connection.text_factory = _text
    try:
        with connection:  # one snapshot: another process may be making the tables at this moment
            connection.execute("BEGIN")
            _is_new(connection, path)  # before anything in another program's file is changed
        connection.execute(f"PRAGMA page_size = {PAGE_BYTES}")
        _write_ahead(connection)
        connection.execute(f"PRAGMA wal_autocheckpoint = {CHECKPOINT_PAGES}")
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute(f"PRAGMA journal_size_limit = {WAL_BYTES}")
        _make_or_check(connection, path)
    except sqlite3.Error as error:
        connection.close()
        raise _unusable(path, error) from error
    except UnicodeDecodeError as error:  # of SQLite's own words on what it cannot read
        connection.close()
        raise _unusable(path, sqlite3.DatabaseError("malformed")) from error
    except InputError:
        connection.close()
        raise
    return connection


def _begin_anew(connection: sqlite3.Connection) -> None:
    """Write empty tables over all that is there, in one transaction: other processes that have the file open go on.

    Raises sqlite3.Error where another process writes for 10 s, or the disk fails.
    """
    end_s = time.monotonic() + BUSY_S

    def wait(status: int, _: int, __: int) -> None:
        if status in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED) and time.monotonic() > end_s:
            raise sqlite3.OperationalError("database is locked")

    with contextlib.closing(sqlite3.connect(":memory:")) as empty:
        empty.execute(f"PRAGMA page_size = {PAGE_BYTES}")
        with empty:
            _make_tables(empty)
        empty.backup(connection, progress=wait)


def _is_damage(error: sqlite3.Error) -> bool:
    """Whether SQLite says that the file is not what it wrote; not: busy, full, gone, or a wrong query."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in DAMAGE


def _text(raw: bytes) -> str:
    """Text of a damaged page may be none; it is then no key and no hash that is asked for."""
    return raw.decode(errors="replace")


def _write_ahead(connection: sqlite3.Connection) -> None:
    """Turn the file's log on. Where another process is about to, SQLite says "locked" at once, and does not wait."""
    end_s = time.monotonic() + BUSY_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > end_s:
                raise
            time.sleep(0.01)
        else:
            return


def _make_or_check(connection: sqlite3.Connection, path: Path) -> None:
    """Make the tables, or see that they are ours: one transaction, since another process may be at the same place."""
    with connection:
        connection.execute("BEGIN IMMEDIATE")
        if _is_new(connection, path):
            _make_tables(connection)
        # written also where it is so already: a read-only file is found now and not with the first table
        connection.execute(f"PRAGMA user_version = {SCHEMA}")


def _make_tables(connection: sqlite3.Connection) -> None:
    for statement in TABLES.split(";"):
        connection.execute(statement)
    connection.execute(f"PRAGMA application_id = {APPLICATION}")
    connection.execute(f"PRAGMA user_version = {SCHEMA}")


def _is_new(connection: sqlite3.Connection, path: Path) -> bool:
    """Whether there are no tables yet; InputError where there are and they are not ours."""
    schema, application, tables = (
        connection.execute(query).fetchone()[0]
        for query in ("PRAGMA user_version", "PRAGMA application_id", "SELECT count(*) FROM sqlite_master")
    )
    if tables and application != APPLICATION:
        raise InputError("film database", str(path), "a luxloop film database", "it is another program's: move it")
    if tables and schema != SCHEMA:
        mend = "it was written by another release: use that, or move it away; what it holds is computed again"
        raise InputError("film database", f"schema {schema}, {path}", f"schema {SCHEMA}", mend)
    made = {sql.strip() for (sql,) in connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")}
    if tables and made != {statement.strip() for statement in TABLES.split(";")}:
        raise _unusable(path, sqlite3.DatabaseError("malformed schema"))
    return not tables


def _unusable(path: Path, error: sqlite3.Error) -> InputError:
    damaged = "not a database" in str(error) or "malformed" in str(error)
    mend = "move it away; what it holds is computed again" if damaged else "choose a file and folder you may write"
    return InputError("film database", str(path), "a SQLite file that can be written", f"{error}; {mend}")


def _hex(field: str, value: str) -> str:
    if len(value) != 64 or not set(value) <= HEX:
        raise InputError(field, value, "a SHA-256, 64 lower-case hex digits")
    return value
