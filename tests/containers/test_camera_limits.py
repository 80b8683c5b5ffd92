"""The camera: smooth in every parameter, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from containers.ray_tracing.camera import (
    expected_image,
    irradiance_image,
)
from containers.ray_tracing.light_map import LightMap
from luxloop.camera import Camera
from luxloop.errors import InputError
from luxloop.words import parse
from tests.light_spots import (
    SD_UM,
    SPOT_UM,
    Real,
    error,
    gaussian,
    map_of,
    spot,
)

# Smoothness

X, Y = SPOT_UM
SLOPES: dict[str, Any] = {
    "shift_px.column": (8.0, lambda x, y: gaussian(x, y) * (x - X) / SD_UM**2),
    "shift_px.row": (8.0, lambda x, y: gaussian(x, y) * (y - Y) / SD_UM**2),
    "rotation_deg": (np.pi / 180, lambda x, y: gaussian(x, y) * ((y - Y) * x - (x - X) * y) / SD_UM**2),
    "magnification_error": (1.0, lambda x, y: gaussian(x, y) * ((x - X) * x + (y - Y) * y) / SD_UM**2),
}
"""Unit and the map's own derivative when the image is moved, turned, magnified, at any value of the parameter."""


def with_value(name: str, value: float, base: Camera) -> Camera:
    """`base` with one parameter changed."""
    if name.startswith("shift_px"):
        row, column = base.shift_px
        return base.model_copy(update={"shift_px": (value, column) if name.endswith("row") else (row, value)})
    return base.model_copy(update={name: value})


def slope_of(light: LightMap, name: str, value: float, step: float, base: Camera) -> Real:
    """Central difference of the image."""
    up, down = (irradiance_image(light, with_value(name, value + sign * step, base)) for sign in (1, -1))
    return (up - down) / (2 * step)


@given(
    name=st.sampled_from(["shift_px.row", "shift_px.column"]),
    value=st.floats(-5.0, 5.0),
    psf=st.sampled_from([0.0, 4.0]),
)
@settings(derandomize=True, max_examples=15, deadline=None)
def test_the_slope_with_shift_is_the_image_of_the_map_s_slope(name: str, value: float, psf: float) -> None:
    """At any shift, whole pixels and crossings of the map's samples included: no bump of an interpolant."""
    base = Camera(rows=64, columns=64, psf_um=psf)
    unit, slope = SLOPES[name]
    truth = unit * irradiance_image(map_of(slope), with_value(name, value, base))
    assert error(slope_of(spot(), name, value, 1e-3, base), truth) < 5e-5


@pytest.mark.parametrize("name", ["rotation_deg", "magnification_error"])
def test_the_slope_with_rotation_and_magnification_at_off_is_the_image_of_the_map_s(name: str) -> None:
    """Turned about the module, x towards y; stretched from it."""
    unit, slope = SLOPES[name]
    truth = unit * irradiance_image(map_of(slope), Camera())
    assert error(slope_of(spot(), name, 0.0, 1e-4, Camera()), truth) < 5e-5


@pytest.mark.parametrize("psf", ["gaussian", "moffat3.5", "moffat4.5"])
def test_the_slope_with_the_square_of_the_psf_at_off_is_half_the_laplacian(psf: Any) -> None:
    """Score variable sd^2: the slope at 0 is finite and the same for every kind of PSF."""
    laplacian = map_of(lambda x, y: gaussian(x, y) * (((x - X) ** 2 + (y - Y) ** 2) / SD_UM**2 - 2.0) / SD_UM**2)
    off, on = (irradiance_image(spot(), Camera(psf=psf, psf_um=sd)) for sd in (0.0, 0.5))
    assert error((on - off) / 0.5**2, irradiance_image(laplacian, Camera()) / 2) < (
        1e-4 if psf == "gaussian" else 0.01
    )


@pytest.mark.parametrize(
    ("name", "around", "step"),
    [
        ("shift_px.row", 0.0, 0.05), ("shift_px.column", 0.5, 0.05), ("rotation_deg", 0.0, 0.05),
        ("rotation_deg", 20.0, 0.05), ("magnification_error", 0.0, 1e-3), ("distortion", 0.0, 1e-3),
        ("distortion", 0.03, 1e-3), ("psf_um", 3.0, 0.1), ("psf_um", 8.0, 0.1), ("psf_um", 16.0, 0.1),
        ("glare_um", 800.0, 2.0), ("vignetting", 0.2, 0.01), ("glare", 0.2, 0.01),
    ],
)  # fmt: skip
def test_slopes_are_continuous_in_every_parameter(name: str, around: float, step: float) -> None:
    """Slopes over a step and over half of it agree to second order, and the second difference of slopes is small."""
    base = Camera(rows=64, columns=64, psf_um=5.0, glare=0.05, rotation_deg=0.1, distortion=0.004)
    slopes = np.array([slope_of(spot(), name, around + k * step, step / 8, base) for k in (-1, 0, 1)])
    assert np.abs(slopes[0] - 2 * slopes[1] + slopes[2]).max() < 1e-3 * np.abs(slopes[1]).max()
    whole, half = (slope_of(spot(), name, around, h, base) for h in (step, step / 2))
    assert error(whole, half) < 1e-3


# Bad input


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("psf_um", -1.0), ("rotation_deg", 45.1), ("rotation_deg", float("nan")), ("magnification_error", 0.6),
        ("distortion", 0.06), ("vignetting", 1.0), ("glare", -0.01), ("pixel_um", 0.0), ("rows", 0), ("gain_dn", 0.0),
        ("saturation_knee", 1.1), ("full_scale_dn", -5.0), ("psf", "airy"), ("shift_px", (float("inf"), 0.0)),
    ],
)  # fmt: skip
def test_cameras_out_of_range_are_refused_by_field(field: str, value: object) -> None:
    """The message names the field."""
    with pytest.raises(InputError, match=field):
        parse(Camera, {field: value})


@pytest.mark.parametrize(
    ("values", "origin", "step", "beyond", "named"),
    [
        (np.full((9, 9), np.nan), (0.0, 0.0), 1.0, "mirror", "irradiance_per_mm2.*nan"),
        (np.ones(9), (0.0, 0.0), 1.0, "mirror", "irradiance_per_mm2"),
        (np.ones((9, 1)), (0.0, 0.0), 1.0, "mirror", "two samples or more"),
        (np.ones((9, 9)) * 1j, (0.0, 0.0), 1.0, "mirror", "real numbers"),
        (np.ones((9, 9)), (0.0, 0.0), 0.0, "mirror", "step_um"),
        (np.ones((9, 9)), (np.nan, 0.0), 1.0, "mirror", "origin_um"),
        (np.ones((9, 9)), (0.0, 0.0), 1.0, "wrap", "beyond"),
    ],
)
def test_maps_that_are_none_are_refused(values: Any, origin: Any, step: float, beyond: Any, named: str) -> None:
    """NaN, wrong shape, complex numbers, no step, no place, an unknown surround."""
    with pytest.raises(InputError, match=named):
        LightMap(values, origin, step, beyond)


@pytest.mark.parametrize(
    ("off", "named"),
    [
        ({"columns": 251}, "x of pixels.*-1000 to 1000"),
        ({"rows": 251}, "y of pixels.*-1000 to 1000"),
        ({"rows": 200, "columns": 200, "rotation_deg": 45.0}, "inside the map"),
        ({"centre_px": (0.0, 200.0)}, "x of pixels"),
        ({"psf": "moffat2.5", "psf_um": 97.0}, "psf_um.*0 to 96 um"),
        ({"pixel_um": 0.008, "psf_um": 8.0}, "pixel_um: got 0.008, allowed: 0.04 um or more.*in um on the receiver"),
    ],
)
def test_images_that_the_map_cannot_fill_are_refused_with_the_range(off: dict[str, Any], named: str) -> None:
    """Pixels beyond the map, a Moffat with more wings than the window around the image, mm that were taken for um."""
    with pytest.raises(InputError, match=named):
        expected_image(spot(8.0), Camera(**off))


def test_an_image_as_large_as_the_map_is_taken() -> None:
    """250 pixels of 8 um on a map of 2 mm: borders coincide."""
    assert expected_image(spot(8.0), Camera(rows=250, columns=250)).shape == (250, 250)


def test_a_map_coarser_than_the_glare_is_refused() -> None:
    """The convolution would not see its own kernel."""
    with pytest.raises(InputError, match="step_um"):
        expected_image(spot(125.0), Camera(glare=0.1, glare_um=100.0))
