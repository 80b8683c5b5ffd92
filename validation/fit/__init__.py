"""Fitting a model to what was measured: whitened least squares with priors, limits and per-shot nuisances."""

from validation.fit.curves import CurvesOf, curves_of, film_parameters
from validation.fit.image_fit import fit
from validation.fit.least_squares import Parameter
from validation.fit.parameters import CurveData, Discrepancy
from validation.fit.profile import Profile, profile
from validation.fit.result import Fit

__all__ = [
    "CurveData",
    "CurvesOf",
    "Discrepancy",
    "Fit",
    "Parameter",
    "Profile",
    "curves_of",
    "film_parameters",
    "fit",
    "profile",
]
