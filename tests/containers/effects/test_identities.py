"""What holds of every module, with what the effects brought in: furnace, ledger, threads, cuts of a run, company.

Rough side walls, light inside the substrate, spread in the plate, walls at the edge, several films: each, and all.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.acting import Effects
from containers.bsdf import Mirror
from containers.catalogue import Catalogue
from containers.effect import SceneEffect
from containers.effects.edge_walls import EdgeWalls
from containers.effects.receiver_volume_scatter import ReceiverVolumeScatter
from containers.effects.side_wall_roughness import SideWallRoughness
from containers.effects.substrate_leak import SubstrateLeak
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.exits import Landing
from containers.ray_tracing.monte_carlo import BLOCK, MonteCarlo
from containers.ray_tracing.predictor import Predictor
from containers.ray_tracing.several_tops import solver_of_all
from containers.ray_tracing.stopping import Solver
from containers.ray_tracing.tally import Tally
from containers.scene import Array, Scene, lambertian_receiver
from containers.stack import dbr_of
from containers.thin_film.table import FilmTable, film_table
from luxloop.camera import Camera
from luxloop.computation import Progress
from luxloop.design import Design
from luxloop.effect import AppliedEffect
from luxloop.film import Grid, Spectrum
from luxloop.model import Environment
from luxloop.ray import AnchorRequest, ChipArray, Film, Module, PredictionRequest, ShotRequest
from tests.ray_scenes import SUBSTRATE, film_face, illuminance, launched, mean_and_error, scene, within_edges

Real = NDArray[np.float64]

WHITE: dict[str, Any] = {"substrate": replace(SUBSTRATE, reflectance=1.0), "receiver": lambertian_receiver(0.0)}
"""A furnace: all is reflected, and what arrives is taken."""
LOSSY = {"absorption_per_um": 0.003}
RAYS = 100_000
ROUGH = SideWallRoughness(slope=0.3)
LEAK = SubstrateLeak(leak_share=0.1, length_um=300.0)
PLATE = ReceiverVolumeScatter(scatter_share=0.5, spread_um=120.0)
WALLS = EdgeWalls(reflectance=0.9)
EFFECTS: dict[str, tuple[SceneEffect, ...]] = {
    "rough": (ROUGH,),
    "leak": (LEAK,),
    "plate": (PLATE,),
    "walls": (WALLS,),
    "walls and leak": (WALLS, LEAK),
    "walls and plate": (WALLS, PLATE),
    "all": (ROUGH, LEAK, PLATE, WALLS),
}
SEVERAL = {"several films": (), "all with several films": (ROUGH, LEAK, PLATE, WALLS)}


@cache
def affected(name: str, layout: str = "module", white: bool = False) -> Scene:
    """A cell, or a module of 2 x 3 chips ("walled": behind perfect mirrors), under effects."""
    wall = Mirror(1.0) if layout == "walled" else None
    module = {} if layout == "cell" else {"layout": Array.regular(2, 3, 300.0, wall=wall)}
    of = scene({} if white else LOSSY, **module, **(WHITE if white else {}))
    of = Effects((EFFECTS | SEVERAL)[name]).scene(of)
    if name not in SEVERAL:
        return of
    return replace(of, tops=((of.chip.top, np.array([1.0, 0.5, 0.0])), (film_face(2.5), np.array([0.0, 0.5, 1.0]))))


def solver(of: Scene, *, threads: int = 2, stored: bool = False, **options: Any) -> Solver:
    """Full histories, or stored exits, of all the films of a scene."""

    def of_film(one: Scene, seed: int) -> Solver:
        if stored:
            return Landing(one, SOURCE.batches(one, 1), seed, threads=threads, **options)
        return MonteCarlo(one, seed, threads=threads, **options)

    return solver_of_all(of, of_film, 1)


SOURCE = ExitSource()


def same_bits(one: Tally, other: Tally) -> bool:
    """Whether two tallies are equal to the last bit."""
    names = ("bins", "ledger", "arrivals", "directions")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


# White furnace


@pytest.mark.parametrize("name", ["rough", "leak", "plate", "all"])
def test_all_light_of_a_white_cell_arrives(name: str) -> None:
    """Every photon lands once, in every group; with a fan what is recorded is right on average."""
    alone, fan = (solver(affected(name, "cell", True), fan=count).run_to(512) for count in (1, 4))
    np.testing.assert_allclose(illuminance(alone), 1.0, atol=1e-12)
    assert alone.ledger_per_history["receiver"] == pytest.approx(1.0, abs=1e-12)
    mean, error = mean_and_error(illuminance(fan))
    assert abs(mean - 1.0) < 4.0 * error < 0.02
    assert fan.ledger_per_history["receiver"] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("name", ["rough", "plate", "several films"])
def test_all_light_of_a_white_module_between_mirrors_arrives(name: str) -> None:
    """Also what the plate spreads and what another film sends back."""
    of = affected(name, "walled", True)
    tally = solver(of, fan=1).run_to(512)
    np.testing.assert_allclose(within_edges(tally, of).sum(axis=(1, 2)) / tally.histories, 1.0, atol=1e-12)


@pytest.mark.parametrize("layout", ["walled", "module"])
@pytest.mark.parametrize("name", ["rough", "leak", "plate", "several films", "all with several films"])
def test_a_white_module_loses_light_at_its_edge_alone(name: str, layout: str) -> None:
    """The substrate goes on beyond mirrors, too: what comes out behind them is lost, and nothing else is."""
    tally = solver(affected(name, layout, True), fan=1).run_to(512)
    ends = {end: value for end, value in tally.ledger_per_history.items() if value and end != "emitted"}
    assert (
        set(ends) == {"receiver", "edge"} if layout == "module" or "leak" in name or "all" in name else {"receiver"}
    )
    assert sum(ends.values()) == pytest.approx(1.0, abs=1e-12)
    assert sum(tally.events_per_history.values()) == pytest.approx(ends["receiver"], abs=1e-12)


def test_even_light_stays_even_in_a_plate_that_ends_at_walls() -> None:
    """Light straight up, the same everywhere between walls, is spread: beside them is as much as in the middle."""
    one = replace(Array.regular(1, 1, 300.0, wall=Mirror(1.0)), offset_um=np.full((1, 1, 2), 1e-3))  # not folded
    plate = ReceiverVolumeScatter(scatter_share=0.6, spread_um=200.0)
    of = Effects((plate,)).scene(scene(layout=one, receiver=lambertian_receiver(0.0)))
    place = np.random.default_rng(1).uniform(-one.half_x_um, one.half_x_um, (RAYS, 2))
    at = np.column_stack([place, np.full(RAYS, of.chip.thickness_um + 1.0)])
    found = within_edges(launched(of, at, [0.0, 0.0, 1.0]), of)[0]
    assert found.sum() == pytest.approx(RAYS, abs=1e-6)
    for rim in (found[0], found[-1], found[:, 0], found[:, -1]):
        expected = RAYS * rim.size / found.size
        assert abs(rim.sum() - expected) < 5.0 * np.sqrt(expected)


# Ledger, threads, cuts of a run


@cache
def traced(name: str, threads: int, stored: bool) -> Tally:
    """A block of each group, the far field included."""
    return solver(affected(name), threads=threads, stored=stored, direction_bins=(8, 12)).run_to(BLOCK)


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("name", [*EFFECTS, *SEVERAL])
def test_every_ledger_is_closed(name: str, stored: bool) -> None:
    """What was emitted, and what roulette made, is the sum of all ends to 1e-12."""
    tally = traced(name, 2, stored)
    assert abs(tally.ledger_defect) < 1e-12
    assert tally.ledger_per_history["emitted"] == pytest.approx(1.0, rel=1e-12)
    assert min(value for end, value in tally.ledger_per_history.items() if end != "roulette") >= 0.0


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("name", [*EFFECTS, *SEVERAL])
def test_one_thread_gives_the_bits_of_two(name: str, stored: bool) -> None:
    """Map, ledger, optical events and far field."""
    one, two = (traced(name, threads, stored) for threads in (1, 2))
    assert same_bits(one, two)
    assert one.directions.sum() > 0.0


@pytest.mark.parametrize("name", ["walls and leak", "walls and plate", "rough", "several films"])
def test_a_run_in_pieces_gives_the_bits_of_one(name: str) -> None:
    """Continued at a whole number of blocks, of each film."""
    pieces, films = solver(affected(name)), 2 if name in SEVERAL else 1
    for blocks in (1, 2):
        pieces.run_to(films * blocks * BLOCK)
    assert same_bits(pieces.tally, solver(affected(name)).run_to(2 * films * BLOCK))


# Company

ENVIRONMENT = Environment(chip_absorption_per_cm=300.0)
DESIGN = Design(distance_um=180.0, width_um=40.0, spacing_um=500.0, thickness_um=20.0, dbr_pairs=2.5)
CAMERA = Camera(rows=6, columns=16, pixel_um=80.0)
APPLIED = {
    "side_wall_roughness": {"slope": 0.3},
    "substrate_leak": {"leak_share": 0.1, "length_um": 300.0},
    "receiver_volume_scatter": {"scatter_share": 0.5, "spread_um": 120.0},
    "edge_walls": {"reflectance": 0.9},
    "dbr_thickness_gradient": {"gradient_per_mm": 0.04},
}


@cache
def table() -> FilmTable:
    """The design's film."""
    line = Spectrum(peak_nm=ENVIRONMENT.peak_nm, fwhm_nm=ENVIRONMENT.fwhm_nm)
    return film_table(dbr_of(ENVIRONMENT, DESIGN.dbr_pairs), line, Grid(wavelengths=11))


class Brought:
    """What requests name and do not bring."""

    def film(self, _: Film) -> FilmTable:
        """The design's."""
        return table()

    def effects(self, module: Module) -> Effects:
        """Those of the catalogue."""
        return Catalogue().effects(module.effects, "ray")


def shot(*names: str) -> ShotRequest:
    """Three chips along x under these effects."""
    return ShotRequest(
        environment=ENVIRONMENT,
        design=DESIGN,
        film=Film(sha256=hashlib.sha256(b"handed over beside").hexdigest(), bytes=1),
        array=ChipArray(rows=1, columns=3),
        camera=CAMERA,
        effects=tuple(AppliedEffect(name=name, parameters=APPLIED[name]) for name in names),
    )


def answer(shots: Sequence[ShotRequest], predictor: Predictor) -> dict[str, Real]:
    """What they are predicted to be, about Monte Carlo there."""
    asked = PredictionRequest(
        shots=tuple(shots), anchor=AnchorRequest(histories=32 * BLOCK), exit_histories=32 * BLOCK
    )
    return dict(predictor.answer(asked, Brought(), Progress())[1])


def test_modules_asked_for_together_are_as_asked_for_alone() -> None:
    """By two threads in one request with others and without the effects, or alone by one thread of a new worker."""
    shots = [shot(), shot("side_wall_roughness"), shot("receiver_volume_scatter", "edge_walls"), shot(*APPLIED)]
    together = answer(shots, Predictor(ExitSource(), 2))
    for number, one in enumerate(shots):
        alone = answer([one], Predictor(ExitSource(), 1))
        for name in ("images_per_mm2", "twin_per_mm2"):  # the functions of noise are those of all shots together
            np.testing.assert_array_equal(together[name][number], alone[name][0], err_msg=f"{number} {name}")
        others = together["images_per_mm2"][:number]
        assert all(np.abs(alone["images_per_mm2"][0] - other).max() > 1e-6 for other in others)
