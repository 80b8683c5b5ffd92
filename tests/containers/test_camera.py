"""The camera: what its image must keep, closed forms of a Gaussian spot and independent programs."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.integrate import quad
from scipy.special import erf, ive

from containers.ray_tracing.camera import (
    ambient,
    blurred,
    expected_image,
    irradiance_image,
    nonlinear,
    pixels,
    receiver_points,
    response,
    saturated,
    transmission,
    with_glare,
)
from containers.ray_tracing.light_map import LightMap, pixel_means, spline_of, spread
from luxloop.camera import Camera
from tests.light_spots import (
    RNG,
    SD_UM,
    SPOT_UM,
    Real,
    error,
    gaussian,
    grid,
    image_of_spot,
    map_of,
    spot,
)

# Off values


def test_all_off_is_the_mean_over_pixels_bit_for_bit() -> None:
    """A camera of default values does nothing but average the map over its pixels."""
    light, camera = spot(), Camera()
    along = (np.arange(128) - 63.5) * 8.0
    x, y = np.broadcast_to(along, (128, 128)).copy(), np.broadcast_to(along[:, None], (128, 128)).copy()
    means = pixel_means(light, spline_of(light), x, y, np.full((128, 128), 8.0))
    assert np.array_equal(expected_image(light, camera), means)


def test_geometry_off_is_the_plain_grid_bit_for_bit() -> None:
    """Rotation, shift, magnification and distortion of 0 leave pixel centres where they are."""
    x, y, side = receiver_points(Camera(rows=5, columns=4, pixel_um=3.3), pixels(5), pixels(4))
    assert np.array_equal(x, np.broadcast_to(3.3 * (np.arange(4) - 1.5), (5, 4)))
    assert np.array_equal(y, np.broadcast_to(3.3 * (np.arange(5) - 2.0)[:, None], (5, 4)))
    assert np.array_equal(side, np.full((5, 4), 3.3))


@pytest.mark.parametrize("psf", ["gaussian", "moffat2.5", "moffat3.5", "moffat4.5"])
def test_blur_off_is_the_image_bit_for_bit(psf: str) -> None:
    """A PSF of no width changes nothing."""
    image = RNG.normal(size=(7, 9))
    assert np.array_equal(blurred(image, psf, 0.0), image)


@pytest.mark.parametrize("law", ["quadratic", "cos4"])
def test_vignetting_and_glare_off_are_the_image_bit_for_bit(law: Any) -> None:
    """No light is lost at the corner, none is spread."""
    image, camera = RNG.normal(size=(128, 128)), Camera(vignetting_law=law)
    assert np.array_equal(image * transmission(camera), image)
    assert np.array_equal(with_glare(image, spot(), camera), image)


def test_sensor_off_is_the_signal_bit_for_bit() -> None:
    """No ambient light, a linear sensor without knee, black level 0, also above full scale and below black."""
    signal = RNG.normal(size=(128, 128)) * 5000.0
    assert np.array_equal(nonlinear(signal, 0.0, 4031.0), signal)
    assert np.array_equal(saturated(signal, 1.0, 4031.0), signal)
    assert np.array_equal(response(signal, Camera()), signal)


# What is kept


@pytest.mark.parametrize("psf", ["gaussian", "moffat2.5", "moffat3.5", "moffat4.5"])
def test_a_flat_map_gives_a_flat_image_of_the_same_value(psf: Any) -> None:
    """Whatever moves or blurs light does not change what is the same everywhere."""
    camera = Camera(
        psf=psf, psf_um=20.0, glare=0.3, rotation_deg=7.0, shift_px=(3.3, -1.2), magnification_error=0.02,
        distortion=0.03, rows=100, columns=90,
    )  # fmt: skip
    image = expected_image(map_of(lambda x, _y: 3.7 + 0.0 * x), camera)
    np.testing.assert_allclose(image, 3.7, rtol=1e-12)


@pytest.mark.parametrize(
    "off",
    [
        {"psf_um": 3.0}, {"psf_um": 24.0}, {"psf": "moffat4.5", "psf_um": 5.0}, {"glare": 0.4, "glare_um": 120.0},
        {"rotation_deg": 10.0}, {"shift_px": (4.4, 2.1)}, {"magnification_error": 0.1}, {"magnification_error": -0.1},
    ],
)  # fmt: skip
def test_flux_is_kept_up_to_the_area_factor_of_magnification(off: dict[str, Any]) -> None:
    """A spot well inside of the image has the flux of the map; (1 + e)^2 of it when the image is larger."""
    camera = Camera(rows=200, columns=200, **off)
    flux = expected_image(spot(beyond="dark"), camera).sum() * camera.pixel_um**2 / 1e6
    assert flux == pytest.approx((1.0 + camera.magnification_error) ** 2, rel=3e-6)


def test_wide_spread_keeps_the_flux_of_a_spot() -> None:
    """The coarser grid holds the light of a spot that stays on the map."""
    wide = spread(spot(beyond="dark"), 150.0)
    assert wide.irradiance_per_mm2.sum() * wide.step_um**2 / 1e6 == pytest.approx(1.0, rel=1e-11)


def test_a_shift_by_whole_pixels_moves_the_image_bit_for_bit() -> None:
    """shift_px = (rows, columns): a feature is found that many rows and columns further on."""
    light = spot()
    plain, moved = expected_image(light, Camera()), expected_image(light, Camera(shift_px=(3.0, -5.0)))
    assert np.array_equal(moved[3:, :-5], plain[:-3, 5:])


def test_a_tilt_of_the_map_along_y_rises_with_the_row_and_along_x_with_the_column() -> None:
    """Row 0 is at the lowest y, x goes to the right."""
    along_y = expected_image(map_of(lambda x, y: y + 0.0 * x), Camera())
    along_x = expected_image(map_of(lambda x, y: x + 0.0 * y), Camera())
    assert np.diff(along_y, axis=0).min() > 7.99
    assert np.abs(np.diff(along_y, axis=1)).max() < 1e-9
    np.testing.assert_allclose(along_x, along_y.T, atol=1e-9)


def test_a_quarter_turn_of_the_map_is_a_quarter_turn_of_the_image() -> None:
    """Turned by 45 deg, or the map by 90 deg (x towards y) and the image back by 45: the same image."""
    light = map_of(lambda x, y: gaussian(x, y) + 0.3 * gaussian(x - 200.0, y + 130.0, 80.0))
    turned = LightMap(np.rot90(light.irradiance_per_mm2, -1), light.origin_um, light.step_um)
    there, back = (irradiance_image(m, Camera(rotation_deg=a)) for m, a in ((light, 45.0), (turned, -45.0)))
    assert error(there, back) < 1e-13


def test_the_image_is_linear_in_the_map_and_a_batch_is_a_loop() -> None:
    """Leading axes go through as if each map had been sent alone; sums go through as sums."""
    maps = RNG.random((2, 3, 90, 80))
    camera = Camera(
        rows=40,
        columns=50,
        rotation_deg=3.0,
        psf_um=9.0,
        glare=0.1,
        vignetting=0.2,
        distortion=0.01,
        shift_px=(0.3, 0.1),
    )
    image = irradiance_image(LightMap(maps, (-395.0, -445.0), 10.0), camera)
    alone = [[irradiance_image(LightMap(m, (-395.0, -445.0), 10.0), camera) for m in pair] for pair in maps]
    summed = irradiance_image(LightMap(maps[0, 0] - 2.0 * maps[1, 2], (-395.0, -445.0), 10.0), camera)
    np.testing.assert_allclose(image, np.array(alone), rtol=1e-13)
    np.testing.assert_allclose(summed, image[0, 0] - 2.0 * image[1, 2], rtol=0.0, atol=1e-12)


# Closed forms and independent programs


@pytest.mark.parametrize("pixel_um", [1.7, 8.0, 33.0])
def test_means_over_pixels_of_a_cubic_are_exact(pixel_um: float) -> None:
    """Linear, quadratic and cubic terms in x and y, far from the map's edge, for pixels below and above its step."""
    light = map_of(
        lambda x, y: 2.0 + x / 50 - (y / 90) ** 2 * x / 70 + (x / 80) ** 3 * (y / 60) ** 3 + (y / 100) ** 3
    )
    camera = Camera(rows=12, columns=11, pixel_um=pixel_um)
    lower = (np.arange(12) - 6.0) * pixel_um, (np.arange(11) - 5.5) * pixel_um

    def mean(power: int, start: Real) -> Real:
        return ((start + pixel_um) ** (power + 1) - start ** (power + 1)) / ((power + 1) * pixel_um)

    x, y = ([mean(power, start) for power in range(4)] for start in (lower[1], lower[0][:, None]))
    truth = 2.0 + x[1] / 50 - y[2] / 90**2 * x[1] / 70 + x[3] / 80**3 * y[3] / 60**3 + y[3] / 100**3
    assert error(expected_image(light, camera), truth) < 1e-12


@pytest.mark.parametrize("shape", [(2, 2), (3, 4), (5, 40), (64, 33)])
def test_the_spline_goes_through_its_samples_also_where_it_is_mirrored(shape: tuple[int, int]) -> None:
    """1/6, 2/3, 1/6 of neighbours is the sample, for maps shorter than the filter's memory too."""
    values = RNG.normal(size=shape)
    spline = spline_of(LightMap(values, (0.0, 0.0), 1.0))[0]
    for axis in (0, 1):
        spline = ndimage.correlate1d(spline, [1 / 6, 2 / 3, 1 / 6], axis, mode="reflect")
    np.testing.assert_allclose(spline, values, rtol=0.0, atol=1e-13)


def test_spline_coefficients_are_those_of_another_program() -> None:
    """Half-sample mirror symmetry; shorter maps are left out, where that program is off by 4e-6 of 5 samples."""
    values = RNG.normal(size=(64, 33))
    other = ndimage.spline_filter(values, 3, mode="reflect")
    np.testing.assert_allclose(spline_of(LightMap(values, (0.0, 0.0), 1.0))[0], other, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("beyond", ["mirror", "dark"])
def test_points_anywhere_are_those_of_another_program(beyond: Any) -> None:
    """Tiny squares, inside and beyond the area: mirrored, or the spline's coefficients with zeros around them."""
    light = LightMap(RNG.normal(size=(20, 30)), (0.0, 0.0), 1.0, beyond)
    x, y = RNG.uniform(-12.0, 42.0, (2, 15, 15))
    means = pixel_means(light, spline_of(light), x, y, np.full_like(x, 1e-3))
    padded = spline_of(LightMap(light.irradiance_per_mm2, (0.0, 0.0), 1.0))[0]
    mode = "reflect" if beyond == "mirror" else "grid-constant"
    other = ndimage.map_coordinates(padded, [y, x], order=3, mode=mode, prefilter=False)
    np.testing.assert_allclose(means, other, rtol=0.0, atol=1e-5)


def test_the_error_falls_with_the_fourth_power_of_the_map_s_step() -> None:
    """Against the analytic integral of a Gaussian spot over each pixel."""
    errors = [error(expected_image(spot(step), Camera()), image_of_spot(Camera())) for step in (25.0, 12.5, 6.25)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 2e-6
    assert (orders > 3.7).all()


@pytest.mark.parametrize(
    ("off", "sd_um", "at"),
    [
        ({"shift_px": (2.3, -7.9)}, SD_UM, (SPOT_UM[0] - 7.9 * 8, SPOT_UM[1] + 2.3 * 8)),
        ({"rows": 90, "columns": 110, "centre_px": (40.2, 61.7)}, SD_UM, SPOT_UM),
        ({"psf_um": 2.5}, np.hypot(SD_UM, 2.5), SPOT_UM),
        ({"psf_um": 50.0}, np.hypot(SD_UM, 50.0), SPOT_UM),
        ({"pixel_um": 5.0, "psf_um": 11.0, "shift_px": (-3.0, 0.5)}, np.hypot(SD_UM, 11.0), (37.5, -87.0)),
    ],
)  # fmt: skip
def test_a_spot_is_seen_where_and_as_wide_as_it_must_be(
    off: dict[str, Any], sd_um: float, at: tuple[float, float]
) -> None:
    """Shift, centre and Gaussian PSF against the closed form."""
    camera = Camera(**off)
    assert error(expected_image(spot(), camera), image_of_spot(camera, sd_um, at)) < 2e-6


@pytest.mark.parametrize("angle_deg", [-40.0, 0.3, 45.0])
def test_a_turned_and_magnified_spot_is_the_closed_form(angle_deg: float) -> None:
    """A round spot stays round: it moves, x towards y for positive angles, and grows by 1 + e, its PSF with it."""
    camera = Camera(rotation_deg=angle_deg, magnification_error=0.07, psf_um=10.0)
    a, m = np.radians(angle_deg), 1.07
    at = (
        m * (SPOT_UM[0] * np.cos(a) - SPOT_UM[1] * np.sin(a)),
        m * (SPOT_UM[0] * np.sin(a) + SPOT_UM[1] * np.cos(a)),
    )
    truth = image_of_spot(camera, m * float(np.hypot(SD_UM, 10.0)), at) * m**2
    assert error(expected_image(spot(), camera), truth) < 2e-6


@given(k1=st.floats(-0.05, 0.05), angle=st.floats(0.0, 6.28), r=st.floats(0.0, 1.0))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_distortion_moves_a_point_from_r_to_r_plus_k1_r_cubed(k1: float, angle: float, r: float) -> None:
    """r = 1 at the corner of the corner pixel, about the image's centre and not about the module's."""
    camera = Camera(rows=60, columns=80, centre_px=(20.0, 30.0), distortion=k1, pixel_um=2.0)
    corner, axis = 50.0, np.array([29.5, 39.5])
    direction = np.array([np.sin(angle), np.cos(angle)])
    row, column = axis + corner * (r + k1 * r**3) * direction
    x, y, _ = receiver_points(camera, np.array([row]), np.array([column]))
    straight = axis + corner * r * direction - np.array([20.0, 30.0])
    assert (y.item(), x.item()) == pytest.approx(tuple(2.0 * straight), abs=1e-10)


def test_a_distorted_pixel_covers_the_area_between_its_neighbours() -> None:
    """The square on the receiver is as large as the cell that the mapped pixel borders span."""
    camera = Camera(distortion=0.05, magnification_error=-0.02, rotation_deg=20.0)
    row, column = np.array([9.5, 10.5]), np.array([99.5, 100.5])
    x, y, _ = receiver_points(camera, row, column)
    a, b = np.array([x[1, 1] - x[0, 0], y[1, 1] - y[0, 0]]), np.array([x[1, 0] - x[0, 1], y[1, 0] - y[0, 1]])
    side = receiver_points(camera, np.array([10.0]), np.array([100.0]))[2].item()
    assert side**2 == pytest.approx(abs(a[0] * b[1] - a[1] * b[0]) / 2, rel=1e-5)


def test_a_wave_is_damped_as_a_gaussian_demands_up_to_a_quarter_of_the_highest_frequency() -> None:
    """exp(-sd^2 k^2 / 2) of its amplitude is left, whatever the approximation of k^2 behind it."""
    wave = np.cos(2 * np.pi * np.arange(64) / 8) + np.zeros((16, 1))
    left = blurred(wave, "gaussian", 2.0)[0, 0]
    assert left == pytest.approx(np.exp(-2.0 * (np.pi / 4) ** 2), rel=1e-4)


@pytest.mark.parametrize(("psf", "allowed"), [("gaussian", 1e-10), ("moffat3.5", 1e-4), ("moffat2.5", 1e-3)])
def test_what_a_pixel_sees_does_not_depend_on_where_the_image_ends(psf: Any, allowed: float) -> None:
    """A small image whose border cuts through the spot is a part of a large one."""
    large, small = (Camera(rows=n, columns=n, psf=psf, psf_um=24.0) for n in (160, 20))
    whole, part = irradiance_image(spot(), large), irradiance_image(spot(), small)
    assert error(part, whole[70:90, 70:90]) < allowed


@pytest.mark.parametrize(("psf", "beta"), [("moffat2.5", 2.5), ("moffat3.5", 3.5), ("moffat4.5", 4.5)])
@pytest.mark.parametrize("distance_px", [0, 15, 40])
def test_a_spot_blurred_by_a_moffat_is_the_integral(psf: Any, beta: float, distance_px: int) -> None:
    """Gaussian spot and (1 + r^2 / alpha^2)^-beta convolved by quadrature, alpha^2 = 2 (beta - 2) sd^2."""
    sd, psf_um, d = 30.0, 12.0, distance_px * 4.0
    camera = Camera(rows=129, columns=129, pixel_um=4.0, psf=psf, psf_um=psf_um)
    # the mean over a pixel is that of a spot wider by the square's second moment, to fourth order in 4 um / 30 um
    x, narrow = grid(5.0, 1000.0), float(np.sqrt(sd**2 - 4.0**2 / 12))
    peak = (sd / narrow) ** 2
    light = LightMap(peak * np.exp(-(x**2 + x[:, None] ** 2) / (2 * narrow**2)), (x[0], x[0]), 5.0)
    alpha2 = 2 * (beta - 2.0) * psf_um**2

    def ring(r: float) -> float:
        law = (beta - 1.0) / (np.pi * alpha2) * (1.0 + r * r / alpha2) ** -beta
        return float(2 * np.pi * r * law * np.exp(-((r - d) ** 2) / (2 * sd**2)) * ive(0, r * d / sd**2))

    ends = (0.0, 30.0, 100.0, 300.0, 1000.0)
    truth = sum(quad(ring, a, b, epsabs=1e-12)[0] for a, b in pairwise(ends))
    image = irradiance_image(light, camera)
    assert abs(image[64, 64 + distance_px] - truth) < 1e-5 * truth + 1e-7
    assert image[64 + distance_px, 64] == pytest.approx(image[64, 64 + distance_px], rel=1e-9)


@pytest.mark.parametrize("off", [{}, {"rotation_deg": 12.0}, {"psf_um": 20.0}])
def test_glare_adds_a_wide_spot_and_takes_from_the_narrow_one(off: dict[str, Any]) -> None:
    """(1 - a) E + a (E convolved with a Gaussian of sd 0.8 mm), for a spot in the middle of a large dark map."""
    camera = Camera(glare=0.1, **off)
    light = spot(12.5, half_um=5000.0)
    sd = float(np.hypot(SD_UM, camera.psf_um))
    a = np.radians(camera.rotation_deg)
    at = (
        SPOT_UM[0] * np.cos(a) - SPOT_UM[1] * np.sin(a),
        SPOT_UM[0] * np.sin(a) + SPOT_UM[1] * np.cos(a),
    )
    narrow, wide = image_of_spot(camera, sd, at), image_of_spot(camera, float(np.hypot(sd, 800.0)), at)
    image = irradiance_image(light, camera)
    assert error(image, 0.9 * narrow + 0.1 * wide) < 3e-5
    only = irradiance_image(light, camera.model_copy(update={"glare": 1.0}))
    assert error(only, wide) < 1e-5


def test_glare_comes_from_all_of_the_map_also_from_beyond_the_image() -> None:
    """A spot that the image does not see still veils it; without glare the image is dark."""
    light, camera = spot(), Camera(rows=16, columns=16, centre_px=(50.0, -80.0))
    dark = irradiance_image(light, camera)
    veiled = irradiance_image(light, camera.model_copy(update={"glare": 0.05}))
    assert dark.max() < 1e-6
    assert veiled.min() > 1e-3


def test_a_dark_surround_takes_the_light_that_a_mirror_gives() -> None:
    """All light spread by sd g from a flat square of half side h: erf(h / g / sqrt 2)^2 in its middle, or still 1."""
    camera = Camera(rows=1, columns=1, glare=1.0)
    dark, mirror = (
        irradiance_image(map_of(lambda x, _y: 1.0 + 0 * x, 8.0, beyond=b), camera) for b in ("dark", "mirror")
    )
    assert dark.item() == pytest.approx(float(erf(1000.0 / 800.0 / np.sqrt(2.0))) ** 2, rel=2e-5)
    assert mirror.item() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(("law", "power"), [("quadratic", 1.0), ("cos4", -0.5)])
def test_vignetting_follows_its_law_and_loses_v_at_the_corner(law: Any, power: float) -> None:
    """1 at the centre; 1 - T, or 1 / sqrt T - 1 for cos^4, grows as the square of the radius, to v at the corner."""
    left = transmission(Camera(rows=101, columns=101, vignetting=0.3, vignetting_law=law))
    fall = np.abs(left**power - 1.0)
    assert left[50, 50] == 1.0
    assert fall[100, 100] == pytest.approx(4.0 * fall[25, 75])
    assert fall[100, 100] * (50.5 / 50.0) ** 2 == pytest.approx(abs(0.7**power - 1.0))


def test_ambient_light_is_a_plane_that_reaches_its_rise_in_the_last_row_and_column() -> None:
    """0 in the middle of the image, the same step from pixel to pixel."""
    plane = ambient(Camera(rows=5, columns=9, ambient_dn=(10.0, -4.0)))
    assert plane[2, 4] == 0.0
    assert plane[4, 4] == pytest.approx(10.0)
    assert plane[2, 8] == pytest.approx(-4.0)
    assert np.allclose(np.diff(plane, axis=0), 5.0)
    assert np.allclose(np.diff(plane, axis=1), -1.0)


def test_nonlinearity_takes_b_of_full_scale_at_full_scale() -> None:
    """Half of full scale loses a quarter of that, 0 nothing."""
    assert nonlinear(np.array([0.0, 500.0, 1000.0]), 0.04, 1000.0).tolist() == pytest.approx([0.0, 490.0, 960.0])


@given(knee=st.floats(0.5, 0.999), share=st.floats(-0.5, 40.0))
@settings(derandomize=True, max_examples=80, deadline=None)
def test_saturation_bends_above_its_knee_only_and_never_passes_full_scale(knee: float, share: float) -> None:
    """Below the knee the signal itself; above it less, rising, and not above full scale."""
    y = np.array([share, share + 0.01]) * 1000.0
    out = saturated(y, knee, 1000.0)
    assert out[0] == y[0] if share <= knee else knee * 1000.0 <= out[0] < y[0]
    assert out[0] <= out[1] <= max(1000.0, 1000.0 * (1 + 1e-15))


def test_saturation_starts_without_a_kink_and_black_is_added_after_it() -> None:
    """Slope 1 and curvature 0 at the knee from above; a pixel far above full scale reads full scale plus black."""
    y = 800.0 + np.array([0.0, 0.5, 1.0])
    out = saturated(y, 0.8, 1000.0)
    assert np.diff(out) == pytest.approx([0.5, 0.5], rel=1e-4)
    camera = Camera(rows=1, columns=1, saturation_knee=0.8, full_scale_dn=1000.0, black_level_dn=64.0)
    assert response(np.array([[1e6]]), camera).item() == pytest.approx(1064.0)


def test_digital_numbers_are_black_plus_gain_times_irradiance_plus_offset() -> None:
    """The base image model of a data set."""
    light, camera = spot(), Camera(gain_dn=250.0, offset_dn=-3.0, black_level_dn=64.0)
    assert error(expected_image(light, camera), 64.0 + 250.0 * image_of_spot(camera) - 3.0) < 2e-6


def test_a_barrel_beyond_what_can_be_inverted_stays_on_its_side() -> None:
    """Camera and effect add up to k1 = -0.07: places change smoothly with it, no pixel looks across the axis."""
    places = []
    for k1 in (-0.0655, -0.066, -0.07):
        camera = Camera(rows=32, columns=32, pixel_um=8.0).model_copy(update={"distortion": k1})
        margin = np.arange(-8.0, 40.0)
        x, _, side = receiver_points(camera, margin, margin)
        assert np.isfinite(side).all()
        assert (np.sign(x[:, :16]) < 0.0).all()
        places.append(x)
    assert np.abs(places[1] - places[0]).max() < 5.0
