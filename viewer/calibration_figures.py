"""The figures of a calibration: error against reflectance as in Fig. 5, pulls, profiles, errors; each gives SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from viewer.look import BLUE, COLOURS, GREY, INK, LOOK, MIDDLE, ORANGE, SHADE, TEXT, svg

Document = Mapping[str, Any]

TITLES = {"mse": "MSE (Eq. 1)", "chi2_per_pixel": "χ² per pixel"}
LIMIT_95 = 3.841  # of chi2 with one degree of freedom


def stage_picture(stage: Document, measure: str) -> bytes:
    """Error against reflectance, a curve per kind of scatter, as in Fig. 5; the smallest of all marked."""
    with rc_context(TEXT):
        figure = Figure(figsize=MIDDLE, layout="constrained")
        axes = figure.add_subplot()
        stage_axes(axes, stage, measure)
        figure.legend(loc="outside lower left", ncols=3, handlelength=1.6)
        return svg(figure)


def all_stages(document: Document) -> Figure:
    """The picture that says most: the curves of every stage beside one another."""
    with rc_context(LOOK):
        stages = document["stages"]
        figure = Figure(figsize=(5.4 * max(len(stages), 1), 4.2), layout="constrained")
        for axes, stage in zip(figure.subplots(1, max(len(stages), 1), squeeze=False)[0], stages, strict=False):
            stage_axes(axes, stage, "mse")
            axes.legend(loc="best")
        figure.suptitle(document["sentence"], fontsize=10, x=0.01, ha="left")
        return figure


def stage_axes(axes: Axes, stage: Document, measure: str) -> None:
    """The curves of one stage; the arg min of Eq. 2 is a ring."""
    ring: tuple[float, float] | None = None
    for curve, colour in zip(stage["curves"], COLOURS * 3, strict=False):
        if measure not in curve:
            continue
        x, y = (np.asarray(curve[name], dtype=np.float64) for name in ("x", measure))
        axes.plot(x, y, "o-", color=colour, markersize=3.0, linewidth=1.1, label=curve["label"])
        if curve["label"] == stage["best"]["label"]:
            here = int(np.argmin(np.abs(x - stage["best"]["x"])))
            ring = x[here], y[here]
    if ring:
        axes.plot(*ring, "o", markersize=11.0, fillstyle="none", color=ORANGE, label="smallest MSE (Eq. 2)")
    axes.set_title(stage["name"])
    axes.set_xlabel(stage["parameter"].removeprefix("environment.").replace(".", ", "))
    axes.set_ylabel(TITLES[measure])
    axes.xaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100.0 * share:g} %"))
    axes.grid(alpha=0.25)


def pull_picture(parameters: Sequence[Document]) -> bytes:
    """How far each parameter was moved from its prior, in the prior's standard deviations, with its 95 % interval."""
    told = [one for one in parameters if one.get("prior_sd")]
    with rc_context(TEXT):
        figure = Figure(figsize=(4.6, 1.2 + 0.32 * len(told)), layout="constrained")
        axes = figure.add_subplot()
        axes.axvspan(-1.0, 1.0, color=SHADE, zorder=0)
        axes.axvline(0.0, color=INK, linewidth=0.6)
        for row, one in enumerate(told):
            value, low, high = ((one[name] - one["prior_mean"]) / one["prior_sd"] for name in
                                ("value", "lower95", "upper95"))  # fmt: skip
            axes.plot([low, high], [row, row], color=BLUE, linewidth=2.0, alpha=0.6)
            axes.plot(value, row, "o", color=BLUE, markersize=4.5)
        axes.set_yticks(range(len(told)), [short(one["path"]) for one in told])
        axes.invert_yaxis()
        axes.set_xlabel("moved from the prior, in its standard deviations")
        axes.grid(alpha=0.25, axis="x")
        return svg(figure)


def profile_picture(profile: Document, parameter: Document | None) -> bytes:
    """chi2 above its smallest against one parameter, the others refitted; below the line lie 95 %."""
    with rc_context(TEXT):
        figure = Figure(figsize=(3.3, 2.6), layout="constrained")
        axes = figure.add_subplot()
        x, chi2 = (np.asarray(profile[name], dtype=np.float64) for name in ("x", "chi2"))
        rise = chi2 - np.nanmin(chi2)
        if parameter is not None:
            axes.axvspan(parameter["lower95"], parameter["upper95"], color=SHADE, zorder=0)
            axes.axvline(parameter["value"], color=ORANGE, linewidth=1.0)
        axes.plot(x, rise, "o-", color=BLUE, markersize=2.5, linewidth=1.1)
        axes.axhline(LIMIT_95, color=INK, linewidth=0.8, linestyle=":")
        axes.set_xlim(float(x.min()), float(x.max()))
        axes.set_ylim(0.0, max(1.05 * float(np.nanmax(rise)), 1.2 * LIMIT_95))
        axes.set_title(short(profile["path"]))
        axes.set_xlabel(unit_of(parameter))
        axes.set_ylabel("χ² above its smallest")
        axes.grid(alpha=0.25)
        return svg(figure)


def error_picture(errors: Mapping[str, Document], units: Mapping[str, str]) -> bytes:
    """The same for a page."""
    with rc_context(TEXT):
        return svg(error_figure(errors, units))


def error_figure(errors: Mapping[str, Document], units: Mapping[str, str], title: str = "") -> Figure:
    """Rms error of each shot before and after, and its noise, which no model can go below.

    `units` of the shots' errors: percent where none is told; shots in degrees have axes of their own.
    """
    groups: dict[str, list[str]] = {}
    for name in errors["after"]["rms_error_percent"]:
        groups.setdefault(units.get(name, "%"), []).append(name)
    counts = [len(names) for names in groups.values()]
    with rc_context(TEXT):
        figure = Figure(figsize=(4.6, 0.4 + 0.8 * len(counts) + 0.27 * sum(counts)), layout="constrained")
        panes = figure.subplots(len(counts), squeeze=False, height_ratios=counts)[:, 0]
        for axes, (unit, names) in zip(panes, groups.items(), strict=True):
            _error_axes(axes, errors, names)
            axes.set_xlabel(f"rms error ({unit})")
        figure.suptitle(title, fontsize=8, x=0.01, ha="left")
        figure.legend(*panes[0].get_legend_handles_labels(), loc="outside lower left", ncols=3)
        return figure


def _error_axes(axes: Axes, errors: Mapping[str, Document], names: Sequence[str]) -> None:
    for row, name in enumerate(names):
        noise = errors["after"]["noise_percent"].get(name)
        after = errors["after"]["rms_error_percent"][name]
        before = errors["before"]["rms_error_percent"].get(name) if "before" in errors else None
        once = row == 0
        if before is not None:
            axes.plot([before, after], [row, row], color=GREY, linewidth=1.2, zorder=1)
            axes.plot(before, row, "o", color=ORANGE, markersize=5.0, label="before" if once else None)
        axes.plot(after, row, "o", color=BLUE, markersize=5.0, label="after" if once else None)
        if noise is not None:
            axes.plot([noise, noise], [row - 0.35, row + 0.35], color=INK, label="noise" if once else None)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.grid(alpha=0.25, axis="x")


def short(path: str) -> str:
    """A parameter's path without what all have in common."""
    return path.removeprefix("environment.").replace("_", " ").replace(".", ", ")


def unit_of(parameter: Document | None) -> str:
    """The unit for an axis; a pure number has none."""
    unit = parameter["unit"] if parameter else ""
    return f"value ({unit})" if unit and unit != "1" else "value"
