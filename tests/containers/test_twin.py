"""The deterministic twin against closed forms, its own symmetries, and Monte Carlo."""

from __future__ import annotations

from dataclasses import replace
from weakref import ref

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.bsdf import GaussianLobe, Lambertian, Mirror, Mixture
from containers.ray_tracing.exits import Exits, Landing, make_exits
from containers.ray_tracing.field import Axis, CellField, beyond_cutoff
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.twin.cell import cell_field
from containers.ray_tracing.twin.columns import COLUMNS
from containers.ray_tracing.twin.module import ChipMap, Lights, ModuleTwin, open_array
from containers.scene import Array, Cell, Emission, Receiver, Scene, lambertian_receiver
from luxloop.errors import InputError
from tests.ray_scenes import scene

Real = NDArray[np.float64]
SIGMA = np.radians(5.0)


@pytest.fixture(scope="module")
def lambert_case() -> tuple[Scene, Exits]:
    """Golden case A: Lambert's law from the chip's top."""
    case = scene(emission=Emission(from_top=True))
    return case, make_exits(case, 1, 4 * BLOCK)


@pytest.fixture(scope="module")
def dim() -> tuple[Scene, Exits]:
    """A chip that absorbs, with notes, so that walks are short."""
    case = scene({"absorption_per_um": 2e-2})
    return case, make_exits(case, 1, 4 * BLOCK, notes=True)


def monte_carlo(case: Scene, exits: Exits, seeds: int = 4) -> tuple[Real, Real]:
    """Coefficients of the cell's field from landings with several seeds, and their error."""
    found = []
    for seed in range(seeds):
        tally = Landing(case, exits, seed, survival=1.0).run_to(exits.histories)
        field = CellField.from_bins(
            tally.cell_bins(), tally.histories, case.layout.spacing_um, case.height_um, folded=True
        )
        found.append(field.coefficients.mean(axis=0))
    return np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(seeds)


@pytest.mark.parametrize("substrate", [Mirror(0.97), GaussianLobe(0.97, SIGMA), Lambertian(0.97)])
def test_a_cell_is_that_of_monte_carlo(lambert_case: tuple[Scene, Exits], substrate: object) -> None:
    """Case A over three substrates: mean to 0.1 %, the map to 0.6 % rms, with the noise of few histories."""
    case, exits = lambert_case
    case = replace(case, substrate=substrate)  # type: ignore[arg-type]  # a Bsdf of the list above
    twin = cell_field(case, exits).coefficients.mean(axis=0)
    long, error = monte_carlo(case, exits)
    assert twin[0, 0] == pytest.approx(long[0, 0], rel=2e-3)
    assert np.sqrt(((twin - long) ** 2).sum()) / long[0, 0] < 6e-3
    assert np.abs(twin - long).max() < 6.0 * error.max() + 2e-3


def test_nothing_comes_back_from_a_black_receiver_or_a_black_substrate(lambert_case: tuple[Scene, Exits]) -> None:
    """Then all light is direct, and above a chip's Lambertian top all of it lands: mean 1 with a white substrate."""
    case, exits = lambert_case
    dark = cell_field(replace(case, receiver=lambertian_receiver(0.0)), exits, shadow=False)
    black = cell_field(replace(case, substrate=Lambertian(0.0)), exits, shadow=False)
    assert dark.mean == pytest.approx(1.0, abs=1e-6)
    assert black.mean == pytest.approx(1.0, abs=1e-6)


def test_all_light_is_a_geometric_series_of_round_trips(lambert_case: tuple[Scene, Exits]) -> None:
    """Without chips in the way the mean is 1 / (1 - rho_r rho_s)."""
    case, exits = lambert_case
    twin = cell_field(replace(case, substrate=Mirror(0.8), receiver=lambertian_receiver(0.5)), exits, shadow=False)
    assert twin.mean == pytest.approx(1.0 / (1.0 - 0.4), rel=1e-6)


def test_chips_that_absorb_take_from_the_light_sent_back() -> None:
    """Large dark chips: the mean is that of Monte Carlo to 0.5 %; without counting chips it is 4 % or more above."""
    dark = scene({"width_um": 100.0, "absorption_per_um": 0.05}, layout=Cell(300.0), emission=Emission(from_top=True))
    exits = make_exits(dark, 1, 2 * BLOCK)
    long, _ = monte_carlo(dark, exits)
    assert cell_field(dark, exits).mean == pytest.approx(long[0, 0], rel=5e-3)
    assert cell_field(dark, exits, shadow=False).mean > 1.04 * long[0, 0]


def test_the_twin_is_a_function_of_its_arguments(dim: tuple[Scene, Exits]) -> None:
    """Bit for bit the same with one thread or two."""
    case, exits = dim
    one, two = (cell_field(case, exits, threads=threads).coefficients for threads in (1, 2))
    assert np.array_equal(one, two)


@pytest.mark.parametrize("name", ["distance_um", "substrate_reflectance", "receiver_reflectance"])
def test_the_twin_is_smooth(lambert_case: tuple[Scene, Exits], name: str) -> None:
    """Derivatives of the lowest waves over a full and a quarter of the usual step agree to a tenth of the largest."""
    case, exits = lambert_case
    column = COLUMNS[name]
    step = column.step(column.value(case))
    slopes = []
    for h in (step, step / 4.0):
        ends = (cell_field(column.move(case, a), exits, shadow=False).coefficients.mean(axis=0) for a in (h, -h))
        slopes.append((np.subtract(*ends) / (2.0 * h))[:3, :3])
    assert np.abs(slopes[0] - slopes[1]).max() < 0.1 * np.abs(slopes[0]).max()


def test_a_mirror_part_of_the_receiver_is_followed(dim: tuple[Scene, Exits]) -> None:
    """A receiver of which a seventh is specular: the mean of Monte Carlo to 0.3 %."""
    case, exits = dim
    coated = replace(case, receiver=Receiver(Mixture((Lambertian(0.35), Mirror(0.35)), (6 / 7, 1 / 7))))
    long, _ = monte_carlo(coated, exits)
    assert cell_field(coated, exits).mean == pytest.approx(long[0, 0], rel=3e-3)


def test_what_the_twin_does_not_know_is_refused(dim: tuple[Scene, Exits]) -> None:
    """A tilted or walled module, a finite one asked as a cell, and a cell asked as a module."""
    case, exits = dim
    array = Array.regular(3, 3, 500.0)
    with pytest.raises(InputError, match="repeats"):
        cell_field(replace(case, layout=array), exits)
    for layout, tilt in (
        (case.layout, (0.0, 0.0)),
        (replace(array, wall=Mirror(0.5)), (0.0, 0.0)),
        (array, (1e-5, 0.0)),
    ):
        with pytest.raises(InputError, match="open edges"):
            ModuleTwin(replace(case, layout=layout, tilt_per_um=tilt), exits)


def test_a_module_too_large_for_its_height_is_refused(
    dim: tuple[Scene, Exits], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where its map could not hold its waves the sides that would do are named; where it loses faint ones it says so.

    50 x 50 chips 45 um below the receiver need 1,474 waves, got 511 of them, and said that nothing was left out.
    """
    case, exits = dim
    low = scene({"thickness_um": 55.0}, distance_um=100.0, layout=Array.regular(50, 50, 300.0))
    with pytest.raises(InputError, match="15000 x 15000 um") as caught:
        ModuleTwin(low, exits)
    side = float(caught.value.allowed.split()[3])
    open_array(replace(low, layout=Array.regular(int(side / 300.0), int(side / 300.0), 300.0)))
    nine = replace(case, layout=Array.regular(3, 3, 500.0))
    assert ModuleTwin(nine, exits, blocks=1).field().truncation == 0.0
    monkeypatch.setattr("containers.ray_tracing.twin.module.MOST_BINS", 32)
    assert ModuleTwin(nine, exits, blocks=1).field().truncation > beyond_cutoff(case.height_um)
    monkeypatch.setattr("containers.ray_tracing.twin.module.MOST_BINS", 24)
    with pytest.raises(InputError, match="higher receiver"):
        ModuleTwin(nine, exits, blocks=1)


def test_a_finite_module_is_that_of_monte_carlo(lambert_case: tuple[Scene, Exits]) -> None:
    """3 x 3 chips: light on the receiver, all and in its middle ninth, to 1.2 %."""
    case, exits = lambert_case
    finite = replace(case, layout=Array.regular(3, 3, 500.0))
    runs = [Landing(finite, exits, seed, survival=1.0).run_to(exits.histories) for seed in range(6)]
    box = runs[0].box
    long = np.mean([run.cell_bins().sum(axis=0) for run in runs], axis=0) / (runs[0].total_histories / 9)
    at = (np.arange(len(long)) + 0.5 - len(long) / 2) * box.step_um
    twin = 1e-6 * box.step_um**2 * ModuleTwin(finite, exits).mean(at, at)
    for half in (750.0, 250.0):
        inside = np.ix_(np.abs(at) < half, np.abs(at) < half)
        assert twin[inside].sum() == pytest.approx(long[inside].sum(), rel=1.2e-2)


def test_a_dense_row_hides_its_light_along_itself_only() -> None:
    """Regression: averaged with that of a row across it was 25 % too much along the row, 18 % too little beside."""
    case = scene(
        {"width_um": 60.0, "thickness_um": 60.0, "absorption_per_um": 2e-2}, receiver=lambertian_receiver(0.0)
    )
    row = replace(case, layout=replace(Array.regular(1, 9, 90.0, half_um=450.0), power=np.eye(9)[4:5]))
    exits = make_exits(row, 1, 4 * BLOCK)
    runs = [Landing(row, exits, seed, survival=1.0).run_to(exits.histories) for seed in range(2)]
    box, long = runs[0].box, np.mean([run.cell_bins().sum(axis=0) / run.total_histories for run in runs], axis=0)
    y, x = ((np.arange(count) + 0.5 - count / 2.0) * box.step_um for count in long.shape)
    twin = 1e-6 * box.step_um**2 * ModuleTwin(row, exits).mean(x, y)
    along, across = (np.abs(x) > 90.0) & (np.abs(x) < 360.0), (np.abs(y) > 90.0) & (np.abs(y) < 360.0)
    beside_x, beside_y = np.abs(x) < 45.0, np.abs(y) < 45.0
    for place in (np.ix_(beside_y, along), np.ix_(across, beside_x)):
        assert twin[place].sum() == pytest.approx(long[place].sum(), rel=2e-2)


def test_below_an_air_gap_the_substrate_takes_its_share() -> None:
    """Dense chips above 0.5: regression, of what comes back into chips it took nothing (7.7 % too much)."""
    case = scene({"bottom": "air_gap", "width_um": 100.0, "thickness_um": 20.0, "absorption_per_um": 1e-3})
    case = replace(case, substrate=Lambertian(0.5), layout=Cell(150.0), distance_um=160.0)
    exits = make_exits(case, 1, 4 * BLOCK)
    twin = cell_field(case, exits).coefficients.mean(axis=0)
    long, _ = monte_carlo(case, exits)
    assert twin[0, 0] == pytest.approx(long[0, 0], rel=1e-2)


def test_a_dead_chip_takes_its_own_light_away(dim: tuple[Scene, Exits]) -> None:
    """The map is linear in the powers, and follows chips that are displaced together."""
    case, exits = dim
    array = Array.regular(1, 3, 500.0)
    maps = {}
    for name, power in (("all", [1.0, 1.0, 1.0]), ("left", [1.0, 0.0, 0.0]), ("rest", [0.0, 1.0, 1.0])):
        lit = replace(case, layout=replace(array, power=np.array([power])))
        maps[name] = ModuleTwin(lit, exits, blocks=1, shadow_rays=0).mean(np.linspace(-700, 700, 15), np.zeros(1))
    np.testing.assert_allclose(maps["left"] + maps["rest"], maps["all"], rtol=1e-5)
    assert np.argmax(maps["left"]) < 7


@pytest.mark.parametrize("emits", [[[1.0]], [[1.0, 2.0], [3.0, 0.0]]], ids=["folded", "whole"])
def test_each_chip_lays_the_same_map_at_its_own_place(emits: list[list[float]]) -> None:
    """Under a black receiver displaced chips of several powers make the sum of the middle one's map, moved."""
    case = scene({"absorption_per_um": 2e-2}, emission=Emission(position=np.array(emits)))
    case = replace(case, receiver=lambertian_receiver(0.0))
    exits, rng = make_exits(case, 1, BLOCK), np.random.default_rng(3)
    offset = rng.uniform(-30.0, 30.0, (3, 3, 2))
    offset[1, 1] = 0.0
    several = replace(Array.regular(3, 3, 400.0), power=rng.random((3, 3)), offset_um=offset)
    middle = replace(several, power=np.eye(9)[4].reshape(3, 3))
    whole, one = (ModuleTwin(replace(case, layout=layout), exits) for layout in (several, middle))
    x, y = np.linspace(-400.0, 500.0, 7), np.linspace(-300.0, 450.0, 6)
    places = zip(several.power.ravel(), several.centres_um.reshape(-1, 2), strict=True)
    expected = sum(power * one.mean(x - cx, y - cy) for power, (cx, cy) in places)
    np.testing.assert_allclose(whole.mean(x, y), expected, rtol=1e-9)


def test_light_of_chips_that_is_remembered_is_the_same_to_the_last_bit(dim: tuple[Scene, Exits]) -> None:
    """Chips that shine or stand otherwise share it; another surface, distance or chip has its own."""
    case, exits = dim
    array, known = Array.regular(3, 3, 500.0), Lights()
    moved = replace(array, offset_um=np.full((3, 3, 2), 7.0))
    lit = replace(case, layout=array)
    others = [
        lit, replace(lit, layout=replace(array, power=np.arange(9.0).reshape(3, 3))), replace(lit, layout=moved),
        replace(lit, substrate=Lambertian(0.5)), replace(lit, distance_um=lit.distance_um + 1.0),
        replace(lit, layout=Array.regular(3, 3, 480.0)),
    ]  # fmt: skip
    x = np.linspace(-700.0, 700.0, 9)
    for one in others:
        remembered, alone = (ModuleTwin(one, exits, blocks=1, known=by).mean(x, x) for by in (known, None))
        np.testing.assert_array_equal(remembered, alone)
    assert len(known) == 4


def test_remembered_light_lasts_as_long_as_its_exits_and_within_its_room(dim: tuple[Scene, Exits]) -> None:
    """Exits that nobody else holds are not kept for it, nor is the light of others taken for theirs."""
    _, exits = dim
    axis, made = Axis(0.0, 1.0, 7, "even"), []
    light = ChipMap(np.zeros((2, 1, 8, 8)), np.zeros((2, 0, 0)), 1.0, axis, axis, 1), 0.0

    def make() -> tuple[ChipMap, float]:
        made.append(1)
        return light

    own, known = replace(exits), Lights()
    alive = ref(own)
    for _ in range(2):
        assert known.of("one", own, make) is light
    assert len(made) == 1
    known.of("one", replace(exits), make)  # others, at the same key as if by the same id
    assert len(made) == 2
    known.of("one", own, make)
    del own
    assert alive() is None
    known.of("two", exits, make)
    assert len(known) == 1
    small = Lights(most_bytes=2 * light[0].nbytes)
    for number in range(5):
        small.of(str(number), exits, make)
    assert len(small) == 2
    before = len(made)
    small.of("4", exits, make)
    assert len(made) == before
