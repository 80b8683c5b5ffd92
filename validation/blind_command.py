"""`luxloop blind make|diagnose|measure|score`: hide effects, let the diagnosis find them, open the seals, count."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from luxloop.errors import InputError
from luxloop.settings import load_settings
from validation.calibrate_command import LastHistories, refuse_fewer
from validation.compare_command import Histories, Json, NoLocal, Page, Quiet, Router, histories_traced
from validation.writing import drawn, view_of

if TYPE_CHECKING:
    from luxloop.settings import Settings
    from validation.effects.known import Known
    from validation.prediction import Predictor

OF_LIGHT = 32_000_000
"""Walks inside a chip, for each sample of a truth (`validation.blind_test.making.HISTORIES`)."""

Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of blind sets.")]
Model = Annotated[str, typer.Option("--model", help="paper, clear_chip, or a model file.")]


def make(
    folder: Folder,
    sets: Annotated[int, typer.Option(min=1, max=100_000, help="How many, of all sorts together.")] = 8,
    seed: Annotated[
        int | None, typer.Option(min=0, max=10**15, help="Of truths, kinds, noise; default: one nobody has chosen.")
    ] = None,
    sigma: Annotated[
        float, typer.Option(help="Projected strength of each hidden thing at the declared camera.")
    ] = 20.0,
    kinds: Annotated[str | None, typer.Option(help="Kinds to hide, with commas; default: all.")] = None,
    outside: Annotated[int, typer.Option(min=0, help="Of the sets: with something outside of the catalogue.")] = 0,
    two: Annotated[int, typer.Option(min=0, help="Of the sets: with two effects of the catalogue.")] = 0,
    nothing: Annotated[int, typer.Option(min=0, help="Of the sets: with nothing hidden.")] = 0,
    draws: Annotated[int, typer.Option(min=1, max=100, help="Sets with nothing hidden that share a light.")] = 20,
    per_truth: Annotated[int, typer.Option(min=1, help="Sets with something hidden that share a truth.")] = 4,
    plan: Annotated[Path | None, typer.Option(help="TOML with camera and samples; default: the paper's six.")] = None,
    pixels: Annotated[int, typer.Option(min=8, max=4096, help="Rows and columns of the images.")] = 128,
    histories: Annotated[int, typer.Option(min=2, help="Of the truths' light, for each sample.")] = OF_LIGHT,
    rivals: Annotated[
        bool, typer.Option("--rivals/--no-rivals", help="Measure what is left beside each other effect.")
    ] = True,
    model: Model = "paper",
    no_local: NoLocal = False,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make data sets that hide something, by a forward model of their own; the answers are sealed."""
    from luxloop.model_file import find_model
    from validation.blind_test import making, told
    from validation.blind_test.alone import alone
    from validation.blind_test.left_out import no_amounts, weak_kinds
    from validation.blind_test.truths import Counts
    from validation.dataset.simulation_plan import paper_plan, read_plan

    if kinds is not None and not kinds.strip(" ,"):
        raise InputError("--kinds", kinds, "names of kinds, with commas", "leave it out for all of them")
    asked = making.Asked(
        folder, Counts(sets, outside, two, nothing, draws, per_truth), making.seed_of(folder, seed), sigma,
        paper_plan() if plan is None else read_plan(plan), find_model(model),
        tuple(name.strip() for name in (kinds or "").split(",") if name.strip()), pixels, histories, rivals,
    )  # fmt: skip
    making.prepared(asked)  # says at once what cannot be, before there is a folder
    _refuse_without_numba("make", folder)
    with alone(folder, "make"):
        begun = making.begin(asked)
        with workers(load_settings(router=router), no_local) as (predictor, known), bar(as_json or quiet) as heard:
            index = making.make(begun, predictor, known, heard)
    document = {
        "folder": str(folder),
        "sets": len(index.sets),
        "root": index.root,
        "too_weak": weak_kinds(folder),
        "no_amount": no_amounts(folder),
    }
    typer.echo(json.dumps(document) if as_json else "\n".join(told.made(document)))


def diagnose(
    folder: Folder,
    model: Annotated[str | None, typer.Option(help="Only that of the sets, which is the default.")] = None,
    twin: Annotated[bool, typer.Option("--twin", help="By the twin alone, whose own error shows, too.")] = False,
    histories: Histories = None,
    most_histories: LastHistories = None,
    seed: Annotated[int, typer.Option(min=0, max=10**15, help="Of the Monte Carlo and the simulated noise.")] = 1,
    among: Annotated[
        str | None, typer.Option(help="Effects to choose from, with commas; default: all. On record: it is easier.")
    ] = None,
    no_local: NoLocal = False,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Diagnose every blind set that has no verdict yet, and put it on record; no seal is opened."""
    from validation.blind_test import told
    from validation.blind_test.alone import alone
    from validation.blind_test.bound import end_of
    from validation.blind_test.folders import read_index
    from validation.blind_test.judging import Judge, chosen_model, not_made
    from validation.comparing import NULLS, Solver
    from validation.diagnose_command import names_of

    settings, index = load_settings(router=router), read_index(folder)
    chosen = chosen_model(folder, index, model)
    chosen_from = tuple(names_of("--among", among))
    first = histories_traced(twin, histories, most_histories)
    refuse_fewer(first, most_histories)
    solver = Solver.of_diagnosis(first, seed, most_histories)
    verdicts: Counter[str] = Counter()
    with (
        alone(folder, "diagnose"),
        workers(settings, no_local) as (predictor, known),
        bar(as_json or quiet) as heard,
    ):
        judge = Judge(folder, chosen, predictor, known, solver, settings.cache_dir / NULLS, chosen_from)
        verdicts.update(str(record["verdict"]) for record in judge.verdicts(index, heard))
    judged, missing = sum(verdicts.values()), len(not_made(folder, index))
    document = {
        "folder": str(folder), "judged": judged, "before": len(index.sets) - judged - missing, "not_made": missing,
        "verdicts": dict(verdicts.most_common()), "last_verdict": end_of(folder, index),
    }  # fmt: skip
    typer.echo(json.dumps(document) if as_json else "\n".join(told.judged(document)))


def measure(
    folder: Folder,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder for the sets with one image more.")],
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Take the images that verdicts proposed, of the same truths; diagnose OUT, then score both folders."""
    from validation.blind_test import told
    from validation.blind_test.further import measure as measured

    _refuse_without_numba("measure", folder)
    with bar(as_json or quiet) as heard:
        index = measured(folder, out, heard)
    document = {"folder": str(out), "of": str(folder), "sets": len(index.sets)}
    typer.echo(json.dumps(document) if as_json else "\n".join(told.measured(document)))


def score(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Folders of blind sets; they add up.")],
    page: Page = None,
    as_json: Json = False,
) -> None:
    """Open the seals of the sets with verdicts, and count: the table, who was taken for whom, what was missed."""
    from validation.blind_test import told
    from validation.blind_test.scoring import maps_of
    from validation.blind_test.scoring import score as scored

    draw = view_of("blind", page) if page is not None else None
    document = scored(folders)
    typer.echo(json.dumps(document, ensure_ascii=False) if as_json else "\n".join(told.scored(document)))
    drawn(draw, document, lambda: maps_of(document["misses"]), page)


def _refuse_without_numba(command: str, folder: Path) -> None:
    """InputError where this installation cannot compile the truths' kernels, as that of the designer's image."""
    if find_spec("numba") is None:
        mend = "pip install 'luxloop[workers]'"
        raise InputError(f"luxloop blind {command}", str(folder), "an installation with numba", mend)


@contextmanager
def workers(settings: Settings, no_local: bool) -> Iterator[tuple[Predictor, Known]]:
    """Workers that answer, and the effects that they know."""
    from luxloop.client import Client
    from luxloop.settings import usable_cache
    from validation.effects.known import Known
    from validation.prediction import Predictor
    from validation.session import PATIENCE_S

    usable_cache(settings)
    with Client(settings, local=not no_local, patience_s=PATIENCE_S) as client:
        yield Predictor(client), Known.ask(client)


@contextmanager
def bar(silent: bool) -> Iterator[Callable[[int, int, str], Any]]:
    """Told how many of how many are done, and what is done now: a bar on a terminal, else a line for each done."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    terminal = sys.stderr.isatty()
    lines = Lines()
    with Progress(*columns, console=console, transient=True, disable=silent or not terminal) as progress:
        row = progress.add_task("sets", total=None)

        def heard(done: int, of: int, what: str) -> None:
            progress.update(row, completed=done, total=of, description=what)
            if not (silent or terminal):
                lines.next(done, of, what)

        yield heard


@dataclass
class Lines:
    """Lines on stderr: what has been done, and how long it took."""

    what: str = ""
    since_s: float = 0.0

    def next(self, done: int, of: int, what: str) -> None:
        """What was begun before is done; `done` of `of` are."""
        now_s = monotonic()
        if self.what:
            typer.echo(f"luxloop: {self.what}: {now_s - self.since_s:.0f} s; {done} of {of} done", err=True)
        self.what, self.since_s = what, now_s
