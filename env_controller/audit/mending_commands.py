"""`luxloop audit recover|compact`: save what a damaged run holds; make one file of a run's segments."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from env_controller.audit.commands import Json, Quiet, Run, Runs
from luxloop.errors import InputError
from luxloop.run_folders import find_run
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
    replace: Annotated[
        bool, typer.Option("--replace", help="Put what was saved in the run's place; the run becomes <run>-damaged.")
    ] = False,
    runs: Runs = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Save what a damaged or unfinished journal holds. Exit 0: all; 3: with loss; 1: nothing; 5: it was changed.

    The run itself is left as it is; with --replace it lies aside afterwards, and what was saved can be resumed.
    """
    from rich.console import Console

    from env_controller.audit import recover as saving
    from env_controller.audit import replace as replacing

    if replace and out is not None:
        raise InputError("--out", str(out), "no --replace beside it", "leave one of the two out")
    show = sys.stderr.isatty() and not (as_json or quiet)
    folder = find_run(run, load_settings(runs=runs).runs_dir)
    with Console(stderr=True, quiet=not show).status("reading and writing anew"):
        recovery = replacing.replace(folder) if replace else saving.recover(folder, out)
    then = _next(recovery) if recovery.mark.records else ""
    if as_json:
        typer.echo(json.dumps({"command": "audit recover", **recovery.document(), "next": then}))
    else:
        typer.echo("\n".join([*_recovered(recovery), *([_row("next", then)] if then else [])]))
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
    lines += [_row("lost", what) for what in recovery.lost]
    lines += [_row("changed", what) for what in recovery.changed]
    lines.append(_row("verdict", typer.style(VERDICTS[recovery.exit_code], fg=COLOURS[recovery.exit_code])))
    if recovery.mark.records:
        before = "is what was there" if recovery.replaced else "is as it was"
        lines.append(_row("chain", f"{recovery.mark.records:,} records, root {recovery.mark.root}"))
        if recovery.out == recovery.folder:
            lines.append(_row("left as it was", f"{recovery.folder}: there is nothing to replace"))
        else:
            lines.append(_row("written to", f"{recovery.out}; {recovery.folder} {before}"))
    return lines


def _next(recovery: Recovery) -> str:
    """The command to go on with: to the end of the run, or to a look at it."""
    from env_controller.audit.replace import to_go_on_with

    if not to_go_on_with(recovery.out):
        return f"luxloop audit verify {_named(recovery.out)}"
    if recovery.replaced or recovery.out == recovery.folder:
        return f"luxloop campaign resume {_named(recovery.out)}"
    return f"luxloop audit recover {_named(recovery.folder)} --replace"


def _named(folder: Path) -> str:
    """A run's id where it lies in the folder of runs of every command, else its path."""
    whole = folder.resolve()
    near = whole.parent == load_settings().runs_dir.resolve()
    return shlex.quote(whole.name if near else str(folder))


def _row(name: str, value: str) -> str:
    return f"{name:<20} {value}"


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
