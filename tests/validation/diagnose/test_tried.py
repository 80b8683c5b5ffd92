"""What of a short list is fitted to its end, and beside what."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.effect import EffectParameter
from tests.validation.analytic import MODEL, SIGMA
from tests.validation.diagnose.made_up import LENGTH, RISE, Affected, data, diagnosis, images_of, spec
from validation.diagnose import tried
from validation.diagnose.columns import FitSight, candidates_of, in_shape
from validation.diagnose.diagnosis import blurred
from validation.diagnose.refit import whole_of
from validation.diagnose.tried import Tried
from validation.effects.confounding import left_beside
from validation.effects.signatures import Projection
from validation.fit import Fit

FIRST, OWN, RIVALS = "the base's anchor", "an anchor of its own", "the rival's anchor"


def one(name: str, drop: float, anchor: str, gap: float = 0.0, left: float = 20.0) -> Any:
    """An effect's refit, as far as the order of ends asks for it; `left` of its 20 sigma beside the other one."""
    spec = SimpleNamespace(name=name, twin=True, walks=False, parameters=())
    fit = SimpleNamespace(gap=gap, problem=SimpleNamespace(anchor=anchor))
    candidate = SimpleNamespace(effect=spec, is_group=False)
    beside = dict.fromkeys(("truth", "rival"), left)
    return SimpleNamespace(
        name=name, drop=drop, plausible=True, fit=fit, candidate=candidate, sigma=20.0, sigma_rival=beside
    )


def never(*_: Any) -> Any:
    """What nobody asks for."""
    raise AssertionError


def tried_with(monkeypatch: pytest.MonkeyPatch, finished: Any, beside: Any, refits: list[Any]) -> Tried:
    """The short list of a truth and its rival, whose ends these functions make up."""
    monkeypatch.setattr(tried, "finished", finished)
    monkeypatch.setattr(tried, "beside", beside)
    monkeypatch.setattr(tried, "as_fitted", lambda score, *_: score)
    monkeypatch.setattr(tried, "columns_of", lambda *_: None)
    monkeypatch.setattr(tried, "is_smooth", lambda _: True)
    monkeypatch.setattr(tried, "_explanation", lambda _, __, found, *___: found)
    ground: Any = SimpleNamespace(
        fit=SimpleNamespace(problem=SimpleNamespace(anchor=FIRST, predictor=None, predict_curves=None))
    )
    short: list[Any] = [
        SimpleNamespace(name=name, best=SimpleNamespace(candidate=None)) for name in ("truth", "rival")
    ]
    monkeypatch.setattr(Tried, "_tell_apart", lambda _: None)
    return Tried(ground, never, {}, short, refits, list[Any](refits))


@pytest.mark.parametrize(
    ("ends", "again"),
    [((FIRST, OWN), ["truth beside rival"]), ((RIVALS, OWN), []), ((FIRST, FIRST), ["truth beside rival"])],
)
def test_what_ended_about_the_first_monte_carlo_is_compared_about_its_rivals(
    ends: tuple[str, str], again: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An end about Monte Carlo of its own stays; `beside` leaves those alone whose rival has none."""
    moved = dict(zip(("truth", "rival"), ends, strict=True))
    asked: list[str] = []

    def finished(found: Any, *_: Any) -> Any:
        # the truth's end promises less than the rival still does, which is then fitted to its end, too
        return one(found.name, 90.0 if found.name == "truth" else 99.0, moved[found.name])

    def beside(found: Any, other: Any, _: Any) -> Any:
        asked.append(f"{found.name} beside {other.name}")
        return found

    refits = [one("truth", 100.0, FIRST), one("rival", 95.0, FIRST)]
    list_of = tried_with(monkeypatch, finished, beside, refits)
    list_of.finish(lambda *_: None)
    list_of.look_into_group(never, never)
    assert asked == ["rival beside truth", *again]
    assert [found.fit.problem.anchor for found in list_of.refits] == list(ends)


@pytest.mark.parametrize(("left", "asked_for"), [(20.0, []), (9.0, ["rival beside truth", "rival to its end"])])
def test_what_looks_like_the_likeliest_is_fitted_though_it_gained_less(
    monkeypatch: pytest.MonkeyPatch, left: float, asked_for: list[str]
) -> None:
    """At its end the likeliest gains more; a rival that is alike (9 of 20 sigma left) by what both gained before."""
    asked: list[str] = []

    def finished(found: Any, *_: Any) -> Any:
        if found.name == "rival":
            asked.append("rival to its end")
        drop = {"truth": 160.0, "rival": 110.0}[found.name]
        return one(found.name, drop, OWN, left=left)

    def beside(found: Any, other: Any, _: Any) -> Any:
        asked.append(f"{found.name} beside {other.name}")
        return one(found.name, 110.0, OWN, left=left)

    refits = [one("truth", 103.0, FIRST, left=left), one("rival", 30.0, FIRST, left=left)]
    tried_with(monkeypatch, finished, beside, refits).finish(lambda *_: None)
    assert asked == asked_for


def test_what_an_effect_takes_off_a_prior_counts_in_its_drop() -> None:
    """The model's own parameter makes up for a ripple against a narrow prior, and goes back beside it."""
    narrow = MODEL.fit[SIGMA].model_copy(update={"prior_mean": 6.0, "prior_sd": 0.01})
    images = images_of(MODEL.with_value(SIGMA, 6.0), 1)
    x = np.cos(np.arange(40) / 6.0)
    images = [replace(one, signal_dn=one.signal_dn * (1.0 + 0.1 * np.add.outer(x, x))) for one in images]
    first = diagnosis(images, MODEL.model_copy(update={"fit": MODEL.fit | {SIGMA: narrow}})).steps[0]

    def whole(found: Fit) -> float:
        known = zip(found.problem.unknowns.parameters, found.values, strict=True)
        return found.chi2 + float(sum(((value - one.prior_mean) / one.prior_sd) ** 2 for one, value in known))

    assert whole(first.ground.fit) - first.ground.fit.chi2 > 10.0
    for one, refit in zip(first.explanations, first.refits, strict=True):
        assert refit.fit is not None
        assert one.drop == pytest.approx(whole(first.ground.fit) - whole(refit.fit), abs=0.5)


@pytest.mark.parametrize(
    ("drop", "twin", "names"), [(20.0, False, {"walls"}), (20.0, True, set()), (5.0, False, set())]
)
def test_columns_of_monte_carlo_that_noise_may_have_blurred_are_looked_at_closely(
    drop: float, twin: bool, names: set[str]
) -> None:
    """Those that score a quarter of the best or more; the twin's own have no such noise."""

    def score(name: str, of: float, known: bool) -> Any:
        candidate = SimpleNamespace(effect=SimpleNamespace(name=name, twin=known))
        best = SimpleNamespace(drop=of, candidate=candidate)
        return SimpleNamespace(name=name, best=best, largest=best)

    scored: Any = SimpleNamespace(effects=(score("chip", 33.0, True), score("walls", drop, twin)))
    assert blurred(scored) == names


def test_sigma_is_of_the_shape_that_each_was_fitted_with() -> None:
    """Stripes of 308 um, tried at 325: their size belongs to the column of the length at which they were fitted."""
    along = EffectParameter(name="along", description="which way", choices=("y", "x"))
    stripes = spec("stripes", LENGTH.model_copy(update={"shape_grid": (325.0,)}))
    first = diagnosis(data("stripes", 2, 0.05, 308.0), known=(spec("lines", along), stripes)).steps[0]
    base, predictor = first.ground.fit, Affected()
    told = {one.name: one for one in first.explanations}
    assert dict(told["stripes"].shape)["length_um"] == pytest.approx(308.0, rel=0.01)
    rows = {}
    for one in first.refits:
        sight, effect = FitSight.of(base, predictor), one.candidate.effect  # type: ignore[arg-type]  # it predicts, too
        (seen,) = in_shape(base, effect, dict(told[effect.name].shape), sight, Projection.of(base))
        rows[effect.name] = told[effect.name].value * base.basis.left(seen.columns)
    for name, rival in (("lines", "stripes"), ("stripes", "lines")):
        assert told[name].sigma == pytest.approx(np.linalg.norm(rows[name]), rel=1e-6)
        assert told[name].sigma_rival[rival] == pytest.approx(left_beside(rows[name][0], [rows[rival]]), rel=1e-6)
    assert told["stripes"].sigma == pytest.approx(np.sqrt(told["stripes"].drop), rel=0.05)


def test_what_is_left_beside_a_rival_is_by_the_columns_that_it_ended_with(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rival that ended after the first one, in other words: what was left of the first beside it is told anew."""
    first = diagnosis(data("ripple", 4, 0.012)).steps[0]
    base, short = first.ground.fit, [score for score in first.scores.effects if score.best.drop > 0.0]
    columns = {one.name: tried.columns_of(base, one.best.candidate) for one in short}
    columns["ripple_like"] = base.basis.left(np.random.default_rng(1).standard_normal((1, len(base.residual))))
    order = [one.candidate.effect.name for one in first.refits]
    short = sorted(short, key=lambda one: order.index(one.name))
    list_of = Tried(first.ground, never, columns, short, list(first.refits), list(first.explanations))
    monkeypatch.setattr(Tried, "_likeliest", lambda *_: None)
    list_of.finish(lambda *_: None)
    (told,) = (one for one in list_of.explanations if one.name == "ripple")
    wanted = left_beside(told.value * columns["ripple"][0], [columns["ripple_like"]])
    assert told.sigma_rival["ripple_like"] == pytest.approx(wanted, rel=1e-9)


def test_numbers_that_act_together_are_taken_in_the_shape_that_they_were_fitted_with() -> None:
    """By the columns of a candidate of that shape, at their sizes; one that was left off does not count."""
    base = diagnosis(data(None, 1)).steps[0].ground.fit
    candidates = candidates_of(base, [RISE], FitSight.of(base, Affected()))  # type: ignore[arg-type]  # it predicts, too
    other = replace(candidates[0], columns=2.0 * candidates[0].columns)
    left = [base.basis.left(one.columns)[0] for one in (other, candidates[1])]
    a, b = (one.path for one in candidates)
    for size, wanted in (({a: 0.1, b: 0.2}, 0.1 * left[0] + 0.2 * left[1]), ({a: 0.1}, 0.1 * left[0])):
        found: Any = SimpleNamespace(candidate=candidates[0], size=size)
        np.testing.assert_allclose(whole_of(base, found, other), wanted, atol=1e-12)
