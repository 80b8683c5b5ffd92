"""The blind truth's stacks: against an independent program, and what each hidden stack must keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import tmm

from tests.validation.blind.truths import PAPER
from validation.blind import Hidden
from validation.blind.film import film
from validation.blind.stack import film_of

ONE_LINE = replace(PAPER, fwhm_nm=0.0)


@pytest.mark.parametrize(("pairs", "air_deg"), [(2.5, 0.0), (5.5, 0.0), (5.5, 50.0), (6.5, 70.0), (0.5, 30.0)])
def test_powers_of_a_stack_are_tmms(pairs: float, air_deg: float) -> None:
    """R and T from inside and outside, means of s and p, at one wavelength."""
    found = film_of(ONE_LINE, pairs, {})
    rows = [(2.4869, 45.2) if number % 2 == 0 else (2.1793, 51.6) for number in range(round(2 * pairs))]
    index, thickness = [2.4869, *(n for n, _ in rows), 1.0], [np.inf, *(d for _, d in rows), np.inf]
    theta = np.arcsin(np.sin(np.radians(air_deg)) / 2.4869)
    told = [tmm.coh_tmm(p, index, thickness, theta, 445.0) for p in "sp"]
    cosine = np.linspace(0.0, 1.0, found.inside.size)
    for table, power in ((found.inside, "R"), (found.passed, "T"), (found.outside, "R")):
        wanted = np.mean([one[power] for one in told])
        assert np.interp(np.cos(np.radians(air_deg)), cosine, table) == pytest.approx(wanted, abs=3e-6)


def test_an_absorbing_stack_is_tmms_from_both_sides() -> None:
    """Reflectances of its two sides differ, also beyond the critical angle; T is one."""
    n = np.array([2.1793 - 0.02j])
    found = film([(n, 51.6), (np.array([2.4869 + 0j]), 45.2)] * 3, 2.4869, np.array([445.0]), np.ones(1))
    index = [2.4869, *([2.1793 + 0.02j, 2.4869] * 3), 1.0]
    thickness = [np.inf, *([51.6, 45.2] * 3), np.inf]
    inside = tmm.coh_tmm("s", index, thickness, 0.0, 445.0)
    outside = tmm.coh_tmm("s", index[::-1], thickness[::-1], 0.0, 445.0)
    assert found.inside[-1] == pytest.approx(inside["R"], abs=1e-9)
    assert found.outside[-1] == pytest.approx(outside["R"], abs=1e-9)
    assert found.passed[-1] == pytest.approx(outside["T"], abs=1e-9)
    steep = np.sqrt(1.0 + 0.5**2 * (2.4869**2 - 1.0)) / 2.4869
    beyond = np.mean([tmm.coh_tmm(p, index, thickness, np.arcsin(steep), 445.0)["R"] for p in "sp"])
    assert np.interp(0.5, np.linspace(0.0, 1.0, found.beyond.size), found.beyond) == pytest.approx(beyond, abs=1e-6)


def test_no_layers_are_fresnels_face() -> None:
    """Zero pairs: ((n - 1)/(n + 1))^2, and nothing is lost at any angle."""
    bare = film_of(PAPER, 0.0, {})
    assert bare.inside[-1] == pytest.approx(((2.4869 - 1.0) / (2.4869 + 1.0)) ** 2, abs=1e-12)
    np.testing.assert_allclose(bare.inside + bare.passed, 1.0, atol=1e-9)


@pytest.mark.parametrize(("pairs", "wanted"), [(2.5, 0.378), (6.5, 0.704)])
def test_the_papers_mirrors_on_their_line(pairs: float, wanted: float) -> None:
    """R(0) of the specification, mean over 18 nm; with AlN first half a pair less is the same mirror."""
    assert film_of(PAPER, pairs, {}).inside[-1] == pytest.approx(wanted, abs=1e-3)
    swapped = film_of(PAPER, pairs - 0.5, {"swapped_layers": Hidden("swapped_layers", 1.0)})
    np.testing.assert_allclose(swapped.inside, film_of(PAPER, pairs, {}).inside, atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "amount", "lossless"),
    [("lossy_layers", 0.01, False), ("oscillator_dispersion", 1.0, True), ("porous_aln", -0.1, True),
     ("interdiffused_layers", 4.0, True), ("growth_drift", 0.05, True), ("growth_wedge", 0.05, True)],
)  # fmt: skip
def test_hidden_stacks_keep_energy_and_vanish_smoothly(kind: str, amount: float, lossless: bool) -> None:
    """R + T = 1 unless it absorbs; a hundredth of the amount changes R by far less."""
    plain = film_of(PAPER, 5.5, {})
    there, little = ({kind: Hidden(kind, a)} for a in (amount, amount / 100.0))
    found = film_of(PAPER, 5.5, there, 400.0)
    total = found.inside + found.passed
    assert total.max() <= 1.0 + 1e-9
    assert bool(np.allclose(total, 1.0, atol=1e-9)) is lossless
    change = np.abs(found.inside - plain.inside).max()
    assert change > 1e-3
    if kind != "oscillator_dispersion":
        assert np.abs(film_of(PAPER, 5.5, little, 400.0).inside - plain.inside).max() < 0.05 * change
