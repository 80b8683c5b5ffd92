"""From bins to a smooth field: what goes in comes out, and what is left out is bounded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.special import k1

from containers.ray_tracing.field import (
    CUTOFF,
    CUTOFF_X,
    CellField,
    ModuleField,
    lambert_transform,
    mode_count,
)
from luxloop.errors import InputError

Real = NDArray[np.float64]
S, HEIGHT = 500.0, 145.0


def point_irradiance(x_um: Real, y_um: Real, chips_um: Real, height_um: float) -> Real:
    """Irradiance (y, x), 1/um^2, under Lambertian points of unit flux: h^2 / (pi (r^2 + h^2)^2)."""
    r2 = (x_um[None, :, None] - chips_um[:, 0]) ** 2 + (y_um[:, None, None] - chips_um[:, 1]) ** 2
    total: Real = (height_um**2 / np.pi / (r2 + height_um**2) ** 2).sum(axis=-1)
    return total


def lattice_um(columns: int, rows: int, pitch_um: float) -> Real:
    """Places (chip, 2) of an array about (0, 0)."""
    x, y = (pitch_um * (np.arange(n) - (n - 1) / 2.0) for n in (columns, rows))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def bin_means(x_um: Real, y_um: Real, chips_um: Real, height_um: float, fine: int) -> Real:
    """Means of the irradiance over bins of `fine` x `fine` of the given points."""
    values = point_irradiance(x_um, y_um, chips_um, height_um)
    return values.reshape(len(y_um) // fine, fine, len(x_um) // fine, fine).mean(axis=(1, 3))


def midpoints(start: float, end: float, count: int) -> Real:
    """Centres of equal intervals."""
    return start + (np.arange(count) + 0.5) * (end - start) / count


def test_the_transform_is_that_of_the_bessel_function() -> None:
    """x K1(x) agrees with an independent library to 1e-13, is 1 at 0, and is the cut-off where it is said to be."""
    x = np.geomspace(1e-4, 200.0, 300)
    np.testing.assert_allclose(lambert_transform(x), x * k1(x), rtol=1e-13)
    assert float(lambert_transform(0.0)) == 1.0
    assert CUTOFF_X * k1(CUTOFF_X) == pytest.approx(CUTOFF, rel=1e-8)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.floats(2.0, 400.0), st.floats(20.0, 1500.0))
def test_the_mode_count_is_the_smallest_that_passes_the_rule(height_um: float, spacing_um: float) -> None:
    """The next mode is below 1e-4 and the last kept one is not, unless held at 6 or 64."""
    m = mode_count(height_um, spacing_um)
    x = 2.0 * np.pi * height_um / spacing_um * np.array([m, m + 1.0])
    last, following = x * k1(x)
    assert 6 <= m <= 64
    assert following < 1e-4 or m == 64
    assert last >= 1e-4 or m == 6


def test_the_papers_best_designs_need_six_modes_and_a_flat_wide_one_more() -> None:
    """S_b1, S_b2, S_b3: six; D 100, T 55, S 700: not."""
    assert [mode_count(D - T, pitch) for D, T, pitch in ((180, 20, 400), (160, 15, 460), (180, 35, 500))] == [6, 6, 6]
    assert mode_count(100.0 - 55.0, 700.0) > 20


def test_a_band_limited_field_comes_back_exactly_from_its_bins() -> None:
    """Exact bin means of a field with even and odd parts give its values on lines, grids and points to 1e-12."""
    k, n = 2.0 * np.pi / S, 32
    edges = np.linspace(-S / 2.0, S / 2.0, n + 1)

    def mean_of(antiderivative: Real) -> Real:
        return np.diff(antiderivative) * n / S

    cos2x, siny = mean_of(np.sin(2 * k * edges) / (2 * k)), mean_of(-np.cos(k * edges) / k)
    sin3x = mean_of(-np.cos(3 * k * edges) / (3 * k))
    bins = 1.0 + 0.3 * cos2x[None, :] + 0.2 * siny[:, None] + 0.1 * siny[:, None] * sin3x[None, :]
    field = CellField.from_bins(np.stack([bins, 2.0 * bins]), n * n, S, HEIGHT)

    def truth(x: Real, y: Real) -> Real:
        return 1.0 + 0.3 * np.cos(2 * k * x) + 0.2 * np.sin(k * y) + 0.1 * np.sin(k * y) * np.sin(3 * k * x)

    x, y = np.linspace(-S / 2.0, S / 2.0, 41), np.linspace(-200.0, 100.0, 13)
    np.testing.assert_allclose(field.grid(x, y)[0], truth(x[None, :], y[:, None]), atol=1e-12)
    np.testing.assert_allclose(field.line(x, 77.0)[1], 2.0 * truth(x, np.full(41, 77.0)), atol=1e-12)
    points = np.array([[10.0, -30.0], [-240.0, 99.0]])
    np.testing.assert_allclose(field.at(points)[0], truth(points[:, 0], points[:, 1]), atol=1e-12)
    centres = midpoints(-S / 2.0, S / 2.0, 8)
    np.testing.assert_allclose(field.map(8)[0], truth(centres[None, :], centres[:, None]), atol=1e-12)


def test_a_plus_y_tilt_is_seen_along_the_rows() -> None:
    """More light in the upper rows of the bins is more light at larger y, and no change along x."""
    bins = np.ones((2, 16, 16))
    bins[:, 10:13, :] = 2.0
    field = CellField.from_bins(bins, 1, S, HEIGHT)
    assert (field.at([[0.0, 100.0]]) > field.at([[0.0, -100.0]])).all()
    np.testing.assert_allclose(np.ptp(field.line(np.linspace(-S / 2, S / 2, 9), 100.0), axis=1), 0.0, atol=1e-12)


@pytest.mark.parametrize(("spacing_um", "height_um"), [(500.0, 145.0), (700.0, 110.0), (460.0, 145.0)])
def test_what_the_series_leaves_out_is_what_it_says(spacing_um: float, height_um: float) -> None:
    """Under a lattice of points summed in space the error is below the truncation, and reaches it above the chips."""
    n, fine, reach_um = 48, 4, 10.5 * spacing_um
    chips = lattice_um(21, 21, spacing_um)
    chips = chips[np.hypot(*chips.T) <= reach_um]
    far = height_um**2 / (len(chips) * spacing_um**2 / np.pi + height_um**2)  # the farther chips, spread out evenly
    half = spacing_um / 2.0
    at = midpoints(-half, half, n * fine)
    bins = bin_means(at, at, chips, height_um, fine) * spacing_um**2 + far
    field = CellField.from_bins(np.stack([bins, bins]), n * n, spacing_um, height_um)
    x = np.linspace(-half, half, 101)
    truth = point_irradiance(x, np.zeros(1), chips, height_um)[0] * spacing_um**2 + far
    error = np.abs(field.line(x)[0] - truth).max()
    # what the sampling of the bins (midpoints, not integrals) and the far chips leave: measured 1e-4
    assert error < field.truncation + 1.5e-4
    assert error > 0.5 * field.truncation - 1.5e-4
    assert field.mean == pytest.approx(1.0, abs=1e-3)


def test_no_mode_outside_the_disc_is_kept() -> None:
    """Of white noise nothing with m^2 + m'^2 > (M + 1/2)^2 remains, and nearly all inside does."""
    bins = np.random.default_rng(3).random((2, 32, 32))
    field = CellField.from_bins(bins, 1, S, HEIGHT)
    m = np.rint(field.x.wavenumber_per_um * S / (2.0 * np.pi))
    outside = np.add.outer(m**2, m**2) > 6.5**2
    assert not field.coefficients[:, outside].any()
    assert (field.coefficients[:, ~outside] != 0.0).all()


@settings(max_examples=20, deadline=None, derandomize=True)
@given(st.integers(0, 2**31))
def test_a_field_is_linear_in_its_bins_and_keeps_their_symmetry_and_light(seed: int) -> None:
    """Sums of bins are sums of fields; mirrored and transposed bins give mirrored and transposed fields."""
    a, b = np.random.default_rng(seed).random((2, 3, 24, 24))
    one, two, both, mirrored, turned = (
        CellField.from_bins(bins, 10, S, HEIGHT) for bins in (a, b, a + 3.0 * b, a[:, :, ::-1], a.transpose(0, 2, 1))
    )
    x = np.linspace(-S / 2.0, S / 2.0, 9)
    np.testing.assert_allclose(both.grid(x, x), one.grid(x, x) + 3.0 * two.grid(x, x), atol=1e-12)
    np.testing.assert_allclose(mirrored.grid(x, x), one.grid(-x, x), atol=1e-12)
    np.testing.assert_allclose(turned.grid(x, x), one.grid(x, x).transpose(0, 2, 1), atol=1e-12)
    assert one.mean == pytest.approx(a.sum() / 30.0, rel=1e-12)
    assert one.mean_error == pytest.approx(a.sum(axis=(1, 2)).std(ddof=1) / 10.0 / np.sqrt(3.0), rel=1e-9)


@pytest.mark.parametrize("modes", [6, 9])
def test_a_folded_cell_is_the_same_field_from_a_quarter_of_its_bins(modes: int) -> None:
    """Mirror-symmetric bins called folded give the same lines, maps, means and denoised field, to 1e-12."""
    bins = np.random.default_rng(6).random((5, 24, 24))
    bins = bins + bins[:, :, ::-1]
    bins = bins + bins[:, ::-1, :]
    whole, quarter = (CellField.from_bins(bins, 99, S, HEIGHT, modes, folded=folded) for folded in (False, True))
    x, y = np.linspace(-S / 2.0, S / 2.0, 17), np.linspace(-S, 2.0 * S, 7)
    np.testing.assert_allclose(quarter.grid(x, y), whole.grid(x, y), atol=1e-12)
    np.testing.assert_allclose(quarter.map(8), whole.map(8), atol=1e-12)
    np.testing.assert_allclose(quarter.denoised().line(x), whole.denoised().line(x), atol=1e-12)
    assert quarter.mean == pytest.approx(whole.mean, rel=1e-12)
    assert (quarter.spacing_um, quarter.truncation) == pytest.approx((whole.spacing_um, whole.truncation))


def test_the_light_of_a_cell_is_one_chips() -> None:
    """Relative illuminance 1 over one cell is all the radiant flux of a chip, in watts."""
    field = CellField.from_bins(np.full((2, 16, 16), 4.0), 4 * 256, S, HEIGHT)
    assert field.mean * field.per_m2 * (S * 1e-6) ** 2 == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("pad", [0.0, 0.5])
def test_a_module_of_points_is_met_on_its_line_within_the_bound(pad: float) -> None:
    """5 x 4 points summed in space: the middle half of a row within the truncation, even where the box ends there."""
    pitch, columns, rows, fine, per_pitch = 500.0, 5, 4, 4, 20
    half = np.array([columns, rows]) * pitch / 2.0 + pad * pitch
    chips = lattice_um(columns, rows, pitch)
    x, y = (midpoints(-h, h, int(2 * h / pitch) * per_pitch * fine) for h in half)
    irradiance = bin_means(x, y, chips, HEIGHT, fine)
    area_um2 = (pitch / per_pitch) ** 2
    bins = 1000.0 * irradiance * area_um2
    field = ModuleField.from_bins(np.stack([bins, bins]), 1000, (-half[0], half[0], -half[1], half[1]), HEIGHT)
    along = np.linspace(-columns * pitch / 4.0, columns * pitch / 4.0, 401)
    truth = point_irradiance(along, np.array([pitch / 2.0]), chips, HEIGHT)[0] * 1e6
    assert np.abs(field.line(along, pitch / 2.0)[0] - truth).max() < field.truncation
    assert field.truncation < 1e-3 * truth.max()


def test_an_evenly_lit_box_stays_even() -> None:
    """No ringing at the edges of a flat box; its light is what landed, whatever the filter."""
    field = ModuleField.from_bins(np.full((2, 40, 60), 5.0), 100, (0.0, 1500.0, -500.0, 500.0), HEIGHT)
    per_mm2 = 5.0 / 100.0 / (25.0e-3) ** 2
    np.testing.assert_allclose(field.grid([0.0, 777.0, 1500.0], [-500.0, 10.0, 500.0]), per_mm2, rtol=1e-12)
    assert field.mean * field.per_m2 * 1.5e-6 == pytest.approx(5.0 * 40 * 60 / 100.0, rel=1e-12)


@pytest.mark.parametrize(("mode", "weight"), [(10, 1.0), (12, 0.5)])
def test_the_modes_of_a_module_fade_as_a_cosine_squared(mode: int, weight: float) -> None:
    """Whole to the cut-off, half way down at 1.15 of it, where mode 12 is."""
    length, bins = 12.0 * np.pi * HEIGHT / (1.15 * CUTOFF_X), 40
    phase = mode * np.pi * np.arange(bins + 1) / bins
    wave = 1.0 + np.sqrt(2.0) * 0.1 * np.diff(np.sin(phase)) / np.diff(phase)
    tally = np.repeat(wave[None, None, :], 2, axis=0).repeat(4, axis=1)
    found = ModuleField.from_bins(tally, 1, (0.0, length, -30.0, 30.0), HEIGHT).coefficients[0, 0]
    assert found[mode] / found[0] == pytest.approx(0.1 * weight, rel=1e-9)


def test_denoising_leaves_what_is_certain_and_shrinks_what_is_not() -> None:
    """Equal groups are left alone; of pure noise about a flat cell less is left than in the mean."""
    rng = np.random.default_rng(11)
    certain = CellField.from_bins(np.repeat(rng.random((1, 32, 32)), 4, axis=0), 1, S, HEIGHT)
    np.testing.assert_allclose(certain.denoised().map(8)[0], certain.map(8)[0], atol=1e-12)
    noisy = CellField.from_bins(rng.poisson(50.0, (32, 32, 32)), 50 * 1024, S, HEIGHT)
    assert noisy.denoised().map(16)[0].std() < 0.6 * noisy.map(16).mean(axis=0).std()
    assert noisy.denoised().groups == 1


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"histories": 0}, "histories"),
        ({"spacing_um": 0.0}, "spacing_um"),
        ({"height_um": -5.0}, "height_um"),
        ({"height_um": float("nan")}, "height_um"),
        ({"bins": np.ones((1, 16, 16))}, "bins"),
        ({"bins": np.ones((4, 16, 20))}, "bins"),
        ({"bins": np.full((4, 16, 16), np.nan)}, "bins"),
        ({"modes": 8}, "bins"),
        ({"modes": 0}, "modes"),
        ({"folded": True, "bins": np.random.default_rng(0).random((4, 16, 16))}, "folded"),
        ({"folded": True, "bins": np.ones((4, 15, 15))}, "folded"),
    ],
)
def test_a_cell_that_cannot_be_is_refused(change: dict[str, object], field: str) -> None:
    """The error names the field at fault."""
    good: dict[str, object] = {"bins": np.ones((4, 16, 16)), "histories": 1, "spacing_um": S, "height_um": HEIGHT}
    with pytest.raises(InputError) as caught:
        CellField.from_bins(**{**good, **change})  # type: ignore[arg-type]  # wrong on purpose
    assert caught.value.field == field


def test_a_module_is_known_inside_its_box_and_with_narrow_enough_bins() -> None:
    """A place outside, a box turned inside out, bins too wide for the cut-off: refused."""
    box = (-500.0, 500.0, -500.0, 500.0)
    field = ModuleField.from_bins(np.ones((2, 60, 60)), 1, box, HEIGHT)
    for wrong in (
        lambda: field.line([0.0, 501.0]),
        lambda: ModuleField.from_bins(np.ones((2, 60, 60)), 1, (500.0, -500.0, -500.0, 500.0), HEIGHT),
        lambda: ModuleField.from_bins(np.ones((2, 60, 20)), 1, box, HEIGHT),
    ):
        with pytest.raises(InputError):
            wrong()


def test_what_weights_took_out_of_the_noise_is_known() -> None:
    """A tally's own modes hide nothing; half the spread hides 3/4 of its noise; a field without a tally nothing."""
    field = CellField.from_bins(np.random.default_rng(3).poisson(9.0, (8, 32, 32)), 9 * 1024, S, HEIGHT)
    assert field.hidden == 0.0
    mean = field.coefficients.mean(axis=0)
    assert replace(field, coefficients=mean + (field.coefficients - mean) * 0.5).hidden == pytest.approx(0.75)
    assert replace(field, tallied_variance=None).hidden == 0.0
    assert CellField.from_bins(np.ones((8, 32, 32)), 1024, S, HEIGHT).hidden == 0.0
