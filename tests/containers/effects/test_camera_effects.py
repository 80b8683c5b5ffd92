"""Effects in the camera by closed forms, and by another program's convolution."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve

from containers.acting import Effects
from containers.effect import DetectorEffect
from containers.effects.ambient_gradient import AmbientGradient
from containers.effects.camera_psf import CameraPsf
from containers.effects.distortion import Distortion
from containers.effects.magnification import Magnification
from containers.effects.nonlinearity import Nonlinearity
from containers.effects.saturation import Saturation
from containers.effects.veiling_glare import VeilingGlare
from containers.effects.vignetting import Vignetting
from containers.ray_tracing.camera import irradiance_image, receiver_points
from luxloop.camera import Camera
from tests.light_spots import map_of, spot

Real = NDArray[np.float64]
CAMERA = Camera(rows=100, columns=100, pixel_um=16.0)
FULL = CAMERA.full_scale_dn


def camera(effect: DetectorEffect, before: Camera = CAMERA) -> Camera:
    """The camera under an effect, as a worker applies it."""
    return Effects((effect,)).camera(before)


def test_blur_is_that_of_another_program_and_adds_to_the_camera_s_own() -> None:
    """A spot seen through the effect is the spot convolved by scipy; variances of Gaussians add up."""
    seen = irradiance_image(spot(), camera(CameraPsf(psf_um=40.0, profile="gaussian")))
    other = gaussian_filter(irradiance_image(spot(), CAMERA), 40.0 / 16.0, truncate=8.0)
    np.testing.assert_allclose(seen, other, atol=2e-4 * other.max())
    assert seen.sum() == pytest.approx(other.sum(), rel=1e-6)
    again = camera(CameraPsf(psf_um=40.0, profile="gaussian"), CAMERA.model_copy(update={"psf_um": 30.0}))
    assert again.psf_um == pytest.approx(50.0)


def test_a_veil_is_that_of_another_program_and_keeps_the_light() -> None:
    """(1 - a) E + a E * Gaussian by scipy; on a wide image the sum stays."""
    wide = Camera(rows=190, columns=190, pixel_um=10.0)
    veiled = camera(VeilingGlare(glare_share=0.1, glare_um=200.0), wide)
    plain = irradiance_image(spot(), wide)
    seen = irradiance_image(spot(), veiled)
    other = 0.9 * plain + 0.1 * gaussian_filter(plain, 20.0, truncate=8.0, mode="reflect")
    np.testing.assert_allclose(seen, other, atol=1e-3 * 0.1 * other.max())
    assert seen.sum() == pytest.approx(plain.sum(), rel=2e-3)


def test_a_veil_adds_to_the_camera_s_own_by_shares_and_second_moments() -> None:
    """What scipy makes of a point by one veil after the other: the light left there, and its mean square shift."""
    both = camera(
        VeilingGlare(glare_share=0.1, glare_um=400.0), CAMERA.model_copy(update={"glare": 0.3, "glare_um": 800.0})
    )
    place = np.arange(-400.0, 401.0)
    veiled = (place == 0.0).astype(float)
    for share, sd in ((0.3, 80.0), (0.1, 40.0)):
        veiled = (1.0 - share) * veiled + share * gaussian_filter(veiled, sd, truncate=8.0, mode="constant")
    mean_square = veiled @ place**2 * 10.0**2  # 10 um apart
    narrow = 0.9 * 0.3 / np.sqrt(2.0 * np.pi) / 80.0 + 0.7 * 0.1 / np.sqrt(2.0 * np.pi) / 40.0
    narrow += 0.3 * 0.1 / np.sqrt(2.0 * np.pi) / np.hypot(80.0, 40.0)
    assert 1.0 - both.glare == pytest.approx(veiled[400] - narrow, rel=1e-4)
    assert both.glare * both.glare_um**2 == pytest.approx(mean_square, rel=1e-3)


def test_a_veil_is_not_dimmed_by_vignetting() -> None:
    """Even light of 1 in any order of both effects: (1 - a) of the law, and a of the light itself."""
    flat = map_of(lambda x, y: 1.0 + 0.0 * x * y)
    dimmed, veil = Vignetting(corner_loss=0.3, law="quadratic"), VeilingGlare(glare_share=0.1, glare_um=800.0)
    law = irradiance_image(flat, camera(dimmed))
    for order in itertools.permutations((dimmed, veil)):
        np.testing.assert_allclose(irradiance_image(flat, Effects(order).camera(CAMERA)), 0.9 * law + 0.1, rtol=1e-9)


@pytest.mark.parametrize("law", ["quadratic", "cos4"])
def test_a_flat_field_shows_the_law_of_vignetting(law: Any) -> None:
    """1 - v r^2, or the fourth power of the cosine of atan(r tan), which is 1 - v at the corner."""
    flat = irradiance_image(map_of(lambda x, y: 1.0 + 0.0 * x * y), camera(Vignetting(corner_loss=0.3, law=law)))
    y, x = np.mgrid[:100, :100] - 49.5
    r2 = (x**2 + y**2) / (100.0**2 + 100.0**2) * 4.0
    slope = np.sqrt(0.7**-0.5 - 1.0)  # tan of the field angle at the corner
    expected = 1.0 - 0.3 * r2 if law == "quadratic" else np.cos(np.arctan(slope * np.sqrt(r2))) ** 4
    np.testing.assert_allclose(flat, expected, rtol=1e-9)


@pytest.mark.parametrize("law", ["quadratic", "cos4"])
@pytest.mark.parametrize("own", ["quadratic", "cos4"])
def test_two_vignettings_are_multiplied_whatever_their_laws(own: Any, law: Any) -> None:
    """By products of the laws of each; next to off the camera's own is left."""
    before = CAMERA.model_copy(update={"vignetting": 0.5, "vignetting_law": own})
    flat = map_of(lambda x, y: 1.0 + 0.0 * x * y)
    seen, alone = (
        irradiance_image(flat, camera(Vignetting(corner_loss=loss, law=law), before)) for loss in (0.3, 1e-12)
    )
    y, x = np.mgrid[:100, :100] - 49.5
    r2 = (x**2 + y**2) / (100.0**2 + 100.0**2) * 4.0

    def left(loss: float, kind: str) -> Real:
        return (
            1.0 - loss * r2 if kind == "quadratic" else np.cos(np.arctan(np.sqrt(r2 * ((1 - loss) ** -0.5 - 1)))) ** 4
        )

    np.testing.assert_allclose(seen, left(0.5, own) * left(0.3, law), rtol=1e-9)
    np.testing.assert_allclose(alone, left(0.5, own), rtol=1e-9)


@pytest.mark.parametrize("profile", ["gaussian", "moffat2.5"])
@pytest.mark.parametrize("own", ["gaussian", "moffat3.5"])
def test_two_blurs_are_convolved_whatever_their_profiles(own: Any, profile: Any) -> None:
    """The camera's own image convolved by scipy with the profile's law; next to off the camera's own is left."""
    before = CAMERA.model_copy(update={"psf_um": 30.0, "psf": own})
    seen, alone = (
        irradiance_image(spot(), camera(CameraPsf(psf_um=um, profile=profile), before)) for um in (40.0, 1e-4)
    )
    first = irradiance_image(spot(), before)
    np.testing.assert_allclose(alone, first, atol=1e-6 * first.max())
    fine = np.arange(-480.0, 481.0, 4.0)  # um, four to a pixel
    r2 = fine**2 + fine[:, None] ** 2
    law = np.exp(-r2 / (2 * 40.0**2)) if profile == "gaussian" else (1.0 + r2 / 40.0**2) ** -2.5
    sampled = irradiance_image(spot(), before.model_copy(update={"rows": 400, "columns": 400, "pixel_um": 4.0}))
    other = fftconvolve(sampled, law / law.sum(), mode="same").reshape(100, 4, 100, 4).mean(axis=(1, 3))
    middle = slice(30, 70)
    np.testing.assert_allclose(seen[middle, middle], other[middle, middle], atol=0.02 * other.max())


def test_the_image_grows_about_the_module_and_bends_about_its_own_centre() -> None:
    """A pixel looks at X / (1 + e); with k1 the corner looks at what r + k1 r^3 = 1 says; first orders add up."""
    row, column = np.array([99.5]), np.array([99.5])
    corner = receiver_points(CAMERA, row, column)[0][0, 0]
    larger = receiver_points(camera(Magnification(scale_error=0.01)), row, column)[0][0, 0]
    bent = receiver_points(camera(Distortion(cubic=0.02)), row, column)[0][0, 0]
    assert larger == pytest.approx(corner / 1.01, rel=1e-12)
    assert bent / corner + 0.02 * (bent / corner) ** 3 == pytest.approx(1.0, abs=1e-9)
    twice = camera(Magnification(scale_error=0.01), CAMERA.model_copy(update={"magnification_error": 0.01}))
    assert twice.magnification_error == pytest.approx(1.01**2 - 1.0)
    assert camera(Distortion(cubic=0.01), camera(Distortion(cubic=0.01))).distortion == pytest.approx(0.02)


@pytest.mark.parametrize("k1", [-0.02, 0.02])
def test_a_pixel_of_a_distorted_image_shows_the_mean_of_what_it_sees(k1: float) -> None:
    """Even light stays even; the area seen, by differences of places, is the closed form, nearly 1 - 4 k1 r^2."""
    bent = camera(Distortion(cubic=k1))
    np.testing.assert_allclose(irradiance_image(map_of(lambda x, y: 1.0 + 0.0 * x * y), bent), 1.0, rtol=1e-12)
    row = column = np.arange(100.0)
    x, y, side = receiver_points(bent, row, column)
    area = np.gradient(x, axis=1) * np.gradient(y, axis=0) - np.gradient(x, axis=0) * np.gradient(y, axis=1)
    r2 = (x**2 + y**2) / (16.0 * np.hypot(50.0, 50.0)) ** 2  # r before it is moved
    closed = 16.0**2 / ((1.0 + k1 * r2) * (1.0 + 3.0 * k1 * r2))
    inner = slice(1, -1)
    np.testing.assert_allclose(area[inner, inner], closed[inner, inner], rtol=3e-5)
    np.testing.assert_allclose(side**2, closed, rtol=1e-9)
    np.testing.assert_allclose(closed / 16.0**2, 1.0 - 4.0 * k1 * r2, atol=20.0 * k1**2)


def test_nonlinearity_takes_b_at_full_scale() -> None:
    """y (1 - b y / ymax)."""
    y = np.array([[0.0, 0.5 * FULL, FULL]])
    np.testing.assert_allclose(Nonlinearity(bend=0.04).signal(y, CAMERA), [[0.0, 0.49 * FULL, 0.96 * FULL]])


def test_saturation_leaves_what_is_below_its_knee_and_bends_softly() -> None:
    """Unchanged below, slope 1 at the knee, tanh above it, never over full scale."""
    y = np.array([[0.0, 0.5, 0.8, 0.8 + 1e-5, 1.0, 3.0]]) * FULL
    seen = Saturation(knee=0.8).signal(y, CAMERA)
    assert np.array_equal(seen[0, :3], y[0, :3])
    assert (seen[0, 3] - seen[0, 2]) / (1e-5 * FULL) == pytest.approx(1.0, abs=1e-6)
    assert seen[0, 4] == pytest.approx(FULL * (0.8 + 0.2 * np.tanh(1.0)))
    assert seen.max() <= FULL


def test_a_knee_near_full_scale_changes_nothing_below_it_and_cuts_what_is_above() -> None:
    """The limit of off: up to ymax the signal, to (1 - tanh 1) (1 - k) ymax; above it ymax, where off has no cut."""
    below, above = np.linspace(0.0, FULL, 1001)[None], np.array([[1.01, 1.5, 3.0]]) * FULL
    for knee in (0.99, 0.999, 0.999999):
        near = Saturation(knee=knee)
        assert np.abs(near.signal(below, CAMERA) - below).max() == pytest.approx(0.23840584 * (1 - knee) * FULL)
    np.testing.assert_allclose(near.signal(above, CAMERA), FULL, rtol=1e-12)
    assert np.array_equal(Saturation(knee=1.0).signal(above, CAMERA), above)


def test_ambient_light_is_a_plane_whatever_the_exposure() -> None:
    """Its rise at the last row and column is a share of full scale; no light and much light get the same."""
    effect = AmbientGradient(rise_x=0.05, rise_y=-0.02)
    dark, bright = np.zeros((100, 100)), np.full((100, 100), 0.5 * FULL)
    plane = effect.signal(dark, CAMERA)
    np.testing.assert_allclose(effect.signal(bright, CAMERA) - bright, plane, atol=1e-9)
    assert plane[0, -1] == pytest.approx(0.07 * FULL)
    assert plane[-1, -1] == pytest.approx(0.03 * FULL)
    assert plane.mean() == pytest.approx(0.0, abs=1e-9)
    assert AmbientGradient(rise_x=0.05, rise_y=0.0).signal(np.zeros((1, 1)), Camera(rows=1, columns=1)) == 0.0


def test_the_sensor_acts_in_its_own_order_whatever_the_model_says() -> None:
    """Light that is added is bent and cut like any other: six orders in the model, one signal."""
    three = (
        AmbientGradient(rise_x=0.05, rise_y=0.0),
        Nonlinearity(bend=0.05),
        Saturation(knee=0.8),
    )
    signal = np.full((100, 100), 0.95 * FULL)
    found = [Effects(order).signal(signal, CAMERA) for order in itertools.permutations(three)]
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])
