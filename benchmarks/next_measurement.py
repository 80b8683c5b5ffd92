"""Does the measurement that `luxloop next` proposes tell two effects apart, once it is made and added?

    python -m benchmarks.next_measurement [--trials 10] [--truth 0] [--anchor 0] [--seed 1] [--sigma 3] [--noise 1]

A trial hides one effect of a pair in three images of the paper's kind (shifts, turns and noise of the declared
camera), so strong that its rival leaves `--sigma` of it beside the camera's noise; that of Monte Carlo hides more of
it. The diagnosis, with the pair to choose from, should not be able to tell them apart; then the shot that it proposes
first is simulated, added to the data, and all is diagnosed again. It counts where the hidden effect is named. Trials
whose first verdict is another one are told, and count for nothing, as those where the proposal itself says that it
would not do (less than 5 sigma). `--truth` and `--anchor`: histories a sample; 0: the twin makes the images, and
diagnoses them. `--noise`: of the camera, times that of the declared one.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from benchmarks.hidden_effects import PAPER, ROTATION_DEG, SHIFT_PX, Told
from benchmarks.ray_coverage import clopper_pearson
from luxloop.client import Client
from luxloop.model import Model
from luxloop.settings import load_settings
from validation.comparing import Solver
from validation.dataset.folder import read_dataset
from validation.dataset.manifest import CameraFacts, Sample
from validation.dataset.simulate import write_dataset
from validation.dataset.simulated_images import Expected, expected_images, exposed, views_of
from validation.dataset.simulation_plan import paper_plan
from validation.diagnose.proposal import Proposal
from validation.diagnose.rounds import Diagnosis
from validation.diagnosing import Diagnosing
from validation.effects.confounding import TOLD_APART, left_beside
from validation.effects.confusing import Ground, image_ground
from validation.effects.known import Known, acting, applied, off_values, with_effect
from validation.effects.signatures import projected
from validation.fit.parameters import free_paths
from validation.observed import Observed
from validation.prediction import Anchored, Predictor

SAMPLES = ("single-0", "single-5.5", "array-5.5")
"""Of the paper's six, for time."""
SHOWN = [one for one in paper_plan().samples if one.id in SAMPLES]
CASES = (
    ("dbr_roughness", 8.0, "dbr_index_error"),
    ("magnification", 0.01, "distortion"),
    ("dipole_orientation", 0.5, "receiver_btdf"),
    ("dbr_index_error", -0.1, "dbr_roughness"),
    ("receiver_btdf", 0.4, "dipole_orientation"),
    ("distortion", -0.02, "magnification"),
    ("dipole_orientation", -0.5, "receiver_btdf"),
    ("magnification", -0.01, "distortion"),
    ("receiver_btdf", -0.4, "dipole_orientation"),
    ("distortion", 0.02, "magnification"),
)
"""What is hidden, the end of its range towards which it is, and the rival: the pairs that images of one distance show
most alike (docs/effects.md), cosines 0.98, 0.88, 0.89."""


@dataclass(frozen=True, eq=False)
class Bench:
    """Who simulates and who diagnoses."""

    client: Client
    known: Known
    truth: int
    anchor: int
    sigma: float
    """Of the hidden effect, beside its rival: below the 5 from which they are told apart."""
    noise: float
    """Of the camera, times that of the declared one: a sensor of so much smaller wells."""

    @cached_property
    def camera(self) -> CameraFacts:
        """Of as many electrons fewer as more noise asks for, the images as bright."""
        declared, times = paper_plan().camera, self.noise**2
        wells = {"full_well_e": declared.full_well_e / times, "gain_dn_per_e": declared.gain_dn_per_e * times}
        return declared.model_copy(update=wells)

    def images(self, model: Model, samples: Sequence[Sample], seed: int) -> list[Expected]:
        """What the camera sees of samples, before its noise."""
        plan = paper_plan().model_copy(update={"samples": tuple(samples), "camera": self.camera})
        views = views_of(plan, seed, shift_px=SHIFT_PX, rotation_deg=ROTATION_DEG)
        if self.truth:
            return exposed(self.client, model, views, plan.camera, histories=self.truth, seed=seed + 1000)
        found = Predictor(self.client).images(model, views, (), Anchored(PAPER, 0))  # walks of its own would show
        return expected_images(views, [one.irradiance_per_mm2 for one in found], plan.camera)

    def observed(self, expected: Sequence[Expected], seed: int) -> Observed:
        """The data with their noise."""
        samples = tuple(one.view.sample for one in expected)
        plan = paper_plan().model_copy(update={"samples": samples, "camera": self.camera})
        with tempfile.TemporaryDirectory() as folder:
            write_dataset(Path(folder), plan, expected, seed=seed)
            return Observed.of(read_dataset(Path(folder)))

    def engine(self, observed: Observed, pair: Sequence[str], seed: int) -> Diagnosing:
        """The diagnosis of data by the model without effects."""
        solver = Solver(self.anchor or None, seed + 2000)
        predictor = Told(self.client, self.truth) if self.truth else Predictor(self.client)
        free = tuple(free_paths(PAPER))
        return Diagnosing(PAPER, observed, predictor, self.known, solver, free, among=tuple(pair))

    def hiding(self, name: str, value: float) -> Model:
        """The model with an effect of a size."""
        spec = self.known.spec(name)
        return with_effect(PAPER, applied(spec, off_values(spec) | {acting(spec)[0].name: value}))

    @cached_property
    def ground(self) -> Ground:
        """What effects are seen on before any is hidden."""
        observed = self.observed(self.images(PAPER, SHOWN, 0), 0)
        return image_ground(PAPER, Predictor(self.client), self.known, observed.images)

    def size(self, name: str, end: float, rival: str) -> float:
        """At which an effect leaves `sigma` beside its rival, towards an end of its range and not beyond."""
        specs = [self.known.spec(name), self.known.spec(rival)]
        own, other = (projected(self.ground.columns(PAPER, spec), self.ground.projection) for spec in specs)
        found = self.sigma / left_beside(own[0], [other])
        if acting(specs[0])[0].score_variable == "square":
            found = float(np.sqrt(found))
        return float(np.copysign(min(found, abs(end)), end))


def proposed(best: Proposal) -> list[Sample]:
    """The samples of a proposal; a longer exposure is as many images."""
    count = max(1, round(best.exposure_ratio))
    return [best.sample.model_copy(update={"id": f"next-{number}"}) for number in range(count)]


def trial(bench: Bench, case: tuple[str, float, str], seed: int) -> bool | None:
    """Whether the hidden effect is named once the proposed image is there; None where it was not asked for."""
    begun, (hidden, _, rival), value = time.monotonic(), case, bench.size(*case)
    truth, pair = bench.hiding(hidden, value), (hidden, rival)
    expected = bench.images(truth, SHOWN, seed)
    engine = bench.engine(bench.observed(expected, seed), pair, seed)
    first = engine.diagnosed()
    print(f"seed {seed}: {hidden} {value:.3g} hidden, rival {rival}: {told(first)}", flush=True)
    if first.verdict.word != "cannot_tell_apart" or not first.proposals:
        return None
    best = first.proposals[0]
    if best.expected_sigma < TOLD_APART:
        print(f"  {first.verdict.sentence}", flush=True)
        return None
    expected += bench.images(truth, proposed(best), seed + 500)
    second = bench.engine(bench.observed(expected, seed), pair, seed).diagnosed()
    named = second.verdict.word == "one_effect" and second.verdict.set[0] == hidden
    print(
        f"  with {best.words} (expected {best.expected_sigma:.0f} sigma, before {best.now_sigma:.1f}):"
        f" {told(second)}: {'right' if named else 'WRONG'}, {time.monotonic() - begun:.0f} s",
        flush=True,
    )
    return named


def told(found: Diagnosis) -> str:
    """A verdict with what it rests on."""
    rows = []
    for one in found.steps[0].explanations:
        rival, share = min(one.sigma_rival.values(), default=0.0), 100.0 * one.share.value
        size = f"{one.name} {one.value:.3g} +- {one.error:.2g}, drop {one.drop:.0f}"
        rows.append(f"{size}, explains {share:.0f} %, sigma {one.sigma:.1f}, beside its rival {rival:.1f}")
        rows += one.distrust
    return f"{found.verdict.word} ({'; '.join(rows)})"


def main() -> None:
    """Run the trials and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--truth", type=int, default=0, help="histories a sample of the truth; 0: the twin")
    parser.add_argument("--anchor", type=int, default=0, help="histories a sample of the anchor; 0: the twin")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial: to run them in parts")
    parser.add_argument("--sigma", type=float, default=3.0, help="that its rival leaves of a hidden effect")
    parser.add_argument("--noise", type=float, default=1.0, help="of the camera, times that of the declared one")
    asked = parser.parse_args()
    numbers = range(asked.first, asked.first + asked.trials)
    with Client(load_settings(), patience_s=300.0) as client:
        bench = Bench(client, Known.ask(client), asked.truth, asked.anchor, asked.sigma, asked.noise)
        results = [trial(bench, CASES[number % len(CASES)], asked.seed + number) for number in numbers]
    counted = [one for one in results if one is not None]
    low, high = clopper_pearson(sum(counted), len(counted)) if counted else (0.0, 1.0)
    print(
        f"{sum(counted)} of {len(counted)} named with the proposed image ({100.0 * low:.0f} to {100.0 * high:.0f} %);"
        f" of {len(results) - len(counted)} more the first verdict was another one, or no image would do"
    )


if __name__ == "__main__":
    main()
