"""Far fields of modules, by Monte Carlo at the ray-tracing worker."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from luxloop.errors import InputError
from luxloop.ray import RayRequest
from luxloop.words import sha256_of
from validation.prediction.differences import moved_models
from validation.prediction.images import FilmOf, module_of
from validation.prediction.words import FarView, PredictedCurve, Real

if TYPE_CHECKING:
    from luxloop.client import Answer
    from luxloop.model import Model
    from validation.dataset.manifest import Sample

Ask = Callable[[Sequence[RayRequest]], "list[Answer]"]

HISTORIES = 4_000_000


@dataclass(frozen=True)
class Wanted:
    """What is to be predicted of far fields at a model."""

    model: Model
    paths: tuple[str, ...]
    histories: int
    seed: int
    film_of: FilmOf


def predict(wanted: Wanted, views: Sequence[FarView], ask: Ask) -> list[PredictedCurve]:
    """The far field of each view's module: the light on its first way to the receiver, 1/sr per flux of a chip.

    Interpolated between the middles of the worker's bins, equal in cos(theta) and phi; beyond the outer middles
    continued on a straight line.
    """
    for view in views:
        if np.any((view.theta_deg < 0.0) | (view.theta_deg > 90.0)):
            raise InputError("theta_deg", float(view.theta_deg.max()), "0 to 90, from the normal", "front side only")
    moves = [(path, *moved) for path in wanted.paths for moved in moved_models(wanted.model, path)]
    models = [wanted.model, *(moved for *_, moved in moves)]
    answers = iter(ask([_request(wanted, model, view) for view in views for model in models]))
    found = []
    for view in views:
        at = next(answers)
        columns = {path: np.zeros(len(view.theta_deg)) for path in wanted.paths}
        for path, weight, _ in moves:
            columns[path] += weight * _seen(next(answers), view, "far_module_per_sr")
        error = _seen(at, view, "far_module_error_per_sr")
        found.append(PredictedCurve(_seen(at, view, "far_module_per_sr"), columns, error))
    return found


def _request(wanted: Wanted, model: Model, view: FarView) -> RayRequest:
    return RayRequest(
        **module_of(model, view.sample, wanted.film_of),
        histories=wanted.histories,
        budget_s=86_400.0,
        seed=_seed_of(wanted.seed, view.sample),
        far_field=True,
    )


def _seed_of(seed: int, sample: Sample) -> str:
    """Another for each sample, so that no two share their noise; a sample keeps its own in another model."""
    return str(int(sha256_of({"seed": str(seed), "sample": sample.id})[:15], 16) % 10**18)


def _seen(answer: Answer, view: FarView, name: str) -> Real:
    """An array (cos theta, phi) of a far field, upper half, in the directions of a view."""
    nodes, values = _continued(np.asarray(answer.arrays[name], np.float64), is_error="_error_" in name)
    columns = values.shape[1]
    cosine = np.cos(np.radians(view.theta_deg))
    row = np.clip(np.searchsorted(nodes, cosine, side="right") - 1, 0, nodes.size - 2)
    up = (cosine - nodes[row]) / (nodes[row + 1] - nodes[row])
    column = (view.phi_deg % 360.0) / 360.0 * columns - 0.5
    across = np.floor(column).astype(int)
    share = column - across
    low, high = (
        (1.0 - share) * values[row + k, across % columns] + share * values[row + k, (across + 1) % columns]
        for k in (0, 1)
    )
    return np.asarray((1.0 - up) * low + up * high)


def _continued(bins: Real, *, is_error: bool) -> tuple[Real, Real]:
    """cos(theta) from the horizon to the normal, and what stands there (cos theta, phi): as the worker's far field.

    Half a row further on a straight line, not below 0; the normal has one value, the mean over phi. Errors there are
    those of the line's ends, as if every column erred alike.
    """
    rows = len(bins)
    nodes = np.concatenate([[0.0], (np.arange(rows) + 0.5) / rows, [1.0]])
    outer = [(0, 1), (-1, -2)]
    if is_error:
        bottom, top = (np.hypot(1.5 * bins[a], 0.5 * bins[b]) for a, b in outer)
    else:
        bottom, top = (np.maximum(1.5 * bins[a] - 0.5 * bins[b], 0.0) for a, b in outer)
        top = np.full_like(top, max(float((1.5 * bins[-1] - 0.5 * bins[-2]).mean()), 0.0))
    return nodes, np.vstack([bottom, bins, top])
