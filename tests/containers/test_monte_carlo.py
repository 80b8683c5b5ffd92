"""The Monte Carlo solver: the golden cases, the furnace, the ledger, and the same bits however a run is cut."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from containers.bsdf import Lambertian, Mirror
from containers.ray_tracing.build import cell_of, scene_of
from containers.ray_tracing.field import CellField
from containers.ray_tracing.monte_carlo import BLOCK, MonteCarlo, blocks_of
from containers.ray_tracing.tally import FIRST, LATER, Tally
from containers.scene import Array, Emission, Scene, lambertian_receiver
from containers.thin_film.table import film_table
from luxloop.design import Design
from luxloop.errors import InputError
from luxloop.film import Grid
from luxloop.model import Environment
from tests.films import film
from tests.ray_scenes import ESCAPE, SUBSTRATE, illuminance, mean_and_error, mode, scene

GOLDEN = json.loads((Path(__file__).parent.parent / "golden" / "ray_tracing.json").read_text())
CASES = {"case_A": Emission(from_top=True), "case_B": Emission()}


def same_bits(a: Tally, b: Tally) -> bool:
    """Whether everything in two tallies is equal to the last bit."""
    pairs = ((a.bins, b.bins), (a.ledger, b.ledger), (a.arrivals, b.arrivals), (a.directions, b.directions))
    return a.histories == b.histories and all(np.array_equal(x, y) for x, y in pairs)


def cut_of_16(tally: Tally) -> tuple[Any, Any]:
    """Relative illuminance and error in 8 of 16 bins per pitch, from chip to edge, in the row next to y = 0."""
    bins = tally.cell_bins() / tally.histories
    size = bins.shape[1] // 16
    coarse = bins.reshape(len(bins), 16, size, 16, size).sum(axis=(2, 4)) * 256.0
    folded = (coarse + coarse[:, :, ::-1]) / 2.0
    return mean_and_error(((folded + folded[:, ::-1]) / 2.0)[:, 8, 8:])


@pytest.fixture(scope="module", params=CASES)
def golden(request: pytest.FixtureRequest) -> tuple[dict[str, Any], Tally]:
    """What is known of a case, and a tally of half a million histories of it."""
    return GOLDEN[request.param], MonteCarlo(scene(emission=CASES[request.param]), 1).run_to(32 * 1024)


def test_the_mean_is_that_of_the_golden_case(golden: tuple[dict[str, Any], Tally]) -> None:
    """Within three standard errors, ours and that of the golden value (0.0004 for A, 0.0006 for B)."""
    case, tally = golden
    name = next(
        name for name in case["mean"] if name.startswith("own") and "cap" not in name.replace("no bounce cap", "")
    )
    error_of_golden = 4e-4 if "Lambertian" in case["source"] else 6e-4
    mean, error = mean_and_error(illuminance(tally))
    assert abs(mean - case["mean"][name]) < 3.0 * np.hypot(error, error_of_golden), (mean, error)


def test_the_cut_is_that_of_the_golden_case(golden: tuple[dict[str, Any], Tally]) -> None:
    """Each of the eight bins within three standard errors (0.3 % of golden A; 0.005 of golden B)."""
    case, tally = golden
    values = np.array(next(cut for name, cut in case["cut"].items() if name.startswith("own")))
    mean, error = cut_of_16(tally)
    of_golden = 3e-3 * values if "Lambertian" in case["source"] else np.full(8, 5e-3)
    assert np.abs(mean - values) / np.hypot(error, of_golden) == pytest.approx(np.zeros(8), abs=3.0)


def test_the_ledger_is_closed(golden: tuple[dict[str, Any], Tally]) -> None:
    """Emitted + roulette = all ends, to 1e-12 of what was emitted."""
    _, tally = golden
    assert abs(tally.ledger_defect) < 1e-12
    assert tally.ledger_per_history["emitted"] == 1.0
    assert tally.ledger_per_history["trapped"] == 0.0


def test_optical_events_are_all_arrivals(golden: tuple[dict[str, Any], Tally]) -> None:
    """The four crossings add up to what the bins hold."""
    _, tally = golden
    assert sum(tally.events_per_history.values()) == pytest.approx(float(illuminance(tally).mean()), rel=1e-12)
    assert all(share >= 0.0 for share in tally.events_per_history.values())


LEDGERS: dict[str, Scene] = {
    "absorbing": scene({"absorption_per_um": 0.01}),
    "mirror": scene({"bottom": "mirror", "mirror": Mirror(0.9), "absorption_per_um": 0.002}),
    "closed mirror": scene({"bottom": "mirror", "mirror": Mirror(1.0)}),
    "air gap": scene({"bottom": "air_gap"}),
    "open array": scene(layout=Array.regular(2, 3, 300.0)),
    "walls": scene(layout=Array.regular(2, 3, 300.0, wall=Lambertian(0.7))),
    "tilted": scene(layout=Array.regular(2, 3, 300.0), tilt_per_um=(3e-4, -2e-4)),
    "bright receiver": scene(receiver=lambertian_receiver(0.95)),
}


@pytest.mark.parametrize("survival", [0.1, 0.35, 1.0])
@pytest.mark.parametrize("name", LEDGERS)
def test_every_ledger_is_closed(name: str, survival: float) -> None:
    """To 1e-12, whatever the module and however the receiver's light goes on; no end is below 0 but roulette."""
    tally = MonteCarlo(LEDGERS[name], 2, survival=survival).run_to(1024)
    assert abs(tally.ledger_defect) < 1e-12
    ledger = tally.ledger_per_history
    assert min(value for end, value in ledger.items() if end != "roulette") > -5e-3  # trapped light has a variance
    assert abs(ledger["roulette"]) < 0.02


@pytest.mark.parametrize("survival", [0.1, 0.35])
def test_roulette_changes_no_mean(survival: float) -> None:
    """Light that goes on always or sometimes: the same map."""
    of = scene(receiver=lambertian_receiver(0.8))
    a, b = MonteCarlo(of, 3, survival=1.0).run_to(4096), MonteCarlo(of, 4, survival=survival).run_to(4096)
    for m, n in ((0, 0), (1, 0), (1, 1)):
        (x, e), (y, f) = mean_and_error(mode(a, m, n)), mean_and_error(mode(b, m, n))
        assert abs(x - y) < 4.0 * np.hypot(e, f)


def test_in_a_white_furnace_all_light_arrives() -> None:
    """All reflectances 1, black receiver, sigma above 0: every photon lands once."""
    of = scene(substrate=replace(SUBSTRATE, reflectance=1.0), receiver=lambertian_receiver(0.0))
    alone, fan = (MonteCarlo(of, 1, fan=count).run_to(1024) for count in (1, 4))
    assert illuminance(alone) == pytest.approx(np.ones(32), abs=1e-12)
    mean, error = mean_and_error(illuminance(fan))  # of a fan that chips cut, what arrives is right on average
    assert abs(mean - 1.0) < 4.0 * error < 4e-3
    assert fan.ledger_per_history["receiver"] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("bottom", ["contact", "mirror", "air_gap"])
def test_in_a_furnace_of_mirrors_a_quarter_arrives_and_the_rest_is_trapped(bottom: str) -> None:
    """Sigma 0: 0.253 lands, 0.747 has no open channel and is said to be trapped."""
    mirror = Mirror(1.0) if bottom == "mirror" else None
    of = scene({"bottom": bottom, "mirror": mirror}, substrate=Mirror(1.0), receiver=lambertian_receiver(0.0))
    tally = MonteCarlo(of, 1).run_to(4096)
    mean, error = mean_and_error(illuminance(tally))
    assert abs(mean - ESCAPE) < 4.0 * error + 2e-4
    assert tally.ledger_per_history["trapped"] == pytest.approx(1.0 - mean, abs=1e-12)


def test_the_error_falls_as_one_over_the_square_root() -> None:
    """Sixteen times the random histories: a quarter of the spread; Sobol's error falls at least as fast."""
    of = scene(emission=Emission(from_top=True))
    for sobol in (False, True):
        errors = [
            mean_and_error(mode(MonteCarlo(of, 1, groups=64, sobol=sobol).run_to(n), 1, 0))[1] for n in (256, 4096)
        ]
        assert errors[0] / errors[1] > 3.0
        assert sobol or errors[0] / errors[1] < 5.3


def test_sobol_and_random_points_agree_and_sobol_is_no_worse() -> None:
    """The same mean within errors."""
    a, b = (
        MonteCarlo(scene(emission=Emission(from_top=True)), 1, sobol=sobol).run_to(4096) for sobol in (True, False)
    )
    (x, e), (y, f) = mean_and_error(mode(a, 1, 0)), mean_and_error(mode(b, 1, 0))
    assert abs(x - y) < 4.0 * np.hypot(e, f)
    assert e < 1.3 * f


def test_one_thread_gives_the_bits_of_two() -> None:
    """And of three, with directions too."""
    of = scene()
    one, two, three = (MonteCarlo(of, 1, threads=n, direction_bins=(8, 12)).run_to(2048) for n in (1, 2, 3))
    assert same_bits(one, two)
    assert same_bits(one, three)
    assert one.directions.sum() > 0.0


def test_a_run_in_pieces_gives_the_bits_of_one() -> None:
    """Continued at any number of histories, and with any size of call."""
    of = scene({"absorption_per_um": 0.003})
    whole, pieces, chunks = MonteCarlo(of, 1), MonteCarlo(of, 1), MonteCarlo(of, 1)
    chunks._calls = 37
    for end in (1, 100, 1024, 1500):
        pieces.run_to(end)
    assert same_bits(whole.run_to(2048), pieces.run_to(2048))
    assert same_bits(whole.tally, chunks.run_to(2048))


def test_a_run_can_be_stopped_and_goes_on_with_the_same_bits() -> None:
    """`report` hears of progress and may raise; what was done is kept and continued."""
    of, heard = scene(), []

    def stop(share: float) -> None:
        heard.append(share)
        if share > 0.2:
            raise KeyboardInterrupt

    run = MonteCarlo(of, 1)
    with pytest.raises(KeyboardInterrupt):
        run.run_to(4096, stop)
    assert 0 < run.tally.histories < 4096
    assert heard[0] == 0.0
    assert same_bits(run.run_to(4096), MonteCarlo(of, 1).run_to(4096))


def test_another_seed_gives_other_bits_and_the_same_light() -> None:
    """Independent runs."""
    a, b = (MonteCarlo(scene(), seed).run_to(2048) for seed in (1, 2))
    assert not np.array_equal(a.bins, b.bins)
    (x, e), (y, f) = mean_and_error(illuminance(a)), mean_and_error(illuminance(b))
    assert abs(x - y) < 4.0 * np.hypot(e, f)


def test_groups_are_told_apart_by_their_number_only() -> None:
    """No two groups share a history."""
    tally = MonteCarlo(scene(), 1).run_to(256)
    assert len({tally.bins[group].tobytes() for group in range(tally.groups)}) == tally.groups


OFF: dict[str, Scene] = {
    "no spread": replace(scene(), receiver=replace(scene().receiver, spread_share=0.0, spread_um=50.0)),
    "spread by nothing": replace(scene(), receiver=replace(scene().receiver, spread_share=1.0, spread_um=0.0)),
    "response of ones": replace(scene(), receiver=replace(scene().receiver, response=np.ones(33))),
    "isotropic table": scene(
        emission=Emission(position=np.ones((1, 1)), cosine=np.array([-1.0, 1.0]), intensity=np.full(2, 7.0))
    ),
}


@pytest.mark.parametrize("name", OFF)
def test_an_effect_at_its_off_value_is_absent_to_the_last_bit(name: str) -> None:
    """Common random numbers: nothing else is disturbed."""
    assert same_bits(MonteCarlo(OFF[name], 1).run_to(512), MonteCarlo(scene(), 1).run_to(512))


def test_an_array_of_nominal_chips_is_the_array_without_effects_to_the_last_bit() -> None:
    """Power 1 or 2 for all, displacement 0."""
    regular = Array.regular(2, 3, 300.0)
    same = replace(regular, power=np.full((2, 3), 2.0), offset_um=np.full((2, 3, 2), -0.0))
    a, b = (MonteCarlo(scene(layout=layout), 1).run_to(512) for layout in (regular, same))
    assert same_bits(a, b)


def test_an_effect_leaves_the_other_draws_alone() -> None:
    """A darker receiver: the first arrivals keep their bits."""
    a, b = (MonteCarlo(scene(receiver=lambertian_receiver(rho)), 1).run_to(512) for rho in (0.35, 0.3))
    assert np.array_equal(a.bins[:, 0], b.bins[:, 0])
    assert not np.array_equal(a.bins[:, 1], b.bins[:, 1])


def test_the_folded_map_is_the_whole_map() -> None:
    """The same cell binned without its symmetries has them within errors, and the same modes."""
    nearly = np.ones((2, 2)) + 1e-9 * np.array([[0.0, 1.0], [0.0, 0.0]])
    whole_of = scene(emission=Emission(position=nearly))
    assert not whole_of.symmetric
    whole, folded = MonteCarlo(whole_of, 1).run_to(8192), MonteCarlo(scene(), 2).run_to(8192)
    bins = folded.cell_bins()
    assert np.array_equal(bins, bins.swapaxes(1, 2))
    assert np.array_equal(bins, bins[:, ::-1])
    for m, n in ((0, 0), (1, 0), (0, 1), (2, 1)):
        (x, e), (y, f) = mean_and_error(mode(whole, m, n)), mean_and_error(mode(folded, m, n))
        assert abs(x - y) < 4.0 * np.hypot(e, f)
    centre = (np.arange(whole.bins.shape[2]) + 0.5) / whole.bins.shape[2] - 0.5
    for axis in "xy":  # odd modes vanish
        odd = np.einsum(f"gyx,{axis}->g", whole.cell_bins(), np.sin(2.0 * np.pi * centre)) / whole.histories
        mean, error = mean_and_error(odd)
        assert abs(mean) < 4.0 * error
    difference, error = mean_and_error(mode(whole, 1, 0) - mode(whole, 0, 1))
    assert abs(difference) < 4.0 * error


@pytest.mark.parametrize("layer", [FIRST, LATER])
def test_the_field_of_folded_bins_is_that_of_the_cell_that_they_are_of(layer: int) -> None:
    """By octants, and by all bins of the cell with sines and cosines: the same maps, means and errors, to 1e-12."""
    of = scene()
    spacing = 2.0 * MonteCarlo(of, 2).tally.box.ends_um[1]
    tally = MonteCarlo(of, 2).run_to(4096)
    assert tally.box.folded
    folded = tally.cell_field(layer, spacing, of.height_um)
    whole = CellField.from_bins(tally.cell_bins(layer), tally.histories, spacing, of.height_um)
    x, y = np.linspace(-spacing / 2.0, spacing / 2.0, 17), np.linspace(-spacing, spacing, 7)
    np.testing.assert_allclose(folded.grid(x, y), whole.grid(x, y), rtol=1e-12, atol=1e-12)
    assert (folded.mean, folded.mean_error) == pytest.approx((whole.mean, whole.mean_error), rel=1e-10)
    assert folded.spacing_um == pytest.approx(whole.spacing_um)


def test_light_born_on_one_side_leans_that_way() -> None:
    """+x of the emission is +x of the map, +y is +y: row 0 is the lowest y."""
    for axis, position in (("x", np.array([[0.0, 1.0]])), ("y", np.array([[0.0], [1.0]]))):
        of = scene({"width_um": 100.0}, emission=Emission(position=position, from_top=True))
        tally = MonteCarlo(of, 1).run_to(1024)
        bins = tally.cell_bins().sum(axis=0) / tally.total_histories
        centre = (np.arange(bins.shape[0]) + 0.5) / bins.shape[0] - 0.5
        assert np.einsum(f"yx,{axis}->", bins, np.sin(2.0 * np.pi * centre)) > 0.05


def test_the_sampled_spectrum_agrees_with_the_averaged_one_where_bounces_are_few() -> None:
    """A strongly absorbing chip meets its film once or twice: averaging costs little; both are different numbers."""
    design = Design(distance_um=180, width_um=28, spacing_um=500, thickness_um=35, dbr_pairs=5.5)
    environment = Environment(chip_absorption_per_cm=500.0, active_layer_depth=0.95)
    tallies = []
    for spectrum in ("averaged", "sampled"):
        each = environment.model_copy(update={"spectrum": spectrum})
        tallies.append(MonteCarlo(scene_of(each, design, film(5.5), cell_of(each, design)), 1).run_to(8192))
    assert tallies[1].ledger_per_history != tallies[0].ledger_per_history
    (x, e), (y, f) = (mean_and_error(illuminance(tally)) for tally in tallies)
    assert abs(x - y) < 4.0 * np.hypot(e, f) + 0.005 * x


def test_a_sampled_line_of_one_wavelength_is_the_averaged_one() -> None:
    """A line without width: both readings are the same numbers within what their nodes differ."""
    design = Design(distance_um=180, width_um=28, spacing_um=500, thickness_um=35, dbr_pairs=5.5)
    narrow = film_table(film(5.5).stack, grid=Grid(wavelengths=1))
    means = []
    for spectrum in ("averaged", "sampled"):
        environment = Environment(spectrum=spectrum)
        means.append(
            illuminance(
                MonteCarlo(scene_of(environment, design, narrow, cell_of(environment, design)), 1).run_to(1024)
            )
        )
    assert means[0] == pytest.approx(means[1], abs=1e-12)


def test_a_count_of_histories_is_a_whole_number_of_blocks() -> None:
    """At least what was asked; none, and nan, are refused."""
    assert blocks_of(1) == BLOCK
    assert blocks_of(32 * BLOCK) == BLOCK
    assert blocks_of(32 * BLOCK + 1) == 2 * BLOCK
    for wrong in (0, -5, 10**12, float("nan")):
        with pytest.raises(InputError, match="histories"):
            blocks_of(wrong)  # type: ignore[arg-type]  # nan is the point


@pytest.mark.parametrize(("name", "pairs", "design"), [
    ("S_b3 without DBR", 0.0, (180, 28, 500, 35)), ("S_b1 5.5 pairs", 5.5, (180, 40, 400, 20)),
    ("S_b2 5.5 pairs", 5.5, (160, 20, 460, 15)),
])  # fmt: skip
def test_the_uniformities_of_the_paper_cells_are_near_the_golden_ones(
    name: str, pairs: float, design: tuple[float, float, float, float]
) -> None:
    """Min / max of the Y = 0 cut of the light's low modes, within three of the golden standard errors (1 point)."""
    D, W, S, T = design
    asked = Design(distance_um=D, width_um=W, spacing_um=S, thickness_um=T, dbr_pairs=pairs)
    environment = Environment()
    of = scene_of(environment, asked, film(pairs) if pairs else None, cell_of(environment, asked))
    tally = MonteCarlo(of, 2).run_to(16 * 1024)
    x = np.linspace(0.0, 0.5, 201)
    cut = np.zeros_like(x)
    for m in range(7):
        for n in range(7):
            share = mode(tally, m, n).mean() * (1.0 if m == 0 else 2.0) * (1.0 if n == 0 else 2.0)
            cut += share * np.cos(2.0 * np.pi * m * x)
    found = 100.0 * cut.min() / cut.max()
    assert found == pytest.approx(GOLDEN["uniformity_percent"][name], abs=3.0)
