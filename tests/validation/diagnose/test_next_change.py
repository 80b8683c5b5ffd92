"""What an effect of its fitted size does to the images that a further measurement would give."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.model import Model
from tests.validation.effects.test_signatures import AMPLITUDE, BASE, ONE, SIDE, SINGLE, Pretended, sight_of, spec_of
from validation.diagnose.next_measurement import Rivals
from validation.diagnose.refit import Refitted
from validation.diagnose.score import Candidate


@pytest.mark.parametrize("walks", [False, True])
def test_the_noise_of_another_walk_is_no_change_that_an_effect_makes(walks: bool) -> None:
    """A separation by it would be told of any image; of an effect with walks of its own they begin nearly off."""
    noise = 5.0 * np.random.default_rng(3).standard_normal((SIDE, SIDE))

    def image(at: dict[str, Any]) -> Any:
        return BASE if "mine.a" not in at else BASE + walks * noise + at["mine.a"] * ONE

    predictor = Pretended(image)
    model, spec = Model(name="m"), spec_of(AMPLITUDE, walks=walks)
    candidate = Candidate(spec, spec.parameters[0], (), np.zeros((1, 1)))
    found: Any = SimpleNamespace(candidate=candidate, value=0.4, model=None, shape=())
    rivals = Rivals(SimpleNamespace(model=model), (), predictor, frozenset())  # type: ignore[arg-type]  # its model is all that is asked for
    one: Refitted = found
    (change,) = rivals._change(sight_of(predictor, SINGLE), one)
    np.testing.assert_allclose(change, 0.4 * ONE, rtol=1e-5)
