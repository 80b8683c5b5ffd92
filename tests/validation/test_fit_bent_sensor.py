"""Fits of images whose sensor bends signals: derivatives by gain and offset are those of the bent signal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from luxloop.effect import AppliedEffect
from tests.validation.analytic import MODEL, PATHS, SINGLE, TRUTH, Spots, two_images
from validation.fit import fit
from validation.prediction import Anchored

KNEE_DN = 6000.0
SENSOR = (AppliedEffect(name="nonlinearity"),)
"""That a model has effects: only then is a predictor told of the sensor."""


def bent(signal):
    """A signal above black as a sensor gives it that saturates softly: s(y) = y / (1 + y / knee)."""
    return signal / (1.0 + signal / KNEE_DN)


def slope(signal):
    """Of `bent`."""
    return (1.0 + signal / KNEE_DN) ** -2


class BentSpots(Spots):
    """As the worker tells it: E' with g E' + o = s(g E + o), its derivatives by gain and offset beside it."""

    def images(self, model, views, paths=(), anchor=None):
        """The images."""
        found = super().images(model, views, paths, anchor)
        return [_bent(one, view.sensor) if view.sensor else one for one, view in zip(found, views, strict=True)]


def _bent(one, sensor):
    gain, offset = sensor.gain_dn, sensor.offset_dn
    own = one.irradiance_per_mm2 if one.twin_per_mm2 is None else one.twin_per_mm2
    there, its_own = (slope(gain * light + offset) for light in (one.irradiance_per_mm2, own))
    return replace(
        one,
        irradiance_per_mm2=(bent(gain * one.irradiance_per_mm2 + offset) - offset) / gain,
        twin_per_mm2=None if one.twin_per_mm2 is None else (bent(gain * own + offset) - offset) / gain,
        noise_per_mm2=None if one.noise_per_mm2 is None else there * one.noise_per_mm2,
        jacobian_per_mm2={path: there * by for path, by in one.jacobian_per_mm2.items()},
        by_gain_per_mm2=its_own * own,
        by_offset=its_own,
    )


@pytest.fixture(scope="module")
def images():
    """Of the truth, as the bent sensor gives them."""
    return [replace(image, signal_dn=bent(image.signal_dn)) for image in two_images()]


@pytest.fixture(scope="module")
def found(images):
    """The fit of them."""
    return fit(MODEL.model_copy(update={"effects": SENSOR}), images, BentSpots())


def test_signals_change_as_the_columns_say(found):
    """Differences of the signals by every unknown, where the slope is far from 1."""
    at, names = found.problem.evaluate(found.values), found.names
    assert min(one.by_offset.min() for one in at.predicted) < 0.6
    for number, name in enumerate(names):
        change = np.zeros(len(names))
        change[number] = 1e-4 * max(abs(found.values[number]), 1.0)
        low, high = (found.problem.evaluate(found.values + sign * change).signals_dn() for sign in (-1.0, 1.0))
        told = [one - now for one, now in zip(at.signals_dn(change), at.signals_dn(), strict=True)]
        for one, below, above in zip(told, low, high, strict=True):
            wanted = (above - below) / 2.0
            np.testing.assert_allclose(one, wanted, atol=1e-4 * np.abs(wanted).max() + 1e-9, err_msg=name)


def test_truth_is_found_back(found):
    """Within four of its errors, offsets too; the straight sensor's columns would end elsewhere or not at all."""
    truth = {path: TRUTH.leaves()[path] for path in PATHS}
    for shot in ("single-a", "array-a"):
        truth |= {f"{shot}.gain": 300.0, f"{shot}.offset_dn": 20.0}
    assert found.converged
    for name, value in truth.items():
        assert abs(found.value(name) - value) < 4.0 * found.error(name), name


def test_the_other_columns_have_the_gain_of_the_anchored_image(found):
    """With an anchor's noise in it, bent as the sensor bends it; what does not grow with the gain stays the same."""
    drawn = {SINGLE.id: 0.001 * np.random.default_rng(3).standard_normal((24, 24))}
    noise, anchor = {SINGLE.id: drawn[SINGLE.id][None]}, Anchored(found.model, 1000)
    problem = replace(found.problem, predictor=BentSpots(noise, drawn=drawn), anchor=anchor)
    at = problem.evaluate(found.values)
    white = at.whitening()
    columns, others = at.columns(white), at.other_columns(white, at.predicted)
    straight = Spots(noise, drawn=drawn).images(found.model, problem.views(found.model, at.by_name), (), anchor)
    for shot, one in zip(("single-a", "array-a"), straight, strict=True):
        signal = found.value(f"{shot}.gain") * one.irradiance_per_mm2 + found.value(f"{shot}.offset_dn")
        by_gain = slope(signal) * one.irradiance_per_mm2
        wanted = white.rows([by_gain if name == shot else 0.0 * by_gain for name in ("single-a", "array-a")])
        place = found.names.index(f"{shot}.gain")
        np.testing.assert_allclose(others[place], wanted, rtol=1e-3, atol=1e-5 * np.abs(wanted).max())
    gains = [place for place, name in enumerate(found.names) if name.endswith(".gain")]
    assert np.abs(others - columns)[gains].max() > 1e-4 * np.abs(columns[gains]).max()
    np.testing.assert_array_equal(np.delete(others, gains, 0), np.delete(columns, gains, 0))
