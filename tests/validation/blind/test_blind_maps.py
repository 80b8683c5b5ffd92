"""Maps of the blind truth: what is convolved, smoothed and laid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import convolve2d

from validation.blind import maps


def test_bounces_do_not_come_round_to_the_other_side() -> None:
    """A kernel with long tails, light at one rim: as scipy's direct sum has it, to rounding, the far rim too."""
    grid = maps.grid_for(160.0, 300.0)
    wide = grid.twice()
    assert (wide.size, wide.step_um, wide.height_um) == (2 * grid.size, grid.step_um, grid.height_um)
    y, x = wide.at_um[:, None], wide.at_um
    tally = (1.0 / (160.0**2 + y**2 + x**2) ** 2)[None]
    tally /= tally.sum()
    transform = maps.transform_of_kernel(tally, wide)
    light = np.zeros((grid.size, grid.size))
    light[3, 5] = 2.0
    found = maps.convolved(light, transform)
    assert found.shape == (1, grid.size, grid.size)
    # the kernel between bins is its samples half a bin off, without what a bin takes: the same by its own transform
    kernel = np.fft.fftshift(np.fft.ifft2(_whole(transform[0], wide.size)).real)
    n = grid.size
    direct = convolve2d(light, kernel[1:, 1:], mode="full")[n - 1 : 2 * n - 1, n - 1 : 2 * n - 1]
    np.testing.assert_allclose(found[0], direct, atol=1e-12 * direct.max())
    far = found[0, 3, -1] / found[0, 3, 5]
    distance_um = (n - 1 - 5) * grid.step_um
    assert far == pytest.approx((1.0 + (distance_um / 160.0) ** 2) ** -2, rel=0.03)


def _whole(transform: np.ndarray, size: int) -> np.ndarray:
    """All waves of a real transform that has those of rfft2."""
    return np.fft.fft2(np.fft.irfft2(transform, (size, size)))


def test_light_that_is_smooth_stays_what_it_is_near_a_chip_and_far_from_it() -> None:
    """A wide hill passes both cuts; a kink is kept near a chip and rounded far from it."""
    grid = maps.grid_for(160.0, 900.0)
    y, x = grid.at_um[:, None], grid.at_um
    hill = np.exp(-(x**2 + y**2) / (2.0 * 120.0**2))[None] * grid.step_um**2
    np.testing.assert_allclose(maps.smooth_about_chip(hill, grid), maps.smooth(hill, grid), atol=1e-6)
    kink = np.maximum(0.0, 1.0 - np.hypot(x, y) / 20.0)[None] * grid.step_um**2
    peak = np.unravel_index(int(kink.argmax()), kink.shape)
    assert maps.smooth_about_chip(kink, grid)[peak] > 1.5 * maps.smooth(kink, grid)[peak]
