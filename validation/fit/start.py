"""Where a fit starts: the module found to a pixel by correlation, gain and offset by a straight line."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from validation.fit.parameters import tied
from validation.fit.problem import Problem
from validation.measured import MeasuredImage
from validation.sample_values import numbers

Real = NDArray[np.float64]

FURTHEST = 0.25  # of the image's side: how far from its first guess the module is looked for


def start_values(problem: Problem, given: Mapping[str, float]) -> Real:
    """Values to start from: those of the model, those given, and for each image what a first look at it says."""
    names = problem.unknowns.names
    leaves = numbers(problem.model)
    values = {name: 1.0 if name == "gain" or name.endswith((".gain", ".scale")) else 0.0 for name in names}
    values |= {path: float(leaves[path]) for path in problem.unknowns.model_paths}
    values |= {name: value for name, value in given.items() if name in values}
    if not problem.images:
        return _with_scales(problem, _vector(problem, values), given)
    first = problem.evaluate(_vector(problem, values), derivatives=False)
    for image, predicted in zip(problem.images, first.predicted, strict=True):
        shot = image.shot.id
        if f"{shot}.shift_row_px" not in given:
            row, column = coarse_shift_px(image, predicted.irradiance_per_mm2)
            values[f"{shot}.shift_row_px"], values[f"{shot}.shift_column_px"] = float(row), float(column)
    second = problem.evaluate(_vector(problem, values), derivatives=False)
    lines = [
        _line(image, predicted.irradiance_per_mm2)
        for image, predicted in zip(problem.images, second.predicted, strict=True)
    ]
    per_ms = [gain / image.shot.exposure_ms for image, (gain, _) in zip(problem.images, lines, strict=True)]
    found = {"gain": float(np.median(per_ms))} if any(tied(image) for image in problem.images) else {}
    for image, (gain, offset) in zip(problem.images, lines, strict=True):
        found |= {f"{image.shot.id}.gain": gain, f"{image.shot.id}.offset_dn": offset}
    values |= {name: value for name, value in found.items() if name in values and name not in given}
    return _with_scales(problem, _vector(problem, values), given)


def coarse_shift_px(image: MeasuredImage, predicted: Real) -> tuple[int, int]:
    """How many whole pixels (row, column) the prediction must move to lie best on the image."""
    measured = np.where(image.used, image.signal_dn - image.signal_dn[image.used].mean(), 0.0)
    rows, columns = (max(1, int(FURTHEST * count)) for count in measured.shape)
    overlap = _overlap(measured, predicted - predicted.mean(), rows, columns)
    row, column = np.unravel_index(int(np.argmax(overlap)), overlap.shape)
    return int(row) - rows, int(column) - columns


def _overlap(one: Real, other: Real, rows: int, columns: int) -> Real:
    """Sums of one map times another one of its shape that is moved by -rows ... rows and -columns ... columns.

    By FFT; scipy.signal takes half a second to import.
    """
    room = tuple(
        fft.next_fast_len(size + most, real=True) for size, most in zip(one.shape, (rows, columns), strict=True)
    )
    around = fft.irfft2(fft.rfft2(one, room) * fft.rfft2(other, room).conj(), room)
    return np.asarray(around[np.ix_(range(-rows, rows + 1), range(-columns, columns + 1))])


def _line(image: MeasuredImage, predicted: Real) -> tuple[float, float]:
    """Gain and offset of the straight line from prediction to image; the gain is kept above zero."""
    x, y = predicted[image.used], image.signal_dn[image.used]
    spread = float(np.sum((x - x.mean()) ** 2))
    gain = float(np.sum((x - x.mean()) * (y - y.mean()))) / spread if spread > 0.0 else 0.0
    if gain <= 0.0:  # the shape does not fit at all: begin with the level
        gain = max(float(y.mean()), 1.0) / max(float(x.mean()), 1e-300)
    return gain, float(y.mean() - gain * x.mean())


def _with_scales(problem: Problem, values: Real, given: Mapping[str, float]) -> Real:
    """The scale of each curve that has one, by least squares."""
    free = [curve for curve in problem.curves if curve.free_scale and f"{curve.id}.scale" not in given]
    if not free:
        return values
    by_name = problem.unknowns.named(values)
    predictions = problem.evaluate(values, derivatives=False).predicted_curves
    for curve, predicted in zip(problem.curves, predictions, strict=True):
        if curve in free:
            weight = predicted.value / curve.sigma**2
            by_name[f"{curve.id}.scale"] = float(weight @ curve.value / (weight @ predicted.value))
    return _vector(problem, by_name)


def _vector(problem: Problem, values: Mapping[str, float]) -> Real:
    return np.array([values[name] for name in problem.unknowns.names])
