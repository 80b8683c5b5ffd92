"""`luxloop designers compare`: learners beside their rivals, on equal budgets."""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from agent.options import (
    BoundsName,
    FinalError,
    Json,
    Lanes,
    MethodOption,
    ModelName,
    NoLocal,
    Quiet,
    Router,
    Runs,
    WalkError,
)
from luxloop.errors import InputError
from luxloop.settings import load_settings

if TYPE_CHECKING:
    from agent.config import Campaign
    from agent.progress import Found

RIVALS = "ddqn-fast,ddqn-fast-random,pattern,random"
EVALUATIONS = 100
UNUSED = {"designer": "--designers names them", "seed": "each designer runs with the seeds 1 to --seeds"}
"""What a file may say that has no place here: a comparison has several designers, and several seeds."""


def compare(
    designers: Annotated[str, typer.Option(help="Names, with commas between.")] = RIVALS,
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Runs of each, with seeds 1, 2, ...")] = 3,
    evaluations: Annotated[
        int | None, typer.Option(min=1, help="Different designs that each run may evaluate; default 100.")
    ] = None,
    model: ModelName = "paper",
    config: Annotated[
        Path | None,
        typer.Option(
            help="TOML file with settings of all runs; options go over it. Its designer and seed are not used."
        ),
    ] = None,
    bounds: BoundsName = None,
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
    """Let several designers look in the same place; how good what they found is, and how soon."""
    from agent.comparison import compare as compared
    from agent.comparison import refuse_own, rows
    from agent.config import read_campaign
    from agent.designers import NAMES, SEARCHES, WITHOUT_START
    from agent.launch import launch, running_set, warn
    from luxloop.model_file import find_model

    names = [name.strip() for name in designers.split(",") if name.strip()]
    for name in names or [designers]:
        if name not in NAMES or names.count(name) > 1:
            mend = "name each once" if name in NAMES else ""
            raise InputError("--designers", name, " or ".join(NAMES), mend)
    settings = load_settings(router=router, runs=runs)
    campaign = read_campaign(
        config, compared=True, bounds=bounds, method=method, walk_error_points=walk_error,
        final_error_points=final_error, lanes=lanes, stop__evaluations=evaluations,
    )  # fmt: skip
    refuse_own(campaign)
    searches = ", ".join(name for name in names if name in SEARCHES)
    if campaign.stop.episodes_without_gain is not None and searches and not quiet:
        warn(f"{config}: stop.episodes_without_gain is not used by {searches}: they have no episodes")
    idle = ", ".join(name for name in names if name in WITHOUT_START)
    if campaign.start is not None and idle and not quiet:
        warn(f"{config}: start is not used by {idle}: they look everywhere")
    for field in UNUSED if config and not quiet else ():
        if field in campaign.model_fields_set:
            warn(f"{config}: {field} = {getattr(campaign, field)!r} is not used: {UNUSED[field]}")
    if "evaluations" not in campaign.stop.model_fields_set:
        stop = campaign.stop.model_copy(update={"evaluations": EVALUATIONS})
        campaign = campaign.model_copy(update={"stop": stop})
    chosen = find_model(model)
    show = sys.stderr.isatty() and not (as_json or quiet)
    begun = f"{datetime.now(UTC):%Y%m%d-%H%M%S}"
    with running_set(settings, local=not no_local) as shared:
        ended: list[str] = []

        def run(one: Campaign, name: str) -> tuple[Found, Any]:
            launched = launch(shared, one, model, f"{begun}-{name}", chosen=chosen, local=False, show=show)
            if launched.interrupted:
                runs = ", ".join(ended) or "none"
                warn(f"interrupted: a comparison cannot be gone on with. Runs that ended: {runs} (campaign report)")
                raise KeyboardInterrupt
            ended.append(launched.run)
            return launched.found, launched.walk

        table = rows(compared(campaign, names, range(1, seeds + 1), run))
    typer.echo(json.dumps({"designers": table}) if as_json else "\n".join(as_text(table)))


def as_text(table: list[dict[str, Any]]) -> list[str]:
    """The table for a person."""
    head = ("best, %: median", "worst", "best", "near", "to near", "s")
    lines = ["{:18} {:>4} {:>15} {:>7} {:>7} {:>6} {:>7} {:>6}".format("designer", "runs", *head)]
    for row in table:
        best = [
            "-" if row[name] is None else f"{100.0 * row[name]:.2f}"
            for name in ("best_median", "best_worst", "best_best")
        ]
        near = "-" if row["evaluations_to_near"] is None else f"{row['evaluations_to_near']:g}"
        lines.append(
            f"{row['designer']:18} {row['runs']:>4} {best[0]:>15} {best[1]:>7} {best[2]:>7}"
            f" {row['near']:>3} of {row['runs']:<2}{near:>6} {row['wall_s']:>6.0f}"
        )
    if table and table[0]["best_of_all"] is not None:
        top = " +- ".join(f"{100.0 * table[0][name]:.2f}" for name in ("best_of_all", "best_of_all_error"))
        lines.append(
            "near: the best, evaluated anew, is within 0.5 points and twice the combined error of the best of all,"
            f" {top} %; to near: evaluations until the walk met it"
        )
    return lines
