"""The linear step: closed forms, priors, limits, covariance, the basis that noise is projected on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from validation.fit.least_squares import Parameter, basis, reduce

ROWS = 40


PARAMETERS = (Parameter("a"), Parameter("b", prior_mean=0.5, prior_sd=0.1), Parameter("c"))


def _problem(seed=0, parameters=PARAMETERS):
    random = np.random.default_rng(seed)
    columns = random.standard_normal((len(parameters), ROWS)) * np.array([[1e-6], [1.0], [1e6]])[: len(parameters)]
    return columns, random.standard_normal(ROWS), parameters


def test_step_is_the_closed_form():
    """The best change solves (A'A + P) d = A'r + P (m - x), columns of very different lengths included."""
    columns, residual, parameters = _problem()
    values = np.array([0.3, 0.2, 0.1])
    step = reduce(columns, residual, parameters, values).step()
    scale = np.linalg.norm(columns, axis=1)
    unit, prior = columns / scale[:, None], np.diag([0.0, 100.0, 0.0]) / np.outer(scale, scale)
    pull = np.array([0.0, 100.0 * (0.5 - 0.2), 0.0]) / scale
    np.testing.assert_allclose(step.change, np.linalg.solve(unit @ unit.T + prior, unit @ residual + pull) / scale)
    left = residual - step.change @ columns
    assert step.chi2 == pytest.approx(left @ left + ((values[1] + step.change[1] - 0.5) / 0.1) ** 2)


def test_covariance_is_the_inverse_of_the_information():
    """Covariance = (A'A/v + P)^-1."""
    columns, residual, parameters = _problem()
    found = reduce(columns, residual, parameters, np.zeros(3)).covariance(1.5)
    scale = np.linalg.norm(columns, axis=1)
    wanted = np.linalg.inv(columns @ columns.T / 1.5 / np.outer(scale, scale) + np.diag([0, 100.0, 0]) / scale**2)
    np.testing.assert_allclose(found * np.outer(scale, scale), wanted, rtol=1e-9)


def test_a_strong_prior_holds_a_parameter():
    """With a prior of almost no width the parameter goes to its mean."""
    columns, residual, _ = _problem()
    parameters = (Parameter("a"), Parameter("b", prior_mean=7.0, prior_sd=1e-9), Parameter("c"))
    assert reduce(columns, residual, parameters, np.zeros(3)).step().change[1] == pytest.approx(7.0)


def test_a_limit_holds_and_the_others_adapt():
    """A parameter that would pass its limit stops there and is named; the others are the best for that value."""
    columns, residual, _ = _problem()
    free = reduce(columns, residual, (Parameter("a"), Parameter("b"), Parameter("c")), np.zeros(3)).step().change
    limit = free[1] / 2.0
    lower, upper = sorted((limit, -10.0 * limit))
    held = (Parameter("a"), Parameter("b", lower, upper), Parameter("c"))
    step = reduce(columns, residual, held, np.zeros(3)).step()
    assert step.at_limit.tolist() == [False, True, False]
    assert step.change[1] == pytest.approx(limit)
    others = columns[[0, 2]]
    rest = residual - limit * columns[1]
    np.testing.assert_allclose(step.change[[0, 2]], np.linalg.lstsq(others.T, rest, rcond=1e-30)[0], rtol=1e-6)


def test_covariance_with_noise_in_the_columns():
    """Noisy columns solve their own equations: the scatter is that of `covariance_of`, not what they claim."""
    truth, _, parameters = _problem()
    flat = tuple(replace(one, prior_sd=np.inf) for one in parameters)
    random, length = np.random.default_rng(3), np.linalg.norm(truth, axis=1)[:, None] / np.sqrt(ROWS)
    columns = truth + length * random.standard_normal(truth.shape)
    values, every = np.zeros(3), np.ones(3, bool)
    moved = np.linalg.solve(columns @ truth.T, columns @ random.standard_normal((ROWS, 20_000)))
    seen = np.cov(moved) / np.outer(length, length)
    reduced = reduce(columns, truth[0], flat, values)
    exact = reduced.covariance_of(columns, truth, 1.0, every) / np.outer(length, length)
    np.testing.assert_allclose(exact, seen, atol=0.05 * np.diag(seen).max())
    claimed = reduced.covariance(1.0, every) / np.outer(length, length)
    assert np.all(np.diag(claimed) < 0.8 * np.diag(seen))
    same = reduced.covariance_of(columns, columns, 1.0, every)
    np.testing.assert_allclose(same, reduced.covariance(1.0, every), rtol=1e-6)


def test_damping_shortens_a_step():
    """The more damping, the shorter the step, and the linear chi2 still falls."""
    columns, residual, parameters = _problem()
    reduced = reduce(columns, residual, parameters, np.array([0.0, 0.5, 0.0]))
    scale = np.linalg.norm(columns, axis=1)
    lengths = [float(np.linalg.norm(reduced.step(damping).change * scale)) for damping in (0.0, 1.0, 10.0, 100.0)]
    assert lengths == sorted(lengths, reverse=True)
    assert reduced.step(10.0).chi2 < reduced.chi2


def test_a_parameter_that_nothing_sees_is_named_and_left():
    """A column of zeros without a prior is blind: it does not move and its error is infinite."""
    columns, residual, _ = _problem()
    columns[1] = 0.0
    reduced = reduce(columns, residual, (Parameter("a"), Parameter("b"), Parameter("c")), np.ones(3))
    assert reduced.blind.tolist() == [False, True, False]
    assert reduced.step().change[1] == 0.0
    assert np.isinf(reduced.covariance()[1, 1])


def test_basis_takes_out_what_a_fit_takes_out():
    """y - D (D'y + P'u) is the residual of the fit to data y with prior errors u."""
    columns, _, parameters = _problem()
    random = np.random.default_rng(5)
    y, u = random.standard_normal(ROWS), random.standard_normal(1)
    values = np.array([0.0, 0.5, 0.0])
    shifted = (parameters[0], Parameter("b", prior_mean=0.5 + 0.1 * u[0], prior_sd=0.1), parameters[2])
    change = reduce(columns, y, shifted, values).step().change
    taken = basis(columns, reduce(columns, y, parameters, values), np.ones(3, dtype=bool))
    np.testing.assert_allclose(
        y - change @ columns, y - taken.data @ (taken.data.T @ y + taken.prior.T @ u), atol=1e-9
    )
    both = np.vstack([taken.data, taken.prior])
    np.testing.assert_allclose(both.T @ both, np.eye(3), atol=1e-10)
    assert 2.0 < taken.taken < 3.0


def test_the_same_column_twice_is_taken_once():
    """Two equal columns span one direction; nothing breaks."""
    columns, residual, _ = _problem()
    columns[1] = columns[0]
    reduced = reduce(columns, residual, (Parameter("a"), Parameter("b"), Parameter("c")), np.zeros(3))
    assert basis(columns, reduced, np.ones(3, dtype=bool)).taken == pytest.approx(2.0)
    assert reduced.condition(np.ones(3, dtype=bool)) > 1e8


def test_a_step_by_two_walks_goes_all_the_way_where_columns_are_noisy():
    """Half of a column is noise: its own product steps half of the way, the product with another column all of it."""
    parameters = (Parameter("a"), Parameter("b", prior_mean=0.0, prior_sd=1e9))
    random, rows = np.random.default_rng(2), 4000
    signal = np.array([random.standard_normal(rows), random.standard_normal(rows)])
    columns, other = (signal + np.array([[1.0], [0.0]]) * random.standard_normal((2, rows)) for _ in range(2))
    residual = np.array([3.0, -2.0]) @ signal
    reduced = reduce(columns, residual, parameters, np.zeros(2))
    assert reduced.step().change[0] == pytest.approx(1.5, rel=0.06)
    whole = reduced.crossed_step(columns, other, residual, np.array([True, True]))
    np.testing.assert_allclose(whole, [3.0, -2.0], rtol=0.08)
    held = reduced.crossed_step(columns, other, residual, np.array([True, False]))
    assert held[1] == 0.0


def test_a_step_by_two_walks_is_the_step_where_they_are_the_same():
    """Without noise, priors included."""
    columns, residual, parameters = _problem()
    reduced = reduce(columns, residual, parameters, np.array([0.3, 0.2, 0.1]))
    whole = reduced.crossed_step(columns, columns, residual, np.array([True, True, True]))
    np.testing.assert_allclose(whole, reduced.step().change, rtol=1e-9)


def test_what_a_prior_pulls_counts_in_what_is_to_be_gained():
    """A value of 3 and a prior one sigma off on the other side: 9 + 1 now, 4 + 4 at best."""
    reduced = reduce(
        np.ones((1, 1)), np.array([3.0]), (Parameter("a", prior_mean=4.0, prior_sd=1.0),), np.full(1, 5.0)
    )
    assert reduced.chi2 == pytest.approx(10.0)
    assert reduced.step().change == pytest.approx([1.0])
    assert reduced.step().chi2 == pytest.approx(8.0)
    assert reduced.gap == pytest.approx(2.0)


@pytest.mark.parametrize("short", [False, True])
def test_a_short_step_goes_no_further_than_a_pose_may(short):
    """The parameter that may not go further stops there, the other is the best for that; at its end it may."""
    columns, residual = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]), np.array([5.0, 2.0, 7.0])
    step = reduce(columns, residual, (Parameter("a", longest_step=0.5), Parameter("b")), np.zeros(2)).step(
        short=short
    )
    np.testing.assert_allclose(step.change, [0.5, 3.25] if short else [3.0, 2.0], rtol=1e-9)
    assert not step.at_limit.any()
