"""Differences about an anchor: by a run of their own, whose noise has nothing in common with the images'."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.acting import Effects
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.exits import Exits
from containers.ray_tracing.predictor import ENOUGH, Predictor, _run_of
from luxloop.computation import Progress
from luxloop.errors import InputError
from luxloop.ray import AnchorRequest, PredictionRequest
from luxloop.words import parse
from tests.containers.test_predictor import DARK_CORNER, HISTORIES, NINE, ask, nobody, request, shot, worker


@pytest.mark.parametrize(
    ("of_anchor", "of_another"), [(0, 0), (1000, 1000), (ENOUGH, ENOUGH), (16 * ENOUGH, 2 * ENOUGH)]
)
def test_another_run_has_an_eighth_of_the_histories_or_enough(of_anchor: int, of_another: int) -> None:
    """Never more than the anchor, and another seed wherever there is a run."""
    anchor = AnchorRequest(histories=of_anchor, seed="5")
    found = _run_of(anchor, noise=False)
    assert _run_of(anchor, noise=True) == anchor
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


class Recording(ExitSource):
    """Notes which blocks are asked for; all have the same exits, so that few are walked."""

    def __init__(self) -> None:
        super().__init__()
        self.asked = set[int]()

    def exits(self, *args: Any, first_block: int = 0, **options: Any) -> Exits:
        self.asked.add(first_block)
        return super().exits(*args, **options)


def test_what_unevenness_adds_to_a_difference_is_by_other_exits() -> None:
    """Of chips with a dark corner images err by exits at the anchor, too; differences by as many, but others."""
    about, asked = {"histories": HISTORIES}, []
    for noise in (True, False):
        source = Recording()
        ask(request(shot(effects=[DARK_CORNER]), anchor=about, noise=noise), worker(source))
        asked.append(source.asked)
    own, quiet = asked
    assert len(quiet - own) == len(own) > 1


def test_the_run_that_was_taken_is_told() -> None:
    """Its seed and its histories; without noise those of the other run."""
    at = AnchorRequest(histories=HISTORIES, seed="3")
    for noise in (True, False):
        told, _ = worker().compute(
            request(shot(), anchor={"histories": HISTORIES, "seed": "3"}, noise=noise), Progress()
        )
        taken = _run_of(at, noise)
        assert (told["seed"], told["histories"]) == (taken.seed, taken.histories)


def test_another_run_that_would_land_the_same_exits_is_refused() -> None:
    """Stored exits are those of the wanted chip, whatever the seed."""
    inputs = request(shot(), anchor={"histories": HISTORIES, "stored_exits": True}, noise=False)
    with pytest.raises(InputError, match=r"anchor\.stored_exits.*full histories"):
        ask(inputs)


def test_nothing_is_kept_of_anchors_without_a_run() -> None:
    """A worker that is asked for ever new places by exits alone holds no more of them."""
    of = Predictor(ExitSource())
    means = SimpleNamespace(film=nobody, effects=lambda _: Effects(()))
    for row in range(3):
        wanted = request(shot(camera__shift_px=[float(row), 0.0]), anchor={"shots": [shot()], "histories": 0})
        of.answer(parse(PredictionRequest, wanted), means, Progress())
    assert len(of._anchors) == 0
