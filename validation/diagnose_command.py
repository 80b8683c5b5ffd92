"""`luxloop diagnose` and `luxloop next`: which effect the model lacks, and what to measure where that is open."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from luxloop.errors import InputError
from luxloop.files import read_text, whole
from luxloop.settings import load_settings
from validation.calibrate_command import LastHistories, ModelFile, Twin, bar, paths_of, refuse_fewer
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
from validation.writing import drawn, view_of

if TYPE_CHECKING:
    from validation.diagnosing import Diagnosing
    from validation.session import Session, Subject

LAST = "diagnosis.json"
"""Beside the versions of the model file: the last diagnosis, for `next`."""

Free = Annotated[
    str | None,
    typer.Option(help="Parameters that are calibrated beside the effects, with commas; default: the file's."),
]


@contextmanager
def diagnosing(
    command: str,
    model: str,
    *,
    free: str | None,
    histories: int | None,
    seed: int,
    pixel_um: float | None,
    film: str | None,
    runs: Path | None,
    router: str | None,
    no_local: bool,
    say: bool,
    among: Sequence[str] = (),
    most_histories: int | None = None,
    writes: bool = False,
) -> Iterator[tuple[Diagnosing, Subject, Session]]:
    """The model on its data, with workers, on record as a run; `writes` where its file shall be written.

    Raises InputError for a model without data, and for one whose file cannot be written.
    """
    from validation.comparing import NULLS, Solver
    from validation.diagnosing import Diagnosing
    from validation.effects.known import Known
    from validation.observed import Observed
    from validation.session import refuse_unwritable, session, subject_of

    refuse_fewer(histories, most_histories)
    settings = load_settings(runs=runs, router=router)
    subject = subject_of(model, None)
    if writes:
        refuse_unwritable(model)
    observed = Observed.of(subject.dataset, pixel_um, film)
    paths = tuple(path for path in paths_of(subject.model, free) if not path.startswith("effects."))
    if free is None and not observed.of_modules:  # films alone know nothing of the module's parameters
        paths = ()
    solver = Solver.of_diagnosis(histories, seed, most_histories)
    with (
        session(settings, subject, command, seed=seed, local=not no_local, say=say) as at,
        bar(say, command) as progress,
    ):
        known = Known.ask(at.asking)
        yield (
            Diagnosing(
                subject.model,
                observed,
                at.predictor,
                known,
                solver,
                paths,
                settings.cache_dir / NULLS,
                progress,
                tuple(among),
            ),
            subject,
            at,
        )


def facts_of(
    subject: Subject, at: Session, engine: Diagnosing, pixel_um: float | None, film: str | None
) -> dict[str, Any]:
    """What every document of these commands begins with: all that it takes to do it again."""
    return {
        "command": shlex.join(["luxloop", *sys.argv[1:]]),
        "model": {
            "file": subject.file, "path": str(Path(subject.file).resolve()), "name": subject.model.name,
            "sha256": subject.model.sha256,
        },
        "dataset": {
            "path": str(subject.dataset.folder), "name": subject.dataset.manifest.name,
            "sha256": subject.dataset.sha256, "pixel_um": pixel_um, "film": film,
        },
        "solver": engine.solver.document(), "free": list(engine.free), "among": list(engine.among),
        "model_sha256": subject.model.sha256,
        "dataset_sha256": subject.dataset.sha256,
        "run": at.door.run,
        "folder": at.door.begun.folder,
        "warnings": list(at.faults),
    }  # fmt: skip


def diagnose(
    model: ModelFile = "model.toml",
    among: Annotated[
        str | None, typer.Option(help="Effects to choose from, with commas; default: all that the workers know.")
    ] = None,
    free: Free = None,
    twin: Twin = False,
    histories: Histories = None,
    most_histories: LastHistories = None,
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
    """Learn which physical effect the model lacks: one verdict, the effects by rank, the measurement to take next."""
    from validation import told_diagnosis as told
    from validation.cautions import overstated_of
    from validation.comparing import maps_of
    from validation.diagnose.arrays import arrays_of
    from validation.diagnose.document import document

    draw = view_of("diagnosis", page) if page is not None else None
    with diagnosing(
        "diagnose", model, free=free, histories=histories_traced(twin, histories, most_histories), seed=seed,
        pixel_um=pixel_um, film=film, runs=runs, router=router, no_local=no_local, say=not (as_json or quiet),
        among=names_of("--among", among), most_histories=most_histories,
    ) as (engine, subject, at):  # fmt: skip
        found = engine.diagnosed()
        told_of = facts_of(subject, at, engine, pixel_um, film) | document(found, seed)
        told_of |= {"not_tested": engine.untested, "held": [one.document() for one in engine.held(found)]}
        told_of["warnings"] += overstated_of(found.steps[0].ground.fit, told_of["shots"])
        at.record(told_of, maps_of(found.steps[0].ground.fit))
        arrays = arrays_of(found) if draw is not None else {}
    typer.echo(json.dumps(told_of, ensure_ascii=False) if as_json else "\n".join(told.diagnosis(told_of)))
    keep(subject, told_of)
    drawn(draw, told_of, lambda: arrays, page)


def names_of(option: str, text: str | None) -> list[str]:
    """The effects that an option names, with commas; none where it is left out. InputError where it names none."""
    names = [name.strip() for name in (text or "").split(",") if name.strip()]
    if text is not None and not names:
        raise InputError(option, text, "names of effects, with commas", "leave it out for all of them")
    return names


def next_(
    effects: Annotated[
        list[str] | None, typer.Argument(metavar="[EFFECT...]", help="Rivals; default: those of the last diagnosis.")
    ] = None,
    model: ModelFile = "model.toml",
    free: Free = None,
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
    """Name the measurement that would tell rival effects apart, with the sigma to expect and the stanza to fill."""
    from validation import told_diagnosis as told
    from validation.diagnose.frozen import slopes_of
    from validation.diagnose.next_measurement import Rivals, left_out_of
    from validation.diagnose.proposal import NO_FILM
    from validation.diagnose.refit import refit

    rivals = list(dict.fromkeys(effects or rivals_of(model)))
    if len(rivals) < 2:
        raise InputError("EFFECT", ", ".join(rivals), "two effects or more, to be told apart", "name another one")
    with diagnosing(
        "next", model, free=free, histories=histories_traced(twin, histories, most_histories), seed=seed,
        pixel_um=pixel_um, film=film, runs=runs, router=router, no_local=no_local, say=not (as_json or quiet),
        most_histories=most_histories,
    ) as (engine, subject, at):  # fmt: skip
        specs = [engine.spec(name) for name in rivals]
        if not engine.observed.images:
            raise InputError("[data]", "no images", "data with images: further images are proposed", NO_FILM)
        if films := [one.name for one in specs if "modules" not in one.acts_on]:
            allowed = "effects of modules: further images are proposed"
            raise InputError("EFFECT", ", ".join(films), allowed, NO_FILM)
        base = engine.fitted(engine.model)
        scores = engine.scored(base, specs)
        slopes = slopes_of(base)
        refits = [refit(base, scores[name], slopes) for name in rivals]
        proposals = Rivals(base, refits, engine.predictor, engine.known.beyond_twin).proposals(engine.progress)
        told_of = facts_of(subject, at, engine, pixel_um, film) | {
            "rivals": rivals,
            "left_out": left_out_of(refits),
            "candidates": [one.document() for one in proposals],
            "next_measurement": proposals[0].document() if proposals else None,
        }
        at.record(told_of, {})
    typer.echo(json.dumps(told_of, ensure_ascii=False) if as_json else "\n".join(told.next_measurement(told_of)))


def keep(subject: Subject, document: dict[str, Any]) -> None:
    """The verdict beside the model file, for `next`; nothing of a shipped model. A disk that is full is told."""
    file = last_file(subject.file)
    if file is None:
        return
    small = {
        name: document[name] for name in ("verdict", "sentence", "set", "rivals", "model_sha256", "dataset_sha256")
    }
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole(file) as fresh:
            fresh.write_text(json.dumps(small), encoding="utf-8")
    except OSError as error:
        typer.echo(f"luxloop: the verdict is not kept for `luxloop next`: {file}: {error.strerror}", err=True)


def last_file(model: str) -> Path | None:
    """Where the last diagnosis of a model file is kept; None for a shipped model."""
    from luxloop.model_file import SHIPPED

    return None if model in SHIPPED else Path(model).parent / ".luxloop" / f"{Path(model).stem}-{LAST}"


def _verdict(file: Path) -> dict[str, Any]:
    """What `keep` wrote into a file; InputError where it is not that."""
    text = read_text(file, "EFFECT", "a diagnosis before", "luxloop diagnose comes first")
    try:
        last = json.loads(text)
        return {name: last[name] for name in ("verdict", "set", "rivals", "model_sha256")}
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        mend = "run luxloop diagnose again, or name the effects"
        raise InputError("EFFECT", str(file), "what luxloop diagnose wrote there", mend) from error


def rivals_of(model: str) -> list[str]:
    """The effects that the last diagnosis could not tell apart.

    Raises InputError where there was none, where it was of another model, or where it left nothing open.
    """
    from luxloop.model_file import find_model

    file = last_file(model)
    if file is None or not file.exists():
        raise InputError(
            "EFFECT", "none", "two effects by name, or a diagnosis before", "luxloop diagnose comes first"
        )
    last = _verdict(file)
    if last["model_sha256"] != find_model(model).sha256:
        mend = "run luxloop diagnose again, or name the effects"
        raise InputError("EFFECT", "none", f"a diagnosis of this model, not of {last['model_sha256'][:12]}", mend)
    if last["verdict"] != "cannot_tell_apart":
        mend = f"name two effects; it said {last['verdict']}"
        raise InputError("EFFECT", "none", "a diagnosis that left rivals", mend)
    return [*last["set"][:1], *last["rivals"]]
