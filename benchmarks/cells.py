"""The one way in which the benchmarks of the ray tracer make scenes, trace them and read U; and their clocks."""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.build import cell_of, scene_of
from containers.ray_tracing.estimate import Estimate
from containers.ray_tracing.exits import Exits, Landing
from containers.ray_tracing.monte_carlo import MonteCarlo
from containers.ray_tracing.outcome import solved
from containers.ray_tracing.simulation import look
from containers.ray_tracing.stopping import POINTS, Solver, Target, run_to_error
from containers.ray_tracing.tally import Box, Tally
from containers.ray_tracing.uniformity import uniformity
from containers.scene import Emission, Scene
from containers.stack import dbr_of
from containers.thin_film.table import film_table
from luxloop.computation import Progress
from luxloop.design import Bounds, Design
from luxloop.film import Spectrum
from luxloop.model import Environment
from luxloop.model_file import SHIPPED, find_model

Real = NDArray[np.float64]

MODELS: dict[str, Environment] = {name: find_model(name).environment for name in SHIPPED}
CLEAR, PAPER = MODELS["clear_chip"], MODELS["paper"]
DESIGNS = {
    "S_b3 without DBR": Design.from_vector((180.0, 28.0, 500.0, 35.0, 0.0)),
    "S_b3": Design.from_vector((180.0, 28.0, 500.0, 35.0, 6.5)),
    "S_b1": Design.from_vector((180.0, 40.0, 400.0, 20.0, 5.5)),
    "S_b2": Design.from_vector((160.0, 20.0, 460.0, 15.0, 5.5)),
}
GOLDEN = Path(__file__).parents[1] / "tests" / "golden" / "ray_tracing.json"
BUDGET_S = 3600.0


def scene_for(environment: Environment, design: Design) -> Scene:
    """The cell of a design, with the film of its DBR."""
    film = None
    if design.dbr_pairs:
        line = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
        film = film_table(dbr_of(environment, design.dbr_pairs), line)
    return scene_of(environment, design, film, cell_of(environment, design))


def golden_scene(case: str) -> Scene:
    """The cell of golden case A (Lambert from the chip's top) or B (isotropic in the clear chip's volume)."""
    scene = scene_for(CLEAR, DESIGNS["S_b3 without DBR"])
    return replace(scene, emission=Emission(from_top=True)) if case == "A" else scene


def golden(case: str) -> dict[str, Any]:
    """The golden record of a case."""
    return dict(json.loads(GOLDEN.read_text())[f"case_{case}"])


def random_designs(count: int, seed: int) -> list[Design]:
    """Feasible designs of the paper's grid, drawn with equal chances and without regard to what they are."""
    rng, bounds = np.random.default_rng(seed), Bounds.preset("paper-grid")
    values = [bounds.values(name) for name in Design.FIELDS]
    found: list[Design] = []
    while len(found) < count:
        design = Design.from_vector([of[rng.integers(len(of))] for of in values])
        if design.feasibility() is None:
            found.append(design)
    return found


def feasible_share() -> float:
    """Share of the paper's grid that can be built: a matter of D and T alone, chips are always apart."""
    bounds = Bounds.preset("paper-grid")
    some = Design.from_vector(bounds.low.as_vector())
    pairs = [(D, T) for D in bounds.values("distance_um") for T in bounds.values("thickness_um")]
    fit = [some.model_copy(update={"distance_um": D, "thickness_um": T}).feasibility() is None for D, T in pairs]
    return sum(fit) / len(fit)


def full_walk(scene: Scene, seed: int, **options: Any) -> MonteCarlo:
    """Whole histories."""
    return MonteCarlo(scene, seed, **options)


def landing(scene: Scene, exits: Exits | Callable[[int], Exits], seed: int, **options: Any) -> Landing:
    """Stored exits."""
    return Landing(scene, exits, seed, **options)


def unfolded(solver: MonteCarlo) -> MonteCarlo:
    """The same solver with bins over the whole cell, its symmetry not used."""
    box, spacing_um = solver.tally.box, solver.scene.layout.spacing_um
    bins = round(spacing_um / box.step_um)
    whole = Box(-spacing_um / 2.0, -spacing_um / 2.0, box.step_um, bins, bins, folded=False, cell=True)
    groups, layers = solver.tally.bins.shape[:2]
    empty = Tally.empty(solver.scene, groups)
    solver.tally = Tally(
        whole, np.zeros((groups, layers, bins, bins)), empty.ledger, empty.arrivals, empty.directions
    )
    return solver


def uniformity_of(scene: Scene, tally: Tally) -> Estimate:
    """U (Eq. 8) of a tally."""
    found = solved(scene, tally)
    return uniformity(found.field, found.region)


def mean_of(scene: Scene, tally: Tally) -> tuple[float, float]:
    """Mean relative illuminance of a cell and its standard error."""
    field = solved(scene, tally).field
    return field.mean, field.mean_error


def to_error(solver: Solver, scene: Scene, points: float, budget_s: float = BUDGET_S) -> Estimate:
    """U once its standard error is at most `points` (0.01 of U), by the worker's own stopping rule."""
    run_to_error(solver, lambda tally: look(scene, tally), Target(points / POINTS, budget_s), Progress())
    return uniformity_of(scene, solver.tally)


def relative_maps(tally: Tally, bins: int) -> Real:
    """Maps (group, bins, bins) of relative illuminance."""
    fine = tally.cell_bins()
    step = fine.shape[-1] // bins
    coarse = fine.reshape(len(fine), bins, step, bins, step).sum(axis=(2, 4))
    return np.asarray(coarse / tally.histories * bins**2)


class Clock:
    """Wall-clock and CPU seconds (of all threads) of what is done inside `with`."""

    wall_s = cpu_s = 0.0

    def __enter__(self) -> Clock:
        self._begin = time.perf_counter(), time.process_time()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.wall_s = time.perf_counter() - self._begin[0]
        self.cpu_s = time.process_time() - self._begin[1]


def load() -> str:
    """How busy the machine is with others, and what there is of it."""
    return f"load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores"


def points(one: Estimate) -> str:
    """A share in points, with its error."""
    return f"{100.0 * one.value:.2f} +- {100.0 * one.standard_error:.2f}"
