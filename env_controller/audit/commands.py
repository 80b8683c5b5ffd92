"""`luxloop audit info|verify`: what a run's journal holds, and whether it is still what was written."""

from __future__ import annotations

import json
import re
import shlex
import sys
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from luxloop.errors import InputError
from luxloop.run_folders import find_run
from luxloop.settings import load_settings

if TYPE_CHECKING:
    from env_controller.audit.checks import Finding
    from luxloop.journal.reader import RunJournal

COLOURS = {"ok": "green", "note": "yellow", "lost": "yellow", "broken": "red"}
Run = Annotated[
    str, typer.Argument(metavar="RUN", help="A run's folder, or its id under --runs.", show_default=False)
]
Runs = Annotated[Path | None, typer.Option(help="Folder of runs (else LUXLOOP_RUNS, else ./runs).")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")]


def info(run: Run, runs: Runs = None, as_json: Json = False, quiet: Quiet = False) -> None:
    """What a journal holds: segments, records by topic, sizes, steps, best design, time span, root of its chain."""
    from rich.console import Console

    from luxloop.journal.reader import RunJournal

    with Console(stderr=True, quiet=not _shows(as_json, quiet)).status("reading the journal"):
        document = document_of(RunJournal(find_run(run, load_settings(runs=runs).runs_dir)))
    typer.echo(json.dumps(document) if as_json else as_text(document))


def verify(
    run: Run,
    runs: Runs = None,
    root: Annotated[
        str | None, typer.Option(help="Root of the chain that was kept elsewhere, 64 hex digits.")
    ] = None,
    records: Annotated[int | None, typer.Option(min=1, help="Count of records at that root.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Whether a journal is what was written. Exit 0: it is; 3: something may be missing; 5: it is not."""
    from rich.console import Console
    from rich.progress import Progress

    from env_controller.audit import checks
    from luxloop.journal.reader import segments_of

    if root is not None and not re.fullmatch(r"[0-9a-f]{64}", root):
        raise InputError("--root", root, "64 digits 0-9a-f", "it is printed when a run ends, and in audit.sha256")
    folder = find_run(run, load_settings(runs=runs).runs_dir)
    total_bytes = sum(path.stat().st_size for path in segments_of(folder))
    show = _shows(as_json, quiet)
    with Progress(console=Console(stderr=True), transient=True, disable=not show) as bar:
        task = bar.add_task("reading the chain", total=total_bytes)
        audit = checks.verify(folder, root, records, lambda done: bar.update(task, completed=done))
    code = checks.exit_code(audit)
    if as_json:
        chain = {"records": audit.mark.records, "root": audit.mark.root}
        findings = [asdict(finding) for finding in audit.findings]
        typer.echo(
            json.dumps(
                {"command": "audit verify", "folder": str(folder), "exit": code}
                | {"chain": chain, "findings": findings}
            )
        )
    else:
        for finding in audit.findings:
            typer.echo(_line(finding))
        if code:
            typer.echo(
                f"next   luxloop audit recover {shlex.quote(str(folder))}   # what was committed, --replace to go on"
            )
    if code:
        raise typer.Exit(code)


def document_of(journal: RunJournal) -> dict[str, Any]:
    """What `audit info` says, as one object."""
    from env_controller.audit.contents import NEVER_NS, Contents

    contents = [Contents(segment.path).read() for segment in journal.segments]
    total = Contents(journal.folder).all_of(contents)
    run = journal.metadata("run")
    state = "finished" if contents[-1].finished else "being written" if journal.being_written else "not finished"
    return {
        "command": "audit info",
        "folder": str(journal.folder),
        **{name: run.get(name, "") for name in ("run", "kind", "model", "reward", "designer", "version")},
        "state": state,
        "left_early": "" if journal.close is None or journal.close.complete else journal.close.reason,
        "segments": [part.as_object() for part in contents],
        "size_bytes": total.size_bytes,
        "topics": dict(sorted(total.topics.items())),
        "steps": total.topics["/step"],
        "best": total.figures(final=False),
        "best_final": total.figures(final=True),
        "first_utc": _utc(total.first_ns % NEVER_NS),
        "last_utc": _utc(total.last_ns),
        "span_s": max(0, total.last_ns - total.first_ns) / 1e9,
        "chain": asdict(total.mark),
        "content": total.content,
        "attachments": {name: len(data) for name, data in journal.attachments().items()},
        "environment": journal.metadata("environment"),
    }


def as_text(document: dict[str, Any]) -> str:
    """The same for people."""
    early = f"; left early: {document['left_early']}" if document["left_early"] else ""
    lines = [
        _row("run", f"{document['run']} ({document['kind']}), {document['state']}{early}"),
        _row("folder", document["folder"]),
        _row("model", f"{document['model'] or '-'}, reward {document['reward'] or '-'}"),
        _row("written by", f"luxloop {document['version']}, Python {document['environment'].get('python', '?')}"),
        _row("time", f"{document['first_utc']} to {document['last_utc']}, {document['span_s']:.1f} s"),
        _row("steps", f"{document['steps']:,}"),
        _row("best", _design(document["best"])),
        _row("best finalist", _design(document["best_final"])),
        _row("chain", f"{document['chain']['records']:,} records, root {document['chain']['root']}"),
        _row("content", f"{document['content']}, of designs, figures and choices"),
        _row("size", f"{document['size_bytes'] / 1e6:.2f} MB in {len(document['segments'])} segment(s)"),
    ]
    for segment in document["segments"]:
        end = "finished" if segment["finished"] else "not finished"
        lines.append(
            _row(f"  {segment['file']}", f"{segment['records']:,} records, {segment['size_bytes']:,} bytes, {end}")
        )
    lines += [_row(f"  {topic}", f"{count:,}") for topic, count in document["topics"].items()]
    lines += [_row("  attachment", f"{name}, {size:,} bytes") for name, size in document["attachments"].items()]
    return "\n".join(lines)


def _design(best: dict[str, Any] | None) -> str:
    from luxloop.design import Design

    if best is None:
        return "none"
    uniformity = f"{100 * best['uniformity']:.2f} +- {100 * best['uniformity_error']:.2f} %"
    return f"uniformity {uniformity}: {Design(**best['design'])} (lane {best['lane']}, step {best['number']})"


def _line(finding: Finding) -> str:
    return f"{typer.style(f'{finding.verdict:<7}', fg=COLOURS[finding.verdict])}{finding.what:<26} {finding.found}"


def _row(name: str, value: str) -> str:
    return f"{name:<20} {value}"


def _utc(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns / 1e9, UTC).isoformat(timespec="seconds") if time_ns else "-"


def _shows(as_json: bool, quiet: bool) -> bool:
    return sys.stderr.isatty() and not (as_json or quiet)
