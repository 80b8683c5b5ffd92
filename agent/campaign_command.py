"""`luxloop campaign run`, `luxloop run`, `luxloop grid`: campaigns from the command line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from agent.options import (
    BoundsName,
    Config,
    DesignerName,
    Evaluations,
    FinalError,
    Id,
    Json,
    Lanes,
    MethodOption,
    ModelName,
    NoLocal,
    Quiet,
    RewardOption,
    Router,
    Runs,
    Saturation,
    Seed,
    TimeLimit,
    WalkError,
)  # fmt: skip
from agent.telling import tell
from luxloop.errors import InputError, LuxloopError
from luxloop.settings import Settings, load_settings
from luxloop.words import parse

if TYPE_CHECKING:
    from agent.config import Campaign
    from agent.launch import Launched

MOST_DESIGNS = 10_000_000
QUICK_EVALUATIONS, QUICK_TIME_S = 150, 100.0
"""Of `luxloop run`: with set-up and finalists it ends within three minutes on two cores."""


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
        evaluations = QUICK_EVALUATIONS if evaluations is None else evaluations
        time_s = QUICK_TIME_S if time_s is None else time_s
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
    from agent.report_command import PAGE, view, write_report

    settings = load_settings(runs=runs)
    try:
        view(Path(PAGE))
    except InputError as error:
        mend = f"{error.mend}; without a report: luxloop campaign run --quick"
        raise InputError("report", "no pictures", error.allowed, mend) from error
    campaign = _campaign(None, seed=seed, stop__evaluations=QUICK_EVALUATIONS, stop__time_s=QUICK_TIME_S)
    launched = _launched(settings, campaign, model, None, False, as_json or quiet)
    folder = Path(launched.ended.folder)
    page: Path | None = None
    try:
        page = write_report(folder) if folder.is_dir() and not launched.interrupted else None
    except (LuxloopError, OSError) as error:
        mend = f"luxloop campaign report {launched.run} --out FILE"
        typer.echo(f"luxloop: no report was written: {error}; the run is whole: {mend}", err=True)
        raise typer.Exit(1) from error
    finally:
        tell(launched, as_json, page)


def grid(
    run_id: Id = None,
    model: ModelName = "paper",
    bounds: Annotated[str | None, typer.Option(help="paper-grid (default) or paper-table3.")] = None,
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
