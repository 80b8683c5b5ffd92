"""What the catalogue's effects on a DBR do to a module's image, what they cost, and where they are approximate.

    python benchmarks/dbr_effects.py [--histories N]

Module: 5 x 5 chips of the paper's model, D 180, W 40, S 500, T 20 um, 5.5 pairs, 60 x 60 pixels of 40 um. The twin's
derivative is held against differences of Monte Carlo with common random numbers, in standard errors of the latter.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import perf_counter
from typing import Any

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
from containers.ray_tracing.twin.prediction import Shot, Supply, _replicas, twin_images
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


def derivatives(histories: int) -> None:
    """Sizes, costs, and the twin's derivatives beside Monte Carlo's."""
    source = ExitSource()
    supply = Supply(lambda scene: source.exits(scene, 1, 4, notes=True))
    base = module()
    flat = twin(base, supply, base)
    start_s = perf_counter()
    for _ in range(5):
        flat = twin(base, supply, base)
    base_s = (perf_counter() - start_s) / 5
    print(f"twin's image of the base model: {1e3 * base_s:.0f} ms")
    print(f"{'effect':24} {'at':>7} {'change %':>9} {'cost':>6} {'chi2/block':>11} {'slope':>14}")
    for name, parameter, at, step in CASES:
        scenes = [module(effects_of(name, **{parameter: at + sign * step})) for sign in (1.0, -1.0)]
        up, down = (twin(scene, supply, base) for scene in scenes)
        start_s = perf_counter()
        twin(scenes[0], supply, base)
        cost = (perf_counter() - start_s) / base_s
        difference = monte_carlo(scenes[0], histories) - monte_carlo(scenes[1], histories)
        mean, error = _blocks(difference).mean(axis=0), _blocks(difference).std(axis=0, ddof=1) / np.sqrt(GROUPS)
        predicted = _blocks(up - down)
        chi2 = float(np.mean(((mean - predicted) / error) ** 2))
        weight = predicted / error**2
        slope, spread = (
            float((weight * mean).sum() / (weight * predicted).sum()),
            1.0 / np.sqrt((weight * predicted).sum()),
        )
        rms = 100.0 * float(np.sqrt(np.mean((up - down) ** 2)) / flat.mean())
        print(f"{name:24} {at:7g} {rms:9.3f} {cost:6.2f} {chi2:11.2f} {slope:7.3f} +- {spread:.3f}")


def _blocks(image: Real) -> Real:
    """Means of 6 x 6 pixels, (..., block)."""
    parts = image.reshape(*image.shape[:-2], 10, 6, 10, 6).mean(axis=(-3, -1))
    return np.asarray(parts.reshape(*image.shape[:-2], 100))


def films_of_a_gradient() -> None:
    """By how much fewer films than columns err."""
    source = ExitSource()
    supply = Supply(lambda scene: source.exits(scene, 1, 4, notes=True))
    base = module()
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
    histories = parser.parse_args().histories
    derivatives(histories)
    films_of_a_gradient()
    lobes(histories)


if __name__ == "__main__":
    main()
