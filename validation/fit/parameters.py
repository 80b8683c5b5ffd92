"""The unknowns of a fit and where each stands: parameters of the model, of films, of each image, of each curve.

environment.substrate.reflectance     a path of the model; limits and prior from its [fit] table
samples.array-0.dead_chip.power_ratio a value of one sample (`sample_values`); a table for all samples
films.gan-on-sapphire.layers.0.a      any other number that only curves depend on, as its caller names it
single-5.5-a.gain                     DN mm^2: image = gain E + offset; or, tied to the exposure,
gain, single-5.5-a.gain_error         DN mm^2 / ms, and gain_i = gain exposure_i (1 + gain_error)
single-5.5-a.offset_dn, .shift_row_px, .shift_column_px, .rotation_deg
goniometer-a.scale                    of a curve whose scale is free
discrepancy.0                         how much of a known error of the model there is, prior mean 0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from luxloop.model import Model
from validation.fit.least_squares import Parameter
from validation.measured import MeasuredImage
from validation.prediction import POSE_COLUMNS, Pose
from validation.sample_values import LEAD, is_by_sample, limits_of, with_members

Real = NDArray[np.float64]

ROTATION_PRIOR_DEG = 0.3
GAIN_ERROR_PRIOR = 0.01  # of an exposure: shutter and lamp
STEP_PX, STEP_DEG = 2.0, 0.5  # a pose moves no further in one iteration


@dataclass(frozen=True, eq=False)
class CurveData:
    """A spectrum, an ellipsometric or a goniometer curve as a fit sees it: rows of value and error."""

    id: str
    value: Real
    sigma: Real
    is_angle: bool = False  # degrees: the residual is wrapped to +-180
    free_scale: bool = False  # goniometer curves: value = scale x predicted
    axis: Real = field(default_factory=lambda: np.zeros(0))  # of the rows: a wavelength or an angle
    axis_unit: str = ""
    source: object = None  # what its predictor needs to know of it


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """An error that the model is known to have, up to its size: images in 1/mm^2, and the spread of the size."""

    images_per_mm2: tuple[Real, ...]
    sd: float = 1.0


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The parameters of a fit in their order, and how to read a vector of their values."""

    parameters: tuple[Parameter, ...]
    model_paths: tuple[str, ...]
    other_paths: tuple[str, ...]  # of films

    @property
    def names(self) -> tuple[str, ...]:
        """The names in order."""
        return tuple(parameter.name for parameter in self.parameters)

    def named(self, values: Real) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, (float(value) for value in values), strict=True))

    def with_limits_of(self, model: Model) -> Unknowns:
        """The same with the limits and priors of another model for its parameters."""
        own = {path: model_parameter(model, path) for path in self.model_paths}
        return replace(self, parameters=tuple(own.get(one.name, one) for one in self.parameters))

    def within(self, values: Real) -> Real:
        """Values brought back inside the limits, which rounding may pass by a last digit."""
        lower = [parameter.lower for parameter in self.parameters]
        return np.clip(values, lower, [parameter.upper for parameter in self.parameters])

    def model(self, model: Model, values: Real) -> Model:
        """The model with its free parameters set; InputError where it does not take a value."""
        by_name = self.named(values)
        for path in self.model_paths:
            if not path.startswith(LEAD):
                model = model.with_value(path, by_name[path])
        return with_members(model, {path: by_name[path] for path in self.model_paths if path.startswith(LEAD)})


def model_parameter(model: Model, path: str) -> Parameter:
    """The limits and the prior of a free parameter of a model; InputError where it has no [fit] table."""
    fit = limits_of(model, path)
    if fit is None:
        raise InputError(f"fit.{path}", None, "limits for a parameter that is to be fitted", f'add [fit."{path}"]')
    prior = (fit.prior_mean, fit.prior_sd)
    mean, sd = (0.0, np.inf) if prior[0] is None or prior[1] is None else (prior[0], prior[1])
    return Parameter(path, fit.lower, fit.upper, mean, sd)


def free_paths(model: Model) -> tuple[str, ...]:
    """The parameters that the model file lets move, but for values that each sample has its own of."""
    return tuple(path for path, fit in model.fit.items() if fit.free and not is_by_sample(model, path))


def unknowns_of(
    model: Model,
    paths: Sequence[str],
    images: Sequence[MeasuredImage],
    curves: Sequence[CurveData] = (),
    others: Sequence[Parameter] = (),
    discrepancies: Sequence[Discrepancy] = (),
) -> Unknowns:
    """All that a fit may move, in a fixed order; InputError where two shots have one id."""
    ids = [image.shot.id for image in images] + [curve.id for curve in curves]
    for shot in ids:
        if ids.count(shot) > 1:
            raise InputError("shots.id", shot, "an id used once", "rename one of the shots")
    parameters = [model_parameter(model, path) for path in paths] + list(others)
    if any(tied(image) for image in images):
        parameters.append(Parameter("gain", lower=0.0))
    for image in images:
        parameters += _of_image(image)
    parameters += [Parameter(f"{curve.id}.scale", lower=0.0) for curve in curves if curve.free_scale]
    parameters += [Parameter(f"discrepancy.{k}", prior_sd=one.sd) for k, one in enumerate(discrepancies)]
    return Unknowns(tuple(parameters), tuple(paths), tuple(parameter.name for parameter in others))


def tied(image: MeasuredImage) -> bool:
    """Whether the gain of an image follows its exposure."""
    return image.camera.gain_mode == "exposure"


def gain_of(image: MeasuredImage, values: Mapping[str, float]) -> float:
    """DN per 1/mm^2 of irradiance."""
    if tied(image):
        return values["gain"] * image.shot.exposure_ms * (1.0 + values[f"{image.shot.id}.gain_error"])
    return values[f"{image.shot.id}.gain"]


def pose_of(image: MeasuredImage, values: Mapping[str, float]) -> Pose:
    """Where the module lies in an image."""
    row, column, rotation = (values[f"{image.shot.id}.{name}"] for name in POSE_COLUMNS)
    return Pose((row, column), rotation)


def _of_image(image: MeasuredImage) -> list[Parameter]:
    shot = image.shot.id
    gain = Parameter(f"{shot}.gain", lower=0.0)
    if tied(image):
        gain = Parameter(f"{shot}.gain_error", prior_sd=GAIN_ERROR_PRIOR)
    return [
        gain,
        Parameter(f"{shot}.offset_dn"),
        Parameter(f"{shot}.shift_row_px", longest_step=STEP_PX),
        Parameter(f"{shot}.shift_column_px", longest_step=STEP_PX),
        Parameter(f"{shot}.rotation_deg", prior_sd=ROTATION_PRIOR_DEG, longest_step=STEP_DEG),
    ]
