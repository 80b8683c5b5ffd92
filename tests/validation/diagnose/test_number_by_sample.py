"""Effects that each sample has its own of, in a diagnosis: what is told of them, and beside which others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.effect import AppliedEffect
from luxloop.model import Fit as Limits
from luxloop.model import Model
from tests.validation.analytic import MODEL, PATHS, SINGLE, Spots
from tests.validation.diagnose import made_up, rippled
from tests.validation.diagnose.made_up import ARRAY, RISE, THIRD, data, diagnosis, hidden, images_of, seen, spec
from validation.diagnose.columns import FitSight, candidates_of
from validation.diagnose.ending import finished
from validation.diagnose.frozen import FrozenImages, slopes_of
from validation.diagnose.in_words import limits
from validation.diagnose.next_measurement import Rivals
from validation.diagnose.refit import freed
from validation.diagnose.refitted import Refitted
from validation.diagnose.score import Projected, scores
from validation.diagnose.tried import of_all_or_each, promised
from validation.effects.known import applied, with_effect
from validation.fit import fit
from validation.prediction import Anchored, Predicted, View
from validation.prediction.differences import moved_models
from validation.sample_values import LEAD, numbers, of_sample, with_sample

TILTED = spec("ripple").model_copy(update={"scope": "per_sample"})
RISEN = RISE.model_copy(update={"scope": "per_sample"})
AFFECTED: Any = made_up.Affected()
"""It predicts as a predictor does."""


@pytest.mark.parametrize("seed", range(1, 6))
def test_what_would_have_been_seen_is_of_all_samples(seed: int) -> None:
    """Regression: noise chose the sample whose number it was told of, and its limit was up to three times as high."""
    values = {}
    for one in (spec("ripple"), TILTED):
        found = diagnosis(data(None, seed), known=[one])
        assert found.verdict.word == "nothing_visible"
        ((name, parameter, values[one.scope], _),) = limits(found.steps[0].scores)
        assert (name, parameter) == ("ripple", "size")
    assert values["per_sample"] == pytest.approx(values["global"], rel=0.15)  # for more numbers that were looked at


@pytest.mark.parametrize("size", [0.01, 0.05])
def test_one_number_of_all_is_kept_where_those_of_each_bring_no_more(size: float) -> None:
    """Whichever scores best by itself: one image holds most of what is known of it, and noise may put it first."""
    kept = set()
    for seed in range(6):
        base = fit(MODEL, images_of(hidden("ripple", {"size": size}), seed), AFFECTED, free=PATHS)
        projected = Projected.of(candidates_of(base, [TILTED], FitSight.of(base, AFFECTED)), base.basis)
        assert [one.sample for one in projected.candidates] == ["", "single", "array", "third"]
        (one,) = scores(projected, base.residual_with_priors).effects
        assert one.apart is not None
        assert (one.best.candidate.sample, one.shapes) == ("", 4)
        assert one.largest.drop == max(one.best.drop, one.apart.drop)
        kept.add(of_all_or_each(base, one).best.candidate.sample)
    assert kept == {""}


def test_numbers_of_samples_promise_together_what_their_ranges_allow() -> None:
    """Opposite sizes of two: each by itself half of it; on a side that does not exist one promises nothing."""
    truth = hidden("ripple", {"size": 0.0}, array={"size": 0.05}, third={"size": -0.05})
    base = fit(MODEL, images_of(truth, 3), AFFECTED, free=PATHS)
    two_sided = TILTED.parameters[0]
    promises = []
    for parameter in (two_sided, two_sided.model_copy(update={"lower": 0.0, "one_sided": True})):
        effect = TILTED.model_copy(update={"parameters": (parameter,)})
        projected = Projected.of(candidates_of(base, [effect], FitSight.of(base, AFFECTED)), base.basis)
        (one,) = scores(projected, base.residual_with_priors).effects
        chosen = of_all_or_each(base, one)
        assert chosen.best is one.apart
        promises.append((promised(base, chosen.best)[0], chosen.best.drop))
    (both, single), (positive, alone) = promises
    assert both > 1.5 * single
    assert positive == pytest.approx(alone, rel=0.05)


def test_a_change_is_predicted_as_it_was_fitted_sample_by_sample() -> None:
    """Regression: all samples, the opposite one too, had the size of the one that scored; a new one has that."""
    base = fit(MODEL, data(None, 1), AFFECTED, free=PATHS)
    found = candidates_of(base, [RISEN], FitSight.of(base, AFFECTED))
    by_path = {one.path: one for one in found}
    names = [f"samples.{sample}.rise.{name}" for sample in ("array", "third") for name in "ab"]
    first, *others = (by_path[name] for name in names)
    size = dict(zip(names, (0.1, 0.2, -0.1, -0.3), strict=True))
    scored = replace(first, others=tuple(others))
    one: Any = SimpleNamespace(candidate=scored, shape=(), size=size)
    refit: Refitted = one
    model = Rivals(base, (), AFFECTED, frozenset())._at_size(MODEL, refit)
    wanted = {"array": (0.1, 0.2), "third": (-0.1, -0.3), "single": (0.0, 0.0), "next-array": (0.1, 0.2)}
    for sample, values in wanted.items():
        (effect,) = of_sample(model, sample).effects
        assert effect.parameters == dict(zip("ab", values, strict=True))


def test_numbers_of_samples_are_known_beside_a_straight_line() -> None:
    """Regression: with tables of limits gone nobody knew them, and a second effect by sample ended the diagnosis.

    What is asked of one sample's image alone has no part of the others' lines.
    """
    asked = list[Model]()

    class Asked:
        def images(
            self, model: Model, views: Sequence[View], paths: Sequence[str] = (), _: Anchored | None = None
        ) -> list[Predicted]:
            asked.append(model)
            assert set(paths) <= set(numbers(model))
            blank = [np.zeros((view.rows, view.columns)) for view in views]
            return [Predicted(one, dict.fromkeys(paths, one)) for one in blank]

    effects = tuple(AppliedEffect(name=name, parameters=of) for name, of in
                    (("ripple", {"size": 0.1}), ("rise", {"a": 0.0, "b": 0.0})))  # fmt: skip
    fits = {path: Limits(free=True, lower=-0.5, upper=0.5) for path in ("effects.rise.a", "effects.ripple.size")}
    model = with_sample(MODEL.model_copy(update={"effects": effects, "fit": fits}), "array", "rise", {"a": 0.2})
    slopes = {"effects.ripple.size": [np.ones((side, side)) for side in (4, 5, 6)]}
    inner: Any = Asked()
    frozen = FrozenImages(inner, slopes, frozenset(), frozenset(["ripple"]))
    views = [View(sample, side, side, 50.0, (2.0, 2.0)) for sample, side in ((SINGLE, 4), (ARRAY, 5), (THIRD, 6))]
    found = frozen.images(model, views, ["samples.array.rise.a"], Anchored(MODEL, 100))
    assert [one.irradiance_per_mm2.max() for one in found] == pytest.approx([0.1] * 3)
    assert [one.name for one in asked[-1].effects] == ["rise"]
    (alone,) = frozen.images(model, views[2:], [], Anchored(model, 100))
    assert (alone.irradiance_per_mm2.shape, alone.irradiance_per_mm2.max()) == ((6, 6), 0.0)


class LineAndRise(Spots):
    """Ripples that only Monte Carlo shows, and a rise that the twin knows, moved as workers' predictors move it."""

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None, **_: Any
    ) -> list[Predicted]:
        """As workers answer."""
        of_effects = [path for path in paths if path.startswith(("effects.", LEAD))]
        moved = {path: moved_models(model, path) for path in of_effects}
        at = anchor.model if anchor is not None and anchor.histories else MODEL
        found = []
        spots = super().images(model, views, [path for path in paths if path not in of_effects])
        for view, one in zip(views, spots, strict=True):
            (there,) = super().images(at, [view])
            line = rippled.traced(alone(at, "ripple"), view, there.irradiance_per_mm2) - there.irradiance_per_mm2
            twin = seen(alone(model, "rise"), view, one.irradiance_per_mm2)
            slopes = {path: seen(alone(model, "rise"), view, part) for path, part in one.jacobian_per_mm2.items()}
            for path, steps in moved.items():
                images = [
                    step.weight * seen(alone(step.what, "rise"), view, one.irradiance_per_mm2) for step in steps
                ]
                slopes[path] = np.sum(images, axis=0)
            found.append(replace(one, irradiance_per_mm2=twin + line, twin_per_mm2=twin, jacobian_per_mm2=slopes))
        return found


def alone(model: Model, effect: str) -> Model:
    """The model with one effect only."""
    return model.model_copy(update={"effects": tuple(one for one in model.effects if one.name == effect), "fit": {}})


def test_a_second_effect_by_sample_is_fitted_to_its_end_beside_a_straight_line() -> None:
    """Regression: round two of a diagnosis ended with InputError. Opposite rises, each within errors."""
    sizes, predictor = {"array": 0.1, "third": -0.1}, LineAndRise()
    ripple = with_effect(MODEL, applied(rippled.RIPPLE, {"size": rippled.TRUTH}))
    rise = with_effect(MODEL, applied(RISEN, {"a": 0.0, "b": 0.0}))
    for sample, size in sizes.items():
        rise = with_sample(rise, sample, "rise", {"a": size, "b": 0.0})

    def light(view: View) -> Any:
        (one,) = Spots().images(MODEL, [view])
        return seen(rise, view, rippled.traced(ripple, view, one.irradiance_per_mm2))

    images = rippled.noisy(light, 4, ("third", THIRD))
    base = fit(MODEL, images, predictor, free=PATHS, anchor_at=lambda at: Anchored(at, rippled.ANCHORED, seed=7))
    first = finished(freed(base, rippled.score_of(base), slopes_of(base)), predictor, None).fit
    assert first is not None
    assert isinstance(first.problem.predictor, FrozenImages)
    assert first.problem.predictor.lines == {"ripple"}
    sight: Any = predictor
    projected = Projected.of(candidates_of(first, [RISEN], FitSight.of(first, sight)), first.basis)
    (one,) = scores(projected, first.residual_with_priors, first.variance_scale).effects
    second = finished(freed(first, of_all_or_each(first, one).best, slopes_of(first)), first.problem.predictor, None)
    assert second.fit is not None
    for sample, size in sizes.items():
        path = f"samples.{sample}.rise.a"
        assert abs(second.fit.value(path) - size) < 3.0 * second.fit.error(path)
    assert second.fit.value("effects.ripple.size") == pytest.approx(rippled.TRUTH, abs=0.01)
