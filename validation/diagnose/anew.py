"""A fit made anew: for a model that has another light than the anchor's, or that begins in a corner (decision 35)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from validation.diagnose.frozen import frozen_at
from validation.fit import Fit, refitted
from validation.fit.image_fit import ANCHOR_MOVE, MAX_ANCHORS, TWIN_STEPS, moved
from validation.fit.problem import Problem
from validation.fit.start import start_values

Real = NDArray[np.float64]

OTHER_LIGHT = 0.1
"""Share by which the light of an image may differ from that at the anchor, before Monte Carlo is asked for anew."""

STEPS = 12
"""Of a fit with frozen derivatives: what explains little never converges."""


def has_other_light(problem: Problem, values: Real) -> bool:
    """Whether an image has another light at these values than at the anchor; never where there is no Monte Carlo.

    What the twin errs by, and the noise of Monte Carlo, is carried over as it is from the anchor, but it goes with
    the light: of a chip that absorbs nothing it is several times too large for one that absorbs 200 /cm.
    """
    anchor, known = problem.anchor, problem.unknowns.named(values)
    if anchor is None or not anchor.histories:
        return False
    alone = replace(anchor, histories=0)
    here, there = (
        problem.predictor.images(one, problem.views(one, known), (), alone)
        for one in (problem.unknowns.model(problem.model, values), anchor.model)
    )
    changes = [
        float(one.irradiance_per_mm2.sum() / other.irradiance_per_mm2.sum()) - 1.0
        for one, other in zip(here, there, strict=True)
    ]
    return max(map(abs, changes), default=0.0) > OTHER_LIGHT


def is_scale(name: str) -> bool:
    """Whether a straight line through an image, or a curve, tells where it starts."""
    return name == "gain" or name.endswith((".gain", ".offset_dn", ".scale"))


def fitted_anew(problem: Problem, start: Mapping[str, float]) -> Fit | None:
    """The fit from these values by the twin, then about Monte Carlo of its own; None where there is no Monte Carlo.

    What made up for a missing effect leads the long way back only where nothing but the twin has a say. Derivatives
    are taken where the twin ended, and once more with each anchor: those of effects are a walk for each moved chip.
    """
    anchor = problem.anchor
    if anchor is None or not anchor.histories:
        return None
    lent = replace(problem, anchor=replace(anchor, model=problem.model, histories=0, poses=()))
    found = refitted(lent, start_values(lent, start), TWIN_STEPS)
    for _ in range(MAX_ANCHORS):
        about = replace(anchor, model=found.model, poses=tuple(found.poses.values()))
        there = replace(
            found.problem, anchor=about, predictor=problem.predictor, predict_curves=problem.predict_curves
        )
        before, found = found, refitted(frozen_at(there, found.values), found.values, STEPS)
        if moved(found, before, problem.unknowns.model_paths) <= ANCHOR_MOVE:
            break
    own = replace(found.problem, predictor=problem.predictor, predict_curves=problem.predict_curves)
    return replace(found, problem=own)
