"""How strongly something hidden shows: the length of its whitened image that a perfect fit could not take away.

    d = whitened (signals with it - signals without), binned as data are compared
    sigma^2 = d'(1 - QQ')d      Q: what gains, offsets, poses and the calibrated parameters can imitate, with priors

Q and the whitening are the project's own, about the truth itself: a fit of the twin would stop elsewhere, where the
twin errs. The light is traced in two halves with random numbers of their own. Each gives a d, and d1'(1 - QQ')d2 is
right on average, where d'd would count the noise of the Monte Carlo as strength.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectSpec
from validation import blind
from validation.blind_test.truths import Truth
from validation.dataset.images import binned_mean
from validation.diagnose.columns import FitSight, candidates_of
from validation.diagnose.groups import joined
from validation.diagnose.score import Projected
from validation.effects.known import Known
from validation.fit import Fit, unknowns_of
from validation.fit.descent import linearised
from validation.fit.parameters import free_paths
from validation.fit.problem import Problem
from validation.fit.result import conclude
from validation.fit.start import start_values
from validation.measured import MeasuredImage
from validation.prediction import Anchored, Predictor

Real = NDArray[np.float64]
Halves = tuple[Real, Real]
"""Whitened rows (row,) of a change, of each half of the light, with what a fit takes away taken out."""

TOLERANCE = 0.1
"""Share of the asked strength by which a set may miss it."""
CLOSE = 0.03
"""Nearer need not be looked for."""
MOST_EVALUATIONS = 6
STEEPEST, FLATTEST = 4.0, 0.5
"""Power of the amount that a strength is taken to grow with."""
LEAST_SIGMA = 5.0
"""A weaker thing is not seen by a test at 1 % among thirty effects and their shapes in one case of two."""
NEGLIGIBLE = 1e-9


class NotReached(Exception):  # noqa: N818  # it is no error: another kind is taken
    """A kind that does not show as strongly as was asked, with the strength that it has at most."""

    def __init__(self, kind: str, sigma: float) -> None:
        self.kind, self.sigma = kind, sigma
        super().__init__(f"{kind} shows by {sigma:.1f} sigma at most")


class NoAmount(Exception):  # noqa: N818  # it is no error: another kind is taken
    """A kind that is strong enough at its most, but shows as strongly as was asked by no amount that was tried."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        super().__init__(f"{kind}: no amount near the asked strength was found")


@dataclass(frozen=True, eq=False)
class Ruler:
    """A perfect fit of images with nothing hidden: it measures what hidden things change."""

    fit: Fit
    binning: int

    @classmethod
    def at(cls, truth: Truth, images: Sequence[MeasuredImage], predictor: Predictor) -> Ruler:
        """About a truth, from its plain images without noise."""
        anchor = Anchored(truth.model, 0)
        unknowns = unknowns_of(truth.model, free_paths(truth.model), images)
        problem = Problem(truth.model, unknowns, tuple(images), predictor, anchor=anchor)
        given = {}
        for image, pose in zip(images, truth.poses, strict=True):
            shot = image.shot.id
            given[f"{shot}.shift_row_px"] = pose.shift_row_px / image.binning
            given[f"{shot}.shift_column_px"] = pose.shift_column_px / image.binning
            given[f"{shot}.rotation_deg"] = pose.rotation_deg
        evaluation = problem.evaluate(start_values(problem, given))
        white, reduced, columns = linearised(evaluation)
        found = conclude(evaluation, white, reduced, columns, reduced.step(), 0, False)
        return cls(replace(found, active=~reduced.blind), images[0].binning)

    def left(self, change_dn: Sequence[Real]) -> Real:
        """Whitened rows (row,) of a change of all images (row, column) in DN, as far as no fit takes it away."""
        rows = self.fit.whitening.rows([binned_mean(image, self.binning) for image in change_dn])
        return np.asarray(self.fit.basis.left(rows[None])[0])

    def rivals(self, predictor: Predictor, known: Known, effects: Sequence[EffectSpec]) -> Projected:
        """The columns of all effects of the catalogue here, each in all of its shapes."""
        sight = FitSight.of(self.fit, predictor, known.beyond_twin)
        return Projected.of(joined(candidates_of(self.fit, effects, sight, refused={})), self.fit.basis)


def sigma_of(halves: Halves) -> float:
    """The length of a change, the noise of its light left out; 0 where there is nothing but noise."""
    return float(np.sqrt(max(float(halves[0] @ halves[1]), 0.0)))


def sigma_beside(halves: Halves, rivals: Projected) -> dict[str, float]:
    """What is left of a change once each effect has taken what it can, in the shape in which it takes most."""
    whole, taken = float(halves[0] @ halves[1]), dict[str, float]()
    for one, part in zip(rivals.candidates, rivals.slices(), strict=True):
        first, second = (rivals.columns[part] @ half for half in halves)
        size, axes = np.linalg.eigh(rivals.gram[part, part])
        some = size > NEGLIGIBLE * size.max()
        share = float(np.sum((axes.T @ first)[some] * (axes.T @ second)[some] / size[some]))
        taken[one.effect.name] = max(taken.get(one.effect.name, 0.0), share)
    return {name: float(np.sqrt(max(whole - share, 0.0))) for name, share in taken.items()}


def amount_for(kind: blind.Kind, asked: float, measure: Callable[[float], float]) -> float:
    """The amount at which a kind shows by `asked` sigma; a discrete one is there or not.

    Parameters
    ----------
    measure : the strength at an amount; it is asked a few times, at `kind.most` first.

    Raises
    ------
    NotReached : it is weaker at its most.
    NoAmount : no amount near enough was found.
    """
    at_most = measure(kind.most)
    if at_most < (1.0 - TOLERANCE) * asked:
        raise NotReached(kind.name, at_most)
    if kind.discrete:
        return kind.most
    share, points = asked / at_most, [(1.0, at_most)]
    for _ in range(MOST_EVALUATIONS):
        share = min(share, 1.0)
        sigma = max(measure(kind.off + share * (kind.most - kind.off)), NEGLIGIBLE)
        points.append((share, sigma))
        if abs(sigma / asked - 1.0) < CLOSE or share == 1.0 == points[-2][0]:
            break
        power = np.clip(_power(points), FLATTEST, STEEPEST)
        share *= float((asked / sigma) ** (1.0 / power))
    best, sigma = min(points, key=lambda point: abs(np.log(point[1] / asked)))
    if abs(sigma / asked - 1.0) > TOLERANCE:
        raise NoAmount(kind.name)
    return kind.off + best * (kind.most - kind.off)


def _power(points: Sequence[tuple[float, float]]) -> float:
    """Of the amount, that the strength grows with between the last two points."""
    (one, before), (two, after) = points[-2:]
    return float(np.log(after / before) / np.log(two / one)) if one != two else 1.0
