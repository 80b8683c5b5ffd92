"""Curves of a comparison: residuals against one coordinate with their noise, spectra and far fields with residuals.

Each gives SVG. What the noise of the measurement alone gives in 95 % of cases is a band.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, MaxNLocator
from numpy.typing import NDArray

from viewer.look import COLOURS, INK, MIDDLE, PIXELS_FROM, SHADE, TEXT, svg

Document = Mapping[str, Any]
Values = NDArray[np.float64]

SCALE = 4.0  # sigma; a pane shows no less
DASHES = ("-", "--", ":", "-.")


class Plain(LogFormatter):
    """Writes 0.01 where matplotlib's own would write 10 to a power in mathtext, which no picture reads."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The label of a tick; empty where there is no room for one."""
        return f"{x:g}" if super().__call__(x, pos) else ""


def profile_picture(profiles: Sequence[Document], groups: Mapping[str, str]) -> bytes:
    """Curves against one coordinate, each with its 95 % band; one colour per group {shot: group}."""
    with rc_context(TEXT):
        figure = Figure(figsize=MIDDLE, layout="constrained")
        axes = figure.add_subplot()
        power = "power" in profiles[0]
        names = list(dict.fromkeys(groups.get(one["shot"], one["shot"]) for one in profiles))
        met: dict[str, int] = {}
        for one in profiles:
            name = groups.get(one["shot"], one["shot"])
            number = met[name] = met.get(name, -1) + 1
            _profile(axes, one, COLOURS[names.index(name) % len(COLOURS)], DASHES[number % len(DASHES)])
        _profile_axes(axes, profiles, power)
        if len(profiles) > 1:
            figure.legend(*_legend(axes, profiles, groups), loc="outside lower left", ncols=3, handlelength=1.6)
        return svg(figure)


def curve_picture(x: Values, measured: Values, model: Values, sigma: Values, lines: Sequence[str],
                  labels: tuple[str, str]) -> bytes:  # fmt: skip
    """A spectrum or a far field, one colour per line, with the residual in sigma in its own pane."""
    with rc_context(TEXT):
        figure = Figure(figsize=(4.6, 3.8), layout="constrained")
        curve_panes(figure, x, measured, model, sigma, lines, labels)
        return svg(figure)


def curve_panes(figure: Figure, x: Values, measured: Values, model: Values, sigma: Values, lines: Sequence[str],
                labels: tuple[str, str]) -> None:  # fmt: skip
    """The two panes of `curve_picture`: points and curve above, residual in sigma below."""
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
    z = (measured - model) / sigma
    names = list(dict.fromkeys(lines))
    shades = _shades(len(names))
    pixels = len(x) > PIXELS_FROM
    for name, colour in zip(names, shades, strict=False):
        here = np.array([line == name for line in lines])
        order = np.argsort(x[here], kind="stable")
        at, of_it, told, apart = (values[here][order] for values in (x, measured, model, z))
        above.plot(at, of_it, ".", color=colour, markersize=3.0, alpha=0.7, rasterized=pixels)
        above.plot(at, told, color=colour, linewidth=1.1, label=name)
        below.plot(at, apart, ".-", color=colour, markersize=2.5, linewidth=0.5, rasterized=pixels)
    sigma_pane(below, z)
    below.set_xlabel(labels[0])
    above.set_ylabel(labels[1])
    above.set_title("points: measured, lines: model")
    above.grid(alpha=0.25)
    if any(names):
        handles, texts = above.get_legend_handles_labels()
        step = -(-len(handles) // 8)
        figure.legend(handles[::step], texts[::step], loc="outside lower left", ncols=4, handlelength=1.2)


def fourier_picture(lines: Sequence[Document]) -> bytes:
    """The power of a spectrum's residual against optical thickness: a peak is a layer that is missing or wrong.

    One colour per line, each with `optical_thickness_um`, `power`, the `line`'s name and the `band` of noise.
    """
    with rc_context(TEXT):
        figure = Figure(figsize=(4.6, 3.8), layout="constrained")
        axes = figure.add_subplot()
        for one, colour in zip(lines, _shades(len(lines)), strict=False):
            axes.plot(one["optical_thickness_um"], one["power"], color=colour, linewidth=1.0, label=one["line"])
        axes.axhspan(0.0, lines[0]["band"], color=SHADE, zorder=0)
        axes.axhline(1.0, color=INK, linewidth=0.6)
        axes.set_xlabel("optical thickness, group index x d x cos(angle inside) (µm)")
        axes.set_ylabel("residual power, 1 = noise")
        axes.set_title("a peak: fringes of a layer missing or wrong")
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.25)
        if len(lines) > 1:
            handles, texts = axes.get_legend_handles_labels()
            step = -(-len(handles) // 8)
            figure.legend(handles[::step], texts[::step], loc="outside lower left", ncols=4, handlelength=1.2)
        return svg(figure)


def sigma_pane(axes: Axes, z: Values) -> None:
    """Residuals in sigma, at least ±4, with the range that holds 95 % of noise."""
    finite = np.abs(z[np.isfinite(z)])
    largest = max(SCALE, 1.1 * float(finite.max(initial=0.0)))
    axes.axhspan(-1.96, 1.96, color=SHADE, zorder=0)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.set_ylim(-largest, largest)
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True, symmetric=True))
    axes.set_ylabel("sigma")


def _shades(count: int) -> Sequence[Any]:
    """Colours of so many lines; no ink: what is drawn as pixels does not change on dark paper."""
    return COLOURS[1:] if count < len(COLOURS) else list(colormaps["viridis"](np.linspace(0.0, 0.9, count)))


def _profile(axes: Axes, one: Document, colour: str, dash: str) -> None:
    """A curve; where it leaves its band its points are filled, so that they are seen among many curves."""
    power = "power" in one
    x = np.asarray(one["x"], dtype=np.float64)
    y, band = _values(one)
    middle = 1.0 if power else 0.0
    low = np.maximum(middle - band, 0.05) if power else middle - band
    axes.fill_between(x, low, middle + band, color=colour, alpha=0.08, linewidth=0.0)
    axes.plot(
        x,
        y,
        color=colour,
        linestyle=dash,
        linewidth=1.1,
        label=", ".join(filter(None, (one["shot"], one.get("line")))),
    )
    outside = np.abs(y - middle) > band
    axes.plot(x[outside], y[outside], "o", color=colour, markersize=2.8)


def _profile_axes(axes: Axes, profiles: Sequence[Document], power: bool) -> None:
    first = profiles[0]
    axes.axhline(1.0 if power else 0.0, color=INK, linewidth=0.6)
    unit = first["unit"].replace("um", "µm")
    axes.set_xlabel(f"{first['against']} ({unit})" if unit else first["against"])
    unit = first.get("value_unit", "% of the model")
    axes.set_ylabel("residual power, 1 = noise" if power else f"measured - model ({unit})")
    axes.grid(alpha=0.25)
    if power:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(Plain())
        axes.yaxis.set_minor_formatter(Plain())
        return
    axes.set_ylim(*_well_known(profiles))


def _values(one: Document) -> tuple[Values, Values]:
    """A profile and its band, point by point."""
    for name, band in (("power", "band"), ("difference", "band"), ("relative_percent", "band_percent")):
        if name in one:
            shape = np.shape(one["x"])
            return np.asarray(one[name], np.float64), np.broadcast_to(np.asarray(one[band], np.float64), shape)
    raise KeyError(one["against"])


def _well_known(profiles: Sequence[Document]) -> tuple[float, float]:
    """Limits that points with a wide band, far from all light, do not set."""
    y, band = (np.concatenate(parts) for parts in zip(*map(_values, profiles), strict=True))
    known = np.isfinite(y) & np.isfinite(band)
    if not known.any():
        return -1.0, 1.0
    known &= band <= 6.0 * np.median(band[known])
    largest = 1.15 * float(np.max(np.maximum(np.abs(y[known]), band[known]))) or 1.0
    return -largest, largest


def _legend(axes: Axes, profiles: Sequence[Document], groups: Mapping[str, str]) -> tuple[list[Any], list[str]]:
    """A line per shot; of many shots a line per group."""
    handles, labels = axes.get_legend_handles_labels()
    if len(profiles) <= 6:
        return handles, labels
    first: dict[str, Any] = {}
    for one, handle in zip(profiles, handles, strict=True):
        first.setdefault(groups.get(one["shot"], one["shot"]), handle)
    return list(first.values()), list(first)
