"""The page of a blind test: the table, who was taken for whom, and what was missed with the residuals that it left.

document of `luxloop blind score`, residuals in sigma by "FOLDER/ID/SHOT/z"  ──▶ one HTML file, or one picture
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from luxloop.errors import InputError
from viewer import html
from viewer.comparison_curves import SCALE
from viewer.comparison_images import NOISE_SEED, RESIDUALS
from viewer.html import NOTHING, paragraph
from viewer.look import INK, TEXT, save, svg

Document = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]

DRAWN = 60
"""Misses whose residuals are drawn; the others are in the table."""
DARK = 0.6
"""Share of a row from which its cell is too dark for ink."""
WORDS = {
    "shown": "shown",
    "met": "met",
    "short": "falls short",
    "open": "too few sets",
    "no sets": "no sets",
    "": NOTHING,
}


def draw(document: Document, arrays: Arrays, path: Path) -> None:
    """Write the page (.html), or the map of who was taken for whom (.png, .svg, .pdf).

    Raises InputError for a picture where no set hides one thing.
    """
    found = document["confusion"]["effects"]
    if path.suffix.lower() in (".html", ".htm"):
        html.write(path, page_of(document, arrays))
    elif not found["rows"]:
        mend = "a page tells all else: --page NAME.html"
        raise InputError("--page", str(path), "a set with one thing hidden", mend)
    else:
        save(confusion_figure(found), path)


def page_of(document: Document, arrays: Arrays) -> str:
    """The page, as HTML."""
    title = f"Blind test of {document['sets']} sets"
    parts = {
        "table": ("Targets", list(_table(document))),
        "confusion": ("Who was taken for whom", list(_confusion(document))),
        "misses": ("What was missed", list(_misses(document, arrays))),
        "sets": ("All sets", list(_sets(document))),
        "provenance": ("Provenance", list(_provenance(document))),
    }
    present = {name: part for name, part in parts.items() if part[1]}
    body = [html.heading(title), paragraph(document["sentence"], "lead")]
    body.append(html.contents({name: heading for name, (heading, _) in present.items()}))
    body += [html.section(name, heading, *inside) for name, (heading, inside) in present.items()]
    return html.page(title, body)


def _table(document: Document) -> Iterator[str]:
    heads = ("quantity", "target", "hits", "sets", "found", "95 % interval", "")
    caption = (
        "Met: what was found reaches the target. Shown: so does its whole interval (Clopper and Pearson; of alarms"
        " also whole truths drawn again; of a mean size 1.96 standard errors). What is hidden comes of a forward"
        " model of its own, its answers sealed before the diagnosis."
    )
    yield html.table(heads, [_row(row) for row in document["table"]], caption, words=2, ending=1)
    if document["further"]:
        sets = f"{document['further']} further sets, with the image that a verdict proposed,"
        yield paragraph(f"{sets} count in the row of that image alone.")
    if document["without_verdict"]:
        yield paragraph(f"{document['without_verdict']} more that were asked for have no verdict.")
    if document["not_checked"]:
        yield paragraph(f"Data of {document['not_checked']} sets are not there, only their records: not checked.")
    if document["too_weak"]:
        rows = [(name, f"{sigma:.1f}") for name, sigma in sorted(document["too_weak"].items())]
        yield paragraph("Not hidden in a truth where they do not show as strongly as was asked at this camera:")
        yield html.table(("kind", "sigma at its most"), rows)
    if document["no_amount"]:
        kinds = ", ".join(document["no_amount"])
        yield paragraph(f"Not hidden in a truth where no amount came near the asked strength: {kinds}.")


def _row(row: Document) -> tuple[str, ...]:
    value = between = NOTHING
    if row["value"] is not None and row["unit"] == "share":
        value = f"{100.0 * row['value']:.1f} %"
        between = f"{100.0 * row['low']:.1f} to {100.0 * row['high']:.1f} %"
    elif row["value"] is not None:
        value, between = f"{row['value']:.2f}", f"{row['low']:.2f} to {row['high']:.2f} ({row['interval']})"
    return (row["quantity"], row["target"], f"{row['hits']:g}", str(row["of"]), value, between, WORDS[row["said"]])


def _confusion(document: Document) -> Iterator[str]:
    words = {
        "effects": "What is hidden (rows) and what was named first, or the verdict where none was (columns).",
        "groups": "The same by group. Effects of a group are hardly told apart by images at one distance.",
    }
    for name, caption in words.items():
        if document["confusion"][name]["rows"]:
            yield html.figure(confusion_picture(document["confusion"][name]), f"Confusion by {name}", caption)
    rows = [(group, ", ".join(names)) for group, names in document["groups"].items()]
    yield html.folded("Groups, fixed before any set was scored", html.table(("group", "effects"), rows, words=2))


def confusion_figure(found: Document) -> Figure:
    """Counts of (hidden, said); the shade is the share of the row."""
    counts = np.array(found["counts"], np.float64)
    rows, columns = found["rows"], found["columns"]
    with rc_context(TEXT):
        size = (0.3 * len(columns) + 3.4, 0.24 * len(rows) + 2.4)
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.add_subplot()
        share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
        axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        axes.set_xticks(range(len(columns)), columns, rotation=90)
        axes.set_yticks(range(len(rows)), rows)
        axes.set_xlabel("said")
        axes.set_ylabel("hidden")
        for row, column in zip(*np.nonzero(counts), strict=True):
            colour = "white" if share[row, column] > DARK else INK
            text = f"{counts[row, column]:.0f}"
            axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=7)
        return figure


def confusion_picture(found: Document) -> bytes:
    """The same for a page."""
    with rc_context(TEXT):
        return svg(confusion_figure(found))


def _misses(document: Document, arrays: Arrays) -> Iterator[str]:
    misses = document["misses"]
    if not misses:
        return
    yield paragraph(
        "A miss: something said where nothing is hidden, nothing or another group said of a known effect, a name for"
        " what is outside of the catalogue. Residuals are measured minus model in sigma; below, those with the effect"
        " that was named."
    )
    for one in misses[:DRAWN]:
        maps = maps_of(one, arrays)
        name = _name(one, document)
        yield f"<h3>{html.escaped(name)}: {html.escaped(one['truth'])}</h3>"
        yield paragraph(f"{_strength(one)} Said: {one['sentence']}")
        if maps:
            picture = residual_picture(maps, f"with {one['said']}")
            yield html.figure(picture, f"Residuals of {name}", "Residuals in sigma, ±4.")
    if len(misses) > DRAWN:
        yield paragraph(f"{len(misses) - DRAWN} more are in the table of all sets.")


def _strength(one: Document) -> str:
    if not one["hidden"]:
        return "Nothing is hidden."
    what = ", ".join(f"{each['kind']} {each['amount']:.3g} {each['unit']}".rstrip() for each in one["hidden"])
    beside = "" if one["sigma_rival"] is None else f", {one['sigma_rival']:.1f} beside its nearest rival"
    return f"Hidden: {what}; {one['sigma']:.1f} sigma{beside}."


def _name(one: Document, document: Document) -> str:
    """Of a set among those of several folders."""
    return f"{document['names'][one['folder']]}/{one['id']}"


def maps_of(one: Document, arrays: Arrays) -> list[dict[str, NDArray[Any]]]:
    """The residuals of a set by shot: without any effect, then, where one was named, with it."""
    before = f"{one['folder']}/{one['id']}/"
    found: dict[str, dict[str, NDArray[Any]]] = {"z": {}, "z_with": {}}
    for name, array in arrays.items():
        if name.startswith(before):
            shot, _, kind = name.removeprefix(before).rpartition("/")
            found[kind][shot] = array
    return [maps for maps in found.values() if maps]


def residual_picture(rows: Sequence[Mapping[str, NDArray[Any]]], below: str) -> bytes:
    """Maps beside each other on one scale, ±4 sigma, noise alone at the end of the first row."""
    like = next(iter(rows[0].values()))
    noise = np.random.default_rng(NOISE_SEED).standard_normal(like.shape)
    shown = [{**rows[0], "noise alone": np.where(np.isfinite(like), noise, np.nan)}, *rows[1:]]
    across = len(shown[0])
    with rc_context(TEXT):
        figure = Figure(figsize=(1.45 * across, 1.68 * len(shown)))
        for down, maps in enumerate(shown):
            for number, (shot, z) in enumerate(maps.items()):
                axes = figure.add_subplot(len(shown), across, down * across + number + 1)
                axes.imshow(z, origin="lower", cmap=RESIDUALS, interpolation="none", vmin=-SCALE, vmax=SCALE)
                axes.set_axis_off()
                axes.set_title(f"{shot}, {below}" if down and not number else shot, fontsize=6.5)
        figure.subplots_adjust(0.01, 0.01, 0.99, 0.92, 0.05, 0.12)
        return svg(figure)


def _sets(document: Document) -> Iterator[str]:
    heads = ("set", "hidden", "said", "verdict", "sigma", "beside its rival", "")
    yield html.folded("Every set with its answer", html.table(heads, _set_rows(document), words=4, ending=1))


def _set_rows(document: Document) -> list[tuple[str, ...]]:
    return [
        (
            _name(one, document), one["truth"], one["said"], one["verdict"], f"{one['sigma']:.1f}",
            NOTHING if one["sigma_rival"] is None else f"{one['sigma_rival']:.1f}",
            ", ".join(["further"] * bool(one["follows"]) + ["missed"] * one["missed"]),
        )
        for one in document["marks"]
    ]  # fmt: skip


def _provenance(document: Document) -> Iterator[str]:
    rows = [*((f"root of {folder}", root or "none: a set taken away would not be found")
              for folder, root in document["roots"].items()), ("luxloop", document["versions"]["luxloop"]),
            ("predictions", ", ".join(document["solvers"])),
            ("effects to choose from", ", ".join(str(count) for count in document["among"]))]  # fmt: skip
    for name, words in (("made", "to make a set"), ("diagnosed", "to diagnose one")):
        if spread := document["seconds"][name]:
            rows.append(
                (words, f"{spread['median']:.0f} s (median of {spread['sets']}), {spread['most']:.0f} s at most")
            )
    yield html.facts(rows)
