"""Derivatives by what one sample has of its own of an effect."""

from __future__ import annotations

import numpy as np
import pytest

from luxloop.effect import AppliedEffect
from luxloop.model import Fit, Model
from tests.validation.prediction.views import FOUR, view
from tests.validation.workers import Workers
from validation.prediction import Anchored, Predictor
from validation.prediction import images as images_module
from validation.sample_values import with_sample

GRADIENT = "dbr_thickness_gradient", "gradient_per_mm"
OF_ALL = "effects." + ".".join(GRADIENT)


@pytest.mark.parametrize("histories", [0, 4096], ids=["by the twin", "about Monte Carlo"])
def test_a_derivative_by_a_samples_own_value_is_that_of_all_in_its_image(
    workers: Workers, model: Model, monkeypatch: pytest.MonkeyPatch, histories: int
) -> None:
    """And 0 in another's, whatever the anchor's model has; their names have dots."""
    monkeypatch.setattr(images_module, "DIFFERENCE_EXITS", 1 << 15)
    two = [view(FOUR.model_copy(update={"id": name, "dbr_pairs": 2.5})) for name in ("four-2.5", "more-2.5")]
    effect = AppliedEffect(name=GRADIENT[0], parameters={GRADIENT[1]: 0.01})
    limits = {OF_ALL: Fit(free=True, lower=-0.05, upper=0.05)}
    of_all = model.model_copy(update={"effects": (effect,), "fit": model.fit | limits})
    own = with_sample(of_all, "four-2.5", GRADIENT[0], {GRADIENT[1]: 0.01})
    path = "samples.four-2.5." + ".".join(GRADIENT)
    predictor, anchor = Predictor(workers), Anchored(model, histories)
    (wanted, _), (here, there) = (
        [one.jacobian_per_mm2[by] for one in predictor.images(of, two, (by,), anchor)]
        for of, by in ((of_all, OF_ALL), (own, path))
    )
    np.testing.assert_allclose(here, wanted, rtol=1e-6, atol=1e-9 * np.abs(wanted).max())
    assert np.abs(wanted).max() > 0.0
    assert not there.any()
