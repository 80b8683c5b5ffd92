"""`luxloop simulate`: the light of one design on its receiver, with errors; its film by PC2, its rays by PC3."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from containers.asking import connected, watched
from containers.drawing import PICTURES, view
from containers.simulate_text import as_text
from containers.typed import check_file, numbers
from luxloop.design import Design
from luxloop.errors import InputError, RemoteError
from luxloop.model_file import find_model, range_of
from luxloop.settings import load_settings, usable_cache
from luxloop.units import unit_of
from luxloop.words import parse

if TYPE_CHECKING:
    from luxloop.bus.frame import Array
    from luxloop.client import Answer, Client
    from luxloop.film import FilmTableRequest
    from luxloop.model import Model
    from luxloop.ray import RayRequest

Method = Literal["monte_carlo", "twin"]
Preset = Literal["S_b1", "S_b2", "S_b3"]

PRESETS: dict[str, tuple[float, ...]] = {
    "S_b1": (180.0, 40.0, 400.0, 20.0, 5.5),
    "S_b2": (160.0, 20.0, 460.0, 15.0, 5.5),
    "S_b3": (180.0, 28.0, 500.0, 35.0, 6.5),
}
"""The paper's best designs, in the order of `Design.FIELDS`."""
OPTIONS = {
    "distance_um": "--distance",
    "width_um": "--width",
    "spacing_um": "--spacing",
    "thickness_um": "--thickness",
    "dbr_pairs": "--pairs",
    "rows": "--array",
    "columns": "--array",
    "wall_reflectance": "--wall",
    "half_x_um": "--array",
    "half_y_um": "--array",
    "histories": "--histories",
    "target_error_points": "--target-error",
    "budget_s": "--budget",
    "seed": "--seed",
    "exit_seed": "--exit-seed",
    "map_bins": "--map-bins",
    "method": "--method",
}
"""Which option a field of a request comes from."""
TWIN_HISTORIES = 1_000_000
BUDGET_S = 60.0
TARGET_ERROR_POINTS = 0.3
RAY_HISTORIES = 1 << 18
"""Of a ray file."""
LONGEST_S = 86_400.0
FILES: dict[str, tuple[str, ...]] = {
    "--plot": PICTURES,
    "--npz": (".npz",),
    "--ies": (".ies",),
    "--rays": (".tm25ray", ".tm25"),
}


def simulate(
    distance: Annotated[float | None, typer.Option("-D", "--distance", help="D to the receiver, um.")] = None,
    width: Annotated[float | None, typer.Option("-W", "--width", help="Side W of the chip, um.")] = None,
    spacing: Annotated[float | None, typer.Option("-S", "--spacing", help="Spacing S of the chips, um.")] = None,
    thickness: Annotated[float | None, typer.Option("-T", "--thickness", help="Height T of the chip, um.")] = None,
    pairs: Annotated[
        float | None, typer.Option("-P", "--pairs", help="Pairs of the DBR, in halves; 0: none.")
    ] = None,
    design: Annotated[
        str | None, typer.Option(help="All five at once: D,W,S,T,pairs, e.g. 180,28,500,35,6.5.")
    ] = None,
    preset: Annotated[
        Preset | None, typer.Option(help="A best design of the paper; options above change it.")
    ] = None,
    model: Annotated[str, typer.Option(help="paper, clear_chip, or a model file.")] = "paper",
    method: Annotated[Method, typer.Option(help="Monte Carlo, or its deterministic twin.")] = "monte_carlo",
    target_error: Annotated[
        float | None, typer.Option(help="Standard error of the uniformity to reach, in points; default 0.3.")
    ] = None,
    budget: Annotated[
        float | None, typer.Option(help="Seconds; a target that would take longer is refused. Default 60.")
    ] = None,
    histories: Annotated[int | None, typer.Option(help="Trace so many rays instead, rounded up to 32,768.")] = None,
    seed: Annotated[str | None, typer.Option(help="Of the histories; default 1.")] = None,
    array: Annotated[
        str | None, typer.Option(help="Rows x columns of a finite module, e.g. 5x5; default: an endless array.")
    ] = None,
    wall: Annotated[
        float | None, typer.Option(help="Reflectance of a mirror at the module's edge; default: open.")
    ] = None,
    map_bins: Annotated[int, typer.Option(help="Points of the map along its longer side.")] = 64,
    stored_exits: Annotated[
        bool, typer.Option("--stored-exits/--no-stored-exits", help="Land stored chip exits: D, S change fast.")
    ] = False,
    exit_seed: Annotated[
        str | None, typer.Option(help="Of stored exits, of the twin and of a ray file; default 1.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw map, cut and ledger: .png, .pdf or .svg.")] = None,
    npz: Annotated[Path | None, typer.Option(help="All arrays, and the document as JSON text: .npz.")] = None,
    ies: Annotated[
        Path | None, typer.Option(help="Far field, the light at its first arrival at the receiver, IES LM-63: .ies.")
    ] = None,
    rays: Annotated[
        Path | None,
        typer.Option(help="The light that leaves one chip alone, nothing come back, IES TM-25: .tm25ray."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")] = False,
) -> None:
    """Uniformity, illuminance and energy ledger of one design, each with its error; as text, picture or files."""
    chosen = find_model(model)
    given = dict(zip(Design.FIELDS, (distance, width, spacing, thickness, pairs), strict=True))
    asked = design_of(given, design, preset)
    environment = chosen.environment
    if problem := asked.feasibility(environment.distance_from, environment.spacing_is):
        raise InputError("-D, -W, -S, -T", str(asked), "a module that can be built", problem)
    wanted = {"plot": plot, "npz": npz, "ies": ies, "rays": rays}
    for option, file in zip(FILES, wanted.values(), strict=True):
        check_file(option, file, FILES[option])
    draw = view("simulation", plot) if plot is not None else None
    refuse_idle(
        method, stored_exits, {
            "--budget": budget, "--histories": histories, "--target-error": target_error, "--seed": seed,
            "--exit-seed": exit_seed, "--ies": ies, "--rays": rays,
        },
    )  # fmt: skip
    if histories is None and target_error is None:
        histories, target_error = (TWIN_HISTORIES, None) if method == "twin" else (None, TARGET_ERROR_POINTS)
    if histories is not None and target_error is not None:
        raise InputError("--histories, --target-error", "both", "one of the two", "a count, or the error to reach")
    with named_by_option():
        request = ray_request(
            chosen,
            asked,
            array=array_of(array, wall),
            method=method,
            histories=histories,
            target_error_points=target_error,
            budget_s=BUDGET_S if budget is None else budget,
            seed=seed or "1",
            stored_exits=stored_exits,
            exit_seed=exit_seed or "1",
            map_bins=map_bins,
            far_field=ies is not None,
            exit_histories=RAY_HISTORIES if rays is not None else 0,
        )
        film = film_request(chosen, asked)
    settings = load_settings()
    usable_cache(settings)
    show = sys.stderr.isatty() and not (as_json or quiet)
    with connected(settings, show) as client, named_by_option():
        answer, film_answer = ask(client, request, film, show)
    document = document_of(chosen, model, request, answer, film_answer)
    if plot is not None and draw is not None:
        draw(document, answer.arrays, plot)
    write_files(document, answer.arrays, request, {name: file for name, file in wanted.items() if name != "plot"})
    document["files"] = {name: str(file) for name, file in wanted.items() if file is not None}
    typer.echo(json.dumps(document) if as_json else as_text(document))


def refuse_idle(method: Method, stored_exits: bool, given: Mapping[str, Any]) -> None:
    """InputError for the first option that this method, or this call, does not look at; None: not given."""
    twin, counted = method == "twin", given["--histories"] is not None
    none_stored = not (twin or stored_exits or given["--rays"] is not None)
    exits = "--stored-exits, --method twin or --rays"
    idle = {
        "--budget": (twin or counted, "--target-error", "it bounds the time to that error"),
        "--seed": (twin, "Monte Carlo", "the twin's own draws are those of --exit-seed"),
        "--target-error": (twin, "Monte Carlo", "the twin takes --histories, of its chips' exits"),
        "--ies": (twin, "Monte Carlo", "the twin has no far field"),
        "--exit-seed": (none_stored, exits, "the histories have --seed"),
    }
    if twin and stored_exits:
        raise InputError("--stored-exits", True, "nothing beside --method twin", "leave it out: the twin always does")
    for name, (is_idle, acting, mend) in idle.items():
        if is_idle and given[name] is not None:
            raise InputError(name, str(given[name]), f"with {acting} only", mend)


def design_of(given: Mapping[str, float | None], design: str | None, preset: str | None) -> Design:
    """The design of the options: the five by name, all at once, or a preset; names change what they name.

    Raises InputError naming the option.
    """
    if design is not None and preset is not None:
        raise InputError("--design, --preset", "both", "one of the two", "or the five options by name")
    base: dict[str, float] = {}
    if design is not None:
        values = numbers("--design", design)
        if ":" in design or len(values) != len(Design.FIELDS):
            raise InputError("--design", design, "five numbers D,W,S,T,pairs", "for example 180,28,500,35,6.5")
        base = dict(zip(Design.FIELDS, values, strict=True))
    elif preset is not None:
        base = dict(zip(Design.FIELDS, PRESETS[preset], strict=True))
    base |= {name: value for name, value in given.items() if value is not None}
    for name in Design.FIELDS:
        if name not in base:
            mend = "give all five options -D -W -S -T -P, or --design, or --preset S_b3"
            raise InputError(OPTIONS[name], None, "a number", mend)
    with named_by_option("--design" if design is not None and set(given.values()) == {None} else ""):
        return parse(Design, base)


def array_of(array: str | None, wall: float | None) -> dict[str, Any] | None:
    """The finite module of a request, None for an endless array. Raises InputError naming the option."""
    if array is None:
        if wall is not None:
            raise InputError("--wall", wall, "nothing without --array", "an endless array has no edge")
        return None
    found = re.fullmatch(r"(\d{1,4})x(\d{1,4})", array)
    if found is None:
        raise InputError("--array", array, "rows x columns, 1x1 to 100x100", "for example 5x5")
    return {"rows": int(found[1]), "columns": int(found[2]), "wall_reflectance": wall}


def ray_request(model: Model, design: Design, **options: Any) -> RayRequest:
    """The request without its film, checked."""
    from luxloop.ray import RayRequest

    environment = model.environment.model_dump()
    return parse(
        RayRequest,
        {"environment": environment, "design": design.model_dump(), "effects": model.effects, **options},
    )


def film_request(model: Model, design: Design) -> FilmTableRequest | None:
    """What PC2 is asked for: the table of the design's DBR, for the line of the model; None without pairs."""
    from luxloop.film import FilmTableRequest, Spectrum

    if not design.dbr_pairs:
        return None
    environment = model.environment
    line = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
    return FilmTableRequest(environment=environment, dbr_pairs=design.dbr_pairs, effects=model.effects, spectrum=line)


def ask(
    client: Client, request: RayRequest, film: FilmTableRequest | None, show: bool
) -> tuple[Answer, Answer | None]:
    """Answers of PC3 and PC2; a table that nobody holds any more is computed again, once."""
    limit_s = LONGEST_S if request.histories is not None else 3.0 * request.budget_s + 60.0
    if film is None:
        return watched(client, request, "rays", show, limit_s), None
    table = watched(client, film, "film", show, LONGEST_S)
    try:
        return watched(client, with_film(request, table), "rays", show, limit_s), table
    except RemoteError as error:
        if error.failure.code != "not_found":
            raise
    table = client.run(film, fresh=True)
    return watched(client, with_film(request, table), "rays", show, limit_s), table


def with_film(request: RayRequest, table: Answer) -> RayRequest:
    """The request for the table that PC2 answered."""
    from luxloop.ray import Film

    film = Film(sha256=str(table.result["table_sha256"]), bytes=int(table.result["table_bytes"]))
    return request.model_copy(update={"film": film})


def document_of(
    model: Model, model_name: str, request: RayRequest, answer: Answer, film: Answer | None
) -> dict[str, Any]:
    """The result document: what was asked, what came, who computed it."""
    array = None if request.array is None else request.array.model_dump(mode="json")
    return {
        "command": "simulate",
        "design": request.design.model_dump(mode="json"),
        "array": array,
        "model": {"name": model_name, "sha256": model.sha256},
        "target_error_points": request.target_error_points,
        **answer.result,
        "film": None if film is None else {"sha256": film.result["table_sha256"], "known": film.result["known"]},
        "worker": answer.worker,
        "compute_s": answer.compute_s,
    }


def write_files(
    document: dict[str, Any], arrays: Mapping[str, Array], request: RayRequest, files: Mapping[str, Path | None]
) -> None:
    """Write the files that were asked for."""
    from containers.simulate_export import WRITERS

    for name, file in files.items():
        if file is not None:
            WRITERS[name](document, arrays, request, file)


@contextmanager
def named_by_option(always: str = "") -> Iterator[None]:
    """Errors of a request, found here or by a worker, name the option that the field comes from."""
    try:
        yield
    except InputError as error:
        allowed, mend = map(_by_option, _range_and_mend(error))
        raise InputError(_option(error.field, always), error.value, allowed, mend) from None
    except RemoteError as error:
        failure, field = error.failure, error.failure.field
        option = _option(field, always)
        if failure.code != "bad_input" or option == field:
            raise
        update = {
            "field": option,
            "message": _by_option(failure.message.replace(field, option, 1)),
            "mend": _by_option(failure.mend),
        }
        raise RemoteError(failure.model_copy(update=update)) from None


def _option(field: str, always: str) -> str:
    return always or OPTIONS.get(_last(field), field)


def _by_option(text: str) -> str:
    """The text with the option's name for what the request calls its budget."""
    return text.replace("budget_s = ", "--budget ").replace("budget_s", "--budget")


def _last(field: str) -> str:
    return field.rpartition(".")[2].rpartition(" ")[2]


def _range_and_mend(error: InputError) -> tuple[str, str]:
    """The whole range of a field and its meaning, where the error gives but the limit that was broken."""
    from luxloop.ray import ChipArray, RayRequest

    name = _last(error.field)
    if name.endswith("seed"):
        return "a whole number from 0 to 9999999999999999999", "the same seed gives the same result"
    for owner in (RayRequest, ChipArray, Design):
        if name in owner.model_fields and (not error.mend or " more wrong: " in error.mend):
            allowed = f"{range_of(owner, name)} {unit_of(name)}".strip()
            return allowed or error.allowed, owner.model_fields[name].description or error.mend
    return error.allowed, error.mend
