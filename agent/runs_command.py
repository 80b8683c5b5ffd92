"""`luxloop campaign list|status|resume`: runs that there are, how they stand, going on with one."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from agent.in_words import line
from agent.options import Json, NoLocal, Quiet, Router, Runs
from agent.telling import tell
from luxloop.errors import InputError, LuxloopError
from luxloop.journal.topics import VALIDATION
from luxloop.run_folders import find_run, refuse_unreadable, runs_in
from luxloop.settings import Settings, load_settings


def list_(runs: Runs = None, as_json: Json = False) -> None:
    """The runs in the results folder, the newest last."""
    from agent.overview import overview

    rows = [_row(overview, folder) for folder in runs_in(load_settings(runs=runs).runs_dir)]
    if as_json:
        typer.echo(json.dumps({"runs": rows}))
        return
    for row in rows:
        typer.echo(_row_text(row))
    if not rows:
        typer.echo("no runs yet: luxloop run")


def _row(overview: Callable[[Path], dict[str, Any]], folder: Path) -> dict[str, Any]:
    """A run of the list; one that cannot be read does not hide the others."""
    row = {"run": folder.name, "folder": str(folder)}
    try:
        refuse_unreadable(folder)
    except InputError as error:
        return row | {"damaged": str(error), "mend": error.mend}
    try:
        return overview(folder)
    except (LuxloopError, OSError) as error:
        return row | {"damaged": str(error), "mend": f"luxloop audit verify {shlex.quote(str(folder))}"}


def status(
    run: Annotated[str | None, typer.Argument(help="Id of a run.", show_default=False)] = None,
    follow: Annotated[bool, typer.Option("--follow", help="Go on telling each new step until the run ends.")] = False,
    source: Annotated[
        str | None, typer.Option("--from", help="With --follow: replay/RUN, a replay on the bus, not a journal.")
    ] = None,
    runs: Runs = None,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """How far a run is, or what came of it: read from its journal, also while it is being written."""
    from agent.overview import overview

    settings = load_settings(runs=runs, router=router)
    if source is not None and (run is not None or not follow):
        raise InputError("--from", source, "only with --follow, and without a RUN", "it names the run")
    if follow:
        _follow(settings, run, source, as_json, quiet)
        return
    row = overview(find_run(_named(run), settings.runs_dir))
    if as_json:
        typer.echo(json.dumps(row))
        return
    for name, value in row.items():
        if value != "" and not isinstance(value, dict | list):
            typer.echo(f"{name:12} {value}")
    for name in ("start", "best"):
        if row.get(name):
            typer.echo(f"{name:12} {line(row[name])}")


def _follow(settings: Settings, run: str | None, source: str | None, as_json: bool, quiet: bool) -> None:
    from agent import follow

    say = not (as_json or quiet)
    show = say and sys.stdout.isatty()
    if source is None:
        follow.follow_run(find_run(_named(run), settings.runs_dir), as_json=as_json, show=show)
    else:
        follow.follow_replay(settings, source, as_json=as_json, show=show, say=say)


def _named(run: str | None) -> str:
    if run is None:
        raise InputError("RUN", run, "the id of a run", "luxloop campaign list")
    return run


def resume(
    run: Annotated[str, typer.Argument(metavar="RUN", help="Id of a run, or its folder.", show_default=False)],
    as_recorded: Annotated[
        bool, typer.Option("--as-recorded", help="Go on with the recorded model, whatever became of its file.")
    ] = False,
    no_local: NoLocal = False,
    runs: Runs = None,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Go on with a run that was interrupted or killed; it ends as if nothing had happened."""
    from agent.resume import resume as go_on

    settings = load_settings(router=router, runs=runs)
    folder = find_run(run, settings.runs_dir)
    settings = settings.model_copy(update={"runs": folder.resolve().parent})
    say = not (as_json or quiet)
    show = sys.stderr.isatty() and say
    tell(go_on(settings, folder, as_recorded=as_recorded, local=not no_local, show=show, say=say), as_json)


def _row_text(row: dict[str, Any]) -> str:
    name = Path(row["folder"]).name  # which commands take; a run that was recovered has several folders
    if "damaged" in row:
        return f"{name:40} damaged: {row['mend']}"
    if row["kind"] == VALIDATION:  # which has no steps of a design
        return f"{name:40} {row['kind']:9} {row['state']}"
    best = row.get("best")
    found = f"best {100.0 * best['uniformity']:.2f} %" if best else "nothing yet"
    return f"{name:40} {row['kind']:9} {row['state']:11} {row['steps']:>6} steps  {found}"
