"""How far apart two effects would be, in standard deviations, if one more image were taken.

The columns of the fit are known on the rows that were measured; on the rows of an image that was not, they are
predicted, with gain, offset, place and turn of its own. sigma is the length of the first effect (at its found size)
after everything that is fitted, priors included, and the rival (at any size) have taken what they can: T-optimality.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

NEGLIGIBLE = 1e-10


@dataclass(frozen=True, eq=False)
class Rows:
    """Whitened columns on some rows: of the model's parameters, of nuisances, of effects by name at their sizes."""

    model: Real
    """(parameter, row)"""
    nuisances: Real
    """(nuisance, row)"""
    nuisance_sd: Real
    """(nuisance,) of their priors, inf without one."""
    effects: dict[str, Real]
    """(row,), the expected change of the prediction."""


def sigma_left(rows: Sequence[Rows], prior_sd: Real, effect: str, rivals: Sequence[str] = ()) -> float:
    """Length that is left of an effect on several sets of rows together.

    `prior_sd` : (parameter,) of the model's parameters, inf without a prior.
    """
    taken = [np.concatenate([one.model for one in rows], axis=1)]
    width = taken[0].shape[1]
    start = 0
    for one in rows:
        count = one.model.shape[1]
        part = np.zeros((len(one.nuisances), width))
        part[:, start : start + count] = one.nuisances
        taken.append(part)
        start += count
    taken += [np.concatenate([one.effects[rival] for one in rows])[None] for rival in rivals]
    target = np.concatenate([one.effects[effect] for one in rows])
    sd = np.concatenate([prior_sd, *(one.nuisance_sd for one in rows), np.full(len(rivals), np.inf)])
    return _left(np.concatenate(taken), 1.0 / sd, target)


def _left(columns: Real, prior_weight: Real, target: Real) -> float:
    length = np.sqrt(np.sum(columns**2, axis=1) + prior_weight**2)
    some = length > 0.0
    scaled, weight = columns[some] / length[some, None], prior_weight[some] / length[some]
    gram = scaled @ scaled.T + np.diag(weight**2)
    along = scaled @ target
    size, axes = np.linalg.eigh(gram)
    kept = size > NEGLIGIBLE * size.max()
    taken = (axes[:, kept].T @ along) ** 2 / size[kept]
    return float(np.sqrt(max(float(target @ target) - float(taken.sum()), 0.0)))
