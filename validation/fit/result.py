"""What a fit found, how sure it is, and whether it may be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from luxloop.model import Model
from validation.fit.least_squares import WORST_CONDITION, Basis, Reduced, Step, basis
from validation.fit.model_noise import noise_share, noise_shares
from validation.fit.parameters import gain_of, pose_of, tied
from validation.fit.problem import Evaluation, Problem
from validation.fit.whitening import Whitening, variance_scale
from validation.noise import histories_for
from validation.prediction import Pose

Real = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_MODEL_NOISE = 2.0  # rms, of the camera's: up to there errors and chi2 were found right (decision 27)
AT_LIMIT = " is at its limit"
NOT_CONVERGED = "the fit has not converged"
NO_STEP = "no good step is left by derivatives that are mostly noise of Monte Carlo (more histories)"
LEAST_GAP = 0.1
"""Of chi2: less to be gained is not why a fit stopped."""
ROUNDING = 1e-6
"""Of a degree of freedom: as many parameters as values leave some 1e-15, of either sign."""
UNMENDED = "free less, or look for what the model lacks (luxloop where, luxloop diagnose)"
BEYOND = 4.0
"""Of chi2, that a parameter at its limit may gain beyond it: so much noise does, too, of what is near the limit."""
MOST_HISTORIES = 10**9  # of a sample, that a request may ask for
LEAST_LIGHT = 5.0
"""Of a gain, in its errors: below, an image may be of no light at all."""
WANTED_NOISE = 0.1
"""Of the camera's, by pixel: along what is smooth, as most effects are, there is more of it (decision 59)."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit at its optimum. Rows are whitened: used pixels of image 0, of image 1, ..., then rows of the curves."""

    problem: Problem
    model: Model
    values: Real
    whitening: Whitening
    reduced: Reduced
    active: Mask  # parameters neither at a limit nor unseen
    columns: Real  # (parameter, row), whitened
    noise_share: float  # of the Monte Carlo, rms over all pixels, in standard deviations of the camera's noise
    residual: Real  # (row,), whitened
    carried: Real  # (row,), whitened: what the twin's error may have changed by, on the way from the anchor
    signals_dn: tuple[Real, ...]  # expected, by image
    noise_per_mm2: tuple[Real | None, ...]  # (function, row, column) of each image: of the prediction's Monte Carlo
    covariance: Real
    chi2: float  # of the data
    freedom: float  # data rows less what the fit takes from them
    variance_scale: float
    iterations: int
    gap: float  # of chi2, that the last step still found
    converged: bool
    at_limit: tuple[str, ...]
    driven: tuple[str, ...]  # of these, what the data drive beyond its limit, by more than noise does
    distrust: tuple[str, ...]  # reasons, empty where the fit may be trusted

    @property
    def trusted(self) -> bool:
        """Whether its verdicts may be used."""
        return not self.distrust

    def doubted(self, reasons: Sequence[str]) -> Fit:
        """The same fit with further reasons not to trust it."""
        return replace(self, distrust=(*self.distrust, *reasons))

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters in their order."""
        return self.problem.unknowns.names

    def value(self, name: str) -> float:
        """The value of a parameter."""
        return float(self.values[self.names.index(name)])

    def error(self, name: str) -> float:
        """Its standard error; 0 for one driven to its limit, inf for one that nothing in the data holds."""
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    def covariance_of(self, names: Sequence[str]) -> Real:
        """The covariance (parameter, parameter) of some of them."""
        index = [self.names.index(name) for name in names]
        return np.asarray(self.covariance[np.ix_(index, index)])

    @property
    def correlation(self) -> Real:
        """Correlations of all parameters; 0 beside one that has no error."""
        sd = np.sqrt(np.diag(self.covariance))
        some = np.where((sd > 0.0) & np.isfinite(sd), sd, np.inf)
        finite = np.where(np.isfinite(self.covariance), self.covariance, 0.0)
        return np.asarray(finite / np.outer(some, some) + np.diag(np.isinf(some).astype(float)))

    @cached_property
    def basis(self) -> Basis:
        """What the fit takes out of noise: needed by every test of what is left."""
        return basis(self.columns, self.reduced, self.active)

    @cached_property
    def residual_with_priors(self) -> Real:
        """(row,): the residual, then how far active parameters are from their priors: in the rows of `basis.left`."""
        priors = self.problem.unknowns.parameters
        held = [(p.prior_mean - at) / p.prior_sd for p, at in zip(priors, self.values, strict=True)]
        counted = self.active & ~self.reduced.blind & (self.reduced.prior_weight > 0.0)
        return np.concatenate([self.residual, np.array(held)[counted]])

    @cached_property
    def residual_images(self) -> list[Real]:
        """Whitened residual of each image, zero where unused."""
        return self.whitening.unfold(self.residual[: self.whitening.count])

    def variance_dn2(self, index: int) -> Real:
        """Of the noise of an image (row, column): of camera, its pattern, and the prediction's Monte Carlo.

        Unused pixels have none of the last.
        """
        own = self.problem.images[index].noise_dn2(self.signals_dn[index])
        return np.asarray(own + np.sum(self.model_noise_dn(index) ** 2, axis=0))

    def model_noise_dn(self, index: int) -> Real:
        """(function, row, column) of an image: what tells the noise of its Monte Carlo, 0 where unused."""
        image, noise = self.problem.images[index], self.noise_per_mm2[index]
        if noise is None:
            return np.zeros((0, *image.used.shape))
        return np.asarray(self.gains[image.shot.id] * noise * image.used)

    @property
    def residual_curves(self) -> list[Real]:
        """Whitened residual of each curve, (row,)."""
        rows, ends = self.residual[self.whitening.count :], np.cumsum([len(one.value) for one in self.problem.curves])
        return [np.asarray(part) for part in np.split(rows, ends[:-1])] if len(ends) else []

    @property
    def poses(self) -> dict[str, Pose]:
        """Poses by shot."""
        by_name = self.problem.unknowns.named(self.values)
        return {image.shot.id: pose_of(image, by_name) for image in self.problem.images}

    @property
    def gains(self) -> dict[str, float]:
        """DN per 1/mm^2, by shot."""
        by_name = self.problem.unknowns.named(self.values)
        return {image.shot.id: gain_of(image, by_name) for image in self.problem.images}

    @property
    def offsets_dn(self) -> dict[str, float]:
        """Offsets by shot."""
        return {image.shot.id: self.value(f"{image.shot.id}.offset_dn") for image in self.problem.images}

    @property
    def chi2_per_row(self) -> float:
        """Chi2 over its degrees of freedom: 1 where nothing but noise is left."""
        return self.chi2 / self.freedom


def conclude(
    evaluation: Evaluation,
    white: Whitening,
    reduced: Reduced,
    columns: Real,
    last: Step,
    iterations: int,
    converged: bool,
    other: Real | None = None,
) -> Fit:
    """The result where a fit stopped; where it converged, the last step is taken on the linear model.

    `other`: columns with noise of their own that is independent (`Evaluation.other_columns`).
    """
    change = last.change if converged else np.zeros_like(last.change)
    values = evaluation.problem.unknowns.within(evaluation.values + change)
    residual = evaluation.residual(white) - change @ columns
    active = ~last.at_limit & ~reduced.blind
    taken, share = basis(columns, reduced, active), noise_share(white)
    chi2, freedom = float(residual @ residual), taken.freedom
    scale = variance_scale(chi2, freedom)
    names = evaluation.problem.unknowns.names
    at_limit = tuple(name for name, held in zip(names, last.at_limit, strict=True) if held)
    driven = tuple(name for n, name in enumerate(names) if name in at_limit and reduced.beyond(n) > BEYOND)
    gap = max(0.0, reduced.chi2 - last.chi2)
    known = ~np.isin(names, driven) & ~reduced.blind
    covariance = (
        reduced.covariance(scale, known) if other is None else reduced.covariance_of(columns, other, scale, known)
    )
    return Fit(
        problem=evaluation.problem,
        model=evaluation.problem.unknowns.model(evaluation.problem.model, values),
        values=values,
        whitening=white,
        reduced=reduced,
        active=active,
        columns=columns,
        noise_share=share,
        residual=residual,
        carried=evaluation.carried(white, values),
        signals_dn=tuple(evaluation.signals_dn(change)),
        noise_per_mm2=tuple(one.noise_per_mm2 for one in evaluation.predicted),
        covariance=covariance,
        chi2=chi2,
        freedom=freedom,
        variance_scale=scale,
        iterations=iterations,
        gap=gap,
        converged=converged,
        at_limit=at_limit,
        driven=driven,
        distrust=(
            *_reasons(evaluation.problem, reduced, known, driven, gap, converged, freedom),
            *_of_noise(evaluation.problem, white, share),
            *_of_light(evaluation.problem, values, covariance),
        ),
    )


def wanted_histories(problem: Problem, white: Whitening, wanted_share: float = WANTED_NOISE) -> dict[str, int]:
    """Histories that bring the noise of each sample, by its id, down to a share; {} where there are none."""
    anchor = problem.anchor
    if anchor is None or not anchor.histories:
        return {}
    found: dict[str, int] = {}
    for image, share in zip(problem.images, noise_shares(white), strict=True):
        sample = image.sample.id
        wanted = histories_for(wanted_share, anchor.histories_of(sample), share)
        found[sample] = max(wanted, found.get(sample, 0))
    return found


def _of_noise(problem: Problem, white: Whitening, share: float) -> list[str]:
    """Why a fit about a noisy anchor may not be trusted."""
    if share <= MOST_MODEL_NOISE or problem.anchor is None:
        return []
    needed = max(wanted_histories(problem, white, MOST_MODEL_NOISE / 2.0).values())
    return [
        f"the Monte Carlo's own noise is {share:.2f} of the camera's, above {MOST_MODEL_NOISE:g}: about"
        f" {needed:,} histories for each sample would do"
    ]


def _of_light(problem: Problem, values: Real, covariance: Real) -> list[str]:
    """Images that hardly show the light they are to be compared with: noise would agree with any model."""
    by_name, names, reasons = problem.unknowns.named(values), problem.unknowns.names, []
    for image in problem.images:
        name = "gain" if tied(image) else f"{image.shot.id}.gain"
        error = float(np.sqrt(covariance[names.index(name), names.index(name)]))
        if by_name[name] < LEAST_LIGHT * error < np.inf:
            value = f"its gain is {by_name[name]:.3g} +- {error:.2g}"
            reasons.append(
                f"{image.shot.file} shows hardly any light of its sample: {value}; is it a dark, or of another one"
            )
    return reasons


def _reasons(
    problem: Problem,
    reduced: Reduced,
    known: Mask,
    driven: tuple[str, ...],
    gap: float,
    converged: bool,
    freedom: float,
) -> list[str]:
    """Why a fit may not be trusted, one sentence each."""
    reasons = []
    named = {parameter.name: parameter for parameter in problem.unknowns.parameters}
    for name in driven:
        low, high = named[name].lower, named[name].upper
        reasons.append(f"{name}{AT_LIMIT} ({low:g} to {high:g}); widen the limits or add what is missing")
    if not converged:
        why = f"{gap:.3g} of chi2 is still to be gained" if gap >= LEAST_GAP else NO_STEP
        reasons.append(f"{NOT_CONVERGED}: {why}; {UNMENDED}")
    for name, blind in zip(problem.unknowns.names, reduced.blind, strict=True):
        if blind:
            reasons.append(f"nothing measured depends on {name}; fix it or give it a prior")
    if (condition := reduced.condition(known)) > WORST_CONDITION:
        reasons.append(f"two parameters are the same to these data (condition {condition:.1e}); fix one of them")
    if freedom < ROUNDING:
        reasons.append("there are no more measured values than parameters; measure more or free less")
    return reasons
