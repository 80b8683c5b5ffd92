"""`luxloop campaign report`: a run, or several, as one page that needs nothing else."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from luxloop.errors import InputError
from luxloop.files import try_to_write
from luxloop.settings import Settings, load_settings, usable_cache

if TYPE_CHECKING:
    from agent.report_under import Named, Winner

PAGE = "report.html"
ENDINGS = (".html", ".htm")
PATIENCE_S = 300.0
"""A worker that starts for the first time compiles its kernels."""
OF_A_RUN = ("run", "kind", "state", "designer", "seed", "reward", "model", "counts", "times", "best", "best_is_final",
            "best_at", "start", "gain", "grid")  # fmt: skip
"""What of each run stands in the tables that compare several."""


def report(
    run: Annotated[list[str], typer.Argument(help="Id of a run, or its folder; further ones are compared with it.")],
    under: Annotated[
        list[str] | None, typer.Option(help="Evaluate each winner anew under this model; repeat for several.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The page: .html; default: report.html in the run's folder.")
    ] = None,
    runs: Annotated[Path | None, typer.Option(help="Folder of runs (else LUXLOOP_RUNS, else ./runs).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The document as one JSON object on stdout.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")] = False,
) -> None:
    """Write a run's report: learning curve, best designs with errors, maps, losses; one page, nothing to load."""
    from luxloop.run_folders import find_run

    settings = load_settings(runs=runs)
    folders = [find_run(name, settings.runs_dir) for name in dict.fromkeys(run)]
    show = sys.stderr.isatty() and not (as_json or quiet)
    document = written(folders, under or [], out or folders[0] / PAGE, settings, show)
    typer.echo(json.dumps(document) if as_json else as_text(document))


def write_report(folder: Path, out: Path | None = None) -> Path:
    """The page of the run in `folder`, once it is written; by default `report.html` beside the journal."""
    page = out or folder / PAGE
    written([folder], [], page, None, show=False)
    return page


def written(
    folders: Sequence[Path], under: Sequence[str], page: Path, settings: Settings | None, show: bool
) -> dict[str, Any]:
    """The document of the first run beside the others, after its page was written.

    Raises InputError where a run has no journal, a model cannot be read or the page cannot be written, RemoteError
    where no worker answers for `under`.
    """
    from rich.console import Console

    from agent.report import document_of
    from agent.report_under import Named
    from luxloop.model_file import find_model

    draw = view(page)
    check_page(page)
    models = [Named(name, find_model(name)) for name in dict.fromkeys(under)]
    with Console(stderr=True).status("reading the journal") if show else nullcontext():
        found = [document_of(folder) for folder in folders]
    document, arrays = found[0]
    document["runs"] = [{name: one[name] for name in OF_A_RUN} for one, _ in found]
    for number, (_, more) in enumerate(found):
        names = ("walk_evaluations", "walk_best", "walk_best_error")
        arrays |= {f"run_{number}_{name}": more[name] for name in names}
    document["under"] = _under(found, models, settings or load_settings(), show) if models else None
    document["report_command"] = _command(folders, under)
    draw(document, arrays, page)
    return document | {"page": str(page)}


def view(page: Path) -> Callable[..., None]:
    """What draws the page; InputError naming --out where pictures are not installed."""
    try:
        (point,) = entry_points(group="luxloop.views", name="campaign")
        draw: Callable[..., None] = point.load()
    except (ImportError, ValueError) as error:  # ValueError: no view of that name
        mend = "pip install 'luxloop[viewer]'"
        raise InputError("--out", str(page), "an installation with pictures", mend) from error
    return draw


def check_page(page: Path) -> None:
    """InputError unless the page has the right ending and can be written; asked before anything is computed."""
    if page.suffix.lower() not in ENDINGS:
        mend = f"for example {page.stem or 'report'}{ENDINGS[0]}"
        raise InputError("--out", str(page), "a name that ends with " + " or ".join(ENDINGS), mend)
    try:
        try_to_write(page)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        why = getattr(error, "strerror", None) or str(error)
        raise InputError("--out", str(page), "a file that can be written, in a folder that exists", why) from error


def as_text(document: dict[str, Any]) -> str:
    """What a person reads: the result in a few lines, the winners under each model, where the page is."""
    from agent.report_text import lines_of

    return "\n".join([*lines_of(document), f"report       {document['page']}"])


def _under(
    found: Sequence[tuple[dict[str, Any], Any]], models: Sequence[Named], settings: Settings, show: bool
) -> dict[str, Any]:
    """Each run's winner under each model, with a bar on a terminal."""
    from rich.console import Console
    from rich.progress import track

    from agent.effects_tried import try_effects
    from agent.report_under import questions, row_under, under_of
    from luxloop.campaign import Plan
    from luxloop.client import Client

    how = Plan.model_validate(found[0][0]["plan"]).final
    winners = _winners([document for document, _ in found])
    usable_cache(settings)
    console = Console(stderr=True)
    waiting = console.status("finding the workers, or starting some") if show else nullcontext()
    with waiting:
        client = Client(settings, patience_s=PATIENCE_S)
    with client:
        for named in models:
            try_effects(client, named.model, named.name, winners[0].design, how.method)
        asked = track(questions(winners, models), "winners", console=console, transient=True, disable=not show)
        rows = [row_under(client, winner, named, how) for winner, named in asked]
    return under_of(models, rows, how)


def _winners(documents: Sequence[dict[str, Any]]) -> list[Winner]:
    """The best design of each run. Raises InputError where no run has one."""
    from agent.report_under import Winner
    from luxloop.design import Design

    winners = [
        Winner(document["run"], Design(**document["best"]["design"])) for document in documents if document["best"]
    ]
    if not winners:
        names = ", ".join(document["run"] for document in documents)
        raise InputError("--under", names, "a run in which a design was evaluated", "leave --under out")
    return winners


def _command(folders: Sequence[Path], under: Sequence[str]) -> list[str]:
    """The command line of this report, without where it is run."""
    options = [word for name in under for word in ("--under", name)]
    return ["luxloop", "campaign", "report", *(folder.name for folder in folders), *options]
