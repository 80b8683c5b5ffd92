"""Level 2 of a replay: what a comparison told of its images, anew from the maps of residuals on record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.audit import Compared, Place
from luxloop.journal.image import frame_of
from luxloop.journal.reader import RunJournal

ROUNDING = 1e-3
"""Relative, of chi2: maps are kept to five digits."""
NO_MAP = "no map of residuals on record"


def re_derive(journal: RunJournal, say: Callable[[Compared], None], *, same_machine: bool) -> None:
    """Compares chi2 per pixel of every image with the map of residuals that it comes from.

    The same on any machine; says nothing of runs that compare nothing.
    """
    del same_machine
    maps = {frame_of(entry.data): entry.value for entry in journal.records("/map/residual")}
    for entry in journal.records("/validation"):
        step = entry.value
        compared(step.document, maps, Place(say, entry.sequence, f"{step.command} of {step.dataset_sha256[:12]}"))


def compared(document: Mapping[str, Any], maps: Mapping[str, NDArray[Any]], at: Place) -> None:
    """Compares the shots of a document with maps (row, column) by shot, in standard deviations, 0 where unused."""
    for shot in document.get("shots", []):
        what = f"chi2 per pixel, {shot['id']}"
        if shot["kind"] != "image":
            continue
        if shot["id"] not in maps:
            at.nothing(what, NO_MAP)
            continue
        z = np.asarray(maps[shot["id"]], float)
        at.near(
            what, shot["chi2_per_pixel"], float((z**2).sum() / shot["pixels"]), ROUNDING * shot["chi2_per_pixel"],
            "maps are kept to five digits",
        )  # fmt: skip
