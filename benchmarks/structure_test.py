"""Speed of the fit and of the structure test, and its false alarms on images with nothing hidden.

    python benchmarks/structure_test.py [speed] [alarms] [pattern]

The images are spots in closed form (tests/validation/analytic.py), so no worker is waited for: only the fit and
the test are measured. "alarms" counts p-values of refitted noise, a fixed pattern of 0.3 % in all images; "pattern"
shows what becomes of them where the fit is not told of a pattern of 1.5 %.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
from scipy.stats import kstest

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.validation.analytic import ARRAY, HALO, MODEL, PATHS, REACH, SIGMA, SINGLE, Spots, blank, measured
from validation.contrasts.null import Variances, null
from validation.contrasts.structure import fit_layout, judged, structure
from validation.fit import Fit, fit

TRUTH = MODEL.with_value(SIGMA, 6.0).with_value(HALO, 0.7).with_value(REACH, 0.5)


def fitted(seed: int, side: int, count: int, prnu: float, told: bool = True, free: tuple[str, ...] = PATHS) -> Fit:
    """A fit of `count` images of noise about the truth."""
    blanks = [blank(f"i{k}", ARRAY if k % 2 else SINGLE, side, prnu) for k in range(count)]
    images = measured(TRUTH, blanks, np.random.default_rng(seed))
    return fit(TRUTH, [image if told else replace(image, prnu=0.0) for image in images], Spots(), free=free)


def speed() -> None:
    """Seconds of one core's time."""
    print("six images, s of CPU     3 parameters   nuisances only   null of 10,000 draws   again (remembered)")
    for side in (41, 128):
        seconds = []
        for free in (PATHS, ()):
            start = process_time()
            one = fitted(1, side, 6, 0.003, free=free)
            seconds.append(process_time() - start)
        for _ in range(2):
            start = process_time()
            structure(one)
            seconds.append(process_time() - start)
        print(f"{side:4d} x {side:<4d}{seconds[0]:25.2f}{seconds[1]:17.2f}{seconds[2]:23.2f}{seconds[3]:21.2f}")


def alarms(fits: int = 600) -> None:
    """P-values of noise after the refit."""
    p_values, inside = [], []
    for seed in range(fits):
        one = fitted(seed, 20, 3, 0.003)
        if seed == 0:  # the null hardly depends on where the fit ends: one serves all
            layout, projection = fit_layout(one), one.basis
            variances = Variances.of(layout, projection)
            drawn = null(layout, projection, variances.weight, 20_000)
        p_values.append(judged(one.residual, layout, projection, variances, drawn).p)
        inside += [abs(one.value(path) - TRUTH.leaves()[path]) < 1.96 * one.error(path) for path in PATHS]
    p = np.array(p_values)
    print(f"{fits} fits of noise, p <= 1 %: {np.mean(p <= 0.01):.1%}, p <= 5 %: {np.mean(p <= 0.05):.1%}, ", end="")
    print(f"uniform: p {kstest(p, 'uniform').pvalue:.2f}; 95 % intervals hold the truth in {np.mean(inside):.1%}")


def pattern(fits: int = 30) -> None:
    """The same with a fixed pattern that the fit knows, or takes for independent noise."""
    for told in (True, False):
        p = np.array([structure(fitted(seed, 20, 6, 0.015, told), draws=1000).p for seed in range(fits)])
        said = "known" if told else "not known"
        print(f"pattern of 1.5 % {said}: p <= 1 % in {np.mean(p <= 0.01):.0%} of {fits} fits")


if __name__ == "__main__":
    for table in sys.argv[1:] or ("speed", "alarms", "pattern"):
        {"speed": speed, "alarms": alarms, "pattern": pattern}[table]()
