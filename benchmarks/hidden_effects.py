"""Hidden effects, made by Monte Carlo with the effect in the scene: what diagnose says of them, and how fast.

    python -m benchmarks.hidden_effects [--only NAME ...] [--truth 16000000] [--anchor 8000000] [--seed 1]

Each case: six images of the paper's kind by Monte Carlo of a truth with the effect, noise of the declared camera,
shifts and turns; then the model without it is diagnosed about a Monte Carlo anchor of other random numbers. The noise
of the truth itself, which light in a laboratory does not have, is told to the fits: the anchor's, by histories.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from luxloop.client import Client
from luxloop.effect import AppliedEffect
from luxloop.model import Model
from luxloop.model_file import find_model
from luxloop.settings import load_settings
from validation.comparing import Solver
from validation.dataset.folder import read_dataset
from validation.dataset.simulate import write_dataset
from validation.dataset.simulated_images import exposed, views_of
from validation.dataset.simulation_plan import paper_plan
from validation.diagnose.rounds import Diagnosis
from validation.diagnosing import Diagnosing
from validation.effects.known import Known
from validation.fit.parameters import free_paths
from validation.observed import Observed
from validation.prediction import Anchored, Predicted, Predictor, View

PAPER = find_model("paper")
SHIFT_PX, ROTATION_DEG = 0.5, 0.1
LOSS = "environment.chip_absorption_per_cm"


@dataclass(frozen=True)
class Case:
    """A truth, the model that lacks something of it, and what should be named with which size."""

    name: str
    truth: Model
    model: Model
    effect: str
    size: float | None
    """Of the effect's parameter; None: a switch."""


class Told(Predictor):
    """A predictor whose Monte Carlo has the truth's noise, too."""

    def __init__(self, client: Client, truth: int) -> None:
        super().__init__(client)
        self._truth = truth

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """As the predictor; variances of both add up."""
        found = super().images(model, views, paths, anchor)
        if anchor is None or not anchor.histories:
            return found
        times = [(1.0 + anchor.histories_of(view.sample.id) / self._truth) ** 0.5 for view in views]
        return [
            replace(one, noise_per_mm2=None if one.noise_per_mm2 is None else by * one.noise_per_mm2)
            for one, by in zip(found, times, strict=True)
        ]


def with_effects(model: Model, **effects: dict[str, float | str]) -> Model:
    """The model with effects."""
    applied = tuple(AppliedEffect(name=name, parameters=values) for name, values in effects.items())
    return model.model_copy(update={"effects": applied})


def clear(model: Model) -> Model:
    """The model whose chips absorb nothing, and whose loss is not fitted."""
    fit = {path: one for path, one in model.fit.items() if path != LOSS}
    return model.model_copy(update={"fit": fit}).with_value(LOSS, 0.0)


def cases() -> list[Case]:
    """Those that the product must show."""
    return [
        Case("nothing", PAPER, PAPER, "", None),
        Case("chip absorption 0 -> 200 /cm", PAPER, clear(PAPER), "chip_absorption", 200.0),
        Case("layer order", PAPER.with_value("environment.layer_order", "aln_first"), PAPER, "dbr_layer_order", None),
        Case("distance", with_effects(PAPER, distance_error={"distance_um": 6.0}), PAPER, "distance_error", 6.0),
        Case("edge walls 0.3", with_effects(PAPER, edge_walls={"reflectance": 0.3}), PAPER, "edge_walls", 0.3),
        Case(
            "vignetting 5 %", with_effects(PAPER, vignetting={"corner_loss": 0.05, "law": "quadratic"}), PAPER,
            "vignetting", 0.05,
        ),
        Case(
            "receiver volume scatter 0.2",
            with_effects(PAPER, receiver_volume_scatter={"scatter_share": 0.2, "spread_um": 150.0}), PAPER,
            "receiver_volume_scatter", 0.2,
        ),
        Case(
            "dipoles 0.2", with_effects(PAPER, dipole_orientation={"preference": 0.2}), PAPER,
            "dipole_orientation", 0.2,
        ),
        Case(
            "rough side walls 0.1", with_effects(PAPER, side_wall_roughness={"slope": 0.1}), PAPER,
            "side_wall_roughness", 0.1,
        ),
    ]  # fmt: skip


def observed_of(case: Case, client: Client, histories: int, seed: int, heard: Callable[..., None]) -> Observed:
    """The data of a case."""
    plan = paper_plan()
    views = views_of(plan, seed, shift_px=SHIFT_PX, rotation_deg=ROTATION_DEG)
    expected = exposed(client, case.truth, views, plan.camera, histories=histories, seed=seed + 1000, heard=heard)
    with tempfile.TemporaryDirectory() as folder:
        write_dataset(Path(folder), plan, expected, seed=seed)
        return Observed.of(read_dataset(Path(folder)))


def diagnosed(case: Case, observed: Observed, client: Client, asked: argparse.Namespace) -> Diagnosis:
    """What the product says."""
    solver = Solver.of_diagnosis(asked.anchor or None, asked.seed + 2000, asked.most)
    engine = Diagnosing(
        case.model, observed, Told(client, asked.truth), Known.ask(client), solver, tuple(free_paths(case.model))
    )
    return engine.diagnosed()


def main() -> None:
    """Run the cases and print what came out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[], help="words of the names of cases")
    parser.add_argument("--truth", type=int, default=16_000_000, help="histories a sample of the truth")
    parser.add_argument(
        "--anchor", type=int, default=8_000_000, help="histories a sample of the anchor; 0: twin alone"
    )
    parser.add_argument("--most", type=int, help="of the last anchor, at most; default: 8 times; 0: no more")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    chosen = [one for one in cases() if not asked.only or any(word in one.name for word in asked.only)]
    with Client(load_settings(), patience_s=300.0) as client:
        for case in chosen:
            start = time.monotonic()
            observed = observed_of(case, client, asked.truth, asked.seed, lambda *_: None)
            made = time.monotonic()
            tell(case, diagnosed(case, observed, client, asked))
            print(
                f"  {made - start:.0f} s for the data, {time.monotonic() - made:.0f} s for the diagnosis\n",
                flush=True,
            )


def tell(case: Case, found: Diagnosis) -> None:
    """A case in some lines."""
    first = found.steps[0]
    base = first.ground
    print(f"{case.name}: {found.verdict.word}")
    print(f"  {found.verdict.sentence}")
    print(
        f"  before: structure p {base.structure.p_text}, chi2/pixel {base.fit.chi2_per_row:.3f},"
        f" Monte Carlo noise {base.fit.noise_share:.2f} of the camera's; scores p {first.scores.p:.2g}"
    )
    for one in sorted(first.explanations, key=lambda one: -one.drop):
        truth = f" (truth {case.size:g})" if one.name == case.effect and case.size is not None else ""
        held = "" if one.held_out_percent is None else " held out {:.3g} -> {:.3g} %".format(*one.held_out_percent)
        mark = "*" if one.name == case.effect else " "
        print(
            f"  {mark} {one.name:24s} {one.size}{truth}: drop {one.drop:.0f}, explains {100 * one.share.value:.0f}"
            f" +- {100 * one.share.error:.0f} %,{held}, p left {one.p_left:.2g}, sigma {one.sigma:.0f}"
        )


if __name__ == "__main__":
    main()
