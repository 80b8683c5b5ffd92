"""Stored exits of one chip that stand for another's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.bsdf import Bsdf, GaussianLobe, Lambertian, Mixture, SpecularTable
from containers.effects.dbr_absorption import DbrAbsorption
from containers.ray_tracing.arrays import THROUGH_TOP, TRACE
from containers.ray_tracing.build import film_faces
from containers.ray_tracing.exits import Exits, chip_key, make_exits
from containers.ray_tracing.kernel import EVENT_OF_EXIT, WEIGHT_OF_EXIT
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.twin.reweighting import lender_of, reweighted
from containers.ray_tracing.twin.supply import Supply
from containers.scene import Face, Scene
from containers.thin_film.table import film_table
from luxloop.errors import InputError
from luxloop.film import Grid
from luxloop.model import Environment
from tests.films import film
from tests.ray_scenes import N, scene

Real = NDArray[np.float64]
SIGMA = np.radians(5.0)


def top(R: float, beyond: float = 1.0) -> Face:
    """A top that reflects alike inside its escape cone, and `beyond` in the middle between that and grazing."""
    critical = np.arcsin(1.0 / N)
    theta = np.array([0.0, critical, critical + 1e-9, (critical + np.pi / 2) / 2, np.pi / 2])
    kept, through = np.array([R, R, 1.0, beyond, 1.0]), np.array([1.0 - R, 1.0 - R, 0.0, 0.0, 0.0])
    inside = SpecularTable(theta, kept, through, N)
    return Face((inside,), (SpecularTable(np.array([0.0]), np.array([R]), np.array([1.0 - R]), 1.0 / N),))


def face(pairs: float, k: float = 0.0, roughness_nm: float = 0.0) -> Face:
    """The paper's DBR, whose AlN absorbs, or whose faces are rough."""
    if k:
        stack = DbrAbsorption(extinction=k).stack(film(pairs).stack)
        return film_faces(Environment(), film_table(stack, grid=Grid(wavelengths=21)))
    return film_faces(Environment(), film(pairs, roughness_nm))


def leaving(exits: Exits) -> Real:
    """(group, kind): light that leaves per history: all, upwards, steeply upwards, straight through the top."""
    weight = exits.rays[:, WEIGHT_OF_EXIT] * (1.0 if exits.weights is None else exits.weights)
    up = exits.rays[:, 5]
    kinds = [weight, weight * (up > 0.0), weight * (up > 0.7), weight * (exits.rays[:, EVENT_OF_EXIT] == THROUGH_TOP)]
    groups = [np.add.reduceat(kind.astype(float), exits.ends[:, 0]) for kind in kinds]
    return np.stack(groups, axis=1) / exits.histories


CHANGES = {
    "bottom": lambda s: replace(s, substrate=GaussianLobe(0.955, SIGMA)),
    "absorption": lambda s: replace(s, chip=replace(s.chip, absorption_per_um=2e-3)),
    "absorption above": lambda s: replace(
        s, chip=replace(s.chip, absorption_per_um=4e-3, absorption_rise_per_um=4e-3)
    ),
    "absorption below": lambda s: replace(
        s, chip=replace(s.chip, absorption_per_um=4e-3, absorption_rise_per_um=-4e-3)
    ),
    "top": lambda s: replace(s, chip=replace(s.chip, top=top(0.45))),
    "loss beyond the critical angle": lambda s: replace(s, chip=replace(s.chip, top=top(0.38, 0.95))),
    "all": lambda s: replace(
        s,
        substrate=GaussianLobe(0.98, SIGMA),
        chip=replace(s.chip, absorption_per_um=0.5e-3, absorption_rise_per_um=0.3e-3, top=top(0.35, 0.99)),
    ),
}


@pytest.fixture(scope="module")
def stored() -> tuple[Scene, Exits]:
    """A chip with some absorption and a half-reflecting top, and its exits."""
    own = scene({"absorption_per_um": 1e-3, "top": top(0.38)})
    return own, make_exits(own, 3, 4 * BLOCK, notes=True)


@pytest.mark.parametrize("change", CHANGES)
def test_reweighted_exits_carry_the_light_of_the_other_chip(stored: tuple[Scene, Exits], change: str) -> None:
    """Light that leaves, by direction, is that of a full walk in the changed chip, and not the stored one's."""
    own, exits = stored
    other = CHANGES[change](own)
    full, got = leaving(make_exits(other, 4, 4 * BLOCK)), leaving(reweighted(exits, own, other).exits)
    error = np.sqrt((full.var(axis=0, ddof=1) + got.var(axis=0, ddof=1)) / len(full))
    assert np.all(np.abs(got.mean(axis=0) - full.mean(axis=0)) < 4.0 * error)
    moved = np.abs(leaving(exits).mean(axis=0) - full.mean(axis=0))
    assert np.max(moved / error) > 8.0


def test_no_change_is_no_change(stored: tuple[Scene, Exits]) -> None:
    """The same chip has weights of exactly 1 and all its exits."""
    own, exits = stored
    same = reweighted(exits, own, replace(own, distance_um=150.0))
    assert same.exits.weights is not None
    assert np.array_equal(same.exits.weights, np.ones(len(exits.rays), np.float32))
    assert same.effective_share == 1.0
    assert same.inexact_share == 0.0


def test_weights_multiply_along_a_chain_of_changes(stored: tuple[Scene, Exits]) -> None:
    """By way of a chip in between the weights are the same as directly."""
    own, exits = stored
    between, last = CHANGES["absorption"](own), CHANGES["absorption"](CHANGES["bottom"](own))
    direct = reweighted(exits, own, last).exits.weights
    chained = reweighted(reweighted(exits, own, between).exits, between, last).exits.weights
    assert direct is not None
    assert chained is not None
    np.testing.assert_allclose(chained, direct, rtol=1e-5)


def test_larger_changes_leave_fewer_effective_exits(stored: tuple[Scene, Exits]) -> None:
    """The effective share falls with the change, and rays with many reflections at a changed top are counted."""
    own, exits = stored
    shares = [
        reweighted(exits, own, replace(own, chip=replace(own.chip, absorption_per_um=a))).effective_share
        for a in (1.1e-3, 2e-3, 5e-3)
    ]
    assert 1.0 > shares[0] > shares[1] > shares[2] > 0.0
    assert 0.0 < reweighted(exits, own, CHANGES["top"](own)).inexact_share < 0.05
    assert reweighted(exits, own, CHANGES["bottom"](own)).inexact_share == 0.0


@pytest.mark.parametrize(
    "other",
    [
        lambda s: replace(s, chip=replace(s.chip, width_um=29.0)),
        lambda s: replace(s, substrate=GaussianLobe(0.97, 2.0 * SIGMA)),
        lambda s: replace(s, emission=replace(s.emission, layer_depth=0.5)),
    ],
)
def test_a_chip_that_the_notes_do_not_know_is_refused(stored: tuple[Scene, Exits], other: object) -> None:
    """Another width, lobe or emission raises InputError."""
    own, exits = stored
    with pytest.raises(InputError, match="make the exits of this chip"):
        reweighted(exits, own, other(own))  # type: ignore[operator]  # a lambda of the list above


def test_exits_without_notes_are_refused(stored: tuple[Scene, Exits]) -> None:
    """There is nothing to reckon from."""
    own, exits = stored
    with pytest.raises(InputError, match="notes=True"):
        reweighted(replace(exits, notes=np.zeros((0, TRACE), np.float32)), own, own)


ROUGH = GaussianLobe(0.97, np.radians(20.0))


@pytest.mark.parametrize(
    ("bottom", "lent"),
    [
        (ROUGH, replace(ROUGH, reflectance=0.9)),
        (
            Mixture((ROUGH, Lambertian(0.97)), (0.5, 0.5)),
            Mixture((replace(ROUGH, reflectance=0.9), Lambertian(0.9)), (0.5, 0.5)),
        ),
    ],
)
def test_a_chip_between_two_has_all_that_is_noted_of_the_one(bottom: Bsdf, lent: Bsdf) -> None:
    """Absorption, top and the bottom's reflectance of the one; what scatters, and the sides, of the other."""
    one = replace(CHANGES["all"](scene()), substrate=GaussianLobe(0.9, SIGMA))
    other = scene({"sides": top(0.2)}, substrate=bottom)
    between = lender_of(other, one)
    expected = replace(
        other, substrate=lent,
        chip=replace(
            other.chip, top=one.chip.top, absorption_per_um=one.chip.absorption_per_um,
            absorption_rise_per_um=one.chip.absorption_rise_per_um,
        ),
    )  # fmt: skip
    assert chip_key(between) == chip_key(expected)
    exits = make_exits(between, 3, BLOCK, notes=True)
    assert reweighted(exits, between, other).effective_share > 0.5
    assert chip_key(lender_of(one, one)) == chip_key(one)


def test_films_that_absorb_are_walked_below_one_that_takes_nothing_beyond_the_critical_angle() -> None:
    """Be such a film's chip the wanted one, or the one whose exits are lent."""
    plain, lossy = (scene({"absorption_per_um": 1e-3, "top": face(2.5, k=k)}) for k in (0.0, 0.005))
    walks: list[Scene] = []
    supply = Supply(lambda s: (walks.append(s), make_exits(s, 3, BLOCK, notes=True))[1])
    found = [supply.of(lossy), supply.of(plain, lossy), supply.of(lossy, plain)]
    assert walks
    for one in walks:
        (inside,), n = one.chip.top.inside, float(one.chip.index[0])
        beyond = np.linspace(np.arcsin(1.0 / n) + 1e-3, np.pi / 2, 50)
        np.testing.assert_allclose(inside.deltas(beyond).mirror, 1.0, atol=1e-9)
    weights = [float(leaving(one).mean(axis=0)[0]) for one in found]
    own = leaving(make_exits(lossy, 4, 16 * BLOCK))
    for lent in (weights[0], weights[2]):
        assert lent == pytest.approx(own.mean(axis=0)[0], abs=0.01 * weights[1])
    assert weights[1] > 1.01 * weights[0]


def test_a_chip_of_another_index_keeps_its_own_top() -> None:
    """A top is a table by the angle inside one material."""
    one = replace(scene(), chip=replace(scene().chip, top=top(0.45)))
    other = scene({"index": np.array([2.3])})
    assert lender_of(other, one).chip.top is other.chip.top


def test_chips_on_a_mirror_have_one_chip_between_whatever_lies_below_it() -> None:
    """One coat moves the mirror and the substrate; no light of the chip comes to the substrate."""
    one, other = (scene({"bottom": "mirror", "mirror": GaussianLobe(r, SIGMA)}) for r in (0.97, 0.9))
    upwards = replace(one.emission, intensity=np.array([0.9, 1.1]))
    moved = [replace(other, emission=upwards, substrate=GaussianLobe(r, SIGMA)) for r in (0.9, 0.91)]
    keys = {chip_key(lender_of(wanted, one)) for wanted in moved}
    assert keys == {chip_key(replace(one, emission=upwards))}


@pytest.mark.parametrize(
    ("pairs", "changes"), [(2.5, {"k": 0.005}), (5.5, {"k": 0.002}), (5.5, {"roughness_nm": 4.0})]
)
def test_a_film_that_absorbs_or_is_rough_has_no_walks_of_its_own(pairs: float, changes: dict[str, float]) -> None:
    """Fringes beyond the critical angle and all; the film that takes no light there lends its exits."""
    plain, other = (scene({"absorption_per_um": 1e-3, "top": face(pairs, **some)}) for some in ({}, changes))
    exits = make_exits(plain, 3, 4 * BLOCK, notes=True)
    full, lent = leaving(make_exits(other, 4, 16 * BLOCK)), leaving(reweighted(exits, plain, other).exits)
    error = np.sqrt((full.var(axis=0, ddof=1) + lent.var(axis=0, ddof=1)) / len(full))
    np.testing.assert_array_less(np.abs(lent.mean(axis=0) - full.mean(axis=0)), 4.0 * error)
    if "k" in changes:  # roughness turns light, and takes none
        assert np.max(np.abs(leaving(exits).mean(axis=0) - full.mean(axis=0)) / error) > 8.0
    back = reweighted(make_exits(other, 3, 4 * BLOCK, notes=True), other, plain)
    again = leaving(make_exits(plain, 4, 16 * BLOCK))
    error = np.sqrt((again.var(axis=0, ddof=1) + leaving(back.exits).var(axis=0, ddof=1)) / len(again))
    np.testing.assert_array_less(np.abs(leaving(back.exits).mean(axis=0) - again.mean(axis=0)), 4.0 * error)
