"""A refit with an effect that the twin cannot represent, on made-up data: a line first, then Monte Carlo about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from luxloop.model import Model
from tests.validation.analytic import HALO, MODEL, PATHS, SIGMA, Spots
from tests.validation.diagnose.made_up import Affected, seen, spec
from tests.validation.diagnose.rippled import (
    ANCHORED,
    HIDDEN,
    RIPPLE,
    TRUTH,
    Anchors,
    H,
    base_fit,
    data,
    noisy,
    score_of,
    smooth_score_of,
    strength,
)
from validation.diagnose.anew import (
    ON_THE_WAY,
    TWIN_ANEW,
    about_its_own,
    by_twin,
    fitted_anew,
    has_other_light,
    has_strayed,
    total_chi2,
)
from validation.diagnose.ending import beside, finished
from validation.diagnose.frozen import FrozenImages, frozen_at, slopes_of, without
from validation.diagnose.refit import freed
from validation.diagnose.refitted import Refitted
from validation.diagnose.score import Candidate, Score
from validation.effects.known import applied, with_effect
from validation.effects.signatures import Column, Projection
from validation.fit import Fit, fit, refitted
from validation.fit.anchored_fit import AT_FIRST
from validation.fit.problem import view_of
from validation.prediction import Anchored, Pose, Predicted, View

Real = NDArray[np.float64]


@pytest.fixture(scope="module")
def base() -> Fit:
    """The fit without the effect, about Monte Carlo where it stands."""
    return base_fit()


@pytest.fixture(scope="module")
def line(base: Fit) -> Refitted:
    """The effect as a straight line from off."""
    return freed(base, score_of(base), slopes_of(base))


def test_first_the_effect_is_a_straight_line_from_off(line: Refitted) -> None:
    """Monte Carlo stays where the fit without it stood; the line's size is the ripple's strength, not its own."""
    assert line.fit is not None
    anchor = line.fit.problem.anchor
    assert anchor is not None
    assert anchor.model.effects == ()
    assert abs(line.value - strength(TRUTH)) < 4.0 * line.error
    assert line.value - TRUTH > 20.0 * line.error


def test_what_is_kept_is_fitted_about_monte_carlo_at_its_own_value(line: Refitted) -> None:
    """With the slope that it has there: the size is the true one within its errors, and the anchor stands at it."""
    predictor = Anchors()
    found = finished(line, predictor, None)
    assert abs(found.value - TRUTH) < 3.0 * found.error
    assert found.error < line.error
    assert (found.chi2, found.beside_base) == (line.chi2, line.fit)  # held against a fit about the same Monte Carlo
    assert line.beside_base is line.fit is not found.fit
    assert found.fit is not None
    assert found.fit.chi2 == pytest.approx(found.fit.freedom, rel=0.1)
    slopes = found.fit.problem.predictor  # those of the second walk, which errors rest on as well, are the same ones
    assert isinstance(slopes, FrozenImages)
    assert slopes.others is not None
    own = slopes.slopes["effects.ripple.size"], slopes.others()["effects.ripple.size"]
    assert all(np.array_equal(*pair) for pair in zip(*own, strict=True))
    anchor = found.fit.problem.anchor
    assert anchor is not None
    assert (anchor.histories, anchor.seed) == (ANCHORED, 7)
    (effect,) = anchor.model.effects
    assert effect.parameters["size"] == pytest.approx(found.value, abs=0.3 * found.error)
    shifts = np.array([[one.shift_px for one in poses] for poses in (anchor.poses, found.fit.poses.values())])
    assert np.abs(shifts[0] - shifts[1]).max() < 0.01
    asked = {(at.histories, at.seed, at.exit_seed) for at in predictor.anchors if at is not None}
    assert asked == {(ANCHORED // 2, 8, 1), (ANCHORED // 2, 9, 2)}  # slopes share no random number with the anchor


def with_histories(line: Refitted, histories: int) -> Refitted:
    """The line about an anchor of so many histories."""
    assert line.fit is not None
    anchor = line.fit.problem.anchor
    assert anchor is not None
    problem = replace(line.fit.problem, anchor=replace(anchor, histories=histories))
    return replace(line, fit=replace(line.fit, problem=problem))


def test_many_histories_are_for_the_last_anchor_of_what_is_kept(line: Refitted) -> None:
    """Where it shall be is found by few; its slope has a part of them; the size is the one that few find, too."""
    few, predictor = finished(line, Anchors(), None), Anchors()
    found = finished(with_histories(line, 8 * ON_THE_WAY), predictor, None)
    assert found.fit is not None
    assert found.fit.problem.anchor is not None
    assert found.fit.problem.anchor.histories == 8 * ON_THE_WAY
    assert found.value == pytest.approx(few.value, abs=0.3 * few.error)
    asked = [at.histories for at in predictor.anchors if at is not None]
    assert set(asked) == {ON_THE_WAY // 2, ON_THE_WAY}
    assert asked == sorted(asked)  # slopes: on the way, then at last


def test_a_fit_about_its_own_monte_carlo_has_many_histories_at_last(base: Fit) -> None:
    """By few until it stays, by fewer at first, and once by all; where all are few, never more than that."""
    anchor = base.problem.anchor
    assert anchor is not None
    several = ((8 * ON_THE_WAY, [ON_THE_WAY, 8 * ON_THE_WAY]), (ANCHORED, [ANCHORED]))
    for histories, expected in several:
        few = [expected[0] // AT_FIRST, expected[0]]
        predictor = Anchors()
        problem = replace(base.problem, predictor=predictor, anchor=replace(anchor, histories=histories))
        found = about_its_own(problem, base)
        assert found.problem.anchor is not None
        assert found.problem.anchor.histories == histories
        asked = [at.histories for at in predictor.anchors if at is not None and at.histories]
        assert sorted(set(asked)) == [few[0], *expected]
        assert asked == sorted(asked)
        worse, predictor = 0.0, Anchors()  # than what it stands beside: a few histories say so
        found = about_its_own(replace(problem, predictor=predictor), base, worse)
        asked = [at.histories for at in predictor.anchors if at is not None and at.histories]
        assert sorted(set(asked)) == few


def test_an_effect_with_walks_of_its_own_is_fitted_as_one_that_the_twin_does_not_know(
    base: Fit, line: Refitted
) -> None:
    """The twin's image with it has the noise of another walk: a straight line first, then Monte Carlo about it."""
    score = score_of(base)
    walking = RIPPLE.model_copy(update={"twin": True, "walks": True})
    score = replace(score, candidate=replace(score.candidate, effect=walking))
    found = freed(base, score, slopes_of(base))
    assert (found.value, found.chi2) == (line.value, line.chi2)
    ended, expected = finished(found, Anchors(), None), finished(line, Anchors(), None)
    assert (ended.value, ended.error) == (expected.value, expected.error)
    assert ended.value != found.value


def test_without_monte_carlo_nothing_is_done_again(line: Refitted) -> None:
    """Where there is no anchor, or one that only lends its exits, the line is all there is."""
    assert line.fit is not None
    anchor = line.fit.problem.anchor
    assert anchor is not None
    for other in (None, replace(anchor, histories=0)):
        there = replace(line, fit=replace(line.fit, problem=replace(line.fit.problem, anchor=other)))
        predictor = Anchors()
        assert finished(there, predictor, None) is there
        assert predictor.asked == 0


def test_derivatives_that_are_not_given_are_asked_for() -> None:
    """A second effect that is added to a fit whose slopes stay has its own; it was a KeyError."""
    images = data()
    views = [view_of(image, Pose()) for image in images]
    given = [np.ones((view.rows, view.columns)) for view in views]
    frozen = FrozenImages(Anchors(), {HALO: given}, frozenset())
    found = frozen.images(MODEL, views, (HALO, SIGMA, "shift_row_px"))
    own = Anchors().images(MODEL, views, (SIGMA, "shift_row_px"))
    for one, of_its_own in zip(found, own, strict=True):
        np.testing.assert_array_equal(one.jacobian_per_mm2[HALO], 1.0)
        for path in (SIGMA, "shift_row_px"):
            np.testing.assert_array_equal(one.jacobian_per_mm2[path], of_its_own.jacobian_per_mm2[path])


class Walks(Spots):
    """Spots whose derivatives have an error that is another one for each walk inside the chips."""

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """As workers answer."""
        error = 1.0 if anchor is None else 1.0 + 0.01 * anchor.exit_seed
        found = super().images(model, views, paths, anchor)
        return [
            replace(one, jacobian_per_mm2={path: error * slope for path, slope in one.jacobian_per_mm2.items()})
            for one in found
        ]


def test_frozen_derivatives_keep_those_of_the_second_walk() -> None:
    """Errors rest on columns of two walks; one that is let go is asked for again, of the walk that is wanted."""
    fit_ = fit(MODEL, data(), Walks(), free=PATHS)
    problem = replace(fit_.problem, anchor=Anchored(MODEL, 0))
    frozen = frozen_at(problem, fit_.values)
    moved = fit_.values + 0.01 * np.abs(fit_.values)
    there, of_another = frozen.evaluate(moved).predicted[0], frozen.evaluate(moved).others()[0]
    at, after = (one.evaluate(values).predicted[0] for one, values in ((problem, fit_.values), (problem, moved)))
    partly = without(frozen, HALO).evaluate(moved)
    for path in PATHS:
        first, second = there.jacobian_per_mm2[path], of_another.jacobian_per_mm2[path]
        np.testing.assert_array_equal(first, at.jacobian_per_mm2[path])
        np.testing.assert_allclose(second, first * 1.02 / 1.01, rtol=1e-12)
    np.testing.assert_array_equal(partly.predicted[0].jacobian_per_mm2[HALO], after.jacobian_per_mm2[HALO])


def test_what_is_frozen_beside_a_line_keeps_the_second_walk_of_all_else() -> None:
    """A line has one slope by either walk; the model's own parameters have two, which are not lost with it."""
    fit_ = fit(MODEL, data(), Walks(), free=PATHS)
    problem, path = replace(fit_.problem, anchor=Anchored(MODEL, 0)), "effects.ripple.size"
    frozen = frozen_at(problem, fit_.values)
    images = frozen.predictor
    assert isinstance(images, FrozenImages)
    line = [np.ones((view.rows, view.columns)) for view in (view_of(one, Pose()) for one in data())]
    beside = replace(images, slopes={**images.slopes, path: line}, lines=frozenset(["ripple"]))
    rippled = with_effect(MODEL, applied(RIPPLE, {"size": TRUTH}))
    again = frozen_at(replace(frozen, predictor=beside, model=rippled), fit_.values).predictor
    assert isinstance(again, FrozenImages)
    assert again.others is not None
    assert again.lines == {"ripple"}
    for one, other in ((again.slopes[path], line), (again.others()[path], line)):
        assert all(np.array_equal(*pair) for pair in zip(one, other, strict=True))
    for own in PATHS:
        first, second = again.slopes[own][0], again.others()[own][0]
        np.testing.assert_allclose(second, first * 1.02 / 1.01, rtol=1e-12)


def test_a_size_beyond_a_straight_lines_reach_is_begun_nearer(base: Fit) -> None:
    """A score that promises half of the range where a tenth of it is there: the fit ends where it would have."""
    score = score_of(base)
    far = freed(base, replace(score, size=10.0 * score.size), slopes_of(base))
    near = freed(base, score, slopes_of(base))
    assert far.chi2 == pytest.approx(near.chi2, abs=1.0)
    assert abs(far.value - near.value) < 0.3 * near.error


class Widening(Spots):
    """Spots with an effect that does nearly what the halo does: a tenth of it is a ripple besides."""

    def images(
        self, model: Model, views: Sequence[View], paths: Sequence[str] = (), anchor: Anchored | None = None
    ) -> list[Predicted]:
        """As workers answer; derivatives by the model's own parameters."""
        size = sum(float(one.parameters["size"]) for one in model.effects)  # type: ignore[arg-type]  # a number here
        wider = model.model_copy(update={"effects": (), "fit": {}}).with_value(
            HALO, float(model.leaves()[HALO]) + size
        )
        rippled = MODEL.model_copy(update={"effects": (applied(RIPPLE, {"size": 0.1 * size}),)})
        own = [path for path in paths if not path.startswith("effects.")]
        return [
            replace(one, irradiance_per_mm2=seen(rippled, view, one.irradiance_per_mm2))
            for view, one in zip(views, super().images(wider, views, own, anchor), strict=True)
        ]


def test_the_models_own_parameters_move_with_the_effect_from_the_start() -> None:
    """A fit without the effect has put it into the halo: begun with the halo as it is, five starts would be worse."""
    grows = spec("ripple")
    truth = with_effect(MODEL.with_value(HALO, 0.3), applied(grows, {"size": 0.3}))
    images = noisy(lambda view: Widening().images(truth, [view])[0].irradiance_per_mm2, 9)
    base = fit(MODEL, images, Widening(), free=PATHS)
    parts = []
    for image in base.problem.images:
        views = [view_of(image, base.poses[image.shot.id])]
        off, on = (
            Widening().images(with_effect(base.model, applied(grows, {"size": size})), views)[0].irradiance_per_mm2
            for size in (0.0, H)
        )
        parts.append((on - off) / H)
    column = Projection.of(base).rows(Column("ripple", "size", {}, None, H, tuple(parts)))
    left = column - base.basis.data @ (base.basis.data.T @ column)
    size = float(left @ base.residual / (left @ left))
    score = Score(Candidate(grows, grows.parameters[0], (), column[None], tuple(parts)), 0.0, size, 0.0, 0.0)
    predictor = Widening()
    found = freed(replace(base, problem=replace(base.problem, predictor=predictor)), score, slopes_of(base))
    assert found.fit is not None
    assert found.fit.converged
    assert found.value == pytest.approx(0.3, abs=4.0 * found.error)
    assert found.fit.value(HALO) == pytest.approx(0.3, abs=4.0 * found.fit.error(HALO))
    assert predictor.asked <= 6


def test_monte_carlo_is_asked_for_anew_where_the_light_has_changed(base: Fit) -> None:
    """By more than a tenth in any image: the fit is made anew, about Monte Carlo of its own."""
    problem = replace(base.problem, predictor=Spots())
    anchor = problem.anchor
    assert anchor is not None
    assert not has_other_light(problem, base.values)
    darker = base.values.copy()
    darker[problem.unknowns.names.index(HALO)] *= 0.5
    assert has_other_light(problem, darker)
    moved = fitted_anew(problem, problem.unknowns.named(darker))
    assert moved is not None
    about = moved.problem.anchor
    assert about is not None
    assert about.model.leaves() != anchor.model.leaves()
    assert (about.histories, about.seed) == (anchor.histories, anchor.seed)
    assert moved.chi2 == pytest.approx(base.chi2, abs=1.0)
    lent = replace(problem, anchor=replace(anchor, histories=0))
    assert not has_other_light(lent, darker)
    assert fitted_anew(lent, lent.unknowns.named(darker)) is None


def test_a_parameter_far_from_where_the_anchor_has_it_has_strayed(base: Fit) -> None:
    """By more than five of its errors; exits that only are lent have no noise to stray from."""
    assert not has_strayed(base)
    far = base.values.copy()
    far[base.problem.unknowns.names.index(HALO)] += 6.0 * base.error(HALO)
    moved = replace(base, values=far)
    assert has_strayed(moved)
    anchor = base.problem.anchor
    assert anchor is not None
    assert not has_strayed(replace(moved, problem=replace(base.problem, anchor=replace(anchor, histories=0))))


@pytest.mark.parametrize("begins_there", [True, False])
def test_what_has_strayed_is_fitted_about_its_own_monte_carlo_and_rivals_beside_it(begins_there: bool) -> None:
    """The twin's error is that at the anchor: the halo takes far away, and what is named has an anchor there.

    Also where it begins at the anchor, and strays while derivatives of its own are taken.
    """
    images = noisy(lambda view: Affected().images(HIDDEN, [view])[0].irradiance_per_mm2, 6)
    base = fit(MODEL, images, Affected(), free=PATHS, anchor_at=lambda model: Anchored(model, ANCHORED, seed=7))
    wide, slopes = base.error(HALO), slopes_of(base)
    ripple = freed(base, smooth_score_of(base), slopes)
    assert ripple.fit is not None
    about_another = base.model.with_value(HALO, base.value(HALO) - 20.0 * wide)
    problem = replace(ripple.fit.problem, anchor=replace(base.problem.anchor, model=about_another))
    values = ripple.fit.values.copy()
    if begins_there:
        there = about_another.leaves()
        for path in PATHS:
            values[ripple.fit.names.index(path)] = there[path]
    strayed = replace(ripple, fit=replace(ripple.fit, problem=problem, values=values))
    assert has_strayed(strayed.fit) != begins_there
    ended = finished(strayed, Affected(), None)
    assert ended.fit is not None
    about = ended.fit.problem.anchor
    assert about is not None
    assert about.model.effects
    moved = beside(ripple, ended, base)
    assert moved.fit is not None
    assert moved.fit.problem.anchor == about
    assert moved.chi2 == pytest.approx(ended.chi2, abs=0.5)
    assert beside(ripple, ripple, base) is ripple
    better = replace(ripple, chi2=ended.chi2 - 31.0)  # about the first one: it loses more than two runs differ by
    assert beside(better, ended, base) is better
    assert beside(ended, replace(moved, fit=replace(moved.fit, problem=strayed.fit.problem)), base) is ended


def test_a_fit_by_the_twin_has_few_sets_of_derivatives(base: Fit) -> None:
    """From far away it comes to where one with derivatives at every step comes to; what is hopeless has one set."""

    class Counted(Affected):
        sets = 0

        def images(self, model: Any, views: Any, paths: Any = (), anchor: Any = None) -> list[Predicted]:
            self.sets += HALO in paths  # else those of poses, which cost nothing
            return super().images(model, views, paths, anchor)

    predictor, anchor = Counted(), base.problem.anchor
    assert anchor is not None
    problem = replace(base.problem, predictor=predictor)
    start = base.problem.unknowns.named(base.values) | {path: MODEL.leaves()[path] for path in PATHS}
    start[HALO] = 0.35
    found = by_twin(problem, start)
    assert 1 < predictor.sets <= TWIN_ANEW
    whole = refitted(replace(problem, anchor=replace(anchor, histories=0)), found.values)
    assert total_chi2(found) == pytest.approx(total_chi2(whole), abs=0.5)
    assert found.problem.predictor is predictor
    predictor.sets = 0
    by_twin(problem, start, below=0.0)
    assert predictor.sets == 1


def test_an_effect_by_its_square_that_is_not_there_ends_at_off() -> None:
    """No slope at off is told of its square by dividing by 0: the images have none of it, and its end is a fit."""
    images = noisy(lambda view: Spots().images(MODEL, [view])[0].irradiance_per_mm2, 6)
    base = fit(MODEL, images, Anchors(), free=PATHS, anchor_at=lambda model: Anchored(model, ANCHORED, seed=7))
    score, effect = score_of(base), spec("ripple", square=True).model_copy(update={"twin": False})
    sign = -np.sign(score.z)  # what is there by chance is on the side that does not exist
    candidate = replace(
        score.candidate, effect=effect, parameter=effect.parameters[0], columns=sign * score.candidate.columns,
        parts=tuple(sign * one for one in score.candidate.parts),
    )  # fmt: skip
    found = freed(base, replace(score, candidate=candidate, size=-abs(score.size)), slopes_of(base))
    assert found.value == 0.0
    ended = finished(found, base.problem.predictor, None)
    assert ended.value == pytest.approx(0.0, abs=1e-3)
    assert ended.chi2 == pytest.approx(found.chi2, abs=1.0)
