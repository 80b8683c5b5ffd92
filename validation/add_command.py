"""`luxloop add`, `remove` and `ladder`: put an effect into the model, take one out, watch the error fall."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from luxloop.errors import InputError
from validation.calibrate_command import LastHistories, ModelFile, Twin
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
    histories_traced,
)
from validation.diagnose_command import Free, diagnosing, facts_of
from validation.writing import drawn, told_whatever_happens, view_of

if TYPE_CHECKING:
    from validation.diagnosing import Diagnosing
    from validation.session import Session, Subject

Force = Annotated[bool, typer.Option("--force", help="Write the model file even where the fit is not to be trusted.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Leave the model file as it is.")]


def add(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="A name; luxloop effects list shows them.")],
    model: ModelFile = "model.toml",
    free: Free = None,
    dry_run: DryRun = False,
    force: Force = False,
    twin: Twin = False,
    histories: Histories = None,
    most_histories: LastHistories = None,
    seed: Seed = 1,
    pixel_um: Pixel = None,
    film: Film = None,
    no_local: NoLocal = False,
    runs: Runs = None,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Add a physical effect to the model, fitted to the data: what changes, the errors before and after, the undo."""
    with diagnosing(
        "add", model, free=free, histories=histories_traced(twin, histories, most_histories), seed=seed,
        pixel_um=pixel_um, film=film, runs=runs, router=router, no_local=no_local, say=not (as_json or quiet),
        most_histories=most_histories, writes=not dry_run,
    ) as (engine, subject, at):  # fmt: skip
        if effect in [one.name for one in engine.model.effects]:
            raise InputError(
                "EFFECT", effect, "an effect that the model does not have", "luxloop remove takes it out"
            )
        _done(engine, subject, at, "add", effect, (pixel_um, film), dry_run, force, as_json)


def remove(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="An effect of the model.")],
    model: ModelFile = "model.toml",
    free: Free = None,
    dry_run: DryRun = False,
    force: Force = False,
    twin: Twin = False,
    histories: Histories = None,
    most_histories: LastHistories = None,
    seed: Seed = 1,
    pixel_um: Pixel = None,
    film: Film = None,
    no_local: NoLocal = False,
    runs: Runs = None,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Take an effect out of the model and fit it again: the errors before and after, the undo."""
    from luxloop.model_file import find_model

    have = [one.name for one in find_model(model).effects]
    if effect not in have:
        raise InputError("EFFECT", effect, f"an effect of the model: {', '.join(have) or 'it has none'}")
    with diagnosing(
        "remove", model, free=free, histories=histories_traced(twin, histories, most_histories), seed=seed,
        pixel_um=pixel_um, film=film, runs=runs, router=router, no_local=no_local, say=not (as_json or quiet),
        most_histories=most_histories, writes=not dry_run,
    ) as (engine, subject, at):  # fmt: skip
        _done(engine, subject, at, "remove", effect, (pixel_um, film), dry_run, force, as_json)


def ladder(
    model: ModelFile = "model.toml",
    page: Page = None,
    as_json: Json = False,
) -> None:
    """Watch the error fall: fitted and held-out error of every version of the model, the noise, what moved back."""
    from luxloop.model_file import SHIPPED, read_text
    from validation import told_diagnosis as told
    from validation.diagnose.ladder import ladder as ladder_of
    from validation.model_versions import version_text, versions

    draw = view_of("ladder", page) if page is not None else None
    path, known = Path(model), []
    if model not in SHIPPED:
        read_text(path)
        known = versions(path)
    document = {
        "model": {"file": model},
        **ladder_of(known, {one.number: version_text(path, one.number) for one in known}),
    }
    typer.echo(json.dumps(document, ensure_ascii=False) if as_json else "\n".join(told.ladder(document)))
    drawn(draw, document, dict, page)


def _done(
    engine: Diagnosing,
    subject: Subject,
    at: Session,
    command: Literal["add", "remove"],
    effect: str,
    looked_at: tuple[float | None, str | None],
    dry_run: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Fit, put it on record, write the model file, tell it."""
    from validation import told_diagnosis as told
    from validation.adding import changed, told_of
    from validation.cautions import overstated_of
    from validation.comparing import maps_of

    before, after = changed(engine, command, effect)
    document = facts_of(subject, at, engine, *looked_at) | {"effect": effect, "version": None}
    document |= told_of(subject.model, before, after)
    document["warnings"] += overstated_of(after.fit, document["shots"])
    at.record(document, maps_of(after.fit))

    def tell() -> None:
        typer.echo(json.dumps(document, ensure_ascii=False) if as_json else "\n".join(told.added(document)))

    with told_whatever_happens(tell):
        if not dry_run and (after.fit.trusted or force):
            kept = after.fit.model.model_copy(update={"data": subject.with_data.data})
            document["version"] = subject.saved(kept, f"{command} {effect}", document["errors"])
