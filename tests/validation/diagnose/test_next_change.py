"""What an effect of its fitted size does to the images that a further measurement would give."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest

from luxloop.effect import AppliedEffect, EffectParameter, EffectSpec, Value
from luxloop.errors import RemoteError
from luxloop.failure import Failure
from luxloop.model import Model
from tests.validation.analytic import ARRAY, MODEL, PATHS, blank
from tests.validation.analytic import SINGLE as SINGLE_CHIP
from tests.validation.diagnose.made_up import CHIPS, LENGTH, THIRD, Affected, data, members_fit, spec
from tests.validation.effects.test_signatures import AMPLITUDE, BASE, ONE, SIDE, SINGLE, Pretended, sight_of, spec_of
from validation.dataset.manifest import Sample
from validation.diagnose.columns import FitSight, candidates_of
from validation.diagnose.next_measurement import Rivals, image_can_tell, left_out_of
from validation.diagnose.proposal import Proposal, next_in_words
from validation.diagnose.refitted import Refitted
from validation.diagnose.score import Candidate, Projected
from validation.effects.confounding import left_beside
from validation.fit import CurveData, fit
from validation.measured import MeasuredImage
from validation.prediction import Anchored, Predicted, PredictedCurve, View


@pytest.mark.parametrize("walks", [False, True])
def test_the_noise_of_another_walk_is_no_change_that_an_effect_makes(walks: bool) -> None:
    """A separation by it would be told of any image; of an effect with walks of its own they begin nearly off."""
    noise = 5.0 * np.random.default_rng(3).standard_normal((SIDE, SIDE))

    def image(at: dict[str, Any]) -> Any:
        return BASE if "mine.a" not in at else BASE + walks * noise + at["mine.a"] * ONE

    predictor = Pretended(image)
    model, spec = Model(name="m"), spec_of(AMPLITUDE, walks=walks)
    candidate = Candidate(spec, spec.parameters[0], (), np.zeros((1, 1)))
    found: Any = SimpleNamespace(candidate=candidate, size={candidate.path: 0.4}, value=0.4, model=None, shape=())
    rivals = Rivals(SimpleNamespace(model=model), (), predictor, frozenset())  # type: ignore[arg-type]  # its model is all that is asked for
    one: Refitted = found
    (change,) = rivals._change(sight_of(predictor, SINGLE), one)
    np.testing.assert_allclose(change, 0.4 * ONE, rtol=1e-5)


def test_an_effect_is_predicted_in_the_shape_that_it_was_fitted_with() -> None:
    """Tried at 300 um and as lines along y, fitted at 340 um and along x: a size is of the shape it belongs to."""
    along = EffectParameter(name="along", description="which way", choices=("x", "y"))
    shapes: list[tuple[EffectSpec, dict[str, Value], dict[str, Value]]] = [
        (spec("stripes", LENGTH), {"length_um": 300.0}, {"length_um": 340.0}),
        (spec("lines", along), {"along": "y"}, {"along": "x"}),
    ]
    for effect, tried, ended in shapes:
        there = MODEL.model_copy(
            update={"effects": (AppliedEffect(name=effect.name, parameters={"size": 0.05, **ended}),)}
        )
        rivals = rivals_about(Affected())
        candidate = Candidate(effect, effect.parameters[0], tuple(tried.items()), np.zeros((1, 1)))
        one = replace(rivals.refits[0], candidate=candidate, model=there)
        sight = FitSight.of(rivals.fit, rivals.predictor)
        fitted = rivals.fit.model.model_copy(update={"effects": there.effects})
        parts = zip(rivals._change(sight, one), sight.parts(fitted), sight.parts(rivals.fit.model), strict=True)
        for change, more, less in parts:
            np.testing.assert_allclose(change, more - less, atol=1e-9)


def test_what_is_expected_of_an_image_counts_the_noise_of_monte_carlo() -> None:
    """Noise along the rivals' difference hides it in what was measured and in what would be."""
    expected = {}
    for loud in (0.0, 1.0):
        noise = {one.id: loud * patterns(one) for one in (SINGLE_CHIP, ARRAY, THIRD)}
        predictor = Affected(noise)
        base = fit(MODEL, data("ripple", 1, 0.05), predictor, free=PATHS, anchor_at=lambda at: Anchored(at, 1000))
        refits = [
            Refitted(Candidate(one, one.parameters[0], (), np.zeros((1, 1))), 0.05, 0.01, base.residual, 0.0, False,
                     MODEL, base)
            for one in (spec("ripple"), spec("ripple_like"))
        ]  # fmt: skip
        rivals = Rivals(base, refits, predictor, frozenset())  # type: ignore[arg-type]  # it predicts as a predictor does
        expected[loud] = {one.words: (one.expected_sigma, one.now_sigma) for one in rivals.proposals()}
    assert expected[0.0].keys() == expected[1.0].keys()
    for words, (then, now) in expected[0.0].items():
        hidden, hidden_now = expected[1.0][words]
        assert hidden < 0.5 * then
        assert hidden_now < 0.5 * now


@pytest.mark.parametrize("kind", ["quiet", "monte carlo", "pattern"])
def test_a_repeat_takes_out_no_noise_but_the_cameras_own(kind: str) -> None:
    """Twice the light, where there is no other noise; that of Monte Carlo and the camera's pattern it has again."""
    noise = {one.id: patterns(one) for one in (SINGLE_CHIP, ARRAY, THIRD)} if kind == "monte carlo" else None
    images = [replace(one, prnu=0.1 if kind == "pattern" else 0.0) for one in data("ripple", 1, 0.05)]
    rivals = rivals_about(Affected(noise), images=images)
    repeats = [one for one in rivals.proposals() if one.words.endswith("(a repeat)")]
    more = rivals._on_measured(rivals._with_more_of(ARRAY, 1.0), rivals._changes(rivals.refits))
    gained = [one.expected_sigma / one.now_sigma for one in repeats]
    assert more.model.shape[1] == sum(int(one.used.sum()) for one in images)
    assert gained
    assert max(gained) > 1.2 if kind == "quiet" else max(gained) < 1.03


def rivals_about(
    predictor: Affected, free: Sequence[str] = PATHS, images: Sequence[MeasuredImage] | None = None
) -> Rivals:
    """Two ripples that look alike, on three samples."""
    base = fit(
        MODEL, data("ripple", 1, 0.05) if images is None else images, predictor, free=free,
        anchor_at=lambda at: Anchored(at, 1000),
    )  # fmt: skip
    refits = [
        Refitted(Candidate(one, one.parameters[0], (), np.zeros((1, 1))), 0.05, 0.01, base.residual, 0.0, False,
                 MODEL, base)
        for one in (spec("ripple"), spec("ripple_like"))
    ]  # fmt: skip
    return Rivals(base, refits, predictor, frozenset())  # type: ignore[arg-type]  # it predicts as a predictor does


@pytest.mark.parametrize(("code", "told"), [("bad_input", True), ("no_worker", False)])
def test_lost_workers_are_no_reason_against_an_image(code: Literal["bad_input", "no_worker"], told: bool) -> None:
    """A sample that cannot be built is passed over; without workers there is no answer, and so no proposal."""

    class Losing(Affected):
        def images(self, model: Model, views: Sequence[View], *more: Any) -> Any:
            if any(view.sample.id.startswith("next-") for view in views):
                raise RemoteError(Failure(code=code, message="made up"))
            return super().images(model, views, *more)

    rivals = rivals_about(Losing())
    if told:
        assert all(one.is_there for one in rivals.proposals())
        return
    with pytest.raises(RemoteError, match="made up"):
        rivals.proposals()


def test_what_is_proposed_can_be_written_into_the_manifest() -> None:
    """Of another sample itself and its image; of one that is there an image more, under a name of its own."""
    images, ids = data("ripple", 1, 0.05), set[str]()
    written = {one.sample.id for one in images}
    proposals = rivals_about(Affected()).proposals()
    assert {one.is_there for one in proposals} == {True, False}
    for one in proposals:
        manifest = tomllib.loads(one.document()["stanza"])
        assert [each["id"] for each in manifest.get("samples", [])] == ([] if one.is_there else [one.sample.id])
        (shot,) = manifest["shots"]
        assert (one.sample.id in written) == one.is_there
        assert shot["sample"] == one.sample.id
        assert shot["id"] not in {each.shot.id for each in images} | written
        assert shot["file"] == f"images/{shot['id']}.tif"
        ids.add(shot["id"])
    assert any("4 times that of" in one.document()["stanza"] for one in proposals)


def test_images_are_proposed_where_no_parameter_of_the_model_moves() -> None:
    """Regression: there were no columns to whiten, and a diagnosis that could not tell effects apart fell over."""
    assert rivals_about(Affected(), ()).proposals()


def test_a_proposal_that_will_not_do_says_so() -> None:
    """Told apart are rivals with 5 sigma between them; the best of what can be measured may have less."""
    words = [next_in_words([Proposal("array, D = 0.10 mm", SINGLE_CHIP, 1.0, sigma, 1.3)]) for sigma in (4.0, 12.0)]
    assert words == [
        "Take one image: array, D = 0.10 mm: expected separation 4 sigma (now 1.3), less than the 5 that tell them"
        " apart: it takes more than that.",
        "Take one image: array, D = 0.10 mm: expected separation 12 sigma (now 1.3).",
    ]


def test_rivals_without_a_size_of_their_own_are_said_to_be_left_out() -> None:
    """A group has a number for each chip: no image is proposed about it, and of the others that is said."""
    rivals = rivals_about(Affected())
    first, second = rivals.refits
    group = replace(first, model=None)
    assert left_out_of([group, second]) == ["ripple"]
    assert replace(rivals, refits=[group, second]).proposals() == []
    none = "Which image would separate them is not known: chips has a number of its own for each chip."
    assert next_in_words([], ["chips"]) == none
    one = Proposal("array, D = 0.10 mm", SINGLE_CHIP, 1.0, 12.0, 1.3)
    told = next_in_words([one], ["chips", "places"])
    assert told.endswith("That is of the others: chips, places have numbers of their own for each chip.")


def test_a_shot_that_is_proposed_has_a_name_of_its_own() -> None:
    """Of a sample that is there, the second time, too: a data set has each id once, and each file."""
    asks = Proposal("again", SINGLE_CHIP, 4.0, 12.0, 1.3, is_there=True)
    first = f"further-{SINGLE_CHIP.id}"
    for taken, name in (((), first), ((first,), f"{first}-2"), ((first, f"{first}-2"), f"{first}-3")):
        told = replace(asks, taken=taken).document()["stanza"]
        assert f'id = "{name}"' in told
        assert f'file = "images/{name}.tif"' in told
    new = replace(asks, is_there=False, taken=(SINGLE_CHIP.id,)).document()["stanza"]
    assert f'[[shots]]\nid = "{SINGLE_CHIP.id}-2"' in new


@pytest.mark.parametrize("films", [1, 2])
def test_an_image_is_not_proposed_where_no_two_rivals_show_in_one(films: int) -> None:
    """Effects of films change no pixel: after a sweep of candidates 0 sigma were expected of the best image."""
    asked = rivals_about(Affected())
    found = [
        replace(one, candidate=replace(one.candidate, effect=effect))
        for one in asked.refits
        for effect in [one.candidate.effect.model_copy(update={"acts_on": ("films",)})]
    ]
    refits = [*asked.refits[films:], *found[:films]]
    assert replace(asked, refits=refits).proposals() == []
    images = asked.fit.problem.images
    assert not image_can_tell(images, [one.candidate.effect for one in refits])
    assert image_can_tell(images, [one.candidate.effect for one in asked.refits])
    assert not image_can_tell((), [one.candidate.effect for one in asked.refits])


class Brighter(Affected):
    """An effect besides that lights one of the samples more."""

    def images(self, model: Model, views: Sequence[View], *more: Any) -> list[Predicted]:
        """As `Affected`."""
        others = tuple(one for one in model.effects if one.name != "bright")
        found = super().images(model.model_copy(update={"effects": others}), views, *more)
        shine = [1.0 + brightness(model) * (view.sample.id == THIRD.id) for view in views]
        return [
            replace(one, irradiance_per_mm2=by * one.irradiance_per_mm2) for one, by in zip(found, shine, strict=True)
        ]


def brightness(model: Model) -> float:
    """Of the effect in a model."""
    return sum(float(one.parameters["size"]) for one in model.effects if one.name == "bright")  # type: ignore[arg-type]  # a number


def scanned(model: Model, curves: Sequence[CurveData], paths: Sequence[str], _: Any) -> list[PredictedCurve]:
    """Curves that the same effect bends, and nothing else does."""
    x = np.linspace(0.0, 6.0, 40)
    return [PredictedCurve(1.0 + brightness(model) * np.cos(x), dict.fromkeys(paths, 0.0 * x)) for _ in curves]


@pytest.mark.parametrize("kind", ["one gain", "members", "curves"])
def test_what_is_told_of_now_is_what_the_verdict_says(kind: str) -> None:
    """By all rows, under the priors of all that is fitted: gains that follow the exposure, chips of one spread."""
    known, predictor = [spec("bright"), spec("ripple")], Brighter()
    images = data("ripple", 1, 0.05)
    if kind != "curves":
        camera = images[0].camera.model_copy(update={"gain_mode": "exposure"})
        images = [replace(one, camera=camera) for one in images]
    curves = [CurveData("scan", np.ones(40), np.full(40, 0.01), free_scale=True)] if kind == "curves" else []
    base = fit(MODEL, images, predictor, free=PATHS, curves=curves, predict_curves=scanned)
    base = members_fit(base, CHIPS) if kind == "members" else base
    projected = Projected.of(candidates_of(base, known, FitSight.of(base, predictor)), base.basis)  # type: ignore[arg-type]  # it predicts, too
    own, rival = (projected.own(one) for one in projected.candidates)
    refits = [Refitted(one, 0.1, 0.01, base.residual, 0.0, False, MODEL, base) for one in projected.candidates]
    told = Rivals(base, refits, predictor, frozenset()).proposals()  # type: ignore[arg-type]  # it predicts, too
    assert told[0].now_sigma == pytest.approx(left_beside(0.1 * own[0], [rival]), rel=0.03)
    assert told[0].now_sigma > 3.0
    assert all(one.expected_sigma > 0.999 * one.now_sigma for one in told)


def patterns(sample: Sample) -> Any:
    """(function, row, column): noise along the difference of the two ripples, ten times the camera's."""
    image = blank("any", sample, side=40)
    view = View(sample, 40, 40, image.pixel_um, image.centre_px)
    light = [Affected().images(effects(name), [view])[0].irradiance_per_mm2 for name in ("ripple", "ripple_like")]
    return (light[0] - light[1])[None]


def effects(name: str) -> Model:
    """The spots with one of the ripples."""
    return MODEL.model_copy(update={"effects": (AppliedEffect(name=name, parameters={"size": 0.05}),)})
