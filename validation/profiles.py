"""What is left of an image against one thing at a time: distance from the nearest chip, azimuth, radius, frequency.

A profile is the mean of measured minus model over a class of pixels, in percent of the model there; its band is the
95 % half width of the noise alone, with that of the model's Monte Carlo, which pixels share. That of frequency is the
power of the residual, 1 for noise; chi2 against pairs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.contrasts.places import chip_centres_um, from_nearest_um, module_coordinates_um
from validation.curve_profiles import curve_profiles
from validation.fit import Fit
from validation.measured import MeasuredImage

Real = NDArray[np.float64]
Profile = dict[str, Any]

NORMAL_95 = 1.959964
RINGS, SECTORS, BANDS = 24, 24, 20
LEAST_PIXELS = 4


def profiles(fit: Fit) -> list[Profile]:
    """The profiles of all images and curves, in the form of the comparison document."""
    found: list[Profile] = []
    residuals = fit.residual_images
    for number, image in enumerate(fit.problem.images):
        model_dn = np.asarray(fit.signals_dn[number])
        found += list(_in_place(image, model_dn, fit.model_noise_dn(number), _axes(image, fit)))
        found.append(_frequency(image, residuals[number]))
    found += _pairs(fit.problem.images, residuals)
    return found + curve_profiles(fit)


def _axes(image: MeasuredImage, fit: Fit) -> Iterator[tuple[str, str, Real, Real]]:
    """(against, unit, values (row, column), edges of classes)."""
    x_um, y_um = module_coordinates_um(image, fit.poses[image.shot.id])
    chips_um = chip_centres_um(image.sample, fit.model.environment)
    nearest_um, radius_um = from_nearest_um(x_um, y_um, chips_um), np.hypot(x_um, y_um)
    azimuth_deg = np.degrees(np.arctan2(y_um, x_um))
    yield "distance from the nearest chip", "um", nearest_um, _edges(nearest_um, image.pixel_um)
    yield "azimuth", "deg", azimuth_deg, np.linspace(-180.0, 180.0, SECTORS + 1)
    yield "field radius", "um", radius_um, _edges(radius_um, image.pixel_um)


def _edges(values: Real, least: float) -> Real:
    """Edges of at most `RINGS` classes of one width, none narrower than a pixel."""
    width = max(float(values.max()) / RINGS, least)
    return np.arange(0.0, float(values.max()) + width, width)


def _in_place(
    image: MeasuredImage, model_dn: Real, shared_dn: Real, axes: Iterator[tuple[str, str, Real, Real]]
) -> Iterator[Profile]:
    """`shared_dn` (function, row, column): noise of the model, each times one unit normal number."""
    difference, variance = image.signal_dn - model_dn, image.noise_dn2(model_dn)
    for against, unit, values, edges in axes:
        place = np.digitize(values[image.used], edges) - 1
        sums = partial(np.bincount, place, minlength=len(edges))
        counts, left, noise, level = map(sums, (None, *(one[image.used] for one in (difference, variance, model_dn))))
        noise = noise + np.sum([sums(one[image.used]) ** 2 for one in shared_dn], axis=0)
        kept = (counts >= LEAST_PIXELS) & (level > 0.0)
        middles = (edges + 0.5 * (edges[1] - edges[0]))[kept]
        yield {
            "against": against, "unit": unit, "shot": image.shot.id, "dbr_pairs": image.sample.dbr_pairs,
            "x": _plain(middles),
            "relative_percent": _plain(100.0 * left[kept] / level[kept]),
            "band_percent": _plain(100.0 * NORMAL_95 * np.sqrt(noise[kept]) / level[kept]),
        }  # fmt: skip


def _frequency(image: MeasuredImage, z: Real) -> Profile:
    """Power of the residual in standard deviations against spatial frequency; unused pixels count as 0."""
    power = np.abs(np.fft.fft2(z)) ** 2 / max(int(image.used.sum()), 1)
    per_mm = [np.fft.fftfreq(count, image.pixel_um * 1e-3) for count in z.shape]
    radius = np.hypot(*np.meshgrid(*per_mm, indexing="ij"))
    edges = np.linspace(0.0, 0.5e3 / image.pixel_um, BANDS + 1)
    place = np.digitize(radius, edges).ravel() - 1
    counts, sums = (np.bincount(place, weights, minlength=BANDS + 1)[:BANDS] for weights in (None, power.ravel()))
    kept = counts > 0
    return {
        "against": "spatial frequency", "unit": "1/mm", "shot": image.shot.id, "dbr_pairs": image.sample.dbr_pairs,
        "x": _plain((edges[:-1] + edges[1] / 2.0)[kept]),
        "power": _plain(sums[kept] / counts[kept]),
        "band": _plain(NORMAL_95 * np.sqrt(2.0 / counts[kept])),
    }  # fmt: skip


def _pairs(images: Sequence[MeasuredImage], residuals: Sequence[Real]) -> list[Profile]:
    """Chi2 per pixel of all images against their samples' DBR pairs, layout by layout."""
    found = []
    for layout in dict.fromkeys(image.sample.layout for image in images):
        ours = sorted(
            (image.sample.dbr_pairs, float((z**2).sum()), int(image.used.sum()))
            for image, z in zip(images, residuals, strict=True)
            if image.sample.layout == layout
        )
        found.append({
            "against": "pairs", "unit": "", "shot": f"{layout} chips", "dbr_pairs": None,
            "x": [one[0] for one in ours],
            "power": [one[1] / one[2] for one in ours],
            "band": [NORMAL_95 * (2.0 / one[2]) ** 0.5 for one in ours],
        })  # fmt: skip
    return found


def _plain(values: Real) -> list[float]:
    return [float(f"{value:.6g}") for value in values]
