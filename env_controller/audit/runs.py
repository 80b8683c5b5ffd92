"""Which run is meant: a folder, or an id under the folder of runs."""

from __future__ import annotations

import os
from pathlib import Path

from luxloop.effect import did_you_mean
from luxloop.errors import InputError
from luxloop.journal.reader import segments_of


def find_run(run: str, runs: Path) -> Path:
    """The folder of a run.

    Raises InputError naming what there is where there is no such run, and what is no segment but has the name of one.
    """
    named = Path(run)
    for folder in (runs / run, named):
        if run and folder.is_dir():
            _refuse_unreadable(folder)
            return folder
    if named.is_file():
        raise InputError("RUN", run, "the folder of a run", f"it is a file: name its folder, {named.parent}")
    if not runs.is_dir():
        mend = f"there is no folder {str(runs)!r}: name the run's folder, or the folder of runs by --runs"
        raise InputError("RUN", run, "the folder of a run, or an id under --runs", mend)
    known = sorted(folder.name for folder in runs.iterdir() if folder.is_dir())
    mend = did_you_mean(run, known) or (f"there are {', '.join(known[:5])}" if known else f"{runs} is empty")
    raise InputError("RUN", run, f"the folder of a run, or an id under {runs}", mend)


def _refuse_unreadable(folder: Path) -> None:
    """InputError where what has a segment's name is no file, or may not be read."""
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
