"""Differences about an anchor: by a run of their own, whose noise has nothing in common with the images'."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.predictor import ENOUGH, _another
from luxloop.ray import AnchorRequest
from tests.containers.test_predictor import HISTORIES, NINE, ask, request, shot, worker


@pytest.mark.parametrize(
    ("of_anchor", "of_another"), [(0, 0), (1000, 1000), (ENOUGH, ENOUGH), (16 * ENOUGH, 2 * ENOUGH)]
)
def test_another_run_has_an_eighth_of_the_histories_or_enough(of_anchor: int, of_another: int) -> None:
    """Never more than the anchor, and another seed wherever there is a run."""
    anchor = AnchorRequest(histories=of_anchor, seed="5")
    found = _another(anchor)
    assert found.histories == of_another
    assert (found.seed != anchor.seed) == (of_anchor > 0)


def test_differences_about_an_anchor_have_nothing_of_its_noise() -> None:
    """A blur takes noise out of an image: a column with the run's own noise agrees with whatever that run errs by."""
    of, blur = worker(ExitSource()), {"name": "camera_psf", "parameters": {"psf_um": 30.0, "profile": "gaussian"}}
    views = {len(effects): shot(NINE, effects=effects, camera__pixel_um=60.0) for effects in ([], [blur])}

    def images(seed: str, histories: int, **changes: bool) -> list[NDArray[Any]]:
        about = {"histories": histories, "seed": seed, "shots": [views[0]]}
        asked = [request(view, anchor=about, **changes) for view in views.values()]
        return [ask(one, of)["images_per_mm2"][0].ravel() for one in asked]

    truth = images("4", 16 * HISTORIES)[0]
    own, quiet = images("3", HISTORIES), images("3", HISTORIES, noise=False)
    assert np.any(quiet[0] != own[0])
    alike = {}
    for name, (still, moved) in {"own": own, "quiet": quiet}.items():
        rows = [one - truth * (one @ truth) / (truth @ truth) for one in (moved - still, truth - own[0])]
        alike[name] = float(rows[0] @ rows[1] / np.sqrt((rows[0] @ rows[0]) * (rows[1] @ rows[1])))
    assert abs(alike["quiet"]) < 0.25 < 0.5 < alike["own"], alike
