"""Pictures of the gallery of effects: small PNGs of few colours."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from viewer.look import BLUE, GREY, INK, ORANGE, TEXT

Real = NDArray[np.float64]
Document = Mapping[str, Any]
Arrays = dict[str, Real]

DPI, COLOURS, REFINED = 80, 256, 3
"""Of a PNG; how often its palette is made to fit better, so that no end of a colour bar takes a line's colour."""


def draw(document: Document, arrays: Arrays, path: Path) -> None:
    """A signature as a small PNG of few colours: the difference and a cut, or a film's curves."""
    with rc_context(TEXT | {"font.size": 7.5}):
        figure = _image(arrays) if document["kind"] == "image" else _curves(arrays)
        file = BytesIO()
        figure.savefig(file, format="png", dpi=DPI, facecolor="white")
    Image.open(file).convert("RGB").quantize(COLOURS, kmeans=REFINED, dither=Image.Dither.NONE).save(
        path, optimize=True
    )


def _image(arrays: Arrays) -> Figure:
    figure = Figure(figsize=(7.2, 2.3), layout="constrained")
    area, cut, beside = figure.subplots(1, 3, width_ratios=(1.15, 1.0, 1.0))
    x_mm, y_mm = arrays["x_um"] / 1e3, arrays["y_um"] / 1e3
    base, after = arrays["base"], arrays["with"]
    difference = 100.0 * (after - base) / base.mean()
    most = float(np.abs(difference).max())
    extent = (x_mm[0], x_mm[-1], y_mm[0], y_mm[-1])
    drawn = area.imshow(difference, origin="lower", extent=extent, cmap="RdBu_r", vmin=-most, vmax=most)
    figure.colorbar(drawn, ax=area)
    area.set_title("difference, % of the mean")
    middle = len(base) // 2
    cut.plot(x_mm, base[middle] / base.mean(), color=INK, linewidth=1.0, label="without")
    cut.plot(x_mm, after[middle] / base.mean(), color=ORANGE, linewidth=1.0, label="with")
    cut.set_ylim(0.0, None)
    cut.set_title("middle row, over the mean")
    cut.legend()
    beside.axhline(0.0, color=GREY, linewidth=0.8)
    beside.plot(x_mm, difference[middle], color=BLUE, linewidth=1.0)
    beside.set_title("middle row, difference in %")
    for axes in (area, cut, beside):
        axes.set_xlabel("x (mm)")
    return figure


def _curves(arrays: Arrays) -> Figure:
    figure = Figure(figsize=(7.2, 2.9), layout="constrained")
    labels = {"R": "R at 0°", "T": "T at 0°", "psi": "psi at 70° (deg)", "delta": "delta at 70° (deg)"}
    names = [name for name in labels if f"{name}/base" in arrays]
    rows = figure.subplots(2, len(names), sharex=True, height_ratios=(1.0, 0.7))
    for above, below, name in zip(*rows, names, strict=True):
        base, after = arrays[f"{name}/base"], arrays[f"{name}/with"]
        above.plot(arrays["wavelength_nm"], base, color=INK, linewidth=1.0, label="without")
        above.plot(arrays["wavelength_nm"], after, color=ORANGE, linewidth=1.0, label="with")
        above.set_title(labels[name])
        below.axhline(0.0, color=GREY, linewidth=0.8)
        below.plot(arrays["wavelength_nm"], after - base, color=BLUE, linewidth=1.0)
        below.set_xlabel("wavelength (nm)")
    rows[0][0].legend()
    rows[1][0].set_ylabel("difference")
    return figure
