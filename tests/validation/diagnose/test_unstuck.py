"""Refits that are stuck where the fit without an effect went to make up for it, and their way out, made up."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.validation.analytic import HALO, MODEL, PATHS
from tests.validation.diagnose.made_up import Affected
from tests.validation.diagnose.rippled import (
    ANCHORED,
    HIDDEN,
    RIPPLE,
    TRUTH,
    Anchors,
    base_fit,
    noisy,
    score_of,
    smooth_score_of,
)
from validation.diagnose import ending
from validation.diagnose.ending import finished, is_stuck, unstuck
from validation.diagnose.frozen import FrozenImages, slopes_of
from validation.diagnose.refit import freed
from validation.fit import Fit, fit
from validation.prediction import Anchored


@pytest.fixture(scope="module")
def base() -> Fit:
    """The fit without the effect, about Monte Carlo where it stands."""
    return base_fit()


def test_a_refit_at_a_limit_is_made_anew_from_where_the_model_began(base: Fit) -> None:
    """A base fit at a limit made up for the effect: what begins anew comes back, if it fits better."""
    score = score_of(base)
    found = freed(base, score, slopes_of(base))
    assert found.fit is not None
    kept, smooth = found.fit, found.candidate.effect.model_copy(update={"twin": True})
    found = replace(found, candidate=replace(found.candidate, effect=smooth))
    assert not is_stuck(found, base)
    at_limit = replace(found, chi2=found.chi2 + 50.0, fit=replace(kept, driven=(HALO,)))
    assert is_stuck(at_limit, base)
    assert not is_stuck(replace(at_limit, driven=True), base)
    anchored = replace(base, problem=replace(base.problem, predictor=Affected()))
    back = unstuck(at_limit, anchored)
    assert back.fit is not None
    assert back.chi2 == pytest.approx(found.chi2, abs=3.0)  # another anchor, other noise
    assert back.value == pytest.approx(found.value, rel=0.05)  # frozen derivatives against its own
    assert unstuck(replace(at_limit, chi2=0.0), anchored).chi2 == 0.0


def test_monte_carlo_is_not_asked_where_the_twin_begins_worse(base: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a short list most fits that are stuck are no better anew, or go to the limit again: minutes each."""
    found = freed(base, score_of(base), slopes_of(base))
    assert found.fit is not None
    at_limit = replace(found, fit=replace(found.fit, driven=(HALO,)))
    predictor, asked = Anchors(), list[Fit]()
    anchored = replace(base, problem=replace(base.problem, predictor=predictor))
    begun, stays = replace(base, chi2=120.0), replace(base, chi2=100.0)
    monkeypatch.setattr(ending, "chi2_by_twin", lambda *_: 500.0)
    monkeypatch.setattr(ending, "about_its_own", lambda _, fit, *__: (asked.append(fit), fit)[1])
    for fits in ([begun, stays], [replace(begun, chi2=90.0, driven=(HALO,))], [replace(begun, chi2=600.0)]):
        twins = iter(fits)
        monkeypatch.setattr(ending, "by_twin", lambda *_, twins=twins: next(twins))
        assert unstuck(at_limit, anchored) is at_limit
        assert next(twins, None) is None
        assert asked.pop() is at_limit.fit  # about its own, which leaves it where it is, and no more
        assert not asked


def test_a_refit_beside_a_base_in_a_corner_is_fitted_about_its_own(
    base: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the twin errs by, carried over from the corner, held it: it is out where that gains more than noise."""
    found = freed(base, score_of(base), slopes_of(base))
    assert found.fit is not None
    smooth = found.candidate.effect.model_copy(update={"twin": True})
    found = replace(found, candidate=replace(found.candidate, effect=smooth))
    corner = replace(base, driven=(HALO,))
    assert is_stuck(found, corner)
    assert not is_stuck(replace(found, candidate=replace(found.candidate, effect=RIPPLE)), corner)
    assert not is_stuck(replace(found, candidate=replace(found.candidate, is_switch=True)), corner)
    for gain, freed_by_it in ((20.0, False), (90.0, True)):
        out = replace(found.fit, chi2=found.fit.chi2 - gain)
        monkeypatch.setattr(ending, "about_its_own", lambda *_, out=out: out)
        ended = unstuck(found, corner)
        assert (ended.fit is out) is freed_by_it
        assert (ended is found) is not freed_by_it


def test_an_effect_with_walks_of_its_own_comes_out_along_its_line() -> None:
    """Led out, Monte Carlo is at the effect's own value, all else has derivatives of its own, and the end is the true
    size. Beside an effect that is a line already it stays, and so does what the twin does not know."""
    predictor = Affected()
    images = noisy(lambda view: predictor.images(HIDDEN, [view])[0].irradiance_per_mm2, 6)
    base = fit(MODEL, images, predictor, free=PATHS, anchor_at=lambda model: Anchored(model, ANCHORED, seed=7))
    score = smooth_score_of(base)
    walking = replace(score.candidate, effect=score.candidate.effect.model_copy(update={"walks": True}))
    line = freed(base, replace(score, candidate=walking), slopes_of(base))
    assert line.fit is not None
    stuck = replace(line, chi2=line.chi2 + 50.0, fit=replace(line.fit, driven=(HALO,)))
    assert is_stuck(stuck, base)
    out = unstuck(stuck, base)
    assert out.fit is not None
    assert out is not stuck
    assert out.chi2 == pytest.approx(line.chi2, abs=5.0)
    anchor, lines = out.fit.problem.anchor, out.fit.problem.predictor
    assert anchor is not None
    assert [one.name for one in anchor.model.effects] == ["ripple"]
    assert isinstance(lines, FrozenImages)
    assert (set(lines.slopes), lines.lines, lines.predictor) == ({"effects.ripple.size"}, {"ripple"}, predictor)
    ended = finished(out, predictor, None)
    assert abs(ended.value - TRUTH) < 3.0 * ended.error
    assert ended.fit is not None
    assert isinstance(ended.fit.problem.predictor, FrozenImages)
    assert set(ended.fit.problem.predictor.slopes) == {*PATHS, "effects.ripple.size"}
    beside_a_line = replace(base, problem=replace(base.problem, predictor=line.fit.problem.predictor))
    assert not is_stuck(stuck, beside_a_line)
    assert not is_stuck(replace(stuck, candidate=replace(walking, effect=RIPPLE)), base)
