"""What the noise of an anchor hides: information along the columns of effects, a camera's alone over what is left.

    python -m benchmarks.anchor_information [--plan docs/blind/plan.toml] [--pixels 42] [--most 32000000]

Images with nothing hidden, by the twin, fitted about Monte Carlo of 4 million histories a sample. There the columns
of the catalogue's effects are whitened without and with the noise of anchors that ask for a share of the camera's
noise by pixel, and what is fitted is taken out of them. 1: the Monte Carlo hides nothing; 4: an effect shows by half
as many sigma. Groups of chips are left out, and what is nearly what is fitted: of its column noise would be left.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from luxloop.client import Client
from luxloop.model_file import find_model
from luxloop.settings import load_settings
from validation.comparing import Solver
from validation.dataset.folder import read_dataset
from validation.dataset.simulate import write_dataset
from validation.dataset.simulated_images import exposed, views_of
from validation.dataset.simulation_plan import Plan, read_plan
from validation.diagnose.score import Projected
from validation.diagnosing import Diagnosing
from validation.effects.known import Known
from validation.fit import Fit
from validation.fit.descent import linearised
from validation.fit.model_noise import noise_shares
from validation.fit.parameters import free_paths
from validation.fit.result import conclude, wanted_histories
from validation.observed import Observed
from validation.prediction import Anchored, Predictor

PAPER = find_model("paper")
BEGINS = 4_000_000
SHARES = (0.3, 0.1, 0.05)
LEFT = 0.05
"""Of a column's length beside what is fitted, at least."""
SHIFT_PX, ROTATION_DEG = 0.5, 0.1


def observed_of(plan: Plan, pixels: int, client: Client, seed: int) -> Observed:
    """Images of the plan by the twin, with the camera's noise."""
    views = views_of(plan, seed, pixels, pixels, SHIFT_PX, ROTATION_DEG)
    expected = exposed(client, PAPER, views, plan.camera, solver="twin")
    with tempfile.TemporaryDirectory() as folder:
        write_dataset(Path(folder), plan, expected, seed=seed)
        return Observed.of(read_dataset(Path(folder)))


def about(fit: Fit, anchor: Anchored) -> Fit:
    """The same values about another anchor, with its noise told; nothing is fitted."""
    evaluation = replace(fit.problem, anchor=anchor).evaluate(fit.values)
    white, reduced, columns = linearised(evaluation)
    found = conclude(evaluation, white, reduced, columns, reduced.step(), 0, False)
    return replace(found, active=fit.active)


def information(fit: Fit, engine: Diagnosing) -> dict[str, tuple[str, float]]:
    """Of each column that is no group and not nearly what is fitted: its effect, its square beside the fit."""
    projected = Projected.of(engine.signatures(fit, engine.effects), fit.basis)
    squares = np.diagonal(projected.gram)
    return {
        str(one.key): (one.effect.name, float(squares[part.start]))
        for one, part, left in zip(projected.candidates, projected.slices(), projected.left, strict=True)
        if not one.is_group and left > LEFT
    }


def hidden(alone: dict[str, tuple[str, float]], noisy: dict[str, tuple[str, float]]) -> dict[str, float]:
    """The camera's information over what is left, by effect: the median over its shapes."""
    found: dict[str, list[float]] = {}
    for key in alone.keys() & noisy.keys():
        found.setdefault(alone[key][0], []).append(alone[key][1] / noisy[key][1])
    return {name: float(np.median(several)) for name, several in found.items()}


def asking(fit: Fit, share: float, most: int) -> Anchored:
    """The anchor that asks for a share of the camera's noise."""
    wanted = {
        sample: max(BEGINS, min(histories, most))
        for sample, histories in wanted_histories(fit.problem, fit.whitening, share).items()
    }
    histories = max(wanted.values())
    enough = tuple((sample, one) for sample, one in wanted.items() if one < histories)
    return Anchored(fit.model, histories, poses=tuple(fit.poses.values()), enough=enough)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plan", type=Path, default=Path(__file__).parents[1] / "docs" / "blind" / "plan.toml")
    parser.add_argument("--pixels", type=int, default=42)
    parser.add_argument("--most", type=int, default=32_000_000, help="histories of a sample, at most")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args(argv)
    columns: dict[str, dict[str, float]] = {}
    with Client(load_settings(), patience_s=300.0) as client:
        observed = observed_of(read_plan(asked.plan), asked.pixels, client, asked.seed)
        solver, free = Solver(BEGINS, asked.seed), tuple(free_paths(PAPER))
        engine = Diagnosing(PAPER, observed, Predictor(client), Known.ask(client), solver, free)
        fit = engine.fitted(PAPER)
        alone = information(about(fit, Anchored(fit.model, 0, poses=tuple(fit.poses.values()))), engine)
        for share in SHARES:
            start, anchor = time.monotonic(), asking(fit, share, asked.most)
            noisy = about(fit, anchor)
            print(f"{share:g} asked: {time.monotonic() - start:.0f} s")
            for image, got in zip(noisy.problem.images, noise_shares(noisy.whitening), strict=True):
                histories = anchor.histories_of(image.sample.id)
                print(f"  {image.sample.id:12s} {histories / 1e6:5.1f} M histories, {got:.2f}", flush=True)
            columns[f"{share:g} asked"] = hidden(alone, information(noisy, engine))
    first = next(iter(columns.values()))
    print(f"\n{'effect':24s}" + "".join(f"{title:>14s}" for title in columns))
    for name in sorted(first, key=first.__getitem__, reverse=True):
        print(f"{name:24s}" + "".join(f"{column[name]:14.2f}" for column in columns.values()))
    print(f"{'median':24s}" + "".join(f"{np.median(list(column.values())):14.2f}" for column in columns.values()))


if __name__ == "__main__":
    main()
