"""`luxloop add`, `remove` and `ladder`: put an effect into the model, take one out, watch the error fall."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from luxloop.errors import InputError
from validation.calibrate_command import ModelFile, Twin
from validation.compare_command import (
    HISTORIES,
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
)
from validation.diagnose_command import Free, diagnosing, facts_of

if TYPE_CHECKING:
    from luxloop.model import Model
    from validation.diagnose.ground import Ground
    from validation.diagnosing import Diagnosing
    from validation.fit import Fit
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
    histories: Histories = HISTORIES,
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
        "add", model, free=free, histories=None if twin else histories, seed=seed, pixel_um=pixel_um, film=film,
        runs=runs, router=router, no_local=no_local, say=not (as_json or quiet),
    ) as (engine, subject, at):  # fmt: skip
        text = _text(subject)
        if effect in [one.name for one in engine.model.effects]:
            raise InputError(
                "EFFECT", effect, "an effect that the model does not have", "luxloop remove takes it out"
            )
        spec = engine.spec(effect)
        before = engine.ground(engine.fitted(engine.model))
        found = engine.refitted(before.fit, spec)
        if found.fit is None:
            mend = "its members differ from sample to sample: give their values under [[effects]] in the model file"
            raise InputError("EFFECT", effect, "an effect with one size", mend)
        _finish(engine, subject, at, text, before, found.fit, f"add {effect}", dry_run, force, as_json)


def remove(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="An effect of the model.")],
    model: ModelFile = "model.toml",
    free: Free = None,
    dry_run: DryRun = False,
    force: Force = False,
    twin: Twin = False,
    histories: Histories = HISTORIES,
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
        "remove", model, free=free, histories=None if twin else histories, seed=seed, pixel_um=pixel_um, film=film,
        runs=runs, router=router, no_local=no_local, say=not (as_json or quiet),
    ) as (engine, subject, at):  # fmt: skip
        text = _text(subject)
        before = engine.ground(engine.fitted(engine.model))
        after = engine.fitted(without(engine.model, effect))
        _finish(engine, subject, at, text, before, after, f"remove {effect}", dry_run, force, as_json)


def ladder(
    model: ModelFile = "model.toml",
    page: Page = None,
    as_json: Json = False,
) -> None:
    """Watch the error fall: fitted and held-out error of every version of the model, the noise, what moved back."""
    from luxloop.model_file import SHIPPED
    from validation import told_diagnosis as told
    from validation.compare_command import view_of
    from validation.diagnose.ladder import ladder as ladder_of
    from validation.model_versions import version_text, versions

    draw = view_of("ladder", page) if page is not None else None
    path = Path(model)
    known = [] if model in SHIPPED else versions(path)
    document = {
        "model": {"file": model},
        **ladder_of(known, {one.number: version_text(path, one.number) for one in known}),
    }
    if draw is not None:
        draw(document, {}, page)
    typer.echo(json.dumps(document, ensure_ascii=False) if as_json else "\n".join(told.ladder(document)))


def without(model: Model, effect: str) -> Model:
    """The model without an effect and without what its [fit] tables say of it."""
    left = tuple(one for one in model.effects if one.name != effect)
    fit = {path: one for path, one in model.fit.items() if not path.startswith(f"effects.{effect}.")}
    return model.model_copy(update={"effects": left, "fit": fit})


def _finish(
    engine: Diagnosing,
    subject: Subject,
    at: Session,
    text: str,
    before: Ground,
    after: Fit,
    command: str,
    dry_run: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Put it on record, write the model file, tell it."""
    from validation import told_diagnosis as told
    from validation.diagnose.ladder import BEFORE, Rung

    ground = engine.ground(after)
    rungs = Rung.of(before), Rung.of(ground)
    document = facts_of(subject, at) | {
        "before": vars(rungs[0]),
        "after": vars(rungs[1]),
        "trusted": after.trusted,
        "reason": "; ".join(after.distrust),
        "fitted": _fitted(after),
        "diff": _diff(subject.model, after.model),
        "version": None,
    }
    at.record(document, {one.shot.id: z for one, z in zip(after.problem.images, after.residual_images, strict=True)})
    if not dry_run and (after.trusted or force):
        if _text(subject) != text:
            mend = "look at it (luxloop model diff) and run this again"
            raise InputError("--model", subject.file, "a file that nobody edits during the fit", mend)
        kept = after.model.model_copy(update={"data": subject.with_data.data})
        version = subject.saved(kept, command, rungs[1].errors() | rungs[0].errors(BEFORE))
        document["version"] = version.number if version else None
    typer.echo(json.dumps(document, ensure_ascii=False) if as_json else "\n".join(told.added(document)))


def _text(subject: Subject) -> str:
    path = Path(subject.file)
    return path.read_text(encoding="utf-8") if path.exists() else ""


def _fitted(found: Fit) -> list[dict[str, Any]]:
    from luxloop.units import unit_of
    from validation.diagnose.document import finite

    return [
        {"path": path, "value": found.value(path), "error": finite(found.error(path)), "unit": unit_of(path)}
        for path in found.problem.unknowns.model_paths
    ]


def _diff(before: Model, after: Model) -> list[str]:
    from luxloop.model_file import diff

    return [str(one) for one in diff(before, after)]
