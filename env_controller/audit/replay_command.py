"""`luxloop audit replay RUN --level N`: a run once more, from its journal; what is the same, and what is not."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from luxloop.errors import InputError
from luxloop.journal.topics import VALIDATION
from luxloop.run_folders import find_run
from luxloop.settings import Settings, load_settings

if TYPE_CHECKING:
    from env_controller.audit.reexecute import Choice, Record
    from env_controller.audit.replay import Replay

VERIFY, RE_EXECUTE, PLAY = 1, 4, 5
NAMES = {1: "verify", 2: "re-derive", 3: "re-decide", 4: "re-execute", 5: "play back"}
COLOURS = {"identical": "green", "within tolerance": "green", "differs": "red", "not comparable": "yellow"}
WIDTH = 100

Run = Annotated[
    str, typer.Argument(metavar="RUN", help="A run's folder, or its id under --runs.", show_default=False)
]
Level = Annotated[
    int,
    typer.Option(min=1, max=5, help="1 verify, 2 re-derive, 3 re-decide, 4 re-execute, 5 play back over the bus."),
]
All = Annotated[bool, typer.Option("--all", help="Level 4: every evaluation; the default up to 200 of them.")]
Sample = Annotated[
    str | None, typer.Option(help="Level 4: a share of the evaluations, as 2%; the default of larger runs.")
]
Best = Annotated[bool, typer.Option("--best", help="Level 4: the best design's final evaluation only.")]
NewSeed = Annotated[bool, typer.Option("--new-seed", help="Level 4: other random numbers; are the errors honest?")]
NoLocal = Annotated[bool, typer.Option("--no-local", help="Levels 4, 5: use a running set only; start no processes.")]
Rate = Annotated[
    float | None, typer.Option(min=0.0, help="Level 5: multiple of real time, default 1; 0 as fast as possible.")
]
Topics = Annotated[str | None, typer.Option(help="Level 5: topics to play, with commas; none: all.")]
Start = Annotated[int | None, typer.Option(min=0, help="Level 5: first step; default 0.")]
Paused = Annotated[bool, typer.Option("--paused", help="Level 5: wait for the space bar at once.")]
Runs = Annotated[Path | None, typer.Option(help="Folder of runs (else LUXLOOP_RUNS, else ./runs).")]
Router = Annotated[str | None, typer.Option(help="Levels 4, 5: endpoint of the router (else LUXLOOP_ROUTER).")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")]


def replay(
    run: Run,
    level: Level = 2,
    every: All = False,
    sample: Sample = None,
    best: Best = False,
    new_seed: NewSeed = False,
    no_local: NoLocal = False,
    rate: Rate = None,
    topics: Topics = None,
    start: Start = None,
    paused: Paused = False,
    runs: Runs = None,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Go through a run again, from its journal. Exit 0: the same, or within its errors; 4: it differs; 5: the journal
    is not what was written.

    Level 1 comes first in any case. 2 derives states, rewards and figures from the replies on record; 3 lets the
    designer decide again; 4 has the workers compute again; 5 plays the records over the bus, for `campaign status`.
    """
    settings = load_settings(runs=runs, router=router)
    choice = _choice(level, every, sample, best, new_seed)
    of_play = {"--rate": rate, "--topics": topics, "--start": start, "--paused": paused or None}
    of_workers = {"--no-local": no_local or None, "--router": router}
    _refuse_elsewhere(level, (PLAY,), of_play)
    _refuse_elsewhere(level, (RE_EXECUTE, PLAY), of_workers)
    folder = find_run(run, settings.runs_dir)
    show = sys.stderr.isatty() and not (as_json or quiet)
    found = _replayed(folder, level, settings, choice, not no_local, show)
    document = found.document() | {"run": folder.name}
    code = found.exit_code
    if level == PLAY and not found.broken:
        from env_controller.audit.playback import play

        wanted = tuple(one for one in (topics or "").split(",") if one)
        played = play(
            folder, settings, rate=1.0 if rate is None else rate, topics=wanted, start=start or 0, paused=paused,
            local=not no_local,
        )  # fmt: skip
        document, code = document | {"exit": 0, "played": played.document()}, 0
    typer.echo(json.dumps(document) if as_json else "\n".join(as_text(document, found)))
    if code:
        raise typer.Exit(code)


def _replayed(folder: Path, level: int, settings: Settings, choice: Choice, local: bool, show: bool) -> Replay:
    """Level 1, then the wanted level."""
    from env_controller.audit.reexecute import chosen, re_execute
    from env_controller.audit.replay import audit_rooms, verified

    with _bar(show) as bar:
        bar.begin("reading the chain", None)
        found = verified(folder, level, bar.look)
        if found.broken or level in (VERIFY, PLAY):
            return found
        if level < RE_EXECUTE:
            bar.begin(NAMES[level], _steps_in(folder))
            audit_rooms(found)
            return found
        from luxloop.journal.reader import RunJournal

        if RunJournal(folder).metadata("run").get("kind") == VALIDATION:
            _measurements_again(found, settings, choice, local, bar.begin)
            return found
        record: Record = chosen(RunJournal(folder), choice)
        bar.begin(NAMES[level], len(record.questions))
        same = not found.other
        re_execute(record, settings, found.tally.take, same_machine=same, new_seed=choice.new_seed, local=local)
        return found


def _measurements_again(
    found: Replay, settings: Settings, choice: Choice, local: bool, begin: Callable[[str, int | None], None]
) -> None:
    """Level 4 of a run that compares a model with measurements: all its requests, by its room's auditor."""
    from env_controller.audit.reexecute import at_home, fresh_client
    from env_controller.audit.replay import audit_rooms

    if choice.best or choice.share not in (None, 1.0):
        raise InputError("--best" if choice.best else "--sample", True, "a campaign or a grid", "leave it out")
    begin(NAMES[RE_EXECUTE], None)
    with fresh_client(settings, local=local) as client:
        audit_rooms(found, at_home(client), client=client, new_seed=choice.new_seed)


def _choice(level: int, every: bool, sample: str | None, best: bool, new_seed: bool) -> Choice:
    """Which evaluations are meant. Raises InputError where the options do not go together."""
    from env_controller.audit.reexecute import Choice

    given = [name for name, wanted in (("--all", every), ("--sample", sample), ("--best", best)) if wanted]
    if len(given) > 1:
        raise InputError(given[1], True, f"nothing beside {given[0]}", "give one of the two")
    _refuse_elsewhere(level, (RE_EXECUTE,), dict.fromkeys([*given, *["--new-seed"] * new_seed], True))
    share = 1.0 if every else None
    if sample is not None:
        percent = re.fullmatch(r"(\d+(?:\.\d+)?) ?%", sample)
        share = float(percent[1]) / 100.0 if percent else 0.0
        if not 0.0 < share <= 1.0:
            raise InputError("--sample", sample, "above 0% to 100%", "for example --sample 2%")
    return Choice(share, best, new_seed)


def _refuse_elsewhere(level: int, of: tuple[int, ...], options: dict[str, Any]) -> None:
    """InputError for the first option that was given and that only other levels look at."""
    which = " or ".join(map(str, of))
    for name, value in options.items() if level not in of else ():
        if value is not None:
            raise InputError(name, value, f"level {which} only", f"add --level {which}, or leave it out")


def as_text(document: dict[str, Any], found: Replay) -> list[str]:
    """What came of it, for people."""
    lines = [f"run          {document['folder']}", f"level        {found.level}, {NAMES[found.level]}"]
    told = (one for one in document["findings"] if one["verdict"] != "ok" or found.level == VERIFY)
    lines += [f"{one['what']:<12} {one['verdict']}: {one['found']}" for one in told]
    if found.broken:
        return [*lines, "verdict      the journal is not what was written: nothing is compared"]
    if found.level == PLAY:
        played = document["played"]
        return [
            *lines,
            f"played       {played['records']:,} records under {played['key']} in {played['wall_s']:.1f} s",
        ]
    return lines if found.level == VERIFY else lines + _compared(document)


def _compared(document: dict[str, Any]) -> list[str]:
    """The comparisons, the first difference, versions, z."""
    from env_controller.audit.replay import SHOWN
    from env_controller.audit.scores import as_text as z_text

    names = list(document["counts"])
    lines = ["", f"{'':<28}" + "".join(f"{name:>18}" for name in names)]
    for what, counts in {**document["compared"], "all": document["counts"]}.items():
        lines.append(f"{what:<28}" + "".join(f"{counts.get(name, 0) or '-':>18}" for name in names))
    lines.append("")
    for what, reasons in document["reasons"].items():
        if not what.endswith("differs"):
            lines += [f"{what}: {count:,} x {why}" for why, count in reasons.items()]
    for name, one in document["environment"].items():
        lines.append(f"other {name}: logged {one['logged']}, now {one['now']}")
    for what, one in document["z"].items():
        lines += z_text(what, one)
    for one in document["differences"][:SHOWN]:
        first = "first difference" if one is document["differences"][0] else "then"
        why = f" ({one['why']})" if one["why"] else ""
        where = one["step"] or "the run"
        lines.append(
            f"{first}: {where}, {one['what']}: logged {_short(one['logged'])}, now {_short(one['now'])}{why}"
        )
    return [*lines, f"verdict      {_verdict(document)}"]


def _verdict(document: dict[str, Any]) -> str:
    counts = document["counts"]
    if counts["differs"]:
        return f"it differs: {counts['differs']:,} of {sum(counts.values()):,} comparisons"
    if document["exit"]:
        return "nothing could be compared" + (", but films" if counts["identical"] else "")
    return "identical" if not counts["within tolerance"] else "the same within tolerance"


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= WIDTH else f"{text[: WIDTH - 3]}..."


def _steps_in(folder: Path) -> int:
    from luxloop.journal.reader import RunJournal

    return max((entry.sequence for entry in RunJournal(folder).last("/step", 1)), default=0) + 1


class Bar:
    """How far it is: the share of the steps that have been seen."""

    def __init__(self, begin: Callable[[str, int | None], None], look: Callable[[Any], None]) -> None:
        self.begin, self.look = begin, look


@contextmanager
def _bar(show: bool) -> Iterator[Bar]:
    """A bar on stderr, of the steps that something was said of."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, disable=not show) as progress:
        task = progress.add_task("", total=None)
        seen: set[int] = set()

        def begin(what: str, total: int | None) -> None:
            seen.clear()
            progress.update(task, description=what, total=total, completed=0)

        def look(one: Any) -> None:
            seen.add(one.sequence)
            progress.update(task, completed=len(seen))

        yield Bar(begin, look)
