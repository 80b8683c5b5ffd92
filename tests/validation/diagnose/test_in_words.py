"""What a verdict says of what it could not see: a few limits, and what the noise of Monte Carlo hides."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from tests.validation.analytic import ARRAY, MODEL, Spots
from tests.validation.diagnose.made_up import CATALOGUE, GAIN, data, diagnosis
from validation.diagnose.in_words import FEW, limits, limits_in_words, more_in_words
from validation.fit import fit
from validation.prediction import Anchored


def test_what_noise_of_monte_carlo_hides_is_said_with_the_histories_that_show_it() -> None:
    """As the noisiest sample asks for, counted from its own; what a command takes at most; where it is little more
    than there are, or there is no Monte Carlo, nothing."""

    def words(share: float, most: int = 0) -> str:
        images = data(None, 1)
        light = {one.sample.id: np.sqrt(one.variance_dn2(one.signal_dn))[None] / GAIN for one in images}
        noise = {name: (share if name == ARRAY.id else 0.03) * one for name, one in light.items()}
        here = fit(
            MODEL, images, Spots(noise), anchor_at=lambda model: Anchored(model, 1_000_000), most_histories=most
        )
        return more_in_words(here)

    assert words(0.07) == ""
    assert words(0.2).endswith("--most-histories 4000000 would show smaller ones.")
    assert words(0.2, 2_000_000).endswith(
        "--most-histories 8000000 would show smaller ones."
    )  # it falls only on paper
    assert words(0.103) == ""
    assert words(30.0).endswith("--most-histories 1000000000 would show smaller ones.")
    assert more_in_words(fit(MODEL, data(None, 1), Spots())) == ""


def test_what_is_above_its_limit_is_seen() -> None:
    """The limit promises 90 % power: of ten draws at that size at least seven are visible."""
    by_name = {name: value for name, _, value, _ in limits(diagnosis(data(None, 1)).steps[0].scores)}
    words = [diagnosis(data("ripple", seed, by_name["ripple"])).verdict.word for seed in range(10)]
    assert sum(word != "nothing_visible" for word in words) >= 7


def test_a_limit_is_so_many_errors_as_level_and_power_ask_for() -> None:
    """Half of 1 % for the scores, either side, of four effects: 3.227 sigma, more for one of several shapes (3.43 of
    two), and 1.282 more for 90 %; by name."""
    effects = diagnosis(data(None, 1)).steps[0].scores
    wanted = {one.name: (norm.isf(0.0025 / 4.0 / one.shapes) + 1.2816) * one.best.error for one in effects.effects}
    assert norm.isf(0.0025 / 4.0) == pytest.approx(3.2272, abs=1e-4)
    assert {one.name for one in effects.effects if one.shapes > 1} == {"stripes"}
    wanted["fog"] = np.sqrt(wanted["fog"])  # its image goes with the square
    found = {name: value for name, _, value, _ in limits(effects)}
    assert len(wanted) == 4
    assert found == pytest.approx({name: wanted[name] for name in found}, rel=1e-4)
    assert {"ripple", "fog"} < set(found)


def test_a_sentence_names_a_few_limits_and_counts_the_others() -> None:
    """All of them stand in the table."""
    scores = diagnosis(data(None, 1)).steps[0].scores
    words = limits_in_words(scores)
    assert len(words) == FEW + 1
    assert words[-1] == f"{len(CATALOGUE) - FEW} more in the table"
