"""`luxloop audit recover|compact`: save what a damaged run holds; make one file of a run's segments."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from env_controller.audit.commands import Json, Quiet, Run, Runs
from env_controller.audit.runs import find_run
from luxloop.settings import load_settings

if TYPE_CHECKING:
    from env_controller.audit.compact import Compacted
    from env_controller.audit.recover import Part, Recovery

COLOURS = {0: "green", 1: "red", 3: "yellow", 5: "red"}
VERDICTS = {
    0: "nothing was missing",
    1: "nothing could be saved",
    3: "saved with loss",
    5: "what was read is not what was written; saved is what lies before that",
}


def recover(
    run: Run,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write into; else <run>-recovered beside the run.")
    ] = None,
    runs: Runs = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Save what a damaged or unfinished journal holds. Exit 0: all; 3: with loss; 1: nothing; 5: it was changed.

    The run itself is left as it is.
    """
    from rich.console import Console

    from env_controller.audit import recover as saving

    show = sys.stderr.isatty() and not (as_json or quiet)
    folder = find_run(run, load_settings(runs=runs).runs_dir)
    with Console(stderr=True, quiet=not show).status("reading and writing anew"):
        recovery = saving.recover(folder, out)
    if as_json:
        typer.echo(json.dumps({"command": "audit recover", **recovery.document()}))
    else:
        typer.echo("\n".join(_recovered(recovery)))
    if recovery.exit_code:
        raise typer.Exit(recovery.exit_code)


def compact(
    run: Run,
    remove: Annotated[
        bool, typer.Option("--remove", help="Do not keep the old segments in segments-before/.")
    ] = False,
    runs: Runs = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Merge the segments of a run that has ended into one file; its chain stays as it is, and is compared first."""
    from rich.console import Console
    from rich.progress import Progress

    from env_controller.audit import compact as merging
    from luxloop.journal.reader import segments_of

    folder = find_run(run, load_settings(runs=runs).runs_dir)
    total_bytes = sum(path.stat().st_size for path in segments_of(folder))
    show = sys.stderr.isatty() and not (as_json or quiet)
    with Progress(console=Console(stderr=True), transient=True, disable=not show) as bar:
        task = bar.add_task("merging", total=total_bytes)
        done = merging.compact(folder, remove=remove, progress=lambda size: bar.update(task, completed=size))
    if as_json:
        typer.echo(json.dumps({"command": "audit compact", **done.document()}))
    else:
        typer.echo("\n".join(_compacted(done)))


def _recovered(recovery: Recovery) -> list[str]:
    """The lines a person reads."""
    lines = [_part(part) for part in recovery.parts]
    lines += [f"{'lost':<20} {what}" for what in recovery.lost]
    lines += [f"{'changed':<20} {what}" for what in recovery.changed]
    verdict = typer.style(VERDICTS[recovery.exit_code], fg=COLOURS[recovery.exit_code])
    lines.append(f"{'verdict':<20} {verdict}")
    if recovery.mark.records:
        lines.append(f"{'chain':<20} {recovery.mark.records:,} records, root {recovery.mark.root}")
        lines.append(f"{'written to':<20} {recovery.out}; {recovery.folder} is as it was")
        lines.append(f"{'next':<20} luxloop audit verify {recovery.out}")
    return lines


def _part(part: Part) -> str:
    left = f", {part.left_bytes:,} bytes not used" if part.left_bytes else ""
    return f"{part.file:<20} {part.records:,} records in {part.read_bytes:,} bytes{left}: {part.found}"


def _compacted(done: Compacted) -> list[str]:
    before, after = done.before_bytes, done.after_bytes
    share = f"{100.0 * after / before:.0f} %" if before else "-"
    kept = f"{done.kept_in}, {before:,} bytes" if done.kept_in else "removed"
    return [
        f"{'segments':<20} {done.segments} made one",
        f"{'size':<20} {before:,} bytes before, {after:,} after ({share})",
        f"{'chain':<20} {done.mark.records:,} records, root {done.mark.root}: as before",
        f"{'old segments':<20} {kept}",
    ]
