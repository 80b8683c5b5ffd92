"""A made-up effect that the twin cannot represent, for refits: its images, a fit without it, its score there.

It multiplies the light by 1 + (s + 8 s^2) p, p a ripple over the place: it grows faster than its size, as walls do,
where light that was sent back comes to a wall again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import AppliedEffect
from luxloop.model import Model
from tests.validation.analytic import ARRAY, MODEL, PATHS, SINGLE, Spots, blank
from tests.validation.diagnose.made_up import GAIN, THIRD, seen, spec
from validation.dataset.manifest import Sample
from validation.diagnose.score import Candidate, Score
from validation.effects.known import applied, with_effect
from validation.effects.signatures import Column, Projection
from validation.fit import Fit, fit
from validation.fit.problem import view_of
from validation.measured import MeasuredImage
from validation.prediction import Anchored, Pose, Predicted, View
from validation.sample_values import of_sample, with_sample

Real = NDArray[np.float64]

RIPPLE = spec("ripple").model_copy(update={"twin": False})
TRUTH = 0.05
ANCHORED = 1_000_000
HIDDEN = MODEL.model_copy(update={"effects": (AppliedEffect(name="ripple", parameters={"size": TRUTH}),)})
H = 1e-4
"""By which the made-up effect is moved for its column at off."""


def strength(size: float) -> float:
    """Of the ripple, at a size of the effect."""
    return size + 8.0 * size**2


def traced(model: Model, view: View, light: Real) -> Real:
    """What Monte Carlo makes of light under the model's effect."""
    effects = of_sample(model, view.sample.id).effects
    sizes = [float(one.parameters["size"]) for one in effects]  # type: ignore[arg-type]  # a number here
    ripple = AppliedEffect(name="ripple", parameters={"size": strength(*sizes) if sizes else 0.0})
    return seen(MODEL.model_copy(update={"effects": (ripple,)}), view, light)


class Anchors(Spots):
    """Spots whose twin knows no effect: an image has that of the model at which Monte Carlo was run."""

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """As workers answer; ValueError for an effect without an anchor, which they refuse."""
        if model.effects and anchor is None:
            raise ValueError("the twin cannot represent ripple")
        at = anchor.model if anchor is not None and anchor.histories else MODEL
        found = []
        for view, twin in zip(views, super().images(model, views, paths), strict=True):
            (there,) = super().images(at, [view])
            effect = traced(at, view, there.irradiance_per_mm2) - there.irradiance_per_mm2
            light = twin.irradiance_per_mm2
            one = replace(twin, irradiance_per_mm2=light + effect, twin_per_mm2=light)
            found.append(one)
        self.anchors.append(anchor)
        return found


def data(**own: float) -> list[MeasuredImage]:
    """Three images with the effect at its true size, or at that which samples have of their own, with noise."""
    model = with_effect(MODEL, applied(RIPPLE, {"size": 0.0 if own else TRUTH}))
    for sample, size in own.items():
        model = with_sample(model, sample, "ripple", {"size": size})

    def light(view: View) -> Real:
        (one,) = Spots().images(MODEL, [view])
        return traced(model, view, one.irradiance_per_mm2)

    return noisy(light, 4, ("third", THIRD))


def noisy(light: Callable[[View], Real], seed: int, *more: tuple[str, Sample]) -> list[MeasuredImage]:
    """Images of this light with noise: a single chip, an array, and more samples."""
    random, images = np.random.default_rng(seed), []
    for shot, sample in (("single", SINGLE), ("array", ARRAY), *more):
        image = blank(shot, sample, side=32)
        signal = GAIN * light(view_of(image, Pose())) + 20.0
        noise = np.sqrt(image.variance_dn2(signal)) * random.standard_normal(signal.shape)
        images.append(replace(image, signal_dn=signal + noise))
    return images


def score_of(base: Fit) -> Score:
    """What the effect's column at off finds in the residual of a fit without it."""
    parts = []
    for image in base.problem.images:
        view = view_of(image, base.poses[image.shot.id])
        (light,) = Spots().images(base.model, [view])
        parts.append(traced(with_effect(MODEL, applied(RIPPLE, {"size": H})), view, light.irradiance_per_mm2))
        parts[-1] = (parts[-1] - light.irradiance_per_mm2) / H
    column = Projection.of(base).rows(Column("ripple", "size", {}, None, H, tuple(parts)))
    left = column - base.basis.data @ (base.basis.data.T @ column)
    z, length = float(left @ base.residual / np.linalg.norm(left)), float(np.linalg.norm(left))
    candidate = Candidate(RIPPLE, RIPPLE.parameters[0], (), column[None], tuple(parts))
    return Score(candidate, z, z / length, 1.0 / length, length / float(np.linalg.norm(column)))


def smooth_score_of(base: Fit) -> Score:
    """The same of a ripple that the twin knows."""
    score = score_of(base)
    return replace(score, candidate=replace(score.candidate, effect=spec("ripple")))


def base_fit(**own: float) -> Fit:
    """The fit without the effect, about Monte Carlo where it stands; `own`: what samples have of it, as `data`."""
    return fit(MODEL, data(**own), Anchors(), free=PATHS, anchor_at=lambda model: Anchored(model, ANCHORED, seed=7))
