"""The film table: its nodes, its interpolation with the error stated, its budget, storage, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from containers.stack import AIR, dbr_of, resolve
from containers.thin_film.table import SIDES, FilmTable, Side, film_table, sampled
from containers.thin_film.transfer_matrix import solve
from luxloop.errors import InputError
from luxloop.film import Grid, Spectrum
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "thin_film.json").read_text())["tables"]
PAPER = Environment()
DISPERSIVE = PAPER.model_copy(update={"indices": "dispersive"})
SMALL = Grid(wavelengths=7, shared_nodes=31, dense_nodes=20)
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
    np.testing.assert_allclose(table.powers("outside").R, r.R_outside[..., :31], atol=1e-12)
    assert not table.losses


def test_stored_losses_are_those_of_the_kernel() -> None:
    """S and A are kept in single precision, rounded down; T in double, so R moves by less than 1e-7."""
    table = film_table(LOSSY, grid=SMALL)
    rows = resolve(LOSSY, table.wavelength_nm)
    r = solve(rows.index, rows.thickness_nm, rows.roughness_nm, rows.wavelength_nm, table.u)
    np.testing.assert_allclose(table.powers("inside").A, r.A_inside, rtol=2e-7, atol=1e-40)
    np.testing.assert_allclose(table.powers("inside").R, r.R_inside, atol=1e-7)
    np.testing.assert_allclose(table.powers("outside").S_R, r.S_R_outside[..., :31], rtol=2e-7, atol=1e-40)


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
    exact = film_table(SMOOTH, grid=Grid(shared_nodes=1501)).average("outside").R
    errors = []
    for nodes in (91, 181):
        table = film_table(SMOOTH, grid=Grid(shared_nodes=nodes))
        errors.append(np.abs(table.at(table.average("outside").R, u) - exact).max())
    assert errors[0] < 1.8e-3
    assert errors[1] < 4.5e-4
    assert errors[1] < errors[0] / 3.0  # second order


def test_interpolation_error_beyond_the_critical_angle() -> None:
    """Where absorption or roughness makes R < 1 beyond air's critical angle, the refined nodes err by under 1e-3."""
    table = film_table(LOSSY, grid=Grid(wavelengths=5))
    u = np.linspace(1.0, 2.4869, 1500)
    rows = resolve(LOSSY, table.wavelength_nm)
    r = solve(rows.index, rows.thickness_nm, rows.roughness_nm, rows.wavelength_nm, u)
    assert r.R_inside.min() < 0.97
    assert np.abs(table.at(table.powers("inside").R, u) - r.R_inside).max() < 1e-3


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
    table = film_table(dbr_of(PAPER, 5.5, roughness_nm=5.0), grid=Grid(shared_nodes=5, dense_nodes=8))
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
    np.testing.assert_allclose(table.powers("inside").R, table.powers("outside").R, atol=1e-7)


@pytest.mark.parametrize("stack", [SMOOTH, LOSSY], ids=["smooth", "lossy"])
def test_parts_put_together_are_the_table(stack: Stack) -> None:
    """Header through JSON and arrays through bytes: every power and interpolated value is bit for bit the same."""
    table = film_table(stack, grid=SMALL)
    header, arrays = table.to_parts()
    copied = {name: np.frombuffer(a.tobytes(), a.dtype).reshape(a.shape) for name, a in arrays.items()}
    again = FilmTable.from_parts(json.loads(json.dumps(header)), copied)
    assert again.stack == table.stack
    for side in SIDES:
        for ours, theirs in zip(table.powers(side), again.powers(side), strict=True):
            assert np.array_equal(ours, theirs)
    assert again.at(again.average("inside").R, 1.1) == table.at(table.average("inside").R, 1.1)


def test_tables_are_compact() -> None:
    """With the default grid 0.18 MB smooth, and under 0.9 MB rough and absorbing."""
    sizes = [sum(a.nbytes for a in film_table(stack).to_parts()[1].values()) for stack in (SMOOTH, LOSSY)]
    assert sizes[0] < 190_000
    assert sizes[1] < 900_000


def test_parts_of_another_version_or_with_strange_arrays_are_refused() -> None:
    """A table that cannot be read says so, and that it must be computed again."""
    header, arrays = film_table(SMOOTH, grid=SMALL).to_parts()
    with pytest.raises(InputError, match="compute the table again"):
        FilmTable.from_parts({**header, "version": 0}, arrays)
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
