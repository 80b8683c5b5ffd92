"""The expected image of a camera: a map of irradiance on the receiver becomes digital numbers, without noise.

    map  --geometry, mean over the pixel, PSFs, vignetting, glare-->  image  --gain, offset-->  signal above black
         --ambient plane, non-linearity, saturation, black level-->  digital numbers

Each step is a function of its own and gives its input back, bit for bit, at its off value; all are smooth in their
parameters. Up to the signal all are linear in the map, and its leading axes (replicas, columns of a Jacobian) go
through as one. Pixels have to lie on the map; only blur and glare look beyond it (`LightMap.beyond`).
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.compiled import kernel
from containers.lens import blurs, corner_px, uneven_blurs, vignettings
from containers.ray_tracing.aberrations import blur_of, rays_of, rays_reach_um
from containers.ray_tracing.light_map import LightMap, pixel_means, spline_of, spread
from luxloop.camera import Camera
from luxloop.errors import InputError

Real = NDArray[np.float64]

MOFFAT_MARGIN_PX, MOFFAT_LARGEST_PX = 48, 12.0
"""How far beyond the image the wings of a Moffat PSF look (fixed, so that the image is smooth in its width)."""
GAUSSIAN_LARGEST_PX = 200.0
"""Of a Gaussian's standard deviation: the widest there is, 200 um, by pixels of 1 um on the receiver."""
MOFFAT = {"moffat2.5": (1.0, 1.0), "moffat3.5": (1.0, 1.0, 1.0 / 3.0), "moffat4.5": (1.0, 1.0, 2.0 / 5.0, 1.0 / 15.0)}
"""Polynomials of q = alpha k that, times exp(-q), are the transform of (1 + r^2 / alpha^2)^-beta."""


def expected_image(light: LightMap, camera: Camera) -> Real:
    """The expected digital numbers (..., row, column) of `camera` in front of `light`.

    Raises
    ------
    InputError where pixels lie outside of the map, or the PSF is too wide for its kind.

    Notes
    -----
    Steps and order: at the head of this module. Neglected: glare that changes over the field.
    """
    return response(camera.gain_dn * irradiance_image(light, camera) + camera.offset_dn, camera)


def irradiance_image(light: LightMap, camera: Camera) -> Real:
    """The irradiance (..., row, column) in 1/mm2 that the pixels see: all before the gain, linear in the map."""
    _refuse_outside(light, camera)
    before = margin_px(camera)
    row, column = (_window(size, before) for size in (camera.rows, camera.columns))
    image = seen_through_lens(light, camera, row, column)
    for psf, sd_px in blurs_px(camera):
        image = blurred(image, psf, sd_px)
    image = image[..., before : before + camera.rows, before : before + camera.columns]
    return with_glare(image * transmission(camera), light, camera)


def response(signal_dn: Real, camera: Camera) -> Real:
    """Digital numbers for a signal above black (..., row, column): ambient light, then the sensor's own steps."""
    return sensed(signal_dn + ambient(camera), camera)


def sensed(light_dn: Real, camera: Camera) -> Real:
    """Digital numbers for the signal of all light that arrives (..., row, column): the sensor's own steps."""
    signal = nonlinear(light_dn, camera.nonlinearity, camera.full_scale_dn)
    return saturated(signal, camera.saturation_knee, camera.full_scale_dn) + camera.black_level_dn


# Geometry


def pixels(count: int, first: int = 0) -> Real:
    """The places in px of `count` pixels along an axis."""
    return np.arange(first, first + count, dtype=np.float64)


def receiver_points(camera: Camera, row: Real, column: Real) -> tuple[Real, Real, Real]:
    """x_um, y_um on the receiver and side_um of a square as large as a pixel there, each (row, column).

    For all combinations of `row` (row,) and `column` (column,) in px, whole numbers or not.

    Notes
    -----
    A point X of the receiver (module's centre 0) is imaged to centre + shift + (1 + e) turned(X) / pixel, and then
    moved along the radius from the image's centre, r to r + k1 r^3 with r = 1 at the corner of the corner pixel; this
    is the inverse. What k1 makes of a square is neglected but for its area. A pixel shows the mean over what it sees,
    not the sum: of an even receiver the image is even, as behind a flat field taken with the same lens. Where nothing
    was divided by a flat, the area seen, 1 / ((1 + e)^2 (1 + k1 r^2) (1 + 3 k1 r^2)), is in the gain and, to first
    order, a quadratic vignetting of 4 k1.
    """
    row = row[:, None]
    axis_row, axis_column = (camera.rows - 1) / 2, (camera.columns - 1) / 2
    centre_row, centre_column = camera.centre_px or (axis_row, axis_column)
    x, y = column - (centre_column + camera.shift_px[1]), row - (centre_row + camera.shift_px[0])
    stretch = np.ones((row.shape[0], column.size))
    if camera.distortion:
        from_axis = (row - axis_row) ** 2 + (column - axis_column) ** 2
        factor, stretch = _undistorted(camera.distortion, from_axis / corner_px(camera) ** 2)
        x = x + (factor - 1.0) * (column - axis_column)
        y = y + (factor - 1.0) * (row - axis_row)
    um, angle = camera.pixel_um / (1.0 + camera.magnification_error), np.radians(camera.rotation_deg)
    cos, sin = np.cos(angle), np.sin(angle)
    return um * (x * cos + y * sin), um * (y * cos - x * sin), um * stretch


def _undistorted(k1: float, r2: Real) -> tuple[Real, Real]:
    """f = r / r' of r + k1 r^3 = r', and the root of the area's scale, for r'^2.

    Beyond r' = 1.5 as there, or as near the end of what a barrel can be inverted to, r'^2 = 4 / 27 |k1|.
    """
    furthest = 0.95 * 4.0 / (27.0 * -k1) if k1 < 0.0 else np.inf
    r2 = np.minimum(r2, min(2.25, furthest))
    f = _radius_ratio(k1, r2)
    return f, np.sqrt(f / (1.0 + 3.0 * k1 * r2 * f**2))


@kernel
def _radius_ratio(k1: float, r2: Real) -> Real:
    """Root f of f + k1 r2 f^3 = 1 for all r2 (row, column), by Newton's method."""
    ratio = np.empty_like(r2)
    for row in range(r2.shape[0]):
        for column in range(r2.shape[1]):
            a = k1 * r2[row, column]
            f, change = 1.0 - a, 1.0
            while abs(change) > 1e-8:  # Newton's next would be below 1e-16
                change = (f + a * f * f * f - 1.0) / (1.0 + 3.0 * a * f * f)
                f -= change
            ratio[row, column] = f
    return ratio


def _from_axis(camera: Camera) -> tuple[Real, Real]:
    """Rows (row, 1) and columns (column,) of the image in px from its centre."""
    return (
        pixels(camera.rows)[:, None] - (camera.rows - 1) / 2,
        pixels(camera.columns) - (camera.columns - 1) / 2,
    )


def reach_um(camera: Camera) -> float:
    """How far from the module's centre, along x or y, what a camera's pixels, blurs and rays see reaches at most."""
    before = margin_px(camera)
    row, column = (pixels(size + 2 * before, -before) for size in (camera.rows, camera.columns))
    borders = receiver_points(camera, row[[0, -1]], column), receiver_points(camera, row, column[[0, -1]])
    seen = max(float((np.maximum(np.abs(x), np.abs(y)) + side).max()) for x, y, side in borders)
    return seen + rays_reach_um(camera, row, column)


def _refuse_outside(light: LightMap, camera: Camera) -> None:
    """InputError where a pixel on the border of the image, hence any, leaves the area of the map."""
    row, column = pixels(camera.rows), pixels(camera.columns)
    borders = receiver_points(camera, row[[0, -1]], column), receiver_points(camera, row, column[[0, -1]])
    x, y, side = (np.concatenate([border.ravel() for border in both]) for both in zip(*borders, strict=True))
    half = side / 2 - 1e-9 * light.step_um
    x0, x1, y0, y1 = light.area_um()
    for axis, points, least, most in (("x", x, x0, x1), ("y", y, y0, y1)):
        seen = float((points - half).min()), float((points + half).max())
        if seen[0] < least or seen[1] > most:
            mend = "fewer or smaller pixels, another centre, or a larger map"
            raise InputError(f"{axis} of pixels in um", seen, f"inside the map, {least:g} to {most:g}", mend)


# The lens


def seen_through_lens(light: LightMap, camera: Camera, row: Real, column: Real) -> Real:
    """Means (..., row, column) over the pixels, sharp or each blurred by its own, before any blur alike for all."""
    x, y, side = receiver_points(camera, row, column)
    sharp = pixel_means(light, spline_of(light), x, y, side)
    if not uneven_blurs(camera):
        return sharp
    rays = rays_of(camera, row, column, light.step_um)
    return sharp + blur_of(light, rays, x, y, float(side.mean()))


def blurs_px(camera: Camera) -> list[tuple[str, float]]:
    """Kind and standard deviation, in pixels of the image, of each PSF that has a width."""
    per_um = (1.0 + camera.magnification_error) / camera.pixel_um
    return [(psf, psf_um * per_um) for psf, psf_um in blurs(camera)]


def margin_px(camera: Camera) -> int:
    """How many pixels beyond the image its PSFs need to see; InputError where they would need too many."""
    return sum(_reach_px(psf, sd_px, camera) for psf, sd_px in blurs_px(camera))


def seen_px(camera: Camera) -> int:
    """How many pixels are computed for an image: its own and those beyond it that its PSFs need to see."""
    beyond = 2 * margin_px(camera)
    return (camera.rows + beyond) * (camera.columns + beyond)


def _reach_px(psf: str, sd_px: float, camera: Camera) -> int:
    if psf not in MOFFAT:
        if sd_px > GAUSSIAN_LARGEST_PX:
            least_um = sd_px / GAUSSIAN_LARGEST_PX * camera.pixel_um
            allowed = f"{least_um:.3g} um or more with a blur of {sd_px:.3g} pixels"
            raise InputError("pixel_um", camera.pixel_um, allowed, "pixel_um is in um on the receiver, as is psf_um")
        return int(np.ceil(7.0 * sd_px)) + 6
    if sd_px > MOFFAT_LARGEST_PX:
        um = camera.pixel_um / (1.0 + camera.magnification_error)
        allowed = f"0 to {MOFFAT_LARGEST_PX * um:g} um for a Moffat here"
        raise InputError("psf_um", sd_px * um, allowed, "or take a gaussian")
    return MOFFAT_MARGIN_PX


def _window(size: int, before: int) -> Real:
    """The pixels of an axis with `before` more at either end, or more: as a Fourier transform takes them well."""
    length = size + 2 * before
    while before and (30**12) % length:  # what divides a high power of 30 has the prime factors 2, 3, 5 only
        length += 1
    return pixels(length, -before)


def blurred(image: Real, psf: str, sd_px: float) -> Real:
    """`image` (..., row, column) convolved with the PSF, periodic at its edges; itself at sd 0. Keeps the sum.

    Notes
    -----
    Gaussian of standard deviation w: exp(-w^2 k^2 / 2). Moffat (A&A 3, 455, 1969), (1 + r^2 / alpha^2)^-beta, with
    the same second moment, alpha^2 = 2 (beta - 2) w^2, hence the same slope in w^2 at 0; its transform (q/2)^v K_v(q)
    2 / Gamma(v), q = alpha k, v = beta - 1, is a polynomial times exp(-q) for these beta. k^2 along an axis is
    4 (s + s^2/3 + 8 s^3/45 + 4 s^4/35), s = sin^2(k/2): off by 4e-5 of it at a quarter, 7e-3 at half the highest
    frequency of the pixels, but without the break there that lets a narrow PSF ring over the image.
    """
    if not sd_px:
        return image
    rows, columns = image.shape[-2:]
    k2 = _wave_squared(np.fft.fftfreq(rows))[:, None] + _wave_squared(np.fft.rfftfreq(columns))
    spectrum = np.fft.rfft2(image)
    spectrum *= _transfer(psf, sd_px, k2)
    return np.fft.irfft2(spectrum, (rows, columns))


def _wave_squared(frequency: NDArray[np.floating[Any]]) -> Real:
    """k^2 in 1/px^2 of cycles per pixel, smooth and periodic; see `blurred`."""
    s = np.sin(np.pi * frequency) ** 2
    return np.asarray(4.0 * s * (1.0 + s * (1.0 / 3.0 + s * (8.0 / 45.0 + s * (4.0 / 35.0)))))


def _transfer(psf: str, sd_px: float, k2: Real) -> Real:
    """The PSF's Fourier transform at squared waves in 1/px^2."""
    if psf not in MOFFAT:
        return np.asarray(np.exp(-0.5 * sd_px**2 * k2))
    coefficients = MOFFAT[psf]
    beta = len(coefficients) + 0.5
    q = sd_px * np.sqrt(2.0 * (beta - 2.0) * k2)
    return np.asarray(np.polynomial.polynomial.polyval(q, coefficients) * np.exp(-q))


def transmission(camera: Camera) -> Real:
    """What vignetting leaves of the light in each pixel (row, column): 1 at the image's centre, 1 - v at its corners.

    Notes
    -----
    1 - v r^2, or cos^4 = 1 / (1 + r^2 tan^2)^2 with the angle at the corner from 1 - v; of several the product.
    """
    row, column = _from_axis(camera)
    r2 = (row**2 + column**2) / corner_px(camera) ** 2
    left = np.ones_like(r2)
    for law, loss in vignettings(camera):
        left *= 1.0 - loss * r2 if law == "quadratic" else (1.0 + r2 * ((1.0 - loss) ** -0.5 - 1.0)) ** -2
    return left


def with_glare(image: Real, light: LightMap, camera: Camera) -> Real:
    """(1 - a) image + a x the receiver's light spread by a wide Gaussian; `image` itself at a = 0.

    Notes
    -----
    The source is all light of the map, also from beyond the image, and what it puts on the sensor is not vignetted.
    PSFs are in it by adding variances (exact for Gaussians); blur that changes over the image is neglected. Light
    that stays on the map keeps its energy. The veil is so smooth that a polynomial through few points of the image
    gives it everywhere.
    """
    if not camera.glare:
        return image
    sd_um = float(reduce(np.hypot, (psf_um for _, psf_um in blurs(camera)), camera.glare_um))
    wide = spread(light, sd_um)
    sizes = camera.rows, camera.columns
    (row, up), (column, across) = (_few_points(size, size * camera.pixel_um / sd_um) for size in sizes)
    veil = up @ pixel_means(wide, spline_of(wide), *receiver_points(camera, row, column)) @ across.T
    return image + camera.glare * (veil - image)


def _few_points(size: int, length_sd: float) -> tuple[Real, Real]:
    """Chebyshev points in px along an axis, and the matrix (pixel, point) from values there to values at the pixels.

    The axis is as long as `length_sd` standard deviations of a Gaussian; the points are enough to follow it.
    """
    count = 12 + int(np.ceil(3.0 * length_sd))
    angle = np.pi * (np.arange(count) + 0.5) / count
    at = (size - 1) / 2 * (1.0 + np.cos(angle))
    angle_of_pixel = np.arccos(np.linspace(-1.0, 1.0, size) if size > 1 else np.zeros(1))
    order = np.arange(count)
    to_series = np.cos(order[:, None] * angle) * np.where(order == 0, 1.0, 2.0)[:, None] / count
    return at, np.cos(angle_of_pixel[:, None] * order) @ to_series


# The sensor


def ambient(camera: Camera) -> Real:
    """The plane of ambient light in DN (row, column): 0 at the image's centre."""
    row, column = _from_axis(camera)
    at_last_row, at_last_column = camera.ambient_dn
    slope_row, slope_column = at_last_row / max(row[-1, 0], 0.5), at_last_column / max(column[-1], 0.5)
    return np.asarray(slope_row * row + slope_column * column)


def nonlinear(signal_dn: Real, b: float, full_scale_dn: float) -> Real:
    """y (1 - b y / ymax) for a signal y above black in DN, any shape."""
    return np.asarray(signal_dn * (1.0 - b * (signal_dn / full_scale_dn)))


def saturated(signal_dn: Real, knee: float, full_scale_dn: float) -> Real:
    """The signal with a soft knee: unchanged up to knee x ymax, then ever closer to ymax; knee 1: unchanged.

    Notes
    -----
    y = ymax (k + (1 - k) tanh((y / ymax - k) / (1 - k))), which is C2 at the knee. What a sensor without a knee clips
    at ymax is left to the mask.
    """
    if knee == 1.0:
        return signal_dn
    above = np.maximum(signal_dn / full_scale_dn - knee, 0.0) / (1.0 - knee)
    bent = full_scale_dn * (knee + (1.0 - knee) * np.tanh(above))
    return np.where(above > 0.0, bent, signal_dn)
