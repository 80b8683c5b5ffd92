"""The deterministic twin against closed forms, its own symmetries, and Monte Carlo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate, special

from containers.bsdf import GaussianLobe, Lambertian, Mirror, Mixture
from containers.ray_tracing.closure import bessel_j0, lambert, round_trip
from containers.ray_tracing.columns import COLUMNS, film_column
from containers.ray_tracing.exchange import Exchange
from containers.ray_tracing.exits import Exits, Landing, make_exits
from containers.ray_tracing.field import CellField
from containers.ray_tracing.module_twin import ModuleTwin
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.prediction import Anchor, Shot, Supply, jacobian, twin_images
from containers.ray_tracing.twin import cell_field
from containers.scene import Array, Cell, Emission, Receiver, Scene, lambertian_receiver
from luxloop.camera import Camera
from luxloop.errors import InputError
from tests.ray_scenes import scene, taking

Real = NDArray[np.float64]
SIGMA = np.radians(5.0)
RECEIVER = lambertian_receiver(0.35)
X = np.array([0.0, 0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 6.0])


@pytest.fixture(scope="module")
def lambert_case() -> tuple[Scene, Exits]:
    """Golden case A: Lambert's law from the chip's top."""
    case = scene(emission=Emission(from_top=True))
    return case, make_exits(case, 1, 4 * BLOCK)


@pytest.fixture(scope="module")
def dim() -> tuple[Scene, Exits]:
    """A chip that absorbs, with notes, so that walks are short."""
    case = scene({"absorption_per_um": 2e-2})
    return case, make_exits(case, 1, 4 * BLOCK, notes=True)


def monte_carlo(case: Scene, exits: Exits, seeds: int = 4) -> tuple[Real, Real]:
    """Coefficients of the cell's field from landings with several seeds, and their error."""
    found = []
    for seed in range(seeds):
        tally = Landing(case, exits, seed, survival=1.0).run_to(exits.histories)
        field = CellField.from_bins(
            tally.cell_bins(), tally.histories, case.layout.spacing_um, case.height_um, folded=True
        )
        found.append(field.coefficients.mean(axis=0))
    return np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(seeds)


def test_bessel_functions_are_those_of_scipy() -> None:
    """J0 to 1e-7 and x K1(x) to 1e-6 over all that is used."""
    x = np.linspace(0.0, 60.0, 5001)
    assert np.abs(bessel_j0(x) - special.j0(x)).max() < 1e-7
    y = np.linspace(1e-6, 30.0, 5001)
    assert np.abs(lambert(y) - y * special.k1(y)).max() < 1e-6


def test_a_round_trip_returns_the_reflectance_at_long_waves() -> None:
    """T(0) is the substrate's reflectance, whatever its scatter, and |T| is never above it."""
    for substrate in (
        Mirror(0.9),
        Lambertian(0.9),
        GaussianLobe(0.9, SIGMA),
        Mixture((Mirror(1.0), Lambertian(0.8)), (0.5, 0.5)),
    ):
        T = round_trip(substrate, RECEIVER, X)
        assert T[0] == pytest.approx(0.9, abs=1e-6)
        assert np.all(np.abs(T) <= 0.9 + 1e-6)


def test_lamberts_round_trip_over_a_mirror_is_the_image_twice_as_far() -> None:
    """The transform of the irradiance by a Lambertian point 2 D below, integrated by another program."""
    for x in (0.3, 1.0, 2.5):
        radial = lambda t, x=x: 2.0 * t * (1.0 + t * t) ** -2 * special.j0(2.0 * x * t)
        value, _ = integrate.quad(radial, 0.0, 200.0, limit=2000)
        assert float(round_trip(Mirror(1.0), RECEIVER, np.array([x]))[0]) == pytest.approx(value, abs=1e-4)


@pytest.mark.parametrize("degrees", [1.0, 5.0, 15.0])
def test_a_lobes_round_trip_is_what_its_own_samples_do(degrees: float) -> None:
    """The mean wave over random rays down and up, within 4 standard errors and what the table states."""
    rng, lobe = np.random.default_rng(2), GaussianLobe(1.0, np.radians(degrees))
    theta = np.arcsin(np.sqrt(rng.random(100_000)))
    out = lobe.sample(rng.random((theta.size, 3)), theta).direction
    shift = np.hypot(np.tan(theta) + out[:, 0] / out[:, 2], out[:, 1] / out[:, 2])
    for x, T in zip(X[1:], round_trip(lobe, RECEIVER, X)[1:], strict=True):
        waves = special.j0(x * shift)
        assert abs(waves.mean() - T) < 4.0 * waves.std() / np.sqrt(theta.size) + (1e-3 if degrees > 10.0 else 2e-4)


def test_a_narrow_lobe_is_a_mirror() -> None:
    """At 0.01 deg the two round trips agree to 1e-4."""
    lobe = round_trip(GaussianLobe(1.0, np.radians(0.01)), RECEIVER, X)
    np.testing.assert_allclose(lobe, round_trip(Mirror(1.0), RECEIVER, X), atol=1e-4)


def test_response_to_half_of_all_light_halves_what_is_recorded() -> None:
    """A flat response is a factor; one that falls to grazing loses most of short ways' counterpart."""
    half = Receiver(Lambertian(0.35), response=np.array([0.5, 0.5]))
    falling = Receiver(Lambertian(0.35), response=np.array([0.0, 1.0]))
    full = round_trip(Mirror(1.0), RECEIVER, X)
    np.testing.assert_allclose(round_trip(Mirror(1.0), half, X, recorded=True), 0.5 * full, atol=1e-9)
    # the mean of cos over Lambert's law is 2/3
    assert float(round_trip(Mirror(1.0), falling, np.zeros(1), recorded=True)[0]) == pytest.approx(
        2.0 / 3.0, abs=1e-4
    )


@pytest.mark.parametrize("substrate", [Mirror(0.97), GaussianLobe(0.97, SIGMA), Lambertian(0.97)])
def test_a_cell_is_that_of_monte_carlo(lambert_case: tuple[Scene, Exits], substrate: object) -> None:
    """Case A over three substrates: mean to 0.1 %, the map to 0.6 % rms, with the noise of few histories."""
    case, exits = lambert_case
    case = replace(case, substrate=substrate)  # type: ignore[arg-type]  # a Bsdf of the list above
    twin = cell_field(case, exits).coefficients.mean(axis=0)
    long, error = monte_carlo(case, exits)
    assert twin[0, 0] == pytest.approx(long[0, 0], rel=2e-3)
    assert np.sqrt(((twin - long) ** 2).sum()) / long[0, 0] < 6e-3
    assert np.abs(twin - long).max() < 6.0 * error.max() + 2e-3


def test_nothing_comes_back_from_a_black_receiver_or_a_black_substrate(lambert_case: tuple[Scene, Exits]) -> None:
    """Then all light is direct, and above a chip's Lambertian top all of it lands: mean 1 with a white substrate."""
    case, exits = lambert_case
    dark = cell_field(replace(case, receiver=lambertian_receiver(0.0)), exits, shadow=False)
    black = cell_field(replace(case, substrate=Lambertian(0.0)), exits, shadow=False)
    assert dark.mean == pytest.approx(1.0, abs=1e-6)
    assert black.mean == pytest.approx(1.0, abs=1e-6)


def test_all_light_is_a_geometric_series_of_round_trips(lambert_case: tuple[Scene, Exits]) -> None:
    """Without chips in the way the mean is 1 / (1 - rho_r rho_s)."""
    case, exits = lambert_case
    twin = cell_field(replace(case, substrate=Mirror(0.8), receiver=lambertian_receiver(0.5)), exits, shadow=False)
    assert twin.mean == pytest.approx(1.0 / (1.0 - 0.4), rel=1e-6)


def test_chips_that_absorb_take_from_the_light_sent_back() -> None:
    """Large dark chips: the mean is that of Monte Carlo to 0.5 % with the chips counted, and 4 % or more above without."""
    dark = scene({"width_um": 100.0, "absorption_per_um": 0.05}, layout=Cell(300.0), emission=Emission(from_top=True))
    exits = make_exits(dark, 1, 2 * BLOCK)
    long, _ = monte_carlo(dark, exits)
    assert cell_field(dark, exits).mean == pytest.approx(long[0, 0], rel=5e-3)
    assert cell_field(dark, exits, shadow=False).mean > 1.04 * long[0, 0]


def test_the_twin_is_a_function_of_its_arguments(dim: tuple[Scene, Exits]) -> None:
    """Bit for bit the same with one thread or two."""
    case, exits = dim
    one, two = (cell_field(case, exits, threads=threads).coefficients for threads in (1, 2))
    assert np.array_equal(one, two)


@pytest.mark.parametrize("name", ["distance_um", "substrate_reflectance", "receiver_reflectance"])
def test_the_twin_is_smooth(lambert_case: tuple[Scene, Exits], name: str) -> None:
    """Derivatives of the lowest waves over a full and over a quarter of the usual step agree to a tenth of the largest."""
    case, exits = lambert_case
    column = COLUMNS[name]
    step = column.step(column.value(case))
    slopes = []
    for h in (step, step / 4.0):
        ends = (cell_field(column.move(case, a), exits, shadow=False).coefficients.mean(axis=0) for a in (h, -h))
        slopes.append((np.subtract(*ends) / (2.0 * h))[:3, :3])
    assert np.abs(slopes[0] - slopes[1]).max() < 0.1 * np.abs(slopes[0]).max()


def test_a_mirror_part_of_the_receiver_is_followed(dim: tuple[Scene, Exits]) -> None:
    """A receiver of which a seventh is specular: the mean of Monte Carlo to 0.3 %."""
    case, exits = dim
    coated = replace(case, receiver=Receiver(Mixture((Lambertian(0.35), Mirror(0.35)), (6 / 7, 1 / 7))))
    long, _ = monte_carlo(coated, exits)
    assert cell_field(coated, exits).mean == pytest.approx(long[0, 0], rel=3e-3)


def test_what_the_twin_does_not_know_is_refused(dim: tuple[Scene, Exits]) -> None:
    """A tilted or walled module, a finite one asked as a cell, and a cell asked as a module."""
    case, exits = dim
    array = Array.regular(3, 3, 500.0)
    with pytest.raises(InputError, match="repeats"):
        cell_field(replace(case, layout=array), exits)
    for layout, tilt in (
        (case.layout, (0.0, 0.0)),
        (replace(array, wall=Mirror(0.5)), (0.0, 0.0)),
        (array, (1e-5, 0.0)),
    ):
        with pytest.raises(InputError, match="open edges"):
            ModuleTwin(replace(case, layout=layout, tilt_per_um=tilt), exits)


def test_a_wide_module_is_an_endless_one_in_its_middle() -> None:
    """Uniform light on a receiver eighty distances wide comes back as rho / (1 - rho) of itself at the centre."""
    exchange = Exchange(Array.regular(15, 15, 500.0), Mirror(0.97), RECEIVER, 90.0)
    x, y = exchange.centres_um
    waves = exchange.solve(np.ones((y.size, x.size)))
    centre = float(exchange.sum_up(waves, np.zeros(1), np.zeros(1))[0, 0])
    assert centre == pytest.approx(0.3395 / (1.0 - 0.3395), rel=5e-3)
    edge = float(exchange.sum_up(waves, x[-1:], np.zeros(1))[0, 0])
    assert 0.4 * centre < edge < 0.7 * centre


def test_a_finite_module_is_that_of_monte_carlo(lambert_case: tuple[Scene, Exits]) -> None:
    """3 x 3 chips: light on the receiver, all and in its middle ninth, to 1.2 %."""
    case, exits = lambert_case
    finite = replace(case, layout=Array.regular(3, 3, 500.0))
    runs = [Landing(finite, exits, seed, survival=1.0).run_to(exits.histories) for seed in range(6)]
    box = runs[0].box
    at = (np.arange(box.columns) + 0.5 - box.columns / 2) * box.step_um
    long = np.mean([run.bins.sum(axis=(0, 1)) for run in runs], axis=0) / (runs[0].total_histories / 9)
    twin = 1e-6 * box.step_um**2 * ModuleTwin(finite, exits).mean(at, at)
    for half in (750.0, 250.0):
        inside = np.ix_(np.abs(at) < half, np.abs(at) < half)
        assert twin[inside].sum() == pytest.approx(long[inside].sum(), rel=1.2e-2)


def test_a_dead_chip_takes_its_own_light_away(dim: tuple[Scene, Exits]) -> None:
    """The map is linear in the powers, and follows chips that are displaced together."""
    case, exits = dim
    array = Array.regular(1, 3, 500.0)
    maps = {}
    for name, power in (("all", [1.0, 1.0, 1.0]), ("left", [1.0, 0.0, 0.0]), ("rest", [0.0, 1.0, 1.0])):
        lit = replace(case, layout=replace(array, power=np.array([power])))
        maps[name] = ModuleTwin(lit, exits, blocks=1, shadow_rays=0).mean(np.linspace(-700, 700, 15), np.zeros(1))
    np.testing.assert_allclose(maps["left"] + maps["rest"], maps["all"], rtol=1e-5)
    assert np.argmax(maps["left"]) < 7


def shots(case: Scene) -> list[Shot]:
    """One chip and nine, seen by a small camera."""
    camera = Camera(rows=16, columns=16, pixel_um=40.0)
    return [
        Shot(replace(case, layout=Array.regular(n, n, 500.0, half)), camera) for n, half in ((1, 500.0), (3, None))
    ]


def test_a_prediction_at_the_anchor_is_monte_carlo_itself(dim: tuple[Scene, Exits]) -> None:
    """There the twin cancels; the covariance is that of the mean of the groups."""
    case, exits = dim
    supply = Supply(lambda _: exits)
    of = shots(case)
    fields = [ModuleTwin(shot.scene, exits, groups=8, seed=7).field() for shot in of]
    anchor = Anchor(of, fields, supply, blocks=1, shadow_rays=2048)
    found = anchor.predict(of)
    other = Anchor(of, fields, supply, blocks=2, shadow_rays=1024).predict(of)
    np.testing.assert_allclose(found.images_per_mm2, other.images_per_mm2, rtol=1e-9)
    assert found.noise_per_mm2.shape == (8, 2, 16, 16)
    assert np.all(found.error_per_mm2 > 0.0)
    assert np.all(found.error_per_mm2 < 0.2 * found.images_per_mm2.max())


def test_jacobian_columns_predict_small_changes(dim: tuple[Scene, Exits]) -> None:
    """Of what moves no walk: the image at half a step is the image plus half the column; a distance with more noise."""
    case, _ = dim
    supply = Supply(lambda s: make_exits(s, 5, BLOCK, notes=True))
    columns = [*COLUMNS.values(), film_column(lambda _: taking(0.3, 0.7))]
    of, options = shots(case), {"blocks": 1, "shadow_rays": 1024}
    found = jacobian(of, columns, supply, **options)
    assert found.shape == (len(columns), 2, 16, 16)
    base = twin_images(of, supply, **options)
    for number, column in enumerate(columns):
        if column.name in ("width_um", "thickness_um", "substrate_sigma_rad"):
            continue  # other walks inside other chips: their noise is larger than this bound
        h = column.step(column.value(case)) / 2.0
        moved = twin_images([Shot(column.move(shot.scene, h), shot.camera) for shot in of], supply, **options)
        expected = h * found[number]
        bound = 0.4 if column.name in ("distance_um", "spacing_um") else 0.1
        assert np.sqrt(np.mean((moved - base - expected) ** 2)) < bound * np.sqrt(np.mean(expected**2)), column.name


def test_one_sided_steps_stay_within_their_range() -> None:
    """A clear chip is not made to amplify, a substrate not to create light; derivatives of a parabola stay exact."""
    clear, white = scene(), scene(substrate=GaussianLobe(0.995, SIGMA))
    for column, case in ((COLUMNS["absorption_per_um"], clear), (COLUMNS["substrate_reflectance"], white)):
        stencil = column.stencil(case)
        assert all(column.low <= column.value(case) + a <= column.high for a, _ in stencil)
        assert sum(w for _, w in stencil) == pytest.approx(0.0, abs=1e-6 * abs(stencil[0][1]))
        assert sum(w * (3.0 * a + a * a) for a, w in stencil) == pytest.approx(3.0)
