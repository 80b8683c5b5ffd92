"""A texture finer than blocks is found, by its length and direction; noise, however loud, is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tests.validation.test_contrasts_structure import DRAWS, _found, _images, _sd, _with
from validation.contrasts.periodic import COARSEST, PERIODIC, Pattern, patterns_of
from validation.contrasts.places import Picture, module_coordinates_um
from validation.prediction import Pose

SHAPE, PIXEL_UM = (42, 40), 24.0


def pictures(count: int, shape: tuple[int, int] = SHAPE, seed: int | None = None) -> list[Picture]:
    """Images of one grid; by a seed some of their pixels are not used."""
    y, x = (np.asarray(one, float) * PIXEL_UM for one in np.indices(shape))
    random = np.random.default_rng(seed)
    return [
        Picture(
            id=f"image-{number}",
            used=np.ones(shape, bool) if seed is None else random.random(shape) < 0.9,
            pixel_um=PIXEL_UM,
            x_um=x,
            y_um=y,
            chips_um=np.zeros((1, 2)),
            grid=0,
        )
        for number in range(count)
    ]


def pattern(count: int, seed: int | None = None) -> tuple[Pattern, int]:
    """Of so many images, and how many rows a residual of them has."""
    several = pictures(count, seed=seed)
    (found,) = patterns_of(several)
    return found, sum(int(one.used.sum()) for one in several)


@pytest.mark.parametrize(("images", "seed"), [(1, None), (2, 5), (6, None)])
def test_of_noise_the_largest_has_its_chance(images: int, seed: int | None) -> None:
    """z of 1,500 draws of white noise is normal: by Kolmogorov and Smirnov, and its tail is not heavier."""
    of, rows = pattern(images, seed)
    random = np.random.default_rng(2)
    z = np.array([of.loudest(random.standard_normal(rows)).z for _ in range(1500)])
    assert stats.kstest(z, "norm").pvalue > 1e-3
    assert np.mean(z > stats.norm.isf(0.01)) < 0.018
    assert abs(z.mean()) < 0.15


def test_power_is_one_of_each_image_and_where_blocks_see_none() -> None:
    """White noise of any size: 1 on average in every ring; coarse, mirrored and real frequencies have no vote."""
    of, rows = pattern(3)
    residual = np.random.default_rng(1).standard_normal(rows)
    power = of.power(residual)
    for ring in range(1, of.rings.max() + 1):
        assert power[of.rings == ring].mean() == pytest.approx(3.0, rel=1e-12)
    np.testing.assert_allclose(of.power(7.0 * residual), power, rtol=1e-12)
    many = [of.power(np.random.default_rng(seed).standard_normal(rows)) for seed in range(300)]
    mean = np.mean(many, axis=0)[of.rings > 0]
    assert np.abs(mean - 3.0).max() < 5.0 * np.sqrt(3.0 / 300)  # whatever blocks leave of each
    fy, fx = of.frequencies
    assert not power[np.broadcast_to(np.maximum(np.abs(fy), fx) <= COARSEST, power.shape)].any()
    votes = list(zip(*np.nonzero(of.rings), strict=True))
    whole = {(int(row), int(column)) for row, column in votes}
    assert all(((-row) % SHAPE[0], (-column) % SHAPE[1]) not in whole for row, column in whole)


@pytest.mark.parametrize(("length_um", "degrees"), [(62.0, 50.0), (62.0, -35.0), (80.0, 0.0), (56.0, 90.0)])
def test_a_wave_is_named_by_its_length_and_direction(length_um: float, degrees: float) -> None:
    """Of 200 of chi2 in six images, moved from image to image: to a frequency of the images, and far above noise."""
    of, rows = pattern(6)
    random, several = np.random.default_rng(3), pictures(6)
    along = 2.0 * np.pi / length_um * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    waves = [np.cos(along[0] * one.x_um + along[1] * one.y_um + random.uniform(0.0, 6.0)) for one in several]
    wave = np.concatenate([one.ravel() for one in waves])
    found = of.loudest(random.standard_normal(rows) + np.sqrt(200.0 / (wave @ wave)) * wave)
    assert found.z > 5.0
    assert found.length_um == pytest.approx(length_um, rel=0.04)
    assert abs((found.direction_deg - degrees + 90.0) % 180.0 - 90.0) < 3.0
    assert f"{found.length_um:.3g} um long" in found.words


@pytest.mark.parametrize("level", [0.0, 1e-6, 0.01])
def test_rounding_and_what_the_model_errs_by_have_no_vote(level: float) -> None:
    """A residual of next to nothing, or of nothing, is no pattern, however regular."""
    of, rows = pattern(3)
    x = np.concatenate([one.x_um.ravel() for one in pictures(3)])
    assert of.loudest(level * np.cos(2.0 * np.pi / 60.0 * x)).z < 1.0
    assert of.loudest(np.full(rows, level)).z < 0.0


@pytest.mark.parametrize("seed", [None, 5])
def test_what_blocks_see_is_no_fine_pattern(seed: int | None) -> None:
    """Steps, slopes and a level of several standard deviations, pixels unused or not: z is as of the noise alone."""
    several, (of, rows) = pictures(3, seed=seed), pattern(3, seed)
    noise = np.random.default_rng(4).standard_normal(rows)
    alone = of.loudest(noise).z
    y = np.concatenate([one.y_um[one.used] for one in several])
    slope = 6.0 * (y / y.max() - 0.5)
    assert of.loudest(noise + slope).z < max(alone, 0.0) + 1.0
    assert of.loudest(noise + 3.0).z == pytest.approx(alone, abs=1e-6)


def test_each_grid_has_its_own_and_small_images_have_none() -> None:
    """Two grids: two patterns, each with its own rows; of 6 x 6 pixels no ring has enough frequencies."""
    first, second = pictures(2), [replace(one, grid=1) for one in pictures(3, (30, 30))]
    one, other = patterns_of([first[0], second[0], first[1], *second[1:]])
    size, small = SHAPE[0] * SHAPE[1], 900
    assert one.rows == (slice(0, size), slice(size + small, 2 * size + small))
    assert (len(other.rows), other.rows[0]) == (3, slice(size, size + small))
    assert patterns_of(pictures(2, (6, 6))) == ()


def test_a_texture_that_blocks_cannot_see_is_found_in_images() -> None:
    """Half of a pixel's noise, three images of two modules: p as small as it gets, the place says what repeats."""
    images = _images()
    for number, image in enumerate(images):
        x_um, y_um = module_coordinates_um(image, Pose())
        along = 0.64 * np.cos(np.radians(40.0)) * x_um + 0.64 * np.sin(np.radians(40.0)) * y_um
        wave = np.cos(along * 2.0 * np.pi / (1.6 * image.pixel_um))
        images = _with(images, number, 0.6 * _sd(image) * wave)
    found = _found(images)
    assert found.p_text == f"< 1/{DRAWS}"
    assert found.where[0].family == PERIODIC
    assert found.where[0].shot is None
    assert found.where[0].place.startswith("waves ")
    assert found.where[0].place.endswith("all images together")
    assert found.where[0].z == found.statistic


def test_a_wrong_read_noise_has_no_vote_there() -> None:
    """Half as much noise again in one image, pixel by pixel: its waves stay those of noise."""
    images = _images()
    noise = np.random.default_rng(3).standard_normal((24, 24))
    found = _found(_with(images, 2, 1.1 * noise * _sd(images[2])))
    (wave,) = (region for region in found.where if region.family == PERIODIC)
    assert abs(wave.z) < 3.0
