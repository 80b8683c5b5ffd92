"""What is fitted to what: one evaluation asks for all predictions at once and gives residuals and their columns.

image_i = gain_i (E_i(theta, pose_i) + discrepancies) + offset_i          curve = scale x f(theta)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from luxloop.model import Model
from validation.fit.parameters import (
    CurveData,
    Discrepancy,
    Unknowns,
    gain_of,
    pose_of,
    tied,
)
from validation.fit.whitening import Whitening, whitening
from validation.measured import MeasuredImage
from validation.prediction import POSE_COLUMNS, Anchored, Pose, Predicted, PredictedCurve, View

Real = NDArray[np.float64]


class ImagePredictor(Protocol):
    """Predicts all images of one question at once (`validation.prediction.Predictor` does)."""

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """The views' irradiance with its derivatives by path and pose."""


class CurvePredictor(Protocol):
    """Predicts all curves of one question at once."""

    def __call__(
        self, model: Model, curves: Sequence[CurveData], paths: Sequence[str], others: Mapping[str, float]
    ) -> list[PredictedCurve]:
        """The curves with their derivatives by `paths` and by the names of `others`, whose values are given."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that stays the same from one evaluation to the next."""

    model: Model
    unknowns: Unknowns
    images: tuple[MeasuredImage, ...]
    predictor: ImagePredictor
    curves: tuple[CurveData, ...] = ()
    predict_curves: CurvePredictor | None = None
    discrepancies: tuple[Discrepancy, ...] = ()
    anchor: Anchored | None = None

    def evaluate(self, values: Real) -> Evaluation:
        """All predictions at these values: the predictor is asked once."""
        by_name, unknowns = self.unknowns.named(values), self.unknowns
        model = unknowns.model(self.model, values)
        images = self._ask_images(model, by_name)
        curves: list[PredictedCurve] = []
        if self.curves and self.predict_curves is not None:
            others = {name: by_name[name] for name in unknowns.other_paths}
            curves = self.predict_curves(model, self.curves, unknowns.model_paths, others)
        return Evaluation(self, values, by_name, model, images, curves)

    def _ask_images(self, model: Model, by_name: Mapping[str, float]) -> list[Predicted]:
        views = [view_of(image, pose_of(image, by_name)) for image in self.images]
        paths = (*self.unknowns.model_paths, *POSE_COLUMNS)
        return self.predictor.images(model, views, paths, self.anchor) if views else []


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The predictions at one point, and the linear problem around it."""

    problem: Problem
    values: Real
    by_name: dict[str, float]
    model: Model
    predicted: list[Predicted]
    predicted_curves: list[PredictedCurve]

    def irradiance_per_mm2(self, index: int) -> Real:
        """Of an image, its discrepancies included."""
        total = self.predicted[index].irradiance_per_mm2
        for k, one in enumerate(self.problem.discrepancies):
            total = total + self.by_name[f"discrepancy.{k}"] * one.images_per_mm2[index]
        return total

    def signals_dn(self, change: Real | None = None) -> list[Real]:
        """Expected signals above black of all images, after a small change of the values where one is given."""
        signals = []
        for index, image in enumerate(self.problem.images):
            offset_dn = self.by_name[f"{image.shot.id}.offset_dn"]
            signals.append(gain_of(image, self.by_name) * self.irradiance_per_mm2(index) + offset_dn)
            if change is not None:
                signals[-1] += np.tensordot(change, self._image_columns(index), axes=1)
        return signals

    def whitening(self) -> Whitening:
        """The whitening that this prediction asks for."""
        white = whitening(self.problem.images, self.signals_dn())
        return replace(white, curve_sigma=tuple(self._curve_sigma(k) for k in range(len(self.predicted_curves))))

    def residual(self, white: Whitening) -> Real:
        """Whitened measured minus predicted: pixels of the images, then rows of the curves."""
        images = [
            image.signal_dn - signal for image, signal in zip(self.problem.images, self.signals_dn(), strict=True)
        ]
        parts = [white.rows(images)] if images else []
        for k, (curve, predicted) in enumerate(zip(self.problem.curves, self.predicted_curves, strict=True)):
            difference = curve.value - self._scale(curve) * predicted.value
            parts.append((wrapped_deg(difference) if curve.is_angle else difference) / white.curve_sigma[k])
        return np.concatenate(parts)

    def columns(self, white: Whitening) -> Real:
        """Whitened derivatives of the prediction, (parameter, row)."""
        images = [self._image_columns(index) for index in range(len(self.predicted))]
        blocks = [white.rows(images)] if images else []
        blocks += [
            self._curve_columns(index) / white.curve_sigma[index] for index in range(len(self.predicted_curves))
        ]
        return np.concatenate(blocks, axis=1)

    def noise_columns(self, white: Whitening) -> Real:
        """Whitened columns (column, row) of the Monte Carlo's own noise: each times a unit normal number.

        Shots of one sample are seen by the same histories, so a group of histories is one column in all of them.
        """
        columns: dict[tuple[str, int], list[tuple[int, Real]]] = {}
        for index, (image, predicted) in enumerate(zip(self.problem.images, self.predicted, strict=True)):
            noise = predicted.noise_per_mm2
            for group, one in enumerate(noise if noise is not None else ()):
                place = columns.setdefault((image.sample.id, group), [])
                place.append((index, gain_of(image, self.by_name) * one))
        rows = sum(len(curve.value) for curve in self.problem.curves)
        if not columns:
            return np.zeros((0, white.count + rows))
        stacks = [np.zeros((len(columns), *image.signal_dn.shape)) for image in self.problem.images]
        for row, entries in enumerate(columns.values()):
            for index, one in entries:
                stacks[index][row] = one
        return np.pad(white.rows(stacks), ((0, 0), (0, rows)))

    def _image_columns(self, index: int) -> Real:
        """Derivatives of one image in DN, (parameter, row, column)."""
        image, predicted = self.problem.images[index], self.predicted[index]
        names, shot, gain = self.problem.unknowns.names, image.shot.id, gain_of(image, self.by_name)
        columns = np.zeros((len(names), *image.signal_dn.shape))
        place = {name: row for row, name in enumerate(names)}
        for name in self.problem.unknowns.model_paths:
            columns[place[name]] = gain * predicted.jacobian_per_mm2[name]
        for name in POSE_COLUMNS:
            columns[place[f"{shot}.{name}"]] = gain * predicted.jacobian_per_mm2[name]
        for k, one in enumerate(self.problem.discrepancies):
            columns[place[f"discrepancy.{k}"]] = gain * one.images_per_mm2[index]
        columns[place[f"{shot}.offset_dn"]] = 1.0
        irradiance = self.irradiance_per_mm2(index)
        if tied(image):
            lit = image.shot.exposure_ms * irradiance
            columns[place["gain"]] = lit * (1.0 + self.by_name[f"{shot}.gain_error"])
            columns[place[f"{shot}.gain_error"]] = lit * self.by_name["gain"]
        else:
            columns[place[f"{shot}.gain"]] = irradiance
        return columns

    def _curve_columns(self, index: int) -> Real:
        curve, predicted = self.problem.curves[index], self.predicted_curves[index]
        columns = np.zeros((len(self.problem.unknowns.names), len(curve.value)))
        for row, name in enumerate(self.problem.unknowns.names):
            if name in predicted.jacobian:
                columns[row] = self._scale(curve) * predicted.jacobian[name]
            elif name == f"{curve.id}.scale":
                columns[row] = predicted.value
        return columns

    def _scale(self, curve: CurveData) -> float:
        return self.by_name[f"{curve.id}.scale"] if curve.free_scale else 1.0

    def _curve_sigma(self, index: int) -> Real:
        """Error of the rows of a curve, that of a Monte Carlo prediction included."""
        curve, error = self.problem.curves[index], self.predicted_curves[index].error
        return curve.sigma if error is None else np.hypot(curve.sigma, self._scale(curve) * error)


def view_of(image: MeasuredImage, pose: Pose) -> View:
    """The camera of a measured image."""
    rows, columns = image.signal_dn.shape
    return View(image.sample, rows, columns, image.pixel_um, image.centre_px, pose)


def wrapped_deg(difference_deg: Real) -> Real:
    """Angles brought to -180 to 180."""
    return np.asarray((difference_deg + 180.0) % 360.0 - 180.0)
