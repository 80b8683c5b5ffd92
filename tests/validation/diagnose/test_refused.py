"""Effects that data cannot have: each is told with its reason, counts as not tested, and is refused by name."""

from __future__ import annotations

from dataclasses import replace

import pytest

from luxloop.effect import EffectSpec
from luxloop.errors import InputError
from tests.validation.analytic import MODEL, PATHS
from tests.validation.diagnose.made_up import CATALOGUE, CHIPS, Affected, data, spec
from validation.comparing import Solver
from validation.diagnosing import Diagnosing
from validation.effects.known import Known
from validation.measured import MeasuredImage
from validation.observed import Observed


def engine(images: list[MeasuredImage], *known: EffectSpec) -> Diagnosing:
    """A diagnosis of images by these effects."""
    seen, catalogue = Observed(tuple(images), (), (), {}), Known(known, {}, {})
    return Diagnosing(MODEL, seen, Affected(), catalogue, Solver(None), PATHS)  # type: ignore[arg-type]  # it predicts as a predictor does


def test_an_effect_of_chips_is_told_as_not_tested_where_there_are_single_ones_alone() -> None:
    """And is not counted among those that explain nothing; `next` and `add` refuse it by name."""
    shots = [data("spiral", seed, 0.08)[0] for seed in (1, 2)]
    images = [replace(one, shot=one.shot.model_copy(update={"id": f"again-{n}"})) for n, one in enumerate(shots)]
    asked = engine(images, CHIPS, *CATALOGUE)
    found = asked.diagnosed()
    assert found.verdict.word == "none_of_the_known"
    assert "None of the 4 known effects explains this" in found.verdict.sentence
    assert found.known == 4
    assert asked.untested == ["chips: no image is of a module of several chips"]
    base = asked.fitted(MODEL)
    with pytest.raises(InputError, match="no image is of a module of several chips"):
        asked.scored(base, [CHIPS, spec("ripple")])
    with pytest.raises(InputError, match="no image is of a module of several chips"):
        asked.added(base, CHIPS)
