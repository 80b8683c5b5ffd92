"""What the light of blind sets errs by, in the errors of each effect's size: a noise that draws of a light share.

    python -m benchmarks.blind_noise [--histories 8000000 32000000] [--seeds 4] [--plan FILE] [--pixels 42]

The light of one truth is traced again and again, each time in two halves; half of their difference has the noise of
their mean. Whitened by the camera alone, less what a fit takes away, it is projected on the column of each effect: z,
which is 1 where the light errs by as much as the effect's size is known to. Printed: its root mean square over seeds
and all columns, and of the effects that it is most like, each in its worst shape; seconds of a light by the clock.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from luxloop.client import Client
from luxloop.model_file import find_model
from luxloop.settings import load_settings
from validation.blind_test.scenes import Lights, Scene
from validation.blind_test.truths import truth_of
from validation.dataset.simulation_plan import read_plan
from validation.effects.known import Known
from validation.prediction import Predictor

SHOWN = 8
FEW = 2_000_000
"""Histories of the light that columns are about."""


def main() -> None:
    """Print a line for each number of histories."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histories", type=int, nargs="+", default=[8_000_000, 32_000_000])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1, help="of the truth")
    parser.add_argument("--plan", type=Path, default=Path("docs/blind/plan.toml"))
    parser.add_argument("--pixels", type=int, default=42)
    asked = parser.parse_args()
    model, plan = find_model("paper"), read_plan(asked.plan)
    truth = truth_of(0, model, len(plan.samples), asked.seed)
    with Client(load_settings(), patience_s=600.0) as client:
        scene = Scene(truth, plan, asked.pixels, FEW, 20.0, Predictor(client), Known.ask(client))
        names = [one.effect.name for one in scene.rivals.candidates for _ in one.columns]
        columns = scene.rivals.columns / np.linalg.norm(scene.rivals.columns, axis=1)[:, None]
    for histories in asked.histories:
        found, begun = [], time.monotonic()
        for number in range(asked.seeds):
            again = replace(truth, seed=truth.seed + 2 * number)
            halves = Lights(again, scene.lights.samples, scene.camera, histories).plain
            first, second = (scene.signals(half) for half in halves)
            error = scene.ruler.left([(one - other) / 2.0 for one, other in zip(first, second, strict=True)])
            found.append(columns @ error)
        seconds = (time.monotonic() - begun) / asked.seeds
        z2 = np.mean(np.square(found), axis=0)
        worst: dict[str, float] = {}
        for name, value in sorted(zip(names, np.sqrt(z2), strict=True), key=lambda one: -one[1]):
            worst.setdefault(name, float(value))
        most = ", ".join(f"{name} {value:.2f}" for name, value in list(worst.items())[:SHOWN])
        print(f"{histories:>13,} histories  {seconds:6.0f} s  all {np.sqrt(z2.mean()):.3f}  {most}", flush=True)


if __name__ == "__main__":
    main()
