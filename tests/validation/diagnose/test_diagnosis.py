"""Verdicts on made-up data: each of the five, with sizes, shares and held-out errors against what is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from luxloop.model import Fit as Limits
from tests.validation.analytic import HALO, MODEL
from tests.validation.diagnose.made_up import CATALOGUE, data, diagnosis, ground_of, spec
from validation.diagnose.diagnosis import limits
from validation.diagnose.ladder import Rung


def test_nothing_hidden_is_nothing_visible() -> None:
    """With limits for every effect, each of them seen at four to six of its errors."""
    found = diagnosis(data(None, 1))
    assert found.verdict.word == "nothing_visible"
    assert found.verdict.sentence.startswith("No missing effect visible. An effect of this kind would have been seen")
    names = [name for name, *_ in limits(found.steps[0].scores)]
    assert set(names) == {one.name for one in CATALOGUE}
    by_name = {name: value for name, _, value, _ in limits(found.steps[0].scores)}
    ripple = found.steps[0].scores.of("ripple")
    assert ripple is not None
    assert 4.0 < by_name["ripple"] / ripple.best.error < 6.0


def test_what_is_above_its_limit_is_seen() -> None:
    """The limit promises 90 % power: of ten draws at that size at least seven are visible."""
    by_name = {name: value for name, _, value, _ in limits(diagnosis(data(None, 1)).steps[0].scores)}
    words = [diagnosis(data("ripple", seed, by_name["ripple"])).verdict.word for seed in range(10)]
    assert sum(word != "nothing_visible" for word in words) >= 7


def test_one_effect_is_named_with_its_size() -> None:
    """The size within three errors, nearly all of the structure explained, the held-out error at the noise."""
    found = diagnosis(data("stripes", 2, 0.05, 300.0), known=[one for one in CATALOGUE if "like" not in one.name])
    assert found.verdict.word == "one_effect"
    assert found.verdict.sentence.startswith("One effect explains the misfit: stripes, size 0.0")
    best = found.added[0]
    assert abs(best.value - 0.05) < 3.0 * best.error
    assert best.share.value > 0.9
    assert best.share.decides
    assert best.held_out is not None
    assert best.held_out.falls
    assert best.held_out_percent is not None
    assert best.held_out_percent[1] < best.held_out_percent[0]
    assert best.p_left > 0.005
    assert best.log_evidence is not None
    assert best.log_evidence > 10.0
    shape = dict(found.steps[0].refits[0].candidate.shape)
    assert shape == {"length_um": 300.0}


def test_an_effect_whose_square_counts_is_fitted_from_off() -> None:
    """Fog of 0.3: nothing has a slope at 0, yet it is found."""
    best = diagnosis(data("fog", 3, 0.3)).added[0]
    assert best.name == "fog"
    assert abs(best.value - 0.3) < 3.0 * best.error


def test_two_that_are_alike_are_not_told_apart() -> None:
    """Both are in the set, and the measurement to take is said."""
    found = diagnosis(data("ripple", 4, 0.012))
    assert found.verdict.word == "cannot_tell_apart"
    assert set(found.verdict.set) == {"ripple", "ripple_like"}
    assert found.verdict.sentence.startswith("The data cannot tell apart ripple")
    assert found.verdict.sentence.endswith("Take one image: another.")


def test_what_nobody_knows_is_not_blamed_on_anybody() -> None:
    """A spiral in the images: the best effect explains less than half, and where it is left is told."""
    found = diagnosis(data("spiral", 5, 0.08))
    assert found.verdict.word == "none_of_the_known"
    assert "None of the 4 known effects explains this" in found.verdict.sentence
    assert "sigma at" in found.verdict.sentence
    assert "by DBR: 0 pairs" in found.verdict.sentence


def test_two_effects_are_found_one_after_the_other() -> None:
    """Stripes and fog together: both named, the second after the first."""
    known = [spec("ripple"), *CATALOGUE[2:]]
    images = data("stripes", 6, 0.08, 300.0)
    fogged = [
        replace(one, signal_dn=0.9 * one.signal_dn + 0.1 * gaussian_filter(one.signal_dn, 3.0)) for one in images
    ]
    found = diagnosis(fogged, known=known)
    assert {one.name for one in found.added} == {"stripes", "fog"}
    assert "What it leaves is explained by" in found.verdict.sentence


def test_a_fit_at_its_limit_is_not_blamed_on_an_effect() -> None:
    """Where the halo may not be what it is, and no effect brings it back, the fit is what is wrong."""
    tight = MODEL.model_copy(
        update={
            "environment": MODEL.environment.model_copy(
                update={"substrate": MODEL.environment.substrate.model_copy(update={"reflectance": 0.5})}
            ),
            "fit": MODEL.fit | {HALO: Limits(free=True, lower=0.3, upper=0.6)},
        }
    )
    found = diagnosis(data(None, 7), tight)
    assert found.verdict.word in ("fit_not_trustworthy", "none_of_the_known")
    assert "limit" in found.verdict.sentence or found.verdict.word == "none_of_the_known"


def test_the_share_of_a_right_model_is_one_and_of_the_base_nothing() -> None:
    """The family that was loudest judges; the error covers the difference."""
    ground = ground_of(diagnosis(data("stripes", 8, 0.1, 300.0)).steps[0].ground.fit)
    loudest = ground.loudest
    assert loudest.share(ground.fit.residual, ground.fit.variance_scale).value == pytest.approx(0.0, abs=0.05)
    noise = np.random.default_rng(1).standard_normal(ground.fit.residual.size)
    right = loudest.share(ground.projection.residual(noise))
    assert abs(right.value - 1.0) < 3.0 * right.error + 0.05


def test_a_right_model_is_at_the_noise_of_its_rung() -> None:
    """Fitted error and noise agree where nothing is hidden; held out is a little above."""
    rung = Rung.of(ground_of(diagnosis(data(None, 9)).steps[0].ground.fit))
    assert rung.fitted_percent == pytest.approx(rung.noise_percent, rel=0.02)
    assert rung.held_out_percent is not None
    assert rung.fitted_percent < rung.held_out_percent < 1.2 * rung.noise_percent
