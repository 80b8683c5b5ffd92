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
    HALO,
    MODEL,
    PATHS,
    REACH,
    SIGMA,
    SINGLE,
    TRUTH,
    Spots,
    blank,
    measured,
    two_images,
)
from validation.dataset.manifest import FilmLayer, FilmSample, SpectrumShot
from validation.dataset.spectra import SpectrumTable
from validation.fit import (
    NOT_CONVERGED,
    CurveData,
    CurvesOf,
    Discrepancy,
    Parameter,
    curves_of,
    film_parameters,
    fit,
    profile,
    refitted,
    unknowns_of,
)
from validation.fit.anchored_fit import refuse_dark
from validation.fit.descent import PROMISED
from validation.fit.problem import Problem, wrapped_deg
from validation.fit.start import coarse_shift_px, start_values
from validation.measured import MeasuredSpectrum
from validation.prediction import Anchored, Pose, PredictedCurve


@pytest.fixture(scope="module")
def found():
    """One fit that several tests look at."""
    return fit(MODEL, two_images(), Spots())


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
    result = fit(MODEL, two_images(), predictor)
    assert predictor.asked <= result.iterations + 5


def test_a_fit_ends_where_what_is_asked_is_out_of_reach(found):
    """What chi2 cannot reach is given up before the optimum; what it can is fitted to the same end."""
    problem = replace(found.problem, predictor=Spots())
    start = start_values(problem, {"single-a.shift_row_px": 3.0, "single-a.shift_column_px": -4.0})
    whole = refitted(problem, start)
    assert whole.chi2 == pytest.approx(found.chi2, abs=0.5)
    reached = refitted(problem, start, below=whole.chi2 + 10.0)
    assert (reached.values == whole.values).all()
    given_up = refitted(problem, start, below=0.5 * whole.chi2)
    assert given_up.iterations < whole.iterations
    assert given_up.chi2 - PROMISED * given_up.gap > 0.5 * whole.chi2
    assert not given_up.converged
    assert not given_up.trusted
    assert given_up.distrust[0].startswith(f"{NOT_CONVERGED}: {given_up.gap:.3g} of chi2 is still to be gained")


def test_nuisances_only():
    """With nothing free the model stays as it is, gains and poses are fitted; on the true model chi2 is noise."""
    result = fit(TRUTH, two_images(), Spots(), free=())
    assert result.model == TRUTH
    assert result.names[0] == "single-a.gain"
    assert result.chi2_per_row == pytest.approx(1.0, abs=0.15)
    wrong = fit(MODEL, two_images(), Spots(), free=())
    assert wrong.chi2 > 3.0 * result.chi2


def test_a_limit_is_reported_and_not_trusted():
    """A truth beyond the limits: the parameter stops there, has no error, and the fit says why it is not trusted."""
    model = MODEL.model_copy(update={"fit": MODEL.fit | {SIGMA: Fit(free=True, lower=1.0, upper=5.5)}})
    result = fit(model, two_images(), Spots())
    assert SIGMA in result.at_limit
    assert SIGMA in result.driven
    assert result.value(SIGMA) == 5.5
    assert result.error(SIGMA) == 0.0
    assert not result.trusted
    assert "at its limit (1 to 5.5)" in result.distrust[0]


def test_a_strong_prior_wins():
    """A prior far narrower than the data's error holds a parameter; a wide one leaves it."""
    narrow = Fit(free=True, lower=1.0, upper=15.0, prior_mean=5.5, prior_sd=1e-6)
    result = fit(MODEL.model_copy(update={"fit": MODEL.fit | {SIGMA: narrow}}), two_images(), Spots())
    assert result.value(SIGMA) == pytest.approx(5.5, abs=1e-5)
    assert result.error(SIGMA) == pytest.approx(1e-6, rel=0.01)


def test_gain_follows_the_exposure():
    """With gain_mode = exposure one gain per ms serves all images, each within about 1 %."""
    images = []
    for image, exposure in zip(two_images(), (8.0, 16.0), strict=True):
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
    result = fit(model, two_images(7), Spots())
    if not result.at_limit:
        assert profile(result, HALO).values.max() <= 0.7001


def test_an_anchor_takes_the_twins_error_away():
    """A twin that is off moves the halo; the anchor brings it back, seen from the poses that were fitted."""
    asked = []

    def anchor_at(model):
        asked.append(model)
        return Anchored(model, 1000)

    exact = fit(MODEL, two_images(), Spots())
    off = fit(MODEL, two_images(), Spots(error=0.1))
    right = fit(MODEL, two_images(), Spots(error=0.1), anchor_at=anchor_at)
    assert off.value(HALO) == pytest.approx(exact.value(HALO) - 0.1, abs=0.03)
    assert right.value(HALO) == pytest.approx(exact.value(HALO), abs=1e-3)
    assert asked[0].leaves()[HALO] == pytest.approx(off.value(HALO))
    assert 1 <= len(asked) <= 3
    assert right.problem.anchor.poses[0].shift_px[1] == pytest.approx(-1.7, abs=0.1)


def test_a_discrepancy_column_is_fitted_within_its_prior():
    """A known error of the model is taken up by its own coefficient and leaves the parameters alone."""
    images = two_images(poses=[Pose(), Pose()])
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
        for image in two_images()
    ]
    low = images[0].camera.model_copy(update={"full_well_e": float(images[0].signal_dn.max()) / 0.97})
    images = [replace(image, camera=low) for image in images]
    result = fit(MODEL, images, Spots())
    assert 0 < (~result.problem.images[0].used).sum() < 30
    brighter = low.model_copy(update={"full_well_e": 0.9 * low.full_well_e})
    beside = replace(result.problem, images=tuple(replace(one, camera=brighter) for one in result.problem.images))
    again = refitted(beside, result.values)  # an effect may bring more pixels near the limit: chi2 is of the same
    assert len(again.residual) == len(result.residual)


def test_a_number_of_an_effect_starts_where_the_model_has_it():
    """Whatever it is called: gains and scales of shots start at 1."""
    mine = AppliedEffect(name="mine", parameters={"gain": 0.1})
    limits = {"effects.mine.gain": Fit(free=True, lower=0.0, upper=0.3)}
    model = MODEL.model_copy(update={"effects": (mine,), "fit": limits})
    images = two_images()
    unknowns = unknowns_of(model, ["effects.mine.gain"], images)
    values = start_values(Problem(model, unknowns, tuple(images), Spots()), {})
    assert unknowns.named(values)["effects.mine.gain"] == 0.1


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
    images = two_images()
    images = {"no shots": [], "an id twice": images + images}.get(change, images)
    free = ["environment.n_gan"] if change == "a path without limits" else None
    with pytest.raises(InputError) as error:
        fit(MODEL, images, Spots(), free=free)
    assert error.value.field == names


def test_what_the_twin_cannot_represent_is_never_fitted_by_the_twin():
    """With nothing free the anchor serves from the start; by the twin alone the workers are asked without an anchor.

    That question is the one that they refuse where an effect is beyond the twin.
    """
    walled = MODEL.model_copy(update={"effects": (AppliedEffect(name="walls", parameters={"reflectance": 0.3}),)})
    about = Spots()
    fit(walled, two_images(1), about, free=(), anchor_at=lambda model: Anchored(model, 1000))
    assert all(anchor is not None and anchor.histories == 1000 for anchor in about.anchors)
    alone = Spots()
    fit(walled, two_images(1), alone)
    assert alone.anchors[0] is None


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
    images = [replace(one, signal_dn=20.0 * np.add.outer(rim, rim)) for one in two_images()]
    found = fit(walled, images, Sensed())
    assert not found.trusted
    assert len(Sensed.gains) > 10
    assert min(Sensed.gains) > 0.0


def test_without_derivatives_the_residual_is_the_same():
    """And no derivative is asked for: those by what changes the light in a chip are walks."""

    class Asked(Spots):
        paths = ()

        def images(self, model, views, paths=(), anchor=None):
            self.paths = tuple(paths)
            return super().images(model, views, paths, anchor)

    predictor = Asked()
    found = fit(MODEL, two_images(), predictor, free=PATHS)
    problem, white = found.problem, found.whitening
    with_them = problem.evaluate(found.values).residual(white)
    assert set(PATHS) < set(predictor.paths)
    without = problem.evaluate(found.values, derivatives=False).residual(white)
    assert predictor.paths == ()
    np.testing.assert_array_equal(without, with_them)


@pytest.mark.parametrize("shape", [(24, 24), (25, 25), (24, 31), (9, 40)])
def test_the_start_is_at_the_pixel_that_the_image_is_at(shape):
    """By as many whole pixels as the image was moved, in sides of even and odd numbers alike."""
    rows, columns = np.indices(shape)

    def spot(row, column):
        distance = np.hypot(rows - (shape[0] - 1) / 2.0 - row, columns - (shape[1] - 1) / 2.0 - column)
        return np.exp(-0.5 * (distance / 1.5) ** 2)

    for row, column in ((0, 0), (1, -2), (-2, 3), (2, 0)):
        image = SimpleNamespace(signal_dn=50.0 + 900.0 * spot(row, column), used=np.ones(shape, bool))
        assert coarse_shift_px(image, spot(0, 0)) == (row, column)


def test_an_image_of_no_light_agrees_with_nothing():
    """A dark frame is noise about a level, as far from this model as from any other: the file is named."""
    one, other = two_images()
    dark = replace(one, signal_dn=20.0 + 6.0 * np.random.default_rng(4).standard_normal(one.signal_dn.shape))
    result = fit(TRUTH, [dark, other], Spots(), free=())
    assert not result.trusted
    assert "single-a.tif shows hardly any light of its sample" in result.distrust[0]
    assert fit(TRUTH, [one, other], Spots(), free=()).trusted


def test_an_image_that_is_best_fitted_by_no_light_is_refused(found):
    """Nothing can be said of it in percent, or of anything else; an inverted one was a division by zero."""
    gone = np.where([name == "single-a.gain" for name in found.names], 0.0, found.values)
    with pytest.raises(InputError, match=r"single-a\.tif: gain: got 0\.0, allowed: above 0; it does not look like"):
        refuse_dark(replace(found, values=gone))
    refuse_dark(found)
