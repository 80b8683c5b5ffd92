"""Strengths: amounts are found on made-up kinds, noise of the light is no strength, rivals take what they can."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.validation.diagnose.test_score import PROJECTION, candidate
from validation.blind import Kind
from validation.blind_test.strength import CLOSE, TOLERANCE, NoAmount, NotReached, amount_for, sigma_beside, sigma_of
from validation.diagnose.score import Projected

ROWS = 400


def kind(off: float = 0.0, most: float = 0.5, *, discrete: bool = False) -> Kind:
    """A kind of made-up strength."""
    return Kind("made_up", "optics", ("vignetting",), "", off, most, discrete, "It is made up.")


@pytest.mark.parametrize("strength", [
    lambda a: 300.0 * abs(a), lambda a: 4000.0 * a * a, lambda a: 100.0 * np.sqrt(abs(a)),
    lambda a: 200.0 * abs(a) + 3000.0 * a * a, lambda a: 80.0 * np.tanh(4.0 * abs(a)),
])  # fmt: skip
@pytest.mark.parametrize(("off", "most"), [(0.0, 0.5), (0.0, -0.5), (1.0, 0.5)])
def test_an_amount_is_found(strength: Callable[[float], float], off: float, most: float) -> None:
    """Whatever power it grows with, to either side of off, in few evaluations."""
    asked: list[float] = []

    def measure(amount: float) -> float:
        asked.append(amount)
        return strength(amount - off)

    amount = amount_for(kind(off, most), 20.0, measure)
    assert strength(amount - off) == pytest.approx(20.0, rel=CLOSE)
    assert asked[0] == most
    assert amount in asked
    assert len(asked) <= 6


def test_what_cannot_be_seen_is_said_with_its_sigma() -> None:
    """At its most it shows by 6 sigma; one that nearly reaches the asked strength is taken."""
    with pytest.raises(NotReached, match=r"6\.0 sigma at most") as reason:
        amount_for(kind(), 20.0, lambda amount: 12.0 * amount)
    assert reason.value.sigma == pytest.approx(6.0)
    assert amount_for(kind(), 20.0, lambda amount: (1.0 - TOLERANCE / 2.0) * 40.0 * amount) == 0.5


def test_a_discrete_one_is_there_as_it_is() -> None:
    """Its strength is what it is, if it is strong enough."""
    assert amount_for(kind(most=1.0, discrete=True), 20.0, lambda amount: 90.0 * amount) == 1.0
    with pytest.raises(NotReached):
        amount_for(kind(most=1.0, discrete=True), 20.0, lambda amount: 9.0 * amount)


def test_a_strength_that_jumps_is_refused() -> None:
    """No amount near enough exists; it is not called weak, for at its most it shows by 100 sigma."""
    with pytest.raises(NoAmount):
        amount_for(kind(), 20.0, lambda amount: 100.0 if amount > 0.1 else 1.0)


def test_noise_of_the_light_is_no_strength() -> None:
    """Halves with noise of their own: the length of their mean counts it, their product does not."""
    random = np.random.default_rng(3)
    change = 20.0 * np.ones(ROWS) / np.sqrt(ROWS)
    lengths, sigmas = [], []
    for _ in range(200):
        halves = tuple(change + 0.5 * random.standard_normal(ROWS) for _ in range(2))
        sigmas.append(sigma_of((halves[0], halves[1])) ** 2)
        lengths.append(float(np.sum(((halves[0] + halves[1]) / 2.0) ** 2)))
    assert np.mean(sigmas) == pytest.approx(400.0, abs=3.0)
    assert np.mean(lengths) == pytest.approx(450.0, abs=3.0)
    noise = random.standard_normal(ROWS)
    assert sigma_of((noise, -noise)) == 0.0


def test_rivals_take_what_they_can() -> None:
    """One takes its cosine's share, a group what its members span, the best shape of several counts."""
    axes = np.linalg.qr(np.concatenate([PROJECTION.data.T, np.random.default_rng(2).standard_normal((6, ROWS))]).T)[
        0
    ].T
    one, two, three, four = axes[4:8]
    change = 20.0 * one
    rivals = Projected.of(
        [
            candidate("near", 3.0 * (0.8 * one + 0.6 * two)),
            candidate("shaped", three, length=1.0), candidate("shaped", one + 1e-9 * two, length=2.0),
            candidate("group", np.array([one + two, one - two, 5.0 * three]), group=True),
            candidate("other", four),
        ],
        PROJECTION,
    )  # fmt: skip
    left = sigma_beside((change, change), rivals)
    assert left == pytest.approx({"near": 12.0, "shaped": 0.0, "group": 0.0, "other": 20.0}, abs=1e-5)
