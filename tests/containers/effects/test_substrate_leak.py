"""Light that travels inside the substrate: where it comes out, that none is lost, and the twin's account of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.special import j1, k1

from containers.acting import Effects
from containers.bsdf import Lambertian, Mirror, Mixture
from containers.effects.substrate_leak import SubstrateLeak
from containers.ray_tracing.exits import Landing, chip_key, make_exits
from containers.ray_tracing.field import CellField
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.twin.cell import cell_field
from containers.ray_tracing.twin.closure import Leak, lambert, round_trip
from containers.ray_tracing.twin.module import ModuleTwin
from containers.scene import Array, Emission, Receiver, Scene, lambertian_receiver
from luxloop.errors import InputError
from tests.ray_scenes import launched, scene

Real = NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -1.0])


def leaky(of: Scene, share: float, length_um: float = 300.0) -> Scene:
    """The scene under the effect."""
    return Effects((SubstrateLeak(leak_share=share, length_um=length_um),)).scene(of)


@pytest.mark.parametrize("length_um", [1e-6, 100.0, 300.0])
def test_light_comes_out_with_the_density_and_by_lambert_s_law(length_um: float) -> None:
    """Of light sent straight down the share within 180 um is the integral over waves of both transforms."""
    one = replace(Array.regular(1, 1, 500.0, half_um=4000.0), offset_um=np.full((1, 1, 2), 1e-3))  # not folded
    wide = scene(layout=one, receiver=lambertian_receiver(0.0))
    rays, D = 100_000, wide.distance_um
    tally = launched(replace(wide, leak_share=1.0, leak_um=length_um), np.tile([40.0, 0.0, 1.0], (rays, 1)), DOWN)
    bins, (x0, x1, y0, y1) = tally.cell_bins()[0], tally.box.ends_um
    x = x0 + (np.arange(bins.shape[1]) + 0.5) * (x1 - x0) / bins.shape[1]
    y = y0 + (np.arange(bins.shape[0]) + 0.5) * (y1 - y0) / bins.shape[0]
    found = bins[(x - 40.0) ** 2 + (y**2)[:, None] < D**2].sum() / rays
    wave = lambda k: j1(k * D) * D * k * D * k1(k * D) * (1.0 + (k * length_um) ** 2) ** -1.5  # noqa: E731
    assert found == pytest.approx(quad(wave, 1e-9, 0.25, limit=400)[0], abs=0.008)
    assert abs(tally.ledger_defect) < 1e-9


def test_a_leak_keeps_light_and_spares_it_the_substrate_s_loss() -> None:
    """What leaks is not absorbed: of the light sent down (1 - a) R + a comes up, for R = 0.5 1 - (1 - a)/2."""
    dark = scene(substrate=Mirror(0.5), receiver=lambertian_receiver(0.0))
    for share in (0.0, 0.1):
        tally = launched(leaky(dark, share), np.tile([200.0, 200.0, 1.0], (100_000, 1)), DOWN)
        up = 1.0 - tally.ledger_per_history["substrate"]
        assert up == pytest.approx(1.0 - (1.0 - share) / 2.0, abs=0.006)
        assert abs(tally.ledger_defect) < 1e-9


@pytest.mark.parametrize("reflectance", [0.0, 0.5, 0.97, 1.0])
@pytest.mark.parametrize("share", [0.05, 0.1])
def test_a_leak_makes_no_light(reflectance: float, share: float) -> None:
    """Of light that a black receiver is sent once, and of the twin's round trip, (1 - a) R + a, never more than 1."""
    of = leaky(scene(substrate=Mirror(reflectance), receiver=lambertian_receiver(0.0)), share)
    tally = launched(of, np.tile([200.0, 200.0, 1.0], (20_000, 1)), DOWN)
    expected = (1.0 - share) * reflectance + share
    assert expected <= 1.0
    assert tally.ledger_per_history["receiver"] + tally.ledger_per_history["chip"] <= 1.0 + 1e-12
    assert 1.0 - tally.ledger_per_history["substrate"] == pytest.approx(expected, abs=0.014)
    at = np.array([0.0])
    trip = round_trip(of.substrate, of.receiver, at, Leak.of(of))
    assert trip[0] == pytest.approx(expected, abs=1e-9)


def test_a_leak_of_nothing_is_no_leak_and_leaves_chips_alone() -> None:
    """The scene itself comes back at 0; the exits of a chip do not depend on the leak."""
    base = scene()
    assert leaky(base, 0.0) is base
    assert chip_key(leaky(base, 0.1)) == chip_key(base)
    with pytest.raises(InputError, match="leak_share"):
        replace(base, leak_share=1.5)


def test_the_round_trip_keeps_its_light_and_has_the_closed_form() -> None:
    """At wave 0 the share a is spared the substrate's loss; at others it is (x K1)^2 (1 + k^2 L^2)^(-3/2)."""
    of = leaky(scene(), 0.1, 360.0)
    leak, x = Leak.of(of), np.linspace(0.0, 4.0, 9)
    trip = round_trip(of.substrate, of.receiver, x)
    found = round_trip(of.substrate, of.receiver, x, leak)
    assert found[0] == pytest.approx(0.9 * 0.97 + 0.1, abs=1e-9)
    assert found == pytest.approx(0.9 * trip + 0.1 * lambert(x) ** 2 * (1.0 + 4.0 * x**2) ** -1.5, abs=1e-9)
    np.testing.assert_array_equal(round_trip(of.substrate, of.receiver, x, Leak()), trip)


@pytest.mark.parametrize("emission", [Emission(from_top=True), Emission()])
def test_the_twin_s_leak_is_that_of_monte_carlo(emission: Emission) -> None:
    """A cell of chips with Lambertian tops, and that shine down as well, share 0.1, L 0.3 mm: the leak changes the
    lowest modes alike."""
    base = scene(emission=emission)
    exits = make_exits(base, 1, 4 * BLOCK)
    after = leaky(base, 0.1)

    def traced(of: Scene) -> Real:
        found = []
        for seed in range(4):
            tally = Landing(of, exits, seed, survival=1.0).run_to(exits.histories)
            field = CellField.from_bins(tally.cell_bins(), tally.histories, 500.0, of.height_um, folded=True)
            found.append(field.coefficients.mean(axis=0)[:3, :3])
        return np.array(found)

    change = traced(after) - traced(base)
    error = change.std(axis=0, ddof=1) / np.sqrt(len(change))
    twin = [cell_field(of, exits).coefficients.mean(axis=0)[:3, :3] for of in (after, base)]
    moved = twin[0] - twin[1]
    assert np.abs(moved - change.mean(axis=0)).max() < 5.0 * error.max() + 2e-4
    assert moved[0, 0] == pytest.approx(change.mean(axis=0)[0, 0], abs=4.0 * error[0, 0] + 2e-4)
    assert moved[0, 0] > 5.0 * error[0, 0]


@pytest.mark.parametrize(
    "receiver",
    [
        lambertian_receiver(0.0),
        replace(lambertian_receiver(0.35), response=np.linspace(0.7, 1.0, 9)),
        Receiver(Mixture((Lambertian(0.35), Mirror(0.5)), (0.8, 0.2))),
    ],
)
def test_the_twin_s_leak_goes_on_beyond_a_module_s_edge(receiver: Receiver) -> None:
    """3 x 3 chips, share 0.1, L 0.6 mm: the leak changes each part of a quarter of the module as by Monte Carlo."""
    base = scene(layout=Array.regular(3, 3, 500.0), receiver=receiver)
    after, exits, half = leaky(base, 0.1, 600.0), make_exits(base, 1, 16 * BLOCK), base.layout.half_x_um

    def traced(of: Scene, seed: int) -> Real:
        tally = Landing(of, exits, seed, survival=1.0).run_to(exits.histories)
        bins, (x0, x1, _, _) = tally.cell_bins().mean(axis=0), tally.box.ends_um
        step, ends = (x1 - x0) / len(bins), np.linspace(-half, half, 7)[:, None]
        start = x0 + np.arange(len(bins)) * step
        to = np.clip(np.minimum(start + step, ends[1:]) - np.maximum(start, ends[:-1]), 0.0, None) / step
        return folded(to @ bins @ to.T) * 9e6 / tally.histories / (half / 3.0) ** 2

    def folded(module: Real) -> Real:
        half_of = module + module[::-1]
        quarter = (half_of + half_of[:, ::-1])[:3, :3]
        return np.asarray(quarter + quarter.T) / 8.0

    found = np.array([traced(after, seed) - traced(base, seed) for seed in range(6)])
    change, error = found.mean(axis=0), found.std(axis=0, ddof=1) / 6**0.5
    x = (np.arange(60) + 0.5) / 30.0 * half - half
    moved = ModuleTwin(after, exits).mean(x, x) - ModuleTwin(base, exits).mean(x, x)
    moved = folded(moved.reshape(6, 10, 6, 10).mean(axis=(1, 3)))
    assert (np.abs(moved - change) < 3.5 * error + 0.02 * np.abs(change)).all()
    assert np.abs(change).mean() > 15.0 * error.mean()
    assert moved.sum() == pytest.approx(change.sum(), rel=0.03)
