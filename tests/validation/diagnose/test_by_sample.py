"""Effects that each sample has its own of: fitted sample by sample, chip by chip, written into the model file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.effect import EffectSpec
from luxloop.errors import InputError
from luxloop.model import Fit as Limits
from luxloop.model import Model
from luxloop.model_file import parse_toml, to_toml
from tests.validation.analytic import MODEL, PATHS
from tests.validation.diagnose import made_up, rippled
from tests.validation.diagnose.made_up import CHIPS, columns_at, hidden
from validation.diagnose.anew import has_strayed
from validation.diagnose.by_sample import Own, _members, _renewed, is_by_sample, with_members_free, with_own_values
from validation.diagnose.columns import _apart
from validation.diagnose.ending import finished
from validation.diagnose.frozen import slopes_of
from validation.diagnose.held_out import folds_by_blocks, folds_by_sample, held_out
from validation.diagnose.refit import freed
from validation.diagnose.refitted import Refitted
from validation.diagnose.score import Candidate, Score
from validation.effects.signatures import Projection
from validation.fit import Fit, fit
from validation.fit.parameters import free_paths
from validation.prediction import Anchored, Predicted, View
from validation.sample_values import free_members, members, of_sample, refuse_strangers, with_members, without_samples

TILTED = made_up.spec("ripple").model_copy(update={"scope": "per_sample"})
SIZES = {"array": 0.06, "third": -0.04}
GAINS = {"array": (0.1, -0.05, 0.02), "third": (-0.08, 0.03, 0.06)}


def added(truth: Model, spec: EffectSpec) -> tuple[Fit, Fit]:
    """The fit without and with the effect."""
    base = fit(MODEL, made_up.images_of(truth, 3), made_up.Affected(), free=PATHS)
    return base, with_own_values(base, spec, columns_at)


def test_each_sample_gets_its_value_and_one_that_shows_nothing_stays_without() -> None:
    """Ripples of two sizes in two of three samples: both within errors, the third has none; designs have it off."""
    base, found = added(hidden("ripple", {"size": 0.0}, **{name: {"size": v} for name, v in SIZES.items()}), TILTED)
    assert set(found.model.samples) == {"array", "third"}
    for sample, size in SIZES.items():
        path = f"samples.{sample}.ripple.size"
        assert abs(found.value(path) - size) < 3.0 * found.error(path)
    assert found.chi2_per_row < 1.1 < base.chi2_per_row
    assert found.trusted
    assert [one.parameters for one in found.model.effects] == [{"size": 0.0}]
    assert parse_toml(to_toml(found.model), "") == found.model


@pytest.mark.parametrize(
    ("common", "own"), [(0.0, {"array": 0.05, "third": -0.05}), (0.05, {})], ids=["of each", "of all"]
)
def test_a_diagnosis_names_what_each_sample_has_its_own_of(common: float, own: dict[str, float]) -> None:
    """Regression: scored by one value of all, ripples that are opposite in two samples were in nobody's sight.

    Where one value of all says as much, it is that.
    """
    truth = hidden("ripple", {"size": common}, **{name: {"size": size} for name, size in own.items()})
    found = made_up.diagnosis(made_up.images_of(truth, 3), known=[TILTED, made_up.spec("fog", square=True)])
    best, kept = found.added[0], found.steps[0].kept
    assert (found.verdict.word, found.set, len(found.added)) == ("one_effect", ("ripple",), 1)
    assert (best.p_left > 0.005, best.share.value > 0.9) == (True, True)
    assert kept is not None
    assert kept.fit is not None
    wanted = {f"samples.{name}.ripple.size": size for name, size in own.items()} or {"effects.ripple.size": common}
    assert (set(kept.paths), best.numbers) == (set(wanted), len(wanted))
    for path, size in wanted.items():
        assert abs(kept.fit.value(path) - size) < 3.0 * kept.fit.error(path)
    assert best.size.startswith(f"size of {kept.candidate.sample} " if own else "size 0.0")
    assert ("(size of " in best.size) == bool(own)


def test_what_only_monte_carlo_shows_is_fitted_about_what_each_sample_has() -> None:
    """Opposite ripples: each within errors about its own value; for its slope no image of another sample is asked."""
    sizes, asked = {"array": 0.05, "third": -0.04}, list[tuple[str, ...]]()

    class Asked(rippled.Anchors):
        def images(self, model: Model, views: Sequence[View], *more: Any, **by: Any) -> list[Predicted]:
            asked.append(tuple(view.sample.id for view in views))
            return super().images(model, views, *more, **by)

    base = rippled.base_fit(**sizes)
    of_all = replace(rippled.score_of(base).candidate, effect=TILTED.model_copy(update={"twin": False}))
    sight: Any = SimpleNamespace(views=[SimpleNamespace(sample=image.sample) for image in base.problem.images])
    one, other = (each for each in _apart(of_all, sight, Projection.of(base)) if each.sample in sizes)
    score = Score(replace(one, others=(other,)), 10.0, 0.05, 0.01, 1.0)
    found = finished(freed(base, score, slopes_of(base)), Asked(), None)
    assert found.fit is not None
    assert found.paths == tuple(f"samples.{sample}.ripple.size" for sample in sizes)
    for path, size in zip(found.paths, sizes.values(), strict=True):
        assert abs(found.fit.value(path) - size) < 3.0 * found.fit.error(path)
    assert {one for one in asked if len(one) == 1} == {("array",), ("third",)}
    anchor = found.fit.problem.anchor
    assert anchor is not None
    assert set(anchor.model.samples) == set(sizes)


def test_numbers_of_samples_whose_names_have_dots_are_counted() -> None:
    """Of "array-2.5" as of any other, and lengths that all have in common; not those of another effect."""
    one, other = (
        Candidate(TILTED, TILTED.parameters[0], (), np.zeros((1, 1)), sample=name) for name in ("a-2.5", "b")
    )
    paths = ("samples.a-2.5.ripple.size", "samples.b.ripple.size", "effects.ripple.length_um", "effects.fog.size")
    known: Any = SimpleNamespace(problem=SimpleNamespace(unknowns=SimpleNamespace(model_paths=paths)))
    found = Refitted(replace(one, others=(other,)), 0.1, 0.01, np.zeros(1), 1.0, False, None, known)
    assert (found.paths, found.numbers) == (paths[:2], 3)


def test_chips_share_a_spread_and_each_has_its_own_gain() -> None:
    """Three gains in each of two modules: all within errors, their spread is the prior; single chips have none."""
    truth = hidden("chips", {"gain": ()}, **{name: {"gain": gains} for name, gains in GAINS.items()})
    base, found = added(truth, CHIPS)
    known = members(found.model)
    pulls = [
        (value - truth.samples[one.sample]["chips"]["gain"][one.chip]) / found.error(path)  # type: ignore[index]  # lists
        for path, (one, value) in known.items()
        if (one.chip or 0) < 3
    ]
    assert len(pulls) == 6
    assert np.sqrt(np.mean(np.square(pulls))) < 2.0
    limits = found.model.fit["effects.chips.gain"]
    assert limits.prior_sd is not None
    assert 0.02 < limits.prior_sd < 0.1  # 0.063 over the chips that act, less over all of a module
    assert found.chi2_per_row < 1.1 < base.chi2_per_row
    assert free_paths(found.model) == PATHS


def test_the_spread_of_members_counts_what_is_not_known_of_each() -> None:
    """A gain of 0.03 known exactly and one of 0 +- 0.04: the mean square is half of 0.05^2, about off and not 0."""
    columns: Any = tuple(
        SimpleNamespace(sample="array", effect="chips", parameter="gain", chip=chip) for chip in (0, 1)
    )
    own = {"array": Own({}, columns, np.zeros(2), 0.0)}
    for off in (0.0, 1.0):
        gain = CHIPS.parameters[0].model_copy(update={"off": off, "upper": 2.0})
        paths = [member.path for member, _ in _members(own)]
        values = dict(zip(paths, ((off + 0.03, 0.0), (off, 0.04)), strict=True))
        limits = {"effects.chips.gain": Limits(free=True, lower=-0.5, upper=2.0, prior_mean=off, prior_sd=0.2)}
        found: Any = SimpleNamespace(
            value=lambda path, of=values: of[path][0], error=lambda path, of=values: of[path][1],
            model=SimpleNamespace(fit=limits),
        )  # fmt: skip
        renewed = _renewed(found, CHIPS.model_copy(update={"parameters": (gain,)}), own)
        assert renewed["effects.chips.gain"].prior_sd == pytest.approx(0.05 / np.sqrt(2.0), rel=1e-12)


def test_a_model_with_values_by_sample_is_fitted_again_with_them_free() -> None:
    """From the file, with its values held at first: the same end as when the effect was added."""
    truth = hidden("chips", {"gain": ()}, **{name: {"gain": gains} for name, gains in GAINS.items()})
    _, found = added(truth, CHIPS)
    model = parse_toml(to_toml(found.model), "")
    shaken = with_members(model, {path: 0.5 * value for path, (_, value) in members(model).items()})
    held = fit(shaken, made_up.images_of(truth, 3), made_up.Affected(), free=PATHS)
    again = with_members_free(held, [CHIPS], columns_at)
    assert held.chi2 > found.chi2 + 10.0
    for path in free_members(model):
        assert abs(again.value(path) - found.value(path)) < 0.2 * found.error(path)


def test_values_by_sample_stray_from_their_anchor_as_others_do() -> None:
    """Where the anchor's model has them, too: the images there were other ones."""
    truth = hidden("chips", {"gain": ()}, **{name: {"gain": gains} for name, gains in GAINS.items()})
    _, found = added(truth, CHIPS)
    off = with_members(found.model, dict.fromkeys(members(found.model), 0.0))
    strayed = {}
    for model in (found.model, off, without_samples(off, "chips")):
        about = replace(found.problem, anchor=Anchored(model, 1000))
        strayed[model.sha256] = has_strayed(replace(found, problem=about))
    assert list(strayed.values()) == [False, True, False]


def test_what_only_left_out_data_know_is_fitted_there() -> None:
    """By samples a module's own gains are its images' business; by blocks they come from the other half."""
    truth = hidden("chips", {"gain": ()}, **{name: {"gain": gains} for name, gains in GAINS.items()})
    base, found = added(truth, CHIPS)
    for folds in (folds_by_sample, folds_by_blocks):
        before, after = (held_out(one, folds(one)) for one in (base, found))
        assert after.rms_percent < 1.05 * made_up.noise_percent(found) < before.rms_percent


def test_an_effect_that_shows_nowhere_is_refused() -> None:
    """With what it would have to do, and what it does."""
    with pytest.raises(InputError, match="lowers chi2 of a sample by 10"):
        added(MODEL, TILTED)


def test_which_effects_samples_have_their_own_of() -> None:
    """Those that say so, and lists per chip."""
    assert is_by_sample(TILTED)
    assert is_by_sample(CHIPS.model_copy(update={"scope": "global"}))
    assert not is_by_sample(made_up.spec("ripple"))


@pytest.mark.parametrize(
    ("samples", "words"),
    [({"gone": {"chips": {"gain": (0.1,)}}}, "a sample of the data: array"),
     ({"array": {"other": {"gain": (0.1,)}}}, "an effect of the model: chips")],
)  # fmt: skip
def test_values_of_strangers_are_refused(samples: Any, words: str) -> None:
    """Of a sample that is not in the data, of an effect that is not in the model."""
    model = hidden("chips", {"gain": ()}).model_copy(update={"samples": samples})
    with pytest.raises(InputError, match=words):
        refuse_strangers(model, ["array"])


def test_a_sample_without_values_has_the_effect_as_it_is_under_effects() -> None:
    """And a model whose samples' values were taken away has them nowhere."""
    model = hidden("chips", {"gain": ()}, array={"gain": (0.1, 0.2)})
    assert of_sample(model, "array").effects[0].parameters == {"gain": (0.1, 0.2)}
    assert of_sample(model, "third").effects[0].parameters == {"gain": ()}
    assert without_samples(model, "chips").samples == {}
    assert model.sha256 != without_samples(model, "chips").sha256
