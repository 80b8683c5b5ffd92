"""Images of replicates, samples of equal numbers: one run of Monte Carlo, told as one and as several.

    python -m benchmarks.replicates [--trials 60]

Made-up images of 42 x 42 pixels whose prediction errs by smooth functions with random factors, which all copies
share; a gain and an offset of each image and one parameter of all are fitted. How often a right model is told to
differ at 1 % and at 5 %, and how far the common parameter scatters in its errors.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from validation.contrasts.families import layout_of
from validation.contrasts.null import Variances, null
from validation.contrasts.places import Picture
from validation.contrasts.structure import judged
from validation.fit.least_squares import Basis
from validation.fit.model_noise import noise_blocks
from validation.fit.whitening import Whitening

PIXELS, FUNCTIONS, DRAWS = 42, 100, 4000


def alarms(runs: Sequence[str], share: float, trials: int) -> tuple[float, float, float]:
    """Share of right models told to differ at 1 % and 5 %, and the rms pull, with these names of the images' runs."""
    random, size = np.random.default_rng(4), (PIXELS, PIXELS)
    y, x = np.indices(size) - (PIXELS - 1) / 2.0
    light = np.exp(-(x * x + y * y) / (2.0 * 9.0**2))
    functions = np.array([gaussian_filter(random.standard_normal(size), 2.5, mode="wrap") for _ in range(FUNCTIONS)])
    functions *= np.sqrt(light + 0.02)
    functions *= share / np.sqrt(np.mean(np.sum(functions**2, axis=0)))
    used = tuple(np.ones(size, bool) for _ in runs)
    camera = Whitening(used, tuple(np.ones(size) for _ in runs), ())
    white = replace(camera, noise=noise_blocks(camera, runs, [functions] * len(runs)))
    nothing = np.zeros(size)
    own = [
        white.rows([one if k == number else nothing for k in range(len(runs))])
        for number in range(len(runs))
        for one in (50.0 * light, np.ones(size))
    ]
    columns = np.array([*own, white.rows([0.25 * light * (x * x + y * y)] * len(runs))])
    basis = Basis(np.linalg.qr(columns.T)[0], np.zeros((0, len(columns))))
    covariance = np.linalg.inv(columns @ columns.T)
    pictures = [Picture(f"{k}", one, 24.0, 24.0 * x, 24.0 * y, np.zeros((1, 2)), 0) for k, one in enumerate(used)]
    layout = layout_of(pictures)
    variances = Variances.of(layout, basis)
    by_noise = null(layout, basis, variances.weight, DRAWS, 1)
    chances, pulls = [], []
    for _ in range(trials):
        common = np.tensordot(random.standard_normal(FUNCTIONS), functions, 1)
        residual = white.rows([random.standard_normal(size) + common for _ in runs])
        pulls.append((covariance @ (columns @ residual))[-1] / np.sqrt(covariance[-1, -1]))
        chances.append(judged(basis.residual(residual), layout, basis, variances, by_noise).p)
    told = np.array(chances)
    return float(np.mean(told < 0.01)), float(np.mean(told < 0.05)), float(np.std(pulls))


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=60)
    trials = parser.parse_args().trials
    print(f"{'copies':>6} {'noise':>6} {'told as':>10} {'at 1 %':>8} {'at 5 %':>8} {'pulls':>6}")
    for copies in (2, 4):
        for share in (0.1, 0.3, 1.0):
            for word, runs in (("one run", ["a"] * copies), ("several", [f"s{k}" for k in range(copies)])):
                few, more, pull = alarms(runs, share, trials)
                print(f"{copies:>6} {share:>6g} {word:>10} {100 * few:>6.0f} % {100 * more:>6.0f} % {pull:>6.2f}")


if __name__ == "__main__":
    main()
