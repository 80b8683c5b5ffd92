"""Stored exits: what decides them, what they are landed on, and that it is the light of the full walk."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.bsdf import GaussianLobe, Lambertian, Mirror
from containers.ray_tracing.exits import Exits, Landing, chip_key, make_exits
from containers.ray_tracing.monte_carlo import BLOCK, MonteCarlo
from containers.ray_tracing.packing import emission_arrays
from containers.ray_tracing.tally import Box, Tally
from containers.ray_tracing.twin.direct import direct_light, open_way
from containers.scene import Array, Cell, Emission, Receiver, Scene, lambertian_receiver
from luxloop.errors import InputError
from tests.ray_scenes import bare, film_face, illuminance, launched, mean_and_error, mode, scene, with_chip

GROUPS = 32
MODES = [(0, 0), (1, 0), (1, 1), (2, 0)]


@cache
def exits_of_plain(seed: int = 1, blocks: int = 2) -> Exits:
    """Exits of the golden chip."""
    return make_exits(scene(), seed, blocks * BLOCK)


def landed(of: Scene, exits: Exits, seed: int = 3, histories: int | None = None, **options: Any) -> Tally:
    """All the exits, or those of so many histories of each group, in a scene."""
    return Landing(of, exits, seed, **options).run_to(histories or exits.histories)


def same_bits(a: Tally, b: Tally) -> bool:
    """Whether bins, ledgers and arrivals are equal to the last bit."""
    return (
        np.array_equal(a.bins, b.bins)
        and np.array_equal(a.ledger, b.ledger)
        and np.array_equal(a.arrivals, b.arrivals)
    )


def agree(a: Tally, b: Tally, most: float = 4.0) -> None:
    """Low modes and all ends of two tallies, within combined standard errors."""
    pairs = [(mode(a, *m), mode(b, *m)) for m in MODES]
    pairs += [(a.ledger[:, end] / a.histories, b.ledger[:, end] / b.histories) for end in range(6)]
    pairs += [(a.arrivals[:, event] / a.histories, b.arrivals[:, event] / b.histories) for event in range(4)]
    for ours, theirs in pairs:
        (x, e), (y, f) = mean_and_error(ours), mean_and_error(theirs)
        assert abs(x - y) <= most * np.hypot(e, f) + 1e-9, (x, y, e, f)


def test_stored_exits_give_each_chip_its_share() -> None:
    """Light straight up from chips of powers 1, 2, 3: the counts on the receiver are right to two, group by group."""
    of = scene(
        layout=replace(Array.regular(1, 3, 300.0), power=np.array([[1.0, 2.0, 3.0]])),
        receiver=Receiver(Lambertian(0.0)),
    )
    tally = launched(of, np.tile([0.0, 0.0, 40.0], (6000, 1)), [0.0, 0.0, 1.0], groups=4)
    bins = tally.cell_bins().sum(axis=1)
    x_um = tally.box.x0_um + (np.arange(bins.shape[1]) + 0.5) * tally.box.step_um
    for group in bins:
        counts = [group[np.abs(x_um - at) < 100.0].sum() for at in (-300.0, 0.0, 300.0)]
        assert counts == pytest.approx([250.0, 500.0, 750.0], abs=2.0)


def test_the_light_of_a_module_is_the_same_however_its_chips_take_turns() -> None:
    """Chips of unlike powers, two of them displaced: drawn evenly, by chance, or in turn; all light from the receiver
    followed, or a part of it. First and later light above each chip, and all ends."""
    offset_um = np.array([[(20.0, 0.0), (0.0, -15.0), (0.0, 0.0)]])
    of = scene(
        layout=replace(Array.regular(1, 3, 300.0), power=np.array([[1.0, 2.0, 3.0]]), offset_um=offset_um),
        receiver=lambertian_receiver(0.6),
    )
    even = MonteCarlo(of, 1).run_to(4096)
    x_um = even.box.x0_um + (np.arange(even.bins.shape[3]) + 0.5) * even.box.step_um

    def lots(tally: Tally) -> list[Any]:
        above = [np.abs(x_um - at) < 100.0 for at in (-280.0, 0.0, 300.0)]
        light = [tally.bins[:, layer][:, :, chip].sum(axis=(1, 2)) for layer in (0, 1) for chip in above]
        return [one / tally.histories for one in (*light, *tally.ledger.T[:6])]

    others = MonteCarlo(of, 2, sobol=False, survival=0.35).run_to(4096), landed(of, make_exits(of, 7, 4 * BLOCK))
    for other in others:
        for ours, theirs in zip(lots(even), lots(other), strict=True):
            (x, e), (y, f) = mean_and_error(ours), mean_and_error(theirs)
            assert abs(x - y) <= 4.5 * np.hypot(e, f) + 1e-9


def test_a_smaller_set_is_the_beginning_of_a_larger_one() -> None:
    """Group by group, to the last bit: rays, notes and ledgers."""
    small, large = (make_exits(scene(), 5, blocks * BLOCK, groups=4, notes=True) for blocks in (1, 3))
    for group in range(4):
        begin, end = large.ends[group, 0], large.ends[group, 1]
        own = slice(small.ends[group, 0], small.ends[group, 1])
        assert np.array_equal(small.rays[own], large.rays[begin:end])
        assert np.array_equal(small.notes[own], large.notes[begin:end])
    assert np.array_equal(small.ledger, large.ledger[:, :1])


def test_a_later_batch_is_the_end_of_a_larger_set() -> None:
    """`first_block` says where a batch begins, whoever made what before it."""
    whole, batch = make_exits(scene(), 5, 3 * BLOCK, groups=4), make_exits(scene(), 5, BLOCK, first_block=2, groups=4)
    for group in range(4):
        assert np.array_equal(
            whole.rays[whole.ends[group, 2] : whole.ends[group, 3]], batch.rays[slice(*batch.ends[group])]
        )
        assert np.array_equal(whole.numbers(group, range(2, 3)), batch.numbers(group, range(1)))
    assert np.array_equal(whole.ledger[:, 2:], batch.ledger)


def test_exits_are_a_function_of_chip_seed_and_count() -> None:
    """The same bits from one thread and two, for any D and S; other bits for another seed."""
    a = exits_of_plain(1)
    again = make_exits(scene(distance_um=100.0, layout=Cell(300.0)), 1, 2 * BLOCK, threads=1)
    assert np.array_equal(a.rays, again.rays)
    assert np.array_equal(a.ends, again.ends)
    assert np.array_equal(a.ledger, again.ledger)
    assert not np.array_equal(a.rays[:100], exits_of_plain(2).rays[:100])


def some_of(exits: Exits, kept: NDArray[np.bool_]) -> Exits:
    """The same walk with some of its exits (exit,) lost."""
    return replace(
        exits, rays=exits.rays[kept], notes=exits.notes[kept], ends=np.concatenate([[0], np.cumsum(kept)])[exits.ends]
    )


def test_an_exit_goes_its_way_whatever_becomes_of_others() -> None:
    """Lost exits change nothing but their own light: what a third and the rest make adds up to what all make.

    So chips that differ a little, and lose other light inside, have noise in common in all that both send out.
    """
    of = scene(layout=Array.regular(2, 2, 400.0))
    exits = make_exits(of, 4, 2 * BLOCK, notes=True)
    third = np.random.default_rng(8).random(len(exits.rays)) < 1.0 / 3.0
    parts = [some_of(exits, kept) for kept in (third, ~third)]
    numbers = [np.concatenate([one.numbers(5, range(2)) for one in some]) for some in ([exits], parts)]
    assert np.array_equal(numbers[0], np.sort(numbers[1]))
    assert numbers[0].max() < 2 * BLOCK
    by_part = [landed(of, one).bins for one in parts]
    assert np.abs(by_part[0]).sum() > 0.0
    np.testing.assert_allclose(sum(by_part), landed(of, exits).bins, rtol=1e-9, atol=1e-12)
    way, lit = open_way(of, Box.of(of)), emission_arrays(of)
    twins = [direct_light(way, lit, one, 3).bins for one in (exits, *parts)]
    np.testing.assert_allclose(twins[1] + twins[2], twins[0], rtol=1e-9, atol=1e-12)


def test_landing_part_of_a_set_is_landing_the_smaller_set() -> None:
    """And landing in two calls is landing in one, to the last bit, on one thread or two."""
    one, two = exits_of_plain(1, 1), exits_of_plain(1, 2)
    assert same_bits(landed(scene(), one), landed(scene(), two, histories=BLOCK))
    parts = Landing(scene(), two, 3, threads=1)
    parts.run_to(BLOCK)
    assert same_bits(parts.run_to(2 * BLOCK), landed(scene(), two))


def test_what_is_outside_the_chip_does_not_change_its_key() -> None:
    """D, S, the array, the receiver and its tilt."""
    key = chip_key(scene())
    tilted = scene(layout=Array.regular(2, 2, 300.0), tilt_per_um=(1e-4, 0.0))
    spread = scene(receiver=Receiver(Lambertian(0.5), spread_share=0.5, spread_um=9.0, response=np.array([0.5, 1.0])))
    for other in (
        scene(distance_um=100.0),
        scene(layout=Cell(300.0)),
        scene(receiver=lambertian_receiver(0.1)),
        tilted,
        spread,
    ):
        assert chip_key(other) == key


CHANGES: dict[str, Scene] = {
    "width": scene({"width_um": 29.0}),
    "thickness": scene({"thickness_um": 36.0}),
    "index": scene({"index": np.array([2.4])}),
    "absorption": scene({"absorption_per_um": 1e-6}),
    "film": scene({"top": film_face(5.5)}),
    "another film": scene({"top": film_face(6.5)}),
    "sides": scene({"sides": bare(2.5)}),
    "bottom": scene({"bottom": "air_gap"}),
    "mirror": scene({"bottom": "mirror", "mirror": Mirror(0.9)}),
    "another mirror": scene({"bottom": "mirror", "mirror": Mirror(0.91)}),
    "sigma": scene(substrate=GaussianLobe(0.97, np.radians(5.1))),
    "substrate": scene(substrate=GaussianLobe(0.96, np.radians(5.0))),
    "layer": scene(emission=Emission(layer_depth=0.5)),
    "another layer": scene(emission=Emission(layer_depth=0.51)),
    "directions": scene(emission=Emission(intensity=np.array([1.0, 1.1]))),
    "place": scene(emission=Emission(position=np.array([[1.0, 1.1]]))),
    "from the top": scene(emission=Emission(from_top=True)),
}


def test_whatever_decides_the_exits_changes_the_key() -> None:
    """W, T, index, absorption, film, sides, bottom, sigma, substrate, emission: no two have the same."""
    keys = {chip_key(of) for of in (scene(), *CHANGES.values())}
    assert len(keys) == 1 + len(CHANGES)


LARGE = {"width_um": 100.0, "thickness_um": 20.0}
LANDED: dict[str, Scene] = {
    "case B": scene(),
    "close and dense": scene(distance_um=100.0, layout=Cell(300.0)),
    "far and sparse": scene(distance_um=180.0, layout=Cell(700.0)),
    "large chip, much light returns": scene(
        LARGE, distance_um=100.0, layout=Cell(300.0), receiver=lambertian_receiver(0.8)),
    "large absorbing chip with film": scene(
        {**LARGE, "absorption_per_um": 0.02, "top": film_face(5.5)}, distance_um=100.0, layout=Cell(300.0)),
    "mirror bottom": scene(
        {"absorption_per_um": 0.02, "bottom": "mirror", "mirror": Mirror(0.97)}, emission=Emission(layer_depth=0.99)),
    "from the top": scene(emission=Emission(from_top=True)),
    "air gap": scene({"bottom": "air_gap", "absorption_per_um": 0.01}),
}  # fmt: skip


@pytest.mark.parametrize("name", LANDED)
def test_landed_exits_are_the_light_of_the_full_walk(name: str) -> None:
    """Modes, ends and optical events agree within four combined standard errors; the ledger is closed."""
    of = LANDED[name]
    a, b = landed(of, make_exits(of, 11, 4 * BLOCK)), MonteCarlo(of, 12).run_to(4 * BLOCK)
    agree(a, b)
    assert abs(a.ledger_defect) < 1e-6  # exits are single precision


def test_one_set_serves_many_distances_and_pitches() -> None:
    """Made once, landed on three modules: each as the full walk has it."""
    exits = exits_of_plain(1, 4)
    for distance, spacing in ((60.0, 300.0), (120.0, 700.0), (180.0, 500.0)):
        of = scene(distance_um=distance, layout=Cell(spacing))
        agree(landed(of, exits), MonteCarlo(of, 2).run_to(4 * BLOCK))


def test_exits_land_on_a_finite_array_too() -> None:
    """Chips by their powers, an open edge, a tilt."""
    layout = replace(Array.regular(2, 3, 300.0), power=np.array([[1.0, 0.0, 2.0], [0.5, 1.0, 1.0]]))
    of = scene(layout=layout, tilt_per_um=(4e-4, -2e-4))
    a, b = landed(of, exits_of_plain(1, 4)), MonteCarlo(of, 2).run_to(4 * BLOCK)
    for end in range(6):
        (x, e), (y, f) = (mean_and_error(tally.ledger[:, end] / tally.histories) for tally in (a, b))
        assert abs(x - y) <= 4.0 * np.hypot(e, f) + 1e-9, end
    for axis in (2, 3):  # the first moments of the map
        both = []
        for tally in (a, b):
            place = np.arange(tally.bins.shape[axis]) - tally.bins.shape[axis] / 2.0 + 0.5
            along = tally.bins.sum(axis=(1, 5 - axis)) / tally.histories
            both.append(mean_and_error(along @ place))
        (x, e), (y, f) = both
        assert abs(x - y) < 4.0 * np.hypot(e, f)


@pytest.mark.parametrize("distance", [60.0, 180.0])
def test_the_stated_error_holds_the_exits_own_sampling(distance: float) -> None:
    """Over 40 seeds the spread of the mean and of mode (1, 0) is what each landing states of itself."""
    of = scene({"absorption_per_um": 0.005}, distance_um=distance)
    found, stated = [], []
    for seed in range(40):
        tally = landed(of, make_exits(of, 100 + seed, BLOCK), seed=200 + seed)
        values = [mean_and_error(mode(tally, *m)) for m in ((0, 0), (1, 0))]
        found.append([mean for mean, _ in values])
        stated.append([error for _, error in values])
    ratio = np.std(found, axis=0, ddof=1) / np.sqrt(np.mean(np.square(stated), axis=0))
    assert np.all((ratio > 0.65) & (ratio < 1.4)), ratio


def test_landing_again_with_another_seed_shows_less_than_the_stated_error() -> None:
    """The landing's own dice are only part of it: a spread over landing seeds alone would state too little."""
    of, exits = scene({"absorption_per_um": 0.005}), make_exits(scene({"absorption_per_um": 0.005}), 1, BLOCK)
    tallies = [landed(of, exits, seed=seed) for seed in range(12)]
    over_landings = np.std([mode(tally, 0, 0).mean() for tally in tallies], ddof=1)
    assert over_landings < np.mean([mean_and_error(mode(tally, 0, 0))[1] for tally in tallies])
    assert len({illuminance(tally).tobytes() for tally in tallies}) == 12


def test_more_histories_than_are_stored_are_refused() -> None:
    """Not a map that is too dark."""
    with pytest.raises(InputError, match="exits"):
        landed(scene(), exits_of_plain(1, 1), histories=2 * BLOCK)


def test_histories_that_are_no_whole_block_are_refused() -> None:
    """Landing counts blocks, and so does making."""
    with pytest.raises(InputError, match="exits"):
        landed(scene(), exits_of_plain(1, 2), histories=BLOCK + 500)
    for histories in (100, 0, BLOCK + 1):
        with pytest.raises(InputError, match="histories"):
            make_exits(scene(), 1, histories)


def test_the_weight_of_an_exit_is_that_of_its_light() -> None:
    """Stored and landed in single precision: what arrives first is what left, less what the module took."""
    of = with_chip(scene(receiver=lambertian_receiver(0.0), substrate=GaussianLobe(1.0, 0.1)), absorption_per_um=0.01)
    exits = make_exits(of, 1, BLOCK)
    tally = landed(of, exits, fan=1)
    left = exits.rays[:, 8].astype(float).sum() / (GROUPS * BLOCK)
    into_chips = tally.ledger_per_history["chip"] - exits.ledger.sum(axis=(0, 1))[0] / (GROUPS * BLOCK)
    assert illuminance(tally).mean() == pytest.approx(left - into_chips + tally.ledger_per_history["roulette"]
        - exits.ledger.sum(axis=(0, 1))[6] / (GROUPS * BLOCK), abs=1e-6)  # fmt: skip
