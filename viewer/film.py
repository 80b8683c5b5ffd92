"""The picture of a film: one curve per stack against angle or wavelength."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import colormaps
from matplotlib.figure import Figure

QUANTITIES = {"R": "reflectance R", "T": "transmittance T", "psi": "psi (deg)", "delta": "delta (deg)"}


def draw(document: dict[str, Any], path: Path) -> None:
    """Draw the result document of `luxloop film` into a PNG file."""
    films, against = document["films"], document["against"]
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
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
            label=label,
        )
    medium = f"in the {'chip' if document['side'] == 'inside' and 'dbr_pairs' in films[0] else document['side']}"
    axes.set_xlabel(f"angle of incidence {medium} (deg)" if against == "angle" else "wavelength (nm)")
    axes.set_ylabel(QUANTITIES[document["quantity"]])
    axes.set_xlim(document["curve_axis"][0], document["curve_axis"][-1])
    if document["unit"] == "1":
        axes.set_ylim(0.0, 1.02)
    axes.grid(alpha=0.25)
    axes.set_title(_title(document), fontsize=10)
    columns = 1 if len(films) < 7 else 2
    axes.legend(
        fontsize=8, ncols=columns, title="solid: N.5 pairs" if len(films) > 1 and "dbr_pairs" in films[0] else None
    )
    figure.savefig(path, dpi=130)


def _title(document: dict[str, Any]) -> str:
    kinds = {"s": "s-polarised light", "p": "p-polarised light", "u": "unpolarised light"}
    light = "light" if document["unit"] == "deg" else kinds[document["polarisation"]]
    at = (
        f"{document['wavelength_nm'][0]:g} nm"
        if document["against"] == "angle"
        else f"{document['angle_deg'][0]:g} deg"
    )
    line = f", line of {document['bandwidth_nm']:g} nm FWHM" if document["bandwidth_nm"] else ""
    return f"{light} from the {document['side']}, {at}{line}, model {document['model']['name']!r}"
