"""The arrays of a campaign's report: learning curve, episodes, Pareto, the line of Eq. 8."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.recorded import Told, distinct, has_episodes

Real = NDArray[np.float64]
Arrays = dict[str, NDArray[np.bool_ | np.int64 | np.float64]]


def walk_arrays(walk: Sequence[Told]) -> Arrays:
    """The learning curve: one value per step of the walk."""
    value = np.array([told.step.uniformity for told in walk], dtype=np.float64)
    error = np.array([told.step.uniformity_error for told in walk], dtype=np.float64)
    counts = np.array([told.evaluated for told in walk], dtype=np.bool_)
    best = np.full(len(walk), -1, dtype=np.int64)
    for i in np.flatnonzero(counts):
        best[i:] = i if best[i] < 0 or value[i] > value[best[i]] else best[i]
    known = best >= 0
    new = {id(told) for told in distinct(walk)}
    return {
        "walk_uniformity": value,
        "walk_error": error,
        "walk_evaluated": counts,
        "walk_infeasible": np.array([not told.step.feasible for told in walk], dtype=np.bool_),
        "walk_best": np.where(known, value[best] if len(walk) else value, np.nan),
        "walk_best_error": np.where(known, error[best] if len(walk) else error, np.nan),
        "walk_evaluations": np.cumsum([id(told) in new for told in walk], dtype=np.int64),
        "walk_epsilon": np.array([told.agent.epsilon if told.agent else np.nan for told in walk], dtype=np.float64),
    }


def episode_arrays(walk: Sequence[Told]) -> Arrays:
    """Mean and best uniformity of each episode, as Fig. 6 counts its iterations; empty where there are no episodes.

    Notes
    -----
    `episode_mean_error` is the mean error of its evaluations: a walk's designs share their random numbers, so the
    noise of neighbours is nearly the same and does not average out.
    """
    by_episode: dict[int, list[Told]] = {}
    for told in walk if has_episodes(walk) else ():
        if told.agent is not None and told.evaluated:
            by_episode.setdefault(told.agent.episode, []).append(told)
    rows = []
    for number, of_it in sorted(by_episode.items()):
        value = np.array([told.step.uniformity for told in of_it])
        error = np.array([told.step.uniformity_error for told in of_it])
        rows.append((number, value.mean(), error.mean(), value.max(), error[value.argmax()]))
    names = ("episode_number", "episode_mean", "episode_mean_error", "episode_best", "episode_best_error")
    return dict(zip(names, np.array(rows, dtype=np.float64).reshape(-1, len(names)).T, strict=True))


def pareto_arrays(designs: Sequence[Told]) -> Arrays:
    """All designs of the walk by uniformity and mean illuminance; `pareto_front`: no other beats it in both.

    Notes
    -----
    The front is that of the values as they were found: a design within its errors of the front may belong to it.
    """
    lit = [told for told in designs if told.step.figures.get("mean_illuminance_lx")]
    light = [told.step.figures["mean_illuminance_lx"] for told in lit]
    lx = np.array([one["value"] for one in light], dtype=np.float64)
    uniformity = np.array([told.step.uniformity for told in lit], dtype=np.float64)
    return {
        "pareto_lx": lx,
        "pareto_lx_error": np.array([one["standard_error"] for one in light], dtype=np.float64),
        "pareto_uniformity": uniformity,
        "pareto_error": np.array([told.step.uniformity_error for told in lit], dtype=np.float64),
        "pareto_pairs": np.array([told.step.design.dbr_pairs for told in lit], dtype=np.float64),
        "pareto_f": np.array([told.step.design.f for told in lit], dtype=np.float64),
        "pareto_front": front_of(lx, uniformity),
    }


def front_of(x: Real, y: Real) -> NDArray[np.bool_]:
    """Which points (point,) no other point is above in one of x, y and not below in the other."""
    front = np.zeros(len(x), dtype=np.bool_)
    highest = -np.inf
    for i in np.lexsort((-y, -x)):  # from the largest x on, of equal x the highest first
        front[i] = y[i] > highest
        highest = max(highest, y[i])
    return front


def line_of(
    map_lx: NDArray[np.float64], half_um: float, x_um: NDArray[np.float64], y_um: float
) -> NDArray[np.float64]:
    """Illuminance along the line at `y_um`, shape of `x_um`, of a map (y, x) of one cell of an endless array.

    Parameters
    ----------
    map_lx : values at the centres of equal squares of the cell |x|, |y| <= `half_um`, row 0 at the lowest y, lx.
    x_um : where, um; beyond the cell it repeats itself.

    Notes
    -----
    The field is a sum of the cell's cosine modes. Of up to (points - 1) / 2 of them the trigonometric interpolation
    D(t) = (1 + 2 sum cos(2 pi k t / P) + cos(pi n t / P)) / n is exact: 1e-7 of the worker's own line.
    """
    rows, columns = map_lx.shape
    at_y = map_lx.T @ _between(rows, half_um, np.array([y_um]))[0]
    return np.asarray(_between(columns, half_um, x_um) @ at_y)


def _between(count: int, half_um: float, at_um: Real) -> Real:
    """Weights (at, point) of `count` equal steps' centres over a period of 2 `half_um`."""
    points_um = ((np.arange(count) + 0.5) * 2.0 / count - 1.0) * half_um
    t = (at_um[:, None] - points_um) / (2.0 * half_um)
    k = np.arange(1, (count - 1) // 2 + 1)
    weights = 1.0 + 2.0 * np.cos(2.0 * np.pi * t[..., None] * k).sum(axis=-1)
    if count % 2 == 0:
        weights += np.cos(np.pi * count * t)
    return np.asarray(weights / count)
