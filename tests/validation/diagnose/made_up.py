"""A made-up catalogue over the closed-form predictor: every effect multiplies the image by a pattern of the place.

ripple, ripple_like   1 + a cos(2 pi (x + 2 y) / 350 um), and nearly the same
fog                   (1 - s^2) E + s^2 E blurred by 3 px: only s^2 has a slope
stripes               1 + a cos(2 pi x / L): L shapes it
lines                 1 + a cos(2 pi u / 300 um), u = x or y: a word shapes it
chips                 1 + (g + 3 g^2 cos(2 pi y / 150 um)) exp(-d^2 / 2 (100 um)^2) about each of three chips
rise                  1 + (a x + b y) / 500 um: two numbers act
flipped               upside down, or as is
spiral                1 + a cos(3 phi): not in the catalogue, for what nobody knows
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from luxloop.effect import AppliedEffect, EffectParameter, EffectSpec, Value
from luxloop.model import Model
from tests.validation.analytic import ARRAY, MODEL, PATHS, SINGLE, Spots, blank
from validation.diagnose.by_sample import with_own_values
from validation.diagnose.columns import FitSight, candidates_of, in_shape
from validation.diagnose.diagnosis import Means, diagnosed
from validation.diagnose.ground import Ground
from validation.diagnose.proposal import Proposal
from validation.diagnose.rounds import Diagnosis
from validation.diagnose.score import Candidate
from validation.effects.signatures import Column, Projection, signature
from validation.fit import Fit, fit
from validation.measured import MeasuredImage
from validation.prediction import Anchored, Predicted, View
from validation.sample_values import LEAD, numbers, of_sample, with_number

Real = NDArray[np.float64]
GAIN = 300.0
THIRD = ARRAY.model_copy(update={"id": "third", "dbr_pairs": 2.5})


def spec(name: str, *more: EffectParameter, square: bool = False) -> EffectSpec:
    """An effect with a size, and what shapes it."""
    size = EffectParameter(
        name="size", description="of it", lower=0.0 if square else -0.5, upper=0.5, off=0.0,
        score_variable="square" if square else "value", one_sided=square,
    )  # fmt: skip
    return EffectSpec(name=name, stage="detector", description=name, parameters=(size, *more))


LENGTH = EffectParameter(
    name="length_um", description="of a stripe", unit="um", lower=50.0, upper=900.0, shape_grid=(200.0, 300.0, 450.0)
)
ANOTHER = Proposal("another", THIRD, 1.0, 9.0, 2.0)
"""What is always proposed where rivals cannot be told apart."""
CHIPS = EffectSpec(
    name="chips", stage="emission", description="gains", scope="per_sample",
    parameters=(
        EffectParameter(name="gain", description="of a chip", lower=-0.5, upper=0.5, off=0.0, per_chip=True),
    ),
)  # fmt: skip
RISE = EffectSpec(
    name="rise", stage="detector", description="two numbers",
    parameters=tuple(
        EffectParameter(name=name, description="along an axis", lower=-0.5, upper=0.5, off=0.0) for name in "ab"
    ),
)  # fmt: skip
FLIPPED = EffectSpec(
    name="flipped", stage="detector", description="there or not", discrete=True,
    parameters=(EffectParameter(name="way", description="round", choices=("as is", "flipped"), off="as is"),),
)  # fmt: skip
CATALOGUE = (spec("ripple"), spec("ripple_like"), spec("fog", square=True), spec("stripes", LENGTH))


class Affected(Spots):
    """Predicts the spots with the model's effects on them."""

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """As `Spots`; derivatives by effects are differences."""
        own = [path for path in paths if not path.startswith(("effects.", LEAD))]
        found = super().images(model, views, own, anchor)
        affected = []
        for view, one in zip(views, found, strict=True):
            columns = {name: seen(model, view, part) for name, part in one.jacobian_per_mm2.items()}
            free = model.model_copy(update={"fit": {}})  # a step goes beyond a limit
            for path in set(paths) - set(own):
                value, moving = numbers(model)[path], model if path.startswith(LEAD) else free
                up, down = (
                    seen(with_number(moving, path, value + by), view, one.irradiance_per_mm2) for by in (1e-4, -1e-4)
                )
                columns[path] = (up - down) / 2e-4
            affected.append(
                replace(one, irradiance_per_mm2=seen(model, view, one.irradiance_per_mm2), jacobian_per_mm2=columns)
            )
        return affected

    def several(self, wanted: Sequence[tuple[Model, View]], lender: Model, exit_seed: int = 1) -> list[Real]:  # noqa: ARG002  # no chips
        """As the predictor's."""
        return [self.images(model, [view])[0].irradiance_per_mm2 for model, view in wanted]


def seen(model: Model, view: View, image: Real) -> Real:
    """An image with the model's effects."""
    rows, columns = np.indices(image.shape)
    x, y = (columns - view.centre_px[1]) * view.pixel_um, (rows - view.centre_px[0]) * view.pixel_um
    for effect in of_sample(model, view.sample.id).effects:
        if effect.name == "chips":
            for gain, centre in zip(effect.parameters["gain"], (-200.0, 0.0, 200.0), strict=False):  # type: ignore[arg-type]  # a list
                bent = gain + 3.0 * gain**2 * np.cos(2.0 * np.pi * y / 150.0)
                image = image * (1.0 + bent * np.exp(-((x - centre) ** 2 + y**2) / 2e4))
            continue
        if effect.name == "flipped":
            image = image[::-1] if effect.parameters["way"] == "flipped" else image
            continue
        if effect.name == "rise":
            a, b = (float(effect.parameters[name]) for name in ("a", "b"))  # type: ignore[arg-type]  # numbers
            image = image * (1.0 + (a * x + b * y) / 500.0)
            continue
        size = float(effect.parameters["size"])  # type: ignore[arg-type]  # a number in this catalogue
        if effect.name == "fog":
            image = (1.0 - size**2) * image + size**2 * gaussian_filter(image, 3.0)
            continue
        length = float(effect.parameters.get("length_um", 0.0))  # type: ignore[arg-type]
        pattern = {
            "ripple": lambda: np.cos(2.0 * np.pi * (x + 2.0 * y) / 350.0),
            "ripple_like": lambda: np.cos(2.0 * np.pi * (x + 2.0 * y) / 354.0),
            "stripes": lambda: np.cos(2.0 * np.pi * x / length),  # noqa: B023
            "lines": lambda: np.cos(2.0 * np.pi * (x if effect.parameters["along"] == "x" else y) / 300.0),  # noqa: B023
            "spiral": lambda: np.cos(3.0 * np.arctan2(y, x)),
        }[effect.name]()
        image = image * (1.0 + size * pattern)
    return image


def data(
    name: str | None, seed: int, size: float = 0.0, length_um: float | None = None, **words: str
) -> list[MeasuredImage]:
    """Three images of the spots, with an effect hidden in them; rectangles of three samples, with noise."""
    parameters = {"size": size, **words} | ({} if length_um is None else {"length_um": length_um})
    hidden = () if name is None else (AppliedEffect(name=name, parameters=parameters),)
    return images_of(MODEL.model_copy(update={"effects": hidden}), seed)


def images_of(truth: Model, seed: int) -> list[MeasuredImage]:
    """Three images of a model, with noise."""
    random = np.random.default_rng(seed)
    images = []
    for shot, sample in (("single", SINGLE), ("array", ARRAY), ("third", THIRD)):
        image = blank(shot, sample, side=40)
        view = View(sample, 40, 40, image.pixel_um, image.centre_px)
        (light,) = Affected().images(truth, [view])
        signal = GAIN * light.irradiance_per_mm2 + 20.0
        images.append(
            replace(
                image, signal_dn=signal + np.sqrt(image.variance_dn2(signal)) * random.standard_normal(signal.shape)
            )
        )
    return images


def noise_percent(found: Fit) -> float:
    """What a right model leaves in the images: rms of the camera's noise over the mean signal, in percent."""
    several = list(zip(found.problem.images, found.signals_dn, strict=True))
    variance = np.concatenate([image.noise_dn2(signal)[image.used] for image, signal in several])
    level = np.mean(np.concatenate([signal[image.used] for image, signal in several]))
    return float(100.0 * np.sqrt(np.mean(variance)) / level)


def hidden(effect: str, common: Mapping[str, Value], **samples: Mapping[str, Value]) -> Model:
    """A truth in which samples have their own of an effect."""
    return MODEL.model_copy(
        update={
            "effects": (AppliedEffect(name=effect, parameters=dict(common)),),
            "samples": {name: {effect: dict(values)} for name, values in samples.items()},
        }
    )


def columns_at(found: Fit, spec: EffectSpec, shape: Mapping[str, Value]) -> list[Column]:
    """The columns of each sample, about a fit."""
    return signature(FitSight.of(found, Affected()), found.model, spec, shape, apart=True)  # type: ignore[arg-type]  # duck


def members_fit(found: Fit, spec: EffectSpec) -> Fit:
    """The fit with a group."""
    return with_own_values(found, spec, columns_at)


def ground_of(found: Fit) -> Ground:
    """The structure of a fit."""
    return Ground.of(found, 2000, 1)


def diagnosis(
    images: Sequence[MeasuredImage], model: Model = MODEL, known: Sequence[EffectSpec] = CATALOGUE
) -> Diagnosis:
    """The verdict on images."""
    predictor = Affected()
    base = fit(model, images, predictor, free=PATHS)

    def signatures(at: Fit, effects: Sequence[EffectSpec]) -> list[Candidate]:
        sight = FitSight.of(at, predictor)  # type: ignore[arg-type]  # it predicts as a predictor does
        return candidates_of(at, effects, sight)

    def shaped(at: Fit, effect: EffectSpec, shape: dict[str, Value]) -> list[Candidate]:
        return list(in_shape(at, effect, shape, FitSight.of(at, predictor), Projection.of(at)))  # type: ignore[arg-type]  # duck

    means = Means(signatures, signatures, shaped, members_fit, ground_of, lambda *_: [ANOTHER])
    return diagnosed(ground_of(base), known, means)
