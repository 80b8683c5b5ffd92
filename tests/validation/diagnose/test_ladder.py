"""What a rung of the ladder calls noise: what a right model leaves, whoever made it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.analytic import MODEL, PATHS, SINGLE, TRUTH, Spots, blank, measured
from tests.validation.diagnose.made_up import GAIN, data, diagnosis, ground_of, images_of, spec
from tests.validation.lines import SIGMA, Lines, fit_of_lines, noisy
from validation import told_diagnosis
from validation.adding import told_of
from validation.diagnose.held_out import folds_by_blocks, held_out
from validation.diagnose.ladder import Rung, ladder
from validation.fit import CurveData, Fit, Parameter, fit
from validation.model_versions import Version
from validation.prediction import Anchored


@pytest.mark.parametrize(("prnu", "share"), [(0.0, 0.0), (0.05, 0.0), (0.0, 1.0), (0.02, 0.5)])
def test_camera_pattern_and_monte_carlo_are_all_noise(prnu: float, share: float) -> None:
    """Rms over the mean signal, of variance 36 + S + (pattern S)^2, and as much again where Monte Carlo has it."""
    images = measured(TRUTH, [blank("one", SINGLE, 20, prnu=prnu)], np.random.default_rng(1))
    light = np.sqrt(images[0].variance_dn2(images[0].signal_dn)) / GAIN
    noise = {SINGLE.id: share * light[None]} if share else {}
    found = fit(TRUTH, images, Spots(noise), free=(), anchor_at=lambda model: Anchored(model, 1000 if share else 0))
    (signal,) = found.signals_dn
    camera = 36.0 + signal + (prnu * signal) ** 2
    wanted = 100.0 * np.sqrt(np.mean(camera + share**2 * (36.0 + signal))) / np.mean(signal)
    rung = Rung.of(ground_of(found))
    assert rung.noise_percent == pytest.approx(wanted, rel=0.02)
    assert rung.held_out_percent is None


def test_a_right_model_is_at_the_noise_of_its_rung() -> None:
    """Fitted error and noise agree where nothing is hidden; held out is a little above."""
    rung = Rung.of(ground_of(diagnosis(data(None, 9)).steps[0].ground.fit))
    assert rung.fitted_percent == pytest.approx(rung.noise_percent, rel=0.02)
    assert rung.held_out_percent is not None
    assert rung.fitted_percent < rung.held_out_percent < 1.2 * rung.noise_percent


def test_what_was_fitted_and_what_was_left_out_are_told_of_one_mean() -> None:
    """Of a reflectance of 1,000 values and a psi of ten: a right model leaves the same noise in both."""
    random = np.random.default_rng(3)
    shapes = {"r": {"t": np.full(1000, 0.1)}, "psi": {"t": np.full(10, 30.0)}}
    known = Parameter("t", prior_mean=1.0, prior_sd=1e-6)
    found = fit_of_lines(shapes, {name: noisy(random, one["t"]) for name, one in shapes.items()}, [known])
    rung = Rung.of(replace(ground_of(fit(TRUTH, images_of(TRUTH, 3), Spots(), free=())), fit=found))
    assert rung.fitted_percent == pytest.approx(100.0 * 0.01 / (400.0 / 1010.0), rel=0.1)
    assert rung.held_out_percent == pytest.approx(rung.fitted_percent, rel=0.1)


def test_curves_of_several_units_are_told_each_of_the_mean_of_its_own() -> None:
    """No reflectance is told of a mean of degrees, and what a goniometer's scale is does not matter."""
    random, scale = np.random.default_rng(4), 5000.0
    sigmas = {"r": 0.002, "delta": 0.1, "psi": 0.1, "far": 0.01 * scale}
    values = {"r": 0.2, "delta": 150.0, "psi": 30.0, "far": scale}
    curves = [
        CurveData(
            name, values[name] + sd * random.standard_normal(200), np.full(200, sd),
            is_angle=name in ("delta", "psi"), free_scale=name == "far",
        ) for name, sd in sigmas.items()
    ]  # fmt: skip
    predict = Lines({name: {"t": np.full(200, value)} for name, value in (values | {"far": 1.0}).items()})
    known = Parameter("t", prior_mean=1.0, prior_sd=1e-6)
    found = fit(TRUTH, [], Spots(), free=(), curves=curves, predict_curves=predict, others=[known], start={"t": 1.0})
    rung = Rung.of(replace(ground_of(fit(TRUTH, images_of(TRUTH, 3), Spots(), free=())), fit=found))
    wanted = 100.0 * np.sqrt(np.mean([0.01**2, (0.1 / 90.0) ** 2, (0.1 / 90.0) ** 2, 0.01**2]))
    assert rung.noise_percent == pytest.approx(wanted, rel=0.01)
    assert rung.fitted_percent == pytest.approx(wanted, rel=0.1)
    assert rung.held_out_percent == pytest.approx(rung.fitted_percent, rel=0.1)


def beside_images(*films: str) -> Fit:
    """Images of the spots, and spectra of two films that lack a layer; which of their parameters are fitted."""
    random, axis = np.random.default_rng(5), np.linspace(0.0, 1.0, 40)
    shapes = {"thickness": 1.0 + axis, "layer": np.cos(6.0 * axis)}
    curves = [
        CurveData(name, noisy(random, shapes["thickness"] + 0.1 * shapes["layer"]), np.full(40, SIGMA), axis=axis)
        for name in ("one", "other")
    ]
    predict = Lines({one.id: {name: shapes[name] for name in films} for one in curves})
    others = [Parameter(name) for name in films]
    return fit(MODEL, images_of(TRUTH, 3), Spots(), free=PATHS, curves=curves, predict_curves=predict, others=others)


def test_an_effect_on_films_beside_images_is_judged_by_the_curves() -> None:
    """The images know nothing of a film's layer: their error stays, that of the spectra falls to their noise."""
    base, found = beside_images("thickness"), beside_images("thickness", "layer")
    before, after = (held_out(one, folds_by_blocks(one)) for one in (base, found))
    film = spec("layer").model_copy(update={"acts_on": ("films",)})
    noise = 100.0 * SIGMA / np.mean(np.abs(base.problem.curves[0].value))
    assert before.percent_of(film) > 3.0 * noise
    assert after.percent_of(film) == pytest.approx(noise, rel=0.2)
    for effect in (spec("ripple"), film.model_copy(update={"acts_on": ("modules", "films")})):
        assert after.percent_of(effect) == pytest.approx(before.percent_of(effect), rel=1e-6)
        assert after.percent_of(effect) == after.rms_percent
    alone = fit(MODEL, images_of(TRUTH, 3), Spots(), free=PATHS)
    assert held_out(alone, folds_by_blocks(alone)).percent_of(film) == pytest.approx(after.rms_percent, rel=1e-6)


def test_a_ladder_has_the_errors_of_curves_beside_those_of_images() -> None:
    """Fitted and held out, with their noise: without them no version would differ after a film's effect was added."""
    told = told_of(MODEL, *(ground_of(beside_images(*films)) for films in (("thickness",), ("thickness", "layer"))))
    assert told["after"]["curves_held_out_percent"] < 0.3 * told["before"]["curves_held_out_percent"]
    assert told["after"]["curves_fitted_percent"] == pytest.approx(told["after"]["curves_noise_percent"], rel=0.2)
    assert told["after"]["held_out_percent"] == pytest.approx(told["before"]["held_out_percent"], rel=1e-6)
    lines = list(told_diagnosis.added(told | {"version": 2, "model": {"file": "model.toml"}, "warnings": []}))
    assert any(line.startswith("held-out error, of the curves: ") for line in lines)
    version = Version(number=1, file="model.toml", time="", command="add layer", sha256="", errors=told["errors"])
    rows = ladder([version], {1: ""})
    (rung,) = rows["rungs"]
    assert rung["curves_held_out_percent"] == told["after"]["curves_held_out_percent"]
    head, *_ = told_diagnosis.ladder(rows)
    assert "error of curves" in head
