"""The picture of a simulation: the map in lx, the cut of Eq. 8 with its error, the ledger as bars."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from luxloop.files import whole
from viewer.look import PLAIN

ENDS = {
    "receiver": "receiver",
    "chip": "chips",
    "substrate": "substrate",
    "dbr": "DBR",
    "edge": "edge",
    "trapped": "trapped",
}


def draw(document: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Draw the result document of `luxloop simulate` and its arrays into a file of the kind its ending names."""
    with rc_context(PLAIN), whole(path) as fresh:
        figure = Figure(figsize=(11.0, 5.6), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0), height_ratios=(1.4, 1.0))
        _map(figure, figure.add_subplot(grid[:, 0]), document, arrays)
        _cut(figure.add_subplot(grid[0, 1]), document, arrays)
        _ledger(figure.add_subplot(grid[1, 1]), document)
        figure.suptitle(_title(document), fontsize=10, x=0.01, ha="left")
        figure.savefig(fresh, dpi=130)


def _map(figure: Figure, axes: Axes, document: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """False colours, row 0 at the lowest y; the line of Eq. 8 across it."""
    extent = (*document["map"]["x_um"], *document["map"]["y_um"])
    image = axes.imshow(arrays["map_lx"], origin="lower", extent=extent, cmap="inferno", interpolation="nearest")
    figure.colorbar(image, ax=axes, label="illuminance (lx)")
    y_um, window_um = document["cut"]["y_um"], document["cut"]["window_um"]
    axes.plot(window_um, [y_um, y_um], color="white", linewidth=1.0, linestyle="--")
    axes.set_xlabel("x (µm)")
    axes.set_ylabel("y (µm)")
    relative = float(np.median(arrays["map_error_lx"] / np.maximum(arrays["map_lx"], 1e-30)))
    axes.set_title(f"standard error of a point {100 * relative:.2g} % (median)", fontsize=9, loc="left")


def _cut(axes: Axes, document: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Illuminance on the line, a band of one standard error either side, the window between its ends."""
    x_um, lx, error = (arrays[f"cut_{name}"] for name in ("x_um", "lx", "error_lx"))
    inside = (x_um >= document["cut"]["window_um"][0] - 1e-9) & (x_um <= document["cut"]["window_um"][1] + 1e-9)
    axes.axvspan(*document["cut"]["window_um"], color="0.93", label="window of Eq. 8")
    axes.fill_between(x_um, lx - error, lx + error, color="tab:orange", alpha=0.4, linewidth=0.0, label="± 1 error")
    axes.plot(x_um, lx, color="tab:red", linewidth=1.4)
    for extreme in (lx[inside].min(), lx[inside].max()):
        axes.axhline(extreme, color="0.4", linewidth=0.7, linestyle=":")
    axes.set_xlim(x_um[0], x_um[-1])
    low, high = float((lx - error).min()), float((lx + error).max())
    room = 0.25 * (high - low) + 1e-3 * abs(high) or 1.0  # where nothing shines
    axes.set_ylim(max(low - 1.6 * room, min(low, 0.0)), high + room)
    axes.set_xlabel(f"x (µm) at y = {document['cut']['y_um']:g} µm")
    axes.set_ylabel("illuminance (lx)")
    axes.legend(loc="lower center", ncols=2, fontsize=8)
    one = document["metrics"]["uniformity"]
    axes.set_title(
        f"uniformity {100 * one['value']:.2f} ± {100 * one['standard_error']:.2f} % (its bias of "
        f"{100 * one['bias']:+.2f} taken off)",
        fontsize=9,
        loc="left",
    )


def _ledger(axes: Axes, document: Mapping[str, Any]) -> None:
    """Where the light ended, in percent of what was emitted."""
    if "ledger" not in document:
        axes.set_axis_off()
        axes.text(0.0, 0.5, "the twin follows only part of the light:\nno ledger", fontsize=9, va="center")
        return
    shares = [100.0 * document["ledger"][name]["value"] for name in ENDS]
    errors = [100.0 * document["ledger"][name]["standard_error"] for name in ENDS]
    bars = axes.barh(list(ENDS.values()), shares, xerr=errors, color="tab:blue", alpha=0.8)
    axes.bar_label(bars, labels=[f"{share:.2f}" for share in shares], padding=4, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.15 * max(*shares, 1.0))
    axes.set_xlabel("% of the emitted light")
    axes.set_title("where the light ended", fontsize=9, loc="left")


def _title(document: Mapping[str, Any]) -> str:
    design, array = document["design"], document["array"]
    lengths = "D {distance_um:g}, W {width_um:g}, S {spacing_um:g}, T {thickness_um:g} µm, {dbr_pairs:g} pairs"
    module = "endless array" if array is None else f"{array['rows']} x {array['columns']} chips"
    lux = document["metrics"]["mean_illuminance_lx"]
    return (
        f"{lengths.format(**design)}; {module}; model {document['model']['name']!r}\n"
        f"mean {lux['value']:,.0f} ± {lux['standard_error']:,.0f} lx; {document['histories']:,} histories"
    )
