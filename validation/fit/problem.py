"""What is fitted to what: one evaluation asks for all predictions at once and gives residuals and their columns.

image_i = gain_i (E_i(theta, pose_i) + discrepancies) + offset_i          curve = scale x f(theta)

E about an anchor has the noise of its Monte Carlo, the same in all evaluations. Were columns or weights taken from it
too, their products with that noise would not vanish on average: gains come out low, and shapes bend to make up for
it. So columns and weights come from the twin's image, which errs independently (they are instruments, in the words
of statistics): J_twin' W (measured - image) = 0 is right on average, whatever noise E has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from luxloop.model import Model
from validation.fit.model_noise import noise_blocks
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
from validation.prediction import POSE_COLUMNS, Anchored, Pose, Predicted, PredictedCurve, Sensor, View
from validation.prediction.words import run_of
from validation.sample_values import numbers

Real = NDArray[np.float64]

FAINT = 1e-3  # of the brightest pixel: darker ones are taken for as bright where they divide


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

    def evaluate(self, values: Real, *, derivatives: bool = True) -> Evaluation:
        """All predictions at these values: the predictor is asked once.

        Without derivatives there is a residual and no column: those by what changes the light in a chip are walks.
        """
        by_name, unknowns = self.unknowns.named(values), self.unknowns
        model, paths = unknowns.model(self.model, values), unknowns.model_paths if derivatives else ()
        images = self._ask_images(model, by_name, (*paths, *POSE_COLUMNS) if derivatives else ())
        curves: list[PredictedCurve] = []
        if self.curves and self.predict_curves is not None:
            others = {name: by_name[name] for name in unknowns.other_paths}
            curves = self.predict_curves(model, self.curves, paths, others)
        return Evaluation(self, values, by_name, model, images, curves)

    def views(self, model: Model, by_name: Mapping[str, float]) -> list[View]:
        """The cameras of all images at these values."""
        views = [view_of(image, pose_of(image, by_name)) for image in self.images]
        if model.effects:
            views = [
                replace(view, sensor=sensor_of(one, by_name)) for view, one in zip(views, self.images, strict=True)
            ]
        return views

    def _ask_images(self, model: Model, by_name: Mapping[str, float], paths: Sequence[str]) -> list[Predicted]:
        views = self.views(model, by_name)
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

    def irradiance_per_mm2(self, index: int, *, quiet: bool = False) -> Real:
        """Of an image, its discrepancies included; `quiet`: the twin's, without the noise of an anchor."""
        predicted = self.predicted[index]
        twin = predicted.twin_per_mm2 if quiet else None
        total = predicted.irradiance_per_mm2 if twin is None else twin
        for k, one in enumerate(self.problem.discrepancies):
            total = total + self.by_name[f"discrepancy.{k}"] * one.images_per_mm2[index]
        return total

    def signals_dn(self, change: Real | None = None, *, quiet: bool = False) -> list[Real]:
        """Expected signals above black of all images, after a small change of the values where one is given."""
        signals = []
        for index, image in enumerate(self.problem.images):
            offset_dn = self.by_name[f"{image.shot.id}.offset_dn"]
            signals.append(gain_of(image, self.by_name) * self.irradiance_per_mm2(index, quiet=quiet) + offset_dn)
            if change is not None:
                signals[-1] += np.tensordot(change, self._image_columns(index), axes=1)
        return signals

    def whitening(self) -> Whitening:
        """The whitening that this prediction asks for, the noise of its Monte Carlo included."""
        white = whitening(self.problem.images, self.signals_dn(quiet=True))
        noise = [
            None if one.noise_per_mm2 is None else gain_of(image, self.by_name) * one.noise_per_mm2
            for image, one in zip(self.problem.images, self.predicted, strict=True)
        ]
        sigmas = tuple(self._curve_sigma(k) for k in range(len(self.predicted_curves)))
        at = self.model if self.problem.anchor is None else self.problem.anchor.model  # whose histories they are
        runs = [run_of(image.sample, at) for image in self.problem.images]
        blocks = noise_blocks(white, runs, noise)
        return replace(white, noise=blocks, curve_sigma=sigmas)

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
        """Whitened derivatives of the prediction, (parameter, row), free of an anchor's noise."""
        images = [self._image_columns(index) for index in range(len(self.predicted))]
        blocks = [white.rows(images)] if images else []
        blocks += [
            self._curve_columns(index) / white.curve_sigma[index] for index in range(len(self.predicted_curves))
        ]
        return np.concatenate(blocks, axis=1)

    def others(self) -> list[Predicted]:
        """The derivatives by the model's parameters once more, by the exits of another walk inside the chips.

        Those of all light are the same: what noise they have is that of one run of Monte Carlo for both.
        """
        anchor = self.problem.anchor
        same = frozenset[str]().union(*(one.of_all_light for one in self.predicted))
        paths = [path for path in self.problem.unknowns.model_paths if path not in same]
        if anchor is None or not paths:
            return self.predicted
        views = self.problem.views(self.model, self.by_name)
        asked = replace(anchor, histories=0, exit_seed=anchor.exit_seed + 1)
        found = self.problem.predictor.images(self.model, views, paths, asked)
        return [
            replace(
                other,
                jacobian_per_mm2=other.jacobian_per_mm2
                | {path: one.jacobian_per_mm2[path] for path in one.of_all_light},
            )
            for one, other in zip(self.predicted, found, strict=True)
        ]

    def other_columns(self, white: Whitening, others: Sequence[Predicted]) -> Real:
        """The columns once more, with noise of their own that is independent but of all light's (`others`).

        Gains and poses by the anchored image, whose noise is none of the twin's.
        """
        predicted = [
            replace(
                one,
                twin_per_mm2=None,
                by_gain_per_mm2=_by_gain_anchored(one),
                jacobian_per_mm2=one.jacobian_per_mm2 | other.jacobian_per_mm2 | one.by_pose_per_mm2,
            )
            for one, other in zip(self.predicted, others, strict=True)
        ]
        return replace(self, predicted=predicted).columns(white)

    def carried(self, white: Whitening, values: Real) -> Real:
        """Whitened rows of what an anchor leaves unknown: by how much the twin's error may differ from that there.

        It is carried over as a share of the image's light; one that stays as it is differs by the change of that.
        """
        images = [self._carried_dn(index, values) for index in range(len(self.predicted))]
        rows = sum(len(curve.value) for curve in self.problem.curves)
        return np.pad(white.rows(images) if images else np.zeros(0), (0, rows))

    def _carried_dn(self, index: int, values: Real) -> Real:
        """Of one image; paths that the anchor's model does not have (of an effect that was added) are left out."""
        image, one, at = self.problem.images[index], self.predicted[index], self.problem.anchor
        change = np.zeros(image.signal_dn.shape)
        if at is None or one.twin_per_mm2 is None:
            return change
        here, there = self.problem.unknowns.named(values), numbers(at.model)
        for path in self.problem.unknowns.model_paths:
            change += (here[path] - float(there.get(path, here[path]))) * one.jacobian_per_mm2[path]
        light = np.maximum(one.twin_per_mm2, FAINT * one.twin_per_mm2.max())
        left = gain_of(image, self.by_name) * (one.irradiance_per_mm2 - one.twin_per_mm2)
        return np.asarray(left * change / light)

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
        columns[place[f"{shot}.offset_dn"]] = 1.0 if predicted.by_offset is None else predicted.by_offset
        by_gain = predicted.by_gain_per_mm2
        by_gain = self.irradiance_per_mm2(index, quiet=True) if by_gain is None else by_gain
        if tied(image):
            lit = image.shot.exposure_ms * by_gain
            columns[place["gain"]] = lit * (1.0 + self.by_name[f"{shot}.gain_error"])
            columns[place[f"{shot}.gain_error"]] = lit * self.by_name["gain"]
        else:
            columns[place[f"{shot}.gain"]] = by_gain
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


def _by_gain_anchored(one: Predicted) -> Real | None:
    """By the gain where a sensor bends signals, with the noise of the anchor; it is small, so that its bend is."""
    if one.by_gain_per_mm2 is None or one.twin_per_mm2 is None:
        return one.by_gain_per_mm2
    return one.by_gain_per_mm2 + one.irradiance_per_mm2 - one.twin_per_mm2


def sensor_of(image: MeasuredImage, values: Mapping[str, float]) -> Sensor:
    """What makes its signal of light, at these values of gain and offset."""
    full_scale_dn = image.camera.full_scale_dn - image.camera.black_level_dn
    return Sensor(gain_of(image, values), values[f"{image.shot.id}.offset_dn"], full_scale_dn)


def view_of(image: MeasuredImage, pose: Pose) -> View:
    """The camera of a measured image."""
    rows, columns = image.signal_dn.shape
    return View(image.sample, rows, columns, image.pixel_um, image.centre_px, pose)


def wrapped_deg(difference_deg: Real) -> Real:
    """Angles brought to -180 to 180."""
    return np.asarray((difference_deg + 180.0) % 360.0 - 180.0)
