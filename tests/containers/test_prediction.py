"""Anchored predictions, their noise, and the columns of their Jacobian."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.bsdf import GaussianLobe
from containers.lens import Lens, Uneven, unevenly_blurred
from containers.ray_tracing.exits import Exits, chip_key, make_exits
from containers.ray_tracing.field import ModuleField
from containers.ray_tracing.kernel import WEIGHT_OF_EXIT
from containers.ray_tracing.light_map import LightMap
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.twin.columns import COLUMNS, film_column
from containers.ray_tracing.twin.difference import Difference, Plate, without_noise
from containers.ray_tracing.twin.module import ModuleTwin
from containers.ray_tracing.twin.prediction import Anchor, Shot, image_of, jacobian, light_map, twin_images
from containers.ray_tracing.twin.reweighting import reweighted
from containers.ray_tracing.twin.supply import EFFECTIVE, Supply
from containers.scene import Array, Face, Scene
from luxloop.camera import Camera
from luxloop.errors import InputError
from tests.ray_scenes import N, bare, scene, taking

SIGMA = np.radians(5.0)


@pytest.fixture(scope="module")
def dim() -> tuple[Scene, Exits]:
    """A chip that absorbs, with notes, so that walks are short."""
    case = scene({"absorption_per_um": 2e-2})
    return case, make_exits(case, 1, 4 * BLOCK, notes=True)


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
    found = anchor.predict(of, supply)
    other = Anchor(of, fields, supply, blocks=2, shadow_rays=1024).predict(of, supply)
    np.testing.assert_allclose(found.images_per_mm2, other.images_per_mm2, rtol=1e-9)
    assert found.noise_per_mm2.shape[1:] == (2, 16, 16)
    assert np.all(found.error_per_mm2 > 0.0)
    assert np.all(found.error_per_mm2 < 0.2 * found.images_per_mm2.max())


def test_an_anchor_without_monte_carlo_lends_its_exits_alone(dim: tuple[Scene, Exits]) -> None:
    """There the prediction is the twin, without noise; beside it the exits of the anchor's chip are reweighted."""
    case, exits = dim
    walks: list[Scene] = []
    supply = Supply(lambda s: (walks.append(s), exits)[1])
    of, options = shots(case), {"blocks": 1, "shadow_rays": 1024}
    anchor = Anchor(of, None, supply, **options)
    found = anchor.predict(of, supply)
    np.testing.assert_array_equal(found.images_per_mm2, twin_images(of, supply, **options))
    assert len(found.noise_per_mm2) == 0
    column = COLUMNS["absorption_per_um"]
    anchor.predict([replace(shot, scene=column.move(shot.scene, 1e-4)) for shot in of], supply)
    assert len(walks) == 1


def test_the_error_at_the_anchor_is_carried_as_a_share_of_the_light(dim: tuple[Scene, Exits]) -> None:
    """Of chips that absorb more both images are dimmer, and so is what Monte Carlo and the twin differ by."""
    case, exits = dim
    supply, options = Supply(lambda _: exits), {"blocks": 1, "shadow_rays": 1024}
    of = shots(case)
    fields = [ModuleTwin(shot.scene, exits, groups=8, seed=7).field() for shot in of]
    anchor = Anchor(of, fields, supply, **options)
    here = anchor.predict(of, supply)
    column = COLUMNS["absorption_per_um"]
    there = anchor.predict([replace(shot, scene=column.move(shot.scene, 2e-3)) for shot in of], supply)
    light = [one.twin_per_mm2.sum(axis=(1, 2)) for one in (here, there)]
    share = (light[1] / light[0])[:, None, None]
    assert np.all(share < 0.98)
    errors = [one.images_per_mm2 - one.twin_per_mm2 for one in (here, there)]
    np.testing.assert_allclose(errors[1], share * errors[0], atol=1e-12 * here.images_per_mm2.max())
    np.testing.assert_allclose(there.noise_per_mm2, share * here.noise_per_mm2)


@pytest.mark.parametrize(
    "lens",
    [
        {"psf_um": 25.0}, {"psf": "moffat2.5", "psf_um": 20.0}, {"magnification_error": 0.02}, {"distortion": -0.03},
        {"vignetting": 0.2}, {"shift_px": (0.4, -0.3)}, {"glare": 0.1, "glare_um": 300.0},
        {"uneven_psf": (("round", 50.0, 0.0), ("tilted", 30.0, 20.0))},
    ],
    ids=lambda lens: next(iter(lens)),
)  # fmt: skip
def test_a_lens_acts_on_all_of_the_light_and_not_on_the_twins_alone(
    dim: tuple[Scene, Exits], lens: dict[str, object]
) -> None:
    """What Monte Carlo has over the twin is blurred, stretched and darkened too: an anchor before another lens, or
    another place of the camera, says the same."""
    case, exits = dim
    supply, options = Supply(lambda _: exits), {"blocks": 1, "shadow_rays": 1024}
    of = shots(case)
    fields = [ModuleTwin(shot.scene, exits, groups=8, seed=7).field() for shot in of]
    moved = [replace(shot, camera=Lens(**shot.camera.model_dump() | lens)) for shot in of]
    here = Anchor(of, fields, supply, **options).predict(moved, supply)
    there = Anchor(moved, fields, supply, **options).predict(moved, supply)
    most = there.images_per_mm2.max()
    assert np.abs(there.images_per_mm2 - there.twin_per_mm2).max() > 1e-3 * most
    np.testing.assert_allclose(here.images_per_mm2, there.images_per_mm2, atol=1e-9 * most)
    seen = [image_of(field.grid, shot).mean(axis=0) for field, shot in zip(fields, moved, strict=True)]
    np.testing.assert_allclose(here.images_per_mm2, seen, atol=1e-9 * most)  # Monte Carlo itself, before that lens


@pytest.mark.parametrize("psf_um", [0.0, 15.0])
def test_a_map_reaches_as_far_as_rays_begin(dim: tuple[Scene, Exits], psf_um: float) -> None:
    """A small image in the middle of nine chips, seen of a map as large as it needs and of the whole module's."""
    case, exits = dim
    scene = replace(case, layout=Array.regular(3, 3, 500.0))
    field, small = ModuleTwin(scene, exits, groups=8, seed=7).field(), Camera(rows=8, columns=8, pixel_um=20.0)
    for law in get_args(Uneven):
        camera = unevenly_blurred(small.model_copy(update={"psf_um": psf_um}), law, 80.0, 30.0)
        shot = Shot(scene, camera)
        near, whole = light_map(field.grid, shot), light_map(field.grid, shot, whole=True)
        assert near.irradiance_per_mm2.size < 0.7 * whole.irradiance_per_mm2.size
        np.testing.assert_allclose(shot.image(near), shot.image(whole), rtol=1e-9)


def test_a_plate_scatters_all_of_the_light_and_not_the_twins_alone(dim: tuple[Scene, Exits]) -> None:
    """What Monte Carlo has over the twin is displaced, too: an anchor behind a clear plate says nearly the same."""
    case, exits = dim
    supply, options = Supply(lambda _: exits), {"blocks": 1, "shadow_rays": 1024}
    of = shots(case)
    plate = replace(case.receiver, spread_share=0.5, spread_um=90.0)
    hazy = [replace(shot, scene=replace(shot.scene, receiver=plate)) for shot in of]
    seen = []
    for about in (of, hazy):
        fields = [ModuleTwin(shot.scene, exits, groups=8, seed=7).field() for shot in about]
        seen.append(Anchor(about, fields, supply, **options).predict(hazy, supply))
    clear, same = seen
    missing = same.images_per_mm2 - same.twin_per_mm2
    assert np.abs(missing).max() > 1e-3 * same.images_per_mm2.max()
    differ = clear.images_per_mm2 - same.images_per_mm2
    assert np.linalg.norm(differ) < 0.03 * np.linalg.norm(missing)


def test_what_the_twin_misses_stays_at_its_chip_where_the_receiver_is_further_away() -> None:
    """Maps of other samples: in the same places, and smooth between them."""

    def missing_at(step_um: float, count: int) -> NDArray[np.float64]:
        at = (np.arange(count) + 0.5 - count / 2.0) * step_um
        along = np.exp(-0.5 * ((at - 1000.0) / 80.0) ** 2)
        return np.outer(np.exp(-0.5 * (at / 80.0) ** 2), along)

    clear = Plate(0.0, 0.0, (1500.0, 1500.0))
    known = Difference(missing_at(25.0, 120), np.ones((120, 120)), 25.0, clear)
    light = LightMap(np.ones((100, 100)), (-1361.25, -1361.25), 27.5)
    found, twin = known.laid(light, clear)
    np.testing.assert_allclose(found, missing_at(27.5, 100), atol=0.01)
    np.testing.assert_allclose(twin.irradiance_per_mm2, 1.0, rtol=1e-12)
    same = LightMap(np.ones((90, 90)), (-1112.5, -1112.5), 25.0)
    found, _ = known.laid(same, clear)
    np.testing.assert_allclose(found, missing_at(25.0, 120)[15:-15, 15:-15], atol=1e-12)


def test_a_plate_brings_what_is_missing_from_outside_of_the_view() -> None:
    """Scattered over the whole module and then cut out; however coarse the samples, nothing is lost inside."""
    whole = np.random.default_rng(1).standard_normal((120, 120))
    hazy = Plate(0.3, 300.0, (1e9, 1e9))
    light = LightMap(np.ones((40, 40)), (-487.5, -487.5), 25.0)
    known = Difference(whole, 2.0 + whole, 25.0, Plate(0.0, 0.0, hazy.half_um))
    found, twin = known.laid(light, hazy)
    np.testing.assert_allclose(found, (whole + hazy.more(whole, 25.0))[40:-40, 40:-40], atol=1e-12)
    behind = 2.0 + whole + hazy.more(2.0 + whole, 25.0)
    np.testing.assert_allclose(twin.irradiance_per_mm2, behind[40:-40, 40:-40], atol=1e-12)
    for step_um in (10.0, 100.0, 200.0):
        even = Plate(0.5, 50.0, (1e9, 1e9)).more(np.ones((200, 200)), step_um)
        assert np.abs(even[90:110, 90:110]).max() < 1e-9


def test_the_noise_of_a_run_is_told_alike_whichever_camera_comes_first(dim: tuple[Scene, Exits]) -> None:
    """One run seen by a near and a wide camera: what the near one tells apart says nothing of the wide one."""
    case, exits = dim
    scene = replace(case, layout=Array.regular(3, 3, 500.0))
    near, wide = (Shot(scene, Camera(rows=16, columns=16, pixel_um=um)) for um in (20.0, 60.0))
    field, supply = ModuleTwin(scene, exits, groups=8, seed=7).field(), Supply(lambda _: exits)
    options = {"blocks": 1, "shadow_rays": 0}
    one, other = (
        Anchor(of, [field] * 2, supply, **options).predict(of, supply) for of in ([near, wide], [wide, near])
    )
    np.testing.assert_allclose(one.error_per_mm2, other.error_per_mm2[::-1], rtol=1e-4)
    assert one.error_per_mm2[1].max() < 0.5 * one.images_per_mm2[1].max()


def test_chips_of_less_power_have_their_images_by_as_much_less(dim: tuple[Scene, Exits]) -> None:
    """Light is linear in power: the anchor's Monte Carlo and its noise are dimmed as the twin is."""
    case, exits = dim
    supply, options = Supply(lambda _: exits), {"blocks": 1, "shadow_rays": 1024}
    of = shots(case)
    fields = [ModuleTwin(shot.scene, exits, groups=8, seed=7).field() for shot in of]
    anchor = Anchor(of, fields, supply, **options)
    dimmed = []
    for shot in of:
        layout = shot.scene.layout
        assert isinstance(layout, Array)
        dimmed.append(replace(shot, scene=replace(shot.scene, layout=replace(layout, power=0.7 * layout.power))))
    here, there = anchor.predict(of, supply), anchor.predict(dimmed, supply)
    assert np.abs(here.images_per_mm2 - here.twin_per_mm2).max() > 1e-3 * here.twin_per_mm2.max()
    np.testing.assert_allclose(there.images_per_mm2, 0.7 * here.images_per_mm2, rtol=1e-6)
    np.testing.assert_allclose(there.noise_per_mm2, 0.7 * here.noise_per_mm2, rtol=1e-6)


def test_no_wall_stands_between_the_anchor_and_a_chip_that_absorbs_more(dim: tuple[Scene, Exits]) -> None:
    """Walked anew from where a tenth of the others' effect is lost, images jumped by another walk's noise."""
    case, exits = dim
    walks: list[Scene] = []
    supply = Supply(lambda s: (walks.append(s), exits)[1])
    shares = []
    for more in (0.005, 0.01, 0.2):
        there = COLUMNS["absorption_per_um"].move(case, more)
        shares.append(reweighted(exits, case, there).effective_share)
        supply.of(there, case)
    assert [one > EFFECTIVE for one in shares] == [True, True, False]
    assert shares[1] < 0.9
    assert len(walks) == 2  # the anchor's, and one of the chip that is too far


def test_a_chip_with_another_emission_has_one_walk_at_any_absorption(dim: tuple[Scene, Exits]) -> None:
    """Its exits are those of the anchor's chip with that emission, reweighted: they do not jump as it absorbs."""
    case, _ = dim
    walks: list[Scene] = []
    supply = Supply(lambda s: (walks.append(s), make_exits(s, 1, BLOCK, notes=True))[1])
    upwards = replace(case.emission, cosine=np.array([-1.0, 1.0]), intensity=np.array([0.9, 1.1]))

    def moved(by_per_um: float, reflectance: float) -> Scene:
        chip = replace(case.chip, absorption_per_um=case.chip.absorption_per_um + by_per_um)
        return replace(case, chip=chip, emission=upwards, substrate=replace(case.substrate, reflectance=reflectance))  # type: ignore[type-var]  # of its kind

    before = supply.of(case)
    exits = [supply.of(moved(by, 0.9), case) for by in (0.0, 1e-6, 1e-3)]
    assert [chip_key(one) for one in walks] == [chip_key(case), chip_key(replace(case, emission=upwards))]
    for one in exits:
        np.testing.assert_array_equal(one.rays, exits[0].rays)
    assert not np.array_equal(before.rays, exits[0].rays)
    own = make_exits(moved(1e-3, 0.9), 2, 8 * BLOCK, notes=True)
    assert leaving(exits[2]) == pytest.approx(leaving(own), rel=0.01)


def test_chips_that_shine_in_other_colours_do_not_share_their_exits(dim: tuple[Scene, Exits]) -> None:
    """The same chip, substrate and emission, and other weights of the line: another walk."""
    _, exits = dim
    face = Face(bare().inside * 2, bare().outside * 2)
    colours = {"index": np.array([N, N]), "top": face, "sides": face}
    two = scene(colours, wavelength_weight=np.array([0.5, 0.5]))
    walks: list[Scene] = []
    supply = Supply(lambda s: (walks.append(s), exits)[1])
    for one in (two, replace(two, wavelength_weight=np.array([0.1, 0.9])), two):
        supply.of(one)
    assert len(walks) == 2


def leaving(exits: Exits) -> float:
    """Of the light that is born, by the exits' weights."""
    weights = exits.rays[:, WEIGHT_OF_EXIT].astype(float) * (1.0 if exits.weights is None else exits.weights)
    return float(weights.sum()) / (exits.histories * len(exits.ledger))


def test_jacobian_columns_predict_small_changes(dim: tuple[Scene, Exits]) -> None:
    """Where no walk moves: the image at half a step is the image plus half the column; distances with more noise."""
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
        moved = twin_images(
            [Shot(column.move(shot.scene, h), shot.camera, base=shot.scene) for shot in of], supply, **options
        )
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


@pytest.mark.parametrize(
    ("name", "rise", "signs"),
    [
        ("absorption_to_top_per_um", 0.02, [1, -1]), ("absorption_to_bottom_per_um", -0.02, [1, -1]),
        ("absorption_per_um", 0.02, [0, 1, 1]), ("absorption_to_bottom_per_um", 0.02, [0, 1, 1]),
        ("absorption_to_top_per_um", 0.0, [1, -1]),
    ],
)  # fmt: skip
def test_no_step_makes_an_end_of_the_chip_amplify(name: str, rise: float, signs: list[int]) -> None:
    """Where a chip absorbs nothing at one end, mean and rise move together to both sides, and alone to one."""
    case = scene({"absorption_per_um": 0.02, "absorption_rise_per_um": rise})
    amounts = [amount for amount, _ in COLUMNS[name].stencil(case)]
    assert [np.sign(amount) for amount in amounts] == signs


@pytest.mark.parametrize(
    ("name", "side", "changes"),
    [
        ("width_um", -1.0, {"width_um": 495.0}),
        ("spacing_um", 1.0, {"width_um": 496.0}),
        ("thickness_um", -1.0, {"thickness_um": 148.0}),
        ("distance_um", 1.0, {"thickness_um": 149.0}),
    ],
)
def test_where_chips_nearly_touch_steps_go_away_from_it(name: str, side: float, changes: dict[str, float]) -> None:
    """One-sided where the scene cannot be moved to the other side: no error names a width that nobody gave."""
    case = scene(changes, layout=Array.regular(3, 3, 500.0), distance_um=150.0)
    amounts = [amount for amount, _ in COLUMNS[name].stencil(case)]
    assert [np.sign(amount) for amount in amounts] == [0.0, side, side]
    assert all(COLUMNS[name].move(case, amount) for amount in amounts)


def test_no_room_for_a_step_is_said(dim: tuple[Scene, Exits]) -> None:
    """By the column's own name."""
    tight = replace(COLUMNS["width_um"], low=dim[0].chip.width_um, high=dim[0].chip.width_um)
    with pytest.raises(InputError, match=r"width_um: .*room for two steps"):
        tight.stencil(dim[0])


def test_what_may_be_noise_is_taken_out_of_what_the_twin_misses() -> None:
    """A hill stays, to some percent of the noise beside it; of noise alone hardly anything is left."""
    random, step_um = np.random.default_rng(5), 5.0
    x, y = ((np.arange(count) + 0.5 - count / 2.0) * step_um for count in (80, 60))
    hill = 5.0 * np.exp(-0.5 * (np.add.outer(((y + 25.0) / 45.0) ** 2, ((x - 50.0) / 60.0) ** 2)))
    bins = 1.0 + random.standard_normal((32, 120, 160))
    box_um = -200.0, 200.0, -150.0, 150.0
    field = ModuleField.from_bins(bins, 4e-4, box_um, height_um=8.0 * step_um)
    noise = field.grid(x, y).mean(axis=0) - field.mean
    still = replace(field, coefficients=np.repeat(field.coefficients[:1], 32, axis=0))
    assert np.std(noise) > 0.1
    assert np.std(without_noise(hill + noise, step_um, field) - hill) < 0.25 * np.std(noise)
    assert np.std(without_noise(noise, step_um, field)) < 0.25 * np.std(noise)
    twice = without_noise(2.0 * noise, step_um, field)  # a quarter of its power is noise: 3/4 of it stay
    assert np.std(twice) == pytest.approx(0.75 * 2.0 * np.std(noise), rel=0.1)
    np.testing.assert_allclose(without_noise(hill, step_um, still), hill, atol=1e-12)
