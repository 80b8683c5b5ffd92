"""How the commands of this room come by pictures: views are found by entry point, before anything is computed."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

from luxloop.errors import InputError

PICTURES = (".png", ".pdf", ".svg")


def view(name: str, plot: Path) -> Callable[..., None]:
    """What draws a result document of that kind; InputError naming --plot where pictures are not installed."""
    mend = "pip install 'luxloop[viewer]'"
    try:
        (point,) = entry_points(group="luxloop.views", name=name)
        draw: Callable[..., None] = point.load()
    except (ImportError, ValueError) as error:  # ValueError: no view of that name
        raise InputError("--plot", str(plot), "an installation with pictures", mend) from error
    return draw
