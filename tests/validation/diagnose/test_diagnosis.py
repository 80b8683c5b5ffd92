"""Verdicts on made-up data: each of the five, with sizes, shares and held-out errors against what is known."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from luxloop.audit import Compared, Place
from luxloop.effect import AppliedEffect, EffectParameter
from luxloop.model import Fit as Limits
from luxloop.model import Model
from tests.validation.analytic import HALO, MODEL, PATHS
from tests.validation.diagnose import made_up
from tests.validation.diagnose.made_up import (
    ANOTHER,
    CATALOGUE,
    CHIPS,
    FLIPPED,
    RISE,
    Affected,
    data,
    diagnosis,
    ground_of,
    hidden,
    images_of,
    members_fit,
    spec,
)
from validation import told_diagnosis
from validation.diagnose.columns import FitSight, candidates_of, in_shape
from validation.diagnose.diagnosis import beyond_limits
from validation.diagnose.document import document, effect_document
from validation.diagnose.ending import finished
from validation.diagnose.explained import Share
from validation.diagnose.explanation import LEVEL
from validation.diagnose.frozen import slopes_of
from validation.diagnose.groups import joined
from validation.diagnose.in_words import limits
from validation.diagnose.proposal import NO_FILM
from validation.diagnose.refit import posed, refit
from validation.diagnose.refitted import with_fit
from validation.diagnose.rounds import Diagnosis, Step, is_the_rest, trusted
from validation.diagnose.score import Projected, scores
from validation.diagnose.verdict import decided
from validation.effects.signatures import Projection
from validation.fit import NOT_CONVERGED, Fit, fit, refitted
from validation.fit.parameters import free_paths
from validation.redeciding import diagnosis as redecided
from validation.redeciding import explanation_of, verdict_of


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
    assert dict(found.steps[0].refits[0].candidate.shape) == {"length_um": 300.0}
    assert dict(best.shape) == pytest.approx({"length_um": 300.0}, rel=0.01)
    assert best.numbers == 2  # its length was fitted, too
    assert "(length_um 299" in found.verdict.sentence or "(length_um 300" in found.verdict.sentence
    scored, base = found.steps[0].scores.of("stripes"), found.steps[0].ground.fit
    assert scored is not None
    assert scored.best.size != best.value
    sight, taken = FitSight.of(base, Affected()), Projection.of(base)  # type: ignore[arg-type]  # it predicts, too
    (one,) = in_shape(base, CATALOGUE[3], dict(best.shape), sight, taken)  # sigma is of the fitted size and length
    assert best.sigma == pytest.approx(abs(best.value) * np.linalg.norm(base.basis.left(one.columns)), rel=1e-9)


@pytest.mark.parametrize(("a", "b"), [(0.08, 0.06), (-0.06, 0.08), (0.08, 0.0)])
def test_all_numbers_of_an_effect_that_act_are_fitted_together(a: float, b: float) -> None:
    """A rise in any direction explains all, where each of its numbers alone explains a part; both are told."""
    truth = MODEL.model_copy(update={"effects": (AppliedEffect(name="rise", parameters={"a": a, "b": b}),)})
    found = diagnosis(images_of(truth, 3), known=(RISE, *CATALOGUE, CHIPS))
    assert (found.verdict.word, found.set[0]) == ("one_effect", "rise")
    best = found.steps[0].kept
    assert best is not None
    assert best.fit is not None
    for path, value in (("effects.rise.a", a), ("effects.rise.b", b)):
        assert abs(best.fit.value(path) - value) < 3.0 * best.fit.error(path)
    (first,) = (one for one in found.steps[0].explanations if one.name == "rise")
    assert first.share.value == pytest.approx(1.0, abs=0.1)
    (written,) = (one.parameters for one in best.fit.model.effects)
    assert set(written) == {"a", "b"}  # what `add` writes, both of them free
    assert {"effects.rise.a", "effects.rise.b"} <= set(free_paths(best.fit.model))
    assert first.numbers == 2
    ((other, value),) = first.shape
    assert {first.parameter, other} == {"a", "b"}
    assert f"({other} {value:.4g})" in found.verdict.sentence
    assert first.sigma == pytest.approx(np.sqrt(first.drop), rel=0.1)


def test_a_number_that_goes_to_the_end_of_its_range_is_left_off_beside_the_one_that_scored() -> None:
    """Rises of 0.08 and 0.012, of which the second may be 0.005 at most: the first explains most, and is named."""
    narrow = RISE.parameters[1].model_copy(update={"lower": -0.005, "upper": 0.005})
    known = RISE.model_copy(update={"parameters": (RISE.parameters[0], narrow)})
    truth = MODEL.model_copy(update={"effects": (AppliedEffect(name="rise", parameters={"a": 0.08, "b": 0.012}),)})
    found = diagnosis(images_of(truth, 3), known=(known, *CATALOGUE))
    (first,) = (one for one in found.steps[0].explanations if one.name == "rise")
    assert (first.plausible, first.parameter, first.shape, first.numbers) == (True, "a", (), 1)
    assert found.verdict.set[:1] == ("rise",)
    assert abs(first.value - 0.08) < 4.0 * first.error


def test_a_number_that_only_its_end_drives_there_is_left_off_too() -> None:
    """A second number that a first fit left inside of a range, and the one with derivatives of its own does not."""
    predictor = Affected()
    base = fit(MODEL, images_of(hidden("rise", {"a": 0.08, "b": 0.012}), 3), predictor, free=PATHS)
    tried = candidates_of(base, [RISE], FitSight.of(base, predictor))  # type: ignore[arg-type]  # it predicts, too
    found = refit(base, scores(Projected.of(joined(tried), base.basis), base.residual_with_priors).effects[0].best,
                  slopes_of(base))  # fmt: skip
    assert found.fit is not None
    assert [one.parameter.name for one in found.candidate.others] == ["b"]
    narrow = found.fit.model.fit | {"effects.rise.b": Limits(free=True, lower=-0.005, upper=0.005)}
    model = found.fit.model.model_copy(update={"fit": narrow}).with_value("effects.rise.b", 0.004)
    start = found.fit.problem.unknowns.named(found.fit.values) | {"effects.rise.b": 0.004}
    problem, values = posed(found.fit.problem, model, found.fit.problem.unknowns.model_paths, start)
    held = with_fit(found, refitted(problem, values, 1))
    ended = finished(held, predictor, None)  # type: ignore[arg-type]  # it predicts as a predictor does
    assert (ended.driven, [*ended.size], ended.paths) == (False, ["effects.rise.a"], ("effects.rise.a",))
    assert abs(ended.value - 0.08) < 4.0 * ended.error
    assert ended.model is not None
    assert ended.model.leaves()["effects.rise.b"] == 0.0
    assert ended.fit is not None
    assert "effects.rise.b" not in ended.fit.names


def test_an_effect_whose_square_counts_is_fitted_from_off() -> None:
    """Fog of 0.3: nothing has a slope at 0, yet it is found."""
    best = diagnosis(data("fog", 3, 0.3)).added[0]
    assert best.name == "fog"
    assert abs(best.value - 0.3) < 3.0 * best.error


@pytest.mark.parametrize(("errors", "named"), [(1.0, True), (4.0, False)])
def test_what_noise_may_have_put_at_the_end_of_its_range_is_named(errors: float, named: bool) -> None:
    """Of a range that ends one error below the best size, or four of them."""
    images, (ripple, *others) = data("ripple", 3, 0.06), CATALOGUE
    whole = diagnosis(images).added[0]
    narrow = ripple.parameters[0].model_copy(update={"upper": whole.value - errors * whole.error})
    ended = ripple.model_copy(update={"parameters": (narrow, *ripple.parameters[1:])})
    found = diagnosis(images, known=(ended, *(one for one in others if one.name != "ripple_like")))
    one = next(one for one in found.steps[0].explanations if one.name == "ripple")
    assert one.value == narrow.upper
    assert (one.plausible, one.at_end, one.why_not) == (named, named, "" if named else "implausible")
    row = effect_document(found.steps[0], one)
    assert explanation_of(row).size == one.size
    assert ("at the end of its range" in one.size) is named
    if not named:
        assert (one.error, one.log_evidence) == (0.0, None)
        assert "ripple" not in found.set
        return
    assert found.set == ("ripple",)
    assert one.error == pytest.approx(whole.error, rel=0.05)
    assert one.log_evidence is not None
    assert "at the end of its range. It explains" in found.verdict.sentence
    assert not one.distrust


def test_only_a_little_that_is_left_to_gain_is_excused_by_a_missing_effect() -> None:
    """So is a limit; a fit that is far from its end, and any other reason, is told at once."""
    fit_ = diagnosis(data(None, 1)).steps[0].ground.fit
    late, other = f"{NOT_CONVERGED}: some is left", "two parameters are the same"
    near = replace(fit_, gap=0.01 * fit_.chi2, distrust=(late, other))
    assert beyond_limits(near) == [other]
    assert beyond_limits(replace(near, gap=0.05 * fit_.chi2)) == [late, other]
    held = replace(near, at_limit=("a.b",), distrust=("a.b is at its limit", other))
    assert beyond_limits(held) == [other]


def test_the_word_that_shapes_an_effect_is_the_one_that_leaves_least() -> None:
    """Lines along x in the images; whatever word a refit was begun with, it ends with that."""
    along = EffectParameter(name="along", description="which way", choices=("x", "y"))
    predictor = Affected()
    base = fit(MODEL, data("lines", 3, 0.05, along="x"), predictor, free=PATHS)
    tried = candidates_of(base, [spec("lines", along)], FitSight.of(base, predictor))  # type: ignore[arg-type]  # duck
    wrong = next(one for one in tried if dict(one.shape)["along"] == "y")
    found = refit(
        base, scores(Projected.of([wrong], base.basis), base.residual_with_priors).effects[0].best, slopes_of(base)
    )
    ended = finished(found, predictor, None)  # type: ignore[arg-type]  # it predicts as a predictor does
    assert dict(ended.shape) == {"along": "x"}
    assert abs(ended.value - 0.05) < 3.0 * ended.error


def test_a_doubtful_second_effect_takes_nothing_from_the_first() -> None:
    """What a further round kept with a parameter at its limit is dropped; the first verdict stands."""
    first = diagnosis(data("stripes", 2, 0.05, 300.0))
    (step, *_) = first.steps
    assert first.verdict.word in ("one_effect", "cannot_tell_apart")
    at_limit = replace(
        step, explanations=tuple(replace(one, distrust=("fog.size is at its limit",)) for one in step.explanations)
    )
    assert trusted([step, at_limit]) == [step]
    assert trusted([at_limit]) == [at_limit]


def test_what_explains_a_part_and_leaves_the_rest_is_none_of_the_known() -> None:
    """A stranger of which an effect takes 57 %, and a second, a guess, next to nothing: neither is named."""
    (step, *_) = diagnosis(data("stripes", 2, 0.05, 300.0)).steps
    assert step.verdict.word in ("one_effect", "cannot_tell_apart")

    def leaving(p_left: float, share: float, error: float = 0.05) -> Step:
        tried = (replace(one, p_left=p_left, share=Share(share, error)) for one in step.explanations)
        return replace(step, explanations=tuple(tried))

    part, guess, rest = leaving(1e-4, 0.57), leaving(1e-4, 0.01, 0.4), leaving(0.3, 0.9)
    assert trusted([part, guess]) == [part]
    assert trusted([part, rest]) == [part, rest]
    assert Diagnosis((leaving(1e-4, 0.57, 0.2),), 6).verdict.word == "none_of_the_known"
    verdict = Diagnosis((part,), 6).verdict
    assert verdict.word == "none_of_the_known"
    assert verdict.sentence.startswith("None of the 6 known effects explains this (best: 57 %). What is left: ")
    told = document(Diagnosis((part,), 6), 1)
    assert (told["verdict"], told["set"], told["added"][0]["share_error"]) == ("none_of_the_known", [], 0.05)
    again = verdict_of(told, [explanation_of(row) for row in told["effects"]])
    assert again is not None
    assert (again.word, again.set) == ("none_of_the_known", ())
    left = " Structure is left that nothing named here explains (p 0.0001)."
    assert Diagnosis((leaving(1e-4, 0.9),), 6).verdict.sentence.endswith(left)
    assert left not in Diagnosis((leaving(0.3, 0.9),), 6).verdict.sentence
    assert left not in Diagnosis((part, rest), 6).verdict.sentence
    group = replace(part, refits=tuple(replace(one, fit=None) for one in part.refits))  # nothing can follow it
    for stands in ((part, rest), (leaving(1e-4, 0.9),), (leaving(1e-4, 0.57, 0.3),), (leaving(0.3, 0.57),), (group,)):
        assert Diagnosis(stands, 6).verdict.word == step.verdict.word
        told = document(Diagnosis(stands, 6), 1)
        again = verdict_of(told, [explanation_of(row) for row in told["effects"]])
        assert again is not None
        assert again.word == told["verdict"]


def group_of(scale: float, *beside: AppliedEffect) -> Model:
    """A truth whose chips have powers of their own, which light bends with, and what is beside them."""
    gains = {"array": (0.3, -0.15, 0.06), "third": (-0.24, 0.09, 0.18)}
    truth = hidden(
        "chips", {"gain": ()}, **{name: {"gain": [scale * one for one in some]} for name, some in gains.items()}
    )
    return truth.model_copy(update={"effects": (*truth.effects, *beside)})


@pytest.mark.parametrize(("scale", "fits"), [(0.1, 0), (0.5, 1), (0.8, 1)])
def test_a_group_is_named_where_it_leaves_nothing(scale: float, fits: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the line of its members, or, where that leaves structure, by the fit in which each has its own number;
    there is none in doubt because a parameter went to its limit without it (0.8)."""
    asked = []

    def counted(*at: Any) -> Fit:
        asked.append(at)
        return members_fit(*at)

    monkeypatch.setattr(made_up, "members_fit", counted)
    found = diagnosis(images_of(group_of(scale), 3), known=(CHIPS, spec("ripple")))
    assert (found.verdict.word, found.set[0], len(asked)) == ("one_effect", "chips", fits)
    assert found.added[-1].p_left >= LEVEL / 2.0


def test_what_a_group_leaves_is_looked_through() -> None:
    """Powers and ripples: both are named. What nobody knows: chips take a part of it, and leave structure."""
    known = CHIPS, spec("ripple"), FLIPPED
    found = diagnosis(
        images_of(group_of(0.5, AppliedEffect(name="ripple", parameters={"size": 0.03})), 3), known=known
    )
    assert [one.name for one in found.added] == ["chips", "ripple"]
    assert "flipped" in [one.name for one in found.steps[1].explanations]  # a switch is begun anew beside members
    assert "What it leaves is explained by ripple" in found.verdict.sentence
    found = diagnosis(
        images_of(group_of(0.5, AppliedEffect(name="spiral", parameters={"size": 0.05})), 3), known=known
    )
    said = json.loads(json.dumps(document(found, 1)))
    assert said["verdict"] == "none_of_the_known"
    assert [row["leads_on"] for row in said["added"]] == [True]
    again = verdict_of(said, [explanation_of(row) for row in said["effects"]])
    assert again is not None
    assert (again.word, again.set) == (said["verdict"], tuple(said["set"]))


def test_a_fit_in_doubt_is_not_called_unknown_and_names_nobody() -> None:
    """The one effect that was kept is distrusted, and leaves structure: the fit is doubted, by a replay too."""
    (step, *_) = diagnosis(data("stripes", 2, 0.05, 300.0)).steps
    doubtful = (
        replace(one, p_left=1e-4, share=Share(0.57, 0.05), distrust=("a limit",)) for one in step.explanations
    )
    found = Diagnosis((replace(step, explanations=tuple(doubtful), proposals=(ANOTHER,)),), 6)
    assert (found.verdict.word, found.set, found.proposals) == ("fit_not_trustworthy", (), ())
    told = document(found, 1)
    again = verdict_of(told, [explanation_of(row) for row in told["effects"]])
    assert again is not None
    assert (again.word, again.set, told["set"], told["candidates"]) == ("fit_not_trustworthy", (), [], [])


def test_what_a_dropped_round_would_have_asked_for_is_not_told() -> None:
    """Only a round that is kept, and could not tell effects apart, asks for an image."""
    (step, *_) = diagnosis(data("stripes", 2, 0.05, 300.0)).steps
    asking = replace(step, verdict=replace(step.verdict, word="cannot_tell_apart"), proposals=(ANOTHER,))
    named = replace(step, verdict=replace(step.verdict, word="one_effect"), proposals=())
    assert Diagnosis((named,), 6).proposals == ()
    assert Diagnosis((named, asking), 6).proposals == (ANOTHER,)
    assert Diagnosis((asking, named), 6).proposals == (ANOTHER,)
    known = replace(named.explanations[0], share=Share(0.0712, 0.0043))
    (row,) = document(Diagnosis((replace(named, explanations=(known,)),), 6), 1)["effects"]
    assert "7.1 +- 0.4 %" in told_diagnosis._effect(row)
    held = "But films.a.layers.0.thickness_nm is held at 28.76."
    facts = {"model": {"file": "model.toml"}, "solver": {"method": "anchored"}, "not_tested": []}
    facts |= {"command": "luxloop diagnose data --among fog,stripes", "held": [{"words": held}]}
    adding = "luxloop add stripes puts it into model.toml."
    for steps, adds, asks in (((named,), 1, False), ((named, asking), 1, True), ((asking,), 0, True)):
        lines = list(told_diagnosis.diagnosis(document(Diagnosis(steps, 6), 1) | facts))
        assert lines[2] == held  # under the verdict
        assert (lines.count(adding), any(ANOTHER.words in line for line in lines)) == (adds, asks)


def test_an_effect_of_the_model_is_not_tried_again() -> None:
    """Neither where it is free nor where it stays as it is."""
    there = AppliedEffect(name="stripes", parameters={"size": 0.05, "length_um": 300.0})
    found = diagnosis(data("stripes", 2, 0.05, 300.0), MODEL.model_copy(update={"effects": (there,)}))
    assert {one.name for one in found.steps[0].scores.effects} == {"ripple", "ripple_like", "fog"}
    assert found.verdict.word == "nothing_visible"


def test_a_document_has_no_infinities() -> None:
    """Strict JSON of every kind of verdict, also where an error is not known."""
    for found in (diagnosis(data(None, 1)), diagnosis(data("stripes", 2, 0.05, 300.0))):
        told = document(found, 1)
        assert json.loads(json.dumps(told, allow_nan=False)) == told
    best = replace(found.added[0], share=Share(0.0, np.inf), error=np.inf)
    row = effect_document(found.steps[0], best)
    assert row["explained_share_error"] is None
    assert row["size"]["size"]["error"] is None
    assert "+-" not in best.size


def test_two_that_are_alike_are_not_told_apart() -> None:
    """Both are in the set, and the measurement to take is said."""
    found = diagnosis(data("ripple", 4, 0.012))
    assert found.verdict.word == "cannot_tell_apart"
    assert set(found.verdict.set) == {"ripple", "ripple_like"}
    assert found.verdict.sentence.startswith("The data cannot tell apart ripple")
    assert found.verdict.sentence.endswith("Take one image: another: expected separation 9 sigma (now 2.0).")
    assert found.proposals == (ANOTHER,)


def test_effects_of_films_that_are_alike_are_told_apart_by_no_image() -> None:
    """Though there are images beside the spectra: the film is to be measured in another way."""
    known = [one.model_copy(update={"acts_on": ("films",)}) for one in CATALOGUE[:2]]
    found = diagnosis(data("ripple", 4, 0.012), known=known)
    assert found.verdict.word == "cannot_tell_apart"
    assert found.verdict.sentence.endswith(f"To separate them, {NO_FILM}.")


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
    first, second = found.steps
    either = replace(second.verdict, word="cannot_tell_apart", rivals=("ripple",))
    for verdict, rivals in ((second.verdict, []), (either, ["ripple"])):
        whole = Diagnosis((first, replace(second, verdict=verdict)), found.known)
        said = json.loads(json.dumps(document(whole, 1)))
        assert [row["rivals"] for row in said["added"]] == [[], rivals]
        assert ("not told apart from ripple)" in said["sentence"]) == bool(rivals)
        told: list[Compared] = []
        redecided(said, Place(told.append))
        assert {one.what: one.verdict for one in told}["sentence"] == "identical"


@pytest.mark.parametrize(("ripple", "stripes"), [(0.0238, 0.031), (0.0077, 0.0093)])
def test_two_effects_are_named_where_neither_explains_half(ripple: float, stripes: float) -> None:
    """The better one explains 46 % +- 3 %; or, weaker, as much as its rival to a sigma: they are there together, and
    none asks for an image to tell them apart. Without the other one in the catalogue neither is named."""
    both = (
        AppliedEffect(name="ripple", parameters={"size": ripple}),
        AppliedEffect(name="stripes", parameters={"size": stripes, "length_um": 300.0}),
    )
    images, others = images_of(MODEL.model_copy(update={"effects": both}), 2), (CATALOGUE[2], RISE)
    found = diagnosis(images, known=(spec("ripple"), CATALOGUE[3], *others))
    assert {one.name for one in found.added} == {"ripple", "stripes"}
    assert (found.verdict.word, found.proposals) == ("one_effect", ())
    assert f"What it leaves is explained by {found.added[1].name} (size" in found.verdict.sentence
    assert found.added[0].share.value < 0.5
    said = json.loads(json.dumps(document(found, 1)))
    again = verdict_of(said, [explanation_of(row) for row in said["effects"]])
    assert again is not None
    assert (again.word, again.set) == (said["verdict"], tuple(said["set"]))
    alone = diagnosis(images, known=(spec("ripple"), *others))
    assert alone.verdict.word == "none_of_the_known"
    assert len(alone.steps) == 1


def test_a_replay_takes_a_second_effect_for_no_rival_only_where_the_diagnosis_did() -> None:
    """A first round that stayed open, for the first effect was gone beside the second, stays open in a replay."""
    both = {"ripple": {"size": 0.0077}, "stripes": {"size": 0.0093, "length_um": 300.0}}
    effects = tuple(AppliedEffect(name=name, parameters=dict(of)) for name, of in both.items())
    images = images_of(MODEL.model_copy(update={"effects": effects}), 2)
    first, rest = diagnosis(images, known=(spec("ripple"), CATALOGUE[3], CATALOGUE[2], RISE)).steps
    assert first.beside == (rest.best.name,)
    vague = tuple(replace(one, share=Share(one.share.value, 0.12)) for one in first.explanations)
    open_ = decided(vague, 5, str, lambda _: "")
    assert open_.word == "cannot_tell_apart"
    stayed = replace(first, explanations=vague, verdict=open_, beside=None)
    for step, word in ((first, "one_effect"), (stayed, open_.word)):
        said = json.loads(json.dumps(document(Diagnosis((step, rest), 5), 1)))
        again = verdict_of(said, [explanation_of(row) for row in said["effects"]])
        assert again is not None
        assert (again.word, said["verdict"]) == (word, word)


def test_the_first_of_two_must_be_there_beside_the_second() -> None:
    """Off by more than three errors of its own; a rest in doubt, of a group, or that leaves structure is none."""
    sizes = {"ripple": {"size": 0.03}, "stripes": {"size": 0.03, "length_um": 300.0}}
    both = tuple(AppliedEffect(name=name, parameters=dict(of)) for name, of in sizes.items())
    found = diagnosis(images_of(MODEL.model_copy(update={"effects": both}), 1), known=(spec("ripple"), CATALOGUE[3]))
    part, rest = found.steps
    assert is_the_rest(part, rest)
    for change in ({"p_left": 0.004}, {"distrust": ("a limit",)}, {"has_members": True}):
        assert not is_the_rest(part, replace(rest, explanations=(replace(rest.best, **change),)))
    assert rest.kept is not None
    assert rest.leads_to is not None
    path = f"effects.{part.best.name}.size"
    at, error = rest.leads_to.names.index(path), rest.leads_to.error(path)
    for size, is_there in ((2.9, False), (-3.1, True)):
        values = rest.leads_to.values.copy()
        values[at] = size * error
        moved = replace(rest.kept, fit=replace(rest.leads_to, values=values))
        assert is_the_rest(part, replace(rest, refits=(moved,))) == is_there


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
    unchanged = loudest.share(ground.fit.residual, ground.structure.variance_scale, same_noise=True)
    assert (unchanged.value, unchanged.error) == pytest.approx((0.0, 0.0), abs=1e-6)
    noise = np.random.default_rng(1).standard_normal(ground.fit.residual.size)
    right = loudest.share(ground.fit.basis.residual(noise), same_noise=False)
    assert abs(right.value - 1.0) < 3.0 * right.error + 0.05
