"""`luxloop compare` and `luxloop where`: how far a model is from measurements, and where in them."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from luxloop.errors import InputError
from luxloop.settings import load_settings
from validation.writing import drawn, told_whatever_happens, view_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from validation.comparing import Comparison
    from validation.session import Subject

HISTORIES = 4_000_000
"""Of Monte Carlo, for each sample: its noise is then below that of the declared camera."""

ModelFile = Annotated[str, typer.Option("--model", help="Model file; begun from `paper` if there is none.")]
Twin = Annotated[bool, typer.Option("--twin", help="The twin alone: two seconds, its own error not excluded.")]
Histories = Annotated[
    int | None, typer.Option(min=32_768, help=f"Of Monte Carlo, for each sample; default: {HISTORIES:,}.")
]
Seed = Annotated[int, typer.Option(min=0, max=10**15, help="Of Monte Carlo and of the simulated noise.")]
Pixel = Annotated[float | None, typer.Option("--pixel-um", help="Pixel to compare at; default: 1/16 of the pitch.")]
Film = Annotated[str | None, typer.Option(help="Film of the data set to take for all spectra.")]
Page = Annotated[Path | None, typer.Option("--page", help="Write a page with all pictures: .html; or one .png.")]
NoLocal = Annotated[bool, typer.Option("--no-local", help="Use a running set only; start no processes.")]
Runs = Annotated[Path | None, typer.Option(help="Folder of runs (else LUXLOOP_RUNS, else ./runs).")]
Router = Annotated[str | None, typer.Option(help="Endpoint of the router (else LUXLOOP_ROUTER).")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")]


def compare(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder with a dataset.toml.")],
    model: ModelFile = "model.toml",
    twin: Twin = False,
    histories: Histories = None,
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
    """Compare a model with measurements: error, noise, p-value of every shot. The model file remembers the data."""
    at = Asked("compare", model, dataset, histories_traced(twin, histories), seed, pixel_um, film, page)
    at.done(no_local, runs, router, say=not (as_json or quiet), as_json=as_json)


def where(
    model: ModelFile = "model.toml",
    twin: Twin = False,
    histories: Histories = None,
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
    """See where the model fails: the regions that are least like noise, and a page with the residuals drawn."""
    at = Asked("where", model, None, histories_traced(twin, histories), seed, pixel_um, film, page)
    at.done(no_local, runs, router, say=not (as_json or quiet), as_json=as_json)


@dataclass(frozen=True)
class Asked:
    """What one of the two commands was asked for; `histories` of None: the twin alone."""

    command: str
    model: str
    dataset: Path | None
    histories: int | None
    seed: int
    pixel_um: float | None
    film: str | None
    page: Path | None

    def done(self, no_local: bool, runs: Path | None, router: str | None, *, say: bool, as_json: bool) -> None:
        """Compare, put it on record, tell it, write the page."""
        from validation.comparing import NULLS, Solver, compared
        from validation.observed import Observed
        from validation.session import refuse_unwritable, session, subject_of

        draw = view_of("comparison", self.page) if self.page is not None else None
        settings = load_settings(runs=runs, router=router)
        subject = subject_of(self.model, self.dataset)
        keeps = self.command == "compare" and subject.model.data != subject.with_data.data
        if keeps:
            refuse_unwritable(self.model)
        observed = Observed.of(subject.dataset, self.pixel_um, self.film)
        solver = Solver(self.histories, self.seed)
        with (
            session(settings, subject, self.command, seed=self.seed, local=not no_local, say=say) as at,
            waiting(say, "comparing"),
        ):
            found = compared(subject.model, observed, at.predictor, solver, cache=settings.cache_dir / NULLS)
            document = self.document(subject, found, at.faults) | {"run": at.door.run, "folder": at.door.begun.folder}
            at.record(document, found.residual_maps())

        def tell() -> None:
            _tell(document, as_json, where=self.command == "where")
            drawn(draw, document, found.arrays, self.page)

        with told_whatever_happens(tell):
            if keeps:  # the model file gets the data's path and hash
                subject.saved(subject.with_data, f"compare {subject.dataset.folder.name}", errors_of(found))

    def document(self, subject: Subject, found: Comparison, faults: Sequence[str]) -> dict[str, Any]:
        """Of the comparison, with what was compared, and `faults` of the data; `where` adds the profiles."""
        from validation.cautions import overstated_of
        from validation.profiles import profiles

        manifest, chosen, told = subject.dataset.manifest, subject.model, found.document()
        return {
            "command": shlex.join(["luxloop", *sys.argv[1:]]),
            "model": {"file": subject.file, "name": chosen.name, "sha256": chosen.sha256},
            "dataset": {
                "path": str(subject.dataset.folder.resolve()), "name": manifest.name,
                "sha256": subject.dataset.sha256, "pixel_um": self.pixel_um, "film": self.film,
            },
            **told, "warnings": [*faults, *overstated_of(found.fit, told["shots"])],
            "profiles": profiles(found.fit) if self.command == "where" or self.page is not None else [],
        }  # fmt: skip


def histories_traced(twin: bool, histories: int | None, most_histories: int | None = None) -> int | None:
    """Histories of Monte Carlo for each sample; None: the twin alone, beside which InputError names those."""
    if not twin:
        return HISTORIES if histories is None else histories
    for option, given in (("--histories", histories), ("--most-histories", most_histories)):
        if given is not None:
            raise InputError(option, given, "nothing beside --twin", "the twin traces none: leave one of the two out")
    return None


def errors_of(found: Comparison) -> dict[str, float]:
    """What a version of a model file is kept with: rms error of every shot, p of structure.

    In percent of the mean signal; of psi and delta in degrees.
    """
    rows: dict[str, float] = {}
    for shot in found.document()["shots"]:
        unit, name = ("deg", "rms_error") if shot.get("unit") == "deg" else ("%", "rms_error_percent")
        rows[f"{shot['id']} rms {unit}"] = round(shot[name], 4)
    return rows | {"p": found.structure.p}


@contextmanager
def waiting(say: bool, what: str) -> Iterator[Callable[[str], None]]:
    """A line on a terminal that says what is done; a function that changes it."""
    from rich.console import Console

    console = Console(stderr=True)
    if not (say and console.is_terminal):
        yield lambda _: None
        return
    with console.status(what) as status:
        yield status.update


def _tell(document: dict[str, Any], as_json: bool, *, where: bool) -> None:
    from validation import told

    if as_json:
        typer.echo(json.dumps(document, ensure_ascii=False))
        return
    lines = list(told.comparison(document))
    if where:
        lines += ["", *told.regions(document)]
    lines += told.binned(document["shots"], lines)
    typer.echo("\n".join(lines))
