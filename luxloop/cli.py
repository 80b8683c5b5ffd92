"""The front door: finds the rooms' commands by entry points, hands them over, turns errors into exit codes.

An entry point of the group `luxloop.commands` is a typer-style function; the name `serve.router` makes it
`luxloop serve router`. Only what the arguments can mean is imported, nothing numeric before the chosen command runs,
and nothing at all that takes time before `main` has taken charge of Ctrl-C.
"""

from __future__ import annotations

import io
import json
import os
import signal
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from luxloop.errors import InputError, LuxloopError, RemoteError, shown

if TYPE_CHECKING:
    import typer

INTERRUPTED = 130
GROUPS = {
    "serve": "Run one of the processes: router, controller, worker, or all of them on this machine.",
    "campaign": "Let a designer look for better backlights; look at what it found.",
    "designers": "The designers there are, beside each other.",
    "audit": "A run's journal: look at it, verify it, replay it, mend it.",
    "materials": "The optical constants that ship with luxloop.",
    "effects": "Physical effects: those there are, what they do, your own.",
    "blind": "The blind test: hide effects, let the diagnosis find them, open the seals and count.",
    "dataset": "Measured data: check it, import it, simulate it, show it.",
    "model": "The model file: make one, look at it, compare versions, go back.",
}


def app(words: tuple[str, ...] = ()) -> typer.Typer:
    """The command tree, or what of it the words of a command line can mean; all of it where they name no command."""
    from importlib.metadata import entry_points

    import typer

    root = typer.Typer(
        name="luxloop",
        help="Design micro-LED backlights on real optics workers, and learn what the model lacks.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
    )
    about = typer.Option(False, "--version", help="Print the version and end.", callback=_version, is_eager=True)

    @root.callback()
    def _options(version: bool = about) -> None:
        """Options before the command."""

    groups: dict[str, typer.Typer] = {}
    points = sorted(entry_points(group="luxloop.commands"), key=lambda point: point.name)
    for depth in (1, 2):
        points = [point for point in points if point.name.split(".")[:depth] == list(words[:depth])] or points
    for point in points:
        group, _, name = point.name.rpartition(".")
        if group and group not in groups:
            groups[group] = typer.Typer(no_args_is_help=True, help=GROUPS.get(group, ""))
            root.add_typer(groups[group], name=group)
        (groups[group] if group else root).command(name)(point.load())
    return root


def main() -> None:
    """`luxloop ...`: exit codes 0 done, 1 failed, 2 bad usage or bad input, 130 interrupted."""
    # while modules are imported nothing is held that must be let go, and a traceback would help nobody
    signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    if isinstance(sys.stdout, io.TextIOWrapper):
        encoding = "utf-8" if "--json" in sys.argv else None  # JSON is UTF-8 wherever it is written
        sys.stdout.reconfigure(encoding=encoding, errors="backslashreplace")  # a terminal may lack a letter
    code = _run("--json" in sys.argv)
    _let_go_of_output()
    sys.exit(code)


def _run(as_json: bool) -> int:
    """The exit code of the command that the arguments name; what went wrong has been told."""
    try:
        root = app(tuple(sys.argv[1:]))
        signal.signal(signal.SIGINT, signal.default_int_handler)  # from here on a command lets go of what it holds
        return int(root(prog_name="luxloop", standalone_mode=not as_json, color=_colour()) or 0)
    except SystemExit as end:  # how typer ends; its code is 1 where the reader of our output has gone: `... | head`
        return 0 if isinstance(end.__context__, BrokenPipeError) else int(end.code or 0)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        return 0
    except LuxloopError as error:
        return _tell(error.exit_code, str(error), _as_object(error), as_json)
    except OSError as error:  # the system's own words, e.g. of a full disk; where it happened helps nobody
        text = error.strerror or str(error)
        text = text if error.filename is None else f"{text}: {error.filename!r}"
        return _tell(1, text, {"code": "failed", "message": text}, as_json)
    except Exception as error:
        if not hasattr(error, "format_message"):  # bad usage: typer's own class, which moved between its releases
            raise
        return _tell(2, error.format_message(), _bad_usage(error), as_json)


def _version(wanted: bool) -> None:
    import typer

    from luxloop import __version__

    if wanted:
        typer.echo(__version__)
        raise typer.Exit


def _tell(code: int, text: str, facts: dict[str, Any], as_json: bool) -> int:
    """The exit code, after the error was told: to a person on stderr, with `--json` also as one object on stdout."""
    import typer

    if as_json:
        with suppress(OSError):  # nobody reads it, or the disk is full: the exit code remains
            typer.echo(json.dumps({"error": facts}))
    with suppress(OSError):
        typer.secho(f"luxloop: {text}", err=True, fg=typer.colors.RED, color=_colour())
    return code


def _colour() -> bool | None:
    """False where the user wants none, else None: colour on a terminal."""
    return False if os.environ.get("NO_COLOR") else None


def _as_object(error: LuxloopError) -> dict[str, Any]:
    if isinstance(error, InputError):
        return {
            "code": "bad_input", "field": error.field, "value": shown(error.value, 200),
            "allowed": error.allowed, "mend": error.mend,
        }  # fmt: skip
    if isinstance(error, RemoteError):
        return dict(error.failure.model_dump(mode="json"))
    return {"code": "failed", "message": str(error)}


def _bad_usage(error: Any) -> dict[str, Any]:
    context = getattr(error, "ctx", None)
    mend = f"{context.command_path} --help" if context is not None else "luxloop --help"
    return {"code": "bad_usage", "message": error.format_message(), "mend": mend}


def _let_go_of_output() -> None:
    """Write out what is left, or drop it where nobody takes it: Python would complain of that when it ends."""
    for stream in filter(None, (sys.__stdout__, sys.__stderr__)):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
