"""The front door: finds the rooms' commands by entry points, hands them over, turns errors into exit codes.

An entry point of the group `luxloop.commands` is a typer-style function; the name `serve.router` makes it
`luxloop serve router`. Nothing numeric is imported before the chosen command runs.
"""

from __future__ import annotations

import json
import os
import sys
from importlib.metadata import entry_points
from typing import Any

import typer

from luxloop import __version__
from luxloop.errors import InputError, LuxloopError, RemoteError

GROUPS = {
    "serve": "Run one of the processes: router, controller, worker, or all of them on this machine.",
    "materials": "The optical constants that ship with luxloop.",
    "model": "The model file: make one, look at it, compare versions, go back.",
}


def app() -> typer.Typer:
    """The whole command tree."""
    root = typer.Typer(
        name="luxloop",
        help="Design micro-LED backlights on real optics workers, and learn what the model lacks.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
    )
    root.callback()(_version)
    groups: dict[str, typer.Typer] = {}
    for point in sorted(entry_points(group="luxloop.commands"), key=lambda point: point.name):
        group, _, name = point.name.rpartition(".")
        if group and group not in groups:
            groups[group] = typer.Typer(no_args_is_help=True, help=GROUPS.get(group, ""))
            root.add_typer(groups[group], name=group)
        (groups[group] if group else root).command(name)(point.load())
    return root


def main() -> None:
    """`luxloop ...`: exit codes 0 done, 1 failed, 2 bad usage or bad input, 130 interrupted."""
    try:
        app()(standalone_mode=True)
    except LuxloopError as error:
        _tell(error)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # the reader of our output has gone: `luxloop ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)


def _version(
    version: bool = typer.Option(False, "--version", help="Print the version and end.", is_eager=True),
) -> None:
    if version:
        typer.echo(__version__)
        raise typer.Exit


def _tell(error: LuxloopError) -> None:
    """The error for a person on stderr; with `--json` also as the one object on stdout."""
    if "--json" in sys.argv:
        typer.echo(json.dumps({"error": _as_object(error)}))
    typer.secho(f"luxloop: {error}", err=True, fg=typer.colors.RED)


def _as_object(error: LuxloopError) -> dict[str, Any]:
    if isinstance(error, InputError):
        return {
            "code": "bad_input",
            "field": error.field,
            "value": repr(error.value)[:200],
            "allowed": error.allowed,
            "mend": error.mend,
        }
    if isinstance(error, RemoteError):
        return dict(error.failure.model_dump(mode="json"))
    return {"code": "failed", "message": str(error)}
