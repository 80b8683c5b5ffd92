"""What the catalogue's effects on a DBR do to a module's image, what they cost, and where they are approximate.

    python benchmarks/dbr_effects.py [--histories N] [--seeds N] [--derivatives]

Module: 5 x 5 chips of the paper's model, D 180, W 40, S 500, T 20 um, 5.5 pairs, 60 x 60 pixels of 40 um. The twin's
derivative is held against differences of Monte Carlo with common random numbers: the slope of Monte Carlo over the
twin's mean of several seeds of exits (131,072 histories each). Both have noise that is common to all pixels, so the
slope's errors are told by whole runs: one by the groups of Monte Carlo, one by the seeds of exits.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from containers.acting import NONE, Effects
from containers.catalogue import Catalogue
from containers.ray_tracing import several_tops
from containers.ray_tracing.build import array_of, cell_of, scene_of
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.monte_carlo import MonteCarlo, blocks_of
from containers.ray_tracing.outcome import solved
from containers.ray_tracing.several_tops import solver_of_all, with_tops
from containers.ray_tracing.tally import GROUPS
from containers.ray_tracing.twin.prediction import Shot, _replicas, twin_images
from containers.ray_tracing.twin.supply import Supply
from containers.scene import Face, Scene
from containers.stack import dbr_of
from containers.thin_film.scatter import AbcSpectrum
from containers.thin_film.surface import film_bsdf
from containers.thin_film.table import film_table
from luxloop.camera import Camera
from luxloop.design import Design
from luxloop.effect import AppliedEffect
from luxloop.film import Spectrum
from luxloop.model_file import find_model

Real = NDArray[np.float64]
ENVIRONMENT = find_model("paper").environment
DESIGN = Design(distance_um=180.0, width_um=40.0, spacing_um=500.0, thickness_um=20.0, dbr_pairs=5.5)
LINE = Spectrum(peak_nm=ENVIRONMENT.peak_nm, fwhm_nm=ENVIRONMENT.fwhm_nm)
CAMERA = Camera(rows=60, columns=60, pixel_um=40.0)
CASES: tuple[tuple[str, str, float, float], ...] = (
    ("dbr_thickness_error", "error_ratio", 0.0, 0.005),
    ("dbr_thickness_gradient", "gradient_per_mm", 0.0, 0.005),
    ("dbr_roughness", "roughness_nm", 4.0, 1.0),
    ("dbr_index_error", "index_change", 0.0, 0.01),
    ("dbr_absorption", "extinction", 0.002, 0.001),
)
"""Effect, parameter, where it is differentiated, half the step."""


def effects_of(name: str, **parameters: Any) -> Effects:
    """One effect, ready to act."""
    return Catalogue().effects([AppliedEffect(name=name, parameters=parameters)], "benchmark")


def module(effects: Effects = NONE) -> Scene:
    """The array with its film under effects."""
    film = film_table(effects.dbr(dbr_of(ENVIRONMENT, DESIGN.dbr_pairs)), LINE)
    scene = scene_of(ENVIRONMENT, DESIGN, film, array_of(ENVIRONMENT, DESIGN, 5, 5))
    return with_tops(scene, ENVIRONMENT, film, effects)


def twin(scene: Scene, supply: Supply, base: Scene) -> Real:
    """The twin's image."""
    return np.asarray(twin_images([Shot(scene, CAMERA, base=base)], supply, blocks=4, shadow_rays=4096)[0])


def monte_carlo(scene: Scene, histories: int) -> Real:
    """Images (group, row, column) of full histories; whole powers in folded bins need no symmetry here."""
    solver = solver_of_all(scene, lambda one, seed: MonteCarlo(one, seed), 7)
    tally = solver.run_to(blocks_of(histories))
    return _replicas([solved(scene, tally).field.grid], [Shot(scene, CAMERA)], lambda: None)[:, 0]


def supply_of(seed: int) -> Supply:
    """Exits of 131,072 histories of this seed."""
    source = ExitSource()
    return Supply(lambda scene: source.exits(scene, seed, 4, notes=True))


class Slope(NamedTuple):
    """How far one derivative is another, the standard errors of that by the noise of each, and what else differs."""

    value: float
    traced_error: float
    exits_error: float
    chi2: float
    """Of a block, for a slope of 1; 1 where noise is all."""


def slope_of(traced: Real, predicted: Real) -> Slope:
    """Of Monte Carlo's difference (group, block) over the twin's (seed, block), blocks weighted by their noise."""
    mean, twin_mean = traced.mean(axis=0), predicted.mean(axis=0)
    variance = traced.var(axis=0, ddof=1) / len(traced)
    weight = twin_mean / variance
    groups, seeds = (one @ weight / (twin_mean @ weight) for one in (traced, predicted))
    errors = [float(one.std(ddof=1) / np.sqrt(len(one))) for one in (groups, seeds)]
    variance = variance + predicted.var(axis=0, ddof=1) / len(predicted)
    chi2 = float(np.mean((mean - twin_mean) ** 2 / variance))
    return Slope(float(groups.mean()), errors[0], errors[1], chi2)


def derivatives(histories: int, seeds: int) -> None:
    """Sizes, costs, and the twin's derivatives beside Monte Carlo's."""
    supplies = [supply_of(seed) for seed in range(1, 1 + seeds)]
    base = module()
    flat = np.mean([twin(base, supply, base) for supply in supplies], axis=0)
    start_s = perf_counter()
    for _ in range(5):
        twin(base, supplies[0], base)
    base_s = (perf_counter() - start_s) / 5
    print(f"twin's image of the base model: {1e3 * base_s:.0f} ms")
    errors = "+- Monte Carlo's, +- exits'"
    print(f"{'effect':24} {'at':>7} {'change %':>9} {'cost':>6} {'chi2/block':>11}   slope {errors}")
    for name, parameter, at, step in CASES:
        scenes = [module(effects_of(name, **{parameter: at + sign * step})) for sign in (1.0, -1.0)]
        images = np.array([[twin(scene, supply, base) for scene in scenes] for supply in supplies])
        start_s = perf_counter()
        twin(scenes[0], supplies[0], base)
        cost = (perf_counter() - start_s) / base_s
        predicted = images[:, 0] - images[:, 1]
        difference = monte_carlo(scenes[0], histories) - monte_carlo(scenes[1], histories)
        slope = slope_of(_blocks(difference), _blocks(predicted))
        rms = 100.0 * float(np.sqrt(np.mean(predicted.mean(axis=0) ** 2)) / flat.mean())
        told = f"{slope.value:.3f} +- {slope.traced_error:.3f} +- {slope.exits_error:.3f}"
        print(f"{name:24} {at:7g} {rms:9.3f} {cost:6.2f} {slope.chi2:11.2f}   {told}", flush=True)


def _blocks(image: Real) -> Real:
    """Means of 6 x 6 pixels, (..., block)."""
    parts = image.reshape(*image.shape[:-2], 10, 6, 10, 6).mean(axis=(-3, -1))
    return np.asarray(parts.reshape(*image.shape[:-2], 100))


def films_of_a_gradient() -> None:
    """By how much fewer films than columns err."""
    supply, base = supply_of(1), module()
    flat = twin(base, supply, base)
    print("\ngradient: error of the image as a share of the effect, 5 films being exact for 5 columns")
    for per_mm in (0.01, 0.05):
        found = {}
        for several_tops.MOST_FILMS in (2, 3, 5):
            effects = effects_of("dbr_thickness_gradient", gradient_per_mm=per_mm)
            found[several_tops.MOST_FILMS] = twin(module(effects), supply, base)
        size = float(np.linalg.norm(found[5] - flat))
        shares = ", ".join(f"{k} films {float(np.linalg.norm(found[k] - found[5])) / size:.3f}" for k in (2, 3))
        print(f"  {per_mm:g} /mm, effect {100 * size / float(np.linalg.norm(flat)):.2f} % rms: {shares}")


def lobes(histories: int) -> None:
    """Scattered light in the specular directions (what scenes have), against lobes of finite width.

    The lobes let out of the chip what the budget S_T scatters onward from total reflection, however long the
    correlation; in truth only faces that are rough over some hundred nm scatter so far. They are an upper bound.
    """
    print("\nroughness of a periodic cell: uniformity %, mean, by where scattered light goes")
    cell = cell_of(ENVIRONMENT, DESIGN)
    smooth = film_table(dbr_of(ENVIRONMENT, DESIGN.dbr_pairs), LINE)
    _cell("smooth", scene_of(ENVIRONMENT, DESIGN, smooth, cell), histories)
    for roughness_nm in (2.0, 5.0):
        rough = film_table(dbr_of(ENVIRONMENT, DESIGN.dbr_pairs, roughness_nm), LINE)
        scene = scene_of(ENVIRONMENT, DESIGN, rough, cell)
        _cell(f"{roughness_nm:g} nm, goes on specularly", scene, histories)
        for length_nm in (3000.0, 1000.0, 300.0):
            faces = AbcSpectrum(correlation_length_nm=length_nm)
            top = Face((film_bsdf(rough, "inside", faces),), (film_bsdf(rough, "outside", faces),))
            other = replace(scene, chip=replace(scene.chip, top=top))
            _cell(f"{roughness_nm:g} nm, lobe of xi {length_nm:g} nm", other, histories)


def _cell(name: str, scene: Scene, histories: int) -> None:
    from containers.ray_tracing.uniformity import uniformity

    start_s = perf_counter()
    found = solved(scene, MonteCarlo(scene, 3).run_to(blocks_of(histories)))
    u = uniformity(found.field, found.region)
    of_groups = found.field.coefficients[:, 0, 0]
    mean, error = float(of_groups.mean()), float(of_groups.std(ddof=1) / np.sqrt(GROUPS))
    took = f"{perf_counter() - start_s:.1f} s"
    quality = f"U {100 * u.value:6.2f} +- {100 * u.standard_error:.2f}"
    print(f"  {name:32} {quality}, mean {mean:.4f} +- {error:.4f}, {took}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histories", type=int, default=400_000, help="of each run of Monte Carlo")
    parser.add_argument("--seeds", type=int, default=8, help="of exits, for the error of the twin's derivatives")
    parser.add_argument("--derivatives", action="store_true", help="print these alone")
    given = parser.parse_args()
    derivatives(given.histories, given.seeds)
    if not given.derivatives:
        films_of_a_gradient()
        lobes(given.histories)


if __name__ == "__main__":
    main()
