"""Effects that are there or not, fitted: where the fit without one went to make up for it, and beside Monte Carlo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from luxloop.model import Model
from tests.validation.analytic import HALO, MODEL, PATHS, Spots
from tests.validation.diagnose.made_up import seen, spec
from tests.validation.diagnose.test_refit import ANCHORED, RIPPLE, TRUTH, data, noisy, strength
from validation.diagnose.refit import switched
from validation.diagnose.score import Candidate
from validation.effects.known import applied, with_effect
from validation.fit import fit
from validation.prediction import Anchored, Predicted, View


class Turned(Spots):
    """Spots of which a switch exchanges what is far from what is near."""

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """As workers answer; with the switch the halo is what it lacks of 1."""
        if not model.effects:
            return super().images(model, views, paths, anchor)
        other = model.model_copy(update={"effects": ()}).with_value(HALO, 1.0 - float(model.leaves()[HALO]))
        found = []
        for one in super().images(other, views, paths, anchor):
            turned = {path: -column if path == HALO else column for path, column in one.jacobian_per_mm2.items()}
            found.append(replace(one, jacobian_per_mm2=turned))
        return found


def test_a_switch_is_fitted_together_with_what_made_up_for_it() -> None:
    """The fit without it goes to the other end of the halo; with it the value that the model had is right."""
    switch, truth = spec("switch"), MODEL.with_value(HALO, 0.2)
    with_it = with_effect(truth, applied(switch, {"size": 1.0}))
    images = noisy(lambda view: Turned().images(with_it, [view])[0].irradiance_per_mm2, 6)
    without_it = fit(truth, images, Turned(), free=(HALO,))
    assert without_it.value(HALO) == pytest.approx(0.8, abs=0.05)
    candidate = Candidate(switch, switch.parameters[0], (("size", 1.0),), np.zeros((1, 1)), (), is_switch=True)
    found = switched(without_it, candidate)
    assert found.fit is not None
    assert found.fit.value(HALO) == pytest.approx(0.2, abs=4.0 * found.fit.error(HALO))
    assert found.fit.chi2 == pytest.approx(found.fit.freedom, rel=0.1)


class Misleading(Spots):
    """Spots of which a switch adds a ripple; Monte Carlo without it has most of the ripple, with it none beyond."""

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """As workers answer: what the twin errs by at the anchor is carried over."""
        misled = anchor is not None and anchor.histories > 0 and not anchor.model.effects
        ripple = strength(TRUTH) * ((1.0 if model.effects else 0.0) + (0.6 if misled else 0.0))
        rippled = MODEL.model_copy(update={"effects": (applied(RIPPLE, {"size": ripple}),)})
        found = []
        for view, one in zip(views, super().images(model, views, paths, anchor), strict=True):
            found.append(replace(one, irradiance_per_mm2=seen(rippled, view, one.irradiance_per_mm2)))
        return found


def test_a_switch_that_fits_worse_than_nothing_beside_the_anchor_is_held_against_the_twin() -> None:
    """Beside the anchor it has the ripple twice; by the twin alone it is right, and so it is about its own anchor."""
    switch = spec("switch")
    base = fit(MODEL, data(), Misleading(), free=PATHS, anchor_at=lambda model: Anchored(model, ANCHORED, seed=7))
    assert base.chi2 > 1.3 * base.freedom
    candidate = Candidate(switch, switch.parameters[0], (("size", 1.0),), np.zeros((1, 1)), (), is_switch=True)
    found = switched(base, candidate)
    assert found.fit is not None
    about = found.fit.problem.anchor
    assert about is not None
    assert about.model.effects
    assert found.fit.chi2 == pytest.approx(found.fit.freedom, rel=0.1)
    assert isinstance(found.fit.problem.predictor, Misleading)  # not those of frozen derivatives


def test_a_switch_that_the_twin_finds_wrong_costs_no_monte_carlo() -> None:
    """Of images without the ripple."""
    predictor = Misleading()
    images = noisy(lambda view: Spots().images(MODEL, [view])[0].irradiance_per_mm2, 8)
    base = fit(MODEL, images, predictor, free=PATHS, anchor_at=lambda model: Anchored(model, ANCHORED, seed=7))
    switch = spec("switch")
    switched(base, Candidate(switch, switch.parameters[0], (("size", 1.0),), np.zeros((1, 1)), (), is_switch=True))
    assert not any(at is not None and at.histories and at.model.effects for at in predictor.anchors)
