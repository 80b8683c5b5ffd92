"""The linear step of a fit: whitened columns, priors as rows, limits, and what the data say about each parameter.

Nothing here knows an image. Columns are held as (parameter, row), scaled to unit length and reduced by Householder
transformations, so no digits are lost to normal equations; all that follows works on the small triangle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

Real = NDArray[np.float64]
Mask = NDArray[np.bool_]

WORST_CONDITION = 1e8  # of the scaled columns; beyond it two parameters are the same to the data


@dataclass(frozen=True)
class Parameter:
    """One number that a fit may move."""

    name: str
    lower: float = -np.inf
    upper: float = np.inf
    prior_mean: float = 0.0
    prior_sd: float = np.inf  # inf: no prior
    longest_step: float = np.inf  # in one iteration: a pose that jumps out of the image never comes back


@dataclass(frozen=True, eq=False)
class Step:
    """Where the linear model has its least chi2 within the limits."""

    change: Real
    chi2: float  # expected there, priors included
    at_limit: Mask


@dataclass(frozen=True, eq=False)
class Reduced:
    """A linear least squares problem brought down to a triangle: |residual - columns' change|^2 + priors."""

    parameters: tuple[Parameter, ...]
    values: Real
    length: Real  # of each column; 1 where the data say nothing
    triangle: Real  # of the scaled data columns
    along: Real  # the residual along them
    chi2_data: float  # at no change
    chi2_prior: float

    @property
    def chi2(self) -> float:
        """At no change, priors included."""
        return self.chi2_data + self.chi2_prior

    @cached_property
    def prior_weight(self) -> Real:
        """1 / sd of each prior, 0 where there is none."""
        return 1.0 / np.array([parameter.prior_sd for parameter in self.parameters])

    @cached_property
    def blind(self) -> Mask:
        """Parameters that neither the data nor a prior hold."""
        return np.asarray((np.abs(self.triangle).sum(axis=0) < 1e-12) & (self.prior_weight == 0.0))

    def step(
        self, damping: float = 0.0, fixed: Mask | None = None, short: bool = False, bounded: bool = True
    ) -> Step:
        """The best change within the limits; `damping` as of Levenberg and Marquardt, `fixed` parameters stay."""
        free = ~self.blind if fixed is None else ~self.blind & ~fixed
        matrix, target = self._rows(free, damping)
        lower, upper = self._room(free, short) if bounded else np.full((2, int(free.sum())), [[-np.inf], [np.inf]])
        scale = self.length[free]
        scaled = _bounded(matrix, target, lower * scale, upper * scale)
        change = np.zeros(len(self.parameters))
        change[free] = np.clip(scaled / scale, lower, upper)
        return Step(change, self.chi2_after(change), self.at_limit(change) & (free if fixed is None else ~fixed))

    @property
    def gap(self) -> float:
        """What the best step is expected to take off chi2: the square of what columns and priors still find."""
        return max(0.0, self.chi2 - self.step().chi2)

    def beyond(self, index: int) -> float:
        """What the best step would take off chi2 besides, could this parameter leave its range."""
        one = replace(self.parameters[index], lower=-np.inf, upper=np.inf)
        released = replace(self, parameters=(*self.parameters[:index], one, *self.parameters[index + 1 :]))
        return max(0.0, self.step().chi2 - released.step().chi2)

    def chi2_after(self, change: Real) -> float:
        """What the linear model expects after a change, priors included."""
        moved = self.along - self.triangle @ (change * self.length)
        rest = self.chi2_data - float(self.along @ self.along)
        return rest + float(moved @ moved) + self._prior_chi2(change)

    def covariance(self, variance_scale: float = 1.0, active: Mask | None = None) -> Real:
        """Covariance of the parameters; rows of those held at a limit or seen by nothing are zero or infinite."""
        free = ~self.blind if active is None else active & ~self.blind
        rows = np.vstack([self.triangle[:, free] / np.sqrt(variance_scale), np.diag(self._prior_scaled)[:, free]])
        inverse = np.linalg.pinv(rows, rcond=1e-13)
        small = inverse @ inverse.T / np.outer(self.length[free], self.length[free])
        full = np.zeros((len(free), len(free)))
        full[np.ix_(free, free)] = small
        full[self.blind, self.blind] = np.inf
        return full

    def covariance_of(self, columns: Real, other: Real, variance_scale: float, active: Mask) -> Real:
        """Covariance of what solves columns' residual + priors = 0 where the columns have noise of their own.

        `other`: the same columns (parameter, row) with noise that is independent: only their product with `columns`
        is on average that of the true ones, and (a b')^-1 (a a') (b a')^-1 is how far noise moves the solution.
        """
        keep = active & ~self.blind
        length = self.length[keep]
        a, b = (some[keep] / length[:, None] / np.sqrt(variance_scale) for some in (columns, other))
        prior = np.diag(self._prior_scaled[keep] ** 2)
        inverse = np.linalg.pinv(a @ b.T + prior)
        full = np.zeros((len(keep), len(keep)))
        full[np.ix_(keep, keep)] = inverse @ (a @ a.T + prior) @ inverse.T / np.outer(length, length)
        full[self.blind, self.blind] = np.inf
        return full

    def crossed_step(self, columns: Real, other: Real, residual: Real, active: Mask) -> Real:
        """The change that solves columns' residual + priors = 0, by columns whose noise is independent of theirs.

        In columns' own product the square of their noise stands beside the signal's, and a step by it falls short.
        """
        keep = active & ~self.blind
        length = self.length[keep]
        a, b = (some[keep] / length[:, None] for some in (columns, other))
        weight = self._prior_scaled[keep]
        pull = np.array([p.prior_mean for p in self.parameters]) - self.values
        target = a @ residual + weight * (self.prior_weight * pull)[keep]
        change = np.zeros(len(keep))
        change[keep] = np.linalg.pinv(a @ b.T + np.diag(weight**2)) @ target / length
        return change

    def condition(self, active: Mask) -> float:
        """Condition of the scaled columns and priors: large where two parameters are the same to the data."""
        matrix, _ = self._rows(active & ~self.blind, 0.0)
        return float(np.linalg.cond(matrix)) if matrix.size else 1.0

    @property
    def _prior_scaled(self) -> Real:
        return np.asarray(self.prior_weight / self.length)

    def _rows(self, free: Mask, damping: float) -> tuple[Real, Real]:
        pull = [(p.prior_mean - value) for p, value in zip(self.parameters, self.values, strict=True)]
        blocks = [self.triangle[:, free], np.diag(self._prior_scaled)[:, free]]
        targets = [self.along, np.array(pull) * self.prior_weight]
        if damping > 0.0:
            blocks.append(np.sqrt(damping) * np.eye(int(free.sum())))
            targets.append(np.zeros(int(free.sum())))
        return np.vstack(blocks), np.concatenate(targets)

    def _room(self, free: Mask, short: bool) -> tuple[Real, Real]:
        """How far each free parameter may go down and up, never the wrong way."""
        lower = np.array([p.lower for p in self.parameters]) - self.values
        upper = np.array([p.upper for p in self.parameters]) - self.values
        if short:
            longest = np.array([p.longest_step for p in self.parameters])
            lower, upper = np.maximum(lower, -longest), np.minimum(upper, longest)
        return np.minimum(lower, 0.0)[free], np.maximum(upper, 0.0)[free]

    def at_limit(self, change: Real) -> Mask:
        """Which parameters a change brings to a limit, or leaves there."""
        value = self.values + change
        lower = np.array([p.lower for p in self.parameters])
        upper = np.array([p.upper for p in self.parameters])
        near = 1e-9 * np.where(np.isfinite(upper - lower), upper - lower, 1.0)
        return np.asarray((value <= lower + near) | (value >= upper - near))

    def _prior_chi2(self, change: Real) -> float:
        return prior_chi2(self.parameters, self.values + change)


def reduce(columns: Real, residual: Real, parameters: tuple[Parameter, ...], values: Real) -> Reduced:
    """The triangle of whitened columns (parameter, row) and residual (row) at the parameters' present values."""
    count = len(parameters)
    length = np.sqrt(np.einsum("ij,ij->i", columns, columns))
    length = np.where(length > 1e-150, length, 1.0)
    with_residual = np.vstack([columns / length[:, None], residual])
    triangle = _triangle(with_residual.T)
    if len(triangle) <= count:  # fewer rows than parameters
        triangle = np.vstack([triangle, np.zeros((count + 1 - len(triangle), count + 1))])
    return Reduced(
        parameters,
        values,
        length,
        triangle[:count, :count],
        triangle[:count, count],
        float(residual @ residual),
        prior_chi2(parameters, values),
    )


def prior_chi2(parameters: tuple[Parameter, ...], values: Real) -> float:
    """What the priors charge for these values."""
    pulls = [(value - p.prior_mean) / p.prior_sd for p, value in zip(parameters, values, strict=True)]
    return float(np.sum(np.square(pulls)))


@dataclass(frozen=True, eq=False)
class Basis:
    """What a linear fit takes out of white noise: orthonormal columns over data rows and over prior rows.

    A residual of the fit is y - data (data' y + prior' u), with y the whitened data and u the errors of the priors,
    all of unit variance: its covariance is I - data data'.
    """

    data: Real  # (row, parameter)
    prior: Real  # (prior, parameter); only rows of parameters that have a prior

    @property
    def taken(self) -> float:
        """Degrees of freedom that the fit takes from the data."""
        return float(np.sum(self.data**2))

    @property
    def freedom(self) -> float:
        """Degrees of freedom left in the data."""
        return len(self.data) - self.taken

    def residual(self, rows: Real) -> Real:
        """What the fit leaves of whitened data rows (row,) in these rows."""
        return np.asarray(rows - self.data @ (self.data.T @ rows))

    def left(self, columns: Real) -> Real:
        """What the fit leaves of whitened columns (column, row): over data rows, then over prior rows.

        What its parameters take of a column their priors pay for: a column's length is root(c' (I - data data') c).
        Of the data rows alone it is less, and a test by these misses what has gone into the priors.
        """
        along = columns @ self.data
        return np.concatenate([columns - along @ self.data.T, -along @ self.prior.T], axis=1)


def basis(columns: Real, reduced: Reduced, active: Mask) -> Basis:
    """The basis of the active columns (neither at a limit nor blind) with their priors."""
    keep = active & ~reduced.blind
    weight = (reduced.prior_weight / reduced.length)[keep]
    with_prior = weight > 0.0
    scaled = (columns[keep] / reduced.length[keep][:, None]).T
    rows = np.vstack([scaled, np.diag(weight)[with_prior]])
    if not keep.any():
        return Basis(rows[: len(scaled)], rows[len(scaled) :])
    triangle = _triangle(np.vstack([reduced.triangle[:, keep], np.diag(weight)]))
    size = np.abs(np.diag(triangle))
    if size.min() > size.max() / WORST_CONDITION:
        orthogonal = solve_triangular(triangle, rows.T, trans="T").T
    else:  # nearly the same column twice: keep the directions that are there
        left, singular, _ = np.linalg.svd(rows, full_matrices=False)
        orthogonal = left[:, singular > singular[0] / WORST_CONDITION]
    return Basis(orthogonal[: len(scaled)], orthogonal[len(scaled) :])


def _triangle(matrix: Real) -> Real:
    """R of the QR decomposition."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def _bounded(matrix: Real, target: Real, lower: Real, upper: Real) -> Real:
    """Linear least squares within limits; limits that leave no room hold the parameter."""
    held = upper - lower <= 0.0
    answer = np.zeros(matrix.shape[1])
    if held.all():
        return answer
    found = lsq_linear(matrix[:, ~held], target, (lower[~held], upper[~held]), method="bvls")
    answer[~held] = found.x
    return answer
