"""Time of all eleven film tables of a campaign, ours beside others, on one thread, with the largest deviation in R.

    python benchmarks/film_speed.py

11 stacks (4.5 to 9.5 pairs), 91 angles in GaN (0 to 89.9 deg), 61 wavelengths, s and p. Best of several warm runs.
`tmm_fast` needs torch and is skipped with its reason where it is not installed.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from containers.stack import dbr_layers
from containers.thin_film.lossless import dbr_reflectance
from containers.thin_film.transfer_matrix import solve

GAN, ALN, GAN_NM, ALN_NM = 2.4869, 2.1793, 45.2, 51.6
PAIRS = np.arange(4.5, 10.0, 0.5)
THETA = np.radians(np.linspace(0.0, 89.9, 91))
WAVELENGTH = np.linspace(400.0, 490.0, 61)
U = GAN * np.sin(THETA)


def stack_of(pairs: float) -> tuple[list[float], list[float]]:
    """Indices and thicknesses from the GaN bulk to air."""
    kinds = dbr_layers(pairs)
    return [GAN, *((GAN, ALN)[kind] for kind in kinds), 1.0], [(GAN_NM, ALN_NM)[kind] for kind in kinds]


def ours_lossless() -> Any:
    return dbr_reflectance(PAIRS, WAVELENGTH, U, n_gan=GAN, n_aln=ALN, gan_layer_nm=GAN_NM, aln_layer_nm=ALN_NM)


def ours_general() -> Any:
    return np.array([solve(n, d, 0.0, WAVELENGTH, U).R_inside for n, d in map(stack_of, PAIRS)])


def plain_numpy() -> Any:
    """Characteristic matrices of Abeles, vectorised over wavelength and angle; one stack and polarisation a call."""
    return np.array([[abeles(*stack_of(pairs), p) for p in range(2)] for pairs in PAIRS]).swapaxes(1, 2)


def abeles(index: list[float], thickness: list[float], p: int) -> Any:
    k0 = 2 * np.pi / WAVELENGTH[:, None]
    kz = [np.sqrt(n * n - U * U + 0j) for n in index]
    y = [k / (n * n if p else 1.0) for k, n in zip(kz, index, strict=True)]
    B, C = np.ones((WAVELENGTH.size, U.size), complex), np.broadcast_to(y[-1], (WAVELENGTH.size, U.size))
    for k, admittance, d in list(zip(kz[1:-1], y[1:-1], thickness, strict=True))[::-1]:
        cos, sin = np.cos(k * k0 * d), np.sin(k * k0 * d)
        B, C = cos * B - 1j * sin / admittance * C, cos * C - 1j * admittance * sin * B
    return np.abs((y[0] * B - C) / (y[0] * B + C)) ** 2


def with_tmm() -> Any:
    import tmm

    R = np.empty((PAIRS.size, WAVELENGTH.size, 2, U.size))
    for s, (index, thickness) in enumerate(map(stack_of, PAIRS)):
        depths = [np.inf, *thickness, np.inf]
        for p, name in enumerate("sp"):
            for w, wavelength in enumerate(WAVELENGTH):
                for a, theta in enumerate(THETA):
                    R[s, w, p, a] = tmm.coh_tmm(name, index, depths, theta, wavelength)["R"]
    return R


def with_tmm_fast() -> Any:
    import torch
    from tmm_fast import coh_tmm

    torch.set_num_threads(1)
    R = np.empty((PAIRS.size, WAVELENGTH.size, 2, U.size))
    theta, wavelength = torch.tensor(THETA), torch.tensor(WAVELENGTH * 1e-9)
    for s, (index, thickness) in enumerate(map(stack_of, PAIRS)):
        M = torch.tensor(np.tile(np.array(index, complex)[None, :, None], (1, 1, WAVELENGTH.size)))
        T = torch.tensor(np.array([[np.inf, *(1e-9 * np.array(thickness)), np.inf]]))
        for p, name in enumerate("sp"):
            R[s, :, p] = coh_tmm(name, M, T, theta, wavelength)["R"][0].numpy().T
    return R


def measure(run: Callable[[], Any], repeats: int) -> tuple[float, float, Any]:
    """Best and median time of warm runs in ms, and the result."""
    result = run() if repeats > 1 else None
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = run()
        times.append((time.perf_counter() - start) * 1e3)
    return min(times), float(np.median(times)), result


def main() -> None:
    warnings.simplefilter("ignore")
    rows: list[tuple[str, Callable[[], Any], int]] = [
        ("plain numpy Abeles", plain_numpy, 5),
        ("luxloop lossless, prefix sharing", ours_lossless, 500),
        ("luxloop general (R, T, r, t, budget, both sides)", ours_general, 5),
        ("tmm_fast 0.3.0, one call per stack", with_tmm_fast, 3),
        ("tmm 0.2.0, loops", with_tmm, 1),
    ]
    points = PAIRS.size * U.size * WAVELENGTH.size * 2
    print(f"{PAIRS.size} stacks x {U.size} angles x {WAVELENGTH.size} wavelengths x 2 polarisations = {points} R")
    print(f"{'program':<50}{'best ms':>10}{'median ms':>11}{'x numpy':>9}{'max |dR|':>10}")
    reference, base = None, 1.0
    for name, run, repeats in rows:
        try:
            best, median, R = measure(run, repeats)
        except ImportError as missing:
            print(f"{name:<50}  skipped: {missing}")
            continue
        if reference is None:
            reference, base = R, best
        print(f"{name:<50}{best:>10.3f}{median:>11.3f}{best / base:>9.4f}{np.abs(R - reference).max():>10.1e}")


if __name__ == "__main__":
    main()
