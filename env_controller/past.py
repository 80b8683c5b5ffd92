"""What the journal of a run holds for going on with it: steps told, films known, where its sequence ends."""

from __future__ import annotations

import json
from pathlib import Path

from env_controller.audit.checks import verify
from env_controller.trials import Past, film_task
from luxloop import __version__
from luxloop.campaign import Plan, Step
from luxloop.errors import LuxloopError, RemoteError
from luxloop.failure import Failure
from luxloop.journal.reader import RunJournal
from luxloop.ray import Film
from luxloop.words import canonical, parse


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


def _refuse_another(journal: RunJournal, plan: Plan) -> None:
    if journal.being_written:
        owner = journal.metadata("environment")
        who = f"process {owner.get('pid', '?')} on {owner.get('host', '?')}"
        raise _refused(f"the journal in {journal.folder} is being written by {who}", "end that one first")
    release = journal.metadata("run").get("version", "")
    if release != __version__:
        mend = f"install luxloop {release}, or begin a new run"
        raise _refused(f"the run was begun by luxloop {release}, this is {__version__}", mend)
    recorded = parse(Plan, json.loads(journal.attachments()["plan.json"]), "plan.json")
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
