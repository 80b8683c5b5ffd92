"""Which run is meant: a folder, or an id under the folder of runs."""

from __future__ import annotations

from pathlib import Path

from luxloop.effect import did_you_mean
from luxloop.errors import InputError


def find_run(run: str, runs: Path) -> Path:
    """The folder of a run. Raises InputError naming what there is where there is no such run."""
    named = Path(run)
    for folder in (runs / run, named):
        if run and folder.is_dir():
            return folder
    if named.is_file():
        raise InputError("RUN", run, "the folder of a run", f"it is a file: name its folder, {named.parent}")
    if not runs.is_dir():
        mend = f"there is no folder {str(runs)!r}: name the run's folder, or the folder of runs by --runs"
        raise InputError("RUN", run, "the folder of a run, or an id under --runs", mend)
    known = sorted(folder.name for folder in runs.iterdir() if folder.is_dir())
    mend = did_you_mean(run, known) or (f"there are {', '.join(known[:5])}" if known else f"{runs} is empty")
    raise InputError("RUN", run, f"the folder of a run, or an id under {runs}", mend)
