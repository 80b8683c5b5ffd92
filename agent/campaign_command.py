"""`luxloop campaign run|status|list`, `luxloop run`, `luxloop grid`: campaigns from the command line."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from agent.in_words import line
from agent.run_folder import refuse_unreadable
from luxloop.errors import InputError, LuxloopError
from luxloop.settings import Settings, load_settings
from luxloop.words import parse

if TYPE_CHECKING:
    from agent.config import Campaign
    from agent.launch import Launched

Method = Literal["monte_carlo", "twin"]
RewardName = Literal["r1", "r2", "r3", "gain"]
INTERRUPTED = 130
MOST_DESIGNS = 10_000_000
QUICK_EVALUATIONS, QUICK_TIME_S = 150, 100.0
"""Of `luxloop run`: with set-up and finalists it ends within three minutes on two cores."""

Id = Annotated[str | None, typer.Option("--id", help="Of the run; none: the time and the designer's name.")]
ModelName = Annotated[str, typer.Option("--model", help="paper, clear_chip, or a model file.")]
Config = Annotated[Path | None, typer.Option(help="TOML file with settings; options go over it.")]
DesignerName = Annotated[
    str | None,
    typer.Option(help="ddqn-fast (default), ddqn-paper, each with -random for random moves; pattern, random."),
]
BoundsName = Annotated[str | None, typer.Option("--bounds", help="paper-table3 (default) or paper-grid.")]
Evaluations = Annotated[int | None, typer.Option(help="Different designs to evaluate at most; default 200.")]
TimeLimit = Annotated[float | None, typer.Option("--time", help="Seconds after which the walk ends.")]
Saturation = Annotated[
    int | None, typer.Option(help="End after so many episodes without a gain above twice its error.")
]
RewardOption = Annotated[
    RewardName | None, typer.Option("--reward", help="r1, r2, r3 as the paper has them, or gain.")
]
MethodOption = Annotated[Method | None, typer.Option("--method", help="Solver of the walk.")]
WalkError = Annotated[float | None, typer.Option(help="Standard error of U in the walk, points; default 1.")]
FinalError = Annotated[float | None, typer.Option(help="The same of the finalists; default 0.3.")]
Lanes = Annotated[int | None, typer.Option(help="Designs under evaluation at once; default 4.")]
Seed = Annotated[int | None, typer.Option(help="Of the designer and of all random numbers; default 1.")]
NoLocal = Annotated[bool, typer.Option("--no-local", help="Use a running set only; start no processes.")]
Runs = Annotated[Path | None, typer.Option(help="Folder of runs (else LUXLOOP_RUNS, else ./runs).")]
Router = Annotated[str | None, typer.Option(help="Endpoint of the router (else LUXLOOP_ROUTER).")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")]


def run(
    run_id: Id = None,
    model: ModelName = "paper",
    config: Config = None,
    designer: DesignerName = None,
    bounds: BoundsName = None,
    evaluations: Evaluations = None,
    time_s: TimeLimit = None,
    saturation: Saturation = None,
    reward: RewardOption = None,
    method: MethodOption = None,
    walk_error: WalkError = None,
    final_error: FinalError = None,
    lanes: Lanes = None,
    seed: Seed = None,
    quick: Annotated[bool, typer.Option("--quick", help="A short campaign: 150 designs, 100 s at most.")] = False,
    no_local: NoLocal = False,
    runs: Runs = None,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Let a designer look for the most uniform backlight; every step is on record, the best are evaluated anew."""
    if quick:
        evaluations, time_s = evaluations or QUICK_EVALUATIONS, time_s or QUICK_TIME_S
    settings = load_settings(router=router, runs=runs)
    campaign = _campaign(
        config, designer=designer, bounds=bounds, reward=reward, method=method, walk_error_points=walk_error,
        final_error_points=final_error, lanes=lanes, seed=seed, stop__evaluations=evaluations, stop__time_s=time_s,
        stop__episodes_without_gain=saturation,
    )  # fmt: skip
    launched = _launched(settings, campaign, model, run_id, no_local, as_json or quiet)
    tell(launched, as_json)


def quick_run(
    model: ModelName = "paper",
    seed: Seed = None,
    runs: Runs = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """The main job for a newcomer: a short campaign on real worker processes, then its report."""
    from agent.report_command import write_report

    settings = load_settings(runs=runs)
    campaign = _campaign(None, seed=seed, stop__evaluations=QUICK_EVALUATIONS, stop__time_s=QUICK_TIME_S)
    launched = _launched(settings, campaign, model, None, False, as_json or quiet)
    folder = Path(launched.ended.folder)
    page = write_report(folder) if folder.is_dir() and not launched.interrupted else None
    tell(launched, as_json, page)


def grid(
    run_id: Id = None,
    model: ModelName = "paper",
    bounds: BoundsName = None,
    step: Annotated[
        str | None, typer.Option(help="Steps D,W,S,T,pairs instead of the bounds' own, e.g. 20,20,100,20,1.")
    ] = None,
    method: MethodOption = None,
    walk_error: WalkError = None,
    final_error: FinalError = None,
    lanes: Lanes = None,
    no_local: NoLocal = False,
    runs: Runs = None,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """The paper's "entire loop": every design of the bounds that can be built; the best are evaluated anew."""
    settings = load_settings(router=router, runs=runs)
    chosen = _stepped(bounds or "paper-grid", step)
    campaign = _campaign(
        None, designer="grid", bounds=chosen, method=method, walk_error_points=walk_error,
        final_error_points=final_error, lanes=lanes, stop__evaluations=10_000_000,
    )  # fmt: skip
    launched = _launched(settings, campaign, model, run_id, no_local, as_json or quiet, kind="grid")
    tell(launched, as_json)


def list_(runs: Runs = None, as_json: Json = False) -> None:
    """The runs in the results folder, the newest last."""
    from agent.launch import runs_of
    from agent.overview import overview

    rows = [_row(overview, folder) for folder in runs_of(load_settings(runs=runs))]
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
        _follow(settings, run, source, as_json, sys.stdout.isatty() and not (as_json or quiet))
        return
    row = overview(folder_of(settings, _named(run)))
    if as_json:
        typer.echo(json.dumps(row))
        return
    for name, value in row.items():
        if value != "" and not isinstance(value, dict | list):
            typer.echo(f"{name:12} {value}")
    for name in ("start", "best"):
        if row.get(name):
            typer.echo(f"{name:12} {line(row[name])}")


def _follow(settings: Settings, run: str | None, source: str | None, as_json: bool, show: bool) -> None:
    from agent import follow

    if source is None:
        follow.follow_run(folder_of(settings, _named(run)), as_json=as_json, show=show)
    else:
        follow.follow_replay(settings, source, as_json=as_json, show=show)


def _named(run: str | None) -> str:
    if run is None:
        raise InputError("RUN", run, "the id of a run", "luxloop campaign list")
    return run


def folder_of(settings: Settings, run: str) -> Path:
    """The folder of a run by its id; a folder's path is one, too. Raises InputError naming the runs there are."""
    from agent.launch import runs_of

    for folder in (settings.runs_dir / run, Path(run)):
        if any(folder.glob("audit-*.mcap")):
            refuse_unreadable(folder)
            return folder
    known = ", ".join(path.name for path in runs_of(settings)[-5:]) or "there is none yet"
    raise InputError("run", run, f"the id of a run in {settings.runs_dir}: {known}", "luxloop campaign list")


def _campaign(config: Path | None, **given: Any) -> Campaign:
    from agent.config import read_campaign

    return read_campaign(config, **given)


def _stepped(name: str, step: str | None) -> Any:
    """The bounds of a preset, with steps of one's own."""
    from luxloop.design import Bounds, Design

    bounds = Bounds.preset(name).model_dump()
    if step is None:
        return bounds
    try:
        values = [float(part) for part in step.split(",")]
    except ValueError:
        values = []
    if len(values) != len(Design.FIELDS):
        raise InputError("--step", step, "five numbers D,W,S,T,pairs", "for example 20,20,100,20,1")
    steps = parse(Design, dict(zip(Design.FIELDS, values, strict=True)), "--step").model_dump()
    count = parse(Bounds, {**bounds, "step": steps}, "--step").count
    if count > MOST_DESIGNS:
        raise InputError("--step", step, f"a grid of at most {MOST_DESIGNS:,} designs", f"this has {count:,}")
    return {**bounds, "step": steps}


def _launched(
    settings: Settings,
    campaign: Campaign,
    model: str,
    run: str | None,
    no_local: bool,
    quiet: bool,
    kind: Literal["campaign", "grid"] = "campaign",
) -> Launched:
    from agent.launch import launch

    show = sys.stderr.isatty() and not quiet
    return launch(settings, campaign, model, run, kind=kind, local=not no_local, show=show, say=not quiet)


def tell(launched: Launched, as_json: bool, page: Path | None = None) -> None:
    """What was found; exit code 130 where it was interrupted."""
    document = launched.document() | ({"report": str(page)} if page else {})
    if as_json:
        typer.echo(json.dumps(document))
    else:
        typer.echo("\n".join(as_text(document)))
    if launched.interrupted:
        if as_json:
            sys.stderr.write(f"interrupted; to go on: luxloop campaign resume {launched.run}\n")
        raise typer.Exit(INTERRUPTED)


def as_text(document: dict[str, Any]) -> list[str]:
    """The lines a person reads at the end of a campaign."""
    counts = f"{document['evaluations']} designs in {document['steps']} steps, {document['episodes']} episodes"
    lines = [
        f"run          {document['run']}: {document['reason']}",
        f"evaluated    {counts}, {document['wall_s']:.0f} s",
    ]
    best, start, bare = (document[name] for name in ("best", "start", "without_dbr"))
    if best:
        lines.append(f"best         {line(best)}")
        lines += [f"finalist {i}   {line(one)}" for i, one in enumerate(document["finalists"], 1)]
    if start:
        lines.append(f"start        {line(start)}")
    if bare:
        lines.append(f"without DBR  {line(bare)}")
    if best and start:
        gain = 100.0 * (best["uniformity"] - start["uniformity"])
        error = 100.0 * (best["uniformity_error"] ** 2 + start["uniformity_error"] ** 2) ** 0.5
        lines.append(f"gained       {gain:+.2f} +- {error:.2f} points over the start")
    lines.append(f"journal      {document['folder']}: {document['records']} records, root {document['root']}")
    if document["interrupted"]:
        lines.append(f"next         luxloop campaign resume {document['run']}")
    elif "report" in document:
        lines.append(f"report       {document['report']}")
    else:
        near = Path(document["folder"]).parent == load_settings().runs_dir.resolve()
        lines.append(f"next         luxloop campaign report {document['run'] if near else document['folder']}")
    return lines


def _row_text(row: dict[str, Any]) -> str:
    name = Path(row["folder"]).name  # which commands take; a run that was recovered has several folders
    if "damaged" in row:
        return f"{name:40} damaged: {row['mend']}"
    best = row.get("best")
    found = f"best {100.0 * best['uniformity']:.2f} %" if best else "nothing yet"
    return f"{name:40} {row['kind']:9} {row['state']:11} {row['steps']:>6} steps  {found}"
