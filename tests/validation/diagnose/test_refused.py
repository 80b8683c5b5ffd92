"""Effects that data cannot have: each is told with its reason, counts as not tested, and is refused by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from luxloop.effect import AppliedEffect, EffectSpec
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.model import Model
from tests.validation.analytic import MODEL, PATHS, SINGLE
from tests.validation.diagnose.made_up import CATALOGUE, CHIPS, Affected, data, images_of, spec
from validation.comparing import Solver
from validation.dataset.manifest import FarFieldShot
from validation.dataset.spectra import FarFieldTable
from validation.diagnosing import Diagnosing
from validation.effects.known import Known
from validation.fit import curves_of
from validation.measured import MeasuredFarField, MeasuredImage
from validation.observed import Observed
from validation.prediction import FarView, Predicted, PredictedCurve


def engine(images: list[MeasuredImage], *known: EffectSpec, predictor: Affected | None = None) -> Diagnosing:
    """A diagnosis of images by these effects."""
    seen, catalogue = Observed(tuple(images), (), (), {}), Known(known, {}, {})
    return Diagnosing(MODEL, seen, predictor or Affected(), catalogue, Solver(None), PATHS)  # type: ignore[arg-type]  # it predicts as a predictor does


class OneOfTwo(Affected):
    """A worker that has ripples or stripes, and not both."""

    def __init__(self) -> None:
        super().__init__()
        self.refusals = 0

    def images(self, model: Model, *more: Any) -> list[Predicted]:
        """As `Affected`."""
        if {"ripple", "stripes"} <= {one.name for one in model.effects}:
            self.refusals += 1
            raise RemoteError(Failure(code="bad_input", message="one of the two"))
        return super().images(model, *more)


@pytest.mark.parametrize(
    ("ripple", "stripes", "refusals"), [(("stripes",), (), 0), ((), ("ripple",), 0), ((), (), 1)]
)
def test_what_only_a_later_round_cannot_have_was_tested(
    ripple: tuple[str, ...], stripes: tuple[str, ...], refusals: int
) -> None:
    """What says the same as an effect that was added is not asked for; what a worker refuses then is not told."""
    specs = (
        spec("ripple").model_copy(update={"excludes": ripple}),
        CATALOGUE[3].model_copy(update={"excludes": stripes}),
    )
    both = AppliedEffect(name="stripes", parameters={"size": 0.08, "length_um": 300.0})
    fog = AppliedEffect(name="fog", parameters={"size": 0.3})
    predictor = OneOfTwo()
    images = images_of(MODEL.model_copy(update={"effects": (both, fog)}), 6)
    asked = engine(images, *specs, CATALOGUE[2], predictor=predictor)
    found = asked.diagnosed()
    assert {one.name for one in found.added} == {"stripes", "fog"}
    assert asked.untested == []
    assert predictor.refusals == refusals


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


class Far(Affected):
    """Far fields that ripples bend."""

    def far_fields(
        self, model: Model, views: Sequence[FarView], paths: Sequence[str], *_: Any
    ) -> list[PredictedCurve]:
        """(1 + size cos 6 theta) cos theta / pi."""
        size = sum(float(one.parameters["size"]) for one in model.effects)  # type: ignore[arg-type]  # a number
        angles = [np.radians(view.theta_deg) for view in views]
        bent = [np.cos(6.0 * theta) * np.cos(theta) / np.pi for theta in angles]
        return [
            PredictedCurve(np.cos(theta) / np.pi + size * one, dict.fromkeys(paths, one))
            for theta, one in zip(angles, bent, strict=True)
        ]


def test_what_each_sample_has_of_its_own_is_added_to_far_fields_as_diagnose_named_it() -> None:
    """Regression: samples were looked for in images, of which there are none, and add refused what was named."""
    tilted = spec("ripple").model_copy(update={"scope": "per_sample"})
    theta = np.arange(0.0, 80.0, 2.0)
    value = (1.0 + 0.1 * np.cos(6.0 * np.radians(theta))) * np.cos(np.radians(theta))
    noise = 0.003 * np.random.default_rng(1).standard_normal(theta.size)
    table = FarFieldTable(theta, 0.0 * theta, value + noise, np.full(theta.size, 0.003))
    shot = FarFieldShot(id="far", kind="far_field", sample=SINGLE.id, file="far.csv")
    asked = engine([], tilted, predictor=Far())
    seen = Observed((), tuple(curves_of([], [MeasuredFarField(shot, SINGLE, table)])), (), {})
    asked = replace(asked, observed=seen, free=())
    assert asked.diagnosed().set == ("ripple",)
    added = asked.added(asked.fitted(MODEL), tilted)
    assert abs(added.value("effects.ripple.size") - 0.1) < 3.0 * added.error("effects.ripple.size")
