"""What a fit says of itself: degrees of freedom, errors, and why it may not be trusted, on straight lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.analytic import MODEL, Spots, two_images
from tests.validation.lines import SIGMA, Lines, fit_of_lines, noisy
from validation.diagnose.anew import total_chi2
from validation.fit import CurveData, Parameter, fit, refitted
from validation.fit.descent import pose_move_px
from validation.fit.parameters import unknowns_of
from validation.fit.problem import Problem
from validation.fit.start import start_values

AXIS = np.linspace(0.0, 1.0, 40)


def test_a_parameter_takes_a_degree_of_freedom_and_half_a_one_takes_half() -> None:
    """One is free; one its prior knows as well as the data do. Chi2 per row is over what is left."""
    even, odd = np.ones(40), np.where(np.arange(40) % 2, 1.0, -1.0)
    prior_sd = SIGMA / np.sqrt(40.0)
    values = {"a": noisy(np.random.default_rng(1), 2.0 * even)}
    found = fit_of_lines({"a": {"t": even, "u": odd}}, values, [Parameter("t"), Parameter("u", prior_sd=prior_sd)])
    assert found.freedom == pytest.approx(40.0 - 1.5, rel=1e-9)
    assert found.chi2_per_row == pytest.approx(found.chi2 / 38.5, rel=1e-9)
    assert found.error("t") == pytest.approx(np.sqrt(found.variance_scale / 40.0) * SIGMA, rel=1e-9)
    assert found.value("u") == pytest.approx(0.5 * odd @ values["a"] / 40.0, rel=1e-6)
    assert found.trusted


def test_a_score_on_a_fit_is_what_the_fit_with_the_column_gains() -> None:
    """Beside parameters that are free, far from their prior, and at a limit; by a fit anew, with priors counted."""
    random = np.random.default_rng(4)
    shapes = dict(zip("tuvc", random.standard_normal((4, 40)), strict=True))
    shapes["c"] = shapes["c"] + shapes["u"]
    values = {"a": noisy(random, 2.0 * shapes["t"] + 0.01 * shapes["u"] + 0.3 * shapes["v"] + 0.02 * shapes["c"])}
    free = Parameter("t"), Parameter("u", prior_mean=0.0, prior_sd=0.002), Parameter("v", upper=0.25, prior_sd=0.1)
    without, within = (
        fit_of_lines({"a": {name: shapes[name] for name in names}}, values, some)
        for names, some in (("tuv", free), ("tuvc", (*free, Parameter("c"))))
    )
    assert without.at_limit == within.at_limit == ("v",)
    rows, taken = without.residual_with_priors, without.basis
    assert len(rows) == 40 + 1
    np.testing.assert_allclose(taken.data.T @ rows[:40] + taken.prior.T @ rows[40:], 0.0, atol=1e-6)
    assert rows[40] == pytest.approx(-without.value("u") / 0.002, rel=1e-9)
    assert abs(rows[40]) > 2.0
    (left,) = taken.left(shapes["c"][None] / SIGMA)
    drop = total_chi2(without) - total_chi2(within)
    assert drop > 10.0
    assert (left @ rows) ** 2 / (left @ left) == pytest.approx(drop, rel=1e-6)
    assert left @ rows / (left @ left) == pytest.approx(within.value("c"), rel=1e-6)


@pytest.mark.parametrize(("beyond", "drives", "left"), [(1.0, False, 0.0), (3.0, True, 0.0), (3.0, True, 30.0)])
def test_a_parameter_that_noise_may_have_put_at_its_limit_is_no_reason_for_doubt(
    beyond: float, drives: bool, left: float
) -> None:
    """By chi2 beyond the limit, the others fitted anew: the square of what lies beyond it over its error there."""
    even, odd = np.ones(40), np.where(np.arange(40) % 2, 1.0, -0.2)
    shapes, both = {"a": {"t": even, "u": odd}}, np.stack([even, odd]) / SIGMA
    error = np.sqrt(np.linalg.inv(both @ both.T)[0, 0])
    rest = np.cos(np.pi * np.arange(40) / 2.0) * (
        np.arange(40) % 4 % 2 == 0
    )  # structure: none of these, and no noise
    rest -= both.T @ np.linalg.solve(both @ both.T, both @ rest)
    values = {"a": (2.0 + beyond * error) * even + 0.4 * odd + left * SIGMA * rest}
    free = fit_of_lines(shapes, values, [Parameter("t"), Parameter("u")])
    held = fit_of_lines(shapes, values, [Parameter("t", upper=2.0), Parameter("u")])
    assert held.chi2 - free.chi2 == pytest.approx(beyond**2, rel=1e-6)
    assert (held.value("t"), held.at_limit) == (2.0, ("t",))
    if drives:
        assert (held.driven, held.error("t")) == (("t",), 0.0)
        assert any("t is at its limit" in reason for reason in held.distrust)
        return
    assert (held.driven, held.trusted) == ((), True)
    assert held.error("t") == pytest.approx(error * np.sqrt(held.variance_scale), rel=1e-6)
    assert held.error("u") == pytest.approx(free.error("u") * np.sqrt(held.variance_scale / free.variance_scale))


def test_the_error_of_a_prediction_stands_beside_that_of_the_data() -> None:
    """Monte Carlo of 4/3 of the measurement's noise: together 5/3, and so is the parameter's error."""
    values = {"a": noisy(np.random.default_rng(2), 2.0 + 0.0 * AXIS)}
    found = fit_of_lines({"a": {"t": np.ones(40)}}, values, [Parameter("t")], error=np.full(40, 4.0 / 3.0 * SIGMA))
    (sigma,) = found.whitening.curve_sigma
    np.testing.assert_allclose(sigma, 5.0 / 3.0 * SIGMA, rtol=1e-12)
    wanted = np.sqrt(found.variance_scale / 40.0) * 5.0 / 3.0 * SIGMA
    assert found.error("t") == pytest.approx(wanted, rel=1e-9)


def test_a_scale_carries_the_error_of_its_prediction() -> None:
    """A far field is predicted up to a scale, and so is what Monte Carlo left in it."""
    curve = CurveData("far", 5.0 * (1.0 + AXIS), np.full(40, 0.03), free_scale=True)
    predict = Lines({"far": {"t": 1.0 + AXIS}}, np.full(40, 0.008))
    found = fit(
        MODEL, [], Spots(), free=(), curves=[curve], predict_curves=predict,
        others=[Parameter("t", prior_mean=1.0, prior_sd=1e-9)], start={"t": 1.0},
    )  # fmt: skip
    np.testing.assert_allclose(found.whitening.curve_sigma[0], 0.05, rtol=1e-6)


def test_two_parameters_of_one_shape_are_not_trusted() -> None:
    """No data tell 1 + 1 from 2 + 0; said once, of the fit, as neither is blind by itself."""
    shape = 1.0 + AXIS
    values = {"a": noisy(np.random.default_rng(3), 2.0 * shape)}
    found = fit_of_lines({"a": {"t": shape, "u": shape}}, values, [Parameter("t"), Parameter("u")])
    assert not found.trusted
    assert [reason.split(" (")[0] for reason in found.distrust] == ["two parameters are the same to these data"]
    known = [Parameter("t"), Parameter("u", prior_mean=1.0, prior_sd=0.1)]
    assert fit_of_lines({"a": {"t": shape, "u": shape}}, values, known).trusted


def test_as_many_parameters_as_values_are_not_trusted() -> None:
    """Where pixels were left out on the way: nothing is left to judge by."""
    parameters = (Parameter("t"), Parameter("u"))
    curve = CurveData("a", np.array([1.0, 3.0]), np.full(2, SIGMA))
    unknowns = unknowns_of(MODEL, (), (), [curve], parameters)
    problem = Problem(MODEL, unknowns, (), Spots(), (curve,), Lines({"a": {"t": np.ones(2), "u": np.arange(2.0)}}))
    found = refitted(problem, np.zeros(2))
    np.testing.assert_allclose(found.values, [1.0, 2.0], atol=1e-9)
    assert found.distrust == ("there are no more measured values than parameters; measure more or free less",)


def test_columns_are_the_derivatives_of_what_is_predicted() -> None:
    """By differences, at gains tied to the exposure with errors of their own, offsets and places of each image."""
    images = []
    for image, exposure_ms in zip(two_images(), (8.0, 16.0), strict=True):
        camera = image.camera.model_copy(update={"gain_mode": "exposure"})
        images.append(replace(image, camera=camera, shot=image.shot.model_copy(update={"exposure_ms": exposure_ms})))
    found = fit(MODEL, images, Spots(), free=())
    values = found.values.copy()
    for name, value in {"single-a.gain_error": 0.2, "array-a.gain_error": -0.1, "array-a.offset_dn": 7.0}.items():
        values[found.names.index(name)] = value
    columns = found.problem.evaluate(values).columns(found.whitening)
    for row, name in enumerate(found.names):
        step = np.zeros(len(values))
        step[row] = 1e-4 * max(abs(values[row]), 1.0)
        up, down = (found.problem.evaluate(values + k * step).residual(found.whitening) for k in (1.0, -1.0))
        length = float(np.linalg.norm(columns[row]))
        np.testing.assert_allclose((down - up) / (2.0 * step[row]), columns[row], atol=1e-5 * length, err_msg=name)


def test_a_pose_moves_the_corners_of_an_image_most() -> None:
    """A shift of (3, 4) px is 5; a degree is 0.30 px at the corner of 24 x 24; the image that moves most counts."""
    problem = fit(MODEL, two_images(), Spots(), free=()).problem

    def move(**by: float) -> float:
        named = {name.replace("single_a_", "single-a.").replace("array_a_", "array-a."): v for name, v in by.items()}
        return pose_move_px(problem, np.array([named.get(name, 0.0) for name in problem.unknowns.names]))

    assert move() == 0.0
    assert move(single_a_gain=1e3, single_a_offset_dn=9.0) == 0.0
    assert move(single_a_shift_row_px=3.0, single_a_shift_column_px=-4.0) == pytest.approx(5.0, rel=1e-12)
    assert move(array_a_rotation_deg=-1.0) == pytest.approx(np.radians(1.0) * np.sqrt(288.0), rel=1e-12)
    assert move(array_a_rotation_deg=1.0, single_a_shift_row_px=0.1) == pytest.approx(0.2962, abs=1e-4)


def test_a_scale_starts_by_weighted_least_squares() -> None:
    """Of 2 x, measured as 2 where it is known ten times as well and as 3 where not: (200 + 3) / (100 + 1)."""
    curve = CurveData("far", np.array([2.0, 3.0]), np.array([0.01, 0.1]), free_scale=True)
    unknowns = unknowns_of(MODEL, (), (), [curve], [Parameter("t")])
    problem = Problem(MODEL, unknowns, (), Spots(), (curve,), Lines({"far": {"t": np.ones(2)}}))
    assert dict(zip(unknowns.names, start_values(problem, {"t": 1.0}), strict=True)) == {
        "t": 1.0, "far.scale": pytest.approx(203.0 / 101.0),
    }  # fmt: skip
