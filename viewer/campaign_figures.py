"""The figures of a campaign's page: each takes the document and its arrays, and gives a picture as SVG.

The same document gives the same bytes: no date, no random names. What has thousands of points is drawn as pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from viewer.look import BLUE, GREEN, GREY, INK, LOOK, ORANGE, PIXELS_FROM, SHADE, svg

Document = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]

ENDS = {
    "receiver": "receiver",
    "chip": "chips",
    "substrate": "substrate",
    "dbr": "DBR",
    "edge": "edge",
    "trapped": "trapped",
}
EVENTS = {
    "through_dbr": "through the top (1)",
    "from_sides": "directly from the sides (2)",
    "after_top_reflection": "after reflection at the top (3)",
    "after_receiver": "after the receiver (4)",
}
"""The paper's optical events 1 to 4."""


def learning_curve(arrays: Arrays) -> bytes:
    """Uniformity of every step of the walk with its error, the best so far with its own, episodes below."""
    episodes = len(arrays["episode_number"]) > 0
    with rc_context(LOOK):
        figure = Figure(figsize=(8.6, 5.4 if episodes else 3.4), layout="constrained")
        rows = figure.subplots(2 if episodes else 1, 1, squeeze=False, height_ratios=(1.5, 1.0)[: 1 + episodes])[:, 0]
        _steps(rows[0], arrays)
        if episodes:
            _episodes(rows[1], arrays)
        return svg(figure)


def runs_compared(document: Document, arrays: Arrays) -> bytes:
    """Best so far of several runs against the designs they evaluated, each with its error."""
    with rc_context(LOOK):
        figure = Figure(figsize=(8.6, 3.2), layout="constrained")
        axes = figure.add_subplot()
        for number, run in enumerate(document["runs"]):
            names = ("walk_evaluations", "walk_best", "walk_best_error")
            x, best, error = _at_changes(*(arrays[f"run_{number}_{name}"] for name in names))
            (line,) = axes.step(x, 100.0 * best, where="post", linewidth=1.5, label=run["run"])
            low, high = 100.0 * (best - error), 100.0 * (best + error)
            axes.fill_between(x, low, high, step="post", color=line.get_color(), alpha=0.15, linewidth=0.0)
        axes.set_xlabel("different designs evaluated")
        axes.set_ylabel("best uniformity so far (%)")
        axes.grid(alpha=0.25)
        axes.legend(loc="lower right")
        return svg(figure)


def best_design(document: Document, arrays: Arrays, name: str = "best") -> bytes:
    """Map in false colours and cut of Eq. 8 of one design, as in Figs. 6d-f."""
    with rc_context(LOOK):
        figure = Figure(figsize=(8.6, 3.5), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
        lx = arrays[f"{name}_map_lx"]
        _map(figure, left, document["shown"][name], lx, (float(lx.min()), float(lx.max())))
        _cut(right, document["shown"][name], arrays, name, BLUE, "")
        _window(right, document["shown"][name])
        right.legend(loc="lower center", ncols=2)
        return svg(figure)


def dbr_compared(document: Document, arrays: Arrays) -> bytes:
    """The same design without and with its DBR on one scale, and both cuts, as in Fig. 8."""
    with rc_context(LOOK):
        figure = Figure(figsize=(8.6, 6.2), layout="constrained")
        grid = figure.add_gridspec(2, 2, height_ratios=(1.0, 0.9))
        maps = {name: arrays[f"{name}_map_lx"] for name in ("bare", "with")}
        low, high = min(lx.min() for lx in maps.values()), max(lx.max() for lx in maps.values())
        ends = (float(low - 0.35 * (high - low)), float(high))  # the darker map is not all black
        titles = {
            "bare": "(a) without DBR",
            "with": f"(b) with {document['dbr']['with']['design']['dbr_pairs']:g} pairs",
        }
        for column, name in enumerate(maps):
            axes = figure.add_subplot(grid[0, column])
            _map(figure, axes, document["shown"][name], maps[name], ends)
            axes.set_title(titles[name])
        cuts = figure.add_subplot(grid[1, :])
        _cut(cuts, document["shown"]["bare"], arrays, "bare", ORANGE, "without DBR, ± 1 error")
        _cut(cuts, document["shown"]["with"], arrays, "with", BLUE, "with DBR, ± 1 error")
        _window(cuts, document["shown"]["with"])
        cuts.set_title("(c) on the line of Eq. 8")
        cuts.legend(loc="best", ncols=3)
        return svg(figure)


def losses(document: Document, names: Mapping[str, str]) -> bytes:
    """Where the light ended and how it came to the receiver, in percent of what was emitted, of the shown `names`."""
    with rc_context(LOOK):
        figure = Figure(figsize=(8.6, 3.1), layout="constrained")
        axes = figure.subplots(1, 2)
        for place, (part, rows) in enumerate({"ledger": ENDS, "optical_events": EVENTS}.items()):
            height = 0.8 / len(names)
            for number, (name, label) in enumerate(names.items()):
                of_it = document["shown"][name][part]
                values, errors = (
                    np.array([100.0 * of_it[row][key] for row in rows]) for key in ("value", "standard_error")
                )
                y = np.arange(len(rows)) + (number - (len(names) - 1) / 2.0) * height
                bars = axes[place].barh(
                    y, values, 0.92 * height, xerr=errors, color=(BLUE, ORANGE)[number % 2], label=label
                )
                axes[place].bar_label(bars, labels=[f"{value:.2f}" for value in values], padding=4, fontsize=7)
            axes[place].set_yticks(np.arange(len(rows)), list(rows.values()))
            axes[place].invert_yaxis()
            axes[place].set_xlim(0.0, 1.18 * max(axes[place].get_xlim()[1], 1.0))
            axes[place].set_xlabel("% of the emitted light")
        axes[0].set_title("where it ended")
        axes[1].set_title("arrivals at the receiver, each counted")
        axes[0].legend(loc="lower right")
        return svg(figure)


def pareto(document: Document, arrays: Arrays) -> bytes:
    """Uniformity against mean illuminance of all designs of the walk; the front, and the finalists with errors."""
    with rc_context(LOOK):
        figure = Figure(figsize=(8.6, 4.2), layout="constrained")
        axes = figure.add_subplot()
        x, y = arrays["pareto_lx"], 100.0 * arrays["pareto_uniformity"]
        seen = axes.scatter(
            x, y, s=14.0, c=arrays["pareto_pairs"], cmap="viridis", alpha=0.8, linewidths=0.0,
            rasterized=len(x) > PIXELS_FROM,
        )  # fmt: skip
        figure.colorbar(seen, ax=axes, label="DBR pairs")
        front = np.flatnonzero(arrays["pareto_front"])
        front = front[np.argsort(x[front])]
        axes.step(x[front], y[front], where="pre", color=GREY, linewidth=1.2, label="front of the walk")
        _marked(axes, document["finalists"], "o", BLUE, "finalists, ± 1 error")
        for row, mark, colour, label in (
            (document["start"], "s", INK, "start"),
            (document["dbr"]["without"], "^", ORANGE, "without DBR"),
        ):
            if row is not None:
                _marked(axes, [row], mark, colour, label)
        axes.xaxis.set_major_formatter("{x:,.0f}")
        axes.set_xlabel("mean illuminance (lx)")
        axes.set_ylabel("uniformity (%)")
        axes.grid(alpha=0.25)
        axes.legend(loc="best")
        return svg(figure)


def geometry(document: Document, arrays: Arrays) -> bytes:
    """Uniformity against the geometry factor f = 4T/W (Eq. 9) of all designs of the walk, finalists with errors."""
    with rc_context(LOOK):
        figure = Figure(figsize=(8.6, 3.2), layout="constrained")
        axes = figure.add_subplot()
        x, y = arrays["pareto_f"], 100.0 * arrays["pareto_uniformity"]
        axes.scatter(x, y, s=12.0, color=GREY, alpha=0.7, linewidths=0.0, rasterized=len(x) > PIXELS_FROM)
        rows = document["finalists"]
        if rows:
            values, errors = _of(rows, "uniformity")
            axes.errorbar([row["f"] for row in rows], 100.0 * values, 100.0 * errors, fmt="o", color=BLUE,
                          markersize=5.0, label="finalists, ± 1 error")  # fmt: skip
            axes.legend(loc="best")
        axes.set_xlabel("geometry factor f = 4T/W")
        axes.set_ylabel("uniformity (%)")
        axes.grid(alpha=0.25)
        return svg(figure)


def _steps(axes: Axes, arrays: Arrays) -> None:
    value, error = 100.0 * arrays["walk_uniformity"], 100.0 * arrays["walk_error"]
    x, told, none = np.arange(1, len(value) + 1), arrays["walk_evaluated"], arrays["walk_infeasible"]
    pixels = len(x) > PIXELS_FROM
    axes.vlines(x[told], (value - error)[told], (value + error)[told], color=GREY, alpha=0.6, linewidth=0.9,
                rasterized=pixels, label="± 1 error of a step")  # fmt: skip
    axes.plot(x[told], value[told], ".", color=GREY, markersize=3.0, rasterized=pixels)
    if none.any():
        axes.plot(x[none], value[none], "x", color=ORANGE, markersize=4.0, rasterized=pixels, label="cannot be built")
    turns, best, of_best = _at_changes(x, 100.0 * arrays["walk_best"], 100.0 * arrays["walk_best_error"])
    low, high = best - of_best, best + of_best
    axes.fill_between(turns, low, high, step="post", color=BLUE, alpha=0.2, linewidth=0.0)
    axes.step(turns, best, where="post", color=BLUE, linewidth=1.5, label="best so far, ± 1 error")
    axes.set_xlabel("step")
    axes.set_ylabel("uniformity (%)")
    axes.set_xlim(0.5, max(len(x), 1) + 0.5)
    axes.grid(alpha=0.25)
    axes.legend(loc="lower right", ncols=3)
    epsilon = arrays["walk_epsilon"]
    if np.isfinite(epsilon).any() and np.nanmax(epsilon) > 0.0:
        beside = axes.twinx()
        beside.plot(x, epsilon, color=GREEN, linewidth=1.0, linestyle="--", rasterized=pixels)
        beside.set_ylim(0.0, 1.02)
        beside.set_ylabel("epsilon, share of random moves (dashed)", color=GREEN)
        beside.spines["right"].set_visible(True)


def _episodes(axes: Axes, arrays: Arrays) -> None:
    x = arrays["episode_number"] + 1.0
    pixels = 2 * len(x) > PIXELS_FROM
    mean, error = 100.0 * arrays["episode_mean"], 100.0 * arrays["episode_mean_error"]
    axes.fill_between(x, mean - error, mean + error, color=ORANGE, alpha=0.3, linewidth=0.0)
    axes.plot(x, mean, "o-", color=ORANGE, markersize=2.5, linewidth=1.2, rasterized=pixels,
              label="mean of an episode, ± 1 error")  # fmt: skip
    best, of_best = 100.0 * arrays["episode_best"], 100.0 * arrays["episode_best_error"]
    axes.errorbar(x, best, of_best, fmt=".", color=BLUE, elinewidth=0.8, markersize=4.0, rasterized=pixels,
                  label="best of an episode, ± 1 error")  # fmt: skip
    axes.set_xlabel("episode")
    axes.set_ylabel("uniformity (%)")
    axes.grid(alpha=0.25)
    axes.legend(loc="lower right", ncols=2)


def _map(figure: Figure, axes: Axes, shown: Document, lx: NDArray[Any], ends: tuple[float, float]) -> None:
    """False colours, row 0 at the lowest y; the line of Eq. 8 across it."""
    extent = (*shown["map"]["x_um"], *shown["map"]["y_um"])
    image = axes.imshow(
        lx, origin="lower", extent=extent, cmap="inferno", interpolation="none", vmin=ends[0], vmax=ends[1]
    )
    figure.colorbar(image, ax=axes, label="illuminance (lx)", format="{x:,.0f}")
    axes.axhline(shown["cut"]["y_um"], color="white", linewidth=0.8, linestyle="--")
    axes.set_xlabel("x (µm)")
    axes.set_ylabel("y (µm)")


def _cut(axes: Axes, shown: Document, arrays: Arrays, name: str, colour: str, label: str) -> None:
    x_um, lx, error = (arrays[f"{name}_cut_{part}"] for part in ("x_um", "lx", "error_lx"))
    axes.fill_between(
        x_um, lx - error, lx + error, color=colour, alpha=0.3, linewidth=0.0, label=label or "± 1 error"
    )
    axes.plot(x_um, lx, color=colour, linewidth=1.4)
    axes.set_xlim(x_um[0], x_um[-1])
    axes.margins(y=0.25)
    axes.yaxis.set_major_formatter("{x:,.0f}")
    axes.set_xlabel(f"x (µm) at y = {shown['cut']['y_um']:g} µm")
    axes.set_ylabel("illuminance (lx)")


def _window(axes: Axes, shown: Document) -> None:
    axes.axvspan(*shown["cut"]["window_um"], color=SHADE, zorder=0, label="window of Eq. 8")


def _marked(axes: Axes, rows: list[Any], mark: str, colour: str, label: str) -> None:
    lit = [row for row in rows if row["mean_illuminance_lx"]]
    if lit:
        (x, x_error), (y, y_error) = _of(lit, "mean_illuminance_lx"), _of(lit, "uniformity")
        axes.errorbar(x, 100.0 * y, 100.0 * y_error, x_error, fmt=mark, color=colour, markersize=5.0, label=label)


def _of(rows: list[Any], name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values and errors of one figure of several rows."""
    value, error = (np.array([row[name][key] for row in rows]) for key in ("value", "standard_error"))
    return value, error


def _at_changes(x: NDArray[Any], best: NDArray[Any], error: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """The same where the best changes, and at the end: a curve of steps needs no more."""
    changes = np.flatnonzero(np.diff(best, prepend=np.nan) != 0.0)
    kept = np.append(changes, len(best) - 1) if len(best) else changes
    return x[kept], best[kept], error[kept]
