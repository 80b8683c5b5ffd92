"""Effects on a module by closed forms: what each does to emission, surfaces, media and places, and what it keeps."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import quad
from scipy.special import ndtr

from containers.acting import Effects
from containers.bsdf import GaussianLobe, Lambertian, Mirror, reciprocity_defect
from containers.effect import SceneEffect
from containers.effects.active_layer_depth import ActiveLayerDepth
from containers.effects.active_layer_thickness import ActiveLayerThickness
from containers.effects.chip_absorption import ChipAbsorption
from containers.effects.chip_position_errors import ChipPositionErrors
from containers.effects.chip_power_spread import ChipPowerSpread
from containers.effects.current_crowding import CurrentCrowding
from containers.effects.dead_chip import DeadChip
from containers.effects.dipole_orientation import DipoleOrientation
from containers.effects.distance_error import DistanceError
from containers.effects.edge_walls import EdgeWalls
from containers.effects.electrode_shadow import ElectrodeShadow
from containers.effects.receiver_btdf import ReceiverBtdf
from containers.effects.receiver_specular import ReceiverSpecular
from containers.effects.receiver_tilt import ReceiverTilt
from containers.effects.receiver_volume_scatter import ReceiverVolumeScatter
from containers.effects.substrate_leak import SubstrateLeak
from containers.effects.substrate_lobe import SubstrateLobe
from containers.ray_tracing.arrays import DZ, PATH
from containers.ray_tracing.kernel import WEIGHT_OF_EXIT
from containers.ray_tracing.monte_carlo import MonteCarlo
from containers.ray_tracing.packing import emission_arrays
from containers.ray_tracing.tally import Tally
from containers.scene import Array, Emission, Scene
from luxloop.errors import InputError
from tests.ray_scenes import N, black, exits_of, lambert_up, launched, scene, within_edges

Real = NDArray[np.float64]
ANGLES = np.linspace(0.0, 1.5, 7)
PLATE = ReceiverVolumeScatter(scatter_share=0.5, spread_um=120.0)
LEAK = SubstrateLeak(leak_share=0.1, length_um=300.0)
UP = np.array([0.0, 0.0, 1.0])


def under(effect: SceneEffect, of: Scene) -> Scene:
    """The scene with the effect, as a worker applies it."""
    return Effects((effect,)).scene(of)


def lone(half_um: float = 1000.0, **changes: Any) -> Scene:
    """One chip in a black module whose map is not folded: its place is off by a nanometre."""
    layout = replace(Array.regular(1, 1, 500.0, half_um), offset_um=np.full((1, 1, 2), 1e-3))
    return black(layout=layout, **changes)


def moments(tally: Tally, walled: Scene | None = None) -> tuple[float, Real, Real]:
    """Sum, mean place (x, y) and variances of what was recorded, per history; of a walled scene between its walls."""
    bins, (x0, x1, y0, y1) = tally.cell_bins().sum(axis=0), tally.box.ends_um
    if walled is not None:
        bins, layout = within_edges(tally, walled).sum(axis=0), walled.layout
        assert isinstance(layout, Array)
        x0, x1, y0, y1 = -layout.half_x_um, layout.half_x_um, -layout.half_y_um, layout.half_y_um
    x, y = (a + (np.arange(n) + 0.5) * (b - a) / n for a, b, n in ((x0, x1, bins.shape[1]), (y0, y1, bins.shape[0])))
    total = bins.sum()
    along_x, along_y = bins.sum(axis=0) / total, bins.sum(axis=1) / total
    mean = np.array([along_x @ x, along_y @ y])
    variance = np.array([along_x @ (x - mean[0]) ** 2, along_y @ (y - mean[1]) ** 2])
    return float(total / tally.total_histories), mean, variance


def test_absorption_dims_each_ray_along_its_path() -> None:
    """Beer and Lambert: the same exits as of a clear chip, each weight exp(-a path), a in 1/um from 1/cm."""
    clear = black()
    before, _, notes = exits_of(clear)
    after, _, _ = exits_of(under(ChipAbsorption(absorption_per_cm=30.0, profile="even"), clear))
    assert len(after) == len(before)
    expected = np.exp(-30.0e-4 * notes[:, PATH].astype(float))
    np.testing.assert_allclose(after[:, WEIGHT_OF_EXIT] / before[:, WEIGHT_OF_EXIT], expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("profile", "bottom_per_cm", "top_per_cm"), [("rising", 20.0, 80.0), ("falling", 80.0, 20.0)]
)
def test_absorption_rises_from_nothing_to_twice_its_mean(
    profile: Any, bottom_per_cm: float, top_per_cm: float
) -> None:
    """Beside what the environment says, which stays where it was."""
    effect = ChipAbsorption(absorption_per_cm=30.0, profile=profile)
    chip = under(effect, scene({"absorption_per_um": 20e-4})).chip
    ends = (
        chip.absorption_per_um - chip.absorption_rise_per_um,
        chip.absorption_per_um + chip.absorption_rise_per_um,
    )
    assert ends == pytest.approx((bottom_per_cm * 1e-4, top_per_cm * 1e-4))


def test_in_plane_dipoles_gain_44_percent_upwards_and_lose_22_percent_sideways() -> None:
    """Into the escape cones of GaN, at a = -1/2; the whole sphere keeps its light."""
    emission = under(DipoleOrientation(preference=-0.5), scene()).emission
    c = np.linspace(-1.0, 1.0, 200_001)
    share = np.interp(c, emission.cosine, emission.intensity)
    inside = np.cos(np.arcsin(1.0 / N))
    phi, along = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 721), np.linspace(inside, 1.0, 201))
    sideways = np.interp(np.sqrt(1.0 - along**2) * np.cos(phi), emission.cosine, emission.intensity)
    assert np.trapezoid(share, c) / 2.0 == pytest.approx(1.0, abs=1e-5)
    assert share[c > inside].mean() - 1.0 == pytest.approx(0.44, abs=0.005)
    assert np.trapezoid(sideways, phi[0], axis=1).mean() / (2.0 * np.pi) - 1.0 == pytest.approx(-0.22, abs=0.005)


@pytest.mark.parametrize("a", [-0.5, 0.2, 0.5])
def test_dipoles_only_turn_light(a: float) -> None:
    """The intensity that kernels draw from has the form of the formula and the power of one chip."""
    drawn = emission_arrays(under(DipoleOrientation(preference=a), scene())).intensity
    c = np.linspace(-1.0, 1.0, drawn.size)
    expected = (1.0 + a * (1.0 - c**2)) / (1.0 + 2.0 * a / 3.0) / (4.0 * np.pi)
    np.testing.assert_allclose(drawn, expected, rtol=1e-4)


def test_crowding_moves_the_centroid_by_c1_w_12_and_the_second_moment_by_c2_w2_45() -> None:
    """Integrals over the square; the weights have a mean of 1 as they are, and the light of a chip is unchanged."""
    of = under(CurrentCrowding(rise=0.3, rim=0.2), scene())
    w = of.emission.position
    assert w.mean() == pytest.approx(1.0, abs=1e-12)
    place = (np.arange(w.shape[0]) + 0.5) / w.shape[0] - 0.5
    assert (w.mean(axis=0) @ place) / place.size == pytest.approx(0.3 / 12.0, rel=2e-3)
    square = place**2 + 1.0 / (12.0 * place.size**2)  # mean over a cell
    second = (np.add.outer(square, square) * w).mean() - 1.0 / 6.0  # of r^2 / W^2
    assert second == pytest.approx(0.2 * quad(lambda u: 8.0 * (u**4 - u**2 / 12.0), -0.5, 0.5)[0], rel=1e-2)
    assert (w.mean(axis=1) @ place) / place.size == pytest.approx(0.0, abs=1e-12)
    assert not of.symmetric
    assert under(CurrentCrowding(rise=0.0, rim=0.2), scene()).symmetric


@pytest.mark.parametrize(("corner", "sign"), [("left_low", (-1, -1)), ("right_high", (1, 1)), ("right_low", (1, -1))])
def test_a_shadow_takes_its_share_of_the_area_at_its_corner(corner: Any, sign: tuple[int, int]) -> None:
    """The dark area is f exactly, also between cells; light's centroid moves away by f (1 - sqrt f) / 2 (1 - f) W."""
    f = 0.1
    w = under(ElectrodeShadow(dark_share=f, corner=corner), scene()).emission.position
    assert 1.0 - w.mean() == pytest.approx(f, abs=1e-12)
    place = (np.arange(32) + 0.5) / 32 - 0.5
    away = f * (1.0 - f**0.5) / 2.0 / (1.0 - f)
    assert w.sum(axis=0) @ place / w.sum() == pytest.approx(-sign[0] * away, abs=2e-4)
    assert w.sum(axis=1) @ place / w.sum() == pytest.approx(-sign[1] * away, abs=2e-4)


def test_effects_on_the_emission_are_multiplied() -> None:
    """Shadow and crowding together weigh each place by both."""
    both = Effects((CurrentCrowding(rise=0.1, rim=0.0), ElectrodeShadow(dark_share=0.2, corner="left_low")))
    one, other = (Effects((effect,)).scene(scene()).emission.position for effect in both.all)
    np.testing.assert_allclose(both.scene(scene()).emission.position, one * other)


def test_a_thin_layer_is_born_at_its_height() -> None:
    """All light starts at the same share of T."""
    assert np.all(emission_arrays(under(ActiveLayerDepth(depth=0.95), scene())).height_quantiles == 0.95)


def test_a_thick_layers_light_is_the_mean_over_its_heights() -> None:
    """Light that leaves upwards from a chip that absorbs: of thin layers by Gauss's rule, and of the thick one."""

    def upward(of: Scene) -> float:
        exits, _, _ = exits_of(of, count=65536)
        return float(exits[exits[:, DZ] > 0.0, WEIGHT_OF_EXIT].sum() / 65536)

    of = black(chip_changes={"absorption_per_um": 0.02})
    thick = under(ActiveLayerThickness(reach=0.4), under(ActiveLayerDepth(depth=0.9), of))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    thin = [upward(under(ActiveLayerDepth(depth=0.9 * (1.0 - 0.2 * (1.0 + u))), of)) for u in nodes]
    assert thick.emission.heights == pytest.approx((0.54, 0.9))
    assert np.ptp(thin) > 0.1 * max(thin)
    assert upward(thick) == pytest.approx(float(weights @ thin) / 2.0, rel=3e-3)


def test_only_a_thin_layer_reaches_down() -> None:
    """The whole volume has no lower place to shine from, and says so; a Lambertian top has no inside."""
    with pytest.raises(InputError, match="a thin layer to reach down from"):
        under(ActiveLayerThickness(reach=0.2), scene())
    both = Effects((ActiveLayerThickness(reach=0.5), ActiveLayerDepth(depth=0.8)))
    assert both.scene(scene()).emission.heights == pytest.approx((0.4, 0.8))  # wherever the model file has them
    top = scene(emission=Emission(from_top=True))
    assert under(ActiveLayerThickness(reach=0.2), top).emission is top.emission


def test_surfaces_keep_their_albedo() -> None:
    """Substrate and receiver send back as much at every angle; the receiver's mixture is reciprocal."""
    of = scene()
    lobe = under(SubstrateLobe(lambertian_share=0.3), of).substrate
    mirror = under(ReceiverSpecular(specular_share=0.15), of).receiver.bsdf
    np.testing.assert_allclose(lobe.albedo(ANGLES), 0.97, rtol=1e-12)
    np.testing.assert_allclose(mirror.albedo(ANGLES), 0.35, rtol=1e-12)
    np.testing.assert_allclose(mirror.deltas(ANGLES).mirror, 0.15 * 0.35, rtol=1e-12)
    assert reciprocity_defect(mirror, ANGLES) < 1e-12
    wide = lobe.evaluate(0.0, np.array([np.sin(1.2), 0.0, np.cos(1.2)]))
    assert wide == pytest.approx(0.3 * 0.97 / np.pi, rel=1e-6)
    whole = replace(of, substrate=Lambertian(0.97))
    assert under(SubstrateLobe(lambertian_share=0.3), whole) is whole
    assert isinstance(of.substrate, GaussianLobe)


@pytest.mark.parametrize("q", [-0.4, 0.4])
def test_lambert_light_is_recorded_with_1_minus_half_q(q: float) -> None:
    """The mean of 1 - q sin^2 over Lambert's law; what arrives from straight below is recorded whole."""
    of = under(ReceiverBtdf(slant_loss=q), black())
    tally = launched(of, [100.0, 100.0, 1.0], lambert_up(50_000))
    straight = launched(of, np.tile([100.0, 100.0, 1.0], (2_000, 1)), UP)
    assert tally.cell_bins().sum() / 50_000 == pytest.approx(1.0 - q / 2.0, abs=2e-3)
    assert straight.cell_bins().sum() / 2_000 == pytest.approx(1.0, abs=1e-9)


def test_the_plate_keeps_light_and_spreads_its_share_by_its_variance() -> None:
    """A beam keeps its sum and place and gets the variance a l^2 along each axis."""
    tally = launched(
        under(ReceiverVolumeScatter(scatter_share=0.5, spread_um=120.0), lone()),
        np.tile([100.0, 50.0, 1.0], (60_000, 1)),
        UP,
    )
    total, mean, variance = moments(tally)
    assert total == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(mean, [100.0, 50.0], atol=2.5)
    np.testing.assert_allclose(variance, 0.5 * 120.0**2, rtol=0.04)
    twice = under(ReceiverVolumeScatter(scatter_share=0.1, spread_um=50.0), scene())
    with pytest.raises(InputError, match="spread_share"):
        under(ReceiverVolumeScatter(scatter_share=0.1, spread_um=50.0), twice)


def test_a_tilt_moves_a_cone_of_light_by_its_first_order() -> None:
    """Rays that fill a disc of slopes u up to 1 land at u h / (1 - D t u_x): their mean moves uphill by t D h / 4."""
    radius, phi = (
        np.sqrt(np.random.default_rng(4).random(100_000)),
        2.0 * np.pi * np.random.default_rng(5).random(100_000),
    )
    slopes = np.column_stack([radius * np.cos(phi), radius * np.sin(phi), np.ones(phi.size)])
    way = slopes / np.linalg.norm(slopes, axis=1)[:, None]
    flat, tilted = (
        moments(launched(of, [0.0, 0.0, 36.0], way))[1]
        for of in (lone(), under(ReceiverTilt(tilt_x_per_mm=0.05, tilt_y_per_mm=0.0), lone()))
    )
    assert tilted[0] - flat[0] == pytest.approx(0.05e-3 * 180.0 * (180.0 - 36.0) / 4.0, rel=0.1)
    assert tilted[1] == pytest.approx(flat[1], abs=0.03)
    cell = scene()
    assert under(ReceiverTilt(tilt_x_per_mm=0.05, tilt_y_per_mm=0.0), cell) is cell


def test_a_farther_receiver_sees_a_beam_farther_away() -> None:
    """A ray at 45 deg lands where D says."""
    tally = launched(under(DistanceError(distance_um=15.0), lone()), [0.0, 0.0, 36.0], [[0.6, 0.0, 0.8]])
    assert moments(tally)[1][0] == pytest.approx((195.0 - 36.0) * 0.75, abs=tally.box.step_um)


def test_displaced_chips_take_their_light_along() -> None:
    """A beam of a displaced chip lands displaced; lists of another length do nothing."""
    of = under(ChipPositionErrors(shift_x_um=(10.0,), shift_y_um=(-4.0,)), lone())
    assert isinstance(of.layout, Array)
    np.testing.assert_allclose(of.layout.centres_um[0, 0], [10.001, -3.999])
    plain, moved = (moments(launched(one, np.tile([0.0, 0.0, 36.0], (10, 1)), UP))[1] for one in (lone(), of))
    np.testing.assert_allclose(moved - plain, [10.0, -4.0], atol=of.height_um / 8.0)
    same = lone()
    assert under(ChipPositionErrors(shift_x_um=(1.0, 2.0), shift_y_um=()), same) is same


def powers(effect: SceneEffect, rows: int = 1, columns: int = 3) -> ArrayLike:
    """The powers of a module's chips under an effect."""
    layout = under(effect, scene(layout=Array.regular(rows, columns, 500.0))).layout
    assert isinstance(layout, Array)
    return layout.power.ravel()


def test_powers_follow_the_lists() -> None:
    """Gains are multiplied; a dead chip is one number; modules that lack the chip stay as they are."""
    np.testing.assert_allclose(powers(ChipPowerSpread(gain=(0.1, 0.0, -0.5))), [1.1, 1.0, 0.5])
    np.testing.assert_allclose(powers(ChipPowerSpread(gain=(0.1,))), 1.0)
    np.testing.assert_allclose(powers(DeadChip(power_ratio=0.2, chip=2.0)), [1.0, 1.0, 0.2])
    np.testing.assert_allclose(powers(DeadChip(power_ratio=0.0, chip=3.0)), 1.0)
    np.testing.assert_allclose(powers(DeadChip(power_ratio=0.0, chip=0.0), 1, 1), 1.0)
    shares = emission_arrays(
        under(ChipPowerSpread(gain=(1 / 3, 0.0, -1 / 3)), scene(layout=Array.regular(1, 3, 500.0)))
    )
    np.testing.assert_allclose(shares.chip_cumulative, [4 / 9, 7 / 9, 1.0])
    with pytest.raises(InputError, match="whole number"):
        powers(DeadChip(power_ratio=0.0, chip=1.5))


def test_walls_send_back_their_share_and_cells_have_none() -> None:
    """A level beam meets one wall after the other until the substrate or receiver: none here; r of it at each."""
    of = under(EdgeWalls(reflectance=0.5), lone(400.0))
    tally = launched(of, np.tile([100.0, 0.0, 100.0], (20_000, 1)), [0.99, 0.0, np.sqrt(1.0 - 0.99**2)])
    # 80 um up take 562 um along x: to the wall at 400, and 262 back
    total, mean, _ = moments(tally, of)
    assert total == pytest.approx(0.5, abs=0.012)
    assert mean[0] == pytest.approx(400.0 - (80.0 * 0.99 / np.sqrt(1.0 - 0.99**2) - 300.0), abs=of.height_um / 8.0)
    cell = scene()
    assert under(EdgeWalls(reflectance=0.5), cell) is cell


def test_walls_stand_in_front_of_the_modules_own() -> None:
    """From its off value on the effect adds to what the edge reflects; a wall that is no mirror it does not know."""
    edge = partial(Array.regular, 1, 1, 500.0)
    for own in (0.1, 0.3, 0.7):  # off, it is the very same, to the bit
        of_off = under(EdgeWalls(reflectance=0.0), scene(layout=edge(wall=Mirror(own)))).layout
        assert isinstance(of_off, Array)
        assert of_off.wall == Mirror(own)
    for r, both in ((0.0, 0.8), (1e-6, 0.8 + 0.2e-6), (0.5, 0.9)):
        layout = under(EdgeWalls(reflectance=r), scene(layout=edge(wall=Mirror(0.8)))).layout
        assert isinstance(layout, Array)
        assert isinstance(layout.wall, Mirror)
        assert layout.wall.reflectance == pytest.approx(both, abs=1e-12)
    with pytest.raises(InputError, match="a mirror"):
        under(EdgeWalls(reflectance=0.5), scene(layout=edge(wall=Lambertian(0.8))))


@pytest.mark.parametrize("beside", [(), (PLATE,), (LEAK,), (PLATE, LEAK)], ids=["alone", "plate", "leak", "both"])
def test_walls_that_reflect_nothing_are_an_open_edge(beside: tuple[SceneEffect, ...]) -> None:
    """The limit of off, bit for bit, map and ledger, also beside other effects; bins of 10 um fit both."""
    open_edge = Effects(beside).scene(scene(layout=Array.regular(3, 3, 320.0)))
    black = replace(open_edge, layout=Array.regular(3, 3, 320.0, wall=Mirror(0.0)))
    one, other = (MonteCarlo(of, 1).run_to(1024) for of in (open_edge, black))
    np.testing.assert_array_equal(one.bins, other.bins)
    np.testing.assert_array_equal(one.ledger, other.ledger)


@pytest.mark.parametrize("reflectance", [0.0, 0.5, 0.9])
def test_a_plate_between_walls_gets_back_r_of_its_light_at_each(reflectance: float) -> None:
    """Even light from below, by sums over mirror images: r^n of what is spread over n walls."""
    r, a, sd, half = reflectance, 0.6, 200.0, 250.0
    one = replace(Array.regular(1, 1, 500.0, half, Mirror(r)), offset_um=np.full((1, 1, 2), 1e-3))  # not folded
    of = under(ReceiverVolumeScatter(scatter_share=a, spread_um=sd), black(layout=one))
    place = np.random.default_rng(1).uniform(-half, half, (200_000, 2))
    tally = launched(of, np.column_stack([place, np.full(len(place), 36.0)]), UP)
    found = within_edges(tally, of)[0]
    x = (np.arange(found.shape[1]) + 0.5) / found.shape[1] * 2.0 * half - half
    n = np.arange(-6, 7)[:, None]
    along = np.sum(r ** np.abs(n) * (ndtr(((2 * n + 1) * half - x) / sd) - ndtr(((2 * n - 1) * half - x) / sd)), 0)
    expected = len(place) / found.size * (1.0 - a + a * np.outer(along, along))
    assert found.sum() == pytest.approx(expected.sum(), rel=2e-3)
    assert np.sum((found - expected) ** 2 / expected) / found.size == pytest.approx(1.0, abs=0.25)


def test_the_map_goes_on_smoothly_beyond_walls_of_any_reflectance() -> None:
    """A Lambertian point and its images, each r as bright as the last: the same sum beside a wall and beyond it."""
    r, half, at, height, rays = 0.4, 250.0, 100.0, 180.0 - 36.0, 400_000
    one = replace(Array.regular(1, 1, 500.0, half, Mirror(r)), offset_um=np.full((1, 1, 2), 1e-3))  # not folded
    tally = launched(black(layout=one), np.tile([at, 0.0, 36.0], (rays, 1)), lambert_up(rays))
    bins, (x0, x1, y0, y1) = tally.cell_bins()[0], tally.box.ends_um
    x, y = (a + (np.arange(n) + 0.5) * (b - a) / n for a, b, n in ((x0, x1, bins.shape[1]), (y0, y1, bins.shape[0])))
    expected = np.zeros_like(bins)
    for i, j in itertools.product((-1, 0, 1), repeat=2):
        square = (x - 2 * i * half - (-1) ** i * at) ** 2 + (y - 2 * j * half)[:, None] ** 2
        expected += r ** (abs(i) + abs(j)) * height**2 / (np.pi * (square + height**2) ** 2)
    expected *= tally.box.step_um**2 * rays
    for beside in ((x > 150.0) & (x < half), (x > half) & (x < 350.0)):
        both = np.ix_(np.abs(y) < 100.0, beside)
        assert bins[both].sum() / expected[both].sum() == pytest.approx(1.0, abs=0.015)
