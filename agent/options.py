"""The options that commands on campaigns share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

Method = Literal["monte_carlo", "twin"]
RewardName = Literal["r1", "r2", "r3", "gain"]

Id = Annotated[str | None, typer.Option("--id", help="Of the run; none: the time and the designer's name.")]
ModelName = Annotated[str, typer.Option("--model", help="paper, clear_chip, or a model file.")]
Config = Annotated[Path | None, typer.Option(help="TOML file with settings; options go over it.")]
DesignerName = Annotated[
    str | None,
    typer.Option(help="ddqn-fast (default), ddqn-paper, each with -random for random moves; pattern, random, grid."),
]
BoundsName = Annotated[str | None, typer.Option("--bounds", help="paper-table3 (default) or paper-grid.")]
Evaluations = Annotated[int | None, typer.Option(help="Different designs to evaluate at most; default 200.")]
TimeLimit = Annotated[float | None, typer.Option("--time", help="Seconds after which the walk ends.")]
Saturation = Annotated[
    int | None, typer.Option(help="Learners: end when so many episodes ended without a gain above twice its error.")
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
Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors and warnings.")]
