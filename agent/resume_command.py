"""`luxloop campaign resume`: go on with a run that was interrupted or killed."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from agent.campaign_command import Json, NoLocal, Quiet, Router, Runs, folder_of, tell
from luxloop.settings import load_settings


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
    folder = folder_of(settings, run)
    settings = settings.model_copy(update={"runs": folder.resolve().parent})
    say = not (as_json or quiet)
    show = sys.stderr.isatty() and say
    tell(go_on(settings, folder, as_recorded=as_recorded, local=not no_local, show=show, say=say), as_json)
