"""`luxloop calibrate`: the paper's virtual-realistic experiment, and beside it the fit with a noise model."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from luxloop.errors import InputError
from luxloop.settings import load_settings
from validation.compare_command import (
    Film,
    Histories,
    Json,
    NoLocal,
    Page,
    Pixel,
    Quiet,
    Router,
    Runs,
    Seed,
    errors_of,
    histories_traced,
)
from validation.writing import drawn, told_whatever_happens, view_of

if TYPE_CHECKING:
    from luxloop.model import Model
    from validation.calibration import Way

MOST_HISTORIES = 128_000_000
"""Of Monte Carlo, for each sample: at 1.5 million a second minutes for six samples."""

ModelFile = Annotated[str, typer.Option("--model", help="The model file; it names its data (luxloop compare).")]
Twin = Annotated[bool, typer.Option("--twin", help="Fit with the twin alone, without Monte Carlo.")]
MostHistories = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=10**9,
        help=f"The last anchor takes as many as its noise asks for, at most these; default: {MOST_HISTORIES:,}.",
    ),
]

LastHistories = Annotated[
    int | None,
    typer.Option(
        min=0, max=10**9, help="The last anchor takes as many as its noise asks for, at most these; default: 8 times."
    ),
]


def calibrate(
    model: ModelFile = "model.toml",
    joint: Annotated[bool, typer.Option("--joint", help="All pairs of substrate and receiver, not in turn.")] = False,
    fit_only: Annotated[bool, typer.Option("--fit-only", help="The continuous fit alone, no candidates.")] = False,
    free: Annotated[
        str | None, typer.Option(help="Parameters to fit, with commas; default: those that the file frees.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Leave the model file as it is.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Write the model file even where the fit is not to be trusted.")
    ] = False,
    twin: Twin = False,
    histories: Histories = None,
    most_histories: MostHistories = None,
    seed: Seed = 1,
    pixel_um: Pixel = None,
    film: Film = None,
    page: Page = None,
    no_local: NoLocal = False,
    runs: Runs = None,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the environment that the images show: scatter by least MSE (Eqs. 1-2), then values with errors."""
    from validation import told
    from validation.calibration import Calibrated, calibrated
    from validation.cautions import overstated_of
    from validation.comparing import NULLS, Solver
    from validation.observed import Observed
    from validation.session import refuse_unwritable, session, subject_of

    draw = view_of("calibration", page) if page is not None else None
    first = histories_traced(twin, histories, most_histories)
    most = max(MOST_HISTORIES, first or 0) if most_histories is None else most_histories
    refuse_fewer(first, most)
    settings = load_settings(runs=runs, router=router)
    subject = subject_of(model, None)
    if not dry_run:
        refuse_unwritable(model)
    if joint and fit_only:
        raise InputError("--joint", True, "not beside --fit-only", "leave one of the two out")
    observed = Observed.of(subject.dataset, pixel_um, film)
    chosen = paths_of(subject.model, free)
    say = not (as_json or quiet)
    solver = Solver(first, seed, most)
    way: Way | None = None if fit_only else "joint" if joint else "in turn"
    with (
        session(settings, subject, "calibrate", seed=seed, local=not no_local, say=say) as at,
        bar(say) as progress,
    ):
        found: Calibrated = calibrated(
            subject.model, observed, at.predictor.telling(progress), solver, way=way, free=chosen,
            progress=progress, cache=settings.cache_dir / NULLS,
        )  # fmt: skip
        document = {
            "command": shlex.join(["luxloop", *sys.argv[1:]]),
            "model": {"file": subject.file, "name": subject.model.name, "sha256": subject.model.sha256},
            "dataset": {
                "path": str(subject.dataset.folder), "name": subject.dataset.manifest.name,
                "sha256": subject.dataset.sha256,
            },
            **found.document(),
            "run": at.door.run, "folder": at.door.begun.folder,
        }  # fmt: skip
        document["warnings"] = [*at.faults, *overstated_of(found.after.fit, document["shots"])]
        at.record(document, found.after.residual_maps())
    document["version"] = None

    def tell() -> None:
        typer.echo(json.dumps(document, ensure_ascii=False) if as_json else "\n".join(told.calibration(document)))
        drawn(draw, document, dict, page)

    with told_whatever_happens(tell):
        if not dry_run and (found.after.fit.trusted or force):
            kept = found.after.fit.model.model_copy(update={"data": subject.with_data.data})
            document["version"] = subject.saved(kept, "calibrate", errors_of(found.after))


def refuse_fewer(histories: int | None, most_histories: int | None) -> None:
    """InputError where the last anchor would have at most fewer histories than the first; None: of the twin alone."""
    if histories is not None and most_histories and most_histories < histories:
        allowed = f"0 for no other last anchor, or at least --histories, {histories:,}"
        raise InputError("--most-histories", most_histories, allowed, "raise it, or lower --histories")


def paths_of(model: Model, free: str | None) -> list[str]:
    """The parameters to fit. Raises InputError for one without limits in the model file."""
    from validation.fit.parameters import free_paths

    if free is None:
        return list(free_paths(model))
    wanted = [path.strip() for path in free.split(",") if path.strip()]
    for path in wanted:
        if path not in model.fit:
            raise InputError("--free", path, ", ".join(model.fit) or "(no [fit] table)", f'add [fit."{path}"]')
    return wanted


@contextmanager
def bar(say: bool, what: str = "calibrating") -> Iterator[Callable[[float, str], None]]:
    """A bar on a terminal: what is told the share done and of what."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not (say and console.is_terminal)) as progress:
        row = progress.add_task(what, total=1.0)
        yield lambda share, what: progress.update(row, completed=share, description=what)
