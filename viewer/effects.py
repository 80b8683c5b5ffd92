"""Pictures of effects: what one does to an image or to a film's curves, and which of them look alike.

document and arrays of `luxloop effects show`       ──▶ image, image with the effect, difference, cut
document of `luxloop effects confusion`              ──▶ the map of cosines, groups boxed; as a page with its table
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from luxloop.errors import InputError
from viewer import html
from viewer.look import BLUE, GREY, INK, ORANGE, TEXT, save, svg

Document = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]

LABELS = {"R": "reflectance R", "T": "transmittance T", "psi": "psi (deg)", "delta": "delta (deg)"}
WRITTEN = 0.3
"""|cosine| from which its number is written into the map."""


def draw(document: Document, arrays: Arrays, path: Path) -> None:
    """Draw what an effect does into a picture (.png, .svg, .pdf), or into a page (.html)."""
    with rc_context(TEXT):
        figure = _images(document, arrays) if document["kind"] == "image" else _curves(arrays)
        values = ", ".join(f"{name} {_short(value)}" for name, value in document["values"].items())
        figure.suptitle(f"{document['effect']}: {values}\n{document['formula']}", fontsize=10, x=0.01, ha="left")
        if path.suffix.lower() in (".html", ".htm"):
            title, said = f"What {document['effect']} does", f"{values}; {document['formula']}"
            body = [html.heading(title), html.figure(svg(figure), said, said)]
            html.write(path, html.page(title, body))
        else:
            save(figure, path)


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"{min(value):g} to {max(value):g}, {len(value)} chips"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _images(document: Document, arrays: Arrays) -> Figure:
    """Base and with the effect on one scale, the difference on a diverging one, a cut through the middle."""
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    grid = figure.add_gridspec(2, 3, height_ratios=(1.25, 1.0))
    x_mm, y_mm = arrays["x_um"] / 1e3, arrays["y_um"] / 1e3
    extent = (*_ends(x_mm), *_ends(y_mm))
    base, after = arrays["base"], arrays["with"]
    top = float(max(base.max(), after.max()))
    for place, image, title in ((0, base, "without"), (1, after, "with the effect")):
        axes = figure.add_subplot(grid[0, place])
        shown = axes.imshow(image, origin="lower", extent=extent, cmap="inferno", vmin=0.0, vmax=top)
        axes.set_title(title)
        axes.set_xlabel("x (mm)")
        axes.set_ylabel("y (mm)" if not place else "")
    figure.colorbar(shown, ax=axes, label="irradiance (1/mm²)")
    difference = 100.0 * (after - base) / base.mean()
    axes, most = figure.add_subplot(grid[0, 2]), float(np.abs(difference).max())
    shown = axes.imshow(difference, origin="lower", extent=extent, cmap="RdBu_r", vmin=-most, vmax=most)
    figure.colorbar(shown, ax=axes, label="% of the mean")
    axes.set_title(f"difference: {document['rms_percent']:.2g} % rms, mean {document['mean_percent']:+.2g} %")
    axes.set_xlabel("x (mm)")
    _cut(figure.add_subplot(grid[1, :2]), figure.add_subplot(grid[1, 2]), x_mm, base, after)
    return figure


def _ends(centres: NDArray[Any]) -> tuple[float, float]:
    """Where the first and the last pixel end."""
    half = (centres[-1] - centres[0]) / (len(centres) - 1) / 2.0
    return float(centres[0] - half), float(centres[-1] + half)


def _cut(axes: Axes, beside: Axes, x_mm: NDArray[Any], base: NDArray[Any], after: NDArray[Any]) -> None:
    """Along the row through the module's centre."""
    middle = len(base) // 2
    axes.plot(x_mm, base[middle], color=INK, label="without")
    axes.plot(x_mm, after[middle], color=ORANGE, label="with the effect")
    axes.set_ylim(0.0, None)
    axes.set_xlabel("x (mm) through the middle row of chips")
    axes.set_ylabel("irradiance (1/mm²)")
    axes.legend()
    beside.axhline(0.0, color=GREY, linewidth=0.8)
    beside.plot(x_mm, 100.0 * (after[middle] - base[middle]) / base.mean(), color=BLUE)
    beside.set_xlabel("x (mm)")
    beside.set_ylabel("difference (% of the mean)")


def _curves(arrays: Arrays) -> Figure:
    """R, T, psi, delta of the example film, without and with the effect."""
    figure = Figure(figsize=(9.6, 6.4), layout="constrained")
    for number, (name, label) in enumerate(LABELS.items()):
        axes = figure.add_subplot(2, 2, number + 1)
        axes.plot(arrays["wavelength_nm"], arrays[f"{name}/base"], color=INK, label="without")
        axes.plot(arrays["wavelength_nm"], arrays[f"{name}/with"], color=ORANGE, label="with the effect")
        axes.set_xlabel("wavelength (nm)")
        axes.set_ylabel(label)
    figure.axes[0].legend()
    return figure


# Which look alike


def draw_confusion(document: Document, arrays: Arrays, path: Path) -> None:  # noqa: ARG001  # a view's arguments
    """Draw the largest map of cosines into a picture, or write a page of all with their tables (.html).

    Raises InputError for a picture where no effect is left to compare.
    """
    if path.suffix.lower() in (".html", ".htm"):
        html.write(path, page_of(document))
        return
    largest = max(document["maps"], key=lambda one: len(one["names"]), default=None)
    if largest is None or not largest["names"]:
        mend = "calibration imitates all effects, or none acts on these data: a page says which, --page NAME.html"
        raise InputError("--page", str(path), "a map with at least one effect", mend)
    with rc_context(TEXT):
        save(map_figure(largest), path)


def page_of(document: Document) -> str:
    """The page of all maps."""
    body = [html.heading(f"Which effects look alike, about the model {document['model']}")]
    for one in document["maps"]:
        body += list(_section(one))
    return html.page("Which effects look alike", body)


def _section(one: Document) -> Iterator[str]:
    yield f"<h2>{html.escaped(one['ground'])}</h2>"
    if one["names"]:
        yield from _map(one)
    if one["imitated"]:
        yield html.paragraph(f"Wholly imitated by calibration: {', '.join(one['imitated'])}.")
    yield from (html.paragraph(f"Not predicted: {name}: {why}") for name, why in one["failed"].items())


def _map(one: Document) -> Iterator[str]:
    yield html.paragraph(
        "Cosine between what two effects do to the data, after what calibration and nuisances can imitate is taken"
        f" out: 1 means that these data cannot tell them apart. Boxes: groups linked by more than {one['alike']:g}."
    )
    with rc_context(TEXT):
        picture = svg(map_figure(one))
    yield html.figure(picture, "Cosines of all pairs.", f"Cosines of effects on {one['ground']}.")
    rows = [
        (str(number + 1), ", ".join(group), f"{max(one['sigma'][name] for name in group):.3g}")
        for number, group in enumerate(one["groups"])
    ]
    yield html.table(("group", "effects", "largest sigma at a third of the range"), rows, words=2)


def map_figure(one: Document) -> Figure:
    """The cosines of all pairs as a picture, groups boxed."""
    names, cosine = one["names"], np.array(one["cosines"])
    side = max(4.5, 0.28 * len(names) + 2.2)
    figure = Figure(figsize=(side + 0.8, side), layout="constrained")
    axes = figure.add_subplot()
    shown = axes.imshow(cosine, cmap="Blues", vmin=0.0, vmax=1.0)
    figure.colorbar(shown, ax=axes, label="|cosine|", shrink=0.7)
    axes.set_xticks(range(len(names)), names, rotation=90)
    axes.set_yticks(range(len(names)), names)
    for row, column in zip(*np.nonzero(cosine >= WRITTEN), strict=True):
        colour = "white" if cosine[row, column] > 0.6 else INK
        axes.text(column, row, f"{100 * cosine[row, column]:.0f}", ha="center", va="center", color=colour, fontsize=5)
    first = 0
    for group in one["groups"]:
        if len(group) > 1:
            box = Rectangle(
                (first - 0.5, first - 0.5), len(group), len(group), fill=False, color=ORANGE, linewidth=2.0
            )
            axes.add_patch(box)
        first += len(group)
    axes.set_title(f"{one['ground']}: |cosine| in %, boxes above {100 * one['alike']:g}")
    return figure
