"""The picture of a film: one curve per stack against angle or wavelength."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import colormaps, rc_context
from matplotlib.figure import Figure

from luxloop.files import whole
from viewer.look import PLAIN

QUANTITIES = {"R": "reflectance R", "T": "transmittance T", "psi": "psi (deg)", "delta": "delta (deg)"}


def draw(document: dict[str, Any], path: Path) -> None:
    """Draw the result document of `luxloop film` into a file of the kind its ending names (PNG, PDF, SVG)."""
    with rc_context(PLAIN), whole(path) as fresh:
        _figure(document).savefig(fresh, dpi=130)


def _figure(document: dict[str, Any]) -> Figure:
    films, against = document["films"], document["against"]
    figure = Figure(figsize=(8.6, 4.6), layout="constrained")
    axes = figure.add_subplot()
    shades = colormaps["viridis"]
    for number, film in enumerate(films):
        label = f"{film['dbr_pairs']:g} pairs" if "dbr_pairs" in film else film["stack"]
        half = "dbr_pairs" in film and film["dbr_pairs"] % 1 != 0
        axes.plot(
            document["curve_axis"],
            film["curve"],
            color=shades(number / max(len(films) - 1, 1) * 0.92),
            linestyle="-" if half or "stack" in film else "--",
            linewidth=1.6,
            marker="o" if len(set(document["curve_axis"])) == 1 else None,
            label=label,
        )
    chip = document["side"] == "inside" and "dbr_pairs" in films[0]
    medium = "in the chip" if chip else f"on the {document['side']}"
    axes.set_xlabel(f"angle of incidence {medium} (deg)" if against == "angle" else "wavelength (nm)")
    axes.set_ylabel(QUANTITIES[document["quantity"]])
    low, high = min(document["curve_axis"]), max(document["curve_axis"])
    axes.set_xlim(*((low, high) if high > low else (low - 1.0, high + 1.0)))
    if document["unit"] == "1":  # all of it, but a coating's few per cent fill the picture
        highest = max(max(film["curve"]) for film in films)
        axes.set_ylim(0.0, 1.02 if highest > 0.3 else max(1.1 * highest, 1e-6))
    axes.grid(alpha=0.25)
    axes.set_title(_title(document), fontsize=9, loc="left")
    if len(films) > 1:
        figure.legend(loc="outside right upper", fontsize=8, title="solid: N.5 pairs")
    return figure


def _title(document: dict[str, Any]) -> str:
    kinds = {"s": "s-polarised light", "p": "p-polarised light", "u": "unpolarised light"}
    light = "light" if document["unit"] == "deg" else kinds[document["polarisation"]]
    at = (
        f"{document['wavelength_nm'][0]:g} nm"
        if document["against"] == "angle"
        else f"{document['angle_deg'][0]:g} deg"
    )
    line = f", line of {document['bandwidth_nm']:g} nm FWHM" if document["bandwidth_nm"] else ""
    first = document["films"][0]
    what = f"DBR of the model {document['model']['name']!r}" if "dbr_pairs" in first else first["stack"]
    if "dbr_pairs" in first and len(document["films"]) == 1:
        what = f"{first['dbr_pairs']:g} pairs, {what}"
    return f"{what}\n{light} from the {document['side']}, {at}{line}"
