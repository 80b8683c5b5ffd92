"""What a rung of the ladder calls noise: what a right model leaves, whoever made it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.validation.analytic import SINGLE, TRUTH, Spots, blank, measured
from tests.validation.diagnose.made_up import GAIN, ground_of
from validation.diagnose.ladder import Rung
from validation.fit import fit
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
