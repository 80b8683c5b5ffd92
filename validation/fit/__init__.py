"""Fitting a model to what was measured: whitened least squares with priors, limits and per-shot nuisances."""

from validation.fit.anchored_fit import fit
from validation.fit.curves import CurvesOf, curves_of, film_parameters
from validation.fit.descent import refitted
from validation.fit.least_squares import Parameter, prior_chi2
from validation.fit.parameters import CurveData, Discrepancy, unknowns_of
from validation.fit.profile import Profile, profile
from validation.fit.result import AT_LIMIT, NOT_CONVERGED, Fit

__all__ = [
    "AT_LIMIT",
    "NOT_CONVERGED",
    "CurveData",
    "CurvesOf",
    "Discrepancy",
    "Fit",
    "Parameter",
    "Profile",
    "curves_of",
    "film_parameters",
    "fit",
    "prior_chi2",
    "profile",
    "refitted",
    "unknowns_of",
]
