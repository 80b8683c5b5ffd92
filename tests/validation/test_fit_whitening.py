"""Whitening takes out the covariance that noise has: pattern and shared dark included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.analytic import SINGLE, blank
from validation.fit.model_noise import noise_blocks
from validation.fit.whitening import variance_scale, variance_scales, whitening


def _images(prnu=0.02, dark=None, count=3):
    images = [blank(f"i{k}", SINGLE, 3, prnu=prnu) for k in range(count)]
    if dark is None:
        return images
    shot = [image.shot.model_copy(update={"dark": dark}) for image in images]
    return [
        replace(image, shot=one, dark_dn2=0.0 * one_like(image) + 10.0)
        for image, one in zip(images, shot, strict=True)
    ]


def one_like(image):
    """An array of the image's shape."""
    return np.ones(image.used.shape)


def _covariance(images, signals, row, column):
    """Of one pixel over the images, written out."""
    s = np.array([signal[row, column] for signal in signals])
    diagonal = [image.variance_dn2(signal)[row, column] for image, signal in zip(images, signals, strict=True)]
    prnu = np.array([image.prnu for image in images])
    covariance = np.diag(diagonal) + np.outer(prnu * s, prnu * s)
    if images[0].shot.dark is not None:
        d = np.sqrt([image.dark_dn2[row, column] for image in images])
        covariance += np.outer(d, d) - np.diag(d**2)
    return covariance


@pytest.mark.parametrize(("prnu", "dark"), [(0.0, None), (0.02, None), (0.0, "d.tif"), (0.02, "d.tif")])
def test_whitened_noise_has_unit_covariance(prnu, dark):
    """W S W' is the identity, pixel by pixel."""
    images = _images(prnu, dark)
    random = np.random.default_rng(1)
    signals = [random.uniform(100.0, 3000.0, (3, 3)) for _ in images]
    white = whitening(images, signals)
    unit = np.eye(3)[:, :, None, None] * np.ones((3, 3))
    matrix = np.array(white.images([unit[k] for k in range(3)]))  # (image, unit, row, column)
    for row, column in np.ndindex(3, 3):
        w = matrix[:, :, row, column]
        np.testing.assert_allclose(w @ _covariance(images, signals, row, column) @ w.T, np.eye(3), atol=1e-10)


@pytest.mark.parametrize("prnu", [0.0, 0.02])
def test_noise_of_a_prediction_is_whitened_with_the_cameras(prnu):
    """W (S + N'N) W' is the identity over all pixels of all images; images of one sample err together."""
    images, random = _images(prnu), np.random.default_rng(2)
    signals = [random.uniform(100.0, 3000.0, (3, 3)) for _ in images]
    noise = [random.normal(0.0, 30.0, (4, 3, 3)), None, random.normal(0.0, 30.0, (4, 3, 3))]
    camera = whitening(images, signals)
    for samples in (("a", "a", "a"), ("a", "b", "c")):
        white = replace(camera, noise=noise_blocks(camera, samples, noise))
        covariance = np.zeros((27, 27))
        for row, column in np.ndindex(3, 3):
            place = 3 * row + column + 9 * np.arange(3)
            covariance[np.ix_(place, place)] = _covariance(images, signals, row, column)
        first, last = (one.reshape(4, 9).T for one in (noise[0], noise[2]))
        wide = np.zeros((27, 8))
        wide[:9, :4] = first
        wide[18:, (slice(0, 4) if samples[2] == "a" else slice(4, 8))] = last
        unit = np.eye(27).reshape(27, 3, 3, 3)
        matrix = white.rows([unit[:, k] for k in range(3)]).T
        np.testing.assert_allclose(matrix @ (covariance + wide @ wide.T) @ matrix.T, np.eye(27), atol=1e-9)


def test_unused_pixels_weigh_nothing():
    """A masked pixel's value changes no row, its own or another image's, however wild it is."""
    images = _images()
    used = images[1].used.copy()
    used[1, 1] = False
    images[1] = replace(images[1], used=used)
    white = whitening(images, [1000.0 * one_like(image) for image in images])
    data = [np.random.default_rng(2).standard_normal((3, 3)) for _ in images]
    before = white.rows(data)
    data[1] = np.where(used, data[1], 1e9)
    np.testing.assert_array_equal(white.rows(data), before)
    assert len(before) == white.count == 26


def test_order_of_images_does_not_matter():
    """Whitening the images in another order gives the same maps."""
    images = _images(0.05)
    signals = [(1.0 + k) * 500.0 * one_like(image) for k, image in enumerate(images)]
    data = [np.random.default_rng(k).standard_normal((3, 3)) for k in range(3)]
    forth = whitening(images, signals).images(data)
    back = whitening(images[::-1], signals[::-1]).images(data[::-1])[::-1]
    np.testing.assert_allclose(forth, back, rtol=1e-12)


def test_rows_unfold_to_the_images_they_came_from():
    """Unfolding rows gives the whitened maps, zero where unused."""
    images = _images()
    images[0] = replace(images[0], used=np.eye(3) > 0.0)
    data = [np.random.default_rng(k).standard_normal((3, 3)) for k in range(3)]
    white = whitening(images, [one_like(image) for image in images])
    for one, other in zip(white.unfold(white.rows(data)), white.images(data), strict=True):
        np.testing.assert_array_equal(one, other)


def test_variance_comes_from_the_prediction():
    """The whitening of a prediction knows no data: only the signal that is handed in."""
    images = _images(0.0)
    changed = [replace(image, signal_dn=image.signal_dn + 500.0) for image in images]
    signals = [1000.0 * one_like(image) for image in images]
    np.testing.assert_array_equal(whitening(images, signals).weight, whitening(changed, signals).weight)


def test_no_variance_is_refused():
    """A used pixel without any noise is refused with its value."""
    images = [replace(image, constant_dn2=0.0 * one_like(image)) for image in _images()]
    with pytest.raises(ValueError, match="must be above 0"):
        whitening(images, [0.0 * one_like(image) for image in images])


def test_variance_scale_lies_between_prior_and_data():
    """With few rows the prior holds it at 1, with many the data do."""
    assert variance_scale(11.0, 10.0) == pytest.approx(1.0, abs=2e-3)
    assert variance_scale(1.1e7, 1e7) == pytest.approx(1.1, abs=1e-4)
    np.testing.assert_allclose(variance_scales(np.array([1e4]), 1e4), 1.0, atol=1e-9)


def test_a_variance_scale_is_the_mean_of_those_that_would_have_left_as_much():
    """Of scales drawn from the prior, each with a chi2 of 1,000 degrees, those where it came to 1,100."""
    random = np.random.default_rng(1)
    log_v = 0.03 * random.standard_normal(1_000_000)
    chi2 = np.exp(log_v) * random.chisquare(1000.0, log_v.size)
    like = log_v[np.abs(chi2 - 1100.0) < 10.0]
    assert len(like) > 5000
    assert np.log(variance_scale(1100.0, 1000.0)) == pytest.approx(like.mean(), abs=0.002)
