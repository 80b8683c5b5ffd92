"""Round trips between receiver and substrate against closed forms, other programs and random rays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, special

from containers.bsdf import GaussianLobe, Lambertian, Mirror, Mixture
from containers.ray_tracing.twin.closure import bessel_j0, lambert, round_trip
from containers.ray_tracing.twin.exchange import Exchange
from containers.scene import Array, Receiver, lambertian_receiver

SIGMA = np.radians(5.0)
RECEIVER = lambertian_receiver(0.35)
X = np.array([0.0, 0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 6.0])


def image_of_a_point(t: float, x: float) -> float:
    """Hankel's integrand of the irradiance by a Lambertian point, t = r / h, at a wave of x / (h / 2)."""
    return float(2.0 * t * (1.0 + t * t) ** -2 * special.j0(2.0 * x * t))


def test_bessel_functions_are_those_of_scipy() -> None:
    """J0 to 1e-7 and x K1(x) to 1e-6 over all that is used."""
    x = np.linspace(0.0, 60.0, 5001)
    assert np.abs(bessel_j0(x) - special.j0(x)).max() < 1e-7
    y = np.linspace(1e-6, 30.0, 5001)
    assert np.abs(lambert(y) - y * special.k1(y)).max() < 1e-6


def test_a_round_trip_returns_the_reflectance_at_long_waves() -> None:
    """T(0) is the substrate's reflectance, whatever its scatter, and |T| is never above it."""
    for substrate in (
        Mirror(0.9),
        Lambertian(0.9),
        GaussianLobe(0.9, SIGMA),
        Mixture((Mirror(1.0), Lambertian(0.8)), (0.5, 0.5)),
    ):
        T = round_trip(substrate, RECEIVER, X)
        assert T[0] == pytest.approx(0.9, abs=1e-6)
        assert np.all(np.abs(T) <= 0.9 + 1e-6)


def test_lamberts_round_trip_over_a_mirror_is_the_image_twice_as_far() -> None:
    """The transform of the irradiance by a Lambertian point 2 D below, integrated by another program."""
    for x in (0.3, 1.0, 2.5):
        value, _ = integrate.quad(image_of_a_point, 0.0, 200.0, args=(x,), limit=2000)
        assert float(round_trip(Mirror(1.0), RECEIVER, np.array([x]))[0]) == pytest.approx(value, abs=1e-4)


@pytest.mark.parametrize("degrees", [1.0, 5.0, 15.0])
def test_a_lobes_round_trip_is_what_its_own_samples_do(degrees: float) -> None:
    """The mean wave over random rays down and up, within 4 standard errors and what the table states."""
    rng, lobe = np.random.default_rng(2), GaussianLobe(1.0, np.radians(degrees))
    theta = np.arcsin(np.sqrt(rng.random(100_000)))
    out = lobe.sample(rng.random((theta.size, 3)), theta).direction
    shift = np.hypot(np.tan(theta) + out[:, 0] / out[:, 2], out[:, 1] / out[:, 2])
    for x, T in zip(X[1:], round_trip(lobe, RECEIVER, X)[1:], strict=True):
        waves = special.j0(x * shift)
        assert abs(waves.mean() - T) < 4.0 * waves.std() / np.sqrt(theta.size) + (1e-3 if degrees > 10.0 else 2e-4)


def test_a_narrow_lobe_is_a_mirror() -> None:
    """At 0.01 deg the two round trips agree to 1e-4."""
    lobe = round_trip(GaussianLobe(1.0, np.radians(0.01)), RECEIVER, X)
    np.testing.assert_allclose(lobe, round_trip(Mirror(1.0), RECEIVER, X), atol=1e-4)


def test_response_to_half_of_all_light_halves_what_is_recorded() -> None:
    """A flat response is a factor; one that falls to grazing loses most of short ways' counterpart."""
    half = Receiver(Lambertian(0.35), response=np.array([0.5, 0.5]))
    falling = Receiver(Lambertian(0.35), response=np.array([0.0, 1.0]))
    full = round_trip(Mirror(1.0), RECEIVER, X)
    np.testing.assert_allclose(round_trip(Mirror(1.0), half, X, recorded=True), 0.5 * full, atol=1e-9)
    # the mean of cos over Lambert's law is 2/3
    assert float(round_trip(Mirror(1.0), falling, np.zeros(1), recorded=True)[0]) == pytest.approx(
        2.0 / 3.0, abs=1e-4
    )


def test_a_wide_module_is_an_endless_one_in_its_middle() -> None:
    """Uniform light on a receiver eighty distances wide comes back as rho / (1 - rho) of itself at the centre."""
    exchange = Exchange(Array.regular(15, 15, 500.0), Mirror(0.97), RECEIVER, 90.0)
    x, y = exchange.centres_um
    waves = exchange.solve(np.ones((y.size, x.size)))
    centre = float(exchange.sum_up(waves, np.zeros(1), np.zeros(1))[0, 0])
    assert centre == pytest.approx(0.3395 / (1.0 - 0.3395), rel=5e-3)
    edge = float(exchange.sum_up(waves, x[-1:], np.zeros(1))[0, 0])
    assert 0.4 * centre < edge < 0.7 * centre
