"""Puts what was saved of a damaged run into its place, so that the run can be gone on with under its own name.

    replace(run)             # <run> is now what could be saved, <run>-damaged what was there

A run is resumed in the folder that has its id. The recovered run is written beside the damaged one, gets its
checkpoints, and only then the two change names: until then, and where anything fails, the run is as it was.
"""

from __future__ import annotations

import os
from pathlib import Path
from shutil import copy2

from env_controller.audit.recover import Recovery, alone, empty, save, whole_or_nothing
from luxloop.errors import InputError
from luxloop.journal.reader import RunJournal
from luxloop.journal.segment import sync_folder

CHECKPOINTS, PLAN = "checkpoints", "plan.json"


def replace(folder: Path) -> Recovery:
    """Save what can be read of the run in `folder`, which becomes `<run>-damaged`; what was saved takes its place.

    Nothing is replaced where nothing could be saved, or nothing was wrong. Raises InputError where there is no
    journal, where it is being written, and where there is a `<run>-damaged` already; LuxloopError where there is no
    room beside the run.
    """
    folder = folder.resolve()
    damaged, fresh = folder.with_name(f"{folder.name}-damaged"), folder.with_name(f".{folder.name}.recovered")
    if os.path.lexists(damaged):
        mend = f"move {damaged} away: it is what an earlier --replace left aside"
        raise InputError("--replace", str(damaged), "a name that is free", mend)
    with alone(folder) as paths, whole_or_nothing(fresh, "make room there; the run is as it was"):
        empty(fresh)  # of a replacement that was killed
        recovery = save(folder, fresh, paths)
        if recovery.sound:
            empty(fresh)
            fresh.rmdir()
            recovery.out = folder
        elif recovery.mark.records:
            _bring_checkpoints(folder / CHECKPOINTS, fresh / CHECKPOINTS)
            _swap(folder, damaged, fresh)
            recovery.folder, recovery.out, recovery.replaced = damaged, folder, True
    return recovery


def to_go_on_with(folder: Path) -> bool:
    """Whether the run in `folder` is a designer's that had something left to do."""
    journal = RunJournal(folder)
    return PLAN in journal.attachments() and not (journal.close and journal.close.complete)


def _bring_checkpoints(before: Path, after: Path) -> None:
    """A second name, or a copy, of each; whether one fits the steps that were saved is for the resume to say."""
    for path in sorted(before.glob("*")):
        if not path.is_file():
            continue
        after.mkdir(exist_ok=True)
        try:
            os.link(path, after / path.name)
        except OSError:  # a file system without second names
            copy2(path, after / path.name)


def _swap(folder: Path, damaged: Path, fresh: Path) -> None:
    folder.rename(damaged)
    try:
        fresh.rename(folder)
    except BaseException:
        damaged.rename(folder)
        raise
    sync_folder(folder.parent)
