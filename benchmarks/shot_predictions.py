"""What a fit pays for its predictions: six images as they are compared, their derivatives, an anchor, by the twin.

    python benchmarks/shot_predictions.py [--histories 4000000] [--model paper]

The paper's six groups at the declared camera (128 x 128 pixels of 8 um), binned by 3 to 42 x 42, real processes on
loopback. Warm: every chip has been seen; moved: receiver and substrate reflect a little less at each request, as in
a fit, so that chips are walked anew. Median of several; other load on the machine is printed, for it counts.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.processes import THIN_FILM, Processes, table
from luxloop.model import Model
from luxloop.model_file import find_model
from validation.dataset.simulated_images import expected_images, views_of
from validation.dataset.simulation_plan import paper_plan
from validation.noise import variance_dn2
from validation.prediction import POSE_COLUMNS, Anchored, Predicted, Predictor, View

RAY_TRACING = ("-m", "luxloop", "serve", "ray-tracing", "--quiet")
SUBSTRATE, RECEIVER = "environment.substrate.reflectance", "environment.receiver.reflectance"
PATHS = (SUBSTRATE, "environment.substrate.sigma_deg", RECEIVER, "environment.chip_absorption_per_cm")
BINNING, REPEATS = 3, 5


def views() -> list[View]:
    """The declared camera, binned."""
    return [
        replace(view, rows=42, columns=42, pixel_um=view.pixel_um * BINNING, centre_px=(20.5, 20.5))
        for view in views_of(paper_plan(), 1)
    ]


class Bench:
    """A predictor, and where theta is."""

    def __init__(self, predictor: Predictor, model: Model) -> None:
        self.predictor, self.start, self.model, self.views = predictor, model, model, views()

    def moved(self) -> Model:
        """Reflectances 0.1 % and 0.2 % lower than before."""
        for path, by in ((SUBSTRATE, 1e-3), (RECEIVER, 2e-3)):
            self.model = self.model.with_value(path, self.model.leaves()[path] - by)
        return self.model

    def row(self, what: str, ask: Callable[[], list[Predicted]], repeats: int = 1) -> list[str]:
        """Median seconds at the client."""
        took = []
        for _ in range(repeats):
            begin = time.perf_counter()
            ask()
            took.append(time.perf_counter() - begin)
        return [what, f"{np.median(took):.2f} s", f"{os.getloadavg()[0]:.1f}"]

    def twin(self) -> list[list[str]]:
        """Images, poses, all seven columns."""
        ask, every = self.predictor.images, (*PATHS, *POSE_COLUMNS)
        rows = [self.row("six images, nothing known", lambda: ask(self.start, self.views))]
        ask(self.start, self.views, every)
        for what, paths in (
            ("no derivative", ()),
            ("3 of the pose", POSE_COLUMNS),
            ("4 of the model, 3 of the pose", every),
        ):
            rows.append(self.row(f"moved, {what}", lambda paths=paths: ask(self.moved(), self.views, paths), REPEATS))
        return rows

    def anchored(self, histories: int) -> list[list[str]]:
        """An anchor made, and used."""
        at = Anchored(self.start, histories)
        ask = self.predictor.images
        rows = [
            self.row(f"anchored, {histories:,} histories each, cold", lambda: ask(self.start, self.views, (), at))
        ]
        rows.append(self.row("anchored, moved", lambda: ask(self.moved(), self.views, (), at), REPEATS))
        return [*rows, *self.noise(ask(self.start, self.views, (), at))]

    def noise(self, predicted: list[Predicted]) -> list[list[str]]:
        """What the anchor's Monte Carlo leaves, and what the twin alone is wrong by, against the camera's noise."""
        camera = paper_plan().camera
        twin = self.predictor.images(self.start, self.views)
        rows = []
        for one, other in zip(
            expected_images(self.views, [p.irradiance_per_mm2 for p in predicted], camera),
            zip(predicted, twin, strict=True),
            strict=True,
        ):
            found, plain = other
            gain = one.signal_dn.max() / one.irradiance_per_mm2.max()
            sigma = np.sqrt(variance_dn2(one.signal_dn, camera)) / BINNING
            noise = np.sqrt((found.noise_per_mm2**2).sum(axis=0)) if found.noise_per_mm2 is not None else 0.0
            of_anchor, of_twin = (
                np.sqrt(np.mean((gain * part / sigma) ** 2))
                for part in (noise, plain.irradiance_per_mm2 - found.irradiance_per_mm2)
            )
            rows.append(
                [
                    f"{one.view.sample.id}: rms of anchor's error / of twin's, in camera sigmas of a bin",
                    f"{of_anchor:.2f} / {of_twin:.2f}",
                    "",
                ]
            )
        return rows


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--histories", type=int, default=4_000_000)
    options.add_argument("--model", default="paper")
    given = options.parse_args()
    with Processes(THIN_FILM, RAY_TRACING) as processes:
        bench = Bench(Predictor(processes.client), find_model(given.model))
        rows = [*bench.twin(), *bench.anchored(given.histories)]
    table(f"predictions for a fit, {given.model}", rows, ["what", "at the client", "load"])


if __name__ == "__main__":
    main()
