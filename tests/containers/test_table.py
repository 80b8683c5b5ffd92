"""The film table: its nodes, its interpolation with the error stated, its budget, storage, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from containers.stack import AIR, dbr_of, resolve
from containers.thin_film.film_measurement import measure
from containers.thin_film.lossless import stack_reflectance
from containers.thin_film.refinement import sampled
from containers.thin_film.table import SIDES, FilmTable, Real, Side, film_table
from containers.thin_film.transfer_matrix import solve
from luxloop.errors import InputError
from luxloop.film import Grid, Spectrum
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack
from luxloop.words import parse

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "thin_film.json").read_text())["tables"]
PAPER = Environment()
DISPERSIVE = PAPER.model_copy(update={"indices": "dispersive"})
SMALL = Grid(wavelengths=11, shared_nodes=31, dense_nodes=20, tolerance_ratio=1.0)
SMOOTH, ROUGH = dbr_of(PAPER, 5.5), dbr_of(PAPER, 5.5, roughness_nm=2.0)
LOSSY = Stack(
    inside=Medium(n=2.4869),
    inside_roughness_nm=1.0,
    layers=tuple(
        Layer(medium=Medium(n=n, k=k), thickness_nm=d, roughness_nm=1.0)
        for n, k, d in ((2.1793, 0.01, 51.6), (2.4869, 0.0, 45.2), (2.1793, 0.01, 51.6))
    ),
    outside=AIR,
)
TABLE = film_table(LOSSY, grid=SMALL)


@pytest.mark.parametrize("stack", [SMOOTH, ROUGH, LOSSY], ids=["smooth", "rough", "lossy"])
@pytest.mark.parametrize("side", SIDES)
def test_every_entry_sums_to_one(stack: Stack, side: Side) -> None:
    """R + T + S_R + S_T + A = 1 to 1e-12, every share between 0 and 1, and so after averaging."""
    table = film_table(stack, grid=SMALL)
    for powers in (table.powers(side), table.average(side)):
        np.testing.assert_allclose(sum(powers), 1.0, atol=1e-12)
        assert all(share.min() >= 0.0 and share.max() <= 1.0 + 1e-12 for share in powers)


def test_smooth_tables_from_both_kernels_agree() -> None:
    """The lossless kernel's table is the general kernel's: R, T at each node, both sides, to 1e-12."""
    table = film_table(SMOOTH, grid=SMALL)
    rows = resolve(SMOOTH, table.wavelength_nm)
    r = solve(rows.index, rows.thickness_nm, rows.roughness_nm, rows.wavelength_nm, table.u)
    np.testing.assert_allclose(table.powers("inside").R, r.R_inside, atol=1e-12)
    np.testing.assert_allclose(table.powers("inside").T, r.T_inside, atol=1e-12)
    np.testing.assert_allclose(table.powers("outside").R, r.R_outside[..., : table.nodes("outside")], atol=1e-12)
    assert not table.losses


def test_stored_losses_are_those_of_the_kernel() -> None:
    """S and A are kept in single precision, rounded down; T in double, so R moves by less than 1e-7."""
    table = film_table(LOSSY, grid=SMALL)
    rows = resolve(LOSSY, table.wavelength_nm)
    r = solve(rows.index, rows.thickness_nm, rows.roughness_nm, rows.wavelength_nm, table.u)
    np.testing.assert_allclose(table.powers("inside").A, r.A_inside, rtol=2e-7, atol=1e-40)
    np.testing.assert_allclose(table.powers("inside").R, r.R_inside, atol=1e-7)
    np.testing.assert_allclose(
        table.powers("outside").S_R, r.S_R_outside[..., : table.nodes("outside")], rtol=2e-7, atol=1e-40
    )


def test_nodes_are_uniform_in_the_air_angle_then_refined_at_the_layers() -> None:
    """181 nodes half a degree apart in air, then nodes to n_GaN with ends at u = 1, n_AlN and n_GaN."""
    table = film_table(SMOOTH)
    np.testing.assert_allclose(np.degrees(np.arcsin(table.u[:181])), np.arange(0.0, 90.25, 0.5), atol=1e-6)
    assert table.breaks == pytest.approx((1.0, 2.1793, 2.4869), abs=1e-3)
    assert set(table.breaks) <= set(table.u)
    assert (np.diff(table.u) > 0).all()
    assert table.nodes("outside") == 181
    assert table.nodes("inside") == table.u.size == 301


@pytest.mark.parametrize("environment", [PAPER, DISPERSIVE], ids=["fixed", "dispersive"])
def test_position_counts_nodes(environment: Environment) -> None:
    """The interpolation variable is the node number at every node, and never falls between."""
    table = film_table(dbr_of(environment, 5.5), grid=SMALL)
    np.testing.assert_allclose(table.position(table.u), np.arange(table.u.size), atol=1e-6)
    assert (np.diff(table.position(np.linspace(0.0, table.u[-1], 2000))) > 0).all()


@settings(max_examples=50, derandomize=True, deadline=None)
@given(st.floats(0.0, 2.4869))
def test_interpolation_stays_between_the_neighbouring_nodes(u: float) -> None:
    """A value read from the table lies between those of the nodes around it."""
    R = TABLE.average("inside").R
    after = min(int(np.searchsorted(TABLE.u, u)), TABLE.u.size - 1)
    around = R[max(after - 2, 0) : after + 2]
    assert around.min() - 1e-12 <= TABLE.at(R, u) <= around.max() + 1e-12


def test_interpolation_error_with_the_default_nodes() -> None:
    """Linear in the air angle: at most 4.5e-4 with 181 nodes and 1.7e-3 with 91, spectrum-averaged, 5.5 pairs."""
    u = np.sin(np.radians(np.linspace(0.0, 90.0, 1501)))
    exact = film_table(SMOOTH, grid=Grid(shared_nodes=1501, tolerance_ratio=1.0)).average("outside").R
    errors = []
    for nodes in (91, 181):
        table = film_table(SMOOTH, grid=Grid(shared_nodes=nodes, tolerance_ratio=1.0))
        errors.append(np.abs(table.at(table.average("outside").R, u) - exact).max())
    assert errors[0] < 1.8e-3
    assert errors[1] < 4.5e-4
    assert errors[1] < errors[0] / 3.0  # second order


def errors_at(table: FilmTable, u: Real) -> tuple[float, float]:
    """Largest error in R and T, both sides, s and p, at u: of the line average and of one wavelength."""
    rows = resolve(table.stack, table.wavelength_nm)
    exact = solve(rows.index, rows.thickness_nm, rows.roughness_nm, rows.wavelength_nm, u)
    found = []
    for side, R in (("inside", exact.R_inside), ("outside", exact.R_outside)):
        powers = table.powers("inside" if side == "inside" else "outside")
        seen = u <= table.u[powers.R.shape[-1] - 1]
        T = np.minimum(exact.T_inside, exact.T_outside)
        found += [table.at(ours, u[seen]) - right[..., seen] for ours, right in ((powers.R, R), (powers.T, T))]
    average = max(np.abs(np.tensordot(table.weight, wrong, axes=1)).max() for wrong in found if wrong.size)
    return float(average), float(max(np.abs(wrong).max() for wrong in found if wrong.size))


def absorbing(stack: Stack, k: float) -> Stack:
    """The stack with AlN that absorbs."""
    lossy = [
        layer.model_copy(update={"medium": Medium(n=2.1793, k=k)}) if layer.medium.n == 2.1793 else layer
        for layer in stack.layers
    ]
    return stack.model_copy(update={"layers": tuple(lossy)})


def aln_film(thickness_nm: float, k: float = 0.0, roughness_nm: float = 0.0) -> Stack:
    """One AlN layer on GaN."""
    layer = Layer(medium=Medium(n=2.1793, k=k), thickness_nm=thickness_nm, roughness_nm=roughness_nm)
    return Stack(inside=Medium(n=2.4869), inside_roughness_nm=roughness_nm, layers=(layer,), outside=AIR)


@pytest.mark.parametrize(
    ("stack", "R_dip"),
    [
        (absorbing(dbr_of(PAPER, 9.5), 1e-3), 0.69),
        (dbr_of(PAPER, 9.5, roughness_nm=1.0), 0.93),
        (dbr_of(PAPER, 9.5, roughness_nm=5.0), 0.47),
        (dbr_of(PAPER, 5.5, roughness_nm=5.0), 0.60),
        (aln_film(1000.0, 1e-3), 0.10),
        (aln_film(3000.0, 1e-4), 0.49),
    ],
    ids=["9.5 k 1e-3", "9.5 rough 1", "9.5 rough 5", "5.5 rough 5", "1 um", "3 um"],
)
def test_guided_mode_dips_beyond_the_critical_angle_are_resolved(stack: Stack, R_dip: float) -> None:
    """Dips of R of one polarisation, missed by up to 0.55 with 120 nodes, are there within the default tolerance."""
    table = film_table(stack)
    assert table.resolved
    u = np.concatenate([np.random.default_rng(1).uniform(1.0, 2.4869, 600), np.linspace(2.15, 2.33, 900)])
    assert errors_at(table, u)[0] < 1e-3
    assert np.tensordot(table.weight, table.powers("inside").R, axes=1)[:, table.u > 1.0].min() < R_dip


@settings(max_examples=25, derandomize=True, deadline=None)
@given(
    st.one_of(st.integers(2, 24), st.floats(200.0, 5000.0)),
    st.one_of(st.just(0.0), st.floats(-4.0, -1.0).map(lambda x: 10.0**x)),
    st.one_of(st.just(0.0), st.floats(0.1, 5.0)),
    st.integers(0, 10**6),
)
def test_the_stated_error_holds_within_a_factor_of_two(
    half_pairs_or_nm: float, k: float, roughness_nm: float, seed: int
) -> None:
    """DBRs to 12 pairs and films of 0.2 to 5 um, absorbing, rough or neither: no u errs by twice what is stated."""
    dbr = isinstance(half_pairs_or_nm, int)
    stack = (
        absorbing(dbr_of(PAPER, half_pairs_or_nm / 2, roughness_nm=roughness_nm), k)
        if dbr
        else aln_film(half_pairs_or_nm, k, roughness_nm)
    )
    table = film_table(stack)
    found = errors_at(table, np.random.default_rng(seed).uniform(0.0, table.u[-1], 120))[0]
    assert table.resolved
    assert found < 2.0 * table.error_average_ratio + 1e-7


def test_the_stated_error_of_one_wavelength_holds_within_a_factor_of_two() -> None:
    """A single wavelength errs more than the line; that is stated too."""
    for stack in (SMOOTH, ROUGH, LOSSY, aln_film(1000.0, 1e-3)):
        table = film_table(stack)
        average, single = errors_at(table, np.linspace(0.0, 2.48, 500))
        assert average < single < 2.0 * table.error_single_ratio
        assert table.error_average_ratio < table.error_single_ratio


def test_a_finer_tolerance_is_met() -> None:
    """Asked for 1e-4, the table has more nodes and is that good."""
    tables = [film_table(ROUGH, grid=Grid(tolerance_ratio=asked)) for asked in (1e-3, 1e-4)]
    u = np.linspace(0.0, 2.4869, 700)
    assert errors_at(tables[1], u)[0] < 1e-4 < errors_at(tables[0], u)[0]
    assert tables[1].u.size > tables[0].u.size


def test_thick_films_get_enough_wavelengths() -> None:
    """30 um of AlN, whose fringes keep step with 61 wavelengths: R(0) is that of the measurement, not 0.168."""
    table = film_table(aln_film(30_000.0))
    measured = measure(aln_film(30_000.0), "R", 445.0, 0.0, bandwidth_nm=18.0, from_side="inside")
    assert table.average("inside").R[0] == pytest.approx(0.14082, abs=2e-5)
    assert table.average("inside").R[0] == pytest.approx(measured[0, 0], abs=1e-6)
    assert film_table(SMOOTH).wavelength_nm.size == 31


def test_many_pairs_get_enough_wavelengths() -> None:
    """100 clear pairs, whose resonances are narrow: the line average is that of four times as many wavelengths."""
    table = film_table(dbr_of(PAPER, 100.0))
    wavelength, weight = sampled(Spectrum(), 4 * (table.wavelength_nm.size - 1) + 1)
    rows = resolve(table.stack, wavelength)
    u = table.u[: table.nodes("outside") : 6]
    exact = np.tensordot(weight, stack_reflectance(rows, u), axes=1).mean(axis=0)
    assert np.abs(table.average("outside").R[::6] - exact).max() < table.error_average_ratio <= 1e-3


def test_a_table_that_is_full_before_it_is_resolved_says_so() -> None:
    """2 mm of clear, coherent AlN: more fringes than a table can hold; it is made, and calls itself unresolved."""
    table = film_table(aln_film(2e6))
    assert not table.resolved
    assert table.error_average_ratio > 0.1
    assert table.wavelength_nm.size * table.u.size <= 1_000_000


def test_split_cells_are_found_without_a_search() -> None:
    """However unevenly cells are split, the position is the node's number at every node and rises between."""
    table = film_table(aln_film(1000.0, 1e-3))
    assert len(set(np.diff(table.axis.first).tolist())) > 3
    np.testing.assert_allclose(table.position(table.u), np.arange(table.u.size), atol=1e-6)
    assert (np.diff(table.position(np.linspace(0.0, table.u[-1], 20_000))) > 0).all()
    between = (table.u[1:] + table.u[:-1]) / 2.0
    assert (np.floor(table.position(between)) == np.arange(between.size)).all()


def test_smooth_tables_of_the_paper_stay_small() -> None:
    """Lossless DBRs of 4.5 to 9.5 pairs need 31 wavelengths, and at most 3 nodes more than the grid has."""
    for half_pairs in range(9, 20):
        table = film_table(dbr_of(PAPER, half_pairs / 2))
        assert table.resolved
        assert table.wavelength_nm.size == 31
        assert 301 <= table.u.size <= 304


@pytest.mark.parametrize("case", ["GaN|GaN-first|5.5", "GaN|GaN-first|6.5", "air|GaN-first|5.5"])
def test_golden_angles_read_from_the_default_table(case: str) -> None:
    """Reading the golden angles from the default table errs by no more than the interpolation, 4.5e-4."""
    side, _, pairs = case.split("|")
    table = film_table(dbr_of(PAPER, float(pairs)))
    u = np.sin(np.radians(GOLDEN[case]["deg"])) * (2.4869 if side == "GaN" else 1.0)
    R = table.average("inside" if side == "GaN" else "outside").R
    np.testing.assert_allclose(table.at(R, u), GOLDEN[case]["R"], atol=4.5e-4)


def test_spectrum_average_of_the_rough_stack() -> None:
    """5 nm on every face, 5.5 pairs, 0 degrees: 2.36 % of the LED's light scattered from GaN, 0.73 % from air."""
    table = film_table(
        dbr_of(PAPER, 5.5, roughness_nm=5.0), grid=Grid(shared_nodes=5, dense_nodes=8, tolerance_ratio=1.0)
    )
    for side, expected in (("inside", 0.0236), ("outside", 0.0073)):
        powers = table.average(side)  # type: ignore[arg-type]  # the literals of the loop
        assert powers.S_R[0] + powers.S_T[0] == pytest.approx(expected, abs=6e-5)


def test_spectrum_is_the_golden_one() -> None:
    """61 wavelengths 400 to 490 nm for 445/18 nm; weights sum to 1; one wavelength is the peak."""
    wavelength, weight = sampled(Spectrum(), 61)
    np.testing.assert_allclose(wavelength, np.linspace(400.0, 490.0, 61))
    assert weight.sum() == pytest.approx(1.0, abs=1e-15)
    assert np.interp(445.0 + 9.0, wavelength, weight) / weight.max() == pytest.approx(0.5, abs=2e-3)
    assert sampled(Spectrum(), 1)[0] == [445.0]


def test_a_dispersive_bulk_has_nodes_to_its_highest_index() -> None:
    """Where u exceeds n_GaN at a wavelength there is no such light: R reads 1, nothing is lost or passed."""
    table = film_table(dbr_of(DISPERSIVE, 5.5, roughness_nm=1.0), grid=SMALL)
    assert table.u[-1] == table.n_inside.max() == pytest.approx(2.5616, abs=1e-3)
    powers = table.powers("inside")
    beyond = table.u >= table.n_inside[:, None]
    assert beyond.any()
    for w, none in enumerate(beyond):
        assert (powers.R[w][:, none] == 1.0).all()
        assert not powers.S_R[w][:, none].any()


def test_the_denser_side_may_be_the_outside() -> None:
    """Turned round, the stack has the same table with the sides exchanged."""
    turned = Stack(inside=LOSSY.outside, layers=LOSSY.layers[::-1], outside=LOSSY.inside, inside_roughness_nm=1.0)
    table, mirrored = film_table(LOSSY, grid=SMALL), film_table(turned, grid=SMALL)
    assert mirrored.nodes("outside") == mirrored.u.size
    for ours, theirs in zip(table.powers("inside"), mirrored.powers("outside"), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-7)


def test_equal_half_spaces_have_shared_nodes_only() -> None:
    """A film between equal media needs no denser side."""
    film = Layer(medium=Medium(n=1.5, k=0.1), thickness_nm=80.0)
    table = film_table(Stack(inside=AIR, layers=(film,), outside=AIR), grid=SMALL)
    assert table.nodes("inside") == table.nodes("outside") == table.u.size == 31
    assert table.position(table.u).max() == pytest.approx(30.0)
    np.testing.assert_allclose(table.powers("inside").R, table.powers("outside").R, atol=1e-7)


@pytest.mark.parametrize("stack", [SMOOTH, LOSSY, aln_film(1000.0, 1e-3)], ids=["smooth", "lossy", "refined"])
def test_parts_put_together_are_the_table(stack: Stack) -> None:
    """Header through JSON and arrays through bytes: every power and interpolated value is bit for bit the same."""
    table = film_table(stack, grid=SMALL.model_copy(update={"tolerance_ratio": 1e-2}))
    header, arrays = table.to_parts()
    copied = {name: np.frombuffer(a.tobytes(), a.dtype).reshape(a.shape) for name, a in arrays.items()}
    again = FilmTable.from_parts(json.loads(json.dumps(header)), copied)
    assert again.stack == table.stack
    assert (again.error_average_ratio, again.error_single_ratio) == (
        table.error_average_ratio,
        table.error_single_ratio,
    )
    assert np.array_equal(again.position(again.u), table.position(table.u))
    for side in SIDES:
        for ours, theirs in zip(table.powers(side), again.powers(side), strict=True):
            assert np.array_equal(ours, theirs)
    assert again.at(again.average("inside").R, 1.1) == table.at(table.average("inside").R, 1.1)


def test_tables_are_compact() -> None:
    """With the default grid 0.18 MB smooth, and under 1 MB rough and absorbing."""
    sizes = [sum(a.nbytes for a in film_table(stack).to_parts()[1].values()) for stack in (SMOOTH, LOSSY)]
    assert sizes[0] < 190_000
    assert sizes[1] < 1_000_000


def test_parts_of_another_version_or_with_strange_arrays_are_refused() -> None:
    """A table that cannot be read says so, and that it must be computed again."""
    header, arrays = film_table(SMOOTH, grid=SMALL).to_parts()
    with pytest.raises(InputError, match="compute the table again"):
        FilmTable.from_parts({**header, "version": 0}, arrays)
    with pytest.raises(InputError, match="first"):
        FilmTable.from_parts(header, {**arrays, "first": arrays["first"][:-1]})
    with pytest.raises(InputError, match="arrays"):
        FilmTable.from_parts(header, {**arrays, "reflectance": arrays["T"]})
    with pytest.raises(InputError, match="arrays"):
        FilmTable.from_parts(header, {name: a for name, a in arrays.items() if name != "T"})


def test_metal_half_spaces_and_incoherent_layers_are_refused() -> None:
    """A bulk that absorbs strongly has no table for light inside it; a thick plate belongs to the measurement."""
    with pytest.raises(InputError, match=r"inside: got 'k = 0.5'.*thick layer"):
        film_table(Stack(inside=Medium(n=2.0, k=0.5), outside=AIR), grid=SMALL)
    plate = Layer(medium=Medium(n=1.5), thickness_nm=1e6, coherent=False)
    with pytest.raises(InputError, match="coherent"):
        film_table(Stack(inside=AIR, layers=(plate,), outside=AIR), grid=SMALL)


@pytest.mark.parametrize(
    ("peak_nm", "fwhm_nm"), [(445.0, 178.0), (445.0, 200.0), (10.0, 18.0), (445.0, 134.0)], ids=str
)
def test_a_line_wider_than_its_peak_allows_is_refused(peak_nm: float, fwhm_nm: float) -> None:
    """A line that would reach wavelength 0 or below names its width, what is allowed and where it would begin."""
    with pytest.raises(InputError, match=r"fwhm_nm: got .*0\.3 x peak_nm.*2\.5 FWHM"):
        parse(Spectrum, {"peak_nm": peak_nm, "fwhm_nm": fwhm_nm})
    assert film_table(SMOOTH, Spectrum(peak_nm=445.0, fwhm_nm=133.0)).wavelength_nm.min() > 445.0 / 4


@pytest.mark.parametrize("wavelengths", [0, 2, 3, 10])
def test_too_few_wavelengths_for_a_line_are_refused(wavelengths: int) -> None:
    """Two or three do not average a line (R(0) 0.317 and 0.647 for 0.638); one is the peak alone."""
    with pytest.raises(InputError, match="wavelengths"):
        parse(Grid, {"wavelengths": wavelengths})


@pytest.mark.parametrize(("wavelengths", "error"), [(11, 1e-6), (31, 3e-9)])
def test_few_wavelengths_average_the_default_line(wavelengths: int, error: float) -> None:
    """Asked for 11, the line averages of the paper's mirrors are those of 121 to 1e-6; the default 31 to 3e-9."""
    assert Grid().wavelengths == 31
    for pairs in (4.5, 5.5, 9.5):
        few, many = (film_table(dbr_of(PAPER, pairs), grid=Grid(wavelengths=w)) for w in (wavelengths, 121))
        u = few.u[:: few.u.size // 20]
        R = [table.at(table.average("inside").R, u[:12]) for table in (few, many)]
        np.testing.assert_allclose(R[0], R[1], atol=error)


HEADER, ARRAYS = TABLE.to_parts()


@pytest.mark.parametrize(
    ("header", "arrays"),
    [
        ({"grid": ...}, {}),
        ({"stack": ...}, {}),
        ({"excess": ...}, {}),
        ({"excess": "much"}, {}),
        ({"breaks": 3}, {}),
        ({"breaks": []}, {}),
        ({"breaks": ["a", "b"]}, {}),
        ({"breaks": HEADER["breaks"][::-1]}, {}),
        ({}, {"first": ARRAYS["first"][:0]}),
        ({}, {"first": ARRAYS["first"][None]}),
        ({}, {"first": ARRAYS["first"].astype(float)}),
        ({}, {"T": ARRAYS["T"][..., :-1]}),
        ({}, {"T": ARRAYS["T"][0]}),
        ({}, {"T": np.full_like(ARRAYS["T"], np.nan)}),
        ({}, {"u": ARRAYS["u"][:, None]}),
        ({}, {"weight": ARRAYS["weight"][1:]}),
        ({}, {name: ARRAYS[name][:0] for name in ("wavelength_nm", "weight", "n_inside", "n_outside", "T")}),
        ({}, {"A_inside": ARRAYS["A_inside"][..., 1:]}),
    ],
)
def test_malformed_parts_are_bad_input_and_no_crash(header: dict[str, Any], arrays: dict[str, Any]) -> None:
    """A crash is tried again on three workers."""
    changed = {name: value for name, value in (HEADER | header).items() if value is not ...}
    with pytest.raises(InputError, match="compute the table again") as caught:
        FilmTable.from_parts(changed, ARRAYS | arrays)
    assert caught.value.field in ("film", "first")
