"""Blind sets with nothing hidden: do scores scatter as much as is told, and what do draws of one light share?

    python -m benchmarks.blind_null FOLDER [--lights 4] [--seed 1]

A line for each light, of all columns of effects at the fit: the mean square of z within its draws, which the
camera's noise makes; that of their means over draws, without what the former leaves of it: noise that draws share;
and the sum of both, 1 if what is told is all there is. Draws share the anchor, whose noise is told, the light of
their data, whose noise is not (in a laboratory light has none), and that their fits stand about the anchor of the
first one. How much of what the others share is in the first draw says which: nearly all (1) where it is anchor or
light, none (0) where it is that they stand away from the anchor; a draw of the others shows 1 +- what is printed.
Then the columns that are shared most. Opens no seal and puts nothing on record.
"""

from __future__ import annotations

import argparse
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from luxloop.client import Client
from luxloop.model import Model
from luxloop.settings import load_settings
from validation.blind_test.folders import SETS, Entry, read_index
from validation.blind_test.judging import Shared, SharedDiagnosing, SharedSolver, chosen_model
from validation.comparing import Solver
from validation.dataset.folder import read_dataset
from validation.diagnose.score import Projected
from validation.effects.known import Known
from validation.fit.parameters import free_paths
from validation.observed import Observed
from validation.prediction import Predictor

HISTORIES = 4_000_000
"""Of an anchor, as `blind diagnose` has them."""
SHOWN = 6

Scores = tuple[list[str], NDArray[np.float64]]


def scores_of(light: str, sets: list[Entry], folder: Path, client: Client, model: Model, seed: int) -> Scores:
    """Names of columns, and z (draw, column)."""
    predictor, known, shared = Predictor(client), Known.ask(client), Shared(light)
    plain = Solver.of_diagnosis(HISTORIES, seed, None)
    solver = SharedSolver(plain.histories, plain.seed, plain.most_histories, shared=shared)
    names: list[str] = []
    drawn = []
    for one in sets:
        observed = Observed.of(read_dataset(folder / SETS / one.id))
        engine = SharedDiagnosing(model, observed, predictor, known, solver, tuple(free_paths(model)), shared=shared)
        fit = engine.ground(engine.fitted(model)).fit
        projected = Projected.of(engine.signatures(fit, engine.effects), fit.basis)
        products = projected.columns @ fit.residual_with_priors / np.sqrt(fit.variance_scale)
        z = products / np.sqrt(np.diag(projected.gram))
        single = [
            (one.effect.name, part.start)
            for one, part in zip(projected.candidates, projected.slices(), strict=True)
            if not one.is_group
        ]
        names = [name for name, _ in single]
        drawn.append(z[[row for _, row in single]])
    return names, np.array(drawn)


def told(light: str, names: list[str], z: NDArray[np.float64]) -> str:
    """One light in words."""
    mean, within = z.mean(axis=0), z.var(axis=0, ddof=1)
    shared = mean**2 - within / len(z)
    first, *others = (_of_shared(z, draw) for draw in range(len(z)))
    loudest: dict[str, float] = {}
    for name, value in sorted(zip(names, mean, strict=True), key=lambda one: -abs(one[1])):
        loudest.setdefault(name, float(value))
    most = ", ".join(f"{name} {value:+.1f}" for name, value in list(loudest.items())[:SHOWN])
    squares = within.mean(), shared.mean(), (within + shared).mean()
    figures = f"{len(z):>8}{len(names):>8}" + "".join(f"{one:>8.2f}" for one in (*squares, first, np.std(others)))
    return f"{light:<12}{figures}  {most}"


def _of_shared(z: NDArray[np.float64], draw: int) -> float:
    """How much of the mean of all others but the first is in a draw."""
    mean = np.delete(z, list({0, draw}), axis=0).mean(axis=0)
    return float(z[draw] @ mean / (mean @ mean))


def main() -> None:
    """Run it and print the table."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("folder", type=Path)
    asked.add_argument("--lights", type=int, default=100, help="at most so many")
    asked.add_argument("--seed", type=int, default=1, help="of the anchors")
    given = asked.parse_args()
    index = read_index(given.folder)
    model, sets = chosen_model(given.folder, index, None), sorted(index.sets, key=lambda one: (one.light, one.id))
    heads = "".join(f"{name:>8}" for name in ("draws", "columns", "within", "shared", "all", "first", "+-"))
    print(f"{'light':<12}{heads}  means of z that are largest")
    with Client(load_settings(), patience_s=600.0) as client:
        for number, (light, some) in enumerate(groupby(sets, key=lambda one: one.light)):
            if number < given.lights:
                print(told(light, *scores_of(light, list(some), given.folder, client, model, given.seed)), flush=True)


if __name__ == "__main__":
    main()
