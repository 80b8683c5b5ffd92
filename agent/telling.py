"""What a person, or a program, is told at the end of a campaign."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from agent.in_words import line
from luxloop.settings import load_settings

if TYPE_CHECKING:
    from agent.launch import Launched

INTERRUPTED = 130


def tell(launched: Launched, as_json: bool, page: Path | None = None) -> None:
    """What was found; exit code 130 where it was interrupted, 1 where nothing could be evaluated."""
    document = launched.document() | ({"report": str(page)} if page else {})
    if as_json:
        typer.echo(json.dumps(document))
    else:
        typer.echo("\n".join(as_text(document)))
    if launched.interrupted:
        if as_json:
            again = run_argument(Path(document["folder"]))
            sys.stderr.write(f"interrupted; to go on: luxloop campaign resume {again}\n")
        raise typer.Exit(INTERRUPTED)
    if document["best"] is None:
        raise typer.Exit(1)


def as_text(document: dict[str, Any]) -> list[str]:
    """The lines a person reads at the end of a campaign."""
    counts = f"{document['evaluations']} designs in {document['steps']} steps, {document['episodes']} episodes"
    later = "; what was under way is on record too" if document["interrupted"] else ""
    lines = [
        f"run          {document['run']}: {document['reason']}",
        f"evaluated    {counts}, {document['wall_s']:.0f} s{later}",
    ]
    if failures := document["failures"]:
        count, most = sum(one["steps"] for one in failures), failures[0]
        lines.append(f"failed       {count} steps, {most['steps']} of them: {most['why']}")
    best, start, bare = (document[name] for name in ("best", "start", "without_dbr"))
    if best:
        again = "" if best not in document["finalists"] else "  (evaluated once: once more, it failed)"
        lines.append(f"best         {line(best)}{again}")
    lines += [f"finalist {i}   {line(one)}" for i, one in enumerate(document["finalists"], 1)]
    if start:
        lines.append(f"start        {line(start)}")
    if bare:
        lines.append(f"without DBR  {line(bare)}")
    if best and start and not (best["failure"] or start["failure"]):
        gain = 100.0 * (best["uniformity"] - start["uniformity"])
        error = 100.0 * (best["uniformity_error"] ** 2 + start["uniformity_error"] ** 2) ** 0.5
        lines.append(f"gained       {gain:+.2f} +- {error:.2f} points over the start")
    lines.append(f"journal      {document['folder']}: {document['records']} records, root {document['root']}")
    if document["interrupted"]:
        lines.append(f"next         luxloop campaign resume {run_argument(Path(document['folder']))}")
    elif "report" in document:
        lines.append(f"report       {document['report']}")
    else:
        near = Path(document["folder"]).parent == load_settings().runs_dir.resolve()
        run = document["run"] if near else shlex.quote(document["folder"])
        lines.append(f"next         luxloop campaign report {run}")
    return lines


def run_argument(folder: Path) -> str:
    """How a run to go on with is named: by its id, and by its folder of runs where that is not where one looks."""
    near = folder.resolve().parent == load_settings().runs_dir.resolve()
    return folder.name if near else f"{folder.name} --runs {shlex.quote(str(folder.resolve().parent))}"
