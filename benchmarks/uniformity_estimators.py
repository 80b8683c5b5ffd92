"""How far off the uniformity of a noisy tally is, by which method, and how often its interval holds the truth.

    python benchmarks/uniformity_estimators.py [--trials 600] [--speed | --stopped [--target-error 0.3]]

Synthetic cells of known min / max on the line through the chips, landings drawn as multinomial counts in 32 groups,
folded 8 times or not. Errors and biases in points (0.01 of U); `mean error` in standard deviations of the value.
`--speed` times a 256 x 256 x 32 tally instead.

`--stopped`: whole runs, stopped by the worker's rule at an error, whose modes are weighed as those of a tally are
(light.py); with what weights may have hidden left out of account (`as tallied`) and reckoned with (`ours`). Reliefs
of some shapes, as high as makes the U wanted; noise per mode as in a run of D 180, W 56, S 300, T 5 um, 6.5 pairs.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from benchmarks import cells
from containers.ray_tracing.estimate import Estimate, estimate, student_t
from containers.ray_tracing.field import Axis, CellField
from containers.ray_tracing.light import _share_of_first, _share_of_later, _weighed
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.stopping import FIRST_BLOCKS, next_blocks
from containers.ray_tracing.uniformity import cell_region, metrics_of, uniformity
from luxloop.design import Design

Real = NDArray[np.float64]
S, HEIGHT, GROUPS, BINS = 500.0, 145.0, 32, 32
REGION = cell_region(S)
RINGS = tuple[float, float, float]  # amplitudes of the rings (1, 0), (1, 1), (2, 0)
CELLS: dict[str, tuple[RINGS, int]] = {
    "ring": ((0.35, 0.10, -0.20), 40_000),
    "centre and corner": ((0.50, 0.12, 0.06), 40_000),
    "nearly flat, ring": ((0.015, 0.0, -0.012), 100_000),
    "nearly flat, ring, noisy": ((0.015, 0.0, -0.012), 10_000),
    "nearly flat, centre": ((0.03, 0.0, 0.0), 100_000),
}


def bin_means(rings: RINGS) -> Real:
    """Bin means of 1 + a (cos kx + cos ky) / 2 + b cos kx cos ky + c (cos 2kx + cos 2ky) / 2."""
    edges = 2.0 * np.pi * (np.arange(BINS + 1) / BINS - 0.5)
    one, two = (np.diff(np.sin(m * edges)) / m * BINS / (2.0 * np.pi) for m in (1, 2))
    a, b, c = rings
    flat = np.ones(BINS)
    single = a * one + c * two
    return np.asarray(1.0 + (np.outer(flat, single) + np.outer(single, flat)) / 2.0 + b * np.outer(one, one))


def tallies(rings: RINGS, histories: int, trials: int, fold: bool) -> list[CellField]:
    """Fields of independent tallies."""
    rng = np.random.default_rng(5)
    probability = bin_means(rings).ravel() / BINS**2
    found = []
    for _ in range(trials):
        bins = rng.multinomial(histories, probability, size=GROUPS).reshape(GROUPS, BINS, BINS).astype(float)
        if fold:
            bins = bins + bins[:, :, ::-1]
            bins = bins + bins[:, ::-1, :]
            bins = (bins + bins.transpose(0, 2, 1)) / 8.0
        found.append(CellField.from_bins(bins, histories, S, HEIGHT))
    return found


def ratio(values: Real) -> Real:
    return np.asarray(values.min(axis=-1) / values.max(axis=-1))


def plain(field: CellField) -> Estimate:
    lines = field.line(REGION.line_um)
    return Estimate(float(ratio(lines.mean(axis=0))), delete_one(field).standard_error, 0.0, GROUPS)


def delete_one(field: CellField) -> Estimate:
    lines = field.line(REGION.line_um)
    value = float(ratio(lines.mean(axis=0)))
    without = ratio((lines.sum(axis=0) - lines) / (GROUPS - 1))
    bias = (GROUPS - 1) * float(without.mean() - value)
    return Estimate(value - bias, float(np.sqrt((GROUPS - 1) * without.var())), bias, GROUPS)


def delete_half(field: CellField) -> Estimate:
    lines = field.line(REGION.line_um)
    value = float(ratio(lines.mean(axis=0)))
    order = np.random.default_rng(1).permuted(np.tile(np.arange(GROUPS), (100, 1)), axis=1)
    half = (order < GROUPS // 2) * 2.0 / GROUPS
    halves = ratio(np.concatenate([half, 2.0 / GROUPS - half]) @ lines)
    bias = float(halves.mean()) - value
    return Estimate(value - bias, float(halves.std()), bias, GROUPS)


def about_the_mean(field: CellField) -> Estimate:
    return estimate(ratio, field.line(REGION.line_um))


def ours(field: CellField) -> Estimate:
    return uniformity(field, REGION)


METHODS: dict[str, Callable[[CellField], Estimate]] = {
    "plain min / max": plain,
    "delete-one jackknife": delete_one,
    "delete-half jackknife": delete_half,
    "bootstrap about the mean": about_the_mean,
    "ours: about the denoised mean": ours,
}


def coverage(trials: int) -> None:
    """The table."""
    t = student_t(0.95, GROUPS - 1)
    for fold in (True, False):
        for name, (rings, histories) in CELLS.items():
            exact = np.repeat(bin_means(rings)[None], 2, axis=0)
            truth = float(ratio(CellField.from_bins(exact, BINS**2, S, HEIGHT).line(REGION.line_um)[0]))
            print(f"\n{name}, U {truth:.4f}, {GROUPS} x {histories} histories{', folded' if fold else ''}")
            print(f"{'':32}{'mean error':>11}{'spread':>8}{'rms':>7}{'stated':>8}{'bias':>8}{'95 % hold':>11}")
            measured = tallies(rings, histories, trials, fold)
            for method, of in METHODS.items():
                found = [of(field) for field in measured]
                error = 100.0 * (np.array([one.value for one in found]) - truth)
                stated = 100.0 * np.array([one.standard_error for one in found])
                bias = 100.0 * np.mean([one.bias for one in found])
                held = 100.0 * np.mean(np.abs(error) <= t * stated)
                print(
                    f"  {method:30}{error.mean() / error.std():+11.2f}{error.std():8.3f}"
                    f"{np.sqrt((error**2).mean()):7.3f}{stated.mean():8.3f}{bias:+8.3f}{held:11.1f}"
                )


FLAT = Design.from_vector((180.0, 56.0, 300.0, 5.0, 6.5))
MODES = 10
FIRST_MEAN, LATER_MEAN = 0.135, 0.068
FIRST_NOISE, LATER_NOISE = 0.005, 0.006  # variance of a mode's mean, times histories
RELIEFS: dict[str, dict[tuple[int, int], float]] = {
    "high cross": {(0, 2): 2.9, (0, 3): 9.7, (0, 4): 5.6, (0, 5): 1.5, (1, 3): 2.0, (1, 4): 2.7},  # of FLAT
    "cosine": {(0, 1): 1.0},
    "ring": {(0, 1): 1.0, (0, 2): -0.8},
    "S_b3": {(0, 1): 200.0, (1, 1): 132.0, (0, 2): -92.0, (0, 3): -32.0, (1, 2): -15.0, (2, 2): 10.0, (0, 4): -10.0},
}
TRUTHS = (1.0, 0.9985, 0.995, 0.99, 0.985, 0.97, 0.9, 0.66)


def modes_of(relief: dict[tuple[int, int], float], height: float) -> Real:
    """(layer, y, x): means of first and later light, and a relief of the first with that root mean square."""
    modes = np.zeros((2, MODES + 1, MODES + 1))
    for (a, b), amplitude in relief.items():
        modes[0, a, b] = modes[0, b, a] = amplitude
    modes *= height / np.sqrt((modes**2).sum())
    modes[:, 0, 0] = FIRST_MEAN, LATER_MEAN
    return modes


class Stopped:
    """Runs of one truth."""

    def __init__(self, relief: dict[tuple[int, int], float], truth: float) -> None:
        self.scene = cells.scene_for(cells.PAPER, FLAT)
        self.axis = Axis(0.0, FLAT.spacing_um / 2.0, MODES, "even")
        self.region = cell_region(FLAT.spacing_um)

        def excess(height: float) -> float:
            line = self.field(np.repeat(modes_of(relief, height).sum(axis=0)[None], 2, axis=0)).line(
                self.region.line_um
            )[0]
            return float(ratio(line)) - truth

        self.modes = modes_of(relief, float(brentq(excess, 0.0, 0.1)) if truth < 1.0 else 0.0)
        self.kept = np.add.outer(np.arange(MODES + 1) ** 2, np.arange(MODES + 1) ** 2) <= (MODES + 0.5) ** 2

    def field(self, coefficients: Real) -> CellField:
        """As `CellField.from_bins` gives it."""
        variance = coefficients.var(axis=0, ddof=1) / len(coefficients)
        return CellField(coefficients, self.axis, self.axis, 1, 0.0, 1.0, variance)

    def run(self, target: float, seed: int, aware: bool) -> tuple[Estimate, int]:
        """The estimate where the run stops, and its histories."""
        rng, done, blocks = np.random.default_rng([11, seed]), 0, FIRST_BLOCKS
        noise = np.zeros((GROUPS, *self.modes.shape))
        sd = np.sqrt(np.array([FIRST_NOISE, LATER_NOISE])[:, None, None] / BLOCK) * self.kept
        while True:
            noise += np.sqrt(blocks - done) * sd * rng.standard_normal(noise.shape)
            done = blocks
            first, later = (self.field((self.modes + noise / done)[:, layer]) for layer in (0, 1))
            shares = _share_of_first(first), _share_of_later(later, self.scene)
            light = sum(_weighed(one, share, share) for one, share in zip((first, later), shares, strict=True))
            found = replace(first, coefficients=light, tallied_variance=first.tallied_variance if aware else None)
            one = uniformity(found, self.region)
            if one.standard_error <= target:
                return one, done * BLOCK * GROUPS
            blocks = next_blocks(done, one.standard_error, target)


def stopped(trials: int, points: float) -> None:
    """The table of runs stopped at an error."""
    print(f"{trials} runs each, stopped at {points:g} points")
    heads = f"{'mean error':>11}{'spread':>8}{'stated':>8}{'95 % hold':>11}{'histories':>12}"
    print(f"{'relief':12}{'U':>7}  {'':12}{heads}")
    for name, relief in RELIEFS.items():
        for truth in TRUTHS if name == "high cross" else TRUTHS[1:]:
            runs = Stopped(relief, truth)
            for way, aware in (("as tallied", False), ("ours", True)):
                found = [runs.run(points / 100.0, seed, aware) for seed in range(trials)]
                error = 100.0 * (np.array([one.value for one, _ in found]) - truth)
                stated = 100.0 * np.mean([one.standard_error for one, _ in found])
                held = 100.0 * np.mean([one.interval()[0] <= truth <= one.interval()[1] for one, _ in found])
                print(
                    f"{name:12}{truth:7.4f}  {way:12}{error.mean():+11.3f}{error.std():8.3f}{stated:8.3f}"
                    f"{held:11.1f}{np.mean([count for _, count in found]):12,.0f}",
                    flush=True,
                )


def speed() -> None:
    """Milliseconds of each part, best and median of 15."""
    bins = np.random.default_rng(0).poisson(3.0, (GROUPS, 256, 256)).astype(float)
    light = {"flux_per_chip_w": 1e-4, "peak_nm": 445.0, "fwhm_nm": 18.0}
    for folded in (False, True):
        if folded:
            bins = bins + bins[:, :, ::-1]
            bins = bins + bins[:, ::-1, :]
        for modes in (6, 12, 28, 64):

            def field(bins: Real = bins, modes: int = modes, folded: bool = folded) -> CellField:
                return CellField.from_bins(bins, 196_608, S, HEIGHT, modes, folded=folded)

            ready = field()
            parts: dict[str, Callable[[], object]] = {
                "field of the bins": field,
                "Eq. 8": lambda ready=ready: uniformity(ready, REGION),
                "all metrics": lambda ready=ready: metrics_of(ready, REGION, **light),
            }
            for name, part in parts.items():
                print(f"{'folded' if folded else '':8}{modes:3d} modes  {name:18}{milliseconds(part)}")


def milliseconds(part: Callable[[], object]) -> str:
    """Best and median of 15 calls."""
    spent = []
    for _ in range(15):
        start = time.perf_counter()
        part()
        spent.append(1e3 * (time.perf_counter() - start))
    return f"{min(spent):7.2f} ms best {np.median(spent):7.2f} ms median"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=600)
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--stopped", action="store_true")
    parser.add_argument("--target-error", type=float, default=0.3, help="of the stopped runs, in points")
    options = parser.parse_args()
    if options.speed:
        speed()
    elif options.stopped:
        stopped(options.trials, options.target_error)
    else:
        coverage(options.trials)
