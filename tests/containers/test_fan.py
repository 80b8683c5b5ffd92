"""First light that the substrate scatters, recorded in a fan of directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from containers.bsdf import GaussianLobe, Lambertian
from containers.ray_tracing.arrays import ENDS
from containers.ray_tracing.exits import Landing, make_exits
from containers.ray_tracing.monte_carlo import MonteCarlo
from containers.ray_tracing.tally import FIRST, LATER
from containers.scene import Array, Scene, lambertian_receiver
from tests.ray_scenes import launched, mean_and_error, mode, scene


def module(**changes: object) -> Scene:
    """Two by three chips with an open edge."""
    return replace(scene(), layout=Array.regular(2, 3, 300.0), **changes)  # type: ignore[arg-type]


SCENES = {
    "cell": scene(),
    "wide lobe": scene(substrate=GaussianLobe(0.8, np.radians(30.0))),
    "crowded": scene(layout=replace(scene().layout, spacing_um=45.0)),  # type: ignore[arg-type]
    "module": module(),
    "tilted module": module(tilt_per_um=(2e-4, -1e-4)),
    "plate": scene(receiver=replace(lambertian_receiver(0.35), spread_share=0.5, spread_um=20.0)),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_ray_that_goes_on_is_the_same_with_any_fan(name: str) -> None:
    """Ledger and later light to the last bit: a fan only records."""
    alone, fan = (MonteCarlo(SCENES[name], 5, fan=count).run_to(1024) for count in (1, 4))
    assert np.array_equal(alone.ledger, fan.ledger)
    if name != "plate":  # where the arrivals of a fan draw places in the plate, too
        assert np.array_equal(alone.bins[:, LATER], fan.bins[:, LATER])
    assert not np.array_equal(alone.bins[:, FIRST], fan.bins[:, FIRST])


@pytest.mark.parametrize("name", SCENES)
def test_a_fan_changes_no_mean(name: str) -> None:
    """The same light, in all and by optical event, and the same lowest modes of the map."""
    alone, fan = (MonteCarlo(SCENES[name], seed, fan=count).run_to(8192) for seed, count in ((6, 1), (7, 5)))
    for found in ((a.bins[:, FIRST].sum(axis=(1, 2)), a.arrivals[:, 0], a.arrivals[:, 1]) for a in (alone, fan)):
        assert all(np.all(part > 0.0) for part in found)
    for of in (lambda t: t.bins[:, FIRST].sum(axis=(1, 2)), lambda t: t.arrivals[:, 0], lambda t: t.arrivals[:, 1]):
        (x, e), (y, f) = mean_and_error(of(alone)), mean_and_error(of(fan))
        assert abs(x - y) < 4.0 * np.hypot(e, f)
    if name in ("cell", "wide lobe"):
        for m, n in ((1, 0), (1, 1), (2, 0)):
            (x, e), (y, f) = mean_and_error(mode(alone, m, n)), mean_and_error(mode(fan, m, n))
            assert abs(x - y) < 4.0 * np.hypot(e, f)


@pytest.mark.parametrize("fan", [1, 4])
def test_the_receiver_takes_what_arrives_and_is_not_sent_back(fan: int) -> None:
    """0.65 of all arrivals: to rounding where a ray records itself, within the errors where its fan does."""
    tally = MonteCarlo(scene(), 8, fan=fan).run_to(8192)
    taken, arrived = tally.ledger[:, ENDS.index("receiver")], tally.arrivals.sum(axis=1)
    if fan == 1:
        assert taken == pytest.approx(0.65 * arrived, rel=1e-12)
    mean, error = mean_and_error(taken - 0.65 * arrived)
    assert abs(mean) <= 4.0 * error + 1e-12 * taken.mean()
    assert error < 0.01 * taken.mean()


def test_one_ray_leaves_the_mean_of_its_fan() -> None:
    """A ray straight down on a white substrate below a black receiver: all of its fan arrives, spread over bins."""
    of = scene(substrate=GaussianLobe(1.0, np.radians(5.0)), receiver=lambertian_receiver(0.0))
    found = launched(of, [[100.0, 0.0, 1.0]], [[0.0, 0.0, -1.0]], fan=4)
    weights = found.bins[0, FIRST][found.bins[0, FIRST] > 0.0]
    assert weights.sum() == pytest.approx(1.0)
    assert 2 <= weights.size <= 4
    assert found.arrivals.sum() == pytest.approx(1.0)


def test_a_fan_takes_noise_away() -> None:
    """Of what one and the same set of exits leaves with many landing seeds, a fan of 8 varies much less."""
    of = scene(receiver=lambertian_receiver(0.0))
    exits = make_exits(of, 1, 1024, groups=2)
    spread = [
        np.var([Landing(of, exits, seed, fan=fan).run_to(1024).arrivals.sum() for seed in range(12)])
        + np.var([mode(Landing(of, exits, seed, fan=fan).run_to(1024), 2, 0).mean() for seed in range(12)])
        for fan in (1, 8)
    ]
    assert spread[1] < spread[0] / 2.0


def test_a_substrate_that_is_no_lobe_has_no_fan() -> None:
    """Lambert's law: the same bits with any fan."""
    of = scene(substrate=Lambertian(0.9))
    alone, fan = (MonteCarlo(of, 5, fan=count).run_to(1024) for count in (1, 4))
    assert np.array_equal(alone.bins, fan.bins)
