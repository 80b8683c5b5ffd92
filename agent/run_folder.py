"""What can be said against a run's folder before its journal is read."""

from __future__ import annotations

import os
from pathlib import Path

from luxloop.errors import InputError
from luxloop.journal.reader import segments_of


def refuse_unreadable(folder: Path) -> None:
    """Raises InputError, with the mend, where what has the name of a segment is no file, or may not be read."""
    for path in segments_of(folder):
        if path.is_file() and os.access(path, os.R_OK):
            continue
        if path.is_symlink() and not path.exists():
            mend = f"bring back what {path} points to, {path.readlink()}, or remove the link"
        elif path.is_file():
            mend = f"let yourself read {path}, or ask its owner to"
        else:
            mend = f"move {path} away: it is no file"
        raise InputError("RUN", str(folder), "a run whose segments are files that can be read", mend)
