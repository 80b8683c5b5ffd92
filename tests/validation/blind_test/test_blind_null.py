"""What `benchmarks.blind_null` takes apart: what comes of the truth's distance from priors, what of the anchor."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind_null import Draw, draw_of
from tests.validation.analytic import ARRAY, HALO, MODEL, REACH, SIGMA, SINGLE, TRUTH, Spots, spots, two_images
from tests.validation.diagnose.test_score import candidate
from validation.diagnose.score import Projected
from validation.fit import Fit, fit
from validation.prediction import Anchored, View

TRUE = {path: float(TRUTH.leaves()[path]) for path in (SIGMA, HALO, REACH)}


@pytest.fixture(scope="module")
def fits() -> list[Fit]:
    """Of the same images about an anchor with noise, by two priors that are 1 and -2 of their sds from the truth."""
    views = [View(sample, 24, 24, 25.0, (11.5, 11.5)) for sample in (SINGLE, ARRAY)]
    noise = {
        view.sample.id: 0.05 * np.array([spots(TRUTH, view)[1][path] for path in (HALO, REACH)]) for view in views
    }
    found = []
    for off in (1.0, -2.0):
        own = MODEL.fit[SIGMA].model_copy(update={"prior_mean": TRUE[SIGMA] + 0.05 * off, "prior_sd": 0.05})
        model = MODEL.model_copy(update={"fit": MODEL.fit | {SIGMA: own}})
        found.append(fit(model, two_images(3), Spots(noise), anchor_at=lambda at: Anchored(at, 1000)))
    return found


def drawn(found: Fit, like: Fit) -> Draw:
    """Five columns: four of noise, and one much like what the prior's parameter does."""
    random = np.random.default_rng(5).standard_normal((4, len(found.residual)))
    near = like.columns[like.names.index(SIGMA)]
    columns = [*random, near + 0.3 * np.linalg.norm(near) * random[0] / np.linalg.norm(random[0])]
    candidates = [candidate(f"column_{n}", one) for n, one in enumerate(columns)]
    return draw_of(Projected.of(candidates, found.basis), found, TRUE)


def test_of_z_the_truths_distance_from_a_prior_makes_what_is_said(fits: list[Fit]) -> None:
    """By another prior on the same data z differs by no more and no less than that."""
    one, other = (drawn(each, fits[0]) for each in fits)
    assert one.of_priors[4] > 0.1 > 10.0 * one.of_priors[:4].max()
    assert abs(one.z - other.z)[4] > 1.0
    np.testing.assert_allclose(one.z - other.z, one.by_truth - other.by_truth, atol=0.05)
    np.testing.assert_allclose(one.by_truth[4] ** 2, one.of_priors[4] / fits[0].variance_scale, rtol=1e-6)


def test_the_anchors_share_of_the_variance_is_that_of_its_whitened_noise(fits: list[Fit]) -> None:
    """v' M'M (1 + M'M)^-1 v along a column v, by the whole matrix."""
    found, rows = fits[0], len(fits[0].residual)
    column = np.random.default_rng(5).standard_normal(rows)
    whole = np.zeros((rows, rows))
    for block in found.whitening.noise:
        whole[np.ix_(block.rows, block.rows)] = block.columns.T @ block.columns
        column[block.rows] += 3.0 * block.columns[0]
    projected = Projected.of([candidate("column", column)], found.basis)
    along = projected.columns[0, :rows] / np.linalg.norm(projected.columns[0])
    share = along @ whole @ np.linalg.solve(np.eye(rows) + whole, along)
    assert draw_of(projected, found, TRUE).of_anchor == pytest.approx(share, rel=1e-6)
    assert share > 0.01
