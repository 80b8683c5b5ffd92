"""The kernels against a tracer that shares nothing with them: same cell, plain numpy, photon by photon."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from containers.bsdf import Mirror
from containers.ray_tracing.build import PER_CM_PER_UM, Real
from containers.ray_tracing.monte_carlo import MonteCarlo
from containers.scene import Cell, Chip, Emission, Face, Scene, lambertian_receiver
from containers.thin_film.surface import film_bsdf
from tests.films import film
from tests.plain_tracer import PlainCell, arrivals, fresnel
from tests.ray_scenes import SUBSTRATE, N, bare, illuminance, mean_and_error, mode

BATCHES = 40
HARD = {"distance": 100.0, "spacing": 300.0, "width": 60.0, "thickness": 20.0}
"""A large chip close to the receiver: much light comes back to chips, neighbours cast shadows."""
MODES = [(1, 0), (0, 1), (1, 1), (2, 0), (2, 1), (3, 0)]


def film_face() -> tuple[Face, Callable[[Real], Real]]:
    """5.5 pairs as a face, and the same R against u for the other tracer."""
    face = Face((film_bsdf(film(5.5), "inside"),), (film_bsdf(film(5.5), "outside"),))
    u = np.sqrt(1.0 - np.linspace(0.0, 1.0, 2001)[::-1] ** 2)[::-1]
    R = face.inside[0].deltas(np.arcsin(np.minimum(u / N, 1.0))).mirror
    order = np.argsort(u)
    return face, lambda at: np.interp(at, u[order], R[order])


def clear_face() -> tuple[Face, Callable[[Real], Real]]:
    """No film, and Fresnel's R against u."""
    return bare(), lambda u: fresnel(1.0, N, np.sqrt(1.0 - u**2))


def both(
    face: tuple[Face, Callable[[Real], Real]],
    size: dict[str, float],
    per_cm: float,
    depth: float | None,
    mirror: float | None,
    rise_per_cm: float = 0.0,
) -> tuple[Scene, PlainCell]:
    """The same cell for either program."""
    top, reflectance = face
    chip = Chip(
        size["width"], size["thickness"], np.array([N]), top, bare(),
        bottom="contact" if mirror is None else "mirror", mirror=None if mirror is None else Mirror(mirror),
        absorption_per_um=per_cm * PER_CM_PER_UM, absorption_rise_per_um=rise_per_cm * PER_CM_PER_UM,
    )  # fmt: skip
    receiver = lambertian_receiver(0.35)
    of = Scene(Cell(size["spacing"]), chip, size["distance"], Emission(layer_depth=depth), SUBSTRATE, receiver)
    plain = PlainCell(
        **size, index=N, absorption=per_cm * PER_CM_PER_UM, layer_depth=depth, mirror=mirror, substrate=0.97,
        sigma_rad=np.radians(5.0), receiver=0.35, top_reflectance=reflectance,
        rise=rise_per_cm * PER_CM_PER_UM,
    )  # fmt: skip
    return of, plain


def compare(of: Scene, plain: PlainCell, photons: int, histories: int, most: float = 4.0) -> None:
    """Mean, low modes and ends of both programs, each within `most` combined standard errors."""
    places, whose, ends = arrivals(plain, photons, seed=5)
    tally = MonteCarlo(of, 6).run_to(histories)
    batch = whose % BATCHES
    expected = [(illuminance(tally), np.ones(len(places)))]
    turn = 2.0 * np.pi * places / plain.spacing
    expected += [(mode(tally, m, n), np.cos(m * turn[:, 0]) * np.cos(n * turn[:, 1])) for m, n in MODES]
    for ours, theirs in expected:
        of_batches = np.bincount(batch, theirs, BATCHES) / (photons / BATCHES)
        (a, error_a), (b, error_b) = mean_and_error(ours), mean_and_error(of_batches)
        assert abs(a - b) < most * np.hypot(error_a, error_b), (a, b, error_a, error_b)
    ledger = tally.ledger_per_history
    for name, share in (("chip", ends["chip"]), ("receiver", ends["receiver"])):
        p = share / photons
        assert abs(ledger[name] - p) < most * 1.5 * np.sqrt(p * (1.0 - p) / photons) + 1e-9, (name, ledger[name], p)
    ours_below, theirs_below = ledger["substrate"], (ends["bottom"] + ends["substrate"]) / photons
    assert ours_below == pytest.approx(theirs_below, abs=most * 1.5 * np.sqrt(theirs_below / photons))


def test_a_lossy_chip_with_a_film_and_a_mirror_agrees_with_the_plain_tracer() -> None:
    """5.5 pairs, 200 /cm, thin layer at 0.99 T, mirror bottom: mean, modes and ends within four standard errors."""
    compare(*both(film_face(), HARD, 200.0, 0.99, 0.97), photons=120_000, histories=8192)


def test_a_lossy_chip_in_contact_agrees_with_the_plain_tracer() -> None:
    """5.5 pairs, 200 /cm, volume emission, bottom in contact with the substrate."""
    compare(*both(film_face(), HARD, 200.0, None, None), photons=120_000, histories=8192)


@pytest.mark.parametrize("rise_per_cm", [400.0, -400.0])
@pytest.mark.parametrize(("depth", "mirror"), [(0.99, 0.97), (None, None)], ids=["layer, mirror", "volume, contact"])
def test_a_chip_that_absorbs_more_at_one_end_agrees_with_the_plain_tracer(
    rise_per_cm: float, depth: float | None, mirror: float | None
) -> None:
    """400 /cm on average, from 0 at the bottom to 800 at the top, or the other way."""
    compare(*both(film_face(), HARD, 400.0, depth, mirror, rise_per_cm), photons=60_000, histories=8192)


def test_a_nearly_clear_chip_of_the_golden_case_agrees_with_the_plain_tracer() -> None:
    """Tens of bounces in the chip of the golden cases, no film, 30 /cm."""
    size = {"distance": 180.0, "spacing": 500.0, "width": 28.0, "thickness": 35.0}
    compare(*both(clear_face(), size, 30.0, None, None), photons=40_000, histories=8192)


@pytest.mark.slow
def test_with_many_photons_no_small_difference_is_left() -> None:
    """600,000 photons tell 0.4 % of the mean: they found that half the light entering a side left at once (1.8 %)."""
    compare(*both(film_face(), HARD, 200.0, 0.99, 0.97), photons=600_000, histories=32_768)
