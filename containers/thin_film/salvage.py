"""A film database whose pages were damaged, on its disk or in its memory: what is whole is kept, the rest goes.

A table that goes is computed again by the next request for it. Without this a damaged page would stay where it is:
SQLite can neither read nor drop what lies on it, and every design with that film would fail until somebody moved the
file away.
"""

from __future__ import annotations

import contextlib
import hashlib
import sqlite3
from collections.abc import Iterator
from typing import Any

DAMAGE = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
ALL_FILMS = (
    "SELECT key, sha256 FROM films ORDER BY key",
    "SELECT key, sha256 FROM films ORDER BY key DESC",
    "SELECT key, sha256 FROM films INDEXED BY films_by_blob",
)
"""From both ends and by the index: each ends at the first damaged page, so together they find what is behind it."""


def is_damage(error: sqlite3.Error) -> bool:
    """Whether SQLite says that the file is not what it wrote; not: busy, full, gone, or a wrong query."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in DAMAGE


def salvage(connection: sqlite3.Connection, tables: str) -> None:
    """Write the file anew through its own connection, in one transaction: other processes that have it open go on.

    What another process writes while this one reads is lost with the damage, and computed again. Raises sqlite3.Error
    where the disk fails.
    """
    (page_bytes,), (application,), (schema,) = (
        connection.execute(f"PRAGMA {name}").fetchone() for name in ("page_size", "application_id", "user_version")
    )
    with contextlib.closing(sqlite3.connect("")) as fresh:  # a file of SQLite's own, gone when it is closed
        fresh.execute(f"PRAGMA page_size = {page_bytes}")
        with fresh:
            for statement in tables.split(";"):
                fresh.execute(statement)
            for key, sha256, packed, used_unix_s in _whole_entries(connection):
                fresh.execute("INSERT OR IGNORE INTO blobs VALUES (?, ?)", (sha256, packed))
                fresh.execute("INSERT OR IGNORE INTO uses VALUES (?, ?, ?)", (sha256, len(packed), used_unix_s))
                fresh.execute("INSERT OR REPLACE INTO films VALUES (?, ?)", (key, sha256))
            fresh.execute(f"PRAGMA application_id = {application}")
            fresh.execute(f"PRAGMA user_version = {schema}")
        fresh.backup(connection)


def _whole_entries(connection: sqlite3.Connection) -> Iterator[tuple[str, str, bytes, float]]:
    """(key, hash, packed table, last use) of every entry that can be read and is what its hash says."""
    for key, sha256 in {pair for query in ALL_FILMS for pair in _readable(connection, query)}:
        packed = _first(connection, "SELECT packed FROM blobs WHERE sha256 = ?", sha256)
        used_unix_s = _first(connection, "SELECT used_unix_s FROM uses WHERE sha256 = ?", sha256)
        if isinstance(packed, bytes) and hashlib.sha256(packed).hexdigest() == sha256:
            yield key, sha256, packed, used_unix_s if isinstance(used_unix_s, float) else 0.0


def _first(connection: sqlite3.Connection, query: str, value: str) -> object:
    return next((row[0] for row in _readable(connection, query, value)), None)


def _readable(connection: sqlite3.Connection, query: str, *values: str) -> Iterator[tuple[Any, ...]]:
    """Rows up to where the pages are damaged."""
    try:
        yield from connection.execute(query, values)
    except sqlite3.DatabaseError as error:
        if not is_damage(error):
            raise
