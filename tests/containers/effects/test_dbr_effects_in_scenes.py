"""Effects on the DBR where rays meet it: the film must have them, rough faces keep light, gradients have places."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.acting import NONE, Effects
from containers.effects.dbr_roughness import DbrRoughness
from containers.effects.dbr_thickness_error import DbrThicknessError
from containers.effects.dbr_thickness_gradient import DbrThicknessGradient
from containers.ray_tracing.build import array_of, scene_of
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.several_tops import scenes_of, with_tops
from containers.ray_tracing.simulation import simulate
from containers.ray_tracing.worker import RayComputation
from containers.scene import Array, Scene
from containers.stack import dbr_of
from containers.thin_film.packing import pack
from containers.thin_film.table import FilmTable, film_table
from luxloop.camera import Camera
from luxloop.computation import Progress
from luxloop.design import Design
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.film import Grid, Spectrum
from luxloop.model import Environment
from luxloop.ray import PredictionRequest, RayRequest
from luxloop.words import parse
from validation.prediction.film_tables import FIELDS

Real = NDArray[np.float64]
ENVIRONMENT = Environment(chip_absorption_per_cm=100.0)
DESIGN = Design(distance_um=180.0, width_um=40.0, spacing_um=500.0, thickness_um=20.0, dbr_pairs=5.5)
LINE = Spectrum(peak_nm=ENVIRONMENT.peak_nm, fwhm_nm=ENVIRONMENT.fwhm_nm)
SOURCE = ExitSource()
CAMERA = Camera(rows=4, columns=12, pixel_um=120.0, gain_dn=1000.0)
STEEP = 0.04


@cache
def film(error_ratio: float = 0.0, roughness_nm: float = 0.0) -> FilmTable:
    """The design's film, too thick by a share, rough."""
    acting = Effects((DbrThicknessError(error_ratio=error_ratio), DbrRoughness(roughness_nm=roughness_nm)))
    return film_table(acting.dbr(dbr_of(ENVIRONMENT, DESIGN.dbr_pairs)), LINE, Grid(wavelengths=11))


def gradient(per_mm: float) -> Effects:
    """The effect, ready to act."""
    return Effects((DbrThicknessGradient(gradient_per_mm=per_mm),))


def request(**changes: Any) -> RayRequest:
    """Three chips along x, seen by a camera."""
    raw = hashlib.sha256(b"of any film; it is handed over beside").hexdigest()
    given: dict[str, Any] = {
        "environment": ENVIRONMENT, "design": DESIGN, "film": {"sha256": raw, "bytes": 1}, "histories": 32 * BLOCK,
        "array": {"rows": 1, "columns": 3}, "images": (CAMERA,),
    }  # fmt: skip
    return RayRequest(**given | changes)


def image(asked: RayRequest, of: FilmTable, effects: Effects = NONE) -> tuple[Real, Real]:
    """The image of a request and its standard error."""
    _, arrays = simulate(asked, of, SOURCE, Progress(), 2, effects)
    return arrays["image_0"], arrays["image_error_0"]


def module(columns: int) -> Scene:
    """A row of chips."""
    return scene_of(ENVIRONMENT, DESIGN, film(), array_of(ENVIRONMENT, DESIGN, 1, columns))


def test_a_film_without_the_effect_is_refused() -> None:
    """The ray worker says which stack it was given, which one it wants, and what to do."""
    raw = pack(*film().to_parts())
    asked = request(
        film={"sha256": hashlib.sha256(raw).hexdigest(), "bytes": len(raw)},
        effects=(AppliedEffect(name="dbr_thickness_error", parameters={"error_ratio": 0.05}),),
        method="twin",
    )
    with pytest.raises(InputError, match="with the same effects") as caught:
        RayComputation(lambda *_: raw, SOURCE).compute(json.loads(asked.model_dump_json()), Progress())
    assert caught.value.field == "film"
    assert "45.2 nm" in str(caught.value.value)
    assert "47.46 nm" in caught.value.allowed


@pytest.mark.parametrize("first", [0, 1], ids=["plain, thick", "thick, plain"])
def test_each_shot_of_a_prediction_is_asked_for_its_film(first: int) -> None:
    """Two shots of one design and film, one of them with an effect on it: refused, whichever comes first."""
    raw = pack(*film().to_parts())
    plain = {
        "environment": ENVIRONMENT.model_dump(), "design": DESIGN.model_dump(), "array": {"rows": 1, "columns": 1},
        "film": {"sha256": hashlib.sha256(raw).hexdigest(), "bytes": len(raw)},
    }  # fmt: skip
    thick = plain | {"effects": [{"name": "dbr_thickness_error", "parameters": {"error_ratio": 0.05}}]}
    shots = [plain, thick] if first == 0 else [thick, plain]
    asked = parse(PredictionRequest, {"shots": shots})
    with pytest.raises(InputError, match="with the same effects") as caught:
        RayComputation(lambda *_: raw, SOURCE).compute(json.loads(asked.model_dump_json()), Progress())
    assert caught.value.field == f"shots.{1 - first}.film"


def test_a_fits_tables_depend_on_all_that_stack_effects_see() -> None:
    """The fields of an environment that a fit asks films with are all that decide the stack."""
    other = parse(
        Environment,
        ENVIRONMENT.model_dump()
        | {"chip_bottom": "air_gap", "emission": "in_plane_dipole", "flux_per_chip_w": 2.0, "spectrum": "sampled"},
    )
    for environment in (ENVIRONMENT, other, other.model_copy(update={"indices": "dispersive"})):
        bare = Environment(**{name: getattr(environment, name) for name in FIELDS})
        assert dbr_of(bare, 5.5) == dbr_of(environment, 5.5)


def test_rough_faces_take_no_light() -> None:
    """What they scatter goes on: nothing ends in the DBR, and rays see R + T = 1 from both sides at all angles."""
    scene = scene_of(ENVIRONMENT, DESIGN, film(0.0, 5.0), module(1).layout)
    theta = np.linspace(0.0, np.pi / 2, 181)
    for side in (scene.chip.top.inside[0], scene.chip.top.outside[0]):
        np.testing.assert_allclose(sum(side.deltas(theta)), 1.0, atol=1e-9)
    smooth = module(1).chip.top.inside[0].deltas(np.zeros(1))
    rough = scene.chip.top.inside[0].deltas(np.zeros(1))
    assert smooth.mirror[0] - rough.mirror[0] == pytest.approx(0.028, abs=0.004)
    result, _ = simulate(request(), film(0.0, 5.0), SOURCE, Progress(), 2, Effects((DbrRoughness(roughness_nm=5.0),)))
    assert result["ledger"]["dbr"]["value"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("method", ["monte_carlo", "twin"])
def test_a_gradient_of_0_and_one_under_a_single_column_are_no_gradient(method: str) -> None:
    """The very same scene, hence the same bits."""
    scene = module(3)
    assert with_tops(scene, ENVIRONMENT, film(), gradient(0.0)) is scene
    assert with_tops(module(1), ENVIRONMENT, film(), gradient(STEEP)).tops == ()
    asked = request(method=method)
    np.testing.assert_array_equal(image(asked, film(), gradient(0.0)), image(asked, film()))


@pytest.mark.parametrize("columns", [2, 3, 4, 9])
def test_every_chip_shines_once(columns: int) -> None:
    """Shares of a chip over its films have the sum 1; a film's scenes have the powers of the layout, no more."""
    scene = module(columns)
    power = np.arange(1.0, columns + 1.0)[None]
    assert isinstance(scene.layout, Array)
    lit = replace(with_tops(scene, ENVIRONMENT, film(), gradient(STEEP)), layout=replace(scene.layout, power=power))
    powers = [one.layout.power for one in scenes_of(lit) if isinstance(one.layout, Array)]
    np.testing.assert_allclose(sum(powers), power, rtol=1e-14)
    assert not lit.symmetric


@pytest.mark.parametrize(("method", "stored"), [("monte_carlo", False), ("monte_carlo", True), ("twin", False)])
def test_a_gradient_is_the_sum_of_columns_with_their_films(method: str, stored: bool) -> None:
    """The image of three columns is that of each alone with the table of its own thickness, added."""
    # a row has half a square's mirror images: by few histories the twin is below 0 far from its light
    histories = (128 if method == "twin" else 32) * BLOCK
    asked = request(method=method, stored_exits=stored, histories=histories)
    whole, error = image(asked, film(), gradient(STEEP))
    parts, errors = [], [error]
    for column, x_mm in enumerate((-0.5, 0.0, 0.5)):
        power = tuple(float(column == other) for other in range(3))
        ratio = STEEP * x_mm
        acting = Effects((DbrThicknessError(error_ratio=ratio),))
        alone = request(
            method=method, stored_exits=stored, histories=histories, seed=str(column + 5),
            array={"rows": 1, "columns": 3, "power": power},
        )  # fmt: skip
        one, spread = image(alone, film(ratio), acting)
        parts.append(one)
        errors.append(spread)
    noise = np.sqrt(sum(one**2 for one in errors))
    if method == "twin":
        np.testing.assert_allclose(whole, sum(parts), rtol=2e-6)
    else:
        sigma = (whole - sum(parts)) / noise
        assert float(np.sqrt(np.mean(sigma**2))) < 1.4
        assert abs(float(np.sum(whole - sum(parts)))) < 5.0 * float(np.sqrt(np.sum(noise**2)))
    flat, _ = image(asked, film())
    assert float(np.abs(whole - flat).max() / flat.max()) > 0.002


def test_the_gradient_turned_round_is_its_mirror_image() -> None:
    """-g is g seen in a mirror, by the twin up to where its round trips are ended (1e-6)."""
    asked = request(method="twin", array={"rows": 1, "columns": 5})
    one, other = (image(asked, film(), gradient(sign * STEEP))[0] for sign in (1.0, -1.0))
    np.testing.assert_allclose(one[:, ::-1], other, rtol=2e-6)
    assert float(np.abs(one / other - 1.0).max()) > 0.01


def test_monte_carlo_of_several_films_keeps_its_books() -> None:
    """As many histories as were asked for, whole blocks of each film, and a ledger that closes to 1e-12."""
    result, _ = simulate(request(histories=96 * BLOCK), film(), SOURCE, Progress(), 2, gradient(STEEP))
    assert result["histories"] == 96 * BLOCK
    assert abs(result["ledger_defect"]) < 1e-12
    assert result["ledger"]["emitted"]["value"] == pytest.approx(1.0, rel=1e-12)
