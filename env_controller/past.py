"""What the journal of a run holds for going on with it: steps told, films known, where its sequence ends."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from env_controller.audit.checks import GIVEN, read_side_file, verify
from env_controller.trials import Past, film_task
from luxloop import __version__
from luxloop.bus import Asked
from luxloop.bus.keys import HOLD_S
from luxloop.campaign import Begin, End, Ended, Plan, Step
from luxloop.errors import LuxloopError, RemoteError
from luxloop.failure import Failure
from luxloop.journal.reader import RunJournal, segments_of, tail_of
from luxloop.journal.scan import Scan
from luxloop.journal.segment import write_side_file
from luxloop.journal.topics import Close
from luxloop.messages import Nothing
from luxloop.ray import Film
from luxloop.words import canonical

log = logging.getLogger(__name__)

KEPT_S = 120.0  # who has not come back for so long for what was read has gone


class Held(NamedTuple):
    """A question that waits for a journal to be read: until when."""

    until_s: float
    asked: Asked


class Read(NamedTuple):
    """What came of reading a journal back, and when."""

    at_s: float
    found: Past | LuxloopError


def read_back(folder: Path, begin: Begin) -> Past:
    """The past of the run in `folder`, which must be the one that `begin` speaks of.

    Raises RemoteError refused where there is no such run, where it is being written, has ended, was taken over by
    another designer, is of another plan or release, or is not what was written.
    """
    if not folder.is_dir():
        mend = f"start the set with LUXLOOP_RUNS set to the folder that holds {folder.name}, or name another set"
        why = f"this controller keeps its runs in {folder.parent}, where there is no folder of a run {folder.name}"
        raise _refused(why, mend)
    try:
        journal, ends = RunJournal(folder), end_of(folder)
        _refuse_another(journal, begin)
        audit = verify(folder, begin.root, None)
        broken = [finding for finding in audit.findings if finding.verdict == "broken"]
        if [finding.what for finding in broken] == [GIVEN]:
            mend = "name the folder that this controller writes to (LUXLOOP_RUNS), or put yours in its place"
            raise _refused(f"the journal in {folder} is not the one that is to be gone on with", mend)
        if broken:
            raise _refused(f"{broken[0].what}: {broken[0].found}", f"luxloop audit recover {folder} --replace")
        return replace(past_of(journal, begin.plan), mark=audit.mark, ends=ends)
    except RemoteError:
        raise
    except (LuxloopError, OSError) as error:
        raise _refused(str(error), f"luxloop audit verify {folder}") from error


def end_of(folder: Path) -> tuple[str, int] | None:
    """Name and size of a run's last segment, None where there is none: nobody has written while they are the same."""
    paths = segments_of(folder)
    return (paths[-1].name, paths[-1].stat().st_size) if paths else None


def ended_before(folder: Path, end: End) -> Ended | None:
    """What a controller before us answered, or would have, when this designer ended its run; None if it has not."""
    try:
        journal = RunJournal(folder)
        mine = journal.metadata("run").get("designer") == end.designer
        over = journal.segments[-1].index is not None and journal.close == Close(end.reason, end.complete)
        if mine and over:
            kept, mark = read_side_file(folder), tail_of(folder)
            if kept is None or kept.records < mark.records:  # a controller that was killed here has not written it
                write_side_file(folder, mark)
            elif kept != mark:
                return None
            return Ended(run=end.run, records=mark.records, root=mark.root, folder=str(folder.resolve()))
    except (LuxloopError, OSError, ValueError):  # ValueError: a side file that holds no mark
        pass
    return None


class Reader:
    """Reads journals back, each in a thread of its own: a long one takes a minute and more.

    Who asks meanwhile is put off: `later` puts the question once more when the journal was read; where its hold is
    over before, it is answered `Nothing`, and its asker comes back.
    """

    def __init__(self, folder: Path, later: Callable[[Asked], object]) -> None:
        self._folder, self._later = folder, later
        self._askers: dict[tuple[str, str], list[Held]] = {}  # of what is being read, by run and designer
        self._pasts: dict[tuple[str, str], Read] = {}
        self._lock = threading.Lock()

    def past(self, asked: Asked, begin: Begin) -> Past | None:
        """The past of the run to go on with; None while it is being read. Raises what `read_back` does.

        Where somebody has written since it was read, it is read again.
        """
        asker = begin.plan.run, begin.designer
        with self._lock:
            found = self._pasts.pop(asker).found if asker in self._pasts else None
            if isinstance(found, Past) and found.ends != end_of(self._folder / begin.plan.run):
                found = None
            if found is None:
                if asker not in self._askers:
                    self._askers[asker] = []
                    threading.Thread(target=self._read, args=(asker, begin), name="past", daemon=True).start()
                self._askers[asker].append(Held(time.monotonic() + HOLD_S, asked))
                return None
        if isinstance(found, LuxloopError):
            raise found
        return found

    def tick(self, now_s: float) -> None:
        """Let go of questions whose hold is over, and of what was read for designers that do not come back."""
        with self._lock:
            for asker, askers in self._askers.items():
                for held in askers:
                    if now_s > held.until_s:
                        held.asked.reply(Nothing())
                self._askers[asker] = [held for held in askers if now_s <= held.until_s]
            for asker in [asker for asker, read in self._pasts.items() if now_s - read.at_s > KEPT_S]:
                del self._pasts[asker]

    def _read(self, asker: tuple[str, str], begin: Begin) -> None:
        found: Past | LuxloopError
        try:
            found = read_back(self._folder / begin.plan.run, begin)
        except LuxloopError as error:
            found = error
        except Exception as error:  # whoever asked is told, and nobody waits for ever
            log.exception("the journal of %s could not be read back", begin.plan.run)
            found = RemoteError(Failure.of(error, "controller"))
        with self._lock:
            self._pasts[asker] = Read(time.monotonic(), found)
            askers = self._askers.pop(asker)
        for held in askers:
            self._later(held.asked)


def was_begun(folder: Path, begin: Begin) -> bool:
    """Whether a controller before us opened the run for this very designer, and died before it could say so."""
    try:
        journal = RunJournal(folder)
        mine = journal.metadata("run").get("designer") == begin.designer
        return mine and journal.segments[-1].index is None  # else it was ended
    except (LuxloopError, OSError):
        return False


def never_begun(folder: Path) -> bool:
    """Whether a controller died before it had committed anything of the run."""
    try:
        paths = segments_of(folder)
        return bool(paths) and not any(next(iter(Scan(path)), None) for path in paths)
    except (LuxloopError, OSError):
        return False


def _refuse_another(journal: RunJournal, begin: Begin) -> None:
    """Raise RemoteError for a run that is in use, has ended, or is not that of this designer and plan."""
    plan, name = begin.plan, begin.plan.run
    if journal.being_written:
        owner = journal.metadata("environment")
        who = f"process {owner.get('pid', '?')} on {owner.get('host', '?')}"
        raise _refused(f"the journal in {journal.folder} is being written by {who}", "end that one first")
    if journal.close is not None and journal.close.complete and journal.segments[-1].index is not None:
        why = f"the run {name!r} in {journal.folder} has ended ({journal.close.reason})"
        raise _refused(why, f"nothing is left to do: luxloop campaign report {name}")
    *before, last = [run.get("designer") for run in journal.starts("run")]
    if begin.designer in before and begin.designer != last:
        why = f"the run {name!r} was taken over by the designer {last}, while this one was not heard of"
        raise _refused(why, f"luxloop campaign status {name}")
    release = journal.metadata("run").get("version", "")
    if release != __version__:
        mend = f"install luxloop {release}, or begin a new run"
        raise _refused(f"the run was begun by luxloop {release}, this is {__version__}", mend)
    recorded = journal.attached("plan.json", Plan)
    if recorded != plan:
        ours, theirs = (json.loads(canonical(one)) for one in (plan, recorded))
        differ = ", ".join(field for field in ours if ours[field] != theirs.get(field))
        raise _refused(f"the run {name!r} was begun with another plan: {differ} differ", "take another id")


def past_of(journal: RunJournal, plan: Plan) -> Past:
    """What a journal holds of a run of this plan."""
    steps: dict[tuple[int, int], Step] = {}
    tables: dict[str, Film] = {}
    sequence = 0
    for entry in journal.records("/step", "/reply/film"):
        if entry.topic == "/step":
            steps[entry.value.lane, entry.value.number] = entry.value
            sequence = max(sequence, entry.sequence + 1)
        elif entry.value.result is not None:
            result = entry.value.result
            tables[entry.value.task_id] = Film(sha256=result["table_sha256"], bytes=result["table_bytes"])
    films = {}
    for pairs in {step.design.dbr_pairs for step in steps.values()} - {0.0}:
        task = film_task(plan, pairs)
        if task.id in tables:
            films[pairs] = task, tables[task.id]
    return Past(steps, films, sequence)


def _refused(message: str, mend: str) -> RemoteError:
    return RemoteError(Failure(code="refused", message=message, mend=mend, where="controller"))
