"""Monte Carlo's noise in images, told by smooth functions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.ray_tracing.twin.noise import MOST_FUNCTIONS, NoiseBasis, most_functions, noise_columns, solved

Real = NDArray[np.float64]
REACH_UM, HEIGHT_UM = 500.0, 160.0


def places(shift_um: float = 0.0, count: int = 24) -> tuple[Real, Real]:
    """x and y of pixels, (row, column) each."""
    u = np.linspace(-480.0, 480.0, count) + shift_um
    return np.meshgrid(u, u)


def light(x_um: Real, y_um: Real) -> Real:
    """A spot as of one chip."""
    return np.asarray((1.0 + (x_um**2 + y_um**2) / HEIGHT_UM**2) ** -2)


def basis(
    shift_um: float = 0.0, *, symmetric: bool = True, like: NoiseBasis | None = None, most: int = MOST_FUNCTIONS
) -> NoiseBasis:
    """Of an image whose pixels are shifted."""
    x_um, y_um = places(shift_um)
    seen = light(x_um, y_um)
    return NoiseBasis.at(x_um, y_um, seen, REACH_UM, HEIGHT_UM, symmetric=symmetric, most=most, like=like)


def drawn(of: NoiseBasis, groups: int, seed: int) -> tuple[Real, Real]:
    """Images (group, row, column) of noise with a spectrum of its own, and its variances by function."""
    rng = np.random.default_rng(seed)
    variance = np.linspace(2.0, 1.0, len(of.factor))
    amplitude = rng.standard_normal((groups, len(variance))) * np.sqrt(variance)
    orthogonal = np.linalg.solve(of.factor, of.functions)
    return (amplitude @ orthogonal).reshape(groups, 24, 24), variance


@pytest.mark.parametrize("count", [1, 63, 64, 65, 200])
def test_a_triangle_is_solved_as_by_a_general_solver(count: int) -> None:
    """By blocks, of any number of functions; what is given stays as it is."""
    rng = np.random.default_rng(count)
    factor, right = np.tril(rng.normal(size=(count, count)), -1) / count + np.eye(count), rng.normal(size=(count, 7))
    given = right.copy()
    np.testing.assert_allclose(solved(factor, right), np.linalg.solve(factor, right), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(right, given)


def test_functions_that_say_nothing_of_their_own_are_left_out_and_the_others_are_orthogonal() -> None:
    """More functions than 24 x 24 pixels can tell apart: those told are whole, and orthogonal under the weight."""
    of = basis(symmetric=False, most=1000)
    assert 100 < len(of.told) < 577
    orthogonal = solved(of.factor, of.functions) * np.sqrt(of.weight)
    np.testing.assert_allclose(orthogonal @ orthogonal.T, np.eye(len(of.told)), atol=1e-9)


def test_columns_have_the_variance_of_the_noise() -> None:
    """32 groups: the variance of every pixel is met to a quarter, its mean over the image to a tenth."""
    of = basis()
    deviations, variance = drawn(of, 32, 5)
    columns = noise_columns(deviations / np.sqrt(32), of, of)
    orthogonal = np.linalg.solve(of.factor, of.functions).reshape(-1, 24, 24)
    truth = (variance[:, None, None] * orthogonal**2).sum(axis=0)
    found = (columns**2).sum(axis=0)
    np.testing.assert_allclose(found, truth, rtol=0.3)
    assert abs(np.mean(found / truth) - 1.0) < 0.1


def test_the_strength_from_the_centre_outwards_is_that_of_the_groups() -> None:
    """Noise twice as strong at the centre and half at the edge, beside what the light says: told as it is."""
    of = basis()
    deviations, _ = drawn(of, 32, 9)
    x_um, y_um = places()
    stronger = np.sqrt(2.0 - 1.5 * (x_um**2 + y_um**2) / (2.0 * 480.0**2))
    plain, found = (noise_columns(one / np.sqrt(32), of, of) for one in (deviations, stronger * deviations))
    ratio = (found**2).sum(axis=0) / (plain**2).sum(axis=0)
    np.testing.assert_allclose(ratio, stronger**2, rtol=0.25)


def test_more_ways_to_err_than_groups_are_all_covered() -> None:
    """Products of the groups alone would leave most of a fresh draw's energy out; the columns cover it."""
    of = basis()
    deviations, _ = drawn(of, 32, 6)
    (fresh,), _ = drawn(of, 1, 7)
    columns = noise_columns(deviations / np.sqrt(32), of, of).reshape(len(of.factor), -1)
    assert len(columns) > 64
    amplitude = np.linalg.lstsq(columns.T, fresh.ravel(), rcond=None)[0]
    np.testing.assert_allclose(columns.T @ amplitude, fresh.ravel(), atol=1e-6 * np.abs(fresh).max())
    assert np.mean(amplitude**2) < 1.6  # each times a unit normal number


def test_two_views_of_a_module_see_the_same_noise() -> None:
    """A column is one function of the place: shifted pixels see it where they look."""
    first = basis()
    shifted = basis(40.0, like=first)
    deviations, _ = drawn(first, 32, 8)
    at, beside = noise_columns(deviations, first, first), noise_columns(deviations, shifted, first)
    whole = 40.0 / (960.0 / 23)
    near = at[:, 5:-5, 5:-5] * (1.0 - whole) + at[:, 5:-5, 6:-4] * whole
    rows = beside[:, 5:-5, 5:-5]
    low = slice(0, 10)  # linear interpolation along x is good for the widest waves only, and y moved too
    along_y = near[:, :-1] * (1.0 - whole) + near[:, 1:] * whole
    np.testing.assert_allclose(rows[low, :-1], along_y[low], atol=0.03 * np.abs(at[low]).max())


def test_functions_follow_the_symmetries_and_stay_few() -> None:
    """A square module's functions are alike under all eight; another one's are not; both are at most 200."""
    square, other = basis(), basis(symmetric=False)
    maps = square.functions.reshape(-1, 24, 24)
    for turned in (maps[:, ::-1], maps[:, :, ::-1], maps.transpose(0, 2, 1)):
        np.testing.assert_allclose(turned, maps, atol=1e-9)
    assert len(square.functions) <= MOST_FUNCTIONS
    assert len(other.functions) <= MOST_FUNCTIONS
    odd = other.functions.reshape(-1, 24, 24)
    assert np.abs(odd + odd[:, :, ::-1]).max(axis=(1, 2)).min() < 1e-9


def test_noise_without_the_symmetries_has_all_its_waves() -> None:
    """200 functions leave out half of the energy of noise that is alike in all of them; all that there are, none."""
    assert most_functions(42 * 42 * 6, symmetric=False) > 961  # as many as a module 5 x 5 has
    assert most_functions(42 * 42 * 6, symmetric=True) == MOST_FUNCTIONS
    assert most_functions(10**9, symmetric=False) == MOST_FUNCTIONS
    whole = basis(symmetric=False, most=most_functions(24 * 24, symmetric=False))
    assert len(whole.factor) > 2 * MOST_FUNCTIONS
    (noise,), _ = drawn(whole, 1, 4)
    left = []
    for of in (basis(symmetric=False), whole):
        functions = np.linalg.qr((of.functions * np.sqrt(of.weight)).T)[0]
        seen = noise.ravel() * np.sqrt(of.weight)
        left.append(1.0 - np.sum((functions.T @ seen) ** 2) / np.sum(seen**2))
    assert left[0] > 0.4
    assert left[1] < 1e-6
