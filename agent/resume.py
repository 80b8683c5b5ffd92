"""Going on with a run that was interrupted or killed: everything it needs lies in its folder.

The journal says what was done; the designer is brought to its newest checkpoint that fits (or to its beginning), and
walks on. Steps that are on record come back as they were, so the run ends as if nothing had happened.
"""

from __future__ import annotations

from pathlib import Path

from agent.config import Campaign
from agent.launch import Launched, Start, warn
from agent.progress import Past, WalkEnd
from agent.recorded import Recorded, recorded, wall_s
from luxloop import __version__
from luxloop.errors import InputError
from luxloop.journal.reader import RunJournal
from luxloop.model import Model
from luxloop.model_file import diff, find_model, parse_toml
from luxloop.settings import Settings, usable_cache

NEEDED = ("plan.json", "campaign.json", "model.toml")


def resume(
    settings: Settings,
    folder: Path,
    *,
    as_recorded: bool = False,
    local: bool = True,
    show: bool = False,
    say: bool = False,
) -> Launched:
    """Go on with the run in `folder` to its end; `settings` name the folder of runs that it lies in.

    `as_recorded` goes on with the model that the journal holds, whatever has become of its file. Raises InputError
    where the run has ended, is not of this release, lacks what is needed, or its model has changed since; RemoteError
    where the controller refuses: the run is in use, or damaged.
    """
    run = recorded(folder)
    refuse_ended(run)
    refuse_renamed(run)
    missing = [name for name in NEEDED if name not in run.attachments]
    if missing:
        raise InputError(str(folder), f"no {', '.join(missing)}", "a run that `luxloop campaign run` or `grid` began")
    refuse_another_release(run)
    model = parse_toml(run.attachments["model.toml"].decode(), f"model.toml of {run.plan.run}")
    if not as_recorded:
        refuse_changed(model, run.plan.model)
    campaign = RunJournal(folder).attached("campaign.json", Campaign)
    usable_cache(settings)
    steps = tuple(told.step for told in run.told)
    past = Past(sum(not step.final for step in steps), wall_s(run.told), WalkEnd.among(run.lines))
    return Start(settings, campaign, run.plan, model, steps, past, run.root, local=local, show=show, say=say).go()


def refuse_ended(run: Recorded) -> None:
    """InputError where nothing is left to do."""
    if run.state == "finished" and run.close is not None and run.close.complete:
        mend = f"it has ended ({run.close.reason}): luxloop campaign report {run.plan.run}"
        raise InputError("RUN", run.plan.run, "a run that was interrupted", mend)


def refuse_renamed(run: Recorded) -> None:
    """InputError for a copy under another name: the controller would go on with the run of its own name."""
    folder = run.folder.resolve()
    if folder.name != run.plan.run:
        there = folder.with_name(run.plan.run)
        first = f"move {there} away, then " if there.exists() else ""
        mend = f"it holds the run {run.plan.run!r}: {first}rename {folder} to {there.name}"
        raise InputError("RUN", str(folder), "the folder of a run under the run's own name", mend)


def refuse_another_release(run: Recorded) -> None:
    """InputError where another release began the run: its designer may choose otherwise."""
    release = run.facts.get("version", "")
    if release != __version__:
        mend = f"install that release to go on with it, or begin a new run with this one, {__version__}"
        raise InputError("RUN", run.plan.run, f"a run of this release; it was begun by {release}", mend)


def refuse_changed(recorded_model: Model, source: str) -> None:
    """InputError with the differences where the model's file is not what the run was begun with."""
    if source.endswith(".toml") and not Path(source).exists():
        warn(f"the model's file {source} is not there; going on with the one in the journal")
        return
    now = find_model(source)
    if now.sha256 == recorded_model.sha256:
        return
    changes = "; ".join(map(str, diff(recorded_model, now))) or "its text"
    mend = (
        f"put it back, begin a new run with it, or go on with the recorded one by --as-recorded. Changed: {changes}"
    )
    raise InputError("--model", source, "the model that the run was begun with", mend)
