"""Largest deviations of our kernels: from tmm 0.2.0 and each other on random stacks, from golden data and identities.

    python benchmarks/film_agreement.py [number of stacks, default 200]

Stacks of 1 to 40 layers, half of them with absorbing layers and metals, from both sides, s and p, at 0, 89.9 and a
random angle between. Then the averages of tests/golden/thin_film.json (two other programs agree on them), and two
identities of the paper's mirrors.
"""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path

import numpy as np
import tmm

from containers.stack import StackRows
from containers.thin_film import lossless
from containers.thin_film.refinement import sampled
from containers.thin_film.transfer_matrix import solve
from luxloop.film import Spectrum

KEYS = ("r", "t", "R", "T")
GAN, ALN = 2.4869, 2.1793
GOLDEN = Path(__file__).parents[1] / "tests" / "golden" / "thin_film.json"


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
    smooth, coherent, films = np.zeros(d.size + 1), np.ones(d.size, bool), np.zeros(d.size, bool)
    rows = StackRows(np.array([wavelength]), n[None], d, smooth, coherent, films)
    if not lossless.applies(rows):
        return 0.0
    return float(np.abs(lossless.stack_reflectance(rows, u) - solve(n, d, 0.0, [wavelength], u).R_inside).max())


def mirrors(pairs: list[float], order: str, wavelength: np.ndarray, u: np.ndarray) -> np.ndarray:
    """R of the paper's mirrors, (stack, wavelength, polarisation, u)."""
    layers = {"gan_layer_nm": 45.2, "aln_layer_nm": 51.6, "layer_order": order}
    return lossless.dbr_reflectance(pairs, wavelength, u, n_gan=GAN, n_aln=ALN, **layers)


def golden_error() -> float:
    """Largest deviation from the golden line averages."""
    wavelength, weight = sampled(Spectrum(), 61)
    worst = 0.0
    for case, golden in json.loads(GOLDEN.read_text())["tables"].items():
        side, order, pairs = case.split("|")
        u = np.sin(np.radians(golden["deg"])) * (GAN if side == "GaN" else 1.0)
        R = mirrors([float(pairs)], "gan_first" if order == "GaN-first" else "aln_first", wavelength, u)[0]
        worst = max(worst, float(np.abs(weight @ R.mean(axis=1) - golden["R"]).max()))
    return worst


def half_pair_error() -> float:
    """R(gan_first, p) against R(aln_first, p - 0.5), p 0.5 to 20, 0 to 89.9 deg."""
    pairs = [0.5 + 0.5 * number for number in range(40)]
    wavelength, u = np.linspace(400.0, 490.0, 7), GAN * np.sin(np.radians(np.linspace(0.0, 89.9, 91)))
    other = mirrors([p - 0.5 for p in pairs], "aln_first", wavelength, u)
    return float(np.abs(mirrors(pairs, "gan_first", wavelength, u) - other).max())


def quarter_wave_error() -> float:
    """R at normal incidence of 1 to 20 exact quarter-wave pairs against ((n0 - Y) / (n0 + Y))^2."""
    worst = 0.0
    for count in range(1, 21):
        layers = np.tile([445.0 / (4.0 * ALN), 445.0 / (4.0 * GAN)], count)
        n = [GAN, *np.tile([ALN, GAN], count), 1.0]
        y = (ALN / GAN) ** (
            2 * count
        )  # each pair multiplies the admittance seen from the inside by (n_AlN / n_GaN)^2
        exact = ((GAN - y) / (GAN + y)) ** 2
        worst = max(worst, abs(float(solve(n, layers, 0.0, [445.0], [0.0]).R_inside[0, 0, 0]) - exact))
    return worst


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
    print("golden line averages (mean of s and p)".ljust(52), f"{golden_error():.1e}")
    print("R(gan_first, p) against R(aln_first, p - 0.5)".ljust(52), f"{half_pair_error():.1e}")
    print("exact quarter waves, 1 to 20 pairs, closed form".ljust(52), f"{quarter_wave_error():.1e}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
