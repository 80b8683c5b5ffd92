"""The pictures of a diagnosis as arrays: what was measured, what the model says, what is left without and with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from validation.diagnose.rounds import Diagnosis
from validation.fit import Fit

Real = NDArray[np.float64]


def arrays_of(found: Diagnosis) -> dict[str, Real]:
    """By "ID/NAME" for every image: measured_dn, model_dn, z (standard deviations) and, with the best effect, z_with.

    (row, column), NaN where a pixel is not used.
    """
    first = found.steps[0]
    best = first.kept if found.verdict.names else None
    arrays = _of(first.ground.fit)
    if best is not None and best.fit is not None:
        arrays |= {name.replace("/z", "/z_with"): one for name, one in _of(best.fit).items() if name.endswith("/z")}
    return arrays


def _of(fit: Fit) -> dict[str, Real]:
    arrays: dict[str, Real] = {}
    for image, model, z in zip(fit.problem.images, fit.signals_dn, fit.residual_images, strict=True):
        shot = image.shot.id
        arrays[f"{shot}/measured_dn"] = np.where(image.used, image.signal_dn, np.nan)
        arrays[f"{shot}/model_dn"] = np.asarray(model)
        arrays[f"{shot}/z"] = np.where(image.used, z, np.nan)
    return arrays
