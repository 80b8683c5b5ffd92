"""Does calibration find the truth, and does the test of structure cry wolf? On images by Monte Carlo, not the twin.

    python -m benchmarks.calibration_study [--truths 20] [--draws 15] [--resume FILE] [--effects]

Each truth has its own reflectances and loss. Its six images (single chips and 5 x 5, 0, 2.5 and 5.5 pairs, the
declared camera) come of Monte Carlo; the fit is told the noise that this left in them (a laboratory's light does
not run out). Three parameters are fitted, without priors, about an anchor of its own random numbers; then further
noise is drawn on the same truth, without and with a fixed pattern of 1 %, and fitted on the linear model there. Draws
on one truth share its Monte Carlo and that of its anchor: intervals are therefore given with whole truths drawn
again, too. With --resume, truths found in the file are not computed again.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
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
from validation.comparing import Solver
from validation.contrasts.null import Variances, null
from validation.contrasts.structure import fit_layout, judged
from validation.dataset.manifest import CameraFacts, ImageShot, Sample
from validation.dataset.simulated_images import expected_images, views_of
from validation.dataset.simulation_plan import DECLARED, paper_plan
from validation.diagnose.explanation import LEVEL
from validation.diagnose.score import Projected, scores
from validation.diagnose.verdict import is_visible
from validation.diagnosing import Diagnosing
from validation.effects.known import Known
from validation.fit import Fit, fit
from validation.fit.descent import crossed, linearised
from validation.fit.problem import Evaluation
from validation.fit.result import conclude
from validation.measured import MeasuredImage
from validation.noise import draw
from validation.observed import Observed
from validation.prediction import Anchored, Predictor

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
PATTERNS_PERCENT = (0.0, 1.0)
NULL_DRAWS = 10_000


@dataclass(frozen=True)
class Truth:
    """A model, the light of its samples by Monte Carlo (view, row, column), and the noise left in that."""

    model: Model
    light: tuple[Real, ...]
    noise: tuple[Real, ...]


def truth_of(model: Model, samples: Sequence[Sample], histories: int, seed: int) -> Truth:
    """The images of a model's samples by Monte Carlo, twice as many histories for an array."""
    light, noise = [], []
    for number, sample in enumerate(samples):
        scene = scene_for(model.environment, sample.design)
        array = Array.regular(sample.rows, sample.columns, sample.spacing_um, sample.half_um())
        scene = replace(scene, layout=array)
        solver = MonteCarlo(scene, 1000 * seed + number)
        tally = solver.run_to(blocks_of(histories * (2 if sample.layout == "array" else 1)))
        field = unweighed(tally, scene)
        camera = Camera(rows=PIXELS // BINNING, columns=PIXELS // BINNING, pixel_um=DECLARED.pixel_um * BINNING)
        shot = Shot(scene, camera)
        groups = image_of(field.grid, shot)
        mean, count = groups.mean(axis=0), len(groups)
        _, (basis,) = bases_of([shot], [field], mean[None])
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
            centre_px=(20.5, 20.5), saturated=0, masked=0, raw_pixels=nine.size,
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


def truths_model(number: int) -> Model:
    """The model of a truth: drawn from its number alone."""
    rng, model = np.random.default_rng((20260, number)), start_model()
    for path, (low, high) in FREE.items():
        model = model.with_value(path, float(rng.uniform(low, high)))
    return model


def engine_for(found: Fit, predictor: Predictor, known: Known, seed: int) -> Diagnosing:
    """What diagnoses the images of a fit."""
    images, histories = found.problem.images, found.problem.anchor.histories if found.problem.anchor else 0
    solver = Solver(histories or None, seed)
    return Diagnosing(found.model, Observed(images, (), (), {}), predictor, known, solver, tuple(FREE))


def studied(number: int, predictor: Predictor, asked: argparse.Namespace, known: Known | None) -> dict[str, Any]:
    """What one truth says: pulls of its full fit and of each draw, p-values, whether they were trusted."""
    began_s, samples, at = time.perf_counter(), paper_plan().samples, truths_model(number)
    truth = truth_of(at, samples, asked.histories, 100 + number)
    lit_s = time.perf_counter()
    seed = 10_000 * (number + 1)
    anchor_at = partial(anchor_of, asked.anchor, 7 + number)
    knowing = predictor.knowing({sample.id: noise for sample, noise in zip(samples, truth.noise, strict=True)})
    images = measured(truth, samples, DECLARED, seed)
    found = fit(start_model(), images, knowing, anchor_at=anchor_at, most_histories=asked.most)
    fitted_s = time.perf_counter()
    row: dict[str, Any] = {
        "truth": number, "full": pulls(found, at), "trusted": found.trusted, "reasons": found.distrust,
        "share": found.noise_share, "chi2": found.chi2_per_row, "iterations": found.iterations,
        "histories": found.problem.anchor.histories if found.problem.anchor else 0,
        "value": [found.value(path) for path in FREE], "error": [found.error(path) for path in FREE],
        "at": [at.leaves()[path] for path in FREE],
    }  # fmt: skip
    there = found.problem.evaluate(found.values)
    engine = engine_for(found, predictor, known, 7 + number) if known else None
    for percent in PATTERNS_PERCENT:
        row[f"draws {percent:g} %"] = list(drawn(truth, samples, there, percent, seed, asked.draws, at, engine))
    row["seconds"] = [lit_s - began_s, fitted_s - lit_s, time.perf_counter() - fitted_s]
    return row


def drawn(
    truth: Truth, samples: Sequence[Sample], there: Evaluation, percent: float, seed: int, count: int, at: Model,
    engine: Diagnosing | None,
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Further noise on a truth, fitted on the linear model at its fit: one null and one set of columns serve all.

    Columns of effects are those at that fit, which the worker knows when they are asked for a second time.
    """
    camera = DECLARED.model_copy(update={"prnu_percent": percent})
    prepared: Any = None
    for turn in range(count):
        images = measured(truth, samples, camera, seed + 100 + turn + 5_000 * (percent > 0.0))
        here = replace(there, problem=replace(there.problem, images=tuple(images)))
        white = prepared[0] if prepared else None
        white, reduced, columns = linearised(here, white)
        other = prepared[2] if prepared else here.other_columns(white, here.others())
        one = conclude(here, white, reduced, columns, crossed(here, white, reduced, columns, other), 1, True, other)
        if prepared is None:
            layout, projection = fit_layout(one), one.basis
            variances = Variances.of(layout, projection)
            drawn_null = null(layout, projection, variances.weight, NULL_DRAWS, seed)
            there_too = replace(one, model=there.model, values=there.values)  # one model for both patterns
            effects = Projected.of(engine.signatures(there_too, engine.effects), projection) if engine else None
            prepared = white, (layout, projection, variances, drawn_null), other, effects
        p = judged(one.residual, *prepared[1]).p
        row = {"pulls": pulls(one, at), "p": p, "trusted": one.trusted, "chi2": one.chi2_per_row}
        if prepared[3] is not None:
            scored = scores(prepared[3], one.residual, one.variance_scale, seed=seed + turn)
            row |= {"scores p": scored.p, "best": scored.effects[0].name}
        yield row


def main() -> None:
    """Run the study, truth by truth, and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    counts = {"truths": 20, "draws": 15, "histories": 4_000_000, "anchor": 4_000_000, "most": 0, "first": 0}
    for name, default in counts.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--resume", type=Path, help="file of truths that are done: those are read, others appended")
    parser.add_argument("--effects", action="store_true", help="score tests of all effects on every draw")
    asked = parser.parse_args()
    rows = {}
    if asked.resume and asked.resume.exists():
        rows = {row["truth"]: row for row in map(json.loads, asked.resume.read_text().splitlines())}
    with Client(load_settings(), patience_s=300.0) as client:
        predictor, known = Predictor(client), Known.ask(client) if asked.effects else None
        for number in range(asked.first, asked.first + asked.truths):
            if number in rows:
                continue
            rows[number] = row = studied(number, predictor, asked, known)
            if asked.resume:
                with asked.resume.open("a") as stream:
                    stream.write(json.dumps(row) + "\n")
            told = ", ".join(f"{one:+.2f}" for one in row["full"])
            steps = ", ".join(f"{one:.0f}" for one in row["seconds"])
            print(f"truth {number}: truth, fit, draws in {steps} s; pulls of its full fit {told}", flush=True)
    tell([rows[number] for number in sorted(rows)])


def tell_diagnosed(rows: Sequence[dict[str, Any]]) -> None:
    """What a diagnosis would have seen."""
    for percent in PATTERNS_PERCENT:
        draws = [row[f"draws {percent:g} %"] for row in rows]
        for level in (0.01, 0.05):
            found = [[one["scores p"] < level for one in of] for of in draws]
            print(f"  scores of all effects, pattern of {percent:g} %, at {100 * level:g} %: {share(found)}")
        seen = [[is_visible(one["p"], one["scores p"]) for one in of] for of in draws]
        print(f"  a diagnosis sees something, pattern of {percent:g} %, at {100 * LEVEL:g} %: {share(seen)}")


def anchor_of(histories: int, seed: int, model: Model) -> Anchored:
    """The anchor of a truth's fit."""
    return Anchored(model, histories, seed)


def pulls(found: Fit, truth: Model) -> list[float]:
    """Value less truth over its error, of each parameter."""
    return [(found.value(path) - truth.leaves()[path]) / found.error(path) for path in FREE]


def share(hits: Sequence[Sequence[bool]]) -> str:
    """The share of hits in percent, lists of one truth each; its interval of 95 % with whole truths drawn again."""
    counts = np.array([[sum(one), len(one)] for one in hits])
    again = counts[np.random.default_rng(1).integers(len(counts), size=(4000, len(counts)))].sum(axis=1)
    low, high = np.quantile(100.0 * again[:, 0] / again[:, 1], (0.025, 0.975))
    hit, of = counts.sum(axis=0)
    by_truths = f"{low:.1f} to {high:.1f} with whole truths drawn again"
    return f"{100.0 * hit / of:5.1f} % ({hit} of {of}; {by_truths}, {exact(hit, of)} as if all were independent)"


def exact(hit: int, of: int) -> str:
    """The interval of Clopper and Pearson, 95 %, in percent."""
    low = beta.ppf(0.025, hit, of - hit + 1) if hit else 0.0
    high = beta.ppf(0.975, hit + 1, of - hit) if hit < of else 1.0
    return f"{100.0 * low:.1f} to {100.0 * high:.1f}"


def tell(rows: Sequence[dict[str, Any]]) -> None:
    """The tables."""
    noise, chi2 = (np.mean([row[name] for row in rows]) for name in ("share", "chi2"))
    print(
        f"\n{load()}; {len(rows)} truths; Monte Carlo noise {noise:.2f} of the camera's, rms; chi2 per row {chi2:.3f}"
    )
    print("95 % intervals that hold the truth")
    plain = f"draws {PATTERNS_PERCENT[0]:g} %"
    for index, path in enumerate(FREE):
        inside = [[abs(one["pulls"][index]) < 1.96 for one in row[plain]] for row in rows]
        alone = [[abs(row["full"][index]) < 1.96] for row in rows]
        of_full = np.array([row["full"][index] for row in rows])
        bias = f"pulls {of_full.mean():+.2f} +- {of_full.std() / np.sqrt(len(rows)):.2f}, sd {of_full.std():.2f}"
        print(f"  {path}\n    draws      {share(inside)}\n    full fits  {share(alone)}; {bias}")
    every = [[abs(pull) < 1.96 for one in row[plain] for pull in one["pulls"]] for row in rows]
    alone = [[abs(pull) < 1.96 for pull in row["full"]] for row in rows]
    print(f"  all three\n    draws      {share(every)}\n    full fits  {share(alone)}")
    print("alarms of the structure test, nothing hidden")
    for percent in PATTERNS_PERCENT:
        for level in (0.01, 0.05):
            found = [[one["p"] < level for one in row[f"draws {percent:g} %"]] for row in rows]
            print(f"  pattern of {percent:g} %, at {100 * level:g} %: {share(found)}")
    if scored := [row for row in rows if all("scores p" in one for one in row[plain])]:
        print(f"score tests and verdicts, {len(scored)} truths")
        tell_diagnosed(scored)
    print(f"full fits not trusted: {sum(not row['trusted'] for row in rows)} of {len(rows)}")


if __name__ == "__main__":
    main()
