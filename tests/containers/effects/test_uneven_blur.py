"""Blur that changes over the image: closed forms of waves and spots, and another program's displaced samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from containers.acting import Effects
from containers.effect import DetectorEffect
from containers.effects.camera_psf import CameraPsf
from containers.effects.focus_tilt import FocusTilt
from containers.effects.off_axis_blur import OffAxisBlur
from containers.lens import Lens, unevenly_blurred
from containers.ray_tracing import aberrations
from containers.ray_tracing.aberrations import rays_of, rays_reach_um
from containers.ray_tracing.camera import irradiance_image, receiver_points
from containers.ray_tracing.light_map import LightMap, pixel_means, spline_of, square_means
from luxloop.camera import Camera
from luxloop.errors import InputError
from luxloop.words import parse
from tests.light_spots import SPOT_UM, gaussian, map_of, spot
from validation.blind.maps import Grid
from validation.blind.optics import image_of
from validation.blind.words import Camera as BlindCamera
from validation.blind.words import Hidden, Pose

Real = NDArray[np.float64]
CAMERA = Camera(rows=50, columns=60, pixel_um=16.0, rotation_deg=20.0, shift_px=(1.3, -2.1))
ROUND, RADIAL, TANGENTIAL = (OffAxisBlur(corner_um=70.0, shape=shape) for shape in ("round", "radial", "tangential"))
TILTED = FocusTilt(edge_um=70.0, direction_deg=35.0)


def camera(*effects: DetectorEffect, before: Camera = CAMERA) -> Camera:
    """The camera under effects, as a worker applies them."""
    return Effects(effects).camera(before)


def place(before: Camera = CAMERA) -> tuple[Real, Real]:
    """x, y (row, column) in the image, 1 as far from its centre as its corner is: (30, 25) px."""
    y, x = np.mgrid[: before.rows, : before.columns].astype(float)
    corner = np.hypot(before.rows, before.columns) / 2.0
    return (x - (before.columns - 1) / 2.0) / corner, (y - (before.rows - 1) / 2.0) / corner


def sd_along(effect: DetectorEffect, x: Real, y: Real, angle: Real | float) -> Real:
    """The law as written: standard deviation in um at x, y along a direction in the image."""
    r = np.hypot(x, y)
    if isinstance(effect, FocusTilt):
        return np.asarray(70.0 * np.abs(r * np.cos(np.arctan2(y, x) - np.radians(effect.direction_deg))))
    assert isinstance(effect, OffAxisBlur)
    from_radius = np.arctan2(y, x) - angle
    part = {"round": np.ones_like(r), "radial": np.cos(from_radius), "tangential": np.sin(from_radius)}
    return np.asarray(70.0 * r**2 * np.abs(part[effect.shape]))


@pytest.mark.parametrize(
    "effect", [ROUND, RADIAL, TANGENTIAL, TILTED], ids=["round", "radial", "tangential", "tilted"]
)
@pytest.mark.parametrize("direction_deg", [0.0, 70.0, 125.0])
def test_of_a_wave_is_left_what_a_gaussian_leaves(effect: DetectorEffect, direction_deg: float) -> None:
    """cos(k.x) becomes exp(-(k sd)^2 / 2) cos(k.x), sd along k in a turned image; 0.2 mm long, up to k sd of 2.2."""
    angle = np.radians(direction_deg)
    kx, ky = 2.0 * np.pi / 200.0 * np.cos(angle), 2.0 * np.pi / 200.0 * np.sin(angle)
    light = map_of(lambda x, y: 1.0 + np.cos(kx * x + ky * y + 0.4), half_um=1400.0)
    sharp, seen = (irradiance_image(light, one) - 1.0 for one in (CAMERA, camera(effect)))
    in_image = angle + np.radians(CAMERA.rotation_deg)  # the image's axes are turned back against the receiver's
    left = np.exp(-0.5 * (2.0 * np.pi / 200.0 * sd_along(effect, *place(), in_image)) ** 2)
    assert left.max() > 0.999
    assert left.min() < 0.5
    np.testing.assert_allclose(seen, left * sharp, atol=2e-4)


@pytest.mark.parametrize(
    "effect", [ROUND, RADIAL, TANGENTIAL, TILTED], ids=["round", "radial", "tangential", "tilted"]
)
@pytest.mark.parametrize(("period_um", "step_um"), [(90.0, 10.0), (60.0, 6.4), (30.0, 3.2)])
def test_rays_miss_no_wave_of_fine_light(effect: DetectorEffect, period_um: float, step_um: float) -> None:
    """Waves of 5 to 15 per standard deviation are gone where it is largest; a wide lattice would show them again."""
    k = 2.0 * np.pi / period_um
    light = map_of(lambda x, y: 1.0 + np.cos(k * x + 0.3) + 0.0 * y, step_um, half_um=1000.0)
    fine = Camera(rows=40, columns=40, pixel_um=8.0)
    sharp, seen = (irradiance_image(light, one) - 1.0 for one in (fine, camera(effect, before=fine)))
    left = np.exp(-0.5 * (k * sd_along(effect, *place(fine), 0.0)) ** 2)
    assert left.min() < 0.01
    np.testing.assert_allclose(seen, left * sharp, atol=2e-3)


@pytest.mark.parametrize("effect", [ROUND, TILTED], ids=["round", "tilted"])
def test_a_spot_becomes_the_gaussian_of_both_variances(effect: DetectorEffect) -> None:
    """Closed form with small pixels: a spot of sd s, seen where the blur has sd w, is a Gaussian of s^2 + w^2."""
    small = CAMERA.model_copy(update={"rows": 100, "columns": 120, "pixel_um": 8.0})
    seen = irradiance_image(spot(sd_um=45.0), camera(effect, before=small))
    x, y, _ = receiver_points(small, np.arange(100.0), np.arange(120.0))
    square = 45.0**2 + 8.0**2 / 12.0 + sd_along(effect, *place(small), 0.0) ** 2
    r2 = (x - SPOT_UM[0]) ** 2 + (y - SPOT_UM[1]) ** 2
    expected = 1e6 * np.exp(-r2 / (2.0 * square)) / (2.0 * np.pi * square)
    np.testing.assert_allclose(seen, expected, atol=3e-4 * expected.max())


def test_both_kinds_of_astigmatism_are_a_curved_field() -> None:
    """Along the radius and across it as much: round; by the rule on a line, one after the other, or in the plane."""
    both = unevenly_blurred(camera(RADIAL), "tangential", 70.0)
    in_plane, round_ = irradiance_image(spot(), both), irradiance_image(spot(), camera(ROUND))
    np.testing.assert_allclose(in_plane, round_, atol=1e-12 * round_.max())
    for law in ("radial", "tangential"):
        alone = camera(OffAxisBlur(corner_um=70.0, shape=law))
        beside = unevenly_blurred(alone, "tilted", 1e-6, 90.0)  # takes the plane's rule
        line, plane = (irradiance_image(spot(), one) for one in (alone, beside))
        np.testing.assert_allclose(line, plane, atol=3e-4 * plane.max())


def test_variances_of_several_blurs_add_up() -> None:
    """Squares, as of causes that know nothing of each other; beside an even blur scipy's convolution."""
    whole = camera(FocusTilt(edge_um=50.0, direction_deg=40.0))
    parts = camera(
        FocusTilt(edge_um=30.0, direction_deg=40.0),
        before=camera(FocusTilt(edge_um=40.0, direction_deg=-140.0)),
    )
    first, second = (irradiance_image(spot(), one) for one in (whole, parts))
    np.testing.assert_allclose(second, first, rtol=1e-9, atol=1e-12 * first.max())
    wide = Camera(rows=100, columns=100, pixel_um=16.0)
    even = CameraPsf(psf_um=30.0, profile="gaussian")
    uneven, both = (irradiance_image(spot(), camera(*one, before=wide)) for one in ((ROUND,), (ROUND, even)))
    other = gaussian_filter(uneven, 30.0 / 16.0, truncate=8.0)
    np.testing.assert_allclose(both, other, atol=2e-3 * other.max())


def test_an_even_receiver_stays_even_and_the_centre_sharp() -> None:
    """Whatever the blur does, weights sum to 1; on the axis nothing is spread."""
    flat = map_of(lambda x, y: 1.0 + 0.0 * x * y, half_um=1400.0)
    for effect in (ROUND, RADIAL, TANGENTIAL, TILTED):
        np.testing.assert_allclose(irradiance_image(flat, camera(effect)), 1.0, rtol=1e-12)
        odd = Camera(rows=41, columns=41, pixel_um=16.0)
        light = spot()
        middle = [irradiance_image(light, one)[20, 20] for one in (odd, camera(effect, before=odd))]
        assert middle[1] == pytest.approx(middle[0], rel=1e-9)


def test_blur_keeps_the_symmetry_of_an_image() -> None:
    """Turned light before a lens that is alike all around is seen turned; a tilt turns with its direction."""
    square = Camera(rows=50, columns=50, pixel_um=16.0)
    light = spot()
    turned = LightMap(np.rot90(light.irradiance_per_mm2), light.origin_um, light.step_um)
    pairs = [(one, one) for one in (ROUND, RADIAL, TANGENTIAL)]
    # rows go upwards: rot90 of an array takes y to x and x to -y, 90 deg back
    for before, after in [*pairs, (TILTED, FocusTilt(edge_um=70.0, direction_deg=35.0 - 90.0))]:
        seen, other = (
            irradiance_image(of, camera(one, before=square)) for of, one in ((light, before), (turned, after))
        )
        np.testing.assert_allclose(np.rot90(seen), other, atol=1e-6 * seen.max())  # of a hexagonal lattice


def test_maps_that_end_and_many_at_once_are_seen_as_one() -> None:
    """A dark map as one that goes on without light; each of a stack of six as alone; bent and off the centre, too."""
    half = 320.0
    ends = map_of(gaussian, half_um=half, beyond="dark")
    padded = np.pad(ends.irradiance_per_mm2, 80)
    goes_on = LightMap(padded, (ends.origin_um[0] - 80 * 6.4, ends.origin_um[1] - 80 * 6.4), 6.4, "dark")
    bent = CAMERA.model_copy(
        update={
            "rows": 30,
            "columns": 34,
            "pixel_um": 12.0,
            "distortion": -0.03,
            "centre_px": (11.0, 16.0),
            "magnification_error": 0.1,
        }
    )
    six = np.arange(6.0).reshape(2, 3, 1, 1)
    stack = LightMap(six * ends.irradiance_per_mm2, ends.origin_um, 6.4, "dark")
    for effect in (ROUND, RADIAL, TILTED):
        one = camera(effect, before=bent)
        seen = irradiance_image(ends, one)
        np.testing.assert_allclose(seen, irradiance_image(goes_on, one), atol=1e-4 * seen.max())
        np.testing.assert_allclose(irradiance_image(stack, one), six * seen, atol=1e-9 * seen.max())


@pytest.mark.parametrize("beyond", ["mirror", "dark"])
def test_means_over_squares_are_those_over_pixels(beyond: Any) -> None:
    """Of squares from half a step to thirty: what pixels as large, at the samples, show of the map."""
    random = np.random.default_rng(5).random((40, 44))
    for side in (5.0, 16.0, 33.0, 300.0):
        light = LightMap(random, (-210.0, -190.0), 10.0, beyond)
        means = square_means(light, side)
        x, y = (start + 10.0 * np.arange(n) for start, n in zip((-210.0, -190.0), (44, 40), strict=True))
        expected = pixel_means(light, spline_of(light), *np.meshgrid(x, y), np.full((40, 44), side))
        before = round((light.origin_um[0] - means.origin_um[0]) / 10.0)
        assert (before == 0) == (beyond == "mirror")
        inner = means.irradiance_per_mm2[before : before + 40, before : before + 44]
        np.testing.assert_allclose(inner, expected, atol=1e-12)


def test_what_would_take_too_long_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """By pixels, rays and maps, before a ray is read."""
    monkeypatch.setattr(aberrations, "MOST_READ", 1 << 20)
    with pytest.raises(InputError, match=r"rows x columns: got '3000 pixels of 451 rays', allowed: 1048576 rays"):
        irradiance_image(spot(), camera(ROUND))
    with pytest.raises(InputError, match="uneven_psf"):
        parse(Lens, unevenly_blurred(CAMERA, "round", 1e6).model_dump(), "camera")


def test_the_slope_at_off_is_of_the_square() -> None:
    """What 2 um blur is 4 times what 1 um does; nothing jumps next to off."""
    for one in (OffAxisBlur, FocusTilt):
        values: dict[str, Any] = {"shape": "round"} if one is OffAxisBlur else {"direction_deg": 45.0}
        name = "corner_um" if one is OffAxisBlur else "edge_um"
        sharp, *blurred = (
            irradiance_image(spot(), camera(one(**values | {name: um}))) for um in (0.0, 1e-6, 1.0, 2.0)
        )
        np.testing.assert_allclose(blurred[0], sharp, atol=1e-12 * sharp.max())
        by_one, by_two = blurred[1] - sharp, blurred[2] - sharp
        np.testing.assert_allclose(by_two, 4.0 * by_one, atol=2e-3 * np.abs(by_two).max())


def test_no_ray_begins_beyond_the_reach_that_is_told() -> None:
    """The farthest of all pixels, also beyond the image; without such a blur there is none."""
    row, column = np.arange(-10.0, 60.0), np.arange(-10.0, 70.0)
    for one in (camera(ROUND), camera(RADIAL), camera(TILTED), camera(ROUND, TILTED)):
        rays = rays_of(one, row, column)
        displaced = (u * rays.by_u_um + v * rays.by_v_um for _, u, v in rays.rule.T)
        farthest = max(float(np.hypot(dx, dy).max()) for dx, dy in displaced)
        assert 0.9 * rays_reach_um(one, row, column) < farthest < rays_reach_um(one, row, column)
        assert rays_reach_um(one, row, column) < 4.6 * 70.0 * np.sqrt(2.0)  # beyond the corner it grows no more
    assert rays_reach_um(CAMERA, row, column) == 0.0


@pytest.mark.parametrize(
    ("kind", "least", "size"),
    [
        ("tilted_lens", 0.999, (0.95, 0.98)),
        ("astigmatism", 0.999, (0.97, 1.0)),
        ("field_curvature", 0.99, (1.2, 1.5)),
    ],
)
def test_it_does_what_another_program_s_displaced_samples_do(
    kind: str, least: float, size: tuple[float, float]
) -> None:
    """The blind test's, by what they change in an image of two spots: discs, even lines, a quintic spline.

    Its edge is the last pixel's middle, 2 x 2.4 % of a square less; its curved field rises later than r^2.
    """
    blind, ours = BlindCamera(42, 42, 24.0, 12, 0.38, 6.0, 1e4, 64.0), Camera(rows=42, columns=42, pixel_um=24.0)
    at = (np.arange(256) - 127.5) * 8.0
    values = np.exp(-((at - 330.0) ** 2 + (at[:, None] + 290.0) ** 2) / (2.0 * 90.0**2))
    values += np.exp(-((at + 400.0) ** 2 + (at[:, None] - 100.0) ** 2) / (2.0 * 80.0**2))
    hidden, grid = Hidden(kind, 40.0, 1), Grid(256, 8.0, 160.0)
    sharp, other = (image_of(values, grid, 1000.0, blind, Pose(), there) for there in ({}, {kind: hidden}))
    effect: DetectorEffect = OffAxisBlur(corner_um=40.0, shape="radial" if kind == "astigmatism" else "round")
    if kind == "tilted_lens":
        direction = 2.0 * np.pi * np.random.default_rng((1, 61)).random()
        edge = (np.abs(np.cos(direction)) + np.abs(np.sin(direction))) / np.sqrt(2.0)  # over the corner's distance
        effect = FocusTilt(edge_um=40.0 / edge, direction_deg=(np.degrees(direction) + 90.0) % 180.0 - 90.0)
    light = map_of(lambda x, y: values + 0.0 * x * y, step_um=8.0, half_um=1024.0)
    change = irradiance_image(light, camera(effect, before=ours)) - irradiance_image(light, ours)
    theirs = other - sharp
    assert np.abs(theirs).max() > 0.01
    assert (change * theirs).sum() > least * np.sqrt((change**2).sum() * (theirs**2).sum())
    assert size[0] < (change * theirs).sum() / (theirs**2).sum() < size[1]
