"""What a rung of the ladder calls noise: what a right model leaves, whoever made it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.analytic import SINGLE, TRUTH, Spots, blank, measured
from tests.validation.diagnose.made_up import GAIN, ground_of, images_of
from tests.validation.lines import fit_of_lines, noisy
from validation.diagnose.ladder import Rung
from validation.fit import Parameter, fit
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


def test_what_was_fitted_and_what_was_left_out_are_told_of_one_mean() -> None:
    """Of a reflectance of 1,000 values and a psi of ten: a right model leaves the same noise in both."""
    random = np.random.default_rng(3)
    shapes = {"r": {"t": np.full(1000, 0.1)}, "psi": {"t": np.full(10, 30.0)}}
    known = Parameter("t", prior_mean=1.0, prior_sd=1e-6)
    found = fit_of_lines(shapes, {name: noisy(random, one["t"]) for name, one in shapes.items()}, [known])
    rung = Rung.of(replace(ground_of(fit(TRUTH, images_of(TRUTH, 3), Spots(), free=())), fit=found))
    assert rung.fitted_percent == pytest.approx(100.0 * 0.01 / (400.0 / 1010.0), rel=0.1)
    assert rung.held_out_percent == pytest.approx(rung.fitted_percent, rel=0.1)
