"""What a command of this room writes for a person: asked for before work begins, told by name where it fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import typer

from luxloop.errors import InputError
from luxloop.files import try_to_write

PAGES = (".html", ".png", ".svg", ".pdf")


@contextmanager
def written(field: str, path: Path, mend: str) -> Iterator[None]:
    """InputError naming `field` and `path` where what is done inside cannot be written."""
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        if isinstance(error, InputError):
            raise
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(field, str(path), "a place that can be written", f"{why}: {mend}") from error


def view_of(name: str, page: Path) -> Callable[..., None]:
    """What draws a document of that kind; InputError naming --page where it cannot be, or the page not written."""
    if page.suffix not in PAGES:
        raise InputError("--page", str(page), f"a name that ends with {', '.join(PAGES)}", "rename it")
    if not page.parent.is_dir():
        raise InputError("--page", str(page), "a file in a folder that is there", f"make {page.parent} first")
    try:
        try_to_write(page)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        mend = f"{why}: name one elsewhere, --page FOLDER/{page.name}"
        raise InputError("--page", str(page), "a file that can be written", mend) from error
    try:
        (point,) = entry_points(group="luxloop.views", name=name)
        draw: Callable[..., None] = point.load()
    except (ImportError, ValueError) as error:  # ValueError: no view of that name
        raise InputError(
            "--page", str(page), "an installation with pictures", "pip install 'luxloop[viewer]'"
        ) from error
    return draw


@contextmanager
def told_whatever_happens(tell: Callable[[], None]) -> Iterator[None]:
    """What was found is told after what is done inside; an InputError there follows, and the command ends with 2.

    That is told on stderr alone, as by `drawn`.
    """
    refused = None
    try:
        yield
    except InputError as error:
        refused = error
    tell()
    if refused is not None:
        typer.echo(f"luxloop: {refused}", err=True)
        raise typer.Exit(InputError.exit_code) from refused


def drawn(
    draw: Callable[..., None] | None, document: Any, arrays: Callable[[], Mapping[str, Any]], page: Path | None
) -> None:
    """Draw the page, where there is to be one, after all else was told: ends with 2 where it cannot be drawn.

    That is told on stderr alone, for the one object of --json is on stdout by then.
    """
    if draw is None or page is None:
        return
    try:
        draw(document, arrays(), page)
    except (OSError, InputError) as error:
        told = error
        if not isinstance(told, InputError):
            mend = f"{told.strerror or told}: all else is done; give it again with another --page"
            told = InputError("--page", str(page), "a file that can be written", mend)
        typer.echo(f"luxloop: {told}", err=True)
        raise typer.Exit(InputError.exit_code) from error
