"""The folders of runs: which there are, which is meant, what can be said against one before its journal is read."""

from __future__ import annotations

import os
from pathlib import Path

from luxloop.errors import InputError, LuxloopError
from luxloop.journal.reader import segments_of
from luxloop.settings import Settings


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


def folder_of(settings: Settings, run: str) -> Path:
    """The folder of a run by its id; a folder's path is one, too. Raises InputError naming the runs there are."""
    for folder in (settings.runs_dir / run, Path(run)):
        if any(folder.glob("audit-*.mcap")):
            refuse_unreadable(folder)
            return folder
    known = ", ".join(path.name for path in runs_of(settings)[-5:]) or "there is none yet"
    raise InputError("run", run, f"the id of a run in {settings.runs_dir}: {known}", "luxloop campaign list")


def runs_of(settings: Settings) -> list[Path]:
    """The folders of runs, the newest last."""
    folder = settings.runs_dir
    try:
        found = [path for path in folder.iterdir() if any(path.glob("audit-*.mcap"))]
    except OSError as error:
        if isinstance(error, FileNotFoundError):
            return []
        raise LuxloopError(f"{folder}: {error.strerror}") from error
    return sorted(found, key=lambda path: path.stat().st_mtime)
