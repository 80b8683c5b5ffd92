"""The pictures of a diagnosis and of a ladder; each as a figure, and as SVG for a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from viewer.comparison_images import SMALL, Image, residuals
from viewer.look import BLUE, GREEN, GREY, INK, ORANGE, TEXT, svg

Document = Mapping[str, Any]

SHOWN = 14
"""Bars of one picture; of scores also those of the verdict."""
WRITTEN = 0.5
"""|cosine| from which its number is written into the map."""
DARK = 0.75
"""|cosine| from which the map is too dark for ink."""


def scores_figure(document: Document) -> Figure:
    """How many sigma of each effect are in the residual, those that were added in colour.

    What has the sign that an effect cannot have is none of it.
    """
    scores = document["scores"]
    rows = [one for place, one in enumerate(scores) if place < SHOWN or one["name"] in document["set"]][::-1]
    added = {one["name"] for one in document["effects"]}
    with rc_context(TEXT):
        figure = Figure(figsize=(7.2, 0.24 * max(len(rows), 4) + 1.1), layout="constrained")
        axes = figure.add_subplot()
        colours = [
            ORANGE if one["name"] in document["set"] else BLUE if one["name"] in added else GREY for one in rows
        ]
        lengths = [np.sqrt(one["chi2_drop"]) for one in rows]
        axes.barh([one["name"] for one in rows], lengths, color=colours, height=0.7)
        axes.set_xlabel("sigma of the effect in what the model leaves")
        named = ", ".join(document["set"])
        axes.set_title(document["verdict"].replace("_", " ") + (f": {named}" if named else ""))
        return figure


def scores_picture(document: Document) -> bytes:
    """The same for a page."""
    with rc_context(TEXT):
        return svg(scores_figure(document))


def residual_picture(title: str, image: Image, z: NDArray[Any]) -> bytes:
    """A map of residuals of an image, with a title that says which model left them."""
    with rc_context(TEXT):
        figure = Figure(figsize=SMALL)
        axes = figure.add_axes((0.16, 0.14, 0.7, 0.78))  # as the pictures beside it
        residuals(figure, axes, image, np.asarray(z, np.float64))
        axes.set_title(title)
        return svg(figure)


def confounding_picture(document: Document) -> bytes:
    """The cosines of all pairs, groups boxed; red for effects that undo each other."""
    found, groups = document["confounding"], document["groups"]
    names, cosines = found["names"], np.array(found["cosines"])
    side = max(4.2, 0.24 * len(names) + 2.0)
    with rc_context(TEXT):
        figure = Figure(figsize=(side + 0.8, side), layout="constrained")
        axes = figure.add_subplot()
        shown = axes.imshow(cosines, cmap="PuOr_r", vmin=-1.0, vmax=1.0)
        figure.colorbar(shown, ax=axes, label="cosine", shrink=0.7)
        axes.set_xticks(range(len(names)), names, rotation=90)
        axes.set_yticks(range(len(names)), names)
        for row, column in zip(*np.nonzero(np.abs(cosines) >= WRITTEN), strict=True):
            if row != column:
                text = f"{100.0 * cosines[row, column]:.0f}"
                colour = "white" if abs(cosines[row, column]) > DARK else INK
                axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=5)
        for group in groups:
            places = [names.index(name) for name in group]
            first, size = min(places) - 0.5, len(places)
            axes.add_patch(Rectangle((first, first), size, size, fill=False, color=INK, linewidth=1.6))
        return svg(figure)


def candidates_picture(document: Document) -> bytes:
    """What each further image would bring."""
    rows = document["candidates"][:SHOWN][::-1]
    with rc_context(TEXT):
        figure = Figure(figsize=(7.2, 0.24 * max(len(rows), 3) + 1.1), layout="constrained")
        axes = figure.add_subplot()
        axes.barh([one["words"] for one in rows], [one["expected_sigma"] for one in rows], color=BLUE, height=0.7)
        axes.axvline(rows[0]["now_sigma"], color=INK, linestyle="--", linewidth=1.0)
        axes.set_xlabel("expected separation of the rivals (sigma)")
        return svg(figure)


def ladder_figure(document: Document) -> Figure:
    """Fitted and held-out error by version, the noise as a line."""
    rungs = document["rungs"]
    at = np.arange(len(rungs), dtype=np.float64)
    with rc_context(TEXT):
        figure = Figure(figsize=(max(4.6, 1.1 * len(rungs) + 2.2), 3.4), layout="constrained")
        axes = figure.add_subplot()
        for shift, name, label, colour in (
            (-0.2, "fitted_percent", "in what was fitted", BLUE),
            (0.2, "held_out_percent", "held out", ORANGE),
        ):
            heights = [np.nan if one[name] is None else one[name] for one in rungs]
            axes.bar(at + shift, heights, width=0.36, color=colour, label=label)
        noise = [one["noise_percent"] for one in rungs]
        axes.plot(at, noise, color=GREEN, marker="_", markersize=24, linewidth=1.2, label="noise")
        axes.set_xticks(at, [f"{one['version']}: {one['command']}" for one in rungs], rotation=20, ha="right")
        axes.set_ylabel("rms error (% of the mean signal)")
        axes.set_ylim(0.0, None)
        axes.legend()
        return figure


def ladder_picture(document: Document) -> bytes:
    """The same for a page."""
    with rc_context(TEXT):
        return svg(ladder_figure(document))
