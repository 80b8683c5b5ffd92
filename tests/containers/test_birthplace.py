"""Chips that shine unevenly, by the exits of one that shines evenly."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.acting import Effects
from containers.effects.current_crowding import CurrentCrowding
from containers.ray_tracing.exits import Exits, Landing, make_exits
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.twin.birthplace import born_as_in
from containers.ray_tracing.twin.module import ModuleTwin
from containers.ray_tracing.twin.supply import Supply
from containers.scene import Array, Scene
from luxloop.errors import InputError
from tests.ray_scenes import film_face, scene

Real = NDArray[np.float64]

AT = np.linspace(-260.0, 260.0, 27)
PLACE = (np.arange(16) + 0.5) / 16 - 0.5
UNEVEN: dict[str, Real] = {
    "rise": np.tile(1.0 + 1.9 * PLACE, (16, 1)),
    "rim": np.add.outer(PLACE**4, PLACE**4),
    "rise and rim": np.add.outer(PLACE**4, PLACE**4) * (1.0 - 1.5 * PLACE),
    "corner": np.outer(PLACE < 0.2, PLACE > -0.3).astype(float),
}
"""Weights (y, x) of places in the chip."""


@cache
def even() -> Scene:
    """Two chips by two under the paper's DBR, some absorption in them."""
    return scene({"absorption_per_um": 0.02, "top": film_face(2.5)}, layout=Array.regular(2, 2, 200.0))


def uneven(name: str) -> Scene:
    """The same with chips that shine so."""
    return replace(even(), emission=even().emission.by_place(UNEVEN[name]))


OWN, LENT = 64, 32
"""Blocks of a walk of its own, and of that of a chip that shines evenly."""


@cache
def walked(name: str = "") -> Exits:
    """Exits of a walk of its own."""
    if name:
        return make_exits(uneven(name), 12, OWN * BLOCK)
    return make_exits(even(), 11, LENT * BLOCK, notes=True)


def groups(of: Scene, exits: Exits) -> Real:
    """Maps of the module (group, y, x)."""
    return ModuleTwin(of, exits, groups=16, shadow_rays=0).of_groups(AT, AT)


def halves(maps: Real) -> tuple[Real, Real]:
    """The means of half the groups each."""
    return maps[0::2].mean(axis=0), maps[1::2].mean(axis=0)


@pytest.mark.parametrize("name", UNEVEN)
def test_the_map_is_that_of_a_walk_of_its_own(name: str) -> None:
    """Along what it changes of an even chip's map, and with no more noise than that has beside its weights; a walk of
    its own without the symmetries has several times as much."""
    of = uneven(name)
    own, lent, alike = groups(of, walked(name)), groups(of, born_as_in(of, [walked()])), groups(even(), walked())
    (one, other), even_one = halves(lent - alike), halves(alike)[0]  # whose noise is independent
    found, lent_alone = (
        maps.reshape(len(maps), -1) @ other.ravel() / (one * other).sum()
        for maps in (own - even_one, (lent - alike)[0::2])
    )
    error = np.sqrt(sum(some.var(ddof=1) / len(some) for some in (found, lent_alone)))
    assert error < 0.1
    assert found.mean() == pytest.approx(1.0, abs=4.0 * error)
    noise = {what: maps.var(axis=0, ddof=1).mean() for what, maps in (("own", own), ("lent", lent), ("even", alike))}
    weight = of.emission.position / of.emission.position.mean()
    assert noise["lent"] < 1.5 * noise["even"] * np.mean(weight**2)
    if not of.emission.symmetric:
        assert noise["lent"] < 0.6 * noise["own"] * OWN / LENT


def test_light_is_neither_made_nor_lost() -> None:
    """The mean over the module is an even chip's, but for what another place of birth does to it."""
    of = uneven("rise")
    lent, alike = (ModuleTwin(one, exits, shadow_rays=0).mean(AT, AT) for one, exits in
                   ((of, born_as_in(of, [walked()])), (even(), walked())))  # fmt: skip
    assert lent.mean() == pytest.approx(alike.mean(), rel=0.02)
    np.testing.assert_allclose(lent + lent[:, ::-1], alike + alike[:, ::-1], rtol=1e-3)


def test_images_of_an_even_emission_are_the_folded_map() -> None:
    """Eight weights of 1 make the map that folded bins make."""
    plain = groups(even(), walked())
    position = np.ones((4, 4))
    position[0, 0] = 1.0 + 1e-12
    nearly = replace(even(), emission=replace(even().emission, position=position))
    assert not nearly.emission.symmetric
    found = groups(nearly, born_as_in(nearly, [walked()]))
    np.testing.assert_allclose(found, plain, rtol=1e-4)


def test_a_small_change_makes_a_small_one() -> None:
    """The map is a straight line in the rise: a hundredth makes a hundredth of it, with no noise of its own."""
    supply = Supply(lambda wanted: make_exits(wanted, 11, BLOCK, notes=True))
    base = even()

    def at(rise: float) -> Any:
        of = Effects((CurrentCrowding(rise=rise, rim=0.0),)).scene(base)
        return ModuleTwin(of, supply.of(of, base), shadow_rays=0).mean(AT, AT)

    step, whole = at(0.31) - at(0.3), at(0.6) - at(0.3)
    np.testing.assert_allclose(step * 30.0, whole, atol=1e-3 * np.abs(whole).max())


def test_sets_of_exits_leave_less_noise() -> None:
    """What unevenness adds has the noise of all sets together, the even chip's light that of the first."""
    of, sets = uneven("corner"), [make_exits(even(), 20 + n, LENT * BLOCK, notes=True) for n in range(8)]
    alike = groups(even(), sets[0])
    one, all_of_them = (groups(of, born_as_in(of, [*some])) - alike for some in (sets[:1], sets))
    np.testing.assert_allclose(all_of_them.mean(), one.mean(), atol=0.02 * np.abs(one).max())
    ratio = all_of_them.var(axis=0, ddof=1).mean() / one.var(axis=0, ddof=1).mean()
    assert 1.0 / 16.0 < ratio < 1.0 / 5.0


def test_one_walk_serves_all_of_them() -> None:
    """Chips that shine unevenly, also with another absorption, are walked in once, evenly lit."""
    walks: list[Scene] = []

    def make(wanted: Scene) -> Exits:
        walks.append(wanted)
        return make_exits(wanted, 11, BLOCK, notes=True)

    supply, base = Supply(make), uneven("rise and rim")
    own, rim = supply.of(base).births, supply.of(uneven("rim"), base).births
    assert own is not None
    assert rim is not None
    np.testing.assert_allclose([own.weights.mean(), rim.weights.mean()], 1.0)
    lossy = replace(base, chip=replace(base.chip, absorption_per_um=0.021))
    moved = supply.of(lossy, base)
    assert moved.births is not None
    np.testing.assert_array_equal(moved.births.weights, own.weights)
    assert moved.weights is not None
    assert moved.weights.max() < 1.0
    assert len(walks) == 1
    assert walks[0].emission.symmetric


def test_landing_refuses_what_only_direct_light_knows() -> None:
    """Its histories would be those of an even chip."""
    of = uneven("corner")
    with pytest.raises(InputError, match="make_exits"):
        Landing(of, born_as_in(of, [walked()]), 1)


def test_a_row_of_chips_has_the_symmetries_of_a_rectangle() -> None:
    """Images whose x and y are exchanged would have other neighbours."""
    row = replace(even(), layout=Array.regular(1, 5, 40.0))
    along = replace(row, emission=row.emission.by_place(UNEVEN["rise"]))
    across = replace(row, emission=row.emission.by_place(UNEVEN["rise"].T))
    for of in (along, across):
        own = make_exits(of, 12, OWN * BLOCK)
        lent = born_as_in(of, [walked()])
        maps = [ModuleTwin(of, exits, groups=16, shadow_rays=0).of_groups(AT, AT) for exits in (own, lent)]
        change = maps[1].mean(axis=0) - ModuleTwin(row, walked(), groups=16, shadow_rays=0).of_groups(AT, AT).mean(
            axis=0
        )
        off = (maps[0] - maps[1].mean(axis=0)).reshape(16, -1) @ change.ravel() / (change**2).sum()
        assert abs(off.mean()) < 4.0 * off.std(ddof=1) / 4.0 + 0.03
