"""The folders of runs: which there are, which is meant, what can be said against one before its journal is read."""

from __future__ import annotations

import os
from pathlib import Path

from luxloop.effect import did_you_mean
from luxloop.errors import InputError, LuxloopError
from luxloop.journal.reader import segments_of
from luxloop.journal.segment import PATTERN


def runs_in(runs: Path) -> list[Path]:
    """The folders that hold a journal, the newest last. Raises LuxloopError where `runs` cannot be read."""
    try:
        found = [path for path in runs.iterdir() if any(path.glob(PATTERN))]
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:  # ValueError: a name that no folder can have
        raise LuxloopError(f"{runs}: {getattr(error, 'strerror', None) or error}") from error
    return sorted(found, key=lambda path: path.stat().st_mtime)


def find_run(run: str, runs: Path) -> Path:
    """The folder of a run, by its id or by the folder itself.

    Raises InputError naming what there is where there is no such run, and what is no segment but has the name of one.
    """
    named = Path(run)
    for folder in (runs / run, named):
        if run and folder.is_dir():
            refuse_unreadable(folder)
            return folder
    if named.is_file():
        raise InputError("RUN", run, "the folder of a run", f"it is a file: name its folder, {named.parent}")
    if not runs.is_dir():
        mend = f"there is no folder {str(runs)!r}: name the run's folder, or the folder of runs by --runs"
        raise InputError("RUN", run, "the folder of a run, or an id under --runs", mend)
    newest = [folder.name for folder in reversed(runs_in(runs))]
    mend = did_you_mean(run, newest) or (f"there are {', '.join(newest[:5])}" if newest else f"{runs} holds none")
    raise InputError("RUN", run, f"the folder of a run, or an id under {runs}", f"{mend}; luxloop campaign list")


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
