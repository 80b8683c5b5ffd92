"""One command at a time in a folder of blind sets: two would seal one set twice, or end its chain twice."""

from __future__ import annotations

import fcntl
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from luxloop.errors import InputError
from validation.blind_test.folders import LOCK


@contextmanager
def alone(folder: Path, command: str, field: str = "FOLDER") -> Iterator[None]:
    """Holds a folder until the end; made where it is not there. The lock ends with its process, however that ends.

    Raises InputError where another process holds it, naming that one, and where nothing can be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("a+", encoding="utf-8")
    except OSError as error:
        raise InputError(field, str(folder), "a folder that can be written", str(error.strerror)) from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.seek(0)
            mend = f"{lock.read() or 'another process'} works in it: wait for its end, or take another folder"
            raise InputError(field, str(folder), "one command at a time in a folder", mend) from None
        lock.truncate(0)
        lock.write(f"luxloop blind {command} (process {os.getpid()} on {socket.gethostname()})")
        lock.flush()
        try:
            yield
        except KeyboardInterrupt:
            sys.stderr.write(f"luxloop: blind {command} interrupted; the same command goes on where it was\n")
            raise


def refuse_busy(folder: Path) -> None:
    """InputError where another process holds a folder: sets of one truth are judged before any seal of it opens."""
    try:
        lock = (folder / LOCK).open(encoding="utf-8")
    except OSError:
        return  # nobody has ever worked in it
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            mend = f"{lock.read() or 'another process'} works in it: wait for its end"
            raise InputError("FOLDER", str(folder), "a folder that nobody works in", mend) from None
