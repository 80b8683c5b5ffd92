"""The walk outside the chips: photometry's laws, the lattice, edges, tilts, dead and displaced chips."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.bsdf import Lambertian, Mirror
from containers.ray_tracing.arrays import CHIP_X, CHIP_Y, DX, DY, DZ, ENDS, RAY, X, Y, Z
from containers.ray_tracing.module import _find_chip, _next
from containers.ray_tracing.monte_carlo import MonteCarlo
from containers.ray_tracing.packing import scene_arrays
from containers.ray_tracing.tally import Tally
from containers.scene import Array, Cell, Emission, Scene, lambertian_receiver
from tests.ray_scenes import N, black, lambert_up, launched, mean_and_error, scene

Real = NDArray[np.float64]
SMALL: dict[str, Any] = {"width_um": 2.0, "thickness_um": 5.0}
ONE = Array.regular(1, 1, 600.0)


def places(tally: Tally) -> tuple[Real, Real]:
    """Centres of the columns and of the rows of bins, um."""
    x0, x1, y0, y1 = tally.box.ends_um
    half = tally.box.step_um / 2.0
    return np.arange(x0 + half, x1, 2.0 * half), np.arange(y0 + half, y1, 2.0 * half)


def within(tally: Tally, x: float, y: float) -> float:
    """Share of the emitted light that arrived in |x| < `x`, |y| < `y`."""
    columns, rows = (np.abs(at) < end for at, end in zip(places(tally), (x, y), strict=True))
    return float(tally.cell_bins().sum(axis=0)[np.ix_(rows, columns)].sum() / tally.total_histories)


def lambertian_share(x: Real, y: Real, h: Real) -> Real:
    """E of a small Lambertian source of flux 1: h^2 / (pi (r^2 + h^2)^2), inverse square and two cosines."""
    return np.asarray(h**2 / (np.pi * (x**2 + y**2 + h**2) ** 2))


@pytest.mark.parametrize("distance", [60.0, 120.0])
def test_inverse_square_and_cos4_below_the_receiver(distance: float) -> None:
    """A small Lambertian chip top over black: E(0) falls as 1/h^2, E(theta) = E(0) cos^4 theta."""
    of = black(chip_changes=SMALL, layout=ONE, distance_um=distance, emission=Emission(from_top=True))
    tally = MonteCarlo(of, 3).run_to(32_768)
    columns, rows = places(tally)
    expected = lambertian_share(columns[None, :], rows[:, None], distance - 5.0) * tally.box.step_um**2
    found, error = mean_and_error(tally.cell_bins() / tally.histories)
    inside = np.hypot(columns[None, :], rows[:, None]) < 250.0
    seen = inside & (expected * tally.total_histories > 50.0)
    deviation = (found - expected)[seen] / np.maximum(error[seen], np.sqrt(expected[seen] / tally.total_histories))
    assert seen.sum() > 200
    assert abs(deviation.mean()) < 0.25
    assert np.mean(deviation**2) < 1.6
    ring = np.hypot(columns[None, :], rows[:, None]) < 20.0
    assert found[ring].sum() == pytest.approx(expected[ring].sum(), rel=0.02)


def test_the_share_on_the_receiver_is_the_view_factor() -> None:
    """From a small disc to a coaxial one of radius r at height h: r^2 / (r^2 + h^2), Lambert's law integrated."""
    of = black(chip_changes=SMALL, layout=Array.regular(1, 1, 2000.0), distance_um=105.0)
    tally = launched(of, np.array([[0.0, 0.0, 5.0]]), lambert_up(200_000))
    columns, rows = places(tally)
    bins = tally.cell_bins().sum(axis=0) / tally.histories
    for r in (60.0, 100.0, 300.0):
        disc = np.hypot(columns[None, :], rows[:, None]) < r
        cells = disc.sum() * tally.box.step_um**2
        radius2 = cells / np.pi  # of the disc that the bins make
        assert bins[disc].sum() == pytest.approx(radius2 / (radius2 + 100.0**2), abs=4e-3)


def test_an_open_edge_loses_the_rest_and_the_map_goes_on_beyond_it() -> None:
    """Arrivals + edge = all light; bins within the edge are the arrivals, the bins beyond are no part of them."""
    of = black(chip_changes=SMALL, layout=Array.regular(1, 1, 200.0), distance_um=105.0)
    tally = launched(of, np.array([[0.0, 0.0, 5.0]]), lambert_up(100_000), groups=2)
    ledger = tally.ledger_per_history
    arrived = tally.arrivals.sum() / tally.total_histories
    assert arrived + ledger["edge"] == pytest.approx(1.0, abs=1e-12)
    assert ledger["receiver"] == pytest.approx(arrived)
    # square of half side 100, 100 above: 4 times the view factor of a quarter, in closed form
    a = 1.0
    quarter = a / np.sqrt(1.0 + a * a) * np.arctan(a / np.sqrt(1.0 + a * a)) / np.pi
    assert arrived == pytest.approx(4.0 * quarter, abs=4.0 * 0.5 / np.sqrt(100_000))
    step = tally.box.step_um
    assert within(tally, 100.0 - step, 100.0 - step) <= arrived <= within(tally, 100.0 + step, 100.0 + step)
    assert tally.bins.sum() / tally.total_histories > arrived + 0.1


def test_nothing_is_recorded_twice_below_a_tilted_receiver() -> None:
    """Regression: light that left an open edge above z = D was recorded within the module, at the level plane."""
    layout = Array.regular(1, 1, 400.0)
    of = black(chip_changes=SMALL, layout=layout, distance_um=100.0, tilt_per_um=(4e-3, 0.0))
    tally = launched(of, np.array([[0.0, 0.0, 5.0]]), lambert_up(100_000))
    arrived = tally.arrivals.sum() / tally.total_histories
    columns, _ = places(tally)
    sure = np.abs(columns) < 200.0 - tally.box.step_um
    inside = (
        tally.cell_bins().sum(axis=0)[np.ix_(np.abs(places(tally)[1]) < 200.0, sure)].sum() / tally.total_histories
    )
    assert inside <= arrived + 1e-12


def test_a_tilted_receiver_is_lit_by_lamberts_law() -> None:
    """E per horizontal area on the plane z = D (1 + t x): (n . r) cos(theta) / (pi r^4), n not normalised."""
    tilt, distance = (1.5e-3, -0.5e-3), 105.0
    of = black(chip_changes=SMALL, layout=Array.regular(1, 1, 500.0), distance_um=distance, tilt_per_um=tilt)
    tally = launched(of, np.array([[0.0, 0.0, 5.0]]), lambert_up(400_000), groups=16)
    columns, rows = places(tally)
    x, y = columns[None, :], rows[:, None]
    slope_x, slope_y = distance * tilt[0], distance * tilt[1]
    h = distance + slope_x * x + slope_y * y - 5.0
    facing = h - slope_x * x - slope_y * y
    expected = facing * h / (np.pi * (x**2 + y**2 + h**2) ** 2) * tally.box.step_um**2
    found, _ = mean_and_error(tally.cell_bins() / tally.histories)
    for sign in (1.0, -1.0):
        for axis in (x, y):
            part = (sign * axis > 0.0) & (np.abs(x) < 200.0) & (np.abs(y) < 200.0)
            assert found[part].sum() == pytest.approx(expected[part].sum(), abs=4.0 * 0.5 / np.sqrt(400_000))
    seen = (np.abs(x) < 200.0) & (np.abs(y) < 200.0) & (expected * 400_000 > 40.0)
    chi_square = ((found - expected)[seen] ** 2 / (expected[seen] / 400_000)).mean()
    assert chi_square == pytest.approx(1.0, abs=6.0 * np.sqrt(2.0 / seen.sum()))


def test_light_from_a_tilted_receiver_comes_back_by_lamberts_law_about_its_normal() -> None:
    """A steep tilt: the light that returns leans with the normal, and ledgers close."""
    tilt, distance = (2.5e-3, 0.0), 200.0
    layout = Array.regular(1, 1, 500.0)
    of = scene(
        SMALL,
        layout=layout,
        distance_um=distance,
        tilt_per_um=tilt,
        substrate=Mirror(0.0),
        receiver=lambertian_receiver(0.5),
    )
    tally = launched(of, np.array([[0.0, 0.0, 5.0]]), np.array([[0.0, 0.0, 1.0]] * 40_000))
    normal = np.array([distance * tilt[0], -1.0])
    normal /= np.linalg.norm(normal)
    w = lambert_up(400_000, 9)  # the same about a normal (x, z) that is turned about y
    turned = np.column_stack(
        [w[:, 2] * normal[0] - w[:, 0] * normal[1], w[:, 1], w[:, 2] * normal[1] + w[:, 0] * normal[0]]
    )
    path = np.where(turned[:, 2] < 0.0, -distance / turned[:, 2], np.inf)
    at = turned[:, :2] * np.minimum(path, 1e9)[:, None]
    hit = (np.abs(at) < 250.0).all(axis=1) & (turned[:, 2] < 0.0)
    ledger = tally.ledger_per_history
    assert ledger["receiver"] == pytest.approx(0.5, abs=0.015)
    assert ledger["substrate"] / 0.5 == pytest.approx(hit.mean(), abs=0.015)
    assert abs(tally.ledger_defect) < 1e-12


def test_walls_of_reflectance_one_are_the_endless_lattice() -> None:
    """A finite array between perfect mirrors sees its own images: the same light as the periodic cell."""
    chip = {"width_um": 60.0, "thickness_um": 20.0, "absorption_per_um": 0.02}
    walled = scene(chip, layout=Array.regular(2, 2, 300.0, wall=Mirror(1.0)), distance_um=100.0)
    endless = scene(chip, layout=Cell(300.0), distance_um=100.0)
    a, b = (MonteCarlo(of, seed).run_to(8192) for seed, of in enumerate((walled, endless), 1))
    for name in ENDS[:4]:
        index = ENDS.index(name)
        (m, e), (n, f) = (mean_and_error(tally.ledger[:, index] / tally.histories) for tally in (a, b))
        assert abs(m - n) < 4.0 * np.hypot(e, f) + 1e-9, name
    assert a.ledger_per_history["edge"] == 0.0
    for event in range(4):
        (m, e), (n, f) = (mean_and_error(tally.arrivals[:, event] / tally.histories) for tally in (a, b))
        assert abs(m - n) < 4.0 * np.hypot(e, f) + 1e-9, event


def test_walls_take_what_they_do_not_reflect() -> None:
    """A black wall is an open edge; a Lambertian one sends back half."""
    chip = {**SMALL}
    by_wall = {}
    for name, wall in (("open", None), ("black", Mirror(0.0)), ("grey", Lambertian(0.5))):
        of = scene(chip, layout=Array.regular(1, 1, 300.0, wall=wall), receiver=lambertian_receiver(0.0))
        tally = MonteCarlo(of, 1).run_to(2048)
        by_wall[name] = tally.ledger_per_history
        assert abs(tally.ledger_defect) < 1e-12
    assert by_wall["open"] == by_wall["black"]
    assert 0.3 < by_wall["grey"]["edge"] / by_wall["open"]["edge"] < 0.8
    assert by_wall["grey"]["receiver"] > by_wall["open"]["receiver"]


def test_the_middle_of_a_large_array_is_the_periodic_cell() -> None:
    """9 x 9 chips, distance a third of the pitch: the light on the central cell agrees with the endless lattice."""
    chip = {"width_um": 60.0, "thickness_um": 20.0, "absorption_per_um": 0.02}
    finite = scene(chip, layout=Array.regular(9, 9, 300.0), distance_um=100.0)
    a = MonteCarlo(finite, 3).run_to(8192)
    b = MonteCarlo(scene(chip, layout=Cell(300.0), distance_um=100.0), 4).run_to(8192)
    columns, rows = places(a)
    per_group = a.cell_bins()[:, np.abs(rows) < 150.0][:, :, np.abs(columns) < 150.0].sum(axis=(1, 2))
    area = (np.abs(rows) < 150.0).sum() * (np.abs(columns) < 150.0).sum() * a.box.step_um**2
    m, e = mean_and_error(per_group / a.histories * 81.0 * 300.0**2 / area)
    n, f = mean_and_error(b.cell_bins().sum(axis=(1, 2)) / b.histories)
    assert abs(m - n) < 4.0 * np.hypot(e, f), (m, n, e, f)


def test_powers_weigh_the_chips_and_dead_ones_give_nothing() -> None:
    """Light of a 1 x 3 array with powers 0, 3, 1 over black: shares 0, 3/4, 1/4 above each chip, low receiver."""
    layout = replace(Array.regular(1, 3, 400.0), power=np.array([[0.0, 3.0, 1.0]]))
    of = black(chip_changes=SMALL, layout=layout, distance_um=15.0, emission=Emission(from_top=True))
    tally = MonteCarlo(of, 1).run_to(2048)
    columns, _ = places(tally)
    by_column = tally.cell_bins().sum(axis=(0, 1)) / tally.total_histories
    for centre, share in ((-400.0, 0.0), (0.0, 0.75), (400.0, 0.25)):
        found = by_column[np.abs(columns - centre) < 150.0].sum()
        assert found == pytest.approx(share, abs=0.012)
    assert by_column[np.abs(columns + 400.0) < 100.0].sum() < 2e-3


def test_a_displaced_chip_shines_where_it_is() -> None:
    """Row 0 is the lowest y; displacements are (x, y)."""
    offset = np.zeros((2, 1, 2))
    offset[0, 0] = 40.0, -70.0
    layout = replace(Array.regular(2, 1, 400.0), offset_um=offset, power=np.array([[1.0], [0.0]]))
    of = black(chip_changes=SMALL, layout=layout, distance_um=30.0, emission=Emission(from_top=True))
    tally = MonteCarlo(of, 1).run_to(1024)
    columns, rows = places(tally)
    bins = tally.cell_bins().sum(axis=0)
    near = (np.abs(columns[None, :] - 40.0) < 60.0) & (np.abs(rows[:, None] + 270.0) < 60.0)
    weight = bins * near
    assert (weight * columns[None, :]).sum() / weight.sum() == pytest.approx(40.0, abs=1.0)
    assert (weight * rows[:, None]).sum() / weight.sum() == pytest.approx(-270.0, abs=1.0)
    assert weight.sum() / tally.total_histories > 0.75


def brute_force(of: Scene, at: Real, way: Real, reach: int) -> tuple[float, int, Real]:
    """Path, face (axis) and centre of the first chip that a ray meets, by trying them all; inf where none."""
    half, top = of.chip.width_um / 2.0, of.chip.thickness_um
    if isinstance(of.layout, Array):
        centres = of.layout.centres_um.reshape(-1, 2)
    else:
        lattice = np.arange(-reach, reach + 1) * of.layout.spacing_um
        centres = np.stack(np.meshgrid(lattice, lattice), axis=-1).reshape(-1, 2)
    low = np.column_stack([centres - half, np.zeros(len(centres))])
    high = np.column_stack([centres + half, np.full(len(centres), top)])
    first, second = (low - at) / way, (high - at) / way
    entries, leaving = np.minimum(first, second), np.maximum(first, second).min(axis=1)
    enter = entries.max(axis=1)
    met = (enter > 1e-7) & (leaving - enter > 1e-9)
    if not met.any():
        return np.inf, -1, np.zeros(2)
    chosen = int(np.flatnonzero(met)[enter[met].argmin()])
    return float(enter[chosen]), int(entries[chosen].argmax()), centres[chosen]


def displaced() -> Array:
    """Five by four chips, each somewhere in its cell."""
    rng = np.random.default_rng(4)
    layout = Array.regular(5, 4, 300.0, half_um=800.0)
    return replace(layout, offset_um=rng.uniform(-110.0, 110.0, (5, 4, 2)))


@pytest.mark.parametrize(
    "layout", [Cell(300.0), Array.regular(5, 4, 300.0), displaced()], ids=["cell", "array", "displaced"]
)
def test_neighbours_are_found_as_brute_force_finds_them(layout: Cell | Array) -> None:
    """Rays from anywhere, many of them grazing: what is met first, where, on which face of which chip."""
    of = scene({"width_um": 60.0, "thickness_um": 50.0}, layout=layout, distance_um=100.0)
    arrays, rng = scene_arrays(of), np.random.default_rng(7)
    span = 150.0 if isinstance(layout, Cell) else 600.0
    met = 0
    for trial in range(3000):
        at = np.array([*rng.uniform(-span, span, 2), rng.choice([0.0, 100.0, 25.0, 50.0])])
        way = rng.normal(size=3)
        if trial % 2:  # grazing light, but not so that it passes more chips than are tried
            way[2] = rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.1) * np.hypot(way[0], way[1])
        way /= np.linalg.norm(way)
        if abs(way[2]) < 0.019:
            continue
        if at[2] == 0.0 or (at[2] == 100.0):
            way[2] = np.copysign(way[2], 1.0 if at[2] == 0.0 else -1.0)
        ray = np.zeros(RAY)
        ray[[X, Y, Z, DX, DY, DZ]] = *at, *way
        path, axis, centre = brute_force(of, at, way, 40)
        inside = np.abs(at[:2] - centre).max() < 30.0 and at[2] <= 50.0 and axis == -1
        if inside or brute_force(of, at - way * 1e-3, way, 1)[0] < 2e-3:
            continue  # born in a chip
        what, found = _next(arrays, ray)
        other = 100.0 - at[2] if way[2] > 0.0 else at[2]
        ends = other / abs(way[2])
        if isinstance(layout, Array):
            edge = (np.copysign([layout.half_x_um, layout.half_y_um], way[:2]) - at[:2]) / way[:2]
            if edge.min() <= 0.0:
                continue  # born beyond the edge
            ends = min(ends, edge.min())
        if (np.abs(at[:2] - centre) < 30.0).all() and at[2] <= 50.0:
            continue
        if path < ends - 1e-9:
            met += 1
            assert what in (5, 6, 7), (trial, at, way, path, found)
            assert what - 5 == axis
            assert found == pytest.approx(path, rel=1e-9, abs=1e-9)
            home = ray[[CHIP_X, CHIP_Y]]
            assert home == pytest.approx(centre, abs=1e-6)
        else:
            assert what < 5, (trial, at, way, path, ends)
            assert found == pytest.approx(ends, rel=1e-9, abs=1e-9)
    assert met > 250


@pytest.mark.parametrize("way", [(0.0, 0.0, -1.0), (0.0, 0.6, -0.8), (0.6, 0.0, -0.8), (-0.6, -0.0, -0.8)])
def test_rays_along_the_lattice_come_to_an_end(way: tuple[float, float, float]) -> None:
    """Regression: a ray with dx = 0 or dy = 0 was looked for in column after column for ever."""
    for layout in (Cell(300.0), Array.regular(3, 3, 300.0)):
        of = scene(layout=layout)
        ray = np.zeros(RAY)
        ray[[X, Y, Z, DX, DY, DZ]] = 100.0, 70.0, 35.0, *way
        chip, path = _find_chip(scene_arrays(of), ray, 0.0, 35.0 / -way[2], True)
        assert (chip, path) == (0, np.inf)


def test_straight_down_on_a_chip_meets_its_top() -> None:
    """The same rays above the chip."""
    ray = np.zeros(RAY)
    ray[[X, Y, Z, DX, DY, DZ]] = 5.0, -3.0, 180.0, 0.0, 0.0, -1.0
    what, path = _next(scene_arrays(scene()), ray)
    assert (what, path) == (7, pytest.approx(145.0))


SIDES = {"-x": (-1.0, 0.0), "+x": (1.0, 0.0), "-y": (0.0, -1.0), "+y": (0.0, 1.0)}
"""Outward normals."""


def onto_a_side(normal: tuple[float, float], count: int, half: float, top: float) -> tuple[Real, Real]:
    """Places 5 um before a side of a chip and directions, downwards by Lambert's law, onto it."""
    rng, w = np.random.default_rng(4), lambert_up(count, 8)
    x, y = normal
    along, up = rng.uniform(-half, half, count), rng.uniform(top / 2.0, top, count)
    at = np.column_stack([x * (half + 5.0) - y * along, y * (half + 5.0) + x * along, up])
    return at, np.column_stack([-x * w[:, 2] - y * w[:, 0], -y * w[:, 2] + x * w[:, 0], -0.1 * np.abs(w[:, 1])])


@pytest.mark.parametrize("unfold", [True, False])
@pytest.mark.parametrize("side", SIDES)
def test_light_that_enters_a_side_crosses_the_chip(side: str, unfold: bool) -> None:
    """Regression: what came in through +x or +y was at once at that wall again, and left: 0.15 absorbed, not 0.7."""
    alpha, half, top = 0.02, 30.0, 20.0
    of = black(
        chip_changes={
            "width_um": 60.0, "thickness_um": top, "absorption_per_um": alpha,
            "bottom": "mirror", "mirror": Mirror(0.9),
        },
        layout=ONE,
    )  # fmt: skip
    normal = np.array([*SIDES[side], 0.0])
    place = normal * (half + 5.0) + [0.0, 0.0, 10.0]
    tally = launched(of, np.tile(place, (20_000, 1)), -normal + [0.0, 0.0, -1e-6], unfold=unfold)
    R = ((N - 1.0) / (N + 1.0)) ** 2
    passed = np.exp(-alpha * 60.0)
    absorbed = (1.0 - R) * (1.0 - passed) / (1.0 - R * passed)
    assert tally.ledger_per_history["chip"] == pytest.approx(absorbed, abs=4.0 * 0.5 / np.sqrt(20_000))


def test_all_sides_of_a_chip_take_the_same_light() -> None:
    """Lambert's light onto each of the four sides: the same ends, by either walk, in a cell and displaced."""
    chip = {"width_um": 60.0, "thickness_um": 20.0, "absorption_per_um": 0.02}
    offset = np.full((1, 1, 2), 1.0 / 3.0)
    layouts = (Cell(300.0), replace(Array.regular(1, 1, 300.1), offset_um=offset))
    found = {}
    for number, layout in enumerate(layouts):
        of = black(chip_changes={**chip, "bottom": "mirror", "mirror": Mirror(0.9)}, layout=layout)
        for side, normal in SIDES.items():
            for unfold in (True, False):
                tally = launched(of, *onto_a_side(normal, 20_000, 30.0, 20.0), unfold=unfold)
                found[number, side, unfold] = [tally.ledger_per_history[end] for end in ("chip", "substrate")]
    for number in range(len(layouts)):
        spread = np.ptp([ends for (of_layout, _, _), ends in found.items() if of_layout == number], axis=0)
        assert np.all(spread < 6.0 * 0.5 / np.sqrt(20_000)), found


def test_a_cell_gives_the_same_light_wherever_it_is_cut() -> None:
    """Light that lands beyond the cell is folded back: bins hold every arrival."""
    tally = MonteCarlo(scene(), 5).run_to(1024)
    assert tally.bins.sum() == pytest.approx(tally.arrivals.sum(), rel=1e-12)


def test_the_plate_spreads_light_without_losing_it() -> None:
    """All light displaced by a Gaussian: a cell keeps all of it, a mode falls by exp(-(k sigma)^2 / 2)."""
    sigma = 60.0
    of = black(emission=Emission(from_top=True))
    spread = replace(of, receiver=replace(of.receiver, spread_share=1.0, spread_um=sigma))
    a, b = (MonteCarlo(each, 2).run_to(8192) for each in (of, spread))
    assert b.bins.sum() == pytest.approx(a.bins.sum(), rel=1e-12)
    modes = []
    for tally in (a, b):
        bins = tally.cell_bins() / tally.histories
        centre = (np.arange(bins.shape[2]) + 0.5) / bins.shape[2] - 0.5
        modes.append(mean_and_error(np.einsum("gyx,x->g", bins, np.cos(2.0 * np.pi * centre))))
    (m, e), (n, f) = modes
    factor = np.exp(-0.5 * (2.0 * np.pi / 500.0 * sigma) ** 2)
    assert n == pytest.approx(m * factor, abs=4.0 * np.hypot(e, f))


def test_the_response_weighs_what_is_recorded_and_nothing_else() -> None:
    """A response equal to the cosine halves nothing in the ledger; the bins fall by the mean cosine."""
    of = black(chip_changes=SMALL, emission=Emission(from_top=True))
    cosine = replace(of, receiver=replace(of.receiver, response=np.array([0.0, 1.0])))
    a, b = (MonteCarlo(each, 2).run_to(4096) for each in (of, cosine))
    assert a.ledger_per_history == b.ledger_per_history
    assert b.bins.sum() / a.bins.sum() == pytest.approx(2 / 3, abs=2e-3)  # Lambert's mean cosine


def test_the_response_of_a_tilted_receiver_is_about_its_normal() -> None:
    """Regression: the cosine to the vertical was taken. Straight up, 30 deg on the receiver; and level with it."""
    slope = np.tan(np.radians(30.0))
    for way, cosine in (((0.0, 0.0, 1.0), np.cos(np.radians(30.0))), ((-0.5, 0.0, np.sqrt(0.75)), 1.0)):
        of = black(chip_changes=SMALL, layout=ONE, distance_um=200.0, tilt_per_um=(slope / 200.0, 0.0))
        of = replace(of, receiver=replace(of.receiver, response=np.array([0.0, 1.0])))
        tally = launched(of, np.array([[0.0, 0.0, 5.0]]), np.array([way] * 10))
        assert tally.bins.sum() / tally.arrivals.sum() == pytest.approx(cosine, abs=1e-6)


def test_a_receiver_that_lets_light_through_has_taken_it() -> None:
    """Regression: what the plate transmits counts as taken, not as lost in roulette; arrivals are as without it."""
    absorbing = scene(receiver=lambertian_receiver(0.35))
    through = replace(absorbing, receiver=replace(absorbing.receiver, bsdf=Lambertian(0.35, 0.5)))
    a, b = (MonteCarlo(each, 2).run_to(4096) for each in (absorbing, through))
    assert abs(b.ledger_defect) < 1e-12
    (m, e), (n, f) = (mean_and_error(tally.arrivals.sum(axis=1) / tally.histories) for tally in (a, b))
    assert abs(m - n) < 4.0 * np.hypot(e, f)
    receiver = ENDS.index("receiver")
    (m, e), (n, f) = (mean_and_error(tally.ledger[:, receiver] / tally.histories) for tally in (a, b))
    assert abs(m - n) < 4.0 * np.hypot(e, f)
