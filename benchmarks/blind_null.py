"""Blind sets with nothing hidden: do scores scatter as much as is told, and what do draws of one light share?

    python -m benchmarks.blind_null FOLDER [--lights 4] [--seed 2]

A line for each light, of all columns of effects at the fits. `all`: the mean square of z over its draws, 1 were each
draw a truth of its own. `within`: what scatters between draws; `shared`: what they have in common, both together
`all`. Two things may be shared, and are told to the verdict: the noise of the anchor, `anchor` of the variance, and
how far the truth lies from what was known of it before, `priors` of the variance where draws have these in common
(`own priors` says no: each draw has its own). The seals are open, so the latter is known: `left` is what is shared
once it is taken out, on average as much as `anchor` says. Columns are much alike: by seven seeds of one light `left`
was 0.03 to 0.29 where 0.12 is told. Needs sets that were scored and hide nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from luxloop.client import Client
from luxloop.errors import InputError
from luxloop.model import Model
from luxloop.settings import load_settings
from validation.blind_test.folders import OPENED, SETS, Entry, read_index
from validation.blind_test.judging import Shared, SharedDiagnosing, SharedSolver, chosen_model, seed_of_light
from validation.blind_test.records import read_record
from validation.blind_test.seals import opened, refuse_other_entry
from validation.blind_test.truths import truth_of
from validation.comparing import Solver
from validation.dataset.folder import read_dataset
from validation.diagnose.score import Projected
from validation.effects.known import Known
from validation.fit import Fit
from validation.fit.parameters import free_paths
from validation.observed import Observed
from validation.prediction import Predictor

Real = NDArray[np.float64]

HISTORIES = 4_000_000
"""Of an anchor, as `blind diagnose` has them."""
SHOWN = 5


@dataclass(frozen=True)
class Draw:
    """What the columns of effects find in a draw; all (column,)."""

    names: list[str]
    z: Real
    by_truth: Real
    """Of z: what comes of how far the truth lies from the priors."""
    of_priors: Real
    """Of the variance: theirs."""
    of_anchor: Real


def drawn(folder: Path, light: str, sets: list[Entry], client: Client, model: Model, seed: int | None) -> list[Draw]:
    """All draws of a light, as verdicts see them; `seed`: of another diagnosis than theirs."""
    truths = [true_leaves(folder, one, model) for one in sets]
    predictor, known, shared = Predictor(client), Known.ask(client), Shared(light)
    own_seed = int(read_record(folder, sets[0].id)["seed"])
    plain = Solver.of_diagnosis(HISTORIES, own_seed if seed is None else seed_of_light(seed, light), None)
    solver = SharedSolver(plain.histories, plain.seed, plain.most_histories, shared=shared)
    found = []
    for one, truth in zip(sets, truths, strict=True):
        observed, own = Observed.of(read_dataset(folder / SETS / one.id)), one.known_before(model)
        engine = SharedDiagnosing(own, observed, predictor, known, solver, tuple(free_paths(model)), shared=shared)
        fit = engine.ground(engine.fitted(own)).fit
        projected = Projected.of(engine.signatures(fit, engine.effects), fit.basis)
        found.append(draw_of(projected, fit, truth))
    return found


def true_leaves(folder: Path, one: Entry, model: Model) -> dict[str, float]:
    """The truth of a set by path of the model. Raises InputError where its seal is shut, or something is hidden."""
    if not (folder / OPENED / f"{one.id}.json").exists():
        raise InputError(
            "FOLDER", f"{folder}: {one.id}", "sets whose seals are open", "luxloop blind score comes first"
        )
    answer = opened(folder, one.id, read_record(folder, one.id))
    refuse_other_entry(one, answer)
    truth = truth_of(int(answer.truth["number"]), model, 0, answer.seed)
    if answer.hidden or answer.truth["surroundings"] != truth.document()["surroundings"]:
        mend = "make some with `luxloop blind make --nothing`"
        raise InputError(f"{one.id}: answer", "something else", "the truth of this model, with nothing hidden", mend)
    leaves = truth.model.leaves()
    return {path: float(leaves[path]) for path in free_paths(model)}


def draw_of(projected: Projected, fit: Fit, truth: Mapping[str, float]) -> Draw:
    """The columns of single effects in a fit."""
    single = [
        (one.effect.name, part.start)
        for one, part in zip(projected.candidates, projected.slices(), strict=True)
        if not one.is_group
    ]
    columns = projected.columns[[row for _, row in single]]
    columns = columns / np.linalg.norm(columns, axis=1)[:, None]
    z, rows = columns @ fit.residual_with_priors / np.sqrt(fit.variance_scale), len(fit.residual)
    held = fit.active & ~fit.reduced.blind & (fit.reduced.prior_weight > 0.0)
    by = [p for p, one in zip(fit.problem.unknowns.parameters, held, strict=True) if one]
    off = np.array([(p.prior_mean - truth[p.name]) / p.prior_sd if p.name in truth else 0.0 for p in by])
    priors = columns[:, rows:] * [p.name in truth for p in by]
    of_anchor = np.zeros(len(z))
    for block in fit.whitening.noise:
        size, axes = np.linalg.eigh(block.columns @ block.columns.T)
        axes, size = axes[:, size > 1e-9 * size[-1]], size[size > 1e-9 * size[-1]]
        along = columns[:, block.rows] @ (block.columns.T @ axes / np.sqrt(size))
        of_anchor += along**2 @ (size / (1.0 + size))
    by_truth = priors @ off / np.sqrt(fit.variance_scale)
    return Draw([name for name, _ in single], z, by_truth, np.sum(priors**2, axis=1), of_anchor)


def told(light: str, draws: list[Draw], *, own_priors: bool) -> str:
    """One light in words."""
    z, by_truth = (np.array([getattr(one, name) for one in draws]) for name in ("z", "by_truth"))
    (within, shared), (_, left) = _parted(z), _parted(z - by_truth)
    of_anchor, of_priors = (
        float(np.mean([getattr(one, name) for one in draws])) for name in ("of_anchor", "of_priors")
    )
    loudest: dict[str, float] = {}
    for name, value in sorted(zip(draws[0].names, z.mean(axis=0), strict=True), key=lambda one: -abs(one[1])):
        loudest.setdefault(name, float(value))
    most = ", ".join(f"{name} {value:+.1f}" for name, value in list(loudest.items())[:SHOWN])
    figures = (within + shared, within, shared, left, of_anchor, of_priors)
    words = "".join(f"{one:>8.2f}" for one in figures)
    return f"{light:<12}{len(z):>8}{z.shape[1]:>8}{words}{'yes' if own_priors else 'no':>12}  {most}"


def _parted(z: Real) -> tuple[float, float]:
    """Mean squares within draws and shared by them, of z (draw, column)."""
    within = z.var(axis=0, ddof=1)
    return float(within.mean()), float((z.mean(axis=0) ** 2 - within / len(z)).mean())


def main() -> None:
    """Run it and print the table."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("folder", type=Path)
    asked.add_argument("--lights", type=int, default=100, help="at most so many")
    asked.add_argument("--seed", type=int, help="of another diagnosis; default: as the verdicts had")
    given = asked.parse_args()
    index = read_index(given.folder)
    model, sets = chosen_model(given.folder, index, None), sorted(index.sets, key=lambda one: (one.light, one.id))
    heads = ("draws", "columns", "all", "within", "shared", "left", "anchor", "priors")
    print(f"{'light':<12}{''.join(f'{name:>8}' for name in heads)}{'own priors':>12}  means of z that are largest")
    with Client(load_settings(), patience_s=600.0) as client:
        for number, (light, some) in enumerate(groupby(sets, key=lambda one: one.light)):
            several = list(some)
            if number < given.lights and len(several) > 1:
                draws = drawn(given.folder, light, several, client, model, given.seed)
                print(told(light, draws, own_priors=bool(several[0].priors)), flush=True)


if __name__ == "__main__":
    main()
