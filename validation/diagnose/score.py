"""Score tests: what each effect would explain of a residual, before it is added.

An effect's column is the derivative of the prediction by its score variable a (the parameter, or its square, where
that has the slope at off), whitened; p is what the fit's own parameters leave of it, r the residual:

    size = p'r / p'p        error = 1 / |p|        z = p'r / |p|        chi2 drop = z^2

Where something only shapes the effect (a length, a corner), the column is taken at each value of a grid, and the
largest z counts, as it does of the numbers that samples may have each of their own. An effect on every chip of a
module is a group: no single size, but a spread of sizes, tested by the energy of all its columns, whose z is that of
a normal number as rare. Noise alone makes scores that are normal with the columns' own cosines, so the chance that
any effect scores as well is counted in draws from exactly that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr  # scipy.stats takes half a second to import

from luxloop.effect import EffectParameter, EffectSpec, Value
from validation.fit.least_squares import Basis
from validation.sample_values import Member

Real = NDArray[np.float64]

DRAWS = 10_000
SADDLES = np.geomspace(100.0, 1e-16, 2000)
"""1 - 2 t of the largest weight, t where the saddle lies: 1, at the mean, is none of them, for there it is 0 / 0."""
ROUNDED = 1e-12
"""Share of the largest eigenvalue below which another is rounding."""
VANISHED = 1e-9
"""Share of a column's square below which the fit's own parameters can do all that it does."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect's parameter at off, with the shape it is tried in, and its whitened columns (column, row).

    One column, or for a group one for each of its members.
    """

    effect: EffectSpec
    parameter: EffectParameter
    shape: tuple[tuple[str, Value], ...]
    columns: Real
    parts: tuple[Real, ...] = ()
    """Of a single column: the images in 1/mm^2 (row, column), then the curves, that it is whitened from."""
    is_switch: bool = False
    """Whether it is there or not: its column is the whole way from off to its shape, its size 1."""
    others: tuple[Candidate, ...] = ()
    """The effect's other numbers that act, in this shape: scored by themselves, and fitted together with it."""
    sample: str = ""
    """Whose own number it is, where each sample has one; "": all samples have one in common."""

    @property
    def is_group(self) -> bool:
        """Whether it is a spread of sizes."""
        return self.parameter.per_chip

    @property
    def sides(self) -> tuple[bool, bool]:
        """Whether sizes below and above off exist."""
        if self.is_switch:
            return False, True
        if self.parameter.score_variable == "square":
            return False, True
        low, off, high = self.parameter.lower, self.parameter.off, self.parameter.upper
        if low is None or high is None or not isinstance(off, float):
            return True, True
        return low < off, high > off

    @property
    def key(self) -> str:
        """Tells it from the same effect in another shape."""
        shape = ", ".join(f"{name} {value}" for name, value in self.shape)
        return self.path.removeprefix("effects.") + (f" ({shape})" if shape else "")

    @property
    def path(self) -> str:
        """Of its number in a model."""
        member = Member(self.sample, self.effect.name, self.parameter.name)
        return member.path if self.sample else member.limits_path

    @property
    def words(self) -> str:
        """Of its number, beside the effect's name."""
        return self.parameter.name + (f" of {self.sample}" if self.sample else "")

    def value(self, size: float) -> float:
        """The parameter at a size of its score variable; ValueError for a switch."""
        if self.is_switch:
            raise ValueError(f"{self.effect.name} is there or not")
        if self.parameter.score_variable == "square":
            return float(np.sqrt(max(size, 0.0)))
        off = self.parameter.off
        return size + (off if isinstance(off, float) else 0.0)

    def size(self, value: float) -> float:
        """The size of its score variable at a value of the parameter."""
        off = self.parameter.off if isinstance(self.parameter.off, float) else 0.0
        return value**2 if self.parameter.score_variable == "square" else value - off


@dataclass(frozen=True, eq=False)
class Score:
    """What a candidate's column finds in a residual."""

    candidate: Candidate
    z: float
    """Signed, of one column; of a group the normal equivalent of its energy."""
    size: float
    """Of the score variable; of a group its rms."""
    error: float
    left: float
    """Length of the column after the fit's parameters, over that before: 0 where they do the same."""

    @property
    def drop(self) -> float:
        """Of chi2, expected where the effect is added; 0 where it would have to be on a side that does not exist."""
        below, above = (False, True) if self.candidate.is_group else self.candidate.sides
        return self.z**2 if (above if self.z > 0.0 else below) else 0.0


@dataclass(frozen=True, eq=False)
class EffectScore:
    """An effect at its best shape."""

    best: Score
    """By a number that all samples have in common, wherever the data show one."""
    p: float
    """Chance that noise alone makes this effect score as well, over its shapes and samples."""
    shapes: int = 1
    """In how many it was scored, numbers of single samples among them."""
    apart: Score | None = None
    """The best number of one sample, of an effect that each may have its own of."""

    @property
    def largest(self) -> Score:
        """Of both, the one that its chance is of."""
        return self.best if self.apart is None or self.best.drop >= self.apart.drop else self.apart

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.best.candidate.effect.name


@dataclass(frozen=True, eq=False)
class Scores:
    """All effects, the one that would lower chi2 most first."""

    effects: tuple[EffectScore, ...]
    p: float
    """Chance that noise alone makes any of them score as well."""
    draws: int
    untestable: tuple[str, ...]
    """Effects whose columns are nothing beside what is fitted anyway, or nothing at all."""

    @property
    def tested(self) -> int:
        """How many effects had columns on these data."""
        return len(self.effects) + len(self.untestable)

    def of(self, name: str) -> EffectScore | None:
        """An effect's, None where it cannot be tested."""
        return next((one for one in self.effects if one.name == name), None)


@dataclass(frozen=True, eq=False)
class Projected:
    """The candidates whose columns the fit leaves, and what it leaves of them."""

    candidates: tuple[Candidate, ...]
    columns: Real
    """(column, row), of all candidates one after the other; data rows, then prior rows."""
    ends: tuple[int, ...]
    left: tuple[float, ...]
    untestable: tuple[str, ...]

    @classmethod
    def of(cls, candidates: Sequence[Candidate], projection: Basis) -> Projected:
        """Columns less what the fit's parameters can do."""
        kept, parts, left, seen = [], [], [], set()
        for one in candidates:
            part = projection.left(one.columns)
            before, after = float(np.sum(one.columns**2)), float(np.sum(part**2))
            if after > VANISHED * before > 0.0:
                kept.append(one)
                parts.append(part)
                left.append(float(np.sqrt(after / before)))
                seen.add(one.effect.name)
        names = dict.fromkeys(one.effect.name for one in candidates)
        rows = len(projection.data) + len(projection.prior)
        return cls(
            tuple(kept),
            np.concatenate(parts) if parts else np.zeros((0, rows)),
            tuple(np.cumsum([len(part) for part in parts]).tolist()),
            tuple(left),
            tuple(name for name in names if name not in seen),
        )

    def own(self, candidate: Candidate) -> Real:
        """The columns of a candidate; ValueError where it was not kept."""
        for one, part in zip(self.candidates, self.slices(), strict=True):
            if one is candidate:
                return self.columns[part]
        raise ValueError(f"{candidate.key} was not projected")

    def slices(self) -> list[slice]:
        """The columns of each candidate."""
        return [slice(start, end) for start, end in zip((0, *self.ends), self.ends, strict=False)]

    @cached_property
    def gram(self) -> Real:
        """Products of all columns."""
        return self.columns @ self.columns.T


def scores(projected: Projected, residual: Real, scale: float = 1.0, draws: int = DRAWS, seed: int = 1) -> Scores:
    """The score test of all candidates.

    Parameters
    ----------
    residual : what a fit leaves, of data and of priors (`Fit.residual_with_priors`). scale : of all variances, as the
        fit found it.
    """
    products = projected.columns @ residual / np.sqrt(scale)
    found = [
        _score(one, products[part], projected.gram[part, part], left, np.sqrt(scale))
        for one, part, left in zip(projected.candidates, projected.slices(), projected.left, strict=True)
    ]
    drawn = _null(projected, draws, seed)  # (candidate, draw), chi2 drops of one degree of freedom
    names = list(dict.fromkeys(one.effect.name for one in projected.candidates))
    effects, normal = [], np.zeros((len(names), draws))
    for number, name in enumerate(names):
        rows = [k for k, one in enumerate(projected.candidates) if one.effect.name == name]
        of_all, of_one = ([found[k] for k in rows if bool(found[k].candidate.sample) is own] for own in (False, True))
        best = max(of_all or of_one, key=lambda score: score.drop)
        largest = drawn[rows].max(axis=0)
        one = EffectScore(best, 1.0, len(rows), max(of_one, key=lambda score: score.drop, default=None))
        effects.append(replace(one, p=_p(largest, one.largest.drop, len(rows))))
        normal[number] = _own_ps(largest, len(rows))
    smallest = normal.min(axis=0) if names else np.ones(draws)
    observed = min((one.p for one in effects), default=1.0)
    as_small = int(np.sum(smallest <= observed))
    p = (1 + as_small) / (1 + draws)
    if not as_small:  # beyond what was drawn: no chance of several is larger than the sum of all
        p = min(p, len(names) * observed)
    effects.sort(key=lambda one: -one.largest.drop)
    return Scores(tuple(effects), p, draws, projected.untestable)


def _score(one: Candidate, products: Real, gram: Real, left: float, root: float) -> Score:
    if not one.is_group:
        length = float(np.sqrt(gram[0, 0]))
        z = float(products[0]) / length
        return Score(one, z, z / length * root, root / length, left)
    z = _group_z(products[:, None], gram)[0]
    spread, error = _spread(products, gram)
    return Score(one, float(z), spread * root, error * root, left)


def _spread(products: Real, gram: Real) -> tuple[float, float]:
    """The rms of a group's members and its error, from the energy of its products: tr G + s^2 tr G^2 on average."""
    length2 = float(np.sum(gram**2))
    square = max(float(products @ products - np.trace(gram)), 0.0) / length2
    of_square = float(np.sqrt(2.0 * np.sum((gram + square * gram @ gram) ** 2))) / length2
    return float(np.sqrt(square)), float(np.sqrt(square + of_square) - np.sqrt(square))


def _group_z(products: Real, gram: Real) -> Real:
    """Normal equivalents (draw,) of the energy of products (member, draw), whose null covariance is `gram`.

    The energy is a sum of chi2 with the gram's eigenvalues as weights. A chi2 of the same mean and variance has too
    light a tail where these are uneven: it says 17.8 for 13.7 with a weight of 1 and nine of 0.1.
    """
    weight = np.linalg.eigvalsh(gram)
    energy, z = _saddles(weight[weight > ROUNDED * weight[-1]] / weight[-1])
    return np.asarray(np.interp(np.sqrt(np.sum(products**2, axis=0) / weight[-1]), np.sqrt(energy), z))


def _saddles(weight: Real) -> tuple[Real, Real]:
    """Energies of a sum of weighted chi2, the largest weight 1, and their normal equivalents, to 0.03 from 1 on.

    By the saddlepoint's tail (Lugannani and Rice 1980, as Barndorff-Nielsen writes it; for such sums Kuonen 1999).
    """
    tilt = 0.5 * (1.0 - SADDLES)
    left = (1.0 - weight) + SADDLES[:, None] * weight  # 1 - 2 tilt weight, of the largest without rounding
    energy = np.sum(weight / left, axis=1)
    height = 2.0 * tilt * energy + np.sum(np.log(left), axis=1)
    root = np.sign(tilt) * np.sqrt(height)
    slope = tilt * np.sqrt(2.0 * np.sum((weight / left) ** 2, axis=1))
    return energy, root + np.log(slope / root) / root


def _null(projected: Projected, draws: int, seed: int) -> Real:
    """Chi2 drops (candidate, draw) under noise alone."""
    random = np.random.default_rng(seed)
    size, axes = np.linalg.eigh(projected.gram) if len(projected.columns) else (np.zeros(0), np.zeros((0, 0)))
    products = (axes * np.sqrt(np.maximum(size, 0.0))) @ random.standard_normal((len(size), draws))
    drops = np.zeros((len(projected.candidates), draws))
    for k, (one, part) in enumerate(zip(projected.candidates, projected.slices(), strict=True)):
        gram = projected.gram[part, part]
        if one.is_group:
            drops[k] = np.maximum(_group_z(products[part], gram), 0.0) ** 2
            continue
        z = products[part][0] / np.sqrt(gram[0, 0])
        below, above = one.sides
        drops[k] = np.where(z > 0.0, z**2 * above, z**2 * below)
    return drops


LEAST_ABOVE = 10
"""Draws as large from which on a chance is counted."""


def _p(drawn: Real, drop: float, shapes: int) -> float:
    """Counted where draws reach, else by the chi2 of one degree of freedom a shape, at most what is counted last.

    Else a larger drop would be the likelier one where few draws happen to lie just below the change.
    """
    above = int(np.sum(drawn >= drop))
    if above >= LEAST_ABOVE or drop == 0.0:
        return (1 + above) / (1 + len(drawn))
    return min(float(_reckoned(np.array(drop), shapes)), (1 + LEAST_ABOVE) / (1 + len(drawn)))


def _reckoned(drops: Real, shapes: int) -> Real:
    """Chance of chi2 drops of one degree of freedom, for each of so many shapes."""
    return np.asarray(np.minimum(1.0, shapes * 2.0 * np.exp(log_ndtr(-np.sqrt(np.maximum(drops, 0.0))))))


def _own_ps(values: Real, shapes: int) -> Real:
    """`_p` of each value among the others."""
    order = np.sort(values)
    above = len(values) - np.searchsorted(order, values, side="left") - 1
    counted = (1.0 + above) / len(values)
    reckoned = np.minimum(_reckoned(values, shapes), (1 + LEAST_ABOVE) / len(values))
    return np.asarray(np.where((above >= LEAST_ABOVE) | (values == 0.0), counted, reckoned))
