"""The far field: isotropic is flat, Lambert is cos theta, the total is the flux, symmetry and errors are right."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from containers.ray_tracing.far_field import FarField, far_field, luminous_flux_lm
from luxloop.errors import InputError

GROUPS, HISTORIES, ROWS, COLUMNS = 32, 4000, 20, 16
Real = NDArray[np.float64]


def histogram(cosine: Real, phi: Real, lowest_cos: float, rows: int = ROWS, columns: int = COLUMNS) -> Real:
    """(group, cos theta, phi) counts of directions (group, history), by numpy's own histogram."""
    edges = (np.linspace(lowest_cos, 1.0, rows + 1), np.linspace(0.0, 2.0 * np.pi, columns + 1))
    return np.stack([np.histogram2d(c, p, bins=edges)[0] for c, p in zip(cosine, phi, strict=True)])


def isotropic(seed: int = 1) -> FarField:
    """Unit weights, uniform on the sphere."""
    rng = np.random.default_rng(seed)
    draws = rng.random((2, GROUPS, HISTORIES))
    return far_field(histogram(2.0 * draws[0] - 1.0, 2.0 * np.pi * draws[1], -1.0), HISTORIES, -1.0)


def lambertian(seed: int = 1) -> FarField:
    """Unit weights, cosine-distributed over the upper half."""
    rng = np.random.default_rng(seed)
    draws = rng.random((2, GROUPS, HISTORIES))
    return far_field(histogram(np.sqrt(draws[0]), 2.0 * np.pi * draws[1], 0.0), HISTORIES)


def smooth(shape: Real) -> FarField:
    """A noise-free far field of the upper half with these intensities (cos theta, phi)."""
    bin_sr = 2.0 * np.pi / shape.size
    return far_field(np.stack([shape, shape]) * bin_sr, 1)


def misses(found: Real, expected: Real | float, error: Real) -> float:
    """Root mean square of the difference in units of the stated errors: 1 where they are right."""
    return float(np.sqrt(np.mean(((found - expected) / error) ** 2)))


def test_the_total_is_what_left() -> None:
    """The integral over the sphere is the weight per history, whatever the distribution, and exactly so."""
    weights = np.random.default_rng(3).random((4, 6, 8))
    flux, error = far_field(weights, 10, -1.0).flux()
    each = weights.sum(axis=(1, 2)) / 10
    assert flux == pytest.approx(each.mean(), rel=1e-12)
    assert error == pytest.approx(np.std(each, ddof=1) / 2.0, rel=1e-12)


def test_an_isotropic_source_is_flat() -> None:
    """1 / 4 pi in every bin, curve and cut, within the stated errors; all of it leaves."""
    field = isotropic()
    flat = 1.0 / (4.0 * np.pi)
    assert 0.9 < misses(field.intensity_per_sr, flat, field.standard_error_per_sr) < 1.15
    for curve in (field.curve(), *field.cuts().values()):
        assert 0.6 < misses(curve.intensity_per_sr, flat, curve.standard_error_per_sr) < 1.5
    assert field.flux()[0] == pytest.approx(1.0, rel=1e-12)


def test_a_lambertian_source_is_a_cosine() -> None:
    """cos theta / pi in every bin, curve and cut, within the stated errors."""
    field = lambertian()
    cosine = field.cos_theta[:, None] / np.pi
    assert 0.9 < misses(field.intensity_per_sr, cosine, field.standard_error_per_sr) < 1.15
    for curve in (field.curve(), *field.cuts().values()):
        expected = np.cos(curve.theta_rad) / np.pi
        assert 0.6 < misses(curve.intensity_per_sr, expected, curve.standard_error_per_sr) < 1.5


def test_a_curve_begins_at_the_receiver() -> None:
    """Theta ascends from +z, and light that goes up is at its beginning."""
    weights = np.zeros((2, 4, 4))
    weights[:, -1, :] = 1.0
    curve = far_field(weights, 1, -1.0).curve()
    assert np.all(np.diff(curve.theta_rad) > 0.0)
    assert curve.theta_rad[0] < np.pi / 4
    assert curve.intensity_per_sr[0] > 0.0
    assert np.all(curve.intensity_per_sr[1:] == 0.0)


def test_cuts_look_along_their_azimuth() -> None:
    """A lobe towards +y is in the cut at 90 degrees, one towards the diagonal in that at 45; 360 degrees are 0."""
    weights = np.zeros((2, 4, 16))
    weights[:, :, 3:5] = 1.0  # about phi = 90 deg
    field = far_field(weights, 1)
    assert field.cut(90.0).intensity_per_sr.min() > 0.0
    assert field.cut(0.0).intensity_per_sr.max() == 0.0
    assert field.cut(180.0).intensity_per_sr.max() == 0.0
    assert np.array_equal(field.cut(450.0).intensity_per_sr, field.cut(90.0).intensity_per_sr)
    assert list(field.cuts()) == [0.0, 45.0, 90.0]


def test_folding_makes_exactly_symmetric_and_keeps_the_flux() -> None:
    """After it quarter turns and mirrors change nothing, each group has its flux, and folding again does nothing."""
    field = far_field(np.random.default_rng(5).random((3, 4, 24)), 7, -1.0)
    once = field.folded()
    values = once.groups_per_sr
    assert np.array_equal(values, np.roll(values, 6, axis=2))
    assert np.array_equal(values, values[:, :, ::-1])
    assert np.allclose(values.sum(axis=(1, 2)), field.groups_per_sr.sum(axis=(1, 2)), rtol=1e-14)
    assert np.allclose(once.folded().groups_per_sr, values, rtol=1e-15)


def test_folding_lowers_the_error_of_independent_bins() -> None:
    """Eight images of a bin: the error falls by about the root of eight, and is still true."""
    field = isotropic(2)
    folded = field.folded()
    gain = field.standard_error_per_sr.mean() / folded.standard_error_per_sr.mean()
    assert gain == pytest.approx(np.sqrt(8.0), rel=0.1)
    flat = 1.0 / (4.0 * np.pi)
    assert 0.8 < misses(folded.intensity_per_sr, flat, folded.standard_error_per_sr) < 1.25


def test_a_field_that_is_symmetric_is_not_changed_by_folding() -> None:
    """cos(4 phi) has the symmetry of a square, cos(2 phi) has not and folds away."""
    phi = 2.0 * np.pi * (np.arange(32) + 0.5) / 32
    square, oblong = (
        smooth(np.tile(2.0 + np.cos(4.0 * phi), (4, 1))),
        smooth(np.tile(2.0 + np.cos(2.0 * phi), (4, 1))),
    )
    assert np.allclose(square.folded().intensity_per_sr, square.intensity_per_sr, rtol=1e-14)
    assert np.allclose(oblong.folded().intensity_per_sr, 2.0, rtol=1e-14)


@settings(derandomize=True, max_examples=30)
@given(st.integers(2, 30), st.integers(1, 30), st.sampled_from([0.0, -1.0]))
def test_the_bins_tile_their_directions(rows: int, columns: int, lowest_cos: float) -> None:
    """Solid angles add up to 2 pi or 4 pi, middles lie inside and evenly."""
    field = far_field(np.ones((2, rows, columns)), 1, lowest_cos)
    assert field.bin_sr * rows * columns == pytest.approx(2.0 * np.pi * (1.0 - lowest_cos))
    assert field.cos_theta.mean() == pytest.approx((1.0 + lowest_cos) / 2.0)
    assert field.phi_rad.mean() == pytest.approx(np.pi)


def test_interpolation_is_exact_for_a_lambertian_field() -> None:
    """Linear in cos theta: right in every direction, poles and horizon included."""
    rows = (np.arange(10) + 0.5) / 10
    field = smooth(np.repeat(rows[:, None], 8, axis=1))
    theta, phi = np.linspace(0.0, np.pi / 2, 41), np.linspace(-7.0, 7.0, 11)
    assert np.allclose(field.at(theta[:, None], phi[None, :]), np.cos(theta)[:, None], atol=1e-12)


def test_a_pole_has_one_value() -> None:
    """At theta = 0, and at pi on the sphere, the intensity does not depend on phi."""
    field = far_field(np.random.default_rng(1).random((2, 6, 8)), 1, -1.0)
    for pole in (0.0, np.pi):
        assert np.ptp(field.at(pole, np.linspace(0.0, 6.0, 9))) < 1e-14


def test_interpolation_hits_the_middles_and_goes_round() -> None:
    """At the middle of a bin its own value; across phi = 0 the neighbours' mean; never below 0."""
    values = np.random.default_rng(2).random((5, 12))
    field = smooth(values)
    theta = np.arccos(field.cos_theta)
    assert np.allclose(field.at(theta[:, None], field.phi_rad[None, :]), values, rtol=1e-12)
    assert np.allclose(field.at(theta, 0.0), 0.5 * (values[:, 0] + values[:, -1]), rtol=1e-12)
    steep = smooth(np.array([[0.0] * 4, [1.0] * 4, [0.0] * 4]))
    assert steep.at(np.array([0.0, np.pi / 2]), 0.0).min() == 0.0


def test_candela_of_an_isotropic_chip() -> None:
    """1 W at 555 nm is 683 lm (K_m), spread over 4 pi: 54.35 cd."""
    flux_lm = luminous_flux_lm(1.0, 555.0, 0.1)
    assert flux_lm == pytest.approx(683.0, rel=1e-3)
    weights = np.ones((2, 4, 4)) / 16
    assert far_field(weights, 1, -1.0).intensity_per_sr[0, 0] * flux_lm == pytest.approx(54.35, rel=1e-3)


@pytest.mark.parametrize(
    ("weights", "histories", "lowest_cos", "field"),
    [
        (np.ones((1, 4, 4)), 1, 0.0, "weights"),
        (np.ones((4, 4)), 1, 0.0, "weights"),
        (np.ones((2, 1, 4)), 1, 0.0, "weights"),
        (-np.ones((2, 4, 4)), 1, 0.0, "weights"),
        (np.full((2, 4, 4), np.nan), 1, 0.0, "weights"),
        (np.ones((2, 4, 4)), 0, 0.0, "histories"),
        (np.ones((2, 4, 4)), 1, 0.5, "lowest_cos"),
    ],
)
def test_a_histogram_that_cannot_be(weights: Real, histories: int, lowest_cos: float, field: str) -> None:
    """One group has no error, nan is no weight, and the rest."""
    with pytest.raises(InputError, match=field):
        far_field(weights, histories, lowest_cos)


def test_directions_and_columns_that_are_not_held() -> None:
    """No direction below the horizon of the upper half, no folding of six columns, no flux of zero."""
    field = far_field(np.ones((2, 4, 6)), 1)
    with pytest.raises(InputError, match="theta_rad"):
        field.at(2.0, 0.0)
    with pytest.raises(InputError, match="phi bins"):
        field.folded()
    with pytest.raises(InputError, match="phi_deg"):
        field.cut(float("nan"))
    with pytest.raises(InputError, match="flux_w"):
        luminous_flux_lm(0.0, 445.0, 18.0)
