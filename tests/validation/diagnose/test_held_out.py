"""Errors in what was left out, in the unit of what is told."""

from __future__ import annotations

import numpy as np
import pytest

from tests.validation.analytic import MODEL, PATHS, TRUTH, Spots
from tests.validation.diagnose.made_up import images_of
from validation.diagnose.held_out import folds_by_sample, held_out
from validation.fit import CurveData, fit
from validation.prediction import PredictedCurve

AXIS = np.linspace(0.0, 1.0, 40)


@pytest.mark.parametrize("curves", [0, 3])
def test_spectra_beside_images_do_not_change_the_error_of_the_images(curves: int) -> None:
    """Percent of the images' mean signal: a reflectance is no DN. Without images it is that of the spectra."""
    random = np.random.default_rng(7)
    spectra = [
        CurveData(f"r{number}", 0.5 + 0.01 * random.standard_normal(40), np.full(40, 0.01), axis=AXIS)
        for number in range(curves)
    ]

    def predict(_model: object, asked: object, *_: object) -> list[PredictedCurve]:
        return [PredictedCurve(np.full(40, 0.5), {}) for _ in spectra]

    found = fit(MODEL, images_of(TRUTH, 3), Spots(), free=PATHS, curves=spectra, predict_curves=predict)  # type: ignore[arg-type]  # it predicts what is asked for
    left = held_out(found, folds_by_sample(found))
    (alone,) = [held_out(one, folds_by_sample(one)) for one in [fit(MODEL, images_of(TRUTH, 3), Spots(), free=PATHS)]]
    assert left.rms_percent == pytest.approx(alone.rms_percent, rel=1e-6)
    assert left.floor_percent == pytest.approx(alone.floor_percent, rel=1e-6)
    if curves:
        only = fit(TRUTH, [], Spots(), free=(), curves=spectra, predict_curves=predict)  # type: ignore[arg-type]  # likewise
        assert held_out(only, folds_by_sample(only)).floor_percent == pytest.approx(2.0, rel=1e-2)
