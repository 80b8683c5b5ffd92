"""From a request to its answer: what must hold whatever is traced, and when a run stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from containers.ray_tracing.estimate import student_t
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.simulation import simulate
from containers.ray_tracing.stopping import FIRST_BLOCKS, Target, next_blocks, run_to_error
from containers.ray_tracing.tally import Tally
from containers.stack import dbr_of
from containers.thin_film.table import FilmTable, film_table
from luxloop.computation import Progress, Stopped
from luxloop.errors import InputError
from luxloop.film import Grid, Spectrum
from luxloop.model import Environment
from luxloop.photometry import luminous_efficacy_lm_per_w
from luxloop.ray import RayRequest
from luxloop.words import parse

GROUPS = 32
DESIGN = {"distance_um": 180.0, "width_um": 28.0, "spacing_um": 500.0, "thickness_um": 35.0, "dbr_pairs": 0.0}
LOW = DESIGN | {"distance_um": 100.0, "thickness_um": 55.0}
DIM: dict[str, Any] = {"environment": {"chip_absorption_per_cm": 200.0}}
WIDE = DESIGN | {"distance_um": 60.0, "width_um": 100.0, "spacing_um": 300.0}
EVENTS = ("through_dbr", "from_sides", "after_top_reflection", "after_receiver")
Arrays = dict[str, NDArray[Any]]


def request(**changes: Any) -> RayRequest:
    """A design without a DBR, one block of histories in each group."""
    return parse(RayRequest, {"environment": {}, "design": DESIGN, "histories": GROUPS * BLOCK} | changes)


@cache
def film(pairs: float = 0.5, **environment: Any) -> FilmTable:
    """The table of a DBR, as PC2 makes it."""
    reading = Environment(**environment)
    line = Spectrum(peak_nm=reading.peak_nm, fwhm_nm=reading.fwhm_nm)
    return film_table(dbr_of(reading, pairs), line, Grid(wavelengths=11))


def traced(asked: RayRequest, threads: int | None = None) -> tuple[dict[str, Any], Arrays]:
    """Document and arrays."""
    table = film(asked.design.dbr_pairs) if asked.design.dbr_pairs else None
    return simulate(asked, table, ExitSource(threads=threads), Progress(), threads)


@cache
def plain() -> tuple[dict[str, Any], Arrays]:
    """The answer to the plain request."""
    return traced(request())


def assert_equal(one: tuple[dict[str, Any], Arrays], other: tuple[dict[str, Any], Arrays]) -> None:
    """The same documents, and the same arrays bit for bit."""
    assert one[0] == other[0]
    assert one[1].keys() == other[1].keys()
    for name, array in one[1].items():
        np.testing.assert_array_equal(array, other[1][name])


def within_errors(one: dict[str, float], other: dict[str, float], errors: float = 4.0) -> bool:
    """Whether two numbers with errors agree."""
    reach = errors * float(np.hypot(one["standard_error"], other["standard_error"]))
    return abs(one["value"] - other["value"]) <= reach


# What holds for every answer


@pytest.mark.parametrize("stored_exits", [False, True])
def test_one_thread_is_two_threads(stored_exits: bool) -> None:
    """Every number and every array, whoever computes which group."""
    asked = request(stored_exits=stored_exits, far_field=True, exit_histories=1)
    assert_equal(traced(asked, 1), traced(asked, 2))


def test_another_seed_is_another_sample_of_the_same() -> None:
    """The numbers differ, within their errors."""
    (one, _), (other, _) = plain(), traced(request(seed="2"))
    for name, found in one["metrics"].items():
        assert found != other["metrics"][name]
        assert within_errors(found, other["metrics"][name], 5.0), name


def test_light_is_conserved() -> None:
    """What was emitted, and what roulette made, is the sum of the ends to 1e-12."""
    ledger = {name: one["value"] for name, one in plain()[0]["ledger"].items()}
    put_in = ledger.pop("emitted") + ledger.pop("roulette")
    assert put_in == pytest.approx(sum(ledger.values()), abs=1e-12)
    assert abs(plain()[0]["ledger_defect"]) < 1e-12


def test_illuminance_is_what_arrives() -> None:
    """Mean lux = arrivals x flux x lm/W / area of the cell, in map and metric; the receiver takes 0.65 of it."""
    result, arrays = plain()
    environment = Environment()
    arrivals = sum(result["optical_events"][name]["value"] for name in EVENTS)
    lm = environment.flux_per_chip_w * luminous_efficacy_lm_per_w(environment.peak_nm, environment.fwhm_nm)
    lux = arrivals * lm / 500e-6**2
    assert result["metrics"]["mean_illuminance_lx"]["value"] == pytest.approx(lux, rel=1e-9)
    assert arrays["map_lx"].mean() == pytest.approx(lux, rel=1e-6)
    taken = result["metrics"]["optical_efficiency"]  # of the rays themselves, arrivals are those of their fans
    assert abs(taken["value"] - 0.65 * arrivals) < 3.0 * taken["standard_error"] < 0.02


def test_a_large_modules_illuminance_is_what_arrives() -> None:
    """As of a cell, by the rays alone; points as regular as the chips said 3 % more (decision 84)."""
    result, _ = traced(request(array={"rows": 32, "columns": 32}, histories=4 * GROUPS * BLOCK))
    environment = Environment()
    lm = environment.flux_per_chip_w * luminous_efficacy_lm_per_w(environment.peak_nm, environment.fwhm_nm)
    taken, mean = result["metrics"]["optical_efficiency"], result["metrics"]["mean_illuminance_lx"]
    lux = lm / 500e-6**2 / (1.0 - environment.receiver.reflectance)
    error = np.hypot(mean["standard_error"], lux * taken["standard_error"])
    assert abs(mean["value"] - lux * taken["value"]) < 4.0 * error < 0.01 * mean["value"]


def test_the_map_of_a_cell_has_the_symmetries_of_the_square() -> None:
    """Row 0 is the lowest y; eight images are one; its errors are positive."""
    arrays = plain()[1]
    for image in (arrays["map_lx"][::-1], arrays["map_lx"][:, ::-1], arrays["map_lx"].T):
        np.testing.assert_allclose(image, arrays["map_lx"], rtol=2e-6)
    assert (arrays["map_error_lx"] > 0.0).all()
    assert {arrays[name].dtype for name in ("map_lx", "map_error_lx")} == {np.dtype(np.float32)}
    assert all(np.isfinite(array).all() for array in arrays.values())


def test_the_cut_is_the_line_of_the_uniformity() -> None:
    """Smallest over largest inside its window is the uniformity plus the bias that was taken off."""
    result, arrays = plain()
    low, high = result["cut"]["window_um"]
    inside = (arrays["cut_x_um"] >= low) & (arrays["cut_x_um"] <= high)
    ratio = arrays["cut_lx"][inside].min() / arrays["cut_lx"][inside].max()
    one = result["metrics"]["uniformity"]
    assert ratio == pytest.approx(one["value"] + one["bias"], abs=1e-9)


def test_flux_scales_lux_and_nothing_else() -> None:
    """Twice the flux: twice the lux, the same ratios."""
    twice, arrays = traced(request(environment={"flux_per_chip_w": 2 * 1.482e-3}))
    once = plain()[0]
    np.testing.assert_allclose(arrays["map_lx"], 2.0 * plain()[1]["map_lx"], rtol=1e-6)
    lux = (
        found["metrics"].pop("mean_illuminance_lx")["value"]
        for found in (twice, dict(once) | {"metrics": dict(once["metrics"])})
    )
    assert next(lux) == pytest.approx(2.0 * next(lux))
    assert {name: twice["metrics"][name] for name in twice["metrics"]} == {
        name: one for name, one in once["metrics"].items() if name != "mean_illuminance_lx"
    }


def test_stored_exits_say_the_same() -> None:
    """Landed exits and full histories agree within their errors, in every metric and every end."""
    landed, _ = traced(request(stored_exits=True, histories=4 * GROUPS * BLOCK))
    full, _ = traced(request(histories=4 * GROUPS * BLOCK))
    for part in ("metrics", "ledger", "optical_events"):
        for name, one in full[part].items():
            assert within_errors(one, landed[part][name], 5.0), (part, name)


def test_a_film_turns_light_back() -> None:
    """With half a pair the light through the top is another; the document says nothing of pairs it was not asked."""
    design = DESIGN | {"dbr_pairs": 4.5}
    table = film(4.5)
    coated, _ = simulate(request(design=design), table, ExitSource(), Progress())
    through = "through_dbr"
    assert not within_errors(coated["optical_events"][through], plain()[0]["optical_events"][through], 10.0)


# Finite modules


def test_a_mirror_around_one_chip_makes_it_an_endless_array() -> None:
    """The cell is its own mirror image, so a perfect wall at half a pitch sees the cell."""
    walled, _ = traced(request(array={"rows": 1, "columns": 1, "wall_reflectance": 1.0}))
    assert walled["ledger"]["edge"]["value"] == 0.0
    for name in EVENTS:
        assert within_errors(walled["optical_events"][name], plain()[0]["optical_events"][name])


def test_a_dead_chip_is_dark_and_the_map_is_seen_from_above() -> None:
    """Of two chips side by side the right one shines: more light at x > 0; the left one gives the mirror image."""
    maps = [
        traced(request(array={"rows": 1, "columns": 2, "power": power}, histories=2 * GROUPS * BLOCK))
        for power in ([0.0, 1.0], [1.0, 0.0])
    ]
    (right, right_map), (left, left_map) = maps
    assert right_map["map_lx"].shape == (32, 64)
    assert right_map["map_lx"][:, 32:].mean() > 2.0 * right_map["map_lx"][:, :32].mean()
    mean = "mean_illuminance_lx"
    assert within_errors(right["metrics"][mean], left["metrics"][mean])
    pull = (right_map["map_lx"] - left_map["map_lx"][:, ::-1]) / np.hypot(
        right_map["map_error_lx"], left_map["map_error_lx"][:, ::-1]
    )
    assert np.mean(pull**2) < 1.7


def test_lux_of_a_module_is_of_all_its_chips() -> None:
    """Two chips give the sum of either alone: the flux of the model is that of one chip."""
    alone, both = (
        traced(request(array={"rows": 1, "columns": 2, "power": power}))[0]["metrics"]["mean_illuminance_lx"]
        for power in ([1.0, 0.0], [1.0, 1.0])
    )
    twice = {name: 2.0 * value for name, value in alone.items()}
    assert within_errors(twice, both)


def test_a_column_of_two_chips_stands_upright() -> None:
    """The upper chip shines: light in the upper rows; the line is its row, y = 250 um, from edge to edge."""
    array = {"rows": 2, "columns": 1, "power": [0.0, 1.0]}
    result, arrays = traced(request(array=array, histories=4 * GROUPS * BLOCK))
    assert arrays["map_lx"].shape == (64, 32)
    assert arrays["map_lx"][32:].mean() > 2.0 * arrays["map_lx"][:32].mean()
    assert result["cut"]["y_um"] == 250.0
    assert (arrays["cut_x_um"][0], arrays["cut_x_um"][-1]) == (-250.0, 250.0)
    beside = arrays["map_lx"][47:49].mean()  # y = 242 and 258 um
    assert arrays["cut_lx"].mean() == pytest.approx(beside, rel=0.02)


def test_the_far_field_of_a_module_is_of_all_its_chips() -> None:
    """In 1/sr per flux of one chip: two chips send twice what each sends; the ratio is of all that was emitted."""
    result, arrays = traced(request(far_field=True, array={"rows": 1, "columns": 2}))
    per_sr, ratio = arrays["far_module_per_sr"], result["far_field"]["module"]["flux_ratio"]["value"]
    assert per_sr.sum() * 2.0 * np.pi / per_sr.size == pytest.approx(2.0 * ratio, rel=1e-9)
    events = result["optical_events"]
    assert ratio == pytest.approx(sum(events[name]["value"] for name in EVENTS[:3]), rel=1e-9)


def test_the_line_of_a_module_is_its_middle_half() -> None:
    """3 columns of 500 um: |x| up to 375 um, on the middle row; the cut goes on to the edge."""
    result, arrays = traced(request(array={"rows": 3, "columns": 3}, histories=8 * GROUPS * BLOCK))
    assert result["cut"] == {"y_um": 0.0, "window_um": [-375.0, 375.0]}
    assert (arrays["cut_x_um"][0], arrays["cut_x_um"][-1]) == (-750.0, 750.0)
    assert "375" in result["region"]


def test_a_module_narrower_than_its_pitch_is_judged_on_its_receiver() -> None:
    """Its mean is that of its map, which ends with the receiver; beyond there is a pad that is no result."""
    result, arrays = traced(request(array={"rows": 1, "columns": 1, "half_um": 100.0}, histories=4 * GROUPS * BLOCK))
    assert result["metrics"]["mean_illuminance_lx"]["value"] == pytest.approx(arrays["map_lx"].mean(), rel=0.01)
    assert result["cut"]["window_um"] == [-100.0, 100.0]


def test_a_module_too_large_for_its_height_is_refused_before_it_is_traced() -> None:
    """As many bins as its modes need are taken up to a limit; beyond it the sides that would do are named."""
    result, _ = traced(request(design=LOW, array={"rows": 9, "columns": 9}, histories=8 * GROUPS * BLOCK))
    assert result["histories"] == 8 * GROUPS * BLOCK
    with pytest.raises(InputError, match=r"array: got '7500 x 7500 um', allowed: up to about 7440 um a side"):
        traced(request(design=LOW, array={"rows": 15, "columns": 15}, histories=10**11))


# Far field, rays, images


def test_the_far_field_holds_the_light_that_first_arrives() -> None:
    """Its flux is that of the optical events before the receiver; what leaves the chips is no less."""
    result, arrays = traced(request(far_field=True))
    events = result["optical_events"]
    first = sum(events[name]["value"] for name in EVENTS if name != "after_receiver")
    far = result["far_field"]
    assert far["module"]["flux_ratio"]["value"] == pytest.approx(first, rel=1e-9)
    assert far["chip"]["flux_ratio"]["value"] >= first
    for name, lowest in (("chip", -1.0), ("module", 0.0)):
        per_sr = arrays[f"far_{name}_per_sr"]
        sr = 2.0 * np.pi * (1.0 - lowest) / per_sr.size
        assert per_sr.sum() * sr == pytest.approx(far[name]["flux_ratio"]["value"], rel=1e-9)
        assert arrays[f"far_{name}_curve_per_sr"].shape == (per_sr.shape[0],)


def test_rays_leave_the_faces_of_the_chip() -> None:
    """Unit directions, outwards, from top or sides; their flux is what did not end in the chip."""
    result, arrays = traced(request(exit_histories=GROUPS * BLOCK, stored_exits=True))
    position, direction = arrays["ray_position_um"], arrays["ray_direction"]
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=1e-5)
    normal = np.abs(position / np.array([14.0, 14.0, 35.0])) > 1.0 - 1e-5
    assert normal.any(axis=1).all()
    outwards = np.where(normal, position * direction, -np.inf).max(axis=1)
    assert (outwards > 0.0).all()
    assert set(arrays["ray_wavelength_nm"]) == {np.float32(445.0)}
    assert 0.2 < arrays["ray_flux_ratio"].sum() <= 1.0
    assert result["exit_histories"] == GROUPS * BLOCK


def test_an_image_of_the_whole_cell_is_its_map() -> None:
    """64 pixels over one pitch: gain x irradiance, in the map's own places; its error is the map's."""
    camera = {"rows": 64, "columns": 64, "pixel_um": 500.0 / 64, "gain_dn": 100.0, "full_scale_dn": 1e6}
    result, arrays = traced(request(images=[camera]))
    dn_per_lx = 100.0 / (result["lx_per_unit"] * 500e-3**2)
    np.testing.assert_allclose(arrays["image_0"], arrays["map_lx"] * dn_per_lx, rtol=3e-3)
    np.testing.assert_allclose(arrays["image_error_0"], arrays["map_error_lx"] * dn_per_lx, rtol=0.03)


def test_a_camera_sees_several_periods_of_a_cell() -> None:
    """An image of three pitches repeats itself; one of a finite module that reaches too far is refused."""
    camera = {"rows": 96, "columns": 96, "pixel_um": 3 * 500.0 / 96}
    image = traced(request(images=[camera]))[1]["image_0"]
    np.testing.assert_allclose(image[:32, :32], image[32:64, 32:64], rtol=1e-5)
    with pytest.raises(InputError, match="inside the map"):
        traced(request(images=[camera], array={"rows": 1, "columns": 1}))


def test_a_black_level_has_no_error_and_saturation_has_less() -> None:
    """The error of digital numbers goes through the sensor as the light does."""
    common = {"rows": 16, "columns": 16, "pixel_um": 30.0, "gain_dn": 100.0}
    cameras = [common, common | {"black_level_dn": 50.0}, common | {"saturation_knee": 0.5, "full_scale_dn": 300.0}]
    arrays = traced(request(images=cameras))[1]
    np.testing.assert_allclose(arrays["image_1"] - arrays["image_0"], 50.0)
    np.testing.assert_allclose(arrays["image_error_1"], arrays["image_error_0"], rtol=1e-9)
    assert (arrays["image_error_2"] < arrays["image_error_0"]).all()


@pytest.mark.parametrize("array", [None, {"rows": 3, "columns": 3}])
def test_the_twin_agrees_with_monte_carlo(array: dict[str, int] | None) -> None:
    """The same module by both methods: mean and map within joint errors; the twin books no ledger."""
    ours, maps = traced(request(array=array, histories=262_144))
    twins, twin_maps = traced(request(array=array, histories=262_144, method="twin"))
    one, other = (found["metrics"]["mean_illuminance_lx"] for found in (ours, twins))
    assert other["value"] == pytest.approx(one["value"], abs=4.0 * one["standard_error"] + 2e-3 * one["value"])
    off = (twin_maps["map_lx"] - maps["map_lx"]) / np.hypot(twin_maps["map_error_lx"], maps["map_error_lx"])
    assert np.sqrt(np.mean(off**2)) < 2.0
    assert "ledger" not in twins
    assert twins["metrics"]["uniformity"]["standard_error"] > 0.0


# What is refused


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"design": DESIGN | {"distance_um": 36.0}}, "design"),
        ({"design": DESIGN | {"width_um": 500.0}}, "design"),
        ({"environment": {"n_gan": 1.41}}, "environment.n_gan"),
        ({"method": "twin", "far_field": True}, "far_field"),
        ({"method": "twin", "histories": None, "target_error_points": 1.0}, "histories"),
        ({"method": "twin", "array": {"rows": 2, "columns": 2, "wall_reflectance": 0.5}}, "layout"),
        ({"method": "twin", "array": {"rows": 50, "columns": 50}, "design": LOW, "histories": 10**6}, "array"),
        ({"method": "twin", "array": {"rows": 1, "columns": 1}, "design": WIDE} | DIM, "method"),
        ({"images": [{"rows": 4096, "columns": 4096}] * 2}, "images"),
        ({"images": [{"rows": 4096, "columns": 4096, "pixel_um": 1.0, "psf_um": 200.0}]}, "images"),
        ({"images": [{"pixel_um": 0.008, "psf_um": 8.0}]}, "pixel_um"),
        ({"images": [{"rows": 4096, "columns": 16, "pixel_um": 900.0}]}, "images"),
        ({"array": {"rows": 2, "columns": 2, "power": [1.0]}}, "array.power"),
        ({"array": {"rows": 1, "columns": 2, "offset_um": [[0.0, 0.0]]}}, "array.offset_um"),
        ({"array": {"rows": 1, "columns": 1, "offset_um": [[300.0, 0.0]]}}, "offset_um"),
        ({"array": {"rows": 1, "columns": 1, "power": [0.0]}}, "power"),
        ({"array": {"rows": 3, "columns": 3, "half_um": 100.0}}, "half_x_um"),
        ({"design": DESIGN | {"distance_um": 12.0, "thickness_um": 5.0}, "histories": 1}, "histories"),
    ],
)
def test_what_cannot_be_traced_is_refused(changes: dict[str, Any], field: str) -> None:
    """By the field that is wrong, with what is allowed."""
    with pytest.raises(InputError) as caught:
        traced(request(**changes))
    assert caught.value.field == field
    assert caught.value.allowed


def test_a_film_must_be_the_designs() -> None:
    """None where pairs are asked for, one of other pairs, of another line, where there are none, or not resolved."""
    asked = request(design=DESIGN | {"dbr_pairs": 0.5})
    coarse = replace(film(9.5), error_average_ratio=1.0)
    assert not coarse.resolved
    for given_request, table in (
        (asked, None),
        (asked, film(1.0)),
        (asked, film(0.5, peak_nm=460.0)),
        (request(), film()),
        (request(design=DESIGN | {"dbr_pairs": 9.5}), coarse),
    ):
        with pytest.raises(InputError) as caught:
            simulate(given_request, table, ExitSource(), Progress())
        assert caught.value.field == "film"


def test_a_stop_is_heard() -> None:
    """Cancelled, a run ends at the next checkpoint, in the histories and in the exits."""
    progress = Progress()
    progress.stop.set()
    for asked in (request(), request(stored_exits=True), request(histories=None, target_error_points=0.1)):
        with pytest.raises(Stopped):
            simulate(asked, None, ExitSource(), progress)


# When a run stops


def test_a_target_is_reached_and_budgets_do_not_matter() -> None:
    """The error is at most what was asked, in whole blocks; another budget and thread count give the same bits."""
    asked = request(histories=None, target_error_points=1.0)
    result, arrays = traced(asked, 2)
    assert result["metrics"]["uniformity"]["standard_error"] <= 0.01
    assert result["histories"] % (GROUPS * BLOCK) == 0
    assert_equal((result, arrays), traced(asked.model_copy(update={"budget_s": 600.0}), 1))


def test_a_target_beyond_the_budget_is_refused_with_the_estimate() -> None:
    """At once after the pilot; it says how long it would take, and which error the budget reaches."""
    with pytest.raises(InputError) as caught:
        traced(request(histories=None, target_error_points=0.001, budget_s=2.0))
    assert caught.value.field == "target_error_points"
    assert "or more within budget_s = 2" in caught.value.allowed
    assert " s here" in caught.value.mend
    assert float(caught.value.allowed.split()[0]) > 0.05


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.integers(1, 10**6), st.floats(1e-5, 1.0), st.floats(1e-5, 1.0))
def test_counts_grow_as_asked_and_no_faster_than_twice(blocks: int, error: float, target: float) -> None:
    """More than before, at most twice, and no more than the law of large numbers asks for and 5 %."""
    following = next_blocks(blocks, error, target)
    assert blocks < following <= 2 * blocks
    assert following <= max(blocks + 1, 1.05 * blocks * (error / target) ** 2 + 1)
    assert next_blocks(blocks, float("inf"), target) == 2 * blocks


@pytest.mark.parametrize(
    ("blocks", "error", "target", "following"),
    [(400, 0.0125, 0.01, 657), (1000, 0.01, 0.01, 1050), (4, 0.01, 0.005, 8), (4, 0.0050001, 0.005, 5)],
)
def test_a_run_goes_on_to_what_its_error_asks_for_and_5_percent(
    blocks: int, error: float, target: float, following: int
) -> None:
    """400 blocks at 1.25 of the target want 625 and 31.25 more; never more than twice, never less than one more."""
    assert next_blocks(blocks, error, target) == following


@dataclass
class Noise:
    """A solver whose histories are pure noise: the mean over groups of normal numbers, 0 in truth."""

    random: np.random.Generator
    tally: Any = field(default_factory=lambda: _Counted())

    def run_to(self, histories: int, report: Callable[[float], None] | None = None) -> Tally:  # noqa: ARG002  # a solver's
        """Add the noise of more blocks."""
        more = (histories - self.tally.histories) / BLOCK
        self.tally.sums += self.random.normal(size=GROUPS) * np.sqrt(more)
        self.tally.histories = histories
        return self.tally  # type: ignore[no-any-return]  # it has what the rule reads of a tally


class _Counted:
    """What the rule reads of a tally."""

    def __init__(self) -> None:
        self.histories, self.groups, self.sums = 0, GROUPS, np.zeros(GROUPS)

    @property
    def means(self) -> NDArray[np.float64]:
        """Of the groups."""
        return np.asarray(self.sums * BLOCK / self.histories)


def _error(tally: Any) -> float:
    return float(tally.means.std(ddof=1) / np.sqrt(GROUPS))


@pytest.mark.parametrize("harder", [1.5, 5.0])
def test_stopping_by_a_noisy_error_keeps_intervals_honest(harder: float) -> None:
    """Of 95 % intervals of 1,000 stopped runs 92 to 98 % hold the truth, and none runs much longer than needed."""
    random = np.random.default_rng(7)
    target = Target(1.0 / np.sqrt(FIRST_BLOCKS * GROUPS) / harder, 60.0)
    held, blocks = 0, []
    for _ in range(1000):
        solver = Noise(random)
        run_to_error(solver, lambda tally: (_error(tally), None), target, Progress())
        held += abs(solver.tally.means.mean()) <= student_t(0.95, GROUPS - 1) * _error(solver.tally)
        blocks.append(solver.tally.histories / BLOCK)
    assert 0.92 <= held / 1000 <= 0.98
    assert 0.9 <= np.mean(blocks) / (FIRST_BLOCKS * harder**2) <= 1.3


def test_a_receiver_too_near_for_the_modes_is_told() -> None:
    """D 60, T 55, S 700: what is left out may be more than the uniformity; D 180 is far enough."""
    near = {"distance_um": 60.0, "width_um": 100.0, "spacing_um": 700.0, "thickness_um": 55.0, "dbr_pairs": 0.0}
    document, _ = traced(request(design=near, histories=8 * GROUPS * BLOCK))
    assert document["metrics"]["uniformity"]["truncation"] > 0.1
    (warning,) = document["warnings"]
    assert "100.0 points" in warning
    far, _ = traced(request(design=near | {"distance_um": 180.0}))
    assert far["warnings"] == []
