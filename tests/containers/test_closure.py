"""Round trips between receiver and substrate against closed forms, other programs and random rays."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate, special

from containers.bsdf import GaussianLobe, Lambertian, Mirror, Mixture
from containers.ray_tracing.twin.closure import Leak, bessel_j0, lambert, round_trip
from containers.ray_tracing.twin.exchange import Exchange, sum_up
from containers.ray_tracing.twin.grid import Grid
from containers.scene import Array, Receiver, lambertian_receiver
from luxloop.errors import InputError

Real = NDArray[np.float64]
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
    x, y = exchange.grid.centres_um
    waves = exchange.solve(np.ones((y.size, x.size)))
    centre = float(sum_up(waves, np.zeros(1), np.zeros(1))[0, 0])
    assert centre == pytest.approx(0.3395 / (1.0 - 0.3395), rel=5e-3)
    edge = float(sum_up(waves, x[-1:], np.zeros(1))[0, 0])
    assert 0.4 * centre < edge < 0.7 * centre


@pytest.mark.parametrize("rows", [1, 5])
@pytest.mark.parametrize("distance_um", [90.0, 300.0, 1200.0])
@pytest.mark.parametrize("length_um", [1e-6, 200.0, 600.0])
def test_what_goes_inside_at_a_point_comes_up_as_hankels_integral_says(
    length_um: float, distance_um: float, rows: int
) -> None:
    """Below each chip of a row, however coarse the grid is beside the module; nothing comes round from its end."""
    layout, step = Array.regular(rows, 1, 400.0), 10.0
    leak = Leak(0.1, length_um / distance_um)
    exchange = Exchange(layout, Mirror(0.97), lambertian_receiver(0.0), distance_um, leak=leak)
    pieces = np.zeros((3, 3))
    pieces[1, 1] = 1.0
    leaked = exchange.wide.laid(pieces, step, layout)
    x, y = np.array([0.0, 130.0]), np.array([0.0, 190.0])
    found = sum_up(exchange.solve(np.zeros(exchange.grid.shape), leaked), x, y)

    def around(r: float) -> float:
        def wave(k: float) -> float:
            up = k * distance_um * special.k1(k * distance_um) if k else 1.0
            return float(k * special.j0(k * r) * up * (1.0 + (k * length_um) ** 2) ** -1.5 / (2.0 * np.pi))

        return float(integrate.quad(wave, 0.0, 25.0 / distance_um, limit=2000)[0])

    expected = [
        [sum(around(float(np.hypot(a - cx, b - cy))) for cx, cy in layout.centres_um.reshape(-1, 2)) for a in x]
        for b in y
    ]
    np.testing.assert_allclose(found, expected, rtol=0.02)


@pytest.mark.parametrize("specular", [0.0, 0.3])
def test_what_leaks_is_one_more_way_of_the_substrate(specular: float) -> None:
    """Over a mirror, below a receiver with a mirror's part: each arrival is a product of straight stretches."""
    a, R, length = 0.1, 0.8, 2.0
    parts = (Lambertian(0.35), Mirror(1.0))
    receiver = Receiver(Mixture(parts, (1.0 - specular, specular)) if specular else parts[0])
    x = np.array([1e-9, 0.1, 0.3, 0.6, 2.0])

    def straight(steps: int) -> Real:
        return np.asarray(steps * x * special.k1(steps * x))

    stays, leaks = (1.0 - a) * R, a * (1.0 + (length * x) ** 2) ** -1.5
    first = stays * straight(2) + leaks * straight(1) ** 2
    second = (
        stays**2 * straight(4)
        + 2.0 * stays * leaks * straight(1) * straight(3)
        + leaks**2 * straight(1) ** 2 * straight(2)
    )
    found = round_trip(Mirror(R), receiver, x, Leak(a, length))
    np.testing.assert_allclose(found, first + specular * second, atol=1e-6)
    arrives, recorded = Leak(a, length).comes_up(x, Mirror(R), receiver)
    np.testing.assert_allclose(
        arrives * a,
        leaks * (straight(1) + specular * (stays * straight(3) + leaks * straight(2) * straight(1))),
        atol=1e-6,
    )
    np.testing.assert_array_equal(recorded, arrives)


@pytest.mark.parametrize("leak", [0.0, 0.2])
def test_what_is_recorded_of_a_second_arrival_is_by_lamberts_law(leak: float) -> None:
    """A response that falls to 0 at grazing: at wave 0 the mean of cos, 2/3, of the first and of the second."""
    falling = Receiver(Mixture((Lambertian(0.35), Mirror(1.0)), (0.7, 0.3)), response=np.linspace(0.0, 1.0, 9))
    all_of_it, seen = (
        round_trip(Mirror(0.9), falling, np.zeros(1), Leak(leak, 2.0), recorded=one) for one in (False, True)
    )
    assert seen[0] == pytest.approx(2.0 / 3.0 * all_of_it[0], rel=1e-4)


def test_a_leak_too_long_for_a_grid_is_refused() -> None:
    """Before the memory is taken."""
    with pytest.raises(InputError, match="leak_um"):
        Exchange(Array.regular(3, 3, 500.0), Mirror(0.97), RECEIVER, 20.0, leak=Leak(0.1, 1e5 / 20.0))


def test_a_leak_of_next_to_nothing_changes_next_to_nothing() -> None:
    """Though its grid is wider."""
    seen = Receiver(Lambertian(0.35), response=np.linspace(0.7, 1.0, 9))
    layout, at = Array.regular(1, 1, 400.0), np.array([0.0, 150.0])
    light = {}
    for share in (0.0, 1e-9):
        exchange = Exchange(layout, GaussianLobe(0.97, SIGMA), seen, 180.0, leak=Leak(share, 3.0))
        x, y = exchange.grid.centres_um
        light[share] = sum_up(exchange.solve(np.exp(-np.add.outer(y**2, x**2) / 1e4)), at, at)
    np.testing.assert_allclose(light[1e-9], light[0.0], rtol=1e-6)


def test_a_module_much_longer_than_wide_has_light() -> None:
    """Fifty chips in a row so far below their receiver that the module is narrower than a cell would be."""
    exchange = Exchange(Array.regular(1, 50, 100.0), Mirror(0.97), RECEIVER, 4000.0)
    light = sum_up(exchange.solve(np.ones(exchange.grid.shape)), np.zeros(1), np.zeros(1))
    assert 0.0 < light[0, 0] < 0.05


@pytest.mark.parametrize(
    ("rows", "columns", "pitch_um", "distance_um", "places"),
    [(3, 3, 300.0, 150.0, (45, 45)), (1, 50, 100.0, 300.0, (8, 250))],
)
def test_the_light_of_a_module_s_receiver_solves_its_integral_equation(
    rows: int, columns: int, pitch_um: float, distance_um: float, places: tuple[int, int]
) -> None:
    """Over a mirror I(p) = rho R sum over the module of K(|p - q|) (E(q) + I(q)), K of Lambert from 2 D away."""
    layout = Array.regular(rows, columns, pitch_um)
    y, x = (
        ((np.arange(n) + 0.5) / n * 2.0 - 1.0) * half
        for n, half in zip(places, (layout.half_y_um, layout.half_x_um), strict=True)
    )
    exchange = Exchange(layout, Mirror(0.97), RECEIVER, distance_um)
    gx, gy = exchange.grid.centres_um

    def light(at_x: Real, at_y: Real) -> Real:
        return np.asarray(np.exp(-np.add.outer((at_y - 100.0) ** 2, at_x**2) / 2e5))

    found = sum_up(exchange.solve(light(gx, gy)), x, y)
    r2 = np.add.outer(np.subtract.outer(y, y) ** 2, np.subtract.outer(x, x) ** 2).transpose(0, 2, 1, 3)
    h2, area = (2.0 * distance_um) ** 2, (x[1] - x[0]) * (y[1] - y[0])
    matrix = (0.35 * 0.97 * area * h2 / (np.pi * (r2 + h2) ** 2)).reshape(x.size * y.size, -1)
    again = np.linalg.solve(np.eye(len(matrix)) - matrix, matrix @ light(x, y).ravel())
    assert np.abs(found.ravel() - again).max() < 0.004 * again.max()


@pytest.mark.parametrize("beyond_um", [0.0, 500.0, 555.0])
def test_a_grid_gives_back_what_was_put_on_it_and_cuts_at_the_edge(beyond_um: float) -> None:
    """Light at its centres; of a piece about a chip what lies inside."""
    layout = Array.regular(2, 3, 100.0)
    grid = Grid.of(layout, 15.0, beyond_um)
    light = np.random.default_rng(1).random(grid.shape)
    np.testing.assert_allclose(grid.sum_up(grid.waves(light), *grid.centres_um), light, atol=1e-12)
    np.testing.assert_allclose(grid.on_module(grid.waves(light)), light, atol=1e-12)
    waves = grid.laid(np.ones((80, 80)), 10.0, layout)  # 800 um wide: of each chip's all of the module
    assert waves[0, 0].real * grid.step_um[0] * grid.step_um[1] == pytest.approx(6 * 20 * 30)
