"""Replays of diagnose and add: the same numbers lead to the same verdict and ladder; what was forged is named."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.audit import Compared, Place
from luxloop.model import Model
from luxloop.model_file import to_toml
from tests.validation.analytic import MODEL, PATHS
from tests.validation.diagnose import made_up
from validation import auditor, reexecute
from validation.adding import told_of
from validation.comparing import maps_of
from validation.dataset.folder import read_dataset
from validation.diagnose.diagnosis import Means
from validation.diagnose.diagnosis import diagnosed as diagnosed_by
from validation.diagnose.document import document
from validation.diagnose.explained import Share
from validation.diagnose.rounds import Diagnosis
from validation.diagnose.verdict import decided
from validation.fit import Fit, fit
from validation.model_versions import save
from validation.redeciding import changed_model, diagnosis, explanation_of
from validation.reexecute import FromAnswers, fitted

Plain = dict[str, Any]
EXAMPLE = Path(__file__).parents[2] / "examples" / "paper-like"


def said(compare: Callable[[Place], object]) -> list[tuple[str, str]]:
    """What a comparison says that is not identical: of what, and with which verdict."""
    told: list[Compared] = []
    compare(Place(told.append))
    assert told
    return [(one.what, one.verdict) for one in told if one.verdict != "identical"]


def as_kept(plain: Plain) -> Plain:
    """As a journal has it."""
    back: Plain = json.loads(json.dumps(plain))
    return back


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    """Of images with a ripple."""
    return made_up.diagnosis(made_up.data("ripple", 3, 0.06), known=made_up.CATALOGUE[:3])


@pytest.fixture(scope="module")
def diagnosed(found: Diagnosis) -> Plain:
    """Its document."""
    return as_kept(document(found, 1))


def put(tree: Any, path: str, value: Any) -> Any:
    """A copy with another value at a path of names and numbers."""
    forged = copy.deepcopy(tree)
    *parents, last = [int(part) if part.isdigit() else part for part in path.split("/")]
    at = forged
    for part in parents:
        at = at[part]
    at[last] = value
    return forged


def test_a_verdict_follows_from_its_numbers(diagnosed: Plain) -> None:
    """As it was told, from shares, held-out errors and rivals alone."""
    assert diagnosed["verdict"] in ("one_effect", "cannot_tell_apart")
    assert said(lambda at: diagnosis(diagnosed, at)) == []
    nothing = as_kept(document(made_up.diagnosis(made_up.data(None, 9), known=made_up.CATALOGUE[:1]), 1))
    assert nothing["verdict"] == "nothing_visible"
    assert said(lambda at: diagnosis(nothing, at)) == []


@pytest.mark.parametrize(
    ("path", "value", "what"),
    [
        ("verdict", "none_of_the_known", "verdict"),
        ("set", ["fog"], "set of the verdict"),
        ("effects/0/explained_share", 0.1, "verdict"),
        ("effects/0/chi2_drop", 0.5, "effects, the best first"),
        ("scores/0/chi2_drop", 0.0, "scores, the best first"),
        ("structure/p", 0.9, "verdict"),
    ],
)
def test_a_forged_diagnosis_is_named(diagnosed: Plain, path: str, value: Any, what: str) -> None:
    """Each number that the verdict or a rank rests on."""
    forged = put(diagnosed, path, value)
    if path.endswith("explained_share"):  # an effect that explains little is doubted only where structure is left
        forged["effects"][0]["p_left"] = 0.0001
    if path == "structure/p":
        forged["scores_p"] = 0.9
    assert (what, "differs") in said(lambda at: diagnosis(forged, at))


def test_a_fall_of_chi2_is_held_against_as_many_numbers_as_were_fitted(diagnosed: Plain) -> None:
    """A record of before that was kept is replayed as it was decided, by one."""
    told = put(diagnosed, "known", 43)
    told["effects"] = [told["effects"][0] | {"chi2_drop": 16.0, "p_left": 1e-4, "numbers": 2}]
    tried = [explanation_of(row) for row in told["effects"]]
    before = [explanation_of({name: row[name] for name in row if name != "numbers"}) for row in told["effects"]]
    words = [decided(some, 43, str, lambda _: "").word for some in (tried, before)]
    assert words == ["none_of_the_known", diagnosed["verdict"]]


def test_where_nothing_could_be_added_the_verdict_follows_too() -> None:
    """A dark ripple, of which only bright ones are known; nobody at all of whom to choose, limits or not."""
    ripple = made_up.CATALOGUE[0]
    bright = ripple.model_copy(update={"parameters": (ripple.parameters[0].model_copy(update={"lower": 0.0}),)})
    images = made_up.data("ripple", 3, -0.06)
    for known in ((bright,), ()):
        told = as_kept(document(made_up.diagnosis(images, known=known), 1))
        assert (told["verdict"], told["effects"], told["set"]) == ("none_of_the_known", [], [])
        held = put(told, "distrust", ["a.b is at its limit (0 to 1); widen the limits"])
        assert said(partial(diagnosis, told)) == []
        assert said(partial(diagnosis, held)) == []
    doubted = put(put(told, "distrust", ["an image may be of no light at all"]), "verdict", "fit_not_trustworthy")
    assert said(partial(diagnosis, doubted)) == []


def test_what_more_monte_carlo_takes_back_is_not_visible() -> None:
    """By a few histories a column may look like the noise in the images; a better one finds nothing there."""
    (one,) = made_up.diagnosis(made_up.data(None, 9), known=made_up.CATALOGUE[:1]).steps
    base = one.ground.fit
    assert one.ground.structure.p > 0.005
    traced = made_up.CATALOGUE[0].model_copy(update={"twin": False})
    score = one.scores.effects[0].best.candidate
    closely = replace(score, effect=traced)
    by_few = replace(closely, columns=score.columns + 0.5 * base.residual[None] * np.linalg.norm(score.columns))
    members_fit, ground_of = made_up.members_fit, made_up.ground_of
    columns = lambda *_: [by_few], lambda *_: [closely], lambda *_: [closely]  # three of a kind
    means = Means(*columns, members_fit, ground_of, lambda *_: [made_up.ANOTHER])
    again = diagnosed_by(one.ground, [traced], means)
    assert again.steps[0].scores.p > 0.005
    assert again.verdict.word == "nothing_visible"
    told = as_kept(document(again, 1))
    assert said(lambda at: diagnosis(told, at)) == []


def test_what_a_verdict_says_is_left_follows_from_its_numbers() -> None:
    """That structure is left; a record from before that was said has none of it; another number is named."""
    (step,) = made_up.diagnosis(made_up.data("ripple", 3, 0.06), known=made_up.CATALOGUE[:1]).steps
    assert step.verdict.word == "one_effect"
    tried = tuple(replace(one, p_left=0.0001, share=Share(0.9, 0.05)) for one in step.explanations)
    verdict = decided(tried, 1, str, lambda _: "")
    leaving = Diagnosis((replace(step, explanations=tried, verdict=verdict),), 1)
    told = as_kept(document(leaving, 1))
    left = " Structure is left that nothing named here explains (p 0.0001)."
    assert told["sentence"] == verdict.sentence + left
    assert said(lambda at: diagnosis(told, at)) == []
    assert said(lambda at: diagnosis(put(told, "sentence", verdict.sentence), at)) == []
    forged = put(told, "sentence", told["sentence"].replace("0.0001", "0.001"))
    assert said(lambda at: diagnosis(forged, at)) == [("sentence", "differs")]


def test_an_error_that_stays_may_be_told_as_it_was_before(diagnosed: Plain) -> None:
    """Lowered or raised to what it was; of other numbers it may not."""
    told = put(diagnosed, "effects/0/held_out_after", diagnosed["effects"][0]["held_out_before"])
    told["effects"] = told["effects"][:1]
    again = decided([explanation_of(row) for row in told["effects"]], told["known"], str, lambda _: "")
    told |= {"verdict": again.word, "set": list(again.set)}
    (stays,) = re.findall(r"leaves the held-out error at (\S+ %)", again.sentence)
    for words, verdicts in (
        (f"leaves the held-out error at {stays}", []),
        (f"raises the held-out error from {stays} to {stays}", []),
        (f"lowers the held-out error from {stays} to {stays}", []),
        (f"lowers the held-out error from 9 % to {stays}", [("sentence", "differs")]),
    ):
        sentence = again.sentence.replace(f"leaves the held-out error at {stays}", words)
        assert said(partial(diagnosis, told | {"sentence": sentence})) == verdicts


def test_a_forged_map_of_residuals_is_named(found: Diagnosis, diagnosed: Plain) -> None:
    """Of a diagnosis as of a comparison: chi2 of each image comes from its map."""
    maps = maps_of(found.steps[0].ground.fit)
    assert said(lambda at: auditor.compared(diagnosed, maps, at)) == []
    forged = {**maps, "array": 1.01 * maps["array"]}
    assert said(lambda at: auditor.compared(diagnosed, forged, at)) == [("chi2 per pixel, array", "differs")]


@pytest.fixture(scope="module")
def fits(found: Diagnosis) -> tuple[Fit, Fit]:
    """Without and with the ripple."""
    kept = found.steps[0].kept
    assert kept is not None
    assert kept.fit is not None
    return found.steps[0].ground.fit, kept.fit


def added(fits: tuple[Fit, Fit], folder: Path) -> Plain:
    """What add told, and a version of the model file that keeps it."""
    before, after = map(made_up.ground_of, fits)
    file = folder / "model.toml"
    told = told_of(MODEL, before, after) | {"effect": "ripple", "model": {"path": str(file)}, "version": None}
    save(file, fits[1].model, "add ripple", told["errors"])
    return as_kept(told)


def test_an_added_effect_and_its_rung_of_the_ladder_follow(fits: tuple[Fit, Fit], tmp_path: Path) -> None:
    """What changed from the two models, errors from those before and after, the version as it is kept."""
    told = added(fits, tmp_path)
    assert said(lambda at: changed_model(told, "add", MODEL, at)) == []


@pytest.mark.parametrize(
    ("path", "value", "what"),
    [
        ("fitted/0/value", 0.123, "fitted value"),
        ("diff/0", "nothing", "what changed"),
        ("after/held_out_percent", 0.01, "errors of the version"),
        ("after_sha256", "0" * 64, "model after"),
        ("trusted", False, "trusted"),
    ],
)
def test_a_forged_value_is_named(fits: tuple[Fit, Fit], tmp_path: Path, path: str, value: Any, what: str) -> None:
    """Values, errors, the model."""
    told = put(added(fits, tmp_path), path, value)
    assert (what, "differs") in said(lambda at: changed_model(told, "add", MODEL, at))


def test_a_forged_entry_of_the_ladder_is_named(fits: tuple[Fit, Fit], tmp_path: Path) -> None:
    """The line of versions.jsonl says another error than the journal; a line that is gone is not comparable."""
    told = added(fits, tmp_path)
    log = tmp_path / ".luxloop" / "models" / "versions.jsonl"
    line = json.loads(log.read_text())
    line["errors"]["held-out %"] = 0.001
    log.write_text(json.dumps(line) + "\n")
    assert said(lambda at: changed_model(told, "add", MODEL, at)) == [("entry of the ladder", "differs")]
    log.write_text("")
    assert said(lambda at: changed_model(told, "add", MODEL, at)) == [("entry of the ladder", "not comparable")]


def test_changed_data_are_named(tmp_path: Path) -> None:
    """A folder that is as it was, one that was changed, one that is gone."""
    sha256 = read_dataset(EXAMPLE).sha256
    here, gone = ({"dataset": {"path": str(path)}} for path in (EXAMPLE, tmp_path))
    assert said(lambda at: auditor.same_data(here, sha256, at)) == []
    assert said(lambda at: auditor.same_data(here, "0" * 64, at)) == [("data set", "differs")]
    assert said(lambda at: auditor.same_data(gone, sha256, at)) == [("data set", "not comparable")]


def test_a_fit_on_the_answers_of_today_is_held_to_the_record(
    fits: tuple[Fit, Fit], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Level 4: what add told, told again by the same fits; other answers give other errors, and that is named."""

    def again(scale: float) -> Callable[[Any, Model, FromAnswers], Plain]:
        images = [made_up.replace(one, signal_dn=scale * one.signal_dn) for one in fits[1].problem.images]
        other = fit(MODEL, images, made_up.Affected(), free=PATHS)
        grounds = made_up.ground_of(fits[0]), made_up.ground_of(fits[1] if scale == 1.0 else other)
        return lambda _, model, __: told_of(model, *grounds)

    sha256 = read_dataset(EXAMPLE).sha256
    told = added(fits, tmp_path) | {"dataset": {"path": str(EXAMPLE)}}
    step = SimpleNamespace(command="add", document=told, dataset_sha256=sha256)
    journal: Any = SimpleNamespace(attachments=lambda: {"model.toml": to_toml(MODEL).encode()})
    monkeypatch.setitem(reexecute.FITS, "add", again(1.0))
    assert said(lambda at: fitted(journal, step, FromAnswers({}), at)) == []
    for errors in (told["before"], told["after"]):
        del errors["curves_noise_percent"]  # documents were given it since
    assert said(lambda at: fitted(journal, step, FromAnswers({}), at)) == []
    monkeypatch.setitem(reexecute.FITS, "add", again(1.02))
    assert ("the fit anew, after", "differs") in said(lambda at: fitted(journal, step, FromAnswers({}), at))
