"""Bayes factors of one more effect: Laplace's approximation and the integral over a group's spread, by sums."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from validation.diagnose.evidence import group_log_evidence, log_evidence


def test_the_evidence_of_a_group_is_integrated_over_its_spread() -> None:
    """Against a sum over spreads of what a normal with that covariance says of the products."""
    random = np.random.default_rng(3)
    columns = random.standard_normal((4, 30))
    products, gram = columns @ (0.4 * columns.sum(axis=0) + random.standard_normal(30)), columns @ columns.T
    for largest in (2.0, 200.0):  # of the wider range the likely spreads are a narrow part
        spreads = largest * (np.arange(20_000) + 0.5) / 20_000.0
        alone = multivariate_normal(np.zeros(4), gram).logpdf(products)
        logs = [multivariate_normal(np.zeros(4), gram + s**2 * gram @ gram).logpdf(products) - alone for s in spreads]
        assert group_log_evidence(products, gram, largest) == pytest.approx(
            float(logsumexp(logs) - np.log(len(logs))), abs=0.01
        )


def test_the_evidence_of_two_numbers_counts_what_they_have_in_common() -> None:
    """Laplace's approximation is exact for a normal likelihood: against a sum over a grid of both numbers."""
    covariance = np.array([[0.02, 0.018], [0.018, 0.02]])
    best = np.array([0.3, -0.2])
    drop = float(best @ np.linalg.solve(covariance, best))
    grid = np.linspace(-1.5, 1.5, 601)
    at = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    off = np.sum((at - best) @ np.linalg.inv(covariance) * (at - best), axis=1)
    expected = float(logsumexp(0.5 * (drop - off)) - np.log(len(at)))
    assert log_evidence(drop, best, covariance, [(-1.5, 1.5)] * 2) == pytest.approx(expected, abs=0.01)


def test_what_lies_beyond_the_range_is_no_evidence() -> None:
    """A size that is not known at all says nothing, however wide its normal is: against sums over the range.

    Of two numbers that are tied to each other, too.
    """
    for value, error in ((0.03, 33.0), (0.01, 0.05), (0.05, 0.005)):
        drop = (value / error) ** 2
        grid = (np.arange(20_000) + 0.5) / 200_000.0
        expected = float(logsumexp(0.5 * (drop - ((grid - value) / error) ** 2)) - np.log(len(grid)))
        found = log_evidence(drop, np.array([value]), np.array([[error**2]]), [(0.0, 0.1)])
        assert found == pytest.approx(expected, abs=1e-4)
        assert found <= 0.5 * drop
    covariance = np.array([[0.5, 0.45], [0.45, 0.5]])
    best, axis = np.array([0.8, 0.2]), (np.arange(400) + 0.5) / 400.0
    at = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    off = np.sum((at - best) @ np.linalg.inv(covariance) * (at - best), axis=1)
    expected = float(logsumexp(0.5 * (3.0 - off)) - np.log(len(at)))
    assert log_evidence(3.0, best, covariance, [(0.0, 1.0)] * 2) == pytest.approx(expected, abs=0.005)


def test_many_parameters_that_are_tied_have_their_share_within_the_range() -> None:
    """Four, the last two tied by 0.9, against draws; ten, in a box that holds them all."""
    covariance = np.eye(4)
    covariance[2, 3] = covariance[3, 2] = 0.9
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(4), covariance, 200_000)
    for half in (0.5, 2.0, 8.0):
        inside = np.mean(np.all(np.abs(draws) < half, axis=1))
        expected = np.log(inside) + 0.5 * np.linalg.slogdet(2.0 * np.pi * covariance)[1] - 4.0 * np.log(2.0 * half)
        found = log_evidence(0.0, np.zeros(4), covariance, [(-half, half)] * 4)
        assert found == pytest.approx(float(expected), abs=0.03)
    ten = log_evidence(0.0, np.zeros(10), np.eye(10), [(-8.0, 8.0)] * 10)
    assert ten == pytest.approx(5.0 * np.log(2.0 * np.pi) - 10.0 * np.log(16.0), abs=1e-6)
