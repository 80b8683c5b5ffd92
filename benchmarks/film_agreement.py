"""Largest deviations of our kernels from tmm 0.2.0, from each other and from energy conservation, on random stacks.

    python benchmarks/film_agreement.py [number of stacks, default 200]

Stacks of 1 to 40 layers, half of them with absorbing layers and metals, from both sides, s and p, at 0, 89.9 and a
random angle between.
"""

from __future__ import annotations

import sys
import warnings

import numpy as np
import tmm

from containers.stack import StackRows
from containers.thin_film import lossless
from containers.thin_film.transfer_matrix import solve

KEYS = ("r", "t", "R", "T")


def random_stack(rng: np.random.Generator, absorbing: bool) -> tuple[np.ndarray, np.ndarray]:
    """Indices 1 to 4 and layers to 150 nm; with absorption 30 % lossy dielectrics and 10 % metals."""
    layers = int(rng.integers(1, 41))
    n = rng.uniform(1.0, 4.0, layers + 2).astype(complex)
    if absorbing:
        lossy, metal = rng.random(layers + 2) < 0.3, rng.random(layers + 2) < 0.1
        n[lossy] += 1j * rng.uniform(0.0, 1.0, lossy.sum())
        n[metal] = rng.uniform(0.05, 1.0, metal.sum()) + 1j * rng.uniform(1.0, 6.0, metal.sum())
    n[[0, -1]] = rng.uniform(1.0, 4.0, 2)
    return n, rng.uniform(0.0, 150.0, layers)


def against_tmm(n: np.ndarray, d: np.ndarray, side: str, theta: float, wavelength: float) -> np.ndarray:
    """Largest |ours - theirs| of r, t, R, T over s and p."""
    step = 1 if side == "inside" else -1
    ours = solve(n, d, 0.0, [wavelength], [n[::step][0].real * np.sin(theta)])
    t = ours.t_inside_to_outside if side == "inside" else ours.t_outside_to_inside
    found = [getattr(ours, f"r_{side}"), t, getattr(ours, f"R_{side}"), getattr(ours, f"T_{side}")]
    theirs = [tmm.coh_tmm(p, n[::step], [np.inf, *d[::step], np.inf], theta, wavelength) for p in "sp"]
    return np.array(
        [max(abs(a[0, p, 0] - theirs[p][key]) for p in range(2)) for a, key in zip(found, KEYS, strict=True)]
    )


def budget_error(n: np.ndarray, d: np.ndarray, wavelength: float, u: np.ndarray) -> float:
    r = solve(n, d, 0.0, [wavelength], u)
    inside = r.R_inside + r.T_inside + r.A_inside - 1.0
    outside = r.R_outside + r.T_outside + r.A_outside - 1.0
    return float(max(np.abs(inside).max(), np.abs(outside).max()))


def kernels_differ(n: np.ndarray, d: np.ndarray, wavelength: float, u: np.ndarray) -> float:
    rows = StackRows(np.array([wavelength]), n[None], d, np.zeros(d.size + 1), np.ones(d.size, bool))
    if not lossless.applies(rows):
        return 0.0
    return float(np.abs(lossless.stack_reflectance(rows, u) - solve(n, d, 0.0, [wavelength], u).R_inside).max())


def main(stacks: int) -> None:
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(20)
    worst = {False: np.zeros(6), True: np.zeros(6)}
    for trial in range(stacks):
        absorbing = bool(trial % 2)
        n, d = random_stack(rng, absorbing)
        wavelength = float(rng.uniform(380.0, 800.0))
        u = n[0].real * np.sin(np.radians(np.append(np.linspace(0.0, 89.0, 40), 89.9)))
        for side in ("inside", "outside"):
            for degrees in (0.0, float(rng.uniform(0.0, 89.9)), 89.9):
                error = against_tmm(n, d, side, np.radians(degrees), wavelength)
                worst[absorbing][:4] = np.maximum(worst[absorbing][:4], error)
        rest = [budget_error(n, d, wavelength, u), 0.0 if absorbing else kernels_differ(n, d, wavelength, u)]
        worst[absorbing][4:] = np.maximum(worst[absorbing][4:], rest)
    print(f"{stacks} random stacks; largest deviations")
    print(f"{'':<12}{'r':>10}{'t':>10}{'R':>10}{'T':>10}{'budget':>10}{'lossless':>10}")
    for absorbing, error in worst.items():
        print(f"{'absorbing' if absorbing else 'lossless':<12}" + "".join(f"{value:>10.1e}" for value in error))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
