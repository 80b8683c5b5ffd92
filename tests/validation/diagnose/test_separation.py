"""What would be left of an effect beside all that may imitate it, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from validation.diagnose.separation import Rows, sigma_left

NONE = np.zeros((0, 1))


def rows(model: float, effect: float, rival: float = 0.0, nuisance: float | None = None, sd: float = np.inf) -> Rows:
    """A single row, on which each has one number; `sd` of the nuisance's prior."""
    nuisances = NONE if nuisance is None else np.array([[nuisance]])
    effects = {"one": np.array([effect]), "other": np.array([rival])}
    return Rows(np.array([[model]]), nuisances, np.full(len(nuisances), sd), effects)


@pytest.mark.parametrize("prior_sd", [1e-9, 0.1, 0.5, 20.0, np.inf])
def test_a_prior_keeps_a_parameter_from_taking_an_effect(prior_sd: float) -> None:
    """Of e beside g t, t known to s: min (e - g t)^2 + (t / s)^2 = e^2 / (1 + (g s)^2)."""
    e, g = 6.0, 2.0
    assert sigma_left([rows(g, e)], np.array([prior_sd]), "one") == pytest.approx(
        e / np.sqrt(1.0 + (g * prior_sd) ** 2), abs=1e-6
    )


def test_two_images_are_weighed_together_under_one_prior() -> None:
    """The parameter is the same in both, so is its prior: sqrt(2) e / sqrt(1 + 2 (g s)^2)."""
    e, g, s = 6.0, 2.0, 0.5
    left = sigma_left([rows(g, e), rows(g, e)], np.array([s]), "one")
    assert left == pytest.approx(np.sqrt(2.0) * e / np.sqrt(1.0 + 2.0 * (g * s) ** 2), rel=1e-9)


def test_a_nuisance_takes_all_of_its_own_image_and_nothing_of_another() -> None:
    """A row with a gain of its own tells nothing; the other row is as if alone."""
    e, g, s = 6.0, 2.0, 0.5
    left = sigma_left([rows(g, e, nuisance=3.0), rows(g, e)], np.array([s]), "one")
    assert left == pytest.approx(e / np.sqrt(1.0 + (g * s) ** 2), rel=1e-6)


@pytest.mark.parametrize("sd", [0.0, 0.01, 0.5])
def test_a_nuisance_under_a_prior_takes_less(sd: float) -> None:
    """Two images of which one is brighter by e: their gains, known to s each, take all but e / sqrt(1 + (g s)^2)."""
    e, g = 10.0, 100.0
    two = [rows(0.0, e, nuisance=g, sd=max(sd, 1e-9)), rows(0.0, 0.0, nuisance=g, sd=max(sd, 1e-9))]
    assert sigma_left(two, np.array([1.0]), "one") == pytest.approx(e / np.sqrt(1.0 + (g * sd) ** 2), abs=1e-6)


def test_a_rival_takes_its_projection_at_any_size() -> None:
    """The sine of the angle between (3, 4) and (1, 0), times 5; the sign of the rival's size is open."""
    two = [rows(0.0, 3.0, 1.0), rows(0.0, 4.0, 0.0)]
    assert sigma_left(two, np.array([1.0]), "one") == pytest.approx(5.0, rel=1e-9)
    assert sigma_left(two, np.array([1.0]), "one", ["other"]) == pytest.approx(4.0, rel=1e-9)
