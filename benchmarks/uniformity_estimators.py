"""How far off the uniformity of a noisy tally is, by which method, and how often its interval holds the truth.

    python benchmarks/uniformity_estimators.py [--trials 600] [--speed]

Synthetic cells of known min / max on the line through the chips, landings drawn as multinomial counts in 32 groups,
folded 8 times or not. Errors and biases in points (0.01 of U); `mean error` in standard deviations of the value.
`--speed` times a 256 x 256 x 32 tally instead.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import argparse
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.estimate import Estimate, estimate, student_t
from containers.ray_tracing.field import CellField
from containers.ray_tracing.uniformity import cell_region, metrics_of, uniformity

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
    options = parser.parse_args()
    if options.speed:
        speed()
    else:
        coverage(options.trials)
