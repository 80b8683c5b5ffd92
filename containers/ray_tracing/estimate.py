"""A statistic of a mean over independent groups: its value without the bias that noise makes, and its error.

The minimum of a noisy curve is too low and its maximum too high, so min / max is too low. How much is found by adding
the noise once more (a parametric bootstrap with the covariance of the groups) to a centre, and taking off what that
changes. About the noisy mean itself this corrects too little, because the mean is rougher than the truth; so the
centre may be handed in denoised. benchmarks/uniformity_estimators.py has it beside the jackknives.

Where weights took noise out of the modes of a map they took light with it: they flatten as noise roughens. While the
relief is well above the noise that is nothing; where it is not, the two cancel to within what they are, and how well
they do depends on a relief that nobody sees. There less of the bias is taken off, and its size enters the error
(docs/decisions/0025).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.checked import within
from luxloop.errors import InputError

Real = NDArray[np.float64]
Part = tuple[Real, Real]
Ratio = Callable[[Real], Part]
"""From replicas (draw, point) to numerators and denominators (draw,)."""

ROTATIONS = 2
"""Random rotations of the groups' deviations; each gives 2 x groups draws (of either sign)."""

MOST_VALUES = 1 << 22
"""Of draws that are held at once."""

HALF_HIDDEN, HALF_FLAT = 0.1, 0.5
"""Bias, in reliefs, from which on weights hide as much as noise adds; and from which on the map may as well be flat,
so that again all of the bias is taken off. Chosen, with `DOUBT`, in benchmarks/uniformity_estimators.py --stopped."""

DOUBT = 2.25
"""Standard error of a bias about a relief that weights may have hidden, in biases."""

SEED = 20240229
"""Of the rotations: fixed, so that an estimate is a pure function of its replicas."""


@dataclass(frozen=True)
class Estimate:
    """A number with its error.

    Attributes
    ----------
    value : with the bias taken off.
    standard_error : from the spread between the groups, and from what weights may have hidden.
    bias : what was taken off (negative where noise made the plain number too low).
    groups : independent groups behind it.
    truncation : bound on the effect of the field's left-out modes.
    """

    value: float
    standard_error: float
    bias: float
    groups: int
    truncation: float = 0.0

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Ends of the confidence interval: Student's t with groups - 1 degrees of freedom, plus the truncation."""
        reach = student_t(level, self.groups - 1) * self.standard_error + self.truncation
        return self.value - reach, self.value + reach


def estimate(statistic: Callable[[Real], Real], replicas: ArrayLike, centre: ArrayLike | None = None) -> Estimate:
    """The bias-corrected value of a statistic of the mean over groups, with standard error and bias.

    Parameters
    ----------
    statistic : from (draw, ...) to (draw,); must accept any number of draws.
    replicas : (group, ...), independent and identically distributed.
    centre : (...), a less noisy guess of the mean, about which the noise is added; by default the mean itself.

    Raises
    ------
    InputError : fewer than two groups; a statistic that is not finite.

    Notes
    -----
    With deviations d_g and G groups the noise of the mean is sum_g z_g d_g / sqrt(G (G - 1)), z standard normal. The
    z are the rows of `ROTATIONS` fixed random orthogonal matrices times +-sqrt(G), so that the draws have exactly
    the groups' covariance and no mean. bias = mean of statistic(centre + noise) - statistic(centre). The standard
    error is the root mean square of the bootstrap's and the delete-one jackknife's: the first is a little too small
    where extrema compete, the second too large.
    """
    groups = np.asarray(replicas, float)
    ones = np.ones(1)
    draws = None if centre is None else np.asarray(centre, float)
    return ratio_estimate(lambda values: (statistic(values), np.broadcast_to(ones, len(values))), groups, draws)


def ratio_estimate(
    ratio: Ratio,
    replicas: Real,
    centre: Real | None = None,
    truncation: float = 0.0,
    hidden: float = 0.0,
    unseen: float = 0.0,
) -> Estimate:
    """The same for a numerator over a denominator of which each may be wrong by `truncation` through left-out modes.

    Parameters
    ----------
    hidden : share of the noise that replicas lost to weights, 0 to 1 (`field.Field.hidden`).
    unseen : of the ratio, what may be hidden where they lost nearly all: an independent part of the standard error.

    Raises
    ------
    InputError : as `estimate`.

    Notes
    -----
    The ratio is then wrong by at most truncation (1 + ratio) / denominator, to first order.

    With the relief R = |ratio - that of a flat map|, the bias b that draws it away from flat, rho = b / R, and
    s(x) = x^2 / (1 + x^2): the share 1 - hidden (s(rho / 0.1) - s(rho / 0.5)) of b is taken off, and
    2.25 hidden s(rho / 0.1) b is an independent part of the standard error.
    """
    return ratio_estimates({"": ratio}, replicas, centre, truncation, hidden, unseen)[""]


def ratio_estimates(
    ratios: dict[str, Ratio],
    replicas: Real,
    centre: Real | None = None,
    truncation: float = 0.0,
    hidden: float = 0.0,
    unseen: float = 0.0,
) -> dict[str, Estimate]:
    """The same for several ratios of the same replicas, which then share their draws."""
    if replicas.ndim < 1 or len(replicas) < 2:
        raise InputError("replicas", replicas.shape, "two groups or more", "an error needs groups to compare")
    G = len(replicas)
    flat = replicas.reshape(G, -1)
    mean = flat.mean(axis=0)
    deviation = flat - mean
    middle = mean if centre is None else centre.reshape(-1)
    plain = _in_pieces(ratios, _without_one(mean, deviation, middle), replicas.shape[1:])
    drawn = _in_pieces(ratios, _drawn(middle, deviation), replicas.shape[1:])
    even = {name: ratio(np.ones_like(replicas[:1])) for name, ratio in ratios.items()}
    return {name: _estimate(plain[name], drawn[name], even[name], truncation, hidden, unseen) for name in ratios}


def _in_pieces(ratios: dict[str, Ratio], pieces: Iterable[Real], shape: tuple[int, ...]) -> dict[str, Part]:
    """Numerators and denominators of each ratio, for (draw, point) that come in pieces."""
    found: dict[str, list[Part]] = {name: [] for name in ratios}
    for piece in pieces:
        for name, ratio in ratios.items():
            found[name].append(ratio(piece.reshape(-1, *shape)))
    both = {name: list(zip(*some, strict=True)) for name, some in found.items()}
    return {name: (np.concatenate(over), np.concatenate(under)) for name, (over, under) in both.items()}


def _without_one(mean: Real, deviation: Real, middle: Real) -> Iterator[Real]:
    """The mean, the G means without one group, the centre."""
    G, size = len(deviation), max(1, MOST_VALUES // mean.size)
    for first in range(0, G, size):
        before, after = [mean[None]] * (first == 0), [middle[None]] * (first + size >= G)
        yield np.concatenate([*before, mean - deviation[first : first + size] / (G - 1), *after])


def _drawn(middle: Real, deviation: Real) -> Iterator[Real]:
    """The centre with noise, of either sign."""
    rotations, size = _rotations(len(deviation)), max(1, MOST_VALUES // (2 * middle.size))
    scaled = deviation / np.sqrt(len(deviation) - 1.0)
    for first in range(0, len(rotations), size):
        some = rotations[first : first + size]
        drawn = np.empty((2, len(some), middle.size))
        noise = np.matmul(some, scaled, out=drawn[0])
        np.subtract(middle, noise, out=drawn[1])
        noise += middle
        yield drawn.reshape(-1, middle.size)


def _estimate(plain: Part, drawn: Part, even: Part, truncation: float, hidden: float, unseen: float) -> Estimate:
    """Estimate from (the mean, the G means without one group, the centre), the draws about it, and a flat map."""
    (numerator, denominator), (drawn_numerator, drawn_denominator) = plain, drawn
    G = len(numerator) - 2
    with np.errstate(divide="ignore", invalid="ignore"):
        at_plain, at_drawn = numerator / denominator, drawn_numerator / drawn_denominator
    if not (np.isfinite(at_plain).all() and np.isfinite(at_drawn).all()):
        raise InputError("statistic", "nan or infinite", "finite for every draw", "more histories")
    value, without_one, at_centre = at_plain[0], at_plain[1:-1], at_plain[-1]
    bias = float(at_drawn.mean() - at_centre)
    share, doubt = 1.0, 0.0
    if hidden > 0.0:
        share, doubt = _of_hidden(bias, float(value - even[0][0] / even[1][0]), hidden)
    jackknife_variance = (G - 1) * without_one.var()
    error = float(np.sqrt((at_drawn.var() + jackknife_variance) / 2.0 + doubt**2 + unseen**2))
    bound = truncation * (1.0 + abs(value)) / abs(denominator[0])
    return Estimate(float(value - share * bias), error, share * bias, G, float(bound))


def _of_hidden(bias: float, relief: float, hidden: float) -> tuple[float, float]:
    """Share of a bias to take off, and the standard error it leaves, where weights may have hidden some relief."""
    away = bias * np.sign(relief) if relief else abs(bias)
    if away <= 0.0:  # noise that draws towards flat is not mistaken for relief
        return 1.0, 0.0
    behind, flat = (away**2 / (away**2 + (at * relief) ** 2) for at in (HALF_HIDDEN, HALF_FLAT))
    return float(1.0 - hidden * (behind - flat)), float(DOUBT * hidden * behind * away)


@lru_cache(maxsize=8)
def _rotations(groups: int) -> Real:
    """Rows (draw, group) of random orthogonal matrices, uniform over all rotations and reflections."""
    normal = np.random.default_rng(SEED).standard_normal((ROTATIONS, groups, groups))
    q, r = np.linalg.qr(normal)
    signed: Real = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None, :]
    return signed.reshape(-1, groups)


@lru_cache(maxsize=32)
def student_t(level: float, degrees: int) -> float:
    """The t within which a fraction `level` of Student's distribution lies on both sides of 0.

    Notes
    -----
    With t = sqrt(degrees) tan a the density is cos(a)^(degrees - 1): its running sum by the trapezoidal rule over
    20,000 steps is 1e-6 good for levels up to 0.999.
    """
    within("level", level, 0.0, 1.0, "the fraction of intervals that hold the truth", below=True)
    if degrees < 1:
        raise InputError("degrees", degrees, "1 or more", "two groups or more")
    a = np.linspace(0.0, np.pi / 2.0, 20_001)
    density = np.cos(a) ** (degrees - 1)
    running = np.r_[0.0, np.cumsum(density[1:] + density[:-1])]
    return float(np.sqrt(degrees) * np.tan(np.interp(level, running / running[-1], a)))
