"""The paper's virtual-realistic experiment: which kind of scatter and which reflectance look most like the images.

    single chips   substrate: Gaussian 0, 5, 10, 15 deg or Lambertian, reflectance 93 to 99 %     Fig. 5(a)
    chip arrays    receiver:  the same five, reflectance 20 to 40 %                               Fig. 5(b)

Each candidate is predicted about an anchor and brought to each image by the gain and the offset of least squares;
what is left is the mean square error of Eq. 1, and the candidate with the least is taken (Eq. 2). The two stages are
repeated until neither changes, or all pairs of candidates are tried at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from luxloop.model import Model, Surface
from luxloop.words import parse
from validation.fit.problem import ImagePredictor, sensor_of, view_of
from validation.measured import MeasuredImage
from validation.prediction import Anchored, Pose

Real = NDArray[np.float64]
Part = Literal["substrate", "receiver"]

MIRROR_DEG = 0.1
"""For the paper's Gaussian of 0 deg: a lobe whose width no camera sees."""
KINDS: dict[str, float | None] = {
    "Gaussian 0 deg": MIRROR_DEG,
    "Gaussian 5 deg": 5.0,
    "Gaussian 10 deg": 10.0,
    "Gaussian 15 deg": 15.0,
    "Lambertian": None,
}
"""The paper's five kinds of scatter, by name: the lobe's sigma in deg, none for Lambert's law."""
REFLECTANCES: dict[Part, tuple[float, ...]] = {
    "substrate": tuple(round(0.93 + 0.01 * i, 2) for i in range(7)),
    "receiver": tuple(round(0.20 + 0.05 * i, 2) for i in range(5)),
}
LAYOUTS: dict[Part, str] = {"substrate": "single", "receiver": "array"}
NAMES: dict[Part, str] = {"substrate": "single chips: the substrate", "receiver": "chip arrays: the receiver"}
JOINT: dict[Part, str] = {
    "substrate": "all images: the substrate, with the best receiver",
    "receiver": "all images: the receiver, with the best substrate",
}
PARTS: tuple[Part, Part] = ("substrate", "receiver")
ERRORS = ("mse", "mse_dn2", "chi2_per_pixel")
MOST_ROUNDS = 6

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Candidate:
    """A kind of scatter and a reflectance of one surface."""

    part: Part
    kind: str
    reflectance: float

    def applied(self, model: Model) -> Model:
        """The model with that surface; a fit of what it does not have (a Lambertian's sigma) is dropped, and one with
        limits that do not hold what it has."""
        sigma_deg = KINDS[self.kind]
        scatter = "lambertian" if sigma_deg is None else "gaussian"
        surface = parse(Surface, {"scatter": scatter, "sigma_deg": sigma_deg, "reflectance": self.reflectance})
        prefix = f"environment.{self.part}."
        fit = {
            path: one for path, one in model.fit.items() if not path.startswith(prefix) or _holds(one, path, surface)
        }
        environment = model.environment.model_copy(update={self.part: surface})
        return model.model_copy(update={"environment": environment, "fit": fit})

    def __str__(self) -> str:
        return f"{self.kind}, {100.0 * self.reflectance:g} %"


@dataclass(frozen=True)
class Tried:
    """What a candidate came to: Eq. 1 with images scaled to the measured maximum, in DN^2, and chi2 per pixel."""

    candidates: tuple[Candidate, ...]
    mse: float
    mse_dn2: float
    chi2_per_pixel: float


@dataclass(frozen=True)
class Stage:
    """All candidates of one surface, on the images of one layout, or on all with the best of the other surface."""

    part: Part
    tried: tuple[Tried, ...]
    name: str

    @property
    def best(self) -> Tried:
        """Eq. 2."""
        return min(self.tried, key=lambda one: one.mse)

    def document(self) -> dict[str, Any]:
        """Curves of the error against the reflectance, one for each kind of scatter, as in Fig. 5."""
        curves = []
        for kind in KINDS:
            of_kind = [one for one in self.tried if one.candidates[-1].kind == kind]
            if of_kind:
                curves.append({
                    "label": kind,
                    "x": [one.candidates[-1].reflectance for one in of_kind],
                    **{name: [getattr(one, name) for one in of_kind] for name in ERRORS},
                })  # fmt: skip
        best = self.best.candidates[-1]
        return {
            "name": self.name,
            "parameter": f"environment.{self.part}.reflectance",
            "curves": curves,
            "best": {"label": best.kind, "x": best.reflectance, "mse": self.best.mse},
        }


@dataclass(frozen=True)
class Experiment:
    """The images, where their modules lie in them, who predicts, and about which model.

    Candidates are differences of the twin about one anchor, with the exits of its chips: noise is then the same for
    all, and does not decide between them.
    """

    images: Sequence[MeasuredImage]
    poses: Mapping[str, Pose]
    values: Mapping[str, float]
    """Of the fit before, by name: gains and offsets, which sensors' effects depend on."""
    predictor: ImagePredictor
    anchor: Anchored

    def of_layout(self, layout: str) -> list[MeasuredImage]:
        """The images of single chips, or of arrays."""
        return [image for image in self.images if image.sample.layout == layout]

    def tried(self, model: Model, candidates: Sequence[Candidate], images: Sequence[MeasuredImage]) -> Tried:
        """The errors of a model with these surfaces, means over the images."""
        for candidate in candidates:
            model = candidate.applied(model)
        views = [view_of(image, self.poses[image.shot.id]) for image in images]
        if model.effects:
            sensors = [sensor_of(image, self.values) for image in images]
            views = [replace(view, sensor=sensor) for view, sensor in zip(views, sensors, strict=True)]
        anchor = replace(self.anchor, poses=tuple(self.poses[image.shot.id] for image in images))
        found = self.predictor.images(model, views, (), anchor)
        errors = [errors_of(image, one.irradiance_per_mm2) for image, one in zip(images, found, strict=True)]
        return Tried(tuple(candidates), *(float(mean) for mean in np.mean(errors, axis=0)))

    def stage(self, model: Model, part: Part, progress: Progress) -> Stage:
        """All candidates of a surface. Raises InputError where no image shows what decides about it."""
        images = self.of_layout(LAYOUTS[part])
        if not images:
            value, allowed = f"no image of layout {LAYOUTS[part]}", f"images of layout {LAYOUTS[part]}"
            raise InputError("DATASET", value, allowed, f"they decide about the {part}; --fit-only leaves this out")
        candidates = [Candidate(part, kind, one) for kind, one in product(KINDS, REFLECTANCES[part])]
        tried = []
        for number, candidate in enumerate(candidates):
            progress(number / len(candidates), f"{part}: {candidate}")
            tried.append(self.tried(model, [candidate], images))
        return Stage(part, tuple(tried), NAMES[part])

    def in_turn(self, model: Model, progress: Progress) -> Iterator[tuple[Model, Stage]]:
        """Substrate, receiver, substrate, ... until neither changes; the model after each stage.

        Raises InputError where `MOST_ROUNDS` were not enough.
        """
        chosen: dict[Part, tuple[Candidate, ...]] = {}
        for number in range(2 * MOST_ROUNDS):
            part = PARTS[number % 2]
            stage = self.stage(model, part, progress)
            same = chosen.get(part) == stage.best.candidates
            chosen[part] = stage.best.candidates
            model = stage.best.candidates[0].applied(model)
            yield model, stage
            if same:
                return
        raise InputError("DATASET", f"{MOST_ROUNDS} rounds", "surfaces that settle", "try all pairs at once: --joint")

    def joint(self, model: Model, progress: Progress) -> tuple[Stage, Stage]:
        """All pairs of substrate and receiver on all images; for each candidate of either, the best of the other."""
        both = [[Candidate(part, *one) for one in product(KINDS, REFLECTANCES[part])] for part in PARTS]
        tried = []
        for number, pair in enumerate(pairs := list(product(*both))):
            progress(number / len(pairs), "; ".join(map(str, pair)))
            tried.append(self.tried(model, pair, self.images))
        return _least(tried, 0), _least(tried, 1)


def _least(tried: Sequence[Tried], which: int) -> Stage:
    """The stage of one surface among pairs: each of its candidates with the best of the other surface."""
    best: dict[Candidate, Tried] = {}
    for one in tried:
        own, other = one.candidates[which], one.candidates[1 - which]
        if own not in best or one.mse < best[own].mse:
            best[own] = replace(one, candidates=(other, own))
    return Stage(PARTS[which], tuple(best.values()), JOINT[PARTS[which]])


def errors_of(image: MeasuredImage, irradiance_per_mm2: Real) -> tuple[float, float, float]:
    """MSE (images scaled to the measured maximum), MSE in DN^2, chi2 per pixel, each after its best gain and offset.

    `irradiance_per_mm2` (row, column) as predicted; unused pixels do not count. Eq. 1 of the paper is least for the
    plain gain and offset; chi2 for those that weigh pixels by their noise.
    """
    measured, predicted = image.signal_dn[image.used], irradiance_per_mm2[image.used]
    gain, offset = line_of(predicted, measured, np.ones_like(measured))
    mse_dn2 = float(np.mean((measured - gain * predicted - offset) ** 2))
    variance = image.noise_dn2(gain * irradiance_per_mm2 + offset)[image.used]
    gain, offset = line_of(predicted, measured, 1.0 / variance)
    chi2 = float(np.mean((measured - gain * predicted - offset) ** 2 / variance))
    return mse_dn2 / float(measured.max()) ** 2, mse_dn2, chi2


def line_of(x: Real, y: Real, weight: Real) -> tuple[float, float]:
    """Slope and intercept of y against x by weighted least squares, all (pixel,)."""
    root = np.sqrt(weight)
    (slope, intercept), *_ = np.linalg.lstsq(
        np.stack([x, np.ones_like(x)], axis=1) * root[:, None], y * root, rcond=None
    )
    return float(slope), float(intercept)


def _holds(one: Any, path: str, surface: Surface) -> bool:
    """Whether the limits of a fit hold the surface's value."""
    value = getattr(surface, path.rpartition(".")[2])
    return isinstance(value, float) and bool(one.lower <= value <= one.upper)
