"""Level 2, the physics' part: the figures of a step once more, from the map and the cut line on record.

A cell's field is a sum of cosines, so its map of equal squares holds it whole: between its points it is interpolated
by trigonometric functions, exactly but for float32 and for modes finer than the map; its own finest bound these.

    figure                       from       holds to
    uniformity (Eq. 8)           cut line   1e-9: the same points of the same field; the logged bias is put back
    uniformity, hot-spot ratio   map        2e-6, relative above 1, and the bound on finer modes
    mean illuminance             map        1e-6 of it, and the same bound
    optical efficiency           ledger     exact: the same sums

A receiver next to the chips shows finer modes than a map of 64 points holds: of such a map nothing is compared.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.uniformity import CUT_POINTS
from luxloop.audit import Compared, Place
from luxloop.campaign import Step
from luxloop.journal.reader import RunJournal

Real = NDArray[np.float64]

OF_LINE, OF_MAP, OF_MEAN = 1e-9, 2e-6, 1e-6
FINEST = 0.75
"""Modes above this share of the finest that a map holds tell how much lies beyond it."""
RESOLVED = 1e-3
"""Of the mean: a map whose own finest modes have more than this does not fall off, and bounds nothing."""
ROUNDING = "rounding of the line"
CLIPPED = "noise left it below 0 or above 1, where it was cut off"
NAMES = {"uniformity": "uniformity", "hot_spot_ratio": "hot-spot ratio"}
MAP = "float32 of the map, and modes finer than it"


def re_derive(journal: RunJournal, say: Callable[[Compared], None], *, same_machine: bool) -> None:  # noqa: ARG001  # bits count on any machine
    """Compares uniformity, mean illuminance, hot-spot ratio and efficiency of every step that left arrays."""
    maps: dict[int, Real] = {}
    received: dict[str, Any] = {}
    for entry in journal.records("/map/sim", "/reply/ray", "/step"):
        if entry.topic == "/map/sim":
            maps = {entry.sequence: np.asarray(entry.value, np.float64)}  # it lies right before its step
        elif entry.topic == "/reply/ray":
            ledger = (entry.value.result or {}).get("ledger", {})
            received[entry.value.task_id] = ledger.get("receiver")
        elif entry.value.failure is None and entry.value.feasible:
            step = entry.value
            if step.cached and step.task_id not in received:  # it left nothing, its figures are another step's
                continue
            at = Place.of(say, entry.sequence, step)
            of_step = received.pop(step.task_id or "", None)
            if of_step is not None:
                _efficiency(step, of_step, at)
            if step.cut is not None:
                _cut(step, at)
            _map(step, maps.get(entry.sequence), at)


def _efficiency(step: Step, received: dict[str, float], at: Place) -> None:
    told = step.figures.get("optical_efficiency")
    if told is not None:
        then, now = ((one["value"], one["standard_error"]) for one in (told, received))
        at.exact("efficiency, ledger", then, now)


def _cut(step: Step, at: Place) -> None:
    assert step.cut is not None  # noqa: S101  # the caller looked
    line, plain = np.array(step.cut.illuminance_lx), plain_ratio(step, "uniformity")
    if plain is None or line.size != CUT_POINTS:
        at.nothing("uniformity, cut", CLIPPED if plain is None else "another cut line")
    else:
        at.near("uniformity, cut", plain, float(line.min() / line.max()), OF_LINE, ROUNDING)


def _map(step: Step, map_lx: Real | None, at: Place) -> None:
    if map_lx is None:
        at.nothing("uniformity, map", "no map on record")
        return
    more = beyond(map_lx)
    if more > RESOLVED:
        at.nothing("figures, map", "its light has modes finer than its map")
        return
    line = between(map_lx, np.linspace(-0.5, 0.5, CUT_POINTS), np.zeros(1))[0]
    spot = between(map_lx, np.array([0.0, -0.5]), np.array([0.0, -0.5]))
    _ratio(step, "uniformity", float(line.min() / line.max()), OF_MAP + more, at)
    _ratio(step, "hot_spot_ratio", float(spot[0, 0] / spot[1, 1]), OF_MAP + more, at)
    mean = step.figures.get("mean_illuminance_lx")
    if mean is not None:
        at.near("mean illuminance, map", mean["value"], float(map_lx.mean()), (OF_MEAN + more) * mean["value"], MAP)


def _ratio(step: Step, name: str, now: float, tolerance: float, at: Place) -> None:
    """Compare a ratio of two places of the map."""
    what, logged = f"{NAMES[name]}, map", plain_ratio(step, name)
    if logged is None:
        at.nothing(what, "not told" if name not in step.figures else CLIPPED)
    else:
        at.near(what, logged, now, tolerance * max(1.0, logged), MAP)


def plain_ratio(step: Step, name: str) -> float | None:
    """A step's ratio with the bias put back that was taken off, as the mean field has it; None where that is lost."""
    told = step.figures.get(name)
    if told is None or (name == "uniformity" and not 0.0 < told["value"] < 1.0):
        return None
    return float(told["value"] + told.get("bias", 0.0))


def between(map_yx: Real, x: Real, y: Real) -> Real:
    """Values (y, x) of a periodic map between its points, at shares -1/2 to 1/2 of its width.

    Parameters
    ----------
    map_yx : (row, column) at the centres of equal squares.

    Notes
    -----
    Trigonometric interpolation: a row of n points holds the modes up to (n - 1) / 2, and those it holds exactly.
    """
    rows, columns = map_yx.shape
    return _weights(y, rows) @ map_yx @ _weights(x, columns).T


def beyond(map_yx: Real) -> float:
    """How much modes finer than the map may add, relative to its mean: as much as its own finest have together."""
    amplitude = np.abs(np.fft.fft2(map_yx)) / map_yx.size
    mode = [np.abs(np.fft.fftfreq(count) * 2.0) for count in map_yx.shape]
    fine = np.maximum.outer(mode[0], mode[1]) > FINEST
    return float(amplitude[fine].sum() / amplitude[0, 0])


def _weights(at: Real, count: int) -> Real:
    """Weights (at, point) of the points of one period."""
    points = (np.arange(count) + 0.5) / count - 0.5
    turns = 2.0 * np.pi * (at[:, None] - points)
    modes = np.arange(1, (count - 1) // 2 + 1)
    total = 1.0 + 2.0 * np.cos(turns[..., None] * modes).sum(axis=-1)
    if count % 2 == 0:
        total += np.cos(turns * count / 2)
    return np.asarray(total / count)
