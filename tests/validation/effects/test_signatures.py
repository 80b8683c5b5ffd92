"""Columns of effects by differences of whole predictions, and angles between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from containers.bsdf import Mirror
from containers.effects.side_wall_roughness import SideWallRoughness
from containers.ray_tracing.arrays import SHUT
from containers.ray_tracing.packing import scene_arrays
from luxloop.effect import AppliedEffect, EffectParameter, EffectSpec
from luxloop.errors import InputError
from luxloop.model import Model
from tests.ray_scenes import scene
from validation.dataset.manifest import Sample
from validation.effects.confounding import Confounding, confounding
from validation.effects.known import (
    NEAR_OFF,
    Known,
    acting,
    far_end,
    is_smooth,
    nearly_off,
    off_values,
    shapes_of,
    stanza,
    typical,
    with_effect,
)
from validation.effects.known import applied as applied_to
from validation.effects.signatures import ALONE, HISTORIES, RUNS, Projection, Sight, projected, signature
from validation.fit.least_squares import Basis
from validation.fit.whitening import Whitening
from validation.prediction import Predicted, View
from validation.prediction.differences import Moved
from validation.sample_values import of_sample, with_sample

SIDE = 6
SAMPLE = {"distance_um": 180.0, "width_um": 40.0, "spacing_um": 500.0, "thickness_um": 20.0, "dbr_pairs": 0.0}
SINGLE = Sample(id="a", layout="single", **SAMPLE)
ARRAY = Sample(id="b", layout="array", rows=2, columns=2, **SAMPLE)
RANDOM = np.random.default_rng(1)
BASE, ONE, TWO = RANDOM.uniform(1.0, 2.0, (3, SIDE, SIDE))


class Pretended:
    """Predicts images by a formula in the values of the model's effects; counts how often it is asked."""

    def __init__(self, image: Callable[[dict[str, Any]], Any]) -> None:
        self.image, self.asked, self.anchors = image, 0, []  # type: ignore[var-annotated]
        self.models: list[Model] = []
        self.exit_seed = 1

    def images(self, model: Model, views: Sequence[View], _: Sequence[str] = (), anchor: Any = None) -> list[Any]:
        """One image for each view."""
        self.asked += 1
        self.anchors.append(anchor)
        return [Predicted(self.image(values_in(of_sample(model, view.sample.id))), {}) for view in views]

    def several(self, wanted: Sequence[tuple[Model, View]], lender: Model, exit_seed: int = 1) -> list[Any]:
        """The image of each view, in one question."""
        self.exit_seed = exit_seed
        self.models += [model for model, _ in wanted]
        asked, seen = self.asked + 1, [self.images(model, [view], (), lender) for model, view in wanted]
        self.asked = asked
        return [found.irradiance_per_mm2 for (found,) in seen]


def values_in(model: Model) -> dict[str, Any]:
    """The values of its effects, by "EFFECT.PARAMETER"; of chips none where nothing is written."""
    every = {f"{e.name}.{name}": value for e in model.effects for name, value in e.parameters.items()}
    return {name: value for name, value in every.items() if value != ()}


def spec_of(parameter: EffectParameter, **facts: Any) -> EffectSpec:
    """An effect with this parameter."""
    return EffectSpec(name="mine", stage="detector", description="", parameters=(parameter,), **facts)


def sight_of(predictor: Any, *samples: Sample) -> Sight:
    """Views of these samples, of six pixels a side."""
    views = [View(sample, SIDE, SIDE, 20.0, (2.5, 2.5)) for sample in samples]
    return Sight(predictor, views)


SMOOTH = np.asarray(2.0 + np.cos(np.pi * np.arange(40) / 40.0)[:, None] * np.ones(40))
NOISE = 0.05
AMPLITUDE = EffectParameter(name="a", description="", lower=-0.5, upper=0.5, off=0.0)


def test_a_derivative_in_the_value_is_that_of_the_formula() -> None:
    """Central differences of base + a one + a^2 two have the slope one, exactly."""
    predictor = Pretended(lambda at: BASE + at.get("mine.a", 0.0) * ONE + at.get("mine.a", 0.0) ** 2 * TWO)
    (column,) = signature(sight_of(predictor, SINGLE), Model(name="m"), spec_of(AMPLITUDE))
    np.testing.assert_allclose(column.parts[0], ONE, rtol=1e-12)
    assert column.step == pytest.approx(0.05)


def test_a_derivative_in_the_square_is_finite_where_that_in_the_value_is_zero() -> None:
    """A width counts by its square: base + w^2 one has the slope one by w^2, at off and one-sided."""
    width = EffectParameter(
        name="w_um", description="", unit="um", lower=0.0, upper=5.0, off=0.0, score_variable="square", one_sided=True
    )
    predictor = Pretended(lambda at: BASE + at.get("mine.w_um", 0.0) ** 2 * ONE)
    (column,) = signature(sight_of(predictor, SINGLE), Model(name="m"), spec_of(width))
    np.testing.assert_allclose(column.parts[0], ONE, rtol=1e-9)


def test_a_model_that_has_the_effect_is_moved_from_there() -> None:
    """The slope of a^2 at a = 0.2 is 0.4, and other values of the effect stay."""
    predictor = Pretended(lambda at: BASE + at.get("mine.a", 0.0) ** 2 * ONE)
    spec = spec_of(AMPLITUDE)
    model = with_effect(Model(name="m"), applied_to(spec, {"a": 0.2}))
    (column,) = signature(sight_of(predictor, SINGLE), model, spec)
    np.testing.assert_allclose(column.parts[0], 0.4 * ONE, rtol=1e-9)


@pytest.mark.parametrize(
    ("at", "values"), [(0.0, (0.0, 0.05, 0.1)), (0.04, (0.08, 0.0)), (0.095, (0.095, 0.0475, 0.0))]
)
def test_what_acts_by_chance_is_moved_as_far_as_there_is_room(at: float, values: tuple[float, ...]) -> None:
    """By half its range from off; from elsewhere to the nearer end, or by half the way to the other one."""
    share = EffectParameter(name="a", description="", lower=0.0, upper=0.1, off=0.0, one_sided=True)
    predictor, spec = Pretended(lambda at: BASE + at["mine.a"] * ONE), spec_of(share, by_chance=True)
    sight = sight_of(predictor, SINGLE)
    (column,) = signature(sight, with_effect(Model(name="m"), applied_to(spec, {"a": at})), spec)
    np.testing.assert_allclose(column.parts[0], ONE, rtol=1e-9)
    moved = [model.effects[0].parameters["a"] for model in predictor.models]
    assert moved == pytest.approx(values)


def test_a_parameter_per_chip_has_a_column_for_each_chip_in_the_views_of_such_modules() -> None:
    """Four chips, four columns; the single chip's image is not asked for and its part is 0."""
    gain = EffectParameter(name="gain", description="", lower=-0.5, upper=0.5, off=0.0, per_chip=True)
    weights = np.arange(1.0, 5.0)
    predictor = Pretended(lambda at: BASE + weights @ np.array(at.get("mine.gain", (0.0,) * 4)) * ONE)
    columns = signature(sight_of(predictor, SINGLE, ARRAY), Model(name="m"), spec_of(gain))
    assert [column.chip for column in columns] == [0, 1, 2, 3]
    for weight, column in zip(weights, columns, strict=True):
        assert not column.parts[0].any()
        np.testing.assert_allclose(column.parts[1], weight * ONE, rtol=1e-9)


def test_moved_models_are_asked_for_together_and_once_and_what_is_beyond_the_twin_is_traced() -> None:
    """They are remembered, and lent the base's exits; an effect beyond the twin has an anchor at each."""
    predictor = Pretended(lambda at: BASE + at.get("mine.a", 0.0) * ONE)
    sight = sight_of(predictor, SINGLE)
    for _ in range(2):
        signature(sight, Model(name="m"), spec_of(AMPLITUDE))
    assert predictor.asked == 1
    assert {lender.sha256 for lender in predictor.anchors} == {Model(name="m").sha256}
    predictor.anchors.clear()
    signature(sight, Model(name="m"), spec_of(AMPLITUDE, twin=False))
    assert [anchor.histories > 0 and anchor.seed for anchor in predictor.anchors] == [1, 1, 2, 2]
    assert {anchor.histories_of(SINGLE.id) for anchor in predictor.anchors} == {ALONE * HISTORIES}
    assert {anchor.histories_of(ARRAY.id) for anchor in predictor.anchors} == {HISTORIES}
    assert [anchor.exit_seed for anchor in predictor.anchors] == [1, 1, 2, 2]
    assert {anchor.model.sha256 for anchor in predictor.anchors} == {
        with_effect(Model(name="m"), applied_to(spec_of(AMPLITUDE), {"a": a})).sha256 for a in (0.5, -0.5)
    }


class Rough(Pretended):
    """Monte Carlo has noise, another for each seed and model; curves are not asked for."""

    def images(self, model: Model, views: Sequence[View], _: Sequence[str] = (), anchor: Any = None) -> list[Any]:
        """The formula, and noise."""
        found = super().images(model, views, (), anchor)
        random = np.random.default_rng([anchor.seed, int(model.sha256[:8], 16)])
        return [replace(one, irradiance_per_mm2=one.irradiance_per_mm2 + NOISE * random.standard_normal(SMOOTH.shape))
                for one in found]  # fmt: skip


def test_a_column_by_monte_carlo_is_nearer_the_light_than_the_mean_of_its_two_runs() -> None:
    """A smooth effect under white noise: most of the noise goes, for the runs do not agree about it."""
    sight = Sight(Rough(lambda at: 1.0 + at.get("mine.a", 0.0) * SMOOTH), [View(SINGLE, 40, 40, 20.0, (19.5, 19.5))])
    spec = spec_of(AMPLITUDE, twin=False)
    (column,) = signature(sight, Model(name="m"), spec)
    noise = NOISE / np.sqrt(2.0) / column.step / np.sqrt(RUNS)
    assert np.std(column.parts[0] - SMOOTH) < 0.3 * noise
    assert np.vdot(column.parts[0], SMOOTH) / np.vdot(SMOOTH, SMOOTH) == pytest.approx(1.0, abs=0.05)
    switched = sight.summed([Moved(1.0, Model(name="n")), Moved(-1.0, Model(name="m"))], True)
    assert np.std(switched[0]) < 0.3 * NOISE  # no difference: what is left of its noise


def test_models_asked_for_together_are_lent_the_exits_of_the_lender() -> None:
    """A base that was lent another's exits would not be the base of the next column."""
    lent: list[tuple[str, str]] = []

    class Lent(Pretended):
        def several(self, wanted: Sequence[tuple[Model, View]], lender: Model, exit_seed: int = 1) -> list[Any]:
            lent.extend((names[model.sha256], names[lender.sha256]) for model, _ in wanted)
            return super().several(wanted, lender, exit_seed)

    sight = sight_of(Lent(lambda _: BASE), SINGLE)
    base, other = Model(name="m"), Model(name="m").with_value("environment.substrate.reflectance", 0.9)
    names = {base.sha256: "base", other.sha256: "other"}
    sight.parts_of([other, base])
    sight.parts(base)
    assert lent == [("other", "other"), ("base", "other"), ("base", "base")]


def test_an_effect_that_makes_light_take_other_ways_is_moved_from_nearly_off_by_two_walks() -> None:
    """With it images have another noise, that of a walk; a difference from off itself is that noise over the step."""
    noise = {seed: np.random.default_rng(seed).normal(0.0, 0.1, (SIDE, SIDE)) for seed in (1, 2)}

    def image(at: dict[str, Any]) -> Any:
        if "mine.a" not in at:
            return BASE
        assert at["mine.a"] > 0.0
        return BASE + noise[predictor.exit_seed] * (1.0 + at["mine.a"]) + at["mine.a"] * ripple

    predictor = Pretended(image)
    rows, columns = np.indices((SIDE, SIDE))
    ripple = np.cos(2.0 * np.pi * (rows + columns) / SIDE)
    one_sided = AMPLITUDE.model_copy(update={"lower": 0.0, "one_sided": True})
    spec = spec_of(one_sided, walks=True)
    assert not is_smooth(spec)
    (column,) = signature(sight_of(predictor, SINGLE), Model(name="m"), spec)
    there = with_effect(Model(name="m"), applied_to(spec, {"a": 0.25}))  # the step down would end at off
    signature(sight_of(predictor, SINGLE), there, spec)
    error = column.parts[0] - ripple
    assert column.step == pytest.approx(0.5 * float(one_sided.upper or 0.0))
    assert np.sqrt(np.mean(error**2)) < 0.1  # from off itself it would be 0.6


def test_rough_sides_nearly_off_shut_light_in_above_a_mirror() -> None:
    """There the walk would follow light for milliseconds that nothing turns out (decision 72)."""
    mirror = scene({"bottom": "mirror", "mirror": Mirror(0.999)})
    (one,) = acting(SideWallRoughness.spec())
    nearly = SideWallRoughness(slope=NEAR_OFF * float(one.upper or 0.0))
    assert scene_arrays(nearly.scene(mirror)).flags[SHUT] == 1


def test_nearly_off_is_near_to_off_in_what_acts_alone() -> None:
    """What shapes an effect stays; of several numbers each is drawn to off."""
    spec = spec_of(AMPLITUDE, walks=True)
    assert nearly_off(spec, {"a": 0.5, "word": "x"}) == {"a": pytest.approx(0.5e-6), "word": "x"}
    assert nearly_off(spec, {"a": (0.5, -0.5)})["a"] == pytest.approx((0.5e-6, -0.5e-6))


def test_projection_takes_out_what_is_taken_and_only_that() -> None:
    """A column in the span of what is taken becomes 0; one across stays; noise of the derivative is no remainder."""
    predictor = Pretended(lambda at: BASE + at.get("mine.a", 0.0) * ONE)
    columns = signature(sight_of(predictor, SINGLE), Model(name="m"), spec_of(AMPLITUDE))
    used = np.ones((SIDE, SIDE), bool)
    white = Whitening((used,), (np.full((SIDE, SIDE), 2.0),), ())
    along = ONE.ravel() / np.linalg.norm(ONE)
    across = TWO.ravel() - along * (along @ TWO.ravel())
    across /= np.linalg.norm(across)
    none = np.zeros((0, 1))
    assert not projected(columns, Projection(white, (3.0,), (), Basis(along[:, None], none))).any()
    np.testing.assert_allclose(
        projected(columns, Projection(white, (3.0,), (), Basis(across[:, None], none)))[0], 6.0 * ONE.ravel()
    )
    assert projected([], Projection(white, (3.0,), (), Basis(along[:, None], none))).shape == (0, SIDE * SIDE)


def test_cosines_of_one_column_are_those_of_vectors_and_of_several_those_of_their_span() -> None:
    """An effect of two columns is the same as any combination of them."""
    x, y, z = np.eye(3)
    found = confounding(
        {"x": x[None], "tilted": (x + y)[None], "both": np.array([x, y]), "z": z[None], "no": 0 * x[None]}
    ).cosines
    np.testing.assert_allclose(found[0], [1.0, np.sqrt(0.5), 1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found[2, 1], 1.0)
    np.testing.assert_array_equal(found, found.T)


def test_groups_are_chains_of_likeness() -> None:
    """a is like b and b like c: one group, though a and c are not; d is alone."""
    cosine = np.array([[1.0, 0.95, 0.5, 0.1], [0.95, 1.0, 0.95, 0.1], [0.5, 0.95, 1.0, 0.1], [0.1, 0.1, 0.1, 1.0]])
    assert Confounding(("a", "b", "c", "d"), cosine).groups == (("a", "b", "c"), ("d",))


def test_values_off_typical_and_of_shapes() -> None:
    """Off values, a third of the range, every point of the shape grid; what is pasted into a model file."""
    spec = EffectSpec(
        name="mine", stage="detector", description="", source_sha256="a" * 64,
        parameters=(
            EffectParameter(name="w_um", description="", unit="um", lower=0.0, upper=30.0, off=0.0),
            EffectParameter(name="length_um", description="", unit="um", lower=1, upper=9, shape_grid=(2, 4, 8)),
            EffectParameter(name="law", description="", choices=("flat", "round")),
        ),
    )  # fmt: skip
    assert off_values(spec) == {"w_um": 0.0, "length_um": 4.0, "law": "round"}
    assert typical(spec) == {"w_um": 10.0, "length_um": 4.0, "law": "round"}
    assert far_end(spec.parameters[0]) == 30.0
    assert [(one["length_um"], one["law"]) for one in shapes_of(spec)] == [
        (4.0, "round"), (2.0, "round"), (8.0, "round"), (4.0, "flat"),
    ]  # fmt: skip
    side = EffectParameter(name="side", description="", choices=("in", "out"))
    words = spec.model_copy(update={"parameters": (spec.parameters[2], side)})
    assert {(one["law"], one["side"]) for one in shapes_of(words)} == set(product(("flat", "round"), ("in", "out")))
    text = stanza(applied_to(spec, typical(spec)))
    assert text.splitlines()[:4] == [
        "[[effects]]",
        'name = "mine"',
        f'source_sha256 = "{"a" * 64}"',
        "[effects.parameters]",
    ]


def test_a_model_with_unknown_effects_or_values_is_refused() -> None:
    """The effect that was meant, the range of the value; of a sample's own values too."""
    known = Known((spec_of(AMPLITUDE),), {}, {})
    good = with_effect(Model(name="m"), applied_to(spec_of(AMPLITUDE), {"a": 0.1}))
    known.refuse_unknown(good)
    for model, words in (
        (with_effect(Model(name="m"), AppliedEffect(name="mime", parameters={})), "did you mean mine"),
        (with_effect(good, applied_to(spec_of(AMPLITUDE), {"a": 0.9})), "-0.5 to 0.5"),
        (with_sample(good, "b", "mine", {"a": -0.9}), "-0.5 to 0.5"),
    ):
        with pytest.raises(InputError, match=words):
            known.refuse_unknown(model)


def test_columns_of_what_the_twin_knows_are_the_twins_beside_what_it_does_not() -> None:
    """A model with a tilt: other effects are moved without it, and by no Monte Carlo; the tilt itself stays."""
    wedge = EffectSpec(name="wedge", stage="geometry", description="", parameters=(AMPLITUDE,), twin=False)
    model = with_sample(
        with_effect(Model(name="m"), applied_to(wedge, {"a": 0.3})), SINGLE.id, "wedge", {"a": 0.4}
    ).with_value("environment.substrate.reflectance", 0.9)
    sight, own = replace(sight_of(Pretended(lambda _: BASE)), beyond_twin=frozenset(["wedge"])), spec_of(AMPLITUDE)
    at = sight.at(model, own)
    assert (at.effects, at.samples) == ((), {})
    assert at.leaves()["environment.substrate.reflectance"] == 0.9
    assert sight.at(model, wedge) is model
