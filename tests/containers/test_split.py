"""Expected-value splitting in the source chip: unbiased, with a closed ledger."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from containers.bsdf import GaussianLobe, Mirror
from containers.ray_tracing.monte_carlo import MonteCarlo
from containers.ray_tracing.split import SplitMonteCarlo
from containers.ray_tracing.tally import Tally
from containers.scene import Emission, Scene, lambertian_receiver
from luxloop.errors import InputError
from tests.ray_scenes import ESCAPE, mean_and_error, scene, taking

HISTORIES = 4096
SCENES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "clear chip on the lobe": ({}, {}),
    "top that reflects half, loss": ({"top": taking(0.5, 0.5), "absorption_per_um": 3e-3}, {}),
    "top and sides that absorb": ({"top": taking(0.3, 0.5), "sides": taking(0.2, 0.7)}, {}),
    "mirror below, born in the cones": (
        {"top": taking(0.7, 0.3), "bottom": "mirror", "mirror": Mirror(0.97), "absorption_per_um": 0.02},
        {"emission": Emission(layer_depth=0.99)},
    ),
    "loss above": ({"top": taking(0.5, 0.4), "absorption_per_um": 0.02, "absorption_rise_per_um": 0.02}, {}),
    "air gap below": ({"bottom": "air_gap"}, {}),
}


def what_is_seen(tally: Tally) -> np.ndarray:
    """Numbers (group, number) per history: ledger, optical events, and the low cosine sums of the map."""
    quarter = tally.bins.sum(axis=1)
    phase = np.pi * (np.arange(quarter.shape[-1]) + 0.5) / quarter.shape[-1]
    modes = [
        np.einsum("gyx,y,x->g", quarter, np.cos(m * phase), np.cos(n * phase)) for m in range(4) for n in range(3)
    ]
    return np.column_stack([tally.ledger, tally.arrivals, np.stack(modes, axis=1)]) / tally.histories


def traced(of: Scene, seed: int, kind: type[MonteCarlo]) -> np.ndarray:
    """The same of a run."""
    return what_is_seen(kind(of, seed).run_to(HISTORIES))


@pytest.mark.parametrize("name", SCENES)
def test_splitting_finds_what_the_analog_walk_finds(name: str) -> None:
    """Ends, optical events and the map's low modes of both walks agree within 4.5 combined standard errors."""
    of = scene(SCENES[name][0], **SCENES[name][1])
    (ours, error), (theirs, their_error) = (
        mean_and_error(traced(of, seed, kind)) for seed, kind in ((3, SplitMonteCarlo), (4, MonteCarlo))
    )
    assert np.all(np.abs(ours - theirs) <= 4.5 * np.hypot(error, their_error) + 1e-12)


@pytest.mark.parametrize("name", SCENES)
def test_the_ledger_of_split_light_closes(name: str) -> None:
    """Emitted light and what roulette made is the sum of all ends, to 1e-12."""
    tally = SplitMonteCarlo(scene(SCENES[name][0], **SCENES[name][1]), 5).run_to(1024)
    assert abs(tally.ledger_defect) < 1e-12


def test_a_white_furnace_sends_all_split_light_to_the_receiver_once() -> None:
    """Substrate of reflectance 1, black receiver, a lobe that frees trapped light: all that was emitted arrives."""
    of = scene(substrate=GaussianLobe(1.0, np.radians(5.0)), receiver=lambertian_receiver(0.0))
    tally = SplitMonteCarlo(of, 6).run_to(HISTORIES)
    assert tally.ledger_per_history["trapped"] == 0.0
    value, error = mean_and_error(tally.ledger[:, 3] / tally.histories)
    assert value == pytest.approx(1.0, abs=4.0 * float(error) + 1e-12)


def test_split_light_without_a_lobe_leaves_by_the_escape_cones_only() -> None:
    """Mirrors below, no loss, a black receiver: a quarter of the light comes out, the rest is trapped."""
    of = scene(substrate=Mirror(1.0), receiver=lambertian_receiver(0.0))
    tally = SplitMonteCarlo(of, 7).run_to(HISTORIES)
    assert tally.ledger_per_history["receiver"] == pytest.approx(ESCAPE, abs=2e-3)
    assert tally.ledger_per_history["trapped"] == pytest.approx(1.0 - ESCAPE, abs=2e-3)


def test_split_light_is_the_same_on_one_thread_and_on_two() -> None:
    """The thread count changes no bit."""
    one, two = (SplitMonteCarlo(scene(), 8, threads=threads).run_to(1024) for threads in (1, 2))
    assert np.array_equal(one.bins, two.bins)
    assert np.array_equal(one.ledger, two.ledger)


def test_a_chip_that_cannot_be_unfolded_is_refused() -> None:
    """Light that is born on the top face, or sides that take light beyond the critical angle, are not split."""
    for of in (scene(emission=Emission(from_top=True)), scene({"sides": taking(0.2, 0.8, beyond=0.9)})):
        with pytest.raises(InputError, match="clear sides"):
            SplitMonteCarlo(of, 1)
