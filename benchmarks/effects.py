"""What each effect of the catalogue does to an image, whether the twin knows it, and what it costs.

    python benchmarks/effects.py [NAME ...] [--histories 1000000] [--seeds 4] [--share 0.33]
    python benchmarks/effects.py current_crowding electrode_shadow --design 40,100,300,20,2.5 --array 1x1 --pixel-um 5

Example module: 5 x 5 chips, D 180, W 40, S 500, T 20 um, 2.5 pairs, the paper's model, 60 x 60 pixels of 40 um,
full scale at 1.05 of the brightest pixel; the second line's receiver is so near that a chip's face shows. Each
parameter with an off value is set to a share of its range, shape parameters to the middle of their grids, lists per
chip to numbers drawn with that root mean square. Monte Carlo runs
at this value and at a thousandth of the step share their random numbers, seed by seed (off itself may be traced in
another way: eightfold symmetry, walks through smooth chips); the seeds are independent, so that products of the
differences of two of them are free of noise. The twin has other exits at each seed, those of the base where it can:

    rms         of the signature over the mean of the image, by Monte Carlo, and of the noise left in it
    twin/MC     <twin, MC> / <MC, MC>, and its standard error
    twin's rest |twin - MC| / |MC|
    MC, twin    CPU time of an image over that of the base model
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from itertools import permutations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.processes import table
from containers.catalogue import Catalogue
from containers.effect import CurveEffect, StackEffect
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.worker import RayComputation
from containers.thin_film.worker import FilmComputation
from luxloop.camera import Camera
from luxloop.computation import Progress
from luxloop.design import Design
from luxloop.effect import AppliedEffect, EffectSpec, Value
from luxloop.film import FilmTableRequest, Spectrum
from luxloop.model_file import find_model
from luxloop.ray import AnchorRequest, ChipArray, Film, PredictionRequest, ShotRequest

Real = NDArray[np.float64]
BRIGHTEST, NEAR = 1.05, 1e-3


class Trial(NamedTuple):
    """An effect at some value and next to off, and which of its parameters was moved from off."""

    name: str
    parameter: str
    effect: AppliedEffect
    near: tuple[AppliedEffect, ...]


class Seen(NamedTuple):
    """An image by Monte Carlo and by the twin, each (seed, row, column), and the CPU time of one."""

    monte_carlo: Real
    twin: Real
    monte_carlo_s: float
    twin_s: float


class Bench:
    """Both workers in this process."""

    def __init__(
        self, design: Design, array: ChipArray, pixel_um: float, receiver: float, histories: int, seeds: int
    ) -> None:
        self.design, self.array = design, array
        paper = find_model("paper").environment
        sent_back = paper.receiver.model_copy(update={"reflectance": receiver})
        self.environment = paper.model_copy(update={"receiver": sent_back})
        self.film = FilmComputation.in_folder(Path(tempfile.mkdtemp()))
        self.ray = RayComputation(lambda sha, _: self.film.blob(sha) or b"", ExitSource(memory_bytes=64 << 20))
        self.histories, self.seeds = histories, seeds
        self.camera = Camera(rows=60, columns=60, pixel_um=pixel_um)
        brightest = float(self.seen((), twin_only=True).twin.max())
        self.camera = self.camera.model_copy(update={"gain_dn": 4031.0 / BRIGHTEST / brightest})
        self.seen((), twin_only=True)
        self.base = self.seen(())

    def seen(self, effects: tuple[AppliedEffect, ...], twin_only: bool = False, twin: bool = True) -> Seen:
        """The image under effects; `twin`: whether the twin knows them."""
        shot, seeds = self._shot(effects), [str(seed) for seed in range(1, 1 + self.seeds)]
        if twin:
            at = AnchorRequest(shots=(self._shot(()),), histories=0)  # chips near the base's have its exits
            by_twin = [self._ask(shot, at, seed) for seed in seeds]
            warm_s = min(self._ask(shot, at, seeds[-1])[1] for _ in range(2))
        traced = [] if twin_only else [self._ask(shot, self._run(seed)) for seed in seeds]
        return Seen(
            np.array([image for image, _ in traced]),
            np.array([image for image, _ in by_twin] if twin else []),
            min((cpu_s for _, cpu_s in traced), default=np.nan),
            warm_s if twin else np.nan,
        )

    def _run(self, seed: str) -> AnchorRequest:
        return AnchorRequest(histories=self.histories, seed=seed)

    def _shot(self, effects: tuple[AppliedEffect, ...]) -> ShotRequest:
        spectrum = Spectrum(peak_nm=self.environment.peak_nm, fwhm_nm=self.environment.fwhm_nm)
        asked = FilmTableRequest(
            environment=self.environment, dbr_pairs=self.design.dbr_pairs, spectrum=spectrum, effects=effects
        )
        made, _ = self.film.compute(asked.model_dump(), Progress())
        film = Film(sha256=made["table_sha256"], bytes=made["table_bytes"])
        return ShotRequest(
            environment=self.environment,
            design=self.design,
            film=film,
            effects=effects,
            array=self.array,
            camera=self.camera,
        )

    def _ask(self, shot: ShotRequest, anchor: AnchorRequest, exit_seed: str = "1") -> tuple[Real, float]:
        request = PredictionRequest(shots=(shot,), anchor=anchor, exit_seed=exit_seed)
        begin_s = time.process_time()
        _, arrays = self.ray.compute(request.model_dump(), Progress())
        return np.asarray(arrays["images_per_mm2"])[0], time.process_time() - begin_s


def trials(spec: EffectSpec, share: float, chips: int) -> Iterator[Trial]:
    """An effect with each of its parameters in turn moved from off by a share of its range; once if it has no off."""
    rng = np.random.default_rng(7)
    at_off: dict[str, Value] = {}
    for one in spec.parameters:
        grid: tuple[float | str, ...] = one.shape_grid or one.choices
        value = grid[len(grid) // 2] if one.off is None else one.off
        at_off[one.name] = (0.0,) * chips if one.per_chip else value
    movable = [one for one in spec.parameters if one.off is not None]
    if not movable:
        yield Trial(spec.name, ", ".join(at_off), AppliedEffect(name=spec.name, parameters=at_off), ())
    for one in movable:
        if one.lower is None or one.upper is None or not isinstance(one.off, float):
            other = next(word for word in reversed(one.choices) if word != one.off)
            yield Trial(spec.name, one.name, AppliedEffect(name=spec.name, parameters=at_off | {one.name: other}), ())
            continue
        step = share * ((one.upper if one.upper > one.off else one.lower) - one.off)
        drawn = rng.standard_normal(chips)
        both = []
        for part in (1.0, NEAR):
            values = np.clip(one.off + part * step * drawn, one.lower, one.upper)
            moved: Value = tuple(map(float, values)) if one.per_chip else one.off + part * step
            both.append(AppliedEffect(name=spec.name, parameters=at_off | {one.name: moved}))
        yield Trial(spec.name, one.name, both[0], (both[1],))


def row(bench: Bench, trial: Trial, known: bool) -> list[str]:
    """A line of the table."""
    after, off = bench.seen((trial.effect,), twin=known), bench.base
    base = bench.seen(trial.near, twin=known) if trial.near else off
    mc, mean = after.monte_carlo - base.monte_carlo, float(base.monte_carlo.mean())
    pairs = list(permutations(range(len(mc)), 2))
    square = float(np.mean([np.mean(mc[i] * mc[j]) for i, j in pairs]))
    noise = float(np.sqrt(np.mean((mc - mc.mean(axis=0)) ** 2) / (len(mc) - 1)))
    value = trial.effect.parameters.get(trial.parameter, "at all")
    said = "drawn" if isinstance(value, tuple) else f"{value:.3g}" if isinstance(value, float) else value
    size = f"{100.0 * np.sqrt(max(square, 0.0)) / mean:.3f} +- {100.0 * noise / mean:.3f} %"
    cells = [trial.name, f"{trial.parameter} {said}", size]
    cost = f"{after.monte_carlo_s / off.monte_carlo_s:.2f}"
    if not known:
        return [*cells, "-", "-", cost, "-"]
    twin = after.twin - base.twin
    along = np.mean(twin * mc, axis=(1, 2)) / square
    rest = np.mean([np.mean((mc[i] - twin[i]) * (mc[j] - twin[j])) for i, j in pairs]) / square
    error = along.std(ddof=1) / len(mc) ** 0.5
    return [
        *cells, f"{along.mean():.3f} +- {error:.3f}", f"{100.0 * np.sqrt(max(rest, 0.0)):.1f} %", cost,
        f"{after.twin_s / off.twin_s:.2f}",
    ]  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--histories", type=int, default=1_000_000)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--share", type=float, default=0.33)
    parser.add_argument("--design", default="180,40,500,20,2.5", help="D,W,S,T in um, pairs")
    parser.add_argument("--array", default="5x5", help="rows x columns")
    parser.add_argument("--pixel-um", type=float, default=40.0)
    parser.add_argument("--receiver", type=float, default=0.35, help="its reflectance; 0: direct light alone")
    asked = parser.parse_args()
    design = Design(**dict(zip(Design.FIELDS, map(float, asked.design.split(",")), strict=True)))
    array = ChipArray(**dict(zip(("rows", "columns"), asked.array.split("x"), strict=True)))
    catalogue, bench = Catalogue(), Bench(design, array, asked.pixel_um, asked.receiver, asked.histories, asked.seeds)
    rows = []
    for spec in catalogue.specs:
        for trial in trials(spec, asked.share, array.rows * array.columns):
            (effect,) = catalogue.effects((trial.effect,), "ray").all
            of_films = isinstance(effect, CurveEffect) or (isinstance(effect, StackEffect) and "dbr" not in effect.of)
            if of_films or (asked.names and spec.name not in asked.names):
                continue
            rows.append(row(bench, trial, spec.twin))
            print("  ".join(rows[-1]), flush=True)
    title = f"{asked.seeds} x {asked.histories} histories, {asked.share:g} of each range"
    table(title, rows, ["effect", "parameter", "rms", "twin/MC", "twin's rest", "MC", "twin"])


if __name__ == "__main__":
    main()
