"""Fits about an anchor of Monte Carlo: its noise in errors and chi2, steps by columns of two walks, histories."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.validation.analytic import (
    ARRAY,
    HALO,
    MODEL,
    POSES,
    REACH,
    SIGMA,
    SINGLE,
    TRUTH,
    Spots,
    spots,
    two_images,
)
from validation.comparing import Solver
from validation.contrasts import structure
from validation.diagnose.ground import Ground
from validation.diagnosing import Diagnosing
from validation.fit import (
    NOT_CONVERGED,
    Parameter,
    anchored_fit,
    descent,
    fit,
    profile,
)
from validation.fit.descent import crossed
from validation.fit.least_squares import Step, reduce
from validation.fit.model_noise import noise_shares
from validation.fit.parameters import Unknowns
from validation.fit.problem import Evaluation
from validation.fit.result import MOST_MODEL_NOISE, WANTED_NOISE
from validation.noise import histories_for
from validation.observed import Observed
from validation.prediction import POSE_COLUMNS, Anchored, Pose, Predicted, View


def test_noise_of_the_monte_carlo_widens_the_errors():
    """What histories left is in the whitening, so in the covariance, and no parameter is spent on it."""
    views = {sample.id: View(sample, 24, 24, 25.0, (11.5, 11.5)) for sample in (SINGLE, ARRAY)}
    noise = {name: 0.2 * spots(TRUTH, view)[1][SIGMA][None] for name, view in views.items()}  # as if sigma varied
    images = two_images(poses=[Pose(), Pose()])
    plain = fit(MODEL, images, Spots(), anchor_at=lambda model: Anchored(model, 1000))
    noisy = fit(MODEL, images, Spots(noise), anchor_at=lambda model: Anchored(model, 1000))
    assert noisy.error(SIGMA) == pytest.approx(np.hypot(plain.error(SIGMA), 0.2 / np.sqrt(2.0)), rel=0.1)
    assert noisy.names == plain.names
    assert plain.noise_share == 0.0 < noisy.noise_share


def _waves(sample, share):
    """Functions of noise (function, row, column) in an image of a sample: waves under the root of the light."""
    light = spots(TRUTH, View(sample, 24, 24, 25.0, (11.5, 11.5)))[0]
    x = np.cos(np.pi * np.outer(np.arange(9), np.arange(24) + 0.5) / 24.0)
    return share * np.sqrt(light * light.mean()) * np.einsum("my,nx->mnyx", x, x).reshape(-1, 24, 24)


@pytest.fixture(scope="module")
def about_noise():
    """Sixteen fits about anchors whose noise is 1.5 times the camera's; and by least squares against the same."""
    noise = {one.id: _waves(one, 0.004) for one in (SINGLE, ARRAY)}
    fits, naive = [], []
    for seed in range(16):
        random = np.random.default_rng(seed)
        drawn = {name: np.tensordot(random.standard_normal(len(one)), one, axes=1) for name, one in noise.items()}
        for found, told in ((fits, Spots(noise, 0.02, drawn)), (naive, _Untold(noise, 0.02, drawn))):
            found.append(fit(MODEL, two_images(100 + seed), told, anchor_at=lambda model: Anchored(model, 1000)))
    return fits, naive


class _Untold(Spots):
    """Says nothing of its noise, nor what the twin sees: all that least squares can do is to take it for exact."""

    def images(self, *asked):
        """The images."""
        return [replace(one, noise_per_mm2=None, twin_per_mm2=None) for one in super().images(*asked)]


def _pulls(fits, name, truth):
    return np.array([(one.value(name) - truth) / one.error(name) for one in fits])


def test_a_fit_about_a_noisy_anchor_is_not_biased(about_noise):
    """Columns without the noise: the gain comes out right on average, where least squares finds it too small."""
    fits, naive = about_noise
    assert fits[0].noise_share == pytest.approx(1.5, abs=0.5)
    assert all(one.converged for one in fits)
    for name, truth in (("array-a.gain", 300.0), (HALO, 0.7), (SIGMA, 6.0), (REACH, 0.5)):
        assert abs(_pulls(fits, name, truth).mean()) < 3.0 / np.sqrt(len(fits)), name
    assert _pulls(naive, "array-a.gain", 300.0).mean() < -3.0


def _fits_that_lack_something(noise):
    """Of images with a texture that the model lacks, about anchors with noise."""
    for seed in range(1, 6):
        random = np.random.default_rng(seed)
        drawn = {name: np.tensordot(random.standard_normal(len(one)), one, axes=1) for name, one in noise.items()}
        rows, columns = np.indices((24, 24))
        texture = 1.0 + 0.05 * np.cos(columns / 3.0) * np.cos(rows / 4.0)
        images = [replace(one, signal_dn=one.signal_dn * texture) for one in two_images(100 + seed)]
        yield fit(MODEL, images, Spots(noise, 0.02, drawn), anchor_at=lambda model: Anchored(model, 1000))


def test_steps_that_go_too_far_and_back_come_to_an_end(monkeypatch):
    """Each makes another whitening, by which the way back looks as good; taken whole, they go round for ever."""
    noise = {one.id: _waves(one, 0.06) for one in (SINGLE, ARRAY)}
    found = list(_fits_that_lack_something(noise))
    assert all(one.converged for one in found)
    monkeypatch.setattr(descent.Pace, "share_of", lambda *_: 1.0)
    whole = list(_fits_that_lack_something(noise))
    assert not all(one.converged for one in whole)
    assert sum(one.iterations for one in found) < sum(one.iterations for one in whole)


@pytest.mark.parametrize("ratio", [-0.6, -1.0, -1.6])
def test_the_pace_ends_what_goes_back_and_forth(ratio):
    """Whole steps would be `ratio` times the one before, along one of three directions."""
    slope, at, pace = np.array([1.0 - ratio, 1.0, 0.9]), np.array([1.0, 0.3, -2.0]), descent.Pace()
    for _ in range(12):
        at = at - pace.share_of(-slope * at) * slope * at
    assert np.abs(at).max() < 1e-3


def test_the_pace_takes_steps_that_go_on_whole():
    """A long way in one direction is not slowed down."""
    pace = descent.Pace()
    assert [pace.share_of(np.array([0.9**k, 0.1])) for k in range(5)] == [1.0] * 5


class _Turned(Spots):
    """How a single chip's image changes with its turn is mostly noise: the twin's, and another of the anchor's."""

    by_pose = True

    def images(self, model, views, paths=(), anchor=None):
        """The images."""
        found = []
        for view, one in zip(views, super().images(model, views, paths, anchor), strict=True):
            own = {path: column for path, column in one.jacobian_per_mm2.items() if path in POSE_COLUMNS}
            light = spots(TRUTH, view)[0] if view.sample == SINGLE else 0.0 * one.irradiance_per_mm2
            turns = [
                column + 0.02 * np.sqrt(light) * np.random.default_rng(seed).standard_normal(light.shape)
                for seed in (1, 2)
                for column in [own.get("rotation_deg", 0.0)]
            ]
            jacobian = one.jacobian_per_mm2 | ({"rotation_deg": turns[0]} if own else {})
            by_pose = own | {"rotation_deg": turns[1]} if own and anchor and anchor.histories else {}
            found.append(replace(one, jacobian_per_mm2=jacobian, by_pose_per_mm2=by_pose if self.by_pose else {}))
        return found


def test_a_turn_that_hardly_shows_has_the_error_that_it_has_and_is_found_in_fewer_steps(monkeypatch):
    """By one column for both, steps went a part of the way only, and the noise in it was taken for knowledge."""
    noise, turn = {one.id: _waves(one, 0.01) for one in (SINGLE, ARRAY)}, "single-a.rotation_deg"

    def pulls_and_steps():
        found = [fit(MODEL, two_images(k), _Turned(noise), anchor_at=lambda at: Anchored(at, 1000)) for k in range(8)]
        assert all(one.converged for one in found)
        pulls = [(one.value(turn) - POSES[0].rotation_deg) / one.error(turn) for one in found]
        return np.sqrt(np.mean(np.square(pulls))), sum(one.iterations for one in found)

    pull, steps = pulls_and_steps()
    monkeypatch.setattr(_Turned, "by_pose", False)
    before, more = pulls_and_steps()
    assert 0.5 < pull < 1.5 < 3.0 < before
    assert steps < more


class _Misled(Spots):
    """Its derivatives say nothing of how the images change: they are noise, another one for each walk."""

    def images(self, model, views, paths=(), anchor=None):
        """The images."""
        lost = np.random.default_rng(1 if anchor is None else anchor.exit_seed)
        return [
            replace(
                one,
                jacobian_per_mm2={
                    path: lost.standard_normal(column.shape) if path.startswith("environment") else column
                    for path, column in one.jacobian_per_mm2.items()
                },
            )
            for one in super().images(model, views, paths, anchor)
        ]


def test_a_fit_that_is_lost_about_a_noisy_anchor_says_so():
    """Derivatives that mislead lead nowhere: no gain becomes zero, and nothing is called converged."""
    noise = {one.id: _waves(one, 0.004) for one in (SINGLE, ARRAY)}
    found = fit(MODEL, two_images(), _Misled(noise), anchor_at=lambda model: Anchored(model, 1000))
    assert min(found.gains.values()) > 100.0
    assert not found.converged
    assert any(reason.startswith(NOT_CONVERGED) for reason in found.distrust)


@pytest.mark.parametrize(("towards", "held"), [(-1.0, False), (1.0, True)])
def test_what_began_at_a_limit_leaves_it_where_the_step_of_two_walks_leads_inside(towards: float, held: bool) -> None:
    """Least squares of the one walk's columns would go the other way; a step beyond the limit is none."""
    columns, other = np.array([[1.0, 0.0], [0.6, 0.8]]), np.array([[1.0, 0.0], [-0.6, 0.8]])
    parameters, values = (Parameter("a", upper=2.0), Parameter("b")), np.array([2.0, 0.0])
    residual = np.array([0.0, towards])
    unknowns = Unknowns(parameters, (), ())
    at = SimpleNamespace(values=values, residual=lambda _: residual, problem=SimpleNamespace(unknowns=unknowns))
    reduced = reduce(columns, residual, parameters, values)
    assert np.sign(reduced.step(bounded=False).change[0]) == -towards
    step = crossed(at, None, reduced, columns, other)
    assert list(step.at_limit) == [held, False]
    assert step.change[0] == pytest.approx(0.0 if held else -0.75)


@pytest.mark.parametrize(("bend", "near"), [(0.0, True), (1.0, False)])
def test_what_chi2_does_at_a_step_is_looked_up_where_it_ends(monkeypatch, bend, near):
    """The first walk's noise promises a rise of 400; there is none, unless the images bend away from the columns."""
    true = np.array([[10.0, 0.0, 0.0, 0.0, 0.0], [10.0, 0.4, 0.0, 0.0, 0.0]])
    noise = np.array([[0.0, 0.0, 5.0, 0.0, 0.0], [0.0, 0.0, 0.0, 5.0, 0.0]])
    columns, other = (true + np.outer([0.0, 1.0], one) for one in noise)
    solution, parameters = np.array([-4.0, 4.0]), (Parameter("a"), Parameter("b"))
    problem = SimpleNamespace(unknowns=Unknowns(parameters, (), ()))

    def evaluate(values):
        bent = np.append(np.zeros(4), bend * values @ values)
        return SimpleNamespace(
            values=values, problem=problem, whitening=lambda: None, others=list, columns=lambda _: columns,
            residual=lambda _: (solution - values) @ true + bent, other_columns=lambda *_: other,
        )  # fmt: skip

    problem.evaluate = evaluate
    monkeypatch.setattr(descent, "is_dark", lambda *_: False)
    monkeypatch.setattr(descent, "conclude", lambda evaluation, *told: (evaluation.values, told[5]))
    values, settled = descent._settled(evaluate(np.zeros(2)), 0)
    assert settled == near
    np.testing.assert_allclose(values, solution if near else 0.0, atol=1e-9)


def test_errors_and_chi2_hold_about_a_noisy_anchor(about_noise):
    """With the noise in the whitening chi2 is that of noise and intervals hold the truth; left out, neither does."""
    fits, naive = about_noise
    assert np.mean([one.chi2_per_row for one in fits]) == pytest.approx(1.0, abs=0.03)
    assert np.mean([one.chi2_per_row for one in naive]) > 1.5
    pulls = [_pulls(fits, name, truth) for name, truth in ((HALO, 0.7), (SIGMA, 6.0), (REACH, 0.5))]
    assert np.mean(np.abs(pulls) < 1.96) > 0.85
    assert 0.6 < np.std(pulls) < 1.4


def test_the_last_anchor_takes_as_many_histories_as_its_noise_asks_for():
    """Of each sample by itself, up to the bound; without one it stays as it is."""
    noise = {SINGLE.id: _waves(SINGLE, 0.002), ARRAY.id: _waves(ARRAY, 0.004)}
    for most, histories in ((0, (1000, 1000)), (1200, (1200, 1200)), (10**9, None)):
        predictor = Spots(noise)
        found = fit(
            MODEL, two_images(), predictor, anchor_at=lambda model: Anchored(model, 1000), most_histories=most
        )
        shares = noise_shares(found.whitening)
        assert found.noise_share == pytest.approx(np.hypot(*shares) / np.sqrt(2.0), rel=0.05)
        wanted = histories or tuple(histories_for(WANTED_NOISE, 1000, share) for share in shares)
        asked = [anchor for anchor in predictor.anchors if anchor is not None and anchor.histories][-1]
        assert found.problem.anchor == asked
        assert (asked.histories_of(SINGLE.id), asked.histories_of(ARRAY.id)) == wanted
        assert asked.histories == max(wanted)
        assert replace(asked, histories=500).histories_of(SINGLE.id) == 500
    assert wanted[0] < wanted[1]
    assert histories_for(0.5, 1000, 1.0) == 4000


@pytest.mark.parametrize(
    ("move", "most", "histories"),
    [
        (1.0, 0, [250, 1000, 1000]),
        (1.0, 1200, [250, 1000, 1200]),
        (9.0, 1200, [250, 1000, 1000, 1200]),
        (0.1, 0, [250, 1000]),
    ],
)
def test_the_last_anchor_is_one_of_three_where_the_fit_is_near(monkeypatch, move, most, histories):
    """A fit that goes on moving has three anchors, the first of few histories, where the twin has led; two lead to
    one of more histories, if it is near by then."""
    monkeypatch.setattr(anchored_fit, "moved", lambda *_: move)
    predictor = Spots({SINGLE.id: _waves(SINGLE, 0.002), ARRAY.id: _waves(ARRAY, 0.004)})
    fit(MODEL, two_images(), predictor, anchor_at=lambda model: Anchored(model, 1000), most_histories=most)
    made = dict.fromkeys((one.histories, one.model.sha256) for one in predictor.anchors if one and one.histories)
    assert [number for number, _ in made] == histories


def test_an_anchor_that_has_enough_is_not_made_anew():
    """Each sample is counted by its own histories, and a few more are not worth a run."""
    noise = {SINGLE.id: _waves(SINGLE, 0.00013), ARRAY.id: _waves(ARRAY, 0.00028)}
    there, predictor = Anchored(MODEL, 24_000, enough=((SINGLE.id, 1000),)), Spots(noise)
    found = fit(MODEL, two_images(), predictor, anchor_at=lambda _: there, most_histories=10**6)
    assert all(share < 1.09 * WANTED_NOISE for share in noise_shares(found.whitening))
    assert {(one.histories, one.enough) for one in predictor.anchors if one is not None and one.histories} == {
        (there.histories, there.enough)
    }
    noisier = Spots({**noise, SINGLE.id: _waves(SINGLE, 0.00066)})
    found = fit(MODEL, two_images(), noisier, anchor_at=lambda _: there, most_histories=10**6)
    single = noise_shares(found.whitening)[0]
    asked = found.problem.anchor
    assert asked.histories_of(SINGLE.id) == histories_for(WANTED_NOISE, 1000, single) < asked.histories_of(ARRAY.id)
    assert asked.histories_of(ARRAY.id) == pytest.approx(24_000, rel=0.2)


def test_a_profile_about_a_noisy_anchor_is_lowest_at_the_fit(about_noise):
    """Chi2 itself is least elsewhere; summed up from its slope the valley ends where the fit does."""
    for one in about_noise[0][:4]:
        along = profile(one, HALO)
        assert along.chi2_above.min() == 0.0
        np.testing.assert_allclose(along.chi2_above[[2, 4]], 1.0, atol=0.25)


def test_histories_are_rounded_up():
    """To two digits: four times as many for half the noise."""
    assert histories_for(0.3, 4_000_000, 1.7) == 130_000_000


def test_an_anchor_that_is_left_far_behind_is_doubted():
    """The twin's error is carried over from the anchor: where that is far and the error large, a test may not say."""
    near = fit(MODEL, two_images(), Spots(error=0.1), anchor_at=lambda model: Anchored(model, 1000))
    assert structure(near, draws=300).doubts == ()
    there = TRUTH.with_value(SIGMA, 2.0)
    far = fit(MODEL, two_images(), Spots(error=0.5), anchor_at=lambda _: Anchored(there, 1000))
    (doubt,) = structure(far, draws=300).doubts
    assert "far from its anchor" in doubt
    assert not far.doubted([doubt]).trusted
    assert Ground.of(near, 300, 1).fit.distrust == ()
    assert Ground.of(far, 300, 1).fit.distrust == (doubt,)  # what compare doubts names no effect in diagnose
    engine = Diagnosing(MODEL, Observed(tuple(two_images()), (), (), {}), Spots(error=0.5), None, Solver(1000), ())
    renewed = engine.ground(far).fit  # about Monte Carlo where it ended
    assert renewed.distrust == ()
    assert renewed.problem.anchor.model == far.model


@pytest.mark.parametrize("prnu", [0.0, 0.05])
def test_the_noise_of_monte_carlo_is_told_as_it_is(prnu):
    """Beside that of camera and pattern, whether the pattern ties the images or not."""
    noise = {SINGLE.id: _waves(SINGLE, 0.002), ARRAY.id: _waves(ARRAY, 0.001)}
    images = [replace(one, prnu=prnu) for one in two_images()]
    found = fit(MODEL, images, Spots(noise), anchor_at=lambda model: Anchored(model, 1000))
    for number, image in enumerate(images):
        functions = found.gains[image.shot.id] * noise[image.sample.id]
        signal = found.signals_dn[number]
        expected = image.variance_dn2(signal) + (prnu * signal) ** 2 + np.sum(functions**2, axis=0)
        np.testing.assert_allclose(found.variance_dn2(number)[image.used], expected[image.used], rtol=1e-9)
        np.testing.assert_allclose(found.model_noise_dn(number), functions * image.used, rtol=1e-9)


def test_a_fit_that_monte_carlo_noise_dominates_is_not_trusted():
    """It says by how much, and how many histories would do; little noise is not spoken of."""
    for share, words in ((0.001, False), (30.0, True)):
        image = two_images()[0]
        noise = {"single": share * np.sqrt(image.variance_dn2(image.signal_dn))[None] / 700.0}
        found = fit(MODEL, two_images(), Spots(noise), anchor_at=lambda model: Anchored(model, 1000))
        needed = max(histories_for(MOST_MODEL_NOISE / 2, 1000, one) for one in noise_shares(found.whitening))
        told = f"about {needed:,} histories for each sample would do"
        assert any(told in reason for reason in found.distrust) == words
        assert found.trusted != words


def test_a_last_step_that_takes_all_light_is_not_taken(monkeypatch):
    """A refit of blind data crashed there: an effect's sensor cannot have a gain of zero."""
    image = two_images()[0]
    noise = {"single": 0.1 * np.sqrt(image.variance_dn2(image.signal_dn))[None] / 700.0}

    def to_darkness(evaluation, _white, reduced, *_):
        change = np.zeros(len(evaluation.values))
        change[evaluation.problem.unknowns.names.index("single-a.gain")] = -1e6
        return Step(change, reduced.chi2, np.zeros(len(change), bool))

    monkeypatch.setattr(descent, "crossed", to_darkness)
    monkeypatch.setattr(descent, "FAR", np.inf)
    found = fit(MODEL, two_images(), Spots(noise), anchor_at=lambda model: Anchored(model, 1000))
    assert not found.converged
    assert any(reason.startswith(NOT_CONVERGED) for reason in found.distrust)
    assert found.value("single-a.gain") == pytest.approx(300.0, rel=0.1)


@pytest.mark.parametrize(
    ("of_all_light", "expected"), [((), [[SIGMA, HALO]]), ((HALO,), [[SIGMA]]), ((SIGMA, HALO), [])]
)
def test_no_other_walk_is_asked_for_of_columns_of_all_light(of_all_light, expected):
    """They have no walk's noise: they stay as they are, and only the rest is asked for once more."""
    asked, image, other = [], np.ones((2, 2)), np.zeros((2, 2))

    def images(model, views, paths, anchor):
        asked.append(list(paths))
        return [Predicted(image, dict.fromkeys(paths, other))]

    problem = SimpleNamespace(
        anchor=Anchored(MODEL, 1000),
        unknowns=SimpleNamespace(model_paths=(SIGMA, HALO)),
        views=lambda *_: [],
        predictor=SimpleNamespace(images=images),
    )
    predicted = Predicted(image, {SIGMA: image, HALO: image}, of_all_light=frozenset(of_all_light))
    (found,) = Evaluation(problem, np.zeros(0), {}, MODEL, [predicted], []).others()
    assert asked == expected
    assert {name for name, one in found.jacobian_per_mm2.items() if one is image} == set(of_all_light)
