"""The joint fit of the model to the paper's five numbers, under every reading of what the paper leaves open.

    python benchmarks/paper_fit.py [--blocks 4] [--places 16] [--screen-error 0.5] [--target-error 0.12] [--best 4]
                                   [--within 1.5] [--only NAME ...] [--flux-error 2e-4] [--threads 1]

The five: U of four designs in percent, and the change of S_b3's mean illuminance by its DBR; their residuals (model
less paper) count in points and in percent of lux. A reading is searched by full walks at places all over the ranges
of its free parameters, then about the best place of what is smooth between them, first with the values of the paper's
Table 4 held, then, for the readings that come near, with these free under their priors. Each best place is walked
again with a seed that no search has used. The best of all are sought on with more histories; for these come
the spread and correlation of the parameters, and the flux that gives the paper's lux. `--blocks`, `--places` and the
errors are the budget: `--places 8 --screen-error 0.6` took 28 readings with Table 4 held in 13 minutes on one core.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import qmc

from benchmarks import cells
from benchmarks.processes import table
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.tally import Tally
from containers.scene import Scene
from luxloop.model import Environment, Surface
from luxloop.photometry import luminous_efficacy_lm_per_w
from luxloop.words import parse

Real = NDArray[np.float64]

PAPER = np.array([68.15, 90.32, 83.97, 86.51, 100.0 * (109_814.0 / 119_910.0 - 1.0)])
BARE_LX = 119_910.0
FRESH = 20_000
NEAR_POINTS = 5.0
SIGNAL, REACH = 15.0, 0.7
"""Of the smooth five: how far a number strays, in points, and over which share of a parameter's range."""
NEAR, ROUNDS, FINER = 0.15, 3, 8
STEP, WORTH = 0.08, 1.0
"""Of the differences, wide because noise is common only in part; of the sum of squares, what a step must bring."""
STARTS = 5


@dataclass(frozen=True)
class Free:
    """A parameter that the fit may move."""

    lower: float
    upper: float
    mean: float | None = None
    sd: float | None = None
    """Of the prior; none: flat between the limits."""
    log: bool = False
    """Whether equal ways are equal ratios."""

    def value(self, way: float) -> float:
        """At a share of the way from lower to upper."""
        if self.log:
            return float(self.lower * (self.upper / self.lower) ** way)
        return float(self.lower + (self.upper - self.lower) * way)

    def way(self, value: float) -> float:
        """The reverse of `value`, of one whose ways are not equal ratios."""
        return (value - self.lower) / (self.upper - self.lower)


SIGMA = "substrate.sigma_deg"
DEPTH = {"active_layer_depth": Free(0.0, 1.0)}
LOSS = {"chip_absorption_per_cm": Free(10.0, 500.0, log=True)}
TABLE_4 = {
    "substrate.reflectance": Free(0.93, 0.99, 0.97, 0.01),
    SIGMA: Free(0.5, 15.0, 5.0, 2.5),
    "receiver.reflectance": Free(0.20, 0.40, 0.35, 0.05),
}
HELD = {name: one.mean for name, one in TABLE_4.items() if one.mean is not None}
WELLS = {"top": 0.99, "bottom": 0.01}
"""Where wells can be: 0.15 to 0.35 um from a face of these chips; `thin` seeks the place, `volume` has none."""
RECEIVER_DEG = 15.0
"""Of a receiver with a lobe: the widest that the paper tried."""


@dataclass(frozen=True)
class Reading:
    """One choice of all that is no number."""

    chip_bottom: str = "contact"
    emission: str = "isotropic"
    layer: str = "thin"
    substrate: str = "gaussian"
    receiver: str = "lambertian"
    others: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        words = [self.chip_bottom, self.emission, self.layer, self.substrate]
        words += [f"receiver {self.receiver}"] if self.receiver != "lambertian" else []
        return ", ".join([*words, *(f"{key} {value}" for key, value in self.others.items())])

    def free(self, table_4: bool) -> dict[str, Free]:
        """What the fit moves."""
        found = (DEPTH if self.layer == "thin" else {}) | LOSS
        if table_4:
            found |= {name: one for name, one in TABLE_4.items() if self.substrate == "gaussian" or name != SIGMA}
        return found

    def environment(self, values: Mapping[str, float]) -> Environment:
        """The environment at values of the free parameters."""
        at = {**HELD, **values}
        substrate_deg = at[SIGMA] if self.substrate == "gaussian" else None
        receiver_deg = RECEIVER_DEG if self.receiver == "gaussian" else None
        changes = {
            "chip_bottom": self.chip_bottom,
            "emission": self.emission,
            "active_layer_depth": at.get("active_layer_depth", WELLS.get(self.layer)),
            "chip_absorption_per_cm": at["chip_absorption_per_cm"],
            "substrate": surface(self.substrate, substrate_deg, at["substrate.reflectance"]),
            "receiver": surface(self.receiver, receiver_deg, at["receiver.reflectance"]),
        }
        return cells.CLEAR.model_copy(update=changes | dict(self.others))


def surface(scatter: str, sigma_deg: float | None, reflectance: float) -> Surface:
    """A surface of the environment."""
    return parse(Surface, {"scatter": scatter, "sigma_deg": sigma_deg, "reflectance": reflectance})


BOTTOMS, EMISSIONS = ("contact", "mirror", "air_gap"), ("isotropic", "in_plane_dipole")
GAP = {"spacing_is": "gap"}
READINGS = [
    *(Reading(*words) for words in product(BOTTOMS, EMISSIONS, ("thin", "volume"), ("gaussian", "lambertian"))),
    *(Reading(bottom, layer=layer) for bottom, layer in product(BOTTOMS, WELLS)),
    *(Reading(bottom, layer=layer, others=GAP) for bottom, layer in product(BOTTOMS, WELLS)),
    Reading("mirror", receiver="gaussian"),
    *(Reading(bottom, others=GAP) for bottom in ("contact", "mirror")),
    Reading("mirror", others={**GAP, "distance_from": "chip_top"}),
]


def numbers(environment: Environment, blocks: int, seed: int, threads: int) -> tuple[Real, Real]:
    """The five and their standard errors, from so many blocks of histories in every group."""
    return of_solvers(environment, lambda scene: walked(scene, blocks, seed, threads))


def to_error(environment: Environment, error: float, seed: int, threads: int) -> tuple[Real, Real]:
    """The five and their standard errors, each U walked until its own is at most `error` points."""

    def walk(scene: Scene) -> Tally:
        solver = cells.full_walk(scene, seed, threads=threads)
        cells.to_error(solver, scene, error)
        return solver.tally

    return of_solvers(environment, walk)


def walked(scene: Scene, blocks: int, seed: int, threads: int) -> Tally:
    """So many blocks of every group."""
    return cells.full_walk(scene, seed, threads=threads).run_to(blocks * BLOCK)


def of_solvers(environment: Environment, walk: Callable[[Scene], Tally]) -> tuple[Real, Real]:
    """The five of an environment; the change's error takes its two means for independent."""
    scenes = [cells.scene_for(environment, design) for design in cells.DESIGNS.values()]
    tallies = [walk(scene) for scene in scenes]
    shares = [cells.uniformity_of(scene, tally) for scene, tally in zip(scenes, tallies, strict=True)]
    (bare, bare_error), (dbr, dbr_error) = (cells.mean_of(scenes[at], tallies[at]) for at in range(2))
    error = dbr / bare * np.hypot(bare_error / bare, dbr_error / dbr)
    return (
        100.0 * np.array([*(one.value for one in shares), dbr / bare - 1.0]),
        100.0 * np.array([*(one.standard_error for one in shares), error]),
    )


class Smooth:
    """The five between the places walked: Gaussian processes of a radial kernel, given the noise of each place."""

    def __init__(self, ways: Real, seen: Real, errors: Real) -> None:
        self._ways, self._mean = ways, seen.mean(axis=0)
        likeness = self._kernel(ways)
        self._weights = np.stack(
            [
                np.linalg.solve(likeness + np.diag(e**2), s)
                for e, s in zip(errors.T, (seen - self._mean).T, strict=True)
            ],
            axis=1,
        )

    def __call__(self, ways: Real) -> Real:
        return np.asarray(self._mean + (self._kernel(ways[None]) @ self._weights)[0])

    def _kernel(self, ways: Real) -> Real:
        squares = ((ways[:, None] - self._ways[None]) ** 2).sum(axis=2)
        return np.asarray(SIGNAL**2 * np.exp(-squares / (2.0 * REACH**2)))


class Search:
    """A reading's fit: places walked, and the best place of what is smooth between them."""

    def __init__(self, reading: Reading, free: Mapping[str, Free], threads: int) -> None:
        self.reading, self.free, self.threads = reading, free, threads
        self._ways, self._seen, self._errors = list[Real](), list[Real](), list[Real]()

    def spread_out(self, places: int, blocks: int) -> None:
        """Walk places all over the ranges, with so many blocks of histories each."""
        for ways in qmc.Sobol(len(self.free), seed=1).random(places):
            self._walk(ways, blocks)

    @property
    def seen(self) -> Real:
        """(place, number) as walked."""
        return np.array(self._seen)

    def widened(self, free: Mapping[str, Free]) -> Search:
        """A search of more parameters that knows this one's places, the new ones at their priors' means."""
        wide = Search(self.reading, free, self.threads)
        more = [one.way(HELD[name]) for name, one in free.items() if name not in self.free]
        wide._ways = [np.array([*ways, *more]) for ways in self._ways]
        wide._seen, wide._errors = list(self._seen), list(self._errors)
        return wide

    def close_in(self, rounds: int, places: int, blocks: int, near: float) -> Best:
        """The best place, after rounds of places about it, each round half as far from it as the one before."""
        rng = np.random.default_rng(len(self._seen))
        for turn in range(rounds):
            at = self.best().ways
            for ways in (at, *rng.normal(at, near / 2.0**turn, (places - 1, at.size))):
                self._walk(np.clip(ways, 0.0, 1.0), blocks)
        return self.best()

    def _walk(self, ways: Real, blocks: int) -> None:
        seed = 1 + len(self._seen)  # another at every place: noise averages out
        seen, errors = numbers(self.reading.environment(self.values(ways)), blocks, seed, self.threads)
        for known, new in ((self._ways, ways), (self._seen, seen), (self._errors, errors)):
            known.append(new)

    def values(self, ways: Real) -> dict[str, float]:
        """The parameters themselves."""
        return {name: one.value(float(way)) for (name, one), way in zip(self.free.items(), ways, strict=True)}

    def priors(self, ways: Real) -> list[float]:
        """Distances from the priors' means in their standard deviations."""
        values = self.values(ways)
        return [(values[n] - one.mean) / one.sd for n, one in self.free.items() if one.sd and one.mean is not None]

    def best(self) -> Best:
        """The least misfit of the smooth five and the priors, sought from the places that are best so far."""
        smooth = Smooth(np.array(self._ways), np.array(self._seen), np.array(self._errors))

        def misfit(ways: Real) -> Real:
            return np.array([*(smooth(ways) - PAPER), *self.priors(ways)])

        starts = sorted(self._ways, key=lambda ways: float((misfit(ways) ** 2).sum()))[:STARTS]
        inside = (np.clip(start, 1e-3, 1.0 - 1e-3) for start in starts)
        found = min((least_squares(misfit, start, bounds=(0.0, 1.0)) for start in inside), key=lambda one: one.cost)
        return Best(self, found.x, found.fun, found.jac)


@dataclass(frozen=True, eq=False)
class Best:
    """Where a search came to."""

    search: Search
    ways: Real
    misfit: Real
    slopes: Real
    """(residual or prior, parameter) per way"""

    @property
    def values(self) -> dict[str, float]:
        """The parameters there."""
        return self.search.values(self.ways)

    def spread(self) -> tuple[Real, Real]:
        """Standard deviations of the ways were each number known to 1, and their correlations."""
        covariance = np.linalg.pinv(self.slopes.T @ self.slopes)
        deviations = np.sqrt(np.diag(covariance))
        return deviations, covariance / np.outer(deviations, deviations)


@dataclass(frozen=True, eq=False)
class Row:
    """A reading's best place, and its five as walked anew."""

    name: str
    best: Best
    seen: Real
    errors: Real

    @property
    def residuals(self) -> Real:
        """Model less paper."""
        return np.asarray(self.seen - PAPER)

    @property
    def squares(self) -> float:
        """Sum of the squares of the five."""
        return float((self.residuals**2).sum())

    @property
    def priors(self) -> float:
        """Sum of the squares of the distances from the priors' means."""
        return float((self.best.misfit[5:] ** 2).sum())

    def misfit(self) -> float:
        """What the fit makes small."""
        return self.squares + self.priors

    def cells(self) -> tuple[str, ...]:
        """For a table; a value in brackets was held."""
        at, free = {**HELD, **self.best.values}, self.best.values
        names = (*DEPTH, *LOSS, *TABLE_4)
        shown = [f"{at[n]:.3g}" if n in free else f"({at[n]:g})" if n in at else "-" for n in names]
        residuals = [f"{r:+.2f} +- {e:.2f}" for r, e in zip(self.residuals, self.errors, strict=True)]
        own = 2.0 * float(np.sqrt(((self.residuals * self.errors) ** 2).sum()))
        return self.name, str(len(free)), *shown, *residuals, f"{self.squares:.0f} +- {own:.0f}", f"{self.priors:.1f}"


VALUES = "layer / T", "loss /cm", "rho_s", "sigma", "rho_r"
HEADS = ("reading", "free", *VALUES, *cells.DESIGNS, "lux", "squares", "priors")


def searched(reading: Reading, options: argparse.Namespace) -> Best:
    """A reading's best place by a coarse search, Table 4's values held."""
    search = Search(reading, reading.free(False), options.threads)
    search.spread_out(options.places * len(search.free), options.blocks)
    return search.close_in(ROUNDS, 2 + 2 * len(search.free), options.blocks, NEAR)


def freed(best: Best, options: argparse.Namespace) -> Best:
    """The search gone on with Table 4's values free."""
    wide = best.search.widened(best.search.reading.free(True))
    return wide.close_in(ROUNDS, 2 + 2 * len(wide.free), options.blocks, NEAR)


def refined(best: Best, blocks: int) -> Best:
    """The search gone on from its best place by Gauss-Newton steps, with one seed for all that is compared."""
    search, ways = best.search, best.ways

    def misfit(ways: Real) -> Real:
        environment = search.reading.environment(search.values(ways))
        return np.array([*(numbers(environment, blocks, FRESH - 1, search.threads)[0] - PAPER), *search.priors(ways)])

    here = misfit(ways)
    slopes = differences(misfit, ways)
    for _ in range(ROUNDS):
        step = lsq_linear(slopes, -here, (np.maximum(-NEAR, -ways - 1e-9), np.minimum(NEAR, 1.0 - ways + 1e-9))).x
        tried = [np.clip(ways + share * step, 0.0, 1.0) for share in (1.0, 0.4)]
        found = [misfit(one) for one in tried]
        least = int(np.argmin([one @ one for one in found]))
        if found[least] @ found[least] >= here @ here - WORTH:
            break
        ways, here = tried[least], found[least]
        slopes = differences(misfit, ways)
    return Best(search, ways, here, slopes)


def differences(misfit: Callable[[Real], Real], ways: Real) -> Real:
    """Jacobian (residual or prior, parameter) per way, by differences a little to both sides, inside the limits."""
    columns = []
    for one in np.eye(ways.size):
        high, low = np.clip(ways + STEP * one, 0.0, 1.0), np.clip(ways - STEP * one, 0.0, 1.0)
        columns.append((misfit(high) - misfit(low)) / float((high - low) @ one))
    return np.stack(columns, axis=1)


def walked_again(best: Best, error: float, threads: int) -> Row:
    """A best place with its five from a fresh seed."""
    reading = best.search.reading
    row = Row(str(reading), best, *to_error(reading.environment(best.values), error, FRESH, threads))
    print("  " + "  ".join(row.cells()), flush=True)
    return row


def flux(environment: Environment, error: float, threads: int) -> str:
    """The flux of a chip that gives the paper's lux without DBR, and what it rests on."""
    design = cells.DESIGNS["S_b3 without DBR"]
    scene = cells.scene_for(environment, design)
    solver, blocks = cells.full_walk(scene, FRESH, threads=threads), 16
    while True:
        mean, own = cells.mean_of(scene, solver.run_to(blocks * BLOCK))
        if own <= error * mean:
            break
        blocks *= 2
    efficacy = luminous_efficacy_lm_per_w(environment.peak_nm, environment.fwhm_nm)
    flux_w = BARE_LX / efficacy * (design.spacing_um * 1e-6) ** 2 / mean
    histories = solver.tally.total_histories / 1e6
    return f"{flux_w:.4g} W: {efficacy:.5g} lm/W, mean {mean:.5f} +- {own:.5f} from {histories:.1f} M histories"


def starts(rows: Sequence[Row]) -> list[Best]:
    """Where to seek on: of each search its own place, or that of a held one of the same reading if that is better."""
    found = []
    for row in sorted(rows, key=Row.misfit):
        search, least = row.best.search, min((r for r in rows if r.name == row.name), key=Row.misfit)
        more = [one.way(HELD[name]) for name, one in search.free.items() if name not in least.best.search.free]
        ways = row.best.ways if more == [] else np.array([*least.best.ways, *more])
        found.append(replace(row.best, ways=ways))
    return found


def contradiction(rows: Sequence[Row]) -> str:
    """How near S_b1 came to S_b2 wherever both S_b3 were near the paper's numbers."""
    seen = np.concatenate([row.best.search.seen for row in rows])
    near = seen[np.abs(seen - PAPER)[:, :2].max(axis=1) < NEAR_POINTS]
    least, told = (near[:, 2] - near[:, 3]).min(initial=np.inf), PAPER[2] - PAPER[3]
    where = f"at {len(near)} of {len(seen)} places walked, where both S_b3 are within {NEAR_POINTS:g} points"
    return f"{where}, S_b1 - S_b2 is {least:+.1f} or more; the paper has {told:+.1f}"


def print_spread(row: Row) -> None:
    """Standard deviations and correlations of a row's parameters, each of the five taken as known to 1."""
    best, free = row.best, row.best.search.free
    deviations, correlations = best.spread()
    lines = []
    for at, (name, one) in enumerate(free.items()):
        low, high = (one.value(float(np.clip(best.ways[at] + s * deviations[at], 0.0, 1.0))) for s in (-1.0, 1.0))
        lines.append((name, f"{best.values[name]:.4g}", f"{low:.3g} to {high:.3g}", *np.round(correlations[at], 2)))
    table(f"{row.name}: parameters, were each number known to 1", lines, ("parameter", "best", "one sd", *free))


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blocks", type=int, default=4, help="of 32,768 histories at each place of the search")
    parser.add_argument("--places", type=int, default=16, help="all over the range of one parameter; of more, more")
    parser.add_argument("--screen-error", type=float, default=0.5, help="of every U, in points, in the first table")
    parser.add_argument("--target-error", type=float, default=0.12, help="of every U in the last one")
    parser.add_argument("--best", type=int, default=4, help="how many are sought on with more histories")
    parser.add_argument("--within", type=float, default=1.5, help="of the least squares: Table 4 is freed as well")
    parser.add_argument("--flux-error", type=float, default=2e-4, help="share of the mean illuminance")
    parser.add_argument("--only", default=[], nargs="*", help="names of readings, as the table has them; none: all")
    parser.add_argument("--threads", type=int, default=1)
    return parser.parse_args()


def main() -> None:
    options = arguments()
    cells.full_walk(cells.golden_scene("B"), 1, threads=1).run_to(128)  # compiled
    print(cells.load())
    seen, errors = to_error(cells.PAPER, options.target_error, FRESH, options.threads)
    shown = "  ".join(f"{r:+.2f} +- {e:.2f}" for r, e in zip(seen - PAPER, errors, strict=True))
    print(f"the shipped model, less the paper: {shown}; squares {((seen - PAPER) ** 2).sum():.1f}")
    print("each reading sought, then walked again; Table 4's values held, as brackets say")
    chosen = [one for one in READINGS if not options.only or str(one) in options.only]
    rows = [walked_again(searched(one, options), options.screen_error, options.threads) for one in chosen]
    least = min(row.squares for row in rows)
    near = [row.best for row in rows if row.squares <= options.within * least]
    print(f"those within {options.within:g} times the least squares, Table 4's values free")
    rows += [walked_again(freed(one, options), options.screen_error, options.threads) for one in near]
    rows.sort(key=Row.misfit)
    table("coarse search, model less paper", [row.cells() for row in rows], HEADS)
    print(contradiction(rows))
    print(f"the best sought on, {FINER} times the histories at each place")
    blocks, finer = FINER * options.blocks, starts(rows)[: options.best]
    rows = [walked_again(refined(best, blocks), options.target_error, options.threads) for best in finer]
    rows.sort(key=Row.misfit)
    table("model less paper", [row.cells() for row in rows], HEADS)
    for row in rows:
        print_spread(row)
        environment = row.best.search.reading.environment(row.best.values)
        print("  flux_per_chip_w", flux(environment, options.flux_error, options.threads))
    print(cells.load())


if __name__ == "__main__":
    main()
