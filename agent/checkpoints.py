"""Checkpoints of a run: all that its designer is, in `runs/<id>/checkpoints`, each tied to a place in the journal.

A checkpoint only saves time: without one, a resumed designer walks its journal again from the beginning and comes to
the same. So one that cannot be written is told, and one that does not fit is left aside with the reason.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agent.ask_tell import BROKEN, Checkpoint
from agent.campaign import NOTHING_TOLD, digest_after
from luxloop import __version__
from luxloop.campaign import Plan, Step
from luxloop.errors import InputError, LuxloopError
from luxloop.words import sha256_of

if TYPE_CHECKING:
    from agent.campaign import Runner

FOLDER, PATTERN, ASIDE = "checkpoints", "checkpoint-*.npz", ".aside"
EVERY_STEPS = 50
KEPT = 3
MAX_BYTES = 1 << 30


class Checkpoints:
    """The checkpoints of one run. `warn` is told what could not be written or does not fit."""

    def __init__(self, run_folder: Path | None, plan: Plan, warn: Callable[[str], None]) -> None:
        """`run_folder` is None where the run's folder is out of reach, on the controller's machine: none are kept."""
        self._folder = run_folder / FOLDER if run_folder else None
        self._plan_sha256, self._warn = sha256_of(plan), warn
        self._saved_steps, self._refused = 0, False

    def on_turn(self, runner: Runner) -> None:
        """Save where enough was told since the last time."""
        if runner.progress.steps >= self._saved_steps + EVERY_STEPS:
            self.save(runner)

    def save(self, runner: Runner) -> None:
        """Write the state, whole or not at all, and let go of the oldest. A full disk is told, once."""
        self._saved_steps = runner.progress.steps
        if self._folder is None:
            return
        state = runner.state()
        words = {"version": __version__, "plan_sha256": self._plan_sha256, "runner": state.words}
        path = self._folder / f"checkpoint-{self._saved_steps:08}.npz"
        try:
            self._folder.mkdir(exist_ok=True)
            _write_whole(path, Checkpoint(words, state.arrays).to_bytes())
            others = [one for one in self._newest_first() if one != path]
            for old in others[KEPT - 1 :]:
                old.unlink(missing_ok=True)
        except OSError as error:
            if not self._refused:
                why = f"{path}: {error.strerror or error}"
                self._warn(
                    f"no checkpoint was written ({why}); the journal holds every step, so a resume only takes longer;"
                    " make room there"
                )
            self._refused = True

    def restored(self, make: Callable[[], Runner], steps: Collection[Step]) -> Runner:
        """A runner in its newest state that fits the steps on record; a fresh one where there is none.

        What does not fit is told and left aside, under a name that is no checkpoint's: damaged, of another release
        or plan, ahead of the journal, or of other steps.
        """
        for path in self._newest_first():
            runner = make()
            try:
                words, arrays = _read(path)
                self._refuse_unfit(words, steps)
                runner.restore(Checkpoint(words["runner"], arrays))
            except (LuxloopError, LookupError, *BROKEN) as error:
                self._warn(f"{path.name} is left aside ({error}); an older one, or the journal alone, will do")
                with suppress(OSError):
                    path.replace(path.with_suffix(ASIDE))
                continue
            self._saved_steps = runner.progress.steps
            return runner
        return make()

    def _refuse_unfit(self, words: dict[str, Any], steps: Collection[Step]) -> None:
        """Raises InputError for a checkpoint of another release or run, or of steps that the journal has not."""
        for field, ours in {"version": __version__, "plan_sha256": self._plan_sha256}.items():
            if words[field] != ours:
                raise InputError(f"checkpoint.{field}", words[field], ours)
        runner = words["runner"]
        for lane, (told, digest) in enumerate(zip(runner["told"], runner["digests"], strict=True)):
            on_record = digest_of(lane, told, steps)
            if on_record is None:
                raise InputError("checkpoint.told", f"{told} of lane {lane}", "no more than the journal holds")
            if on_record != digest:
                raise InputError("checkpoint.digests", f"that of lane {lane}", "those of the journal's steps")

    def _newest_first(self) -> list[Path]:
        return sorted(self._folder.glob(PATTERN), reverse=True) if self._folder else []


def digest_of(lane: int, told: int, steps: Collection[Step]) -> str | None:
    """The digest of a lane's first steps; None where the record does not hold so many."""
    ours = {step.number: step for step in steps if step.lane == lane}
    digest = NOTHING_TOLD
    for number in range(told):
        if number not in ours:
            return None
        digest = digest_after(digest, ours[number])
    return digest


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    if path.stat().st_size > MAX_BYTES:
        raise InputError(path.name, f"{path.stat().st_size:,} bytes", f"at most {MAX_BYTES:,}")
    whole = Checkpoint.from_bytes(path.read_bytes())
    return whole.words, whole.arrays


def _write_whole(path: Path, data: bytes) -> None:
    """Write a file so that after a crash it is there whole, or not at all."""
    fresh = path.with_name(f".{path.name}.new")
    try:
        with fresh.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError:
        with suppress(OSError):
            fresh.unlink(missing_ok=True)
        raise
