"""Uniformity with its error: what is known in closed form, and how often the stated intervals hold the truth."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import t as students_t

from containers.ray_tracing.estimate import Estimate, estimate, student_t
from containers.ray_tracing.field import Axis, CellField, Field, ModuleField, lambert_transform
from containers.ray_tracing.light import _share_of_first, _weighed
from containers.ray_tracing.uniformity import (
    MEASUREMENT_POINTS,
    SENTENCES,
    Metrics,
    Region,
    array_region,
    cell_region,
    metrics_of,
    percentile_1_over_99,
    uniformity,
)
from luxloop.errors import InputError
from luxloop.photometry import illuminance_lx

Real = NDArray[np.float64]
S, HEIGHT, GROUPS = 500.0, 145.0, 32
LINE = {"flux_per_chip_w": 2e-4, "peak_nm": 445.0, "fwhm_nm": 18.0}


def bin_means(rings: dict[tuple[int, int], float], n: int) -> Real:
    """Bin means (n, n) of 1 + sum a (cos m kx cos m' ky + cos m' kx cos m ky) / 2, exactly."""
    m = np.arange(8)
    edges = 2.0 * np.pi * (np.arange(n + 1) / n - 0.5)
    cosine = np.concatenate([np.ones((1, n)), np.diff(np.sin(m[1:, None] * edges)) / m[1:, None] * n / (2 * np.pi)])
    bins = np.ones((n, n))
    for (a, b), amplitude in rings.items():
        bins = bins + amplitude * (np.outer(cosine[a], cosine[b]) + np.outer(cosine[b], cosine[a])) / 2.0
    return bins


def certain_field(rings: dict[tuple[int, int], float], scale: float = 1.0, n: int = 24) -> CellField:
    """A field without noise: all groups are equal."""
    bins = scale * np.repeat(bin_means(rings, n)[None], 4, axis=0)
    return CellField.from_bins(bins, n * n, S, HEIGHT)


def folded(bins: Real) -> Real:
    """Bins (group, n, n) made 8-fold symmetric."""
    bins = bins + bins[:, :, ::-1]
    bins = bins + bins[:, ::-1, :]
    return np.asarray((bins + bins.transpose(0, 2, 1)) / 8.0)


def all_estimates(metrics: Metrics) -> dict[str, Estimate]:
    """The numbers of a field that has no ledger."""
    values = {one.name: getattr(metrics, one.name) for one in fields(metrics)}
    return {name: value for name, value in values.items() if isinstance(value, Estimate)}


def test_of_a_flat_map_every_uniformity_is_one_with_no_error() -> None:
    """U = 1 on line, area, percentiles and readings; no variation, no hot spot, no bias."""
    found = all_estimates(metrics_of(certain_field({}), cell_region(S), **LINE))
    assert found.pop("coefficient_of_variation").value == pytest.approx(0.0, abs=1e-12)
    found.pop("mean_illuminance_lx")
    assert len(found) == 8
    for one in found.values():
        assert one.value == pytest.approx(1.0, abs=1e-12)
        assert one.standard_error == pytest.approx(0.0, abs=1e-12)
        assert one.bias == pytest.approx(0.0, abs=1e-12)


def test_of_a_known_map_every_number_is_the_closed_form() -> None:
    """E = 1 + a (cos kx + cos ky): line 1 / (1 + 2 a), area and hot spot (1 -+ 2 a), deviation a, mean light."""
    a = 0.15
    metrics = metrics_of(certain_field({(1, 0): 2.0 * a}), cell_region(S), **LINE)
    outer = np.cos(0.8 * np.pi)
    expected = {
        "uniformity": 1.0 / (1.0 + 2.0 * a),
        "uniformity_2d": (1.0 - 2.0 * a) / (1.0 + 2.0 * a),
        "coefficient_of_variation": a,
        "uniformity_5": (1.0 + 2.0 * a * outer) / (1.0 + 2.0 * a),
        "uniformity_9": (1.0 + 2.0 * a * outer) / (1.0 + 2.0 * a),
        "uniformity_13": (1.0 + 2.0 * a * outer) / (1.0 + 2.0 * a),
        "uniformity_25": (1.0 + 2.0 * a * outer) / (1.0 + 2.0 * a),
        "hot_spot_ratio": (1.0 + 2.0 * a) / (1.0 - 2.0 * a),
        "mean_illuminance_lx": float(illuminance_lx(LINE["flux_per_chip_w"] / (S * 1e-6) ** 2, 445.0, 18.0)),
    }
    found = all_estimates(metrics)
    for name, value in expected.items():
        assert found[name].value == pytest.approx(value, rel=1e-9), name
    assert found["uniformity_2d"].value < found["percentile_ratio"].value < 1.0


def test_percentiles_leave_a_hundredth_beyond_them() -> None:
    """Of 100 x 100 different values a hundred are below the one and a hundred above the other, in any order."""
    ramp = np.random.default_rng(1).permutation(10_000.0 + np.arange(10_000.0)).reshape(1, 100, 100)
    low, high = percentile_1_over_99(np.concatenate([ramp, 2.0 * ramp]))
    assert low.tolist() == [10_100.0, 20_200.0]
    assert high.tolist() == [19_899.0, 39_798.0]


def test_the_line_holds_an_extremum_between_the_chips() -> None:
    """A ring: E = 1 + a cos kx - b cos 2kx (plus the same in y) has its peak inside, where a / 4b = cos kx."""
    a, b = 0.2, 0.15
    found = uniformity(certain_field({(1, 0): 2.0 * a, (2, 0): -2.0 * b}), cell_region(S))
    along_y = 1.0 + a - b
    peak = along_y + a * a / (4.0 * b) - b * (2.0 * (a / (4.0 * b)) ** 2 - 1.0)
    assert found.value == pytest.approx((along_y - a - b) / peak, rel=2e-5)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.floats(1e-3, 1e3), st.integers(0, 2**31))
def test_ratios_do_not_know_the_flux(scale: float, seed: int) -> None:
    """All weights times a number: the same ratios and errors, the illuminance times it."""
    bins = np.random.default_rng(seed).poisson(40.0, (8, 16, 16)).astype(float)
    one, other = (
        all_estimates(metrics_of(CellField.from_bins(b, 10240, S, HEIGHT), cell_region(S), **LINE))
        for b in (bins, scale * bins)
    )
    lx, scaled_lx = one.pop("mean_illuminance_lx"), other.pop("mean_illuminance_lx")
    assert scaled_lx.value == pytest.approx(scale * lx.value, rel=1e-9)
    assert scaled_lx.standard_error == pytest.approx(scale * lx.standard_error, rel=1e-9)
    for name, found in one.items():
        assert other[name].value == pytest.approx(found.value, rel=1e-6, abs=1e-9)
        assert other[name].standard_error == pytest.approx(found.standard_error, rel=1e-6, abs=1e-9)


def test_a_linear_statistic_has_no_bias_and_the_textbook_error() -> None:
    """A weighted sum of the mean over groups: no correction, standard deviation over the root of the groups."""
    replicas = np.random.default_rng(2).normal(size=(20, 3))
    weights = np.array([1.0, -2.0, 0.5])
    found = estimate(lambda values: values @ weights, replicas)
    each = replicas @ weights
    assert found.value == pytest.approx(each.mean(), abs=1e-12)
    assert found.bias == pytest.approx(0.0, abs=1e-12)
    assert found.standard_error == pytest.approx(each.std(ddof=1) / np.sqrt(20.0), rel=1e-9)


def test_the_square_of_a_mean_loses_the_variance_that_noise_adds() -> None:
    """E[mean^2] = truth^2 + variance: the bias taken off is the estimated variance of the mean."""
    replicas = np.random.default_rng(4).normal(1.0, 3.0, 24)
    found = estimate(lambda values: values**2, replicas)
    assert found.bias == pytest.approx(replicas.var(ddof=1) / 24.0, rel=1e-9)


@pytest.mark.parametrize("level", [0.5, 0.68, 0.95, 0.99])
@pytest.mark.parametrize("degrees", [1, 2, 15, 31, 200])
def test_student_t_is_the_tabled_one(level: float, degrees: int) -> None:
    """An independent library's quantiles to 1e-5."""
    assert student_t(level, degrees) == pytest.approx(students_t.ppf(0.5 + level / 2.0, degrees), rel=1e-5)


def test_an_interval_is_t_errors_wide_and_holds_the_truncation() -> None:
    """value +- (t x standard error + truncation)."""
    low, high = Estimate(0.7, 0.01, -0.002, 32, 0.003).interval(0.95)
    assert (low + high) / 2.0 == pytest.approx(0.7, abs=1e-12)
    assert high - 0.7 == pytest.approx(2.0395 * 0.01 + 0.003, rel=1e-4)


FIELDS = {
    "ring": ({(1, 0): 0.35, (2, 0): -0.2, (1, 1): 0.1}, 40_000),
    "centre and corner": ({(1, 0): 0.5, (1, 1): 0.12, (2, 0): 0.06}, 40_000),
    "nearly flat": ({(1, 0): 0.015, (2, 0): -0.012}, 100_000),
}


@pytest.mark.parametrize("name", FIELDS)
def test_the_bias_of_noise_is_taken_off_and_the_intervals_hold_the_truth(name: str) -> None:
    """160 tallies of known cells: mean error under 0.3 standard errors (0.08 is chance), 90 % or more covered."""
    rings, histories = FIELDS[name]
    n, rng, region = 24, np.random.default_rng(17), cell_region(S)
    probability = bin_means(rings, n).ravel() / n**2
    truth = uniformity(certain_field(rings), region).value
    found = []
    for _ in range(160):
        bins = folded(rng.multinomial(histories, probability, size=GROUPS).reshape(GROUPS, n, n).astype(float))
        found.append(uniformity(CellField.from_bins(bins, histories, S, HEIGHT), region))
    errors = np.array([one.value - truth for one in found])
    stated = np.array([one.standard_error for one in found])
    intervals = np.array([one.interval(0.95) for one in found])
    assert abs(errors.mean()) < 0.3 * stated.mean()
    assert np.mean((intervals[:, 0] <= truth) & (truth <= intervals[:, 1])) >= 0.90
    assert np.sqrt((stated**2).mean()) == pytest.approx(errors.std(), rel=0.2)


def test_noise_alone_makes_the_plain_ratio_low_and_the_estimate_does_not_follow() -> None:
    """A flat cell that is not folded: the plain min / max is 2 errors low, the estimate within one of 1."""
    bins = np.random.default_rng(8).poisson(150.0, (GROUPS, 24, 24)).astype(float)
    found = uniformity(CellField.from_bins(bins, 150 * 576, S, HEIGHT), cell_region(S))
    assert found.bias < -2.0 * found.standard_error
    assert abs(found.value - 1.0) < 1.5 * found.standard_error


def weighed_fields(a: float, count: int, histories: float = 1e5) -> list[CellField]:
    """Folded fields of 1 + a cos kx + a cos ky whose noise was taken out as light.py does, by Wiener's weights."""
    rng, axis = np.random.default_rng(23), Axis(0.0, S / 2.0, 10, "even")
    truth = np.zeros((11, 11))
    truth[0, 0], truth[0, 1], truth[1, 0] = 1.0, a / np.sqrt(2.0), a / np.sqrt(2.0)
    found = []
    for _ in range(count):
        modes = truth + rng.standard_normal((GROUPS, 11, 11)) / np.sqrt(histories)
        tallied = CellField(modes, axis, axis, 1, 0.0, 1.0, modes.var(axis=0, ddof=1) / GROUPS)
        share = _share_of_first(tallied)
        found.append(replace(tallied, coefficients=_weighed(tallied, share, share)))
    return found


@pytest.mark.parametrize("truth", [1.0, 0.9985, 0.995, 0.985, 0.9])
def test_weights_that_flatten_a_map_leave_its_uniformity_honest(truth: float) -> None:
    """One cosine of known amplitude, 60 runs: off by less than half the error, 90 % or more of intervals hold."""
    found = [uniformity(field, cell_region(S)) for field in weighed_fields((1.0 / truth - 1.0) / 2.0, 60)]
    errors = np.array([one.value - truth for one in found])
    assert abs(errors.mean()) < 0.5 * np.mean([one.standard_error for one in found])
    assert np.mean([one.interval()[0] <= truth <= one.interval()[1] for one in found]) >= 0.9


@pytest.mark.parametrize("kept", [0.0, 1e-4])
def test_where_weights_took_out_nearly_all_noise_the_error_is_that_of_the_tally(kept: float) -> None:
    """A run whose noise lay below the caution everywhere has no error by its spread; 4 % of them had, and stopped."""
    (field,) = weighed_fields(0.0, 1, 1e3)
    assert field.tallied_variance is not None
    tallied = float(np.sqrt(field.tallied_variance.sum() - field.tallied_variance[0, 0]))
    share = np.full((11, 11), kept)
    share[0, 0] = 1.0
    bare = replace(field, coefficients=_weighed(field, share, share))
    for name, found in all_estimates(metrics_of(bare, cell_region(S), **LINE)).items():
        if name != "mean_illuminance_lx":
            assert 1.0 * tallied < found.standard_error < 2.0 * tallied, name
    assert field.unseen == 0.0 < field.hidden


def test_what_weights_may_have_hidden_counts_near_flat_and_not_where_relief_is_seen() -> None:
    """Beside the same field taken as never weighed: a flat map has twice the error or more, U 0.66 the same."""
    for a, least, most in ((0.0, 2.0, np.inf), (0.25, 1.0, 1.001)):
        (field,) = weighed_fields(a, 1)
        aware, not_aware = (uniformity(one, cell_region(S)) for one in (field, replace(field, tallied_variance=None)))
        assert least <= aware.standard_error / not_aware.standard_error <= most
        if a:
            assert aware.value == pytest.approx(not_aware.value, abs=0.01 * aware.standard_error)


def test_the_same_tally_gives_the_same_bits() -> None:
    """No state is kept between estimates."""
    bins = np.random.default_rng(9).poisson(30.0, (GROUPS, 24, 24)).astype(float)
    one, other = (uniformity(CellField.from_bins(bins, 30 * 576, S, HEIGHT), cell_region(S)) for _ in range(2))
    assert one == other


@pytest.mark.parametrize(
    ("rows", "columns", "line_y_um", "chip_um"),
    [(5, 5, 0.0, (0.0, 0.0)), (4, 6, 250.0, (250.0, 250.0)), (1, 2, 0.0, (250.0, 0.0))],
)
def test_the_line_of_an_array_is_the_middle_half_of_the_row_nearest_the_centre(
    rows: int, columns: int, line_y_um: float, chip_um: tuple[float, float]
) -> None:
    """Odd rows: y = 0; even rows: half a pitch above; a quarter of the array's length on either side."""
    region = array_region(rows, columns, S)
    assert region.line_y_um == line_y_um
    assert region.chip_um == chip_um
    assert region.line_um[[0, -1]].tolist() == [-columns * S / 4.0, columns * S / 4.0]
    assert len(region.line_um) == 401
    assert f"y = {line_y_um:g} um" in region.text


def test_where_the_receiver_ends_before_the_array_does_so_does_the_region() -> None:
    """What lies beyond is no result: line, area and the point between chips are on the receiver."""
    region = array_region(1, 1, S, (100.0, 60.0))
    assert region.line_um[[0, -1]].tolist() == [-100.0, 100.0]
    assert region.half_width_um == (100.0, 60.0)
    assert region.gap_um == (-100.0, -60.0)
    assert "of which the receiver has 200 x 120 um" in region.text
    wide = array_region(3, 3, S, (2_000.0, 2_000.0))
    assert (wide.half_width_um, wide.text) == (array_region(3, 3, S).half_width_um, array_region(3, 3, S).text)


def test_a_single_lambertian_point_falls_off_as_cos_to_the_fourth() -> None:
    """One chip, pitch S: U = cos^4 at a quarter pitch, from a module's bins, within the truncation."""
    n, box = 120, 750.0
    at = (np.arange(n * 4) + 0.5) * 2.0 * box / (n * 4) - box
    r2 = np.add.outer(at**2, at**2)
    irradiance = (HEIGHT**2 / np.pi / (r2 + HEIGHT**2) ** 2).reshape(n, 4, n, 4).mean(axis=(1, 3))
    bins = np.repeat((irradiance * (2.0 * box / n) ** 2 * 1e4)[None], 4, axis=0)
    field = ModuleField.from_bins(bins, 10_000, (-box, box, -box, box), HEIGHT)
    metrics = metrics_of(field, array_region(1, 1, S), **LINE)
    falloff = (1.0 + (125.0 / HEIGHT) ** 2) ** -2
    assert abs(metrics.uniformity.value - falloff) < metrics.uniformity.truncation < 1e-3
    corner = (1.0 + 2.0 * (250.0 / HEIGHT) ** 2) ** -2
    assert metrics.hot_spot_ratio.value == pytest.approx(1.0 / corner, rel=0.02)


def lattice_field(pitches: int, modes: int, places: int) -> tuple[Field, Real]:
    """Lambertian points at the pitches' middles, mean 1, in functions of a box that ends where the pitches do; and
    the light (place, place) over one pitch, read so finely."""
    m = np.arange(modes + 1)
    one = np.sqrt(np.where(m, 2.0, 1.0))  # of a cosine that is orthonormal
    amplitude = lambert_transform(2.0 * np.pi * np.hypot(m[:, None], m) * HEIGHT / S) * np.outer(one, one)
    coefficients = np.zeros((4, 2 * pitches * modes + 1, 2 * pitches * modes + 1))
    signs = (-1.0) ** m  # the box begins between chips
    coefficients[:, :: 2 * pitches, :: 2 * pitches] = amplitude * np.outer(signs, signs)
    half = pitches * S / 2.0
    axis = Axis(-half, 2.0 * half, 2 * pitches * modes, "box")
    waves = one * np.cos(2.0 * np.pi * np.outer((np.arange(places) + 0.5) / places - 0.5, m))
    return ModuleField(coefficients, axis, axis, 1000, 0.0, 1e6), waves @ amplitude @ waves.T


@pytest.mark.parametrize("pitches", [8, 16, 24])
def test_the_area_of_a_large_module_is_read_as_finely_as_that_of_a_small_one(pitches: int) -> None:
    """Mean, smallest over largest and variation are those of a fine map, however many pitches divide the points.

    With two points a pitch the mean was 20 % low, and the uniformity 0.8 for 0.05.
    """
    field, fine = lattice_field(pitches, 5, 99)
    found = metrics_of(field, array_region(pitches, pitches, S), **LINE)
    lx = metrics_of(certain_field({}), cell_region(S), **LINE).mean_illuminance_lx.value * (S * 1e-3) ** 2
    assert found.mean_illuminance_lx.value == pytest.approx(lx, rel=1e-6)
    assert found.uniformity_2d.value == pytest.approx(fine.min() / fine.max(), rel=0.15)
    assert found.coefficient_of_variation.value == pytest.approx(fine.std() / fine.mean(), rel=1e-3)


@pytest.mark.parametrize("mode", [63, 64, 96, 128])
def test_the_mean_of_the_area_is_that_of_the_light_whatever_its_modes(mode: int) -> None:
    """On 64 lines mode 64 of a cell was constant, and counted as light."""
    coefficients = np.zeros((4, mode + 1, mode + 1))
    coefficients[:, 0, 0], coefficients[:, 0, mode] = 1.0, 0.1
    axis = Axis(0.0, S / 2.0, mode, "even")
    field = CellField(coefficients, axis, axis, 1000, 0.0, 1e12 / S**2)
    flat = metrics_of(certain_field({}), cell_region(S), **LINE)
    found = metrics_of(field, cell_region(S), **LINE)
    assert found.mean_illuminance_lx.value == pytest.approx(flat.mean_illuminance_lx.value, rel=1e-12)
    assert found.coefficient_of_variation.value == pytest.approx(0.1, rel=1e-9)


def test_draws_in_pieces_are_the_same_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only so many values are held at once; a number is the same but for the order of its sums."""
    bins = np.random.default_rng(3).poisson(40.0, (8, 24, 24)).astype(float)
    field = CellField.from_bins(bins, 40 * 576, S, HEIGHT)
    whole = all_estimates(metrics_of(field, cell_region(S), **LINE))
    monkeypatch.setattr("containers.ray_tracing.estimate.MOST_VALUES", 3 * 64 * 64)
    for name, one in all_estimates(metrics_of(field, cell_region(S), **LINE)).items():
        assert one.value == pytest.approx(whole[name].value, rel=1e-12)
        assert one.standard_error == pytest.approx(whole[name].standard_error, rel=1e-9)


def test_measurement_points_lie_symmetric_inside_the_area() -> None:
    """5, 9, 13 and 25 different places, each with its mirror images, 10 % of the width from the edge at most."""
    region = cell_region(S)
    for count, points in MEASUREMENT_POINTS.items():
        assert len(set(points)) == count
        assert {(-x, y) for x, y in points} == {(y, x) for x, y in points} == set(points)
        assert np.abs(region.measurement_points_um(count)).max() == pytest.approx(0.4 * S)


def test_a_minimum_below_zero_is_a_failure_that_asks_for_more_histories() -> None:
    """Too little light to say anything: no uniformity is invented."""
    bins = np.zeros((4, 24, 24))
    bins[:, 11:13, 11:13] = 1.0
    with pytest.raises(InputError, match="more histories"):
        uniformity(CellField.from_bins(bins, 16, S, HEIGHT), cell_region(S))
    with pytest.raises(InputError, match="more histories"):
        uniformity(CellField.from_bins(0.0 * bins, 16, S, HEIGHT), cell_region(S))


def test_every_number_is_explained_and_the_ledgers_is_passed_through() -> None:
    """One sentence for each field of the metrics; the optical efficiency is the one handed in."""
    efficiency = Estimate(0.61, 0.001, 0.0, 32)
    metrics = metrics_of(certain_field({}), cell_region(S), optical_efficiency=efficiency, **LINE)
    assert set(SENTENCES) == {one.name for one in fields(metrics)}
    assert metrics.optical_efficiency is efficiency
    assert metrics.region == cell_region(S).text


@pytest.mark.parametrize("wrong", [(0, 3, S), (3, 0, S), (2, 2, -1.0)])
def test_an_array_without_chips_or_pitch_is_refused(wrong: tuple[int, int, float]) -> None:
    """Rows, columns and pitch must be there."""
    with pytest.raises(InputError):
        array_region(*wrong)


def test_one_group_has_no_error_to_state() -> None:
    """An estimate needs two groups or more, an interval a level below 1."""
    with pytest.raises(InputError):
        estimate(lambda values: values.min(axis=1), np.ones((1, 5)))
    with pytest.raises(InputError):
        Estimate(0.5, 0.1, 0.0, 8).interval(1.0)


def test_regions_are_plain_data() -> None:
    """A cell's area passes through the chip and a corner, once each."""
    region: Region = cell_region(S)
    x, y = region.area_um(certain_field({}))
    assert 0.0 in x
    assert -S / 2.0 in y
    assert S / 2.0 not in x
