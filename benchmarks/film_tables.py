"""Film tables: what they cost, the error they state, and the error found at random u by direct computation.

    python benchmarks/film_tables.py [--stacks 300]

Error found: the largest in T and R from both sides, s and p, averaged over the table's own line, at u drawn at random
(uniform, and denser at the ends of the segments); "one wavelength" the same without the average. After the named
stacks a summary of random ones: DBRs of 1 to 20 pairs and single films of 0.2 to 5 um (n 1.45, 2.1793, 2.6) on GaN,
absorbing (k 1e-4 to 0.1), rough (0 to 5 nm rms) or both; and lossless ones: DBRs, films up to 50 um, DBR cavities.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.processes import table
from containers.stack import AIR, dbr_of, resolve
from containers.thin_film import warm_up
from containers.thin_film.packing import pack
from containers.thin_film.table import FilmTable, film_table
from containers.thin_film.transfer_matrix import solve
from luxloop.film import Grid
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack

Real = NDArray[np.float64]
PAPER = Environment()
GAN, ALN = 2.4869, 2.1793


def dbr(pairs: float, k: float = 0.0, roughness_nm: float = 0.0) -> Stack:
    """The paper's DBR with AlN that absorbs and faces that are rough."""
    stack = dbr_of(PAPER, pairs, roughness_nm=roughness_nm)
    layers = [
        layer.model_copy(update={"medium": Medium(n=ALN, k=k)}) if layer.medium.n == ALN else layer
        for layer in stack.layers
    ]
    return stack.model_copy(update={"layers": tuple(layers)})


def film(thickness_nm: float, k: float = 0.0, roughness_nm: float = 0.0, n: float = ALN) -> Stack:
    """One layer on GaN."""
    layer = Layer(medium=Medium(n=n, k=k), thickness_nm=thickness_nm, roughness_nm=roughness_nm)
    return Stack(inside=Medium(n=GAN), inside_roughness_nm=roughness_nm, layers=(layer,), outside=AIR)


def cavity(pairs: float, thickness_nm: float) -> Stack:
    """A clear layer between two DBRs."""
    mirror = dbr(pairs).layers
    return Stack(inside=Medium(n=GAN), layers=(*mirror, *film(thickness_nm).layers, *mirror[::-1]), outside=AIR)


NAMED = {
    "4.5 pairs": dbr(4.5),
    "5.5 pairs": dbr(5.5),
    "9.5 pairs": dbr(9.5),
    "9.5 pairs, k 1e-3": dbr(9.5, k=1e-3),
    "9.5 pairs, rough 1 nm": dbr(9.5, roughness_nm=1.0),
    "9.5 pairs, rough 5 nm": dbr(9.5, roughness_nm=5.0),
    "5.5 pairs, rough 5 nm": dbr(5.5, roughness_nm=5.0),
    "5.5 pairs, dispersive, rough 2 nm": dbr_of(PAPER.model_copy(update={"indices": "dispersive"}), 5.5, 2.0),
    "1 um, k 1e-3": film(1000.0, k=1e-3),
    "3 um, k 1e-4": film(3000.0, k=1e-4),
    "30 um": film(30_000.0),
    "100 pairs": dbr(100.0),
}


def lossy_stacks(count: int) -> list[Stack]:
    """Random stacks that absorb, scatter, or both; always the same."""
    rng = np.random.default_rng(11)
    stacks = []
    for number in range(count):
        k = 0.0 if number % 4 == 1 else float(10 ** rng.uniform(-4.0, -1.0))
        roughness_nm = float(rng.uniform(0.0, 5.0)) if number % 2 else 0.0
        if rng.random() < 0.5:
            stacks.append(dbr(int(rng.integers(2, 41)) / 2, k, roughness_nm))
        else:
            thickness_nm = float(10 ** rng.uniform(np.log10(200.0), np.log10(5000.0)))
            stacks.append(film(thickness_nm, k, roughness_nm, float(rng.choice([1.45, ALN, 2.6]))))
    return stacks


def clear_stacks(count: int) -> list[Stack]:
    """Random smooth, lossless stacks; always the same."""
    rng = np.random.default_rng(12)
    stacks = []
    for number in range(count):
        thickness_nm = float(10 ** rng.uniform(np.log10(200.0), np.log10(50_000.0)))
        pairs = int(rng.integers(2, 41)) / 2
        stacks.append(
            (dbr(pairs), film(thickness_nm), cavity(pairs / 2 // 0.5 * 0.5, thickness_nm / 5.0))[number % 3]
        )
    return stacks


def errors_found(made: FilmTable, u: Real) -> tuple[float, float]:
    """Largest error of the line average and of one wavelength at u (U,)."""
    rows = resolve(made.stack, made.wavelength_nm)
    index = rows.index.copy()
    index[:, [0, -1]] = index[:, [0, -1]].real
    exact = solve(index, rows.thickness_nm, rows.roughness_nm, rows.wavelength_nm, u)
    average, single = 0.0, 0.0
    for side, R, T in (
        ("inside", exact.R_inside, exact.T_inside),
        ("outside", exact.R_outside, exact.T_outside),
    ):
        powers = made.powers("inside" if side == "inside" else "outside")
        shown = u <= made.u[powers.R.shape[-1] - 1]
        for read, right in ((powers.R, R), (powers.T, np.minimum(T, exact.T_outside))):
            wrong = made.at(read, u[shown]) - right[..., shown]
            average = max(average, float(np.abs(np.tensordot(made.weight, wrong, axes=1)).max()))
            single = max(single, float(np.abs(wrong).max()))
    return average, single


def random_u(made: FilmTable, count: int, rng: np.random.Generator) -> Real:
    """A quarter where light leaves the film, the rest beyond; half of them denser at the ends of the segments."""
    low, high = made.breaks[0], made.breaks[-1]
    if not made.losses:
        return np.asarray(rng.uniform(0.0, low, count))
    places = rng.uniform(0.0, 1.0, count // 4)
    cosine = np.array(made.breaks[:-1])[:, None] + np.diff(made.breaks)[:, None] * (1 - np.cos(np.pi * places)) / 2
    rest = cosine.ravel()[rng.integers(0, cosine.size, count // 2)]
    return np.concatenate([rng.uniform(0.0, low, count // 4), rng.uniform(low, high, count // 4), rest])


def row_of(name: str, stack: Stack, grid: Grid, points: int) -> list[object]:
    """One row of the table of named stacks."""
    begin = time.perf_counter()
    made = film_table(stack, grid=grid)
    took_ms = 1e3 * (time.perf_counter() - begin)
    average, single = errors_found(made, random_u(made, points, np.random.default_rng(3)))
    size = f"{made.wavelength_nm.size} x {made.u.size}"
    kb = f"{len(pack(*made.to_parts())) / 1e3:.0f}"
    stated = f"{made.error_average_ratio:.1e}", f"{made.error_single_ratio:.1e}"
    return [name, size, f"{took_ms:.1f}", kb, stated[0], f"{average:.1e}", stated[1], f"{single:.1e}"]


def summary(name: str, stacks: list[Stack], points: int) -> list[object]:
    """One row for many stacks."""
    rng, took, found, ratios, nodes = np.random.default_rng(4), 0.0, [], [], []
    for stack in stacks:
        begin = time.perf_counter()
        made = film_table(stack)
        took += time.perf_counter() - begin
        error = errors_found(made, random_u(made, points, rng))[0]
        found.append(error)
        ratios.append(error / made.error_average_ratio if error > made.grid.tolerance_ratio else 0.0)
        nodes.append(made.u.size)
        if ratios[-1] > 1.0:
            print(f"  {error:.1e} found, {made.error_average_ratio:.1e} stated: {str(stack)[:90]}")
    above = [sum(e > limit for e in found) for limit in (1e-3, 2e-3)]
    mean_ms = f"{1e3 * took / len(stacks):.0f}"
    return [name, len(stacks), f"{np.mean(nodes):.0f}", mean_ms, *above, f"{max(found):.1e}", f"{max(ratios):.2f}"]


def main(count: int) -> None:
    """Print both tables."""
    warm_up()
    heads = ["stack", "size", "ms", "kB", "stated", "found", "one wavelength: stated", "found"]
    table("default grid, tolerance 1e-3", [row_of(n, s, Grid(), 2000) for n, s in NAMED.items()], heads)
    rows = [summary("absorbing, rough", lossy_stacks(count), 320), summary("clear", clear_stacks(count), 320)]
    heads = ["random stacks", "how many", "nodes", "ms", "> 1e-3", "> 2e-3", "worst", "found / stated at most"]
    table("random stacks, default grid, tolerance 1e-3", rows, heads)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--stacks", type=int, default=300)
    main(parser.parse_args().stacks)
