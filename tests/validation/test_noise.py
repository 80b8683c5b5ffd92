"""Noise as it is drawn against noise as a model has it: moments of many draws, ends of the range, seeds."""

from __future__ import annotations

import numpy as np
import pytest

from luxloop.errors import InputError
from validation.dataset.manifest import CameraFacts
from validation.noise import draw, fixed_pattern, variance_dn2

CAMERA = CameraFacts(
    pixel_um=8.0, bit_depth=12, gain_dn_per_e=0.38, read_noise_e=6.0, full_well_e=10_000.0, black_level_dn=64.0
)
DRAWS = 2000
SIGNALS = np.repeat([[0.0], [3.0], [40.0], [900.0], [3000.0]], 60, axis=1)


def draws(camera: CameraFacts, frames: int = 1, count: int = DRAWS, signal: np.ndarray = SIGNALS) -> np.ndarray:
    """Many images (draw, row, column) of one camera, its pattern the same in all."""
    return np.stack([draw(signal, camera, seed=n, frames=frames, pattern_seed=7) for n in range(count)])


@pytest.mark.parametrize("frames", [1, 4])
def test_mean_and_variance_are_the_models(frames: int) -> None:
    """From darkness to 3000 DN, within five standard errors; frames divide the variance."""
    count = DRAWS // frames
    drawn = draws(CAMERA, frames, count) - CAMERA.black_level_dn
    expected = variance_dn2(SIGNALS, CAMERA, frames)[:, 0]
    pixels = count * SIGNALS.shape[1]
    assert np.all(np.abs(drawn.mean(axis=(0, 2)) - SIGNALS[:, 0]) < 5.0 * np.sqrt(expected / pixels))
    found = drawn.var(axis=0, ddof=1).mean(axis=1)
    assert np.all(np.abs(found / expected - 1.0) < 5.0 * np.sqrt(2.0 / pixels))


def test_the_fixed_pattern_is_one_pattern_in_all_images() -> None:
    """Means of many draws follow it pixel by pixel; between draws nothing is added to the variance."""
    camera = CAMERA.model_copy(update={"prnu_percent": 3.0})
    signal = np.full((6, 50), 2000.0)
    drawn = draws(camera, count=400, signal=signal) - camera.black_level_dn
    pattern = fixed_pattern(camera, signal.shape, 7)
    expected = variance_dn2(signal * pattern, camera)
    assert np.all(np.abs(drawn.mean(axis=0) - signal * pattern) < 5.0 * np.sqrt(expected / 400))
    assert drawn.var(axis=0, ddof=1).mean() == pytest.approx(expected.mean(), rel=5.0 * np.sqrt(2.0 / drawn.size))


def test_the_covariance_of_images_is_that_of_the_pattern() -> None:
    """Of two images with signals a and b of one unknown camera it is a b prnu^2, of two cameras 0."""
    camera = CAMERA.model_copy(update={"prnu_percent": 2.0})
    a, b = (np.full((64, 64), level) for level in (2500.0, 1500.0))
    products: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(60):
        one = draw(a, camera, seed=seed, shot=0) - camera.black_level_dn - a
        for same in products:
            other = draw(b, camera, seed=seed, shot=1, pattern_seed=seed if same else 10_000 + seed)
            products[same].append(float(np.mean(one * (other - camera.black_level_dn - b))))
    expected = 2500.0 * 1500.0 * 0.02**2
    for same, found in products.items():
        error = float(np.std(found)) / np.sqrt(len(found))
        assert abs(np.mean(found) - expected * same) < 5.0 * error
        assert error < 0.02 * expected


def test_a_camera_without_prnu_has_no_pattern() -> None:
    """All its pixels are alike; otherwise the pattern is a seed's own, with its rms."""
    assert np.all(fixed_pattern(CAMERA, (4, 4), 1) == 1.0)
    camera = CAMERA.model_copy(update={"prnu_percent": 1.0})
    one, other = (fixed_pattern(camera, (300, 300), seed) for seed in (1, 2))
    assert one.std() == pytest.approx(0.01, rel=0.02)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.02


def test_numbers_are_whole_and_end_at_full_well_and_full_scale() -> None:
    """A frame has whole numbers; a full pixel ends at K x full well, a large one at 2^bits - 1, a black one at 0."""
    full = np.full((20, 20), 9000.0)
    at_well = draw(full, CAMERA, seed=1)
    assert np.array_equal(at_well, np.rint(at_well))
    assert at_well.mean() == pytest.approx(64.0 + 0.38 * 10_000.0, abs=1.0)
    large = CAMERA.model_copy(update={"full_well_e": 1e6})
    assert np.all(draw(full, large, seed=1) == 4095.0)
    dark = CAMERA.model_copy(update={"black_level_dn": 0.0})
    assert draw(0.0 * full, dark, seed=1).min() == 0.0
    averaged = draw(np.full((20, 20), 100.0), CAMERA, seed=1, frames=4)
    assert np.array_equal(4.0 * averaged, np.rint(4.0 * averaged))
    assert not np.array_equal(averaged, np.rint(averaged))


def test_a_seed_gives_the_same_image_and_shots_differ() -> None:
    """To the last bit; another seed or shot is another draw."""
    signal = np.full((8, 8), 500.0)
    one = draw(signal, CAMERA, seed=3, shot=1)
    assert np.array_equal(one, draw(signal, CAMERA, seed=3, shot=1))
    for other in (draw(signal, CAMERA, seed=4, shot=1), draw(signal, CAMERA, seed=3, shot=2)):
        assert not np.array_equal(one, other)


@pytest.mark.parametrize("signal", [np.full((2, 2), -1.0), np.full((2, 2), np.nan), np.zeros(3)])
def test_what_is_no_expected_signal_is_refused(signal: np.ndarray) -> None:
    """Negative, not finite, not an image; and no frame at all."""
    with pytest.raises(InputError, match="signal_dn"):
        draw(signal, CAMERA, seed=1)
    with pytest.raises(InputError, match="frames"):
        draw(np.zeros((2, 2)), CAMERA, seed=1, frames=0)
