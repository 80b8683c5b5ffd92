"""Does calibration find the truth, and does the test of structure cry wolf? On images by Monte Carlo, not the twin.

    python benchmarks/calibration_study.py [--truths 20] [--draws 15] [--histories 2000000] [--anchor 4000000]

Each truth has its own reflectances and loss. Its six images (single chips and 5 x 5, 0, 2.5 and 5.5 pairs, the
declared camera) come of Monte Carlo; the fit is told the noise that this left in them (a laboratory's light does
not run out). Three parameters are fitted, without priors, about an anchor of its own random numbers; then further
noise is drawn on the same truth, without and with a fixed pattern of 1 %, and fitted on the linear model there.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from benchmarks.cells import load, scene_for
from containers.ray_tracing.light import unweighed
from containers.ray_tracing.monte_carlo import MonteCarlo, blocks_of
from containers.ray_tracing.twin.noise import noise_columns
from containers.ray_tracing.twin.prediction import Shot, bases_of, image_of
from containers.scene import Array
from luxloop.camera import Camera
from luxloop.client import Client
from luxloop.model import Fit as Limits
from luxloop.model import Model
from luxloop.model_file import find_model
from luxloop.settings import load_settings
from validation.contrasts import structure
from validation.dataset.manifest import CameraFacts, ImageShot, Sample
from validation.dataset.simulate import DECLARED, expected_images, paper_plan, views_of
from validation.fit import Fit, fit
from validation.fit.problem import ImagePredictor, view_of
from validation.measured import MeasuredImage
from validation.noise import draw
from validation.prediction import Anchored, Predicted, Predictor, View

Real = NDArray[np.float64]

BINNING, PIXELS = 3, 126
FREE = {
    "environment.substrate.reflectance": (0.94, 0.985),
    "environment.receiver.reflectance": (0.27, 0.42),
    "environment.chip_absorption_per_cm": (130.0, 280.0),
}
"""What is fitted, and between which limits truths are drawn."""
START = {"environment.substrate.reflectance": 0.965, "environment.receiver.reflectance": 0.35,
         "environment.chip_absorption_per_cm": 200.0}  # fmt: skip
PATTERN_PERCENT = 1.0
STRUCTURE_DRAWS = 2000


@dataclass(frozen=True)
class Truth:
    """A model, the light of its samples by Monte Carlo (view, row, column), and the noise left in that."""

    model: Model
    light: tuple[Real, ...]
    noise: tuple[Real, ...]


class Told:
    """A predictor that adds the truth's own noise to what it says of its noise."""

    def __init__(self, predictor: ImagePredictor, truth: Truth) -> None:
        self._predictor, self._truth = predictor, truth

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """As the predictor."""
        found = self._predictor.images(model, views, paths, anchor)
        if anchor is None or not anchor.histories:
            return found
        return [
            replace(one, noise_per_mm2=np.concatenate([one.noise_per_mm2, more]))
            for one, more in zip(found, self._truth.noise, strict=True)
            if one.noise_per_mm2 is not None
        ]


class Linear:
    """Predicts by the derivatives at a fit: what another draw of noise moves is small."""

    def __init__(self, at: Fit, predictor: ImagePredictor) -> None:
        problem = at.problem
        paths = (*problem.unknowns.model_paths, "shift_row_px", "shift_column_px", "rotation_deg")
        views = [view_of(one, at.poses[one.shot.id]) for one in problem.images]
        self._views, self._model = views, at.model
        self._found = predictor.images(at.model, views, paths, problem.anchor)

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """The images."""
        del paths, anchor  # always all derivatives, always about the fit's own anchor
        moved = []
        here, there = self._model.leaves(), model.leaves()
        for view, at, found in zip(views, self._views, self._found, strict=True):
            change = {path: there[path] - here[path] for path in FREE}
            change["shift_row_px"] = view.pose.shift_px[0] - at.pose.shift_px[0]
            change["shift_column_px"] = view.pose.shift_px[1] - at.pose.shift_px[1]
            change["rotation_deg"] = view.pose.rotation_deg - at.pose.rotation_deg
            image = found.irradiance_per_mm2 + sum(by * found.jacobian_per_mm2[path] for path, by in change.items())
            moved.append(replace(found, irradiance_per_mm2=image))
        return moved


def truth_of(model: Model, samples: Sequence[Sample], histories: int, seed: int) -> Truth:
    """The images of a model's samples by Monte Carlo, twice as many histories for an array."""
    light, noise = [], []
    for number, sample in enumerate(samples):
        scene = scene_for(model.environment, sample.design)
        array = Array.regular(sample.rows, sample.columns, sample.spacing_um, sample.half_um)
        scene = replace(scene, layout=array)
        solver = MonteCarlo(scene, 1000 * seed + number)
        tally = solver.run_to(blocks_of(histories * (2 if sample.layout == "array" else 1)))
        field = unweighed(tally, scene)
        camera = Camera(rows=PIXELS // BINNING, columns=PIXELS // BINNING, pixel_um=DECLARED.pixel_um * BINNING)
        shot = Shot(scene, camera)
        groups = image_of(field.grid, shot)
        mean, count = groups.mean(axis=0), len(groups)
        (basis,) = bases_of([shot], [field], mean[None])
        light.append(mean)
        noise.append(noise_columns((groups - mean) / np.sqrt(count * (count - 1.0)), basis, basis))
    return Truth(model, tuple(light), tuple(noise))


def measured(truth: Truth, samples: Sequence[Sample], camera: CameraFacts, seed: int) -> list[MeasuredImage]:
    """Images with the noise of the camera, drawn in binned pixels: a bin is a pixel of nine times the well."""
    views = [replace(view, rows=42, columns=42, pixel_um=24.0, centre_px=(20.5, 20.5)) for view in
             views_of(paper_plan(), seed)]  # fmt: skip
    expected = expected_images(views, truth.light, camera)
    images = []
    for number, (one, sample) in enumerate(zip(expected, samples, strict=True)):
        nine = np.repeat(np.repeat(one.signal_dn, BINNING, axis=0), BINNING, axis=1)
        raw = draw(nine, camera, seed=seed, shot=number) - camera.black_level_dn
        signal = raw.reshape(42, BINNING, 42, BINNING).mean(axis=(1, 3))
        like, bins = np.ones_like(signal), BINNING**2
        shot = ImageShot(
            id=sample.id, kind="image", sample=sample.id, file="images/none.tif", exposure_ms=one.exposure_ms
        )
        images.append(MeasuredImage(
            shot=shot, sample=sample, camera=camera, signal_dn=signal, used=np.ones(signal.shape, bool),
            constant_dn2=camera.dark_variance_dn2 / bins * like, slope_dn=camera.gain_dn_per_e / bins * like,
            dark_dn2=0.0 * like, prnu=camera.prnu_percent / 100.0 / BINNING, binning=BINNING, pixel_um=24.0,
            centre_px=(20.5, 20.5), saturated=0, masked=0,
        ))  # fmt: skip
    return images


def start_model() -> Model:
    """Where all fits begin: the shipped model without priors."""
    model = find_model("paper")
    limits = {"environment.substrate.reflectance": (0.85, 1.0), "environment.receiver.reflectance": (0.1, 0.6),
              "environment.chip_absorption_per_cm": (10.0, 600.0)}  # fmt: skip
    fits = {path: Limits(free=True, lower=low, upper=high) for path, (low, high) in limits.items()}
    model = model.model_copy(update={"fit": fits})
    for path, value in START.items():
        model = model.with_value(path, value)
    return model


def share(count: int, of: int) -> str:
    """A share in percent with its Clopper-Pearson interval of 95 %."""
    low = beta.ppf(0.025, count, of - count + 1) if count else 0.0
    high = beta.ppf(0.975, count + 1, of - count) if count < of else 1.0
    return f"{100.0 * count / of:5.1f} % ({count} of {of}; {100.0 * low:.1f} to {100.0 * high:.1f})"


def main() -> None:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("truths", 20), ("draws", 15), ("histories", 2_000_000), ("anchor", 4_000_000)):
        parser.add_argument(f"--{name}", type=int, default=default)
    asked = parser.parse_args()
    samples, model = paper_plan().samples, start_model()
    rng = np.random.default_rng(20260)
    pulls: dict[str, list[float]] = {path: [] for path in FREE}
    first: dict[str, list[float]] = {path: [] for path in FREE}
    alarms: dict[str, list[float]] = {"without a pattern": [], f"pattern of {PATTERN_PERCENT:g} %": []}
    untrusted, began_s, model_noise = 0, time.perf_counter(), []
    with Client(load_settings(), patience_s=300.0) as client:
        predictor = Predictor(client)
        for number in range(asked.truths):
            at = model
            for path, (low, high) in FREE.items():
                at = at.with_value(path, float(rng.uniform(low, high)))
            truth = truth_of(at, samples, asked.histories, 100 + number)
            told = Told(predictor, truth)
            images = measured(truth, samples, DECLARED, 10_000 * (number + 1))
            found = fit(model, images, told, anchor_at=partial(anchor_of, asked.anchor, 7 + number))
            model_noise.append(float(np.sqrt((found.noise**2).sum(axis=0).mean())))
            keep(found, at, first)
            linear = Linear(found, told)
            for pattern, name in zip((0.0, PATTERN_PERCENT), alarms, strict=True):
                camera = DECLARED.model_copy(update={"prnu_percent": pattern})
                for turn in range(asked.draws):
                    seed = 10_000 * (number + 1) + 100 + turn + 50 * (pattern > 0.0)
                    one = fit(found.model, measured(truth, samples, camera, seed), linear,
                              anchor_at=lambda m: Anchored(m, 1))  # fmt: skip
                    untrusted += not one.trusted
                    alarms[name].append(structure(one, draws=STRUCTURE_DRAWS, seed=seed).p)
                    if not pattern:
                        keep(one, at, pulls)
            pull = ", ".join(f"{first[path][-1]:+.2f}" for path in FREE)
            print(
                f"truth {number + 1}: {time.perf_counter() - began_s:.0f} s, pulls of its full fit {pull}", flush=True
            )
    tell(pulls, first, alarms, untrusted, model_noise)


def anchor_of(histories: int, seed: int, model: Model) -> Anchored:
    """The anchor of a truth's fit."""
    return Anchored(model, histories, seed)


def keep(found: Fit, truth: Model, pulls: dict[str, list[float]]) -> None:
    """Value less truth over its error."""
    for path in FREE:
        pulls[path].append((found.value(path) - truth.leaves()[path]) / found.error(path))


def tell(pulls: Any, first: Any, alarms: Any, untrusted: int, model_noise: Sequence[float]) -> None:
    """The tables."""
    print(f"\n{load()}; noise of the Monte Carlo in all images: {np.mean(model_noise):.2f} of the camera's, rms")
    print("95 % intervals that hold the truth")
    for path in FREE:
        inside = np.abs(pulls[path]) < 1.96
        alone = np.abs(first[path]) < 1.96
        print(f"  {path:38} {share(int(inside.sum()), inside.size)}; full fits {share(int(alone.sum()), alone.size)}")
    every = np.abs([one for path in FREE for one in pulls[path]]) < 1.96
    print(f"  {'all three':38} {share(int(every.sum()), every.size)}")
    print("alarms of the structure test, nothing hidden")
    for name, found in alarms.items():
        p = np.array(found)
        one, five = (share(int((p < level).sum()), p.size) for level in (0.01, 0.05))
        print(f"  {name:20} at 1 %: {one}; at 5 %: {five}")
    print(f"fits not trusted: {untrusted}")


if __name__ == "__main__":
    main()
