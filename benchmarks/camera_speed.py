"""Time of one camera image, ours beside scipy.ndimage, on one thread, with the error of both against a closed form.

    python benchmarks/camera_speed.py

A Gaussian spot of sd 60 um on a map of 313 x 313 samples, 6.4 um apart, seen by 128 x 128 pixels of 8 um that are
turned by 0.3 deg and shifted. Best and median of warm runs; error: largest deviation from the analytic mean over each
pixel, as a share of the peak. scipy: `affine_transform` (cubic, with its prefilter) at the centres of pixels or at
3 x 3 Gauss points in each, `gaussian_filter` for the PSF and, on the map, for the glare; for blur that changes over
the image `map_coordinates` at our rays, or seven Gauss and Hermite's points along either axis.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.special import erf

from containers.lens import unevenly_blurred
from containers.ray_tracing.aberrations import rays_of
from containers.ray_tracing.camera import expected_image, irradiance_image, pixels, receiver_points
from containers.ray_tracing.light_map import LightMap, spline_of
from luxloop.camera import Camera

SAMPLES, STEP_UM, SD_UM, AT_UM = 313, 6.4, 60.0, (35.0, -72.0)
GEOMETRY: dict[str, Any] = {"rotation_deg": 0.3, "shift_px": (0.4, -0.7)}
PSF: dict[str, Any] = {**GEOMETRY, "psf_um": 5.0}
GLARE: dict[str, Any] = {**PSF, "glare": 0.05}
ALL: dict[str, Any] = {
    **GLARE, "vignetting": 0.1, "magnification_error": 0.003, "distortion": 0.01, "nonlinearity": 0.01,
    "saturation_knee": 0.9, "ambient_dn": (1.0, 2.0), "gain_dn": 50.0,
}  # fmt: skip
CORNER_UM = 30.0
MOFFAT: dict[str, Any] = {**PSF, "psf": "moffat3.5"}


def spot_map() -> LightMap:
    x = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) * STEP_UM
    r2 = (x - AT_UM[0]) ** 2 + (x[:, None] - AT_UM[1]) ** 2
    return LightMap(1e6 * np.exp(-r2 / (2 * SD_UM**2)) / (2 * np.pi * SD_UM**2), (x[0], x[0]), STEP_UM)


def closed_form(camera: Camera) -> Any:
    """Shares of a narrow and a wide spot and their mirror images in the map's edges, as means over pixels.

    Over squares along the map's axes: those turned by 0.3 deg have the same mean to 1e-9.
    """
    x, y, _ = receiver_points(camera, pixels(128), pixels(128))
    period = 2 * SAMPLES * STEP_UM

    def along(u: Any, at: float, sd: float) -> Any:
        places = [at, *(side * period / 2 - at for side in (-1, 1)), *(at + side * period for side in (-1, 1))]
        edges = [(u - place + side) / sd / np.sqrt(2.0) for place in places for side in (4.0, -4.0)]
        return sum(erf(edge) * sign for edge, sign in zip(edges, (1, -1) * len(places), strict=True)) / 16.0

    def spot(sd: float) -> Any:
        return 1e6 * along(x, AT_UM[0], sd) * along(y, AT_UM[1], sd)

    narrow = float(np.hypot(SD_UM, camera.psf_um))
    return (1.0 - camera.glare) * spot(narrow) + camera.glare * spot(float(np.hypot(narrow, camera.glare_um)))


def scipy_image(light: LightMap, camera: Camera, gauss_points: bool) -> Any:
    """The same steps with scipy: glare on the map, resampling of a wider window, PSF on it."""
    values = light.irradiance_per_mm2
    if camera.glare:
        wide = ndimage.gaussian_filter(values, camera.glare_um / light.step_um, mode="reflect", truncate=6.0)
        values = (1.0 - camera.glare) * values + camera.glare * wide
    margin = 8 if camera.psf_um else 0
    a, scale = np.radians(camera.rotation_deg), camera.pixel_um / light.step_um
    matrix = scale * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])  # (row, column) to (row, column)
    centre = 63.5 + np.array(camera.shift_px) + margin
    shape = (128 + 2 * margin, 128 + 2 * margin)
    spline = ndimage.spline_filter(values, 3, mode="reflect")
    nodes, weights = np.polynomial.legendre.leggauss(3) if gauss_points else (np.zeros(1), np.full(1, 2.0))
    image = np.zeros(shape)
    for dy, wy in zip(nodes / 2, weights / 2, strict=True):
        for dx, wx in zip(nodes / 2, weights / 2, strict=True):
            offset = (SAMPLES - 1) / 2 + matrix @ (np.array([dy, dx]) - centre)
            image += (
                wy * wx * ndimage.affine_transform(spline, matrix, offset, shape, mode="reflect", prefilter=False)
            )
    if camera.psf_um:
        image = ndimage.gaussian_filter(image, camera.psf_um / camera.pixel_um, truncate=7.0)
    return image[margin : margin + 128, margin : margin + 128]


def blurred_spot(camera: Camera) -> Any:
    """Closed form: the spot and its pixel, widened by what stands at each pixel's place, all as Gaussians."""
    x, y, side = receiver_points(camera, pixels(128), pixels(128))
    square = SD_UM**2 + side**2 / 12.0 + (CORNER_UM * radius2()) ** 2
    r2 = (x - AT_UM[0]) ** 2 + (y - AT_UM[1]) ** 2
    return 1e6 * np.exp(-r2 / 2.0 / square) / (2.0 * np.pi * square)


def radius2() -> Any:
    """Square of the distance of each pixel from the image's centre, 1 at its corner."""
    from_axis = (pixels(128) - 63.5) ** 2
    return (from_axis + from_axis[:, None]) / (2.0 * 64.0**2)


def scipy_rays(light: LightMap, camera: Camera, hermite: bool) -> Any:
    """Point samples of the map's spline about each pixel's place."""
    x, y, _ = receiver_points(camera, pixels(128), pixels(128))
    ours = rays_of(camera, pixels(128), pixels(128), STEP_UM)
    displaced = [(w, *(u * ours.by_u_um + v * ours.by_v_um)) for w, u, v in ours.rule.T]
    if hermite:
        node, weight = np.polynomial.hermite_e.hermegauss(7)
        sd, of = CORNER_UM * radius2(), weight / weight.sum()
        displaced = [(of[i] * of[j], sd * node[i], sd * node[j]) for i in range(7) for j in range(7)]
    spline = ndimage.spline_filter(light.irradiance_per_mm2, 3, mode="reflect")
    found, middle = np.zeros(x.shape), (SAMPLES - 1) / 2
    for weight, dx, dy in displaced:
        at = [(y + dy) / STEP_UM + middle, (x + dx) / STEP_UM + middle]
        found += weight * ndimage.map_coordinates(spline, at, order=3, mode="reflect", prefilter=False)
    return found


def times_ms(function: Callable[[], Any], runs: int) -> tuple[float, float]:
    """Best and median of warm runs."""
    function()
    taken = []
    for _ in range(runs):
        begin = time.perf_counter()
        function()
        taken.append((time.perf_counter() - begin) * 1e3)
    return min(taken), float(np.median(taken))


def line(name: str, function: Callable[[], Any], truth: Any = None, runs: int = 40, images: int = 1) -> None:
    best, median = times_ms(function, runs)
    error = f"{np.abs(function() - truth).max() / truth.max():.1e}" if truth is not None else ""
    print(f"{name:<58}{best / images:>9.2f}{median / images:>9.2f}{error:>11}")


def main() -> None:
    light = spot_map()
    print(f"{'one image of 128 x 128 pixels from a map of 313 x 313':<58}{'best ms':>9}{'median':>9}{'error':>11}")
    for name, off in (
        ("geometry, mean over pixels", GEOMETRY),
        ("  and Gaussian PSF 5 um", PSF),
        ("  and glare", GLARE),
    ):
        camera = Camera(**off)
        truth = closed_form(camera)
        line(f"{name}: ours", lambda camera=camera: irradiance_image(light, camera), truth)
        for points, how in ((False, "scipy, point samples"), (True, "scipy, 3 x 3 points a pixel")):
            run = lambda camera=camera, points=points: scipy_image(light, camera, points)  # noqa: E731 bound, for a table
            line(f"{name}: {how}", run, truth, 5)
    line("all steps and effects on: ours", lambda: expected_image(light, Camera(**ALL)))
    line("geometry and Moffat PSF 5 um: ours", lambda: irradiance_image(light, Camera(**MOFFAT)))
    uneven = unevenly_blurred(Camera(**GEOMETRY), "round", CORNER_UM)
    truth = blurred_spot(uneven)
    line("geometry and blur off the axis, 30 um: ours", lambda: irradiance_image(light, uneven), truth, 5)
    line("  scipy, point samples at our 91 rays", lambda: scipy_rays(light, uneven, False), truth, 3)
    line("  scipy, point samples at 7 x 7 points", lambda: scipy_rays(light, uneven, True), truth, 3)
    along = unevenly_blurred(Camera(**GEOMETRY), "radial", CORNER_UM)
    line("geometry and blur along the radius, 30 um: ours", lambda: irradiance_image(light, along), None, 5)
    batch = LightMap(np.repeat(light.irradiance_per_mm2[None], 32, axis=0), light.origin_um, STEP_UM)
    line("all linear steps, 32 maps at once, each: ours", lambda: irradiance_image(batch, Camera(**ALL)), None, 5, 32)
    line("blur off the axis, 32 maps at once, each: ours", lambda: irradiance_image(batch, uneven), None, 2, 32)
    six = [Camera(**{**ALL, "shift_px": (0.1 * k, 0.2)}) for k in range(6)]
    line("six cameras, all on, together: ours", lambda: [expected_image(light, camera) for camera in six], None, 20)
    line("  of each the spline of the map: ours", lambda: spline_of(light))


if __name__ == "__main__":
    main()
