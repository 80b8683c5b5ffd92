"""What of a short list is fitted to its end, and beside what."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.validation.analytic import MODEL, SIGMA
from tests.validation.diagnose.made_up import diagnosis, images_of
from validation.diagnose import tried
from validation.diagnose.diagnosis import blurred
from validation.diagnose.tried import Tried
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


def tried_with(monkeypatch: pytest.MonkeyPatch, finished: Any, beside: Any, refits: list[Any]) -> Tried:
    """The short list of a truth and its rival, whose ends these functions make up."""
    monkeypatch.setattr(tried, "finished", finished)
    monkeypatch.setattr(tried, "beside", beside)
    monkeypatch.setattr(tried, "as_fitted", lambda _, score, __: score)
    monkeypatch.setattr(tried, "columns_of", lambda *_: None)
    monkeypatch.setattr(tried, "is_smooth", lambda _: True)
    monkeypatch.setattr(tried, "_explanation", lambda _, __, found, *___: found)
    ground: Any = SimpleNamespace(
        fit=SimpleNamespace(problem=SimpleNamespace(anchor=FIRST, predictor=None, predict_curves=None))
    )
    short: list[Any] = [
        SimpleNamespace(name=name, best=SimpleNamespace(candidate=None)) for name in ("truth", "rival")
    ]
    projected: Any = SimpleNamespace(own=lambda _: None)
    return Tried(ground, projected, {}, short, refits, list[Any](refits))


def never(*_: Any) -> Any:
    """There is no group."""
    raise AssertionError


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
        return SimpleNamespace(name=name, best=SimpleNamespace(drop=of, candidate=candidate))

    scored: Any = SimpleNamespace(effects=(score("chip", 33.0, True), score("walls", drop, twin)))
    assert blurred(scored) == names
