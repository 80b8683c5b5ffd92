"""The nonlinear fit of images and curves: truth found back, honest errors, limits, priors, anchors."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.model import Fit
from tests.validation.analytic import (
    ARRAY,
    HALO,
    MODEL,
    REACH,
    SIGMA,
    SINGLE,
    Spots,
    blank,
    measured,
    spots,
)
from validation.contrasts import structure
from validation.dataset.manifest import FilmLayer, FilmSample, SpectrumShot
from validation.dataset.spectra import SpectrumTable
from validation.fit import (
    CurveData,
    CurvesOf,
    Discrepancy,
    Parameter,
    curves_of,
    film_parameters,
    fit,
    image_fit,
    profile,
)
from validation.fit.image_fit import crossed
from validation.fit.least_squares import Step, reduce
from validation.fit.parameters import Unknowns
from validation.fit.problem import wrapped_deg
from validation.fit.result import WANTED_NOISE, histories_for
from validation.measured import MeasuredSpectrum
from validation.prediction import Anchored, Pose, PredictedCurve, View

TRUTH = MODEL.with_value(SIGMA, 6.0).with_value(HALO, 0.7).with_value(REACH, 0.5)
POSES = [Pose((0.8, -1.7), 0.0), Pose((-2.4, 0.6), 0.4)]


def _data(seed=1, prnu=0.0, truth=TRUTH, poses=POSES):
    images = [blank("single-a", SINGLE, prnu=prnu), blank("array-a", ARRAY, prnu=prnu)]
    return measured(truth, images, np.random.default_rng(seed), poses)


@pytest.fixture(scope="module")
def found():
    """One fit that several tests look at."""
    return fit(MODEL, _data(), Spots())


def test_truth_is_found_back(found):
    """Parameters, gains, offsets and poses come back within four of their errors; chi2 is that of noise."""
    wanted = {SIGMA: 6.0, HALO: 0.7, REACH: 0.5, "single-a.gain": 300.0, "array-a.gain": 300.0}
    wanted |= {"single-a.shift_row_px": 0.8, "array-a.shift_column_px": 0.6, "array-a.rotation_deg": 0.4}
    for name, value in wanted.items():
        assert found.error(name) > 0.0
        assert abs(found.value(name) - value) < 4.0 * found.error(name), name
    assert found.converged
    assert found.trusted
    assert found.gap < 0.1
    assert found.chi2_per_row == pytest.approx(1.0, abs=0.15)
    assert found.poses["array-a"].rotation_deg == found.value("array-a.rotation_deg")
    assert found.offsets_dn["single-a"] == pytest.approx(20.0, abs=4.0 * found.error("single-a.offset_dn"))


def test_optimum_is_an_optimum(found):
    """At the values found no step gains anything: the residual is orthogonal to all columns without a prior."""
    evaluation = found.problem.evaluate(found.values)
    white = found.whitening
    columns, residual = evaluation.columns(white), evaluation.residual(white)
    flat = [parameter.prior_sd == np.inf for parameter in found.problem.unknowns.parameters]
    pulls = columns[flat] @ residual / np.linalg.norm(columns[flat], axis=1)
    assert np.abs(pulls).max() < 0.01
    np.testing.assert_allclose(found.residual, residual, atol=1e-3)


def test_signals_are_those_of_the_optimum(found):
    """The expected signals belong to the values reported."""
    for signal, again in zip(found.signals_dn, found.problem.evaluate(found.values).signals_dn(), strict=True):
        np.testing.assert_allclose(signal, again, rtol=1e-4, atol=0.01)


def test_each_iteration_asks_once():
    """All images and derivatives of an iteration are one question."""
    predictor = Spots()
    result = fit(MODEL, _data(), predictor)
    assert predictor.asked <= result.iterations + 5


def test_nuisances_only():
    """With nothing free the model stays as it is, gains and poses are fitted; on the true model chi2 is noise."""
    result = fit(TRUTH, _data(), Spots(), free=())
    assert result.model == TRUTH
    assert result.names[0] == "single-a.gain"
    assert result.chi2_per_row == pytest.approx(1.0, abs=0.15)
    wrong = fit(MODEL, _data(), Spots(), free=())
    assert wrong.chi2 > 3.0 * result.chi2


def test_a_limit_is_reported_and_not_trusted():
    """A truth beyond the limits: the parameter stops there, has no error, and the fit says why it is not trusted."""
    model = MODEL.model_copy(update={"fit": MODEL.fit | {SIGMA: Fit(free=True, lower=1.0, upper=5.5)}})
    result = fit(model, _data(), Spots())
    assert SIGMA in result.at_limit
    assert result.value(SIGMA) == 5.5
    assert result.error(SIGMA) == 0.0
    assert not result.trusted
    assert "at its limit (1 to 5.5)" in result.distrust[0]


def test_a_strong_prior_wins():
    """A prior far narrower than the data's error holds a parameter; a wide one leaves it."""
    narrow = Fit(free=True, lower=1.0, upper=15.0, prior_mean=5.5, prior_sd=1e-6)
    result = fit(MODEL.model_copy(update={"fit": MODEL.fit | {SIGMA: narrow}}), _data(), Spots())
    assert result.value(SIGMA) == pytest.approx(5.5, abs=1e-5)
    assert result.error(SIGMA) == pytest.approx(1e-6, rel=0.01)


def test_gain_follows_the_exposure():
    """With gain_mode = exposure one gain per ms serves all images, each within about 1 %."""
    images = []
    for image, exposure in zip(_data(), (8.0, 16.0), strict=True):
        camera = image.camera.model_copy(update={"gain_mode": "exposure"})
        shot = image.shot.model_copy(update={"exposure_ms": exposure})
        images.append(replace(image, camera=camera, shot=shot, signal_dn=image.signal_dn * exposure / 8.0))
    result = fit(MODEL, images, Spots())
    assert result.value("gain") == pytest.approx(300.0 / 8.0, rel=0.02)
    assert result.gains["array-a"] == pytest.approx(600.0, rel=0.03)
    assert abs(result.value("array-a.gain_error")) < 0.02
    assert 0.0 < result.error("array-a.gain_error") <= 0.01


def test_profile_is_the_parabola_near_the_optimum(found):
    """Chi2 along a parameter rises by 1 at one standard error, by about 9 at three; its own centre is the optimum."""
    along = profile(found, SIGMA)
    np.testing.assert_allclose(along.chi2_above, along.parabola, rtol=0.1, atol=0.05)
    assert len(along.values) == 7
    with pytest.raises(InputError, match="parameter"):
        profile(found, "environment.n_gan")


def test_profile_stops_at_the_limits():
    """No point of a profile lies outside of the parameter's limits."""
    model = TRUTH.model_copy(update={"fit": {HALO: Fit(free=True, lower=0.0, upper=0.7001)}})
    result = fit(model, _data(7), Spots())
    if not result.at_limit:
        assert profile(result, HALO).values.max() <= 0.7001


def test_an_anchor_takes_the_twins_error_away():
    """A twin that is off moves the halo; the anchor brings it back, seen from the poses that were fitted."""
    asked = []

    def anchor_at(model):
        asked.append(model)
        return Anchored(model, 1000)

    exact = fit(MODEL, _data(), Spots())
    off = fit(MODEL, _data(), Spots(error=0.1))
    right = fit(MODEL, _data(), Spots(error=0.1), anchor_at=anchor_at)
    assert off.value(HALO) == pytest.approx(exact.value(HALO) - 0.1, abs=0.03)
    assert right.value(HALO) == pytest.approx(exact.value(HALO), abs=1e-3)
    assert asked[0].leaves()[HALO] == pytest.approx(off.value(HALO))
    assert 1 <= len(asked) <= 3
    assert right.problem.anchor.poses[0].shift_px[1] == pytest.approx(-1.7, abs=0.1)


def test_noise_of_the_monte_carlo_widens_the_errors():
    """What histories left is in the whitening, so in the covariance, and no parameter is spent on it."""
    views = {sample.id: View(sample, 24, 24, 25.0, (11.5, 11.5)) for sample in (SINGLE, ARRAY)}
    noise = {name: 0.2 * spots(TRUTH, view)[1][SIGMA][None] for name, view in views.items()}  # as if sigma varied
    images = _data(poses=[Pose(), Pose()])
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
            found.append(fit(MODEL, _data(100 + seed), told, anchor_at=lambda model: Anchored(model, 1000)))
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
    found = fit(MODEL, _data(), _Misled(noise), anchor_at=lambda model: Anchored(model, 1000))
    assert min(found.gains.values()) > 100.0
    assert not found.converged
    assert not found.trusted


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
    monkeypatch.setattr(image_fit, "_is_dark", lambda *_: False)
    monkeypatch.setattr(image_fit, "conclude", lambda evaluation, *told: (evaluation.values, told[5]))
    values, settled = image_fit._settled(evaluate(np.zeros(2)), 0)
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
    """Up to the bound; without one it stays as it is."""
    noise = {one.id: _waves(one, 0.004) for one in (SINGLE, ARRAY)}
    for most, histories in ((0, 1000), (5000, 5000), (10**9, None)):
        predictor = Spots(noise)
        found = fit(MODEL, _data(), predictor, anchor_at=lambda model: Anchored(model, 1000), most_histories=most)
        wanted = histories or histories_for(WANTED_NOISE, 1000, found.noise_share)
        asked = [anchor.histories for anchor in predictor.anchors if anchor is not None and anchor.histories]
        assert found.problem.anchor.histories == asked[-1] == wanted
    assert histories_for(0.5, 1000, 1.0) == 4000


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
    near = fit(MODEL, _data(), Spots(error=0.1), anchor_at=lambda model: Anchored(model, 1000))
    assert structure(near, draws=300).doubts == ()
    there = TRUTH.with_value(SIGMA, 2.0)
    far = fit(MODEL, _data(), Spots(error=0.5), anchor_at=lambda _: Anchored(there, 1000))
    (doubt,) = structure(far, draws=300).doubts
    assert "far from its anchor" in doubt
    assert not far.doubted([doubt]).trusted


def test_a_discrepancy_column_is_fitted_within_its_prior():
    """A known error of the model is taken up by its own coefficient and leaves the parameters alone."""
    images = _data(poses=[Pose(), Pose()])
    bumps = tuple(np.exp(-0.5 * ((np.indices((24, 24)) - 8) ** 2).sum(axis=0) / 4.0) for _ in images)
    both = zip(images, bumps, strict=True)
    hit = [replace(image, signal_dn=image.signal_dn + 300.0 * 2.0 * bump) for image, bump in both]
    result = fit(MODEL, hit, Spots(), discrepancies=[Discrepancy(bumps, sd=3.0)])
    assert result.value("discrepancy.0") == pytest.approx(2.0, abs=4.0 * result.error("discrepancy.0"))
    assert result.value(SIGMA) == pytest.approx(6.0, abs=4.0 * result.error(SIGMA))


def test_two_parameters_that_are_one_are_not_trusted():
    """A single spot without a halo: reach does nothing, and the fit says so."""
    model = TRUTH.with_value(HALO, 0.0).model_copy(update={"fit": {REACH: MODEL.fit[REACH]}})
    images = measured(model, [blank("single-a", SINGLE)], np.random.default_rng(1))
    result = fit(model, images, Spots())
    assert f"nothing measured depends on {REACH}" in result.distrust[0]
    assert np.isinf(result.error(REACH))


def test_clipped_frames_are_left_out():
    """Pixels whose mean of many frames may hide a clipped one are dropped once the prediction is known."""
    images = [
        replace(image, shot=image.shot.model_copy(update={"frames_averaged": 16}), slope_dn=image.slope_dn / 16.0)
        for image in _data()
    ]
    low = images[0].camera.model_copy(update={"full_well_e": float(images[0].signal_dn.max()) / 0.97})
    images = [replace(image, camera=low) for image in images]
    result = fit(MODEL, images, Spots())
    assert 0 < (~result.problem.images[0].used).sum() < 30


def test_curves_are_fitted_with_their_films():
    """A spectrum that depends on a film's parameter and a far field of free scale: both found, angles wrapped."""
    axis = np.linspace(0.0, 1.0, 30)
    random = np.random.default_rng(3)

    def predict(model, curves, paths, others):
        slope = others["films.f.layers.0.thickness_nm"]
        psi = PredictedCurve(slope * axis, {"films.f.layers.0.thickness_nm": axis})
        return [psi, PredictedCurve(np.cos(axis), {})]

    curves = [
        CurveData(
            "psi", wrapped_deg(200.0 * axis + 0.1 * random.standard_normal(30)), np.full(30, 0.1), is_angle=True
        ),
        CurveData(
            "goniometer", 5.0 * np.cos(axis) + 0.01 * random.standard_normal(30), np.full(30, 0.01), False, True
        ),
    ]
    film = Parameter("films.f.layers.0.thickness_nm", 100.0, 300.0)
    result = fit(
        MODEL, [], Spots(), free=(), curves=curves, predict_curves=predict, others=[film], start={film.name: 198.0}
    )
    assert result.value(film.name) == pytest.approx(200.0, abs=4.0 * result.error(film.name))
    assert result.value("goniometer.scale") == pytest.approx(5.0, abs=4.0 * result.error("goniometer.scale"))
    assert result.trusted


def test_measured_curves_reach_their_predictor():
    """A spectrum's free thickness is asked for with the film as it stands; its limits come from the manifest."""
    layer = FilmLayer(fixed=(1.5, 0.0), thickness_nm=95.0, free={"thickness_nm": (50.0, 150.0)})
    film = FilmSample(id="f", exit="Si", layers=(layer,))
    axis = np.linspace(400.0, 700.0, 40)
    like = np.ones(40)
    shot = SpectrumShot(id="r", kind="spectrum", film="f", quantity="R", file="r.csv")
    truth = np.cos(100.0 * 60.0 / axis) ** 2
    one = MeasuredSpectrum(shot, film, SpectrumTable(axis, 0.0 * like, ("u",) * 40, truth, 0.01 * like))

    class Films:
        """Answers with cos^2 of the thickness over the wavelength."""

        def spectra(self, _model, curves, paths=()):
            thickness = curves[0].film.layers[0].thickness_nm
            phase = thickness * 60.0 / axis
            return [PredictedCurve(np.cos(phase) ** 2, {path: -np.sin(2.0 * phase) * 60.0 / axis for path in paths})]

        def far_fields(self, *_):
            raise AssertionError("there is no far field")

    parameters, start = film_parameters([one])
    assert (parameters[0].lower, parameters[0].upper) == (50.0, 150.0)
    curves = curves_of([one], [])
    result = fit(
        MODEL, [], Spots(), free=(), curves=curves, predict_curves=CurvesOf(Films()), others=parameters, start=start
    )
    assert result.value("films.f.layers.0.thickness_nm") == pytest.approx(100.0, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ("no shots", "shots"),
        ("a path without limits", "fit.environment.n_gan"),
        ("an id twice", "shots.id"),
    ],
)
def test_what_cannot_be_fitted_is_refused(change, names):
    """No shots, a path without limits, one id twice: each is named."""
    images = _data()
    images = {"no shots": [], "an id twice": images + images}.get(change, images)
    free = ["environment.n_gan"] if change == "a path without limits" else None
    with pytest.raises(InputError) as error:
        fit(MODEL, images, Spots(), free=free)
    assert error.value.field == names


def test_a_fit_that_monte_carlo_noise_dominates_is_not_trusted():
    """It says by how much, and how many histories would do; little noise is not spoken of."""
    for share, words in ((0.001, False), (30.0, True)):
        image = _data()[0]
        noise = {"single": share * np.sqrt(image.variance_dn2(image.signal_dn))[None] / 700.0}
        found = fit(MODEL, _data(), Spots(noise), anchor_at=lambda model: Anchored(model, 1000))
        assert any("histories for each sample" in reason for reason in found.distrust) == words
        assert found.trusted != words


def test_what_the_twin_cannot_represent_is_never_fitted_by_the_twin():
    """With nothing free the anchor serves from the start; by the twin alone the workers are asked without an anchor.

    That question is the one that they refuse where an effect is beyond the twin.
    """
    walled = MODEL.model_copy(update={"effects": (AppliedEffect(name="walls", parameters={"reflectance": 0.3}),)})
    about = Spots()
    fit(walled, _data(1), about, free=(), anchor_at=lambda model: Anchored(model, 1000))
    assert all(anchor is not None and anchor.histories == 1000 for anchor in about.anchors)
    alone = Spots()
    fit(walled, _data(1), alone)
    assert alone.anchors[0] is None


def test_a_last_step_that_takes_all_light_is_not_taken(monkeypatch):
    """A refit of blind data crashed there: an effect's sensor cannot have a gain of zero."""
    image = _data()[0]
    noise = {"single": 0.1 * np.sqrt(image.variance_dn2(image.signal_dn))[None] / 700.0}

    def to_darkness(evaluation, _white, reduced, *_):
        change = np.zeros(len(evaluation.values))
        change[evaluation.problem.unknowns.names.index("single-a.gain")] = -1e6
        return Step(change, reduced.chi2, np.zeros(len(change), bool))

    monkeypatch.setattr(image_fit, "crossed", to_darkness)
    monkeypatch.setattr(image_fit, "FAR", np.inf)
    found = fit(MODEL, _data(), Spots(noise), anchor_at=lambda model: Anchored(model, 1000))
    assert not found.converged
    assert found.value("single-a.gain") == pytest.approx(300.0, rel=0.1)


def test_no_sensor_is_asked_for_without_a_gain():
    """An image that is bright where the model is dark pulls its gain below zero: with effects it stays above."""

    class Sensed(Spots):
        """Refuses a view whose sensor has no gain, as a worker does."""

        gains: ClassVar[list[float]] = []

        def images(self, model, views, paths=(), anchor=None):
            self.gains.extend(view.sensor.gain_dn for view in views if view.sensor is not None)
            return super().images(model, views, paths, anchor)

    walled = TRUTH.model_copy(update={"effects": (AppliedEffect(name="vignetting", parameters={}),)})
    rim = (np.arange(24) - 11.5) ** 2
    images = [replace(one, signal_dn=20.0 * np.add.outer(rim, rim)) for one in _data()]
    found = fit(walled, images, Sensed())
    assert not found.trusted
    assert len(Sensed.gains) > 10
    assert min(Sensed.gains) > 0.0
