"""What the journal of a run holds for going on with it: steps told, films known, where its sequence ends."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from pathlib import Path

from env_controller.audit.checks import verify
from env_controller.trials import Past, film_task
from luxloop import __version__
from luxloop.bus import Asked
from luxloop.campaign import Begin, Plan, Step
from luxloop.errors import LuxloopError, RemoteError
from luxloop.failure import Failure
from luxloop.journal.chain import Mark
from luxloop.journal.reader import RunJournal, segments_of, tail_of
from luxloop.ray import Film
from luxloop.words import canonical, parse

log = logging.getLogger(__name__)


def read_back(folder: Path, plan: Plan) -> Past:
    """The past of the run in `folder`, which must be the one that `plan` describes.

    Raises RemoteError: not_found where there is no such run, refused where it is being written, is of another plan
    or release, or is not what was written.
    """
    try:
        journal = RunJournal(folder)
        _refuse_another(journal, plan)
        broken = [finding for finding in verify(folder, None, None).findings if finding.verdict == "broken"]
        if broken:
            raise _refused(f"{broken[0].what}: {broken[0].found}", f"luxloop audit recover {folder}")
        return _read(journal, plan)
    except RemoteError:
        raise
    except (LuxloopError, OSError) as error:
        raise _refused(str(error), f"luxloop audit verify {folder}") from error


class Reader:
    """Reads journals back, each in a thread of its own: a long one takes seconds.

    Who asks meanwhile is put off: `later` puts the question once more when the journal was read.
    """

    def __init__(self, folder: Path, later: Callable[[Asked], object]) -> None:
        self._folder, self._later = folder, later
        self._askers: dict[str, list[Asked]] = {}
        self._pasts: dict[str, Past | LuxloopError] = {}
        self._lock = threading.Lock()

    def past(self, asked: Asked, plan: Plan) -> Past | None:
        """The past of a plan's run; None while it is being read. Raises what `read_back` does."""
        with self._lock:
            found = self._pasts.pop(plan.run, None)
            if found is None:
                askers = self._askers.setdefault(plan.run, [])
                askers.append(asked)
                if len(askers) == 1:
                    threading.Thread(target=self._read, args=(plan,), name="past", daemon=True).start()
                return None
        if isinstance(found, LuxloopError):
            raise found
        return found

    def _read(self, plan: Plan) -> None:
        found: Past | LuxloopError
        try:
            found = read_back(self._folder / plan.run, plan)
        except LuxloopError as error:
            found = error
        except Exception as error:  # whoever asked is told, and nobody waits for ever
            log.exception("the journal of %s could not be read back", plan.run)
            found = RemoteError(Failure.of(error, "controller"))
        with self._lock:
            self._pasts[plan.run] = found
            askers = self._askers.pop(plan.run)
        for asked in askers:
            self._later(asked)


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
        return bool(segments_of(folder)) and tail_of(folder) == Mark()
    except (LuxloopError, OSError):
        return False


def _refuse_another(journal: RunJournal, plan: Plan) -> None:
    if journal.being_written:
        owner = journal.metadata("environment")
        who = f"process {owner.get('pid', '?')} on {owner.get('host', '?')}"
        raise _refused(f"the journal in {journal.folder} is being written by {who}", "end that one first")
    release = journal.metadata("run").get("version", "")
    if release != __version__:
        mend = f"install luxloop {release}, or begin a new run"
        raise _refused(f"the run was begun by luxloop {release}, this is {__version__}", mend)
    attached = journal.attachments()
    if "plan.json" not in attached:
        raise _refused("the run has no plan on record", "it was not begun by `luxloop campaign run` or `grid`")
    recorded = parse(Plan, json.loads(attached["plan.json"]), "plan.json")
    if recorded != plan:
        ours, theirs = (json.loads(canonical(one)) for one in (plan, recorded))
        differ = ", ".join(name for name in ours if ours[name] != theirs.get(name))
        raise _refused(f"the run {plan.run!r} was begun with another plan: {differ} differ", "take another id")


def _read(journal: RunJournal, plan: Plan) -> Past:
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
