"""From a request to its answer: scene, solver, stopping, then the document and the arrays. No clock, no bus."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np

from containers.acting import NONE, Effects
from containers.bsdf import Mirror
from containers.ray_tracing.arrays import DX, DZ, X, Z
from containers.ray_tracing.build import array_of, cell_of, scene_of
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.exits import Exits, Landing
from containers.ray_tracing.field import ModuleField
from containers.ray_tracing.kernel import WAVE_OF_EXIT, WEIGHT_OF_EXIT
from containers.ray_tracing.monte_carlo import BLOCK, MonteCarlo, blocks_of
from containers.ray_tracing.outcome import Arrays, Document, Solved, far_fields, outcome, region_of, solved
from containers.ray_tracing.receiver_images import images_of, refuse_too_many
from containers.ray_tracing.several_tops import scenes_of, solver_of_all, with_tops
from containers.ray_tracing.stopping import POINTS, Solver, Target, run_to_count, run_to_error
from containers.ray_tracing.tally import GROUPS, Box, Tally
from containers.ray_tracing.twin.cell import cell_field
from containers.ray_tracing.twin.module import ModuleTwin, open_array
from containers.ray_tracing.uniformity import uniformity
from containers.scene import Array, Cell, Scene
from containers.scene_checks import scene_warnings
from containers.stack import dbr_of
from containers.thin_film.table import FilmTable
from luxloop.computation import Progress
from luxloop.errors import InputError
from luxloop.film import Spectrum
from luxloop.ray import Module, RayRequest

TOLD_TRUNCATION = 0.003
"""Of U: a bound on what the modes left out do to it that is worth a warning."""
DIRECTION_BINS = (128, 64)
"""Of the far field: cosine of theta over the whole sphere, azimuth."""
MOST_TWIN_HISTORIES = 10_000_000
"""Whose exits, 23 bytes a history, are in memory at once."""


def simulate(
    request: RayRequest,
    film: FilmTable | None,
    source: ExitSource,
    progress: Progress,
    threads: int | None = None,
    effects: Effects = NONE,
) -> tuple[Document, Arrays]:
    """The result document of a request and its arrays.

    Parameters
    ----------
    film : the table of `request.film`, None where there is none.
    source : of stored chip exits.
    threads : to compute on, all that may be used by default; the result does not depend on it.
    effects : of the request, ready to act; those on its film have acted before.

    Raises
    ------
    InputError : a design that cannot be built, a film that is not the design's, a table that creates energy, a target
        over its budget, too few histories, a module too large for its height, pixels beyond the receiver's pad.
    Stopped : cancelled.

    Notes
    -----
    `warnings` of the document are of the scene's surfaces (`scene_warnings`), and of modes that a near receiver
    would need and that are left out.

    Arrays: `map_lx`, `map_error_lx` (y, x); `cut_x_um`, `cut_lx`, `cut_error_lx`; with `far_field` those of
    `outcome.far_fields`; `image_K`, `image_error_K` (row, column) in DN of camera K; with `exit_histories` the rays
    that leave a chip, x and y about its centre, z from the substrate: `ray_position_um`, `ray_direction` (ray, 3),
    `ray_flux_ratio` of the flux that the chip emits, `ray_wavelength_nm` (ray,).
    """
    refuse_too_many([effects.camera(camera) for camera in request.images])
    refuse_other_film(request, film, effects)
    scene = scene_of(request.environment, request.design, film, layout_of(request))
    bare = with_tops(scene, request.environment, film, effects)
    if request.method == "twin" and (names := effects.beyond_twin_in(bare)):
        raise InputError("method", "twin", "monte_carlo", f"the twin cannot represent {', '.join(names)}")
    idle = effects.idle_in(bare, request.design.dbr_pairs, bool(request.images))
    result, arrays = simulate_scene(request, effects.scene(bare), film, source, progress, threads, effects)
    return result | {"warnings": idle + result["warnings"]}, arrays


def simulate_scene(
    request: RayRequest,
    scene: Scene,
    film: FilmTable | None,
    source: ExitSource,
    progress: Progress,
    threads: int | None = None,
    effects: Effects = NONE,
) -> tuple[Document, Arrays]:
    """`simulate` of a scene that is already made: how it is solved, and what is answered, is the request's."""
    warnings = scene_warnings(scene)
    if request.method == "twin":
        found = _twin(request, scene, source, progress, threads)
    else:
        solver = solver_of(request, scene, source, threads)
        found = _solve(request, scene, solver, progress)
    result, arrays = outcome(found, request.environment, request.map_bins)
    result |= {name: getattr(request, name) for name in ("method", "seed", "stored_exits")}
    result["warnings"] = [*warnings, *_left_out(result["metrics"]["uniformity"])]
    if request.far_field:
        result["far_field"], more = far_fields(found, fold=scene.symmetric)
        result["far_field"]["eightfold"] = scene.symmetric
        arrays |= more
    if request.images:
        report = lambda share: progress.report(share, "images")  # noqa: E731
        seen = images_of(found.field, Box.of(scene), request.images, report, effects)
        for number, (image, error) in enumerate(seen):
            arrays |= {f"image_{number}": image, f"image_error_{number}": error}
    if request.stored_exits or request.exit_histories or request.method == "twin":
        result["exit_seed"] = request.exit_seed
    if request.exit_histories:
        of_rays, more = _exits(request, scene, film, source, progress)
        result, arrays = result | of_rays, arrays | more
    return result, arrays


def _left_out(uniformity: Document) -> list[str]:
    """A warning where the modes left out may move the uniformity by more than its standard error and 0.3 points."""
    truncation = uniformity["truncation"]
    if truncation <= max(TOLD_TRUNCATION, uniformity["standard_error"]):
        return []
    points = POINTS * min(truncation, 1.0)
    return [
        f"the receiver is so near the chips that modes left out may move the uniformity by up to {points:.1f} points;"
        " its standard error does not hold that: raise D - T, or take the number as a rough one"
    ]


def layout_of(request: Module) -> Cell | Array:
    """The endless or finite array of a request. Raises InputError where its chips do not fit the module."""
    asked = request.array
    if asked is None:
        return cell_of(request.environment, request.design)
    array = array_of(request.environment, request.design, asked.rows, asked.columns, asked.half_um)
    chips, mend = asked.rows * asked.columns, "one for each chip, row by row from the lowest y"
    for name, given in (("power", asked.power), ("offset_um", asked.offset_um)):
        if given and len(given) != chips:
            raise InputError(f"array.{name}", f"{len(given)} values", f"{chips} values, or none", mend)
    return replace(
        array,
        wall=None if asked.wall_reflectance is None else Mirror(asked.wall_reflectance),
        power=np.array(asked.power or [1.0] * chips).reshape(asked.rows, asked.columns),
        offset_um=np.array(asked.offset_um or [(0.0, 0.0)] * chips).reshape(asked.rows, asked.columns, 2),
    )


def refuse_other_film(request: Module, film: FilmTable | None, effects: Effects = NONE) -> None:
    """InputError where a film is missing, is not the DBR of the request's design, or is not resolved."""
    pairs, environment, mend = (
        request.design.dbr_pairs,
        request.environment,
        "ask the thin-film worker for the design's, with the same effects",
    )
    if film is None:
        if pairs:
            raise InputError("film", None, f"the table of {pairs:g} pairs", mend)
        return
    wanted = (
        effects.dbr(dbr_of(environment, pairs)),
        Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm),
    )
    if not pairs or (film.stack, film.spectrum) != wanted:
        raise InputError("film", str(film.stack)[:200], str(wanted[0])[:200] if pairs else "none: no pairs", mend)
    if not film.resolved:
        raise InputError("film", film.error_average_ratio, f"an error up to {film.grid.tolerance_ratio:g}", mend)


def _twin(request: RayRequest, scene: Scene, source: ExitSource, progress: Progress, threads: int | None) -> Solved:
    """The receiver as the twin sees it, from the exits of as many histories as are asked for."""
    if request.histories is None:
        mend = "the twin has no error to stop by but its exits'; 1,000,000 are usual"
        raise InputError("histories", None, "a count with method = twin", mend)
    if request.histories > MOST_TWIN_HISTORIES:
        mend = "all their exits are in memory at once; the twin's own error does not fall with more"
        raise InputError("histories", request.histories, f"up to {MOST_TWIN_HISTORIES:,} with method = twin", mend)
    if request.far_field:
        raise InputError("far_field", True, "false with method = twin", "use monte_carlo")
    blocks, seed = blocks_of(request.histories) // BLOCK, int(request.exit_seed)

    def exits(one: Scene) -> Exits:
        return source.exits(one, seed, blocks, report=lambda share: progress.report(share, "exits"))

    if isinstance(scene.layout, Cell):
        return Solved(scene, None, cell_field(scene, exits(scene), threads=threads), region_of(scene))
    open_array(scene)
    fields = [_twin_field(one, exits(one), threads) for one in scenes_of(scene)]
    whole = sum(field.coefficients for field in fields[1:])
    field = replace(fields[0], coefficients=fields[0].coefficients + whole) if fields[1:] else fields[0]
    return Solved(scene, None, field, region_of(scene))


def _twin_field(scene: Scene, exits: Exits, threads: int | None) -> ModuleField:
    """A module's field by the twin alone; InputError where its chips would take more light than comes to them."""
    twin = ModuleTwin(scene, exits, groups=GROUPS, threads=threads)
    if twin.exchange.least_returned < 0.0:
        chips = f"chips {scene.chip.width_um:g} um wide are no points {scene.distance_um:g} um below the receiver"
        raise InputError("method", "twin", "monte_carlo", f"for the twin each is one, and {chips}")
    return twin.field()


def solver_of(request: RayRequest, scene: Scene, source: ExitSource, threads: int | None) -> Solver:
    """Monte Carlo as a request wants it: full histories, or stored exits."""
    directions = DIRECTION_BINS if request.far_field else (0, 0)

    def solver(one: Scene, seed: int) -> Solver:
        if request.stored_exits:
            batches = source.batches(one, int(request.exit_seed))
            return Landing(one, batches, seed, threads=threads, direction_bins=directions)
        return MonteCarlo(one, seed, threads=threads, direction_bins=directions)

    return solver_of_all(scene, solver, int(request.seed))


def _solve(request: RayRequest, scene: Scene, solver: Solver, progress: Progress) -> Solved:
    """The receiver after as many histories as the request says, or asks for by its target."""
    if request.target_error_points is None:
        run_to_count(solver, request.histories or 0, progress)
        return solved(scene, solver.tally)
    target = Target(request.target_error_points / POINTS, request.budget_s)
    return run_to_error(solver, lambda tally: look(scene, tally), target, progress)


def look(scene: Scene, tally: Tally) -> tuple[float, Solved]:
    """Standard error of U (Eq. 8), infinity where there are too few histories to tell; and the receiver it is of."""
    found = solved(scene, tally)
    try:
        return uniformity(found.field, found.region).standard_error, found
    except InputError as error:
        if error.field != "histories":
            raise
        return inf, found


def _exits(
    request: RayRequest, scene: Scene, film: FilmTable | None, source: ExitSource, progress: Progress
) -> tuple[Document, Arrays]:
    """The light that leaves a chip, ray by ray; of whole blocks of all groups, at least as many as were asked for."""
    blocks = blocks_of(request.exit_histories) // BLOCK
    batches, rays, block = source.batches(scene, int(request.exit_seed)), [], 0
    while block < blocks:
        progress.report(block / blocks, "rays")
        found = batches(block)
        here, last = block - found.first_block, min(blocks - found.first_block, found.ledger.shape[1])
        rays += [found.rays[ends[here] : ends[last]] for ends in found.ends]
        block = found.first_block + last
    exits, emitted = np.concatenate(rays), blocks * BLOCK * GROUPS
    sampled = request.environment.spectrum == "sampled" and film is not None
    line_nm = film.wavelength_nm if sampled and film is not None else np.array([request.environment.peak_nm])
    return {"exit_histories": emitted}, {
        "ray_position_um": exits[:, X : Z + 1],
        "ray_direction": exits[:, DX : DZ + 1],
        "ray_flux_ratio": exits[:, WEIGHT_OF_EXIT] / np.float32(emitted),
        "ray_wavelength_nm": np.asarray(line_nm, np.float32)[exits[:, WAVE_OF_EXIT].astype(int)],
    }
