"""The general kernel: identities of Maxwell's equations first, then published values, then an independent program."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tmm
from hypothesis import given, settings
from hypothesis import strategies as st

from containers.stack import dbr_of, resolve
from containers.thin_film.refinement import sampled
from containers.thin_film.transfer_matrix import StackResponse, solve
from luxloop.errors import InputError
from luxloop.film import Spectrum
from luxloop.model import Environment

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "thin_film.json").read_text())["tables"]
GAN, ALN, SILVER = 2.4869, 2.1793, 0.04 + 2.6j


def quarter_waves(layers: int, first: complex = GAN, second: complex = ALN) -> tuple[list[complex], list[float]]:
    """GaN | alternating layers | air of the paper."""
    index = [GAN, *([first, second] * layers)[:layers], 1.0]
    return index, [45.2 if n == GAN else 51.6 for n in index[1:-1]]


def random_stack(rng: np.random.Generator, absorbing: bool, layers: int) -> tuple[Any, Any]:
    """Indices 1 to 4, layers up to 150 nm; with absorption some metals and some lossy dielectrics."""
    n = rng.uniform(1.0, 4.0, layers + 2).astype(complex)
    if absorbing:
        lossy, metal = rng.random(layers + 2) < 0.3, rng.random(layers + 2) < 0.1
        n[lossy] += 1j * rng.uniform(0.0, 1.0, lossy.sum())
        n[metal] = rng.uniform(0.05, 1.0, metal.sum()) + 1j * rng.uniform(1.0, 6.0, metal.sum())
    n[[0, -1]] = rng.uniform(1.0, 4.0, 2)
    return n, rng.uniform(0.0, 150.0, layers)


def budgets(r: StackResponse) -> list[Any]:
    """R + T + S + A per side."""
    return [
        r.R_inside + r.T_inside + r.S_R_inside + r.S_T_inside + r.A_inside,
        r.R_outside + r.T_outside + r.S_R_outside + r.S_T_outside + r.A_outside,
    ]


@pytest.mark.parametrize("absorbing", [False, True])
def test_power_is_conserved_and_absorption_is_never_negative(absorbing: bool) -> None:
    """R + T + A = 1 to 1e-12 from both sides, A >= 0, and A = 0 exactly where nothing absorbs."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        n, d = random_stack(rng, absorbing, int(rng.integers(0, 30)))
        r = solve(n, d, 0.0, [450.0], np.linspace(0.0, n.real[[0, -1]].max(), 60))
        for total in budgets(r):
            np.testing.assert_allclose(total, 1.0, atol=1e-12)
        assert min(r.A_inside.min(), r.A_outside.min()) >= -1e-15
        assert absorbing or not r.A_inside.any()
        assert not r.S_R_inside.any()
        assert not r.S_T_outside.any()


def test_transmission_is_reciprocal() -> None:
    """T from GaN to air is T from air to GaN, absorption or not, rough or not; the amplitudes obey t' y = t y'."""
    index, thickness = quarter_waves(11, second=2.1793 + 0.01j)
    u = np.linspace(0.0, 0.999, 50)
    r = solve(index, thickness, 2.0, [445.0], u)
    np.testing.assert_allclose(r.T_inside, r.T_outside, rtol=1e-12)
    ratio = np.sqrt(GAN**2 - u**2) / np.sqrt(1.0 - u**2)
    np.testing.assert_allclose(r.t_inside_to_outside[0], ratio * r.t_outside_to_inside[0], rtol=1e-11)


def test_reflection_beyond_the_critical_angle_is_total() -> None:
    """|r| = 1 for every lossless, smooth stack where light cannot leave; less with absorption."""
    u = np.linspace(1.0, GAN, 200)[1:-1]
    index, thickness = quarter_waves(19)
    np.testing.assert_allclose(np.abs(solve(index, thickness, 0.0, [445.0], u).r_inside), 1.0, atol=1e-12)
    index[2] += 0.01j
    assert np.abs(solve(index, thickness, 0.0, [445.0], u).r_inside).max() < 1.0 - 1e-6


def test_no_layers_is_a_bare_fresnel_face() -> None:
    """s and p of a bare GaN face follow the angle form of Fresnel's equations, from both sides."""
    theta = np.radians([10.0, 30.0, 56.0, 80.0, 89.9])
    inside = np.arcsin(np.sin(theta) / GAN)
    r = solve([GAN, 1.0], [], 0.0, [445.0], np.sin(theta))
    r_s = -np.sin(theta - inside) / np.sin(theta + inside)
    r_p = np.tan(theta - inside) / np.tan(theta + inside)
    np.testing.assert_allclose(r.r_outside[0].real, [r_s, r_p], atol=1e-12)
    np.testing.assert_allclose(r.r_inside[0].real, [-r_s, -r_p], atol=1e-12)


def test_s_equals_p_at_normal_incidence_up_to_the_stated_sign() -> None:
    """r_p = -r_s and t_p = t_s at normal incidence, in any stack."""
    n, d = random_stack(np.random.default_rng(5), True, 12)
    r = solve(n, d, 0.0, [450.0], [0.0])
    for amplitude in (r.r_outside, r.r_inside):
        np.testing.assert_allclose(amplitude[0, 1], -amplitude[0, 0], rtol=1e-12)
    for amplitude in (r.t_outside_to_inside, r.t_inside_to_outside):
        np.testing.assert_allclose(amplitude[0, 1], amplitude[0, 0], rtol=1e-12)


@pytest.mark.parametrize(("layers", "outermost"), [(5, "GaN"), (11, "GaN"), (4, "AlN"), (10, "AlN")])
def test_exact_quarter_waves_have_the_closed_form(layers: int, outermost: str) -> None:
    """R = ((n0 - Y) / (n0 + Y))^2 with the admittance Y of a quarter-wave stack, at normal incidence."""
    index, _ = quarter_waves(layers)
    r = solve(index, [445.0 / (4.0 * n) for n in index[1:-1]], 0.0, [445.0], [0.0])
    pairs = layers // 2
    Y = (ALN / GAN) ** (2 * pairs) if outermost == "AlN" else GAN**2 * (ALN / GAN) ** (-2 * pairs)
    expected = ((GAN - 1.0 / Y) / (GAN + 1.0 / Y)) ** 2 if outermost == "AlN" else ((GAN - Y) / (GAN + Y)) ** 2
    np.testing.assert_allclose(r.R_inside[0, :, 0], expected, rtol=1e-12)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 9), st.floats(0.0, 1.0), st.floats(0.0, 2.4), st.booleans())
def test_a_layer_cut_in_two_is_the_same_layer(at: int, part: float, u: float, absorbing: bool) -> None:
    """Splitting a layer, or adding a layer of no thickness, changes nothing."""
    n, d = random_stack(np.random.default_rng(7), absorbing, 10)
    n[0] = 2.5
    whole = solve(n, d, 0.0, [450.0], [u])
    cut_n, cut_d = np.insert(n, at + 1, n[at + 1]), np.insert(d, at, part * d[at])
    cut_d[at + 1] -= part * d[at]
    cut = solve(cut_n, cut_d, 0.0, [450.0], [u])
    empty = solve(np.insert(n, at + 1, 1.7 + 0.3j), np.insert(d, at, 0.0), 0.0, [450.0], [u])
    for other in (cut, empty):
        np.testing.assert_allclose(other.r_inside, whole.r_inside, atol=1e-11)
        np.testing.assert_allclose(other.T_inside, whole.T_inside, atol=1e-11)
        np.testing.assert_allclose(other.A_inside, whole.A_inside, atol=1e-11)


def test_a_half_wave_layer_is_absent() -> None:
    """A lossless layer of half a wave changes no power at its wavelength."""
    index, thickness = quarter_waves(5)
    with_layer = solve(
        [*index[:3], 1.8, *index[3:]], [*thickness[:2], 445.0 / 3.6, *thickness[2:]], 0, [445.0], [0.0]
    )
    np.testing.assert_allclose(with_layer.R_inside, solve(index, thickness, 0, [445.0], [0.0]).R_inside, atol=1e-13)


@pytest.mark.parametrize("pairs", [0.5, 1.0, 2.5, 5.5, 6.0, 9.5])
def test_the_first_gan_layer_belongs_to_the_bulk(pairs: float) -> None:
    """R(gan_first, p) = R(aln_first, p - 0.5)."""
    u = np.linspace(0.0, GAN, 90)
    found = []
    for order, p in (("gan_first", pairs), ("aln_first", pairs - 0.5)):
        rows = resolve(dbr_of(Environment().model_copy(update={"layer_order": order}), p), [430.0, 445.0])
        found.append(solve(rows.index, rows.thickness_nm, rows.roughness_nm, [430.0, 445.0], u).R_inside)
    np.testing.assert_allclose(found[0], found[1], atol=1e-13)


def test_a_batch_is_its_parts() -> None:
    """Wavelengths and nodes solved together give bit for bit what they give one by one."""
    n, d = random_stack(np.random.default_rng(9), True, 8)
    wavelengths, u = np.array([400.0, 445.0, 490.0]), np.linspace(0.0, 2.0, 7)
    batch = solve(n, d, 1.0, wavelengths, u)
    for w, nm in enumerate(wavelengths):
        for i, node in enumerate(u):
            one = solve(n, d, 1.0, [nm], [node])
            assert np.array_equal(one.r_outside[0, :, 0], batch.r_outside[w, :, i])
            assert np.array_equal(one.S_R_inside[0, :, 0], batch.S_R_inside[w, :, i])


def test_an_opaque_layer_and_a_wide_gap_give_zeros_and_no_overflow() -> None:
    """A millimetre of silver or of evanescent gap passes exactly nothing; R stays what one face has."""
    thick = solve([GAN, SILVER, 1.0], [1e6], 0.0, [445.0], [0.0, 0.9])
    face = solve([GAN, SILVER], [], 0.0, [445.0], [0.0, 0.9])
    assert not thick.T_inside.any()
    np.testing.assert_allclose(thick.R_inside, face.R_inside, rtol=1e-13)
    gap = solve([GAN, 1.0, GAN], [1e6], 0.0, [445.0], [1.5])
    np.testing.assert_allclose(gap.R_inside, 1.0, atol=1e-13)
    assert not gap.T_inside.any()


def test_light_tunnels_through_a_narrow_gap() -> None:
    """Frustrated total reflection: T falls as exp(-2 kappa d) with the width of the gap, once it is wide."""
    kappa = np.sqrt(1.5**2 - 1.0) * 2 * np.pi / 445.0
    widths = np.array([400.0, 500.0])
    T = [solve([GAN, 1.0, GAN], [width], 0.0, [445.0], [1.5]).T_inside[0, :, 0] for width in widths]
    np.testing.assert_allclose(T[1] / T[0], np.exp(-2 * kappa * 100.0), rtol=1e-3)
    assert (T[0] > 1e-8).all()


def test_a_node_exactly_at_a_layers_index_is_finite() -> None:
    """At u = n of a layer, where the waves to and fro coincide, the result joins its neighbours."""
    index, thickness = quarter_waves(6, first=ALN, second=GAN)
    index[2] = 2.1793 + 0.0j
    r = solve(index, thickness, 0.0, [445.0], ALN + np.array([-1e-7, 0.0, 1e-7]))
    assert np.isfinite(r.r_inside).all()
    np.testing.assert_allclose(r.r_inside[..., 1], r.r_inside[..., [0, 2]].mean(axis=-1), atol=1e-8)


def test_absorbing_stacks_reflect_differently_from_either_side() -> None:
    """Layers with k = 0.01, 9.5 pairs, 0 degrees: R is 0.683 from GaN and 0.779 from air."""
    index, thickness = quarter_waves(19)
    index = [n + 0.01j if 0 < j < 20 else n for j, n in enumerate(index)]
    wavelength, weight = sampled(Spectrum(), 61)
    r = solve(index, thickness, 0.0, wavelength, [0.0])
    assert weight @ r.R_inside[:, 0, 0] == pytest.approx(0.683, abs=1e-3)
    assert weight @ r.R_outside[:, 0, 0] == pytest.approx(0.779, abs=1e-3)


@pytest.mark.parametrize(
    ("sigma", "R", "T", "scattered"),
    [(0, 0.64680, 0.35320, 0.0), (1, 0.64498, 0.35409, 0.00092), (2, 0.63953, 0.35677, 0.00370),
     (5, 0.60171, 0.37508, 0.02321)],
)  # fmt: skip
def test_rough_faces_of_the_paper_stack(sigma: float, R: float, T: float, scattered: float) -> None:
    """5.5 pairs at 445 nm, 0 degrees: R, T and scattered power of the independent study, and their sum is 1."""
    r = solve(*quarter_waves(11), sigma, [445.0], [0.0])
    found = [r.R_inside, r.T_inside, r.S_R_inside + r.S_T_inside]
    np.testing.assert_allclose([value[0, 0, 0] for value in found], [R, T, scattered], atol=6e-6)
    for total in budgets(r):
        np.testing.assert_allclose(total, 1.0, atol=1e-13)


def test_a_single_rough_face_scatters_by_the_known_factors() -> None:
    """TIS of one GaN/air face, sigma 1 nm: (4 pi n sigma / lambda)^2 R = 0.00493 R from GaN, 0.00080 R from air."""
    r = solve([GAN, 1.0], [], 1.0, [445.0], [0.0])
    smooth = solve([GAN, 1.0], [], 0.0, [445.0], [0.0])
    assert 1.0 - r.R_inside[0, 0, 0] / smooth.R_inside[0, 0, 0] == pytest.approx(0.00493, abs=2e-5)
    assert 1.0 - r.R_outside[0, 0, 0] / smooth.R_outside[0, 0, 0] == pytest.approx(0.00080, abs=5e-6)
    np.testing.assert_allclose(r.S_R_inside + r.R_inside, smooth.R_inside, rtol=1e-12)
    np.testing.assert_allclose(r.S_T_inside + r.T_inside, smooth.T_inside, rtol=1e-12)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 2**31), st.floats(0.1, 5.0))
def test_rough_lossless_stacks_create_no_power(seed: int, sigma: float) -> None:
    """Debye-Waller keeps every lossless stack passive: S >= 0 everywhere, nothing had to be rescaled."""
    rng = np.random.default_rng(seed)
    n, d = random_stack(rng, False, int(rng.integers(0, 12)))
    r = solve(n, d, sigma, [450.0], np.linspace(0.0, n.real[0], 40))
    assert r.excess < 1e-12
    for total in budgets(r):
        np.testing.assert_allclose(total, 1.0, atol=1e-12)
    assert min(x.min() for x in (r.S_R_inside, r.S_T_inside, r.S_R_outside, r.S_T_outside)) >= 0.0


def waves_of_two_faces(n: Any, d: float, k0: float, s: Any, u: float, p: int) -> tuple[Any, Any, Any]:
    """Two rough faces about one layer, light from medium 0: tilted admittances, kz, and the waves at the faces.

    The four unknown amplitudes (reflected, to and fro in the layer at its first face, transmitted) come from one
    linear system, face by face: out = r in + t' in', with the Debye-Waller factors on each r and t.
    """
    kz = np.sqrt(np.array(n) ** 2 - u**2)
    y = kz / np.array(n) ** 2 if p else kz

    def face(i: int, o: int, j: int) -> tuple[float, float]:
        r = (y[i] - y[o]) / (y[i] + y[o])
        return r * np.exp(-2 * (kz[i] * s[j] * k0) ** 2), (1 + r) * np.exp(-(((kz[i] - kz[o]) * s[j] * k0) ** 2) / 2)

    (r01, t01), (r10, t10), (r12, t12) = face(0, 1, 0), face(1, 0, 0), face(1, 2, 1)
    e = np.exp(1j * kz[1] * k0 * d)
    # unknown: R back in 0, F forth in 1 at face 0, B back in 1 at face 0, T
    matrix = np.array([[1, 0, -t10, 0], [0, 1, -r10, 0], [0, -r12 * e * e, 1, 0], [0, -t12 * e, 0, 1]])
    R, F, B, T = np.linalg.solve(matrix, np.array([r01, t01, 0, 0]))
    return y, kz, (R, B, T, F * e)


@pytest.mark.parametrize("p", [0, 1])
@pytest.mark.parametrize("u", [0.0, 0.6, 0.95])
@pytest.mark.parametrize("s", [(3.0, 0.0), (0.0, 2.0), (1.0, 3.0)])
def test_scatter_of_two_faces_is_divided_as_the_waves_that_meet_them(
    s: tuple[float, float], u: float, p: int
) -> None:
    """S and its halves from both sides, against the waves of a linear system and what each loses at each face.

    A wave onto a face scatters the part that its r^2 lost back to where it came from, that of t^2 to the far side;
    so of a wave that travels back it is the t^2 part that goes to the side of incidence.
    """
    n, d, k0 = [2.5, 1.7, 1.0], 70.0, 2 * np.pi / 445.0
    found = solve(n, [d], s, [445.0], [u])
    for side in ("inside", "outside"):
        step = 1 if side == "inside" else -1
        media, rough = n[::step], s[::step]
        y, kz, (R, B, T, F1) = waves_of_two_faces(media, d, k0, rough, u, p)

        def lost(i: int, o: int, j: int, y: Any = y, kz: Any = kz, rough: Any = rough) -> tuple[float, float]:
            r, sigma = (y[i] - y[o]) / (y[i] + y[o]), rough[j] * k0
            by_r, by_t = -np.expm1(-4 * (kz[i] * sigma) ** 2), -np.expm1(-(((kz[i] - kz[o]) * sigma) ** 2))
            return y[i] * r**2 * by_r, y[o] * (1 + r) ** 2 * by_t

        a, b, c = lost(0, 1, 0), lost(1, 0, 0), lost(1, 2, 1)
        back = a[0] + abs(B) ** 2 * b[1] + abs(F1) ** 2 * c[0]
        onward = a[1] + abs(B) ** 2 * b[0] + abs(F1) ** 2 * c[1]
        scattered = 1.0 - abs(R) ** 2 - abs(T) ** 2 * y[2] / y[0]
        S_R, S_T = getattr(found, f"S_R_{side}")[0, p, 0], getattr(found, f"S_T_{side}")[0, p, 0]
        halves = np.array([back, onward]) / (back + onward) * scattered
        np.testing.assert_allclose([S_R, S_T], halves, rtol=1e-9)


def test_scatter_of_a_stack_turned_round_is_that_from_the_other_side() -> None:
    """Eight rough layers, three of them lossy: inside and outside change places, the halves of S with them."""
    n, d = random_stack(np.random.default_rng(21), False, 8)
    n[[2, 5, 6]] += 0.02j
    s = np.linspace(0.2, 2.0, 9)
    u = np.linspace(0.0, 0.99 * n.real[[0, -1]].min(), 20)
    there, back = solve(n, d, s, [450.0], u), solve(n[::-1], d[::-1], s[::-1], [450.0], u)
    for name in ("R", "T", "S_R", "S_T", "A"):
        np.testing.assert_allclose(getattr(there, f"{name}_inside"), getattr(back, f"{name}_outside"), atol=1e-13)
    assert np.abs(there.S_R_inside - there.S_R_outside).max() > 1e-4
    assert np.abs(there.S_T_inside - there.S_T_outside).max() > 1e-4


def test_layers_of_one_material_and_several_thicknesses_agree_with_tmm() -> None:
    """Equal indices two apart with thicknesses that differ: no layer takes the phase of another."""
    n = np.array([2.5, *([1.5, 2.2] * 5), 1.0])
    d = np.array([40.0, 50.0, 60.0, 55.0, 45.0, 80.0, 45.0, 30.0, 90.0, 20.0])
    u = np.array([0.0, 0.4, 0.9])
    R = solve(n, d, 0.0, [445.0], u).R_inside[0]
    for p, name in enumerate("sp"):
        theirs = [tmm.coh_tmm(name, n, [np.inf, *d, np.inf], np.arcsin(x / 2.5), 445.0)["R"] for x in u]
        np.testing.assert_allclose(R[p], theirs, atol=1e-12)


@pytest.mark.parametrize("below", [1e-5, 1e-7, 1e-9])
def test_a_wave_that_nearly_grazes_in_a_thick_layer_keeps_its_phase(below: float) -> None:
    """2 um of 1.5 between 2.5 and 2.0 at u just below 1.5: the closed form of one layer, to 1e-8."""
    u, k0, d = 1.5 * (1.0 - below), 2 * np.pi / 445.0, 2000.0
    kz = np.sqrt(np.array([2.5, 1.5, 2.0]) ** 2 - u**2)
    kz[1] = 1.5 * np.sqrt(below * (2.0 - below))  # without the rounding of the difference
    r01, r12 = (kz[0] - kz[1]) / (kz[0] + kz[1]), (kz[1] - kz[2]) / (kz[1] + kz[2])
    turn = np.exp(2j * kz[1] * k0 * d)
    R = abs((r01 + r12 * turn) / (1 + r01 * r12 * turn)) ** 2
    assert solve([2.5, 1.5, 2.0], [d], 0.0, [445.0], [u]).R_inside[0, 0, 0] == pytest.approx(R, abs=2e-7)


def test_what_an_absorbing_far_side_takes_is_transmitted_not_absorbed() -> None:
    """Clear layers on silver and on GaN with k: from the clear side A = 0 exactly and R + T + S = 1."""
    for far in (SILVER, GAN + 0.3j):
        for s in (0.0, 0.5):
            r = solve([far, 2.0, 1.5, 1.0], [60.0, 80.0], s, [445.0], np.linspace(0.0, 0.99, 12))
            assert not r.A_outside.any()
            np.testing.assert_allclose(r.R_outside + r.T_outside + r.S_R_outside + r.S_T_outside, 1.0, atol=1e-12)


def test_roughness_beyond_the_model_is_refused() -> None:
    """A metal film with rough faces, and Nevot-Croce where R + T exceeds 1, are refused by name and size."""
    with pytest.raises(InputError, match=r"roughness_nm: got 5.0.*debye_waller"):
        solve([GAN, SILVER, 1.0], [50.0], 5.0, [445.0], np.linspace(0.0, GAN, 300))
    with pytest.raises(InputError, match="nevot_croce"):
        solve(*quarter_waves(11), 5.0, [445.0], [0.0], roughness_model="nevot_croce")


def test_graded_faces_reflect_as_known_where_they_are_allowed() -> None:
    """Nevot-Croce multiplies the reflectance of one face by exp(-4 k1 k2 s^2); silicon, whose T is not measured."""
    k = 2 * np.pi / 445.0
    graded = solve([3.0 + 1.0j, 1.0], [], 0.01, [445.0], [0.0], roughness_model="nevot_croce")
    smooth = solve([3.0 + 1.0j, 1.0], [], 0.0, [445.0], [0.0])
    assert graded.R_outside[0, 0, 0] / smooth.R_outside[0, 0, 0] == pytest.approx(
        np.exp(-4.0 * 3.0 * (k * 0.01) ** 2), rel=1e-12
    )


def test_published_values_of_an_absorbing_stack() -> None:
    """The values of a Mathematica program that tmm's own tests cite: R, T, r_s, psi, Delta, three lossy layers."""
    r = solve([1.0, 2 + 4j, 3 + 0.3j, 1 + 0.1j], [2.0, 3.0], 0.0, [100.0], [np.sin(0.1)])
    np.testing.assert_allclose(r.R_inside[0, :, 0], [0.37273208839139516, 0.37016110373044969], rtol=1e-13)
    np.testing.assert_allclose(r.T_inside[0, :, 0], [0.22604491247079261, 0.22824374314132009], rtol=1e-13)
    assert r.r_inside[0, 0, 0] == pytest.approx(-0.60331226568845775 - 0.093522181653632019j, rel=1e-13)
    rho = r.r_inside[0, 1, 0] / r.r_inside[0, 0, 0]
    assert np.arctan(abs(rho)) == pytest.approx(0.78366777347038352, rel=1e-13)
    assert np.angle(-rho) == pytest.approx(0.0021460774404193292, rel=1e-9)


def test_surface_plasmon_dip() -> None:
    """Glass | 5 nm Cr | 30 nm Au | air at 633 nm absorbs nearly all p light near 45.5 deg; the case broke others."""
    n, d, theta = (
        np.array([1.517, 3.719 + 4.362j, 0.130 + 3.162j, 1.0]),
        [5.0, 30.0],
        np.radians(np.arange(30, 60, 0.1)),
    )
    r = solve(n, d, 0.0, [633.0], 1.517 * np.sin(theta))
    dip = int(r.R_inside[0, 1].argmin())
    assert np.degrees(theta[dip]) == pytest.approx(45.5, abs=0.11)
    assert r.R_inside[0, 1, dip] < 0.002
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = tmm.coh_tmm("p", n, [np.inf, *d, np.inf], theta[dip], 633.0)["R"]
    assert r.R_inside[0, 1, dip] == pytest.approx(theirs, abs=1e-12)


@pytest.mark.parametrize("absorbing", [False, True])
def test_random_stacks_agree_with_tmm(absorbing: bool) -> None:
    """100 stacks each, 1 to 40 layers, s and p, both sides, to 89.9 deg: r, t, R, T of tmm 0.2.0 to 1e-10."""
    rng = np.random.default_rng(1 + absorbing)
    for _ in range(100):
        n, d = random_stack(rng, absorbing, int(rng.integers(1, 41)))
        wavelength = rng.uniform(380.0, 800.0)
        for side in ("inside", "outside"):
            step = 1 if side == "inside" else -1
            theta = np.radians(rng.choice([0.0, 89.9, rng.uniform(0.0, 89.9)]))
            r = solve(n, d, 0.0, [wavelength], [n[::step][0].real * np.sin(theta)])
            t = r.t_inside_to_outside if side == "inside" else r.t_outside_to_inside
            ours = [getattr(r, f"r_{side}"), t, getattr(r, f"R_{side}"), getattr(r, f"T_{side}")]
            for p, name in enumerate("sp"):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    theirs = tmm.coh_tmm(name, n[::step], [np.inf, *d[::step], np.inf], theta, wavelength)
                found = np.array([value[0, p, 0] for value in ours])
                np.testing.assert_allclose(found, [theirs[key] for key in "rtRT"], atol=1e-10, rtol=0)


@pytest.mark.parametrize("case", sorted(GOLDEN))
def test_golden_averages(case: str) -> None:
    """Spectrum-averaged R of the double-checked table, both sides and orders, to 1e-9."""
    side, order, pairs = case.split("|")
    environment = Environment().model_copy(update={"layer_order": order.lower().replace("-", "_")})
    wavelength, weight = sampled(Spectrum(), 61)
    rows = resolve(dbr_of(environment, float(pairs)), wavelength)
    u = np.sin(np.radians(GOLDEN[case]["deg"])) * (GAN if side == "GaN" else 1.0)
    r = solve(rows.index, rows.thickness_nm, rows.roughness_nm, wavelength, u)
    R = r.R_inside if side == "GaN" else r.R_outside
    np.testing.assert_allclose(weight @ R.mean(axis=1), GOLDEN[case]["R"], atol=1e-9)


def test_monochromatic_anchors() -> None:
    """445 nm, 5.5 and 6.5 pairs: R(0), R_s(20), R_p(20) to the eight digits known, and r(0) with its sign."""
    u = GAN * np.sin(np.radians([0.0, 20.0]))
    for layers, R0, Rs, Rp in ((11, 0.64680186, 0.75467131, 0.29040285), (13, 0.71485710, 0.78280482, 0.32781715)):
        R = solve(*quarter_waves(layers), 0.0, [445.0], u).R_inside[0]
        np.testing.assert_allclose([R[0, 0], R[0, 1], R[1, 1]], [R0, Rs, Rp], atol=6e-9)
    r = solve(*quarter_waves(11), 0.0, [445.0], [0.0]).r_inside[0, 0, 0]
    assert r == pytest.approx(-0.78826097 - 0.1595196j, abs=1e-7)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"thickness_nm": [-1.0]}, "thickness_nm: got -1.0"),
        ({"thickness_nm": [np.nan]}, "thickness_nm: got nan"),
        ({"wavelength_nm": [0.0]}, "wavelength_nm: got 0.0"),
        ({"u": [-0.1]}, "u: got -0.1"),
        ({"roughness_nm": [-2.0, 0.0]}, "roughness_nm: got -2.0"),
        ({"index": [2.5, 2.0 - 0.1j, 1.0]}, "give k with a plus sign"),
        ({"index": [2.5, 1.0]}, "index: got 'shape"),
        ({"index": [2.5, 1e-200, 1.0]}, "index: got"),
        ({"index": [np.nan, 2.0, 1.0]}, "index: got"),
        ({"thickness_nm": [1e17]}, "thickness_nm: got 1e+17"),
        ({"thickness_nm": [1e300]}, "thickness_nm: got 1e+300"),
        ({"thickness_nm": [np.inf]}, "thickness_nm: got inf"),
        ({"thickness_nm": ["thin"]}, "thickness_nm: got ['thin']"),
        ({"thickness_nm": 50.0}, "thickness_nm: got '0 dimensions'"),
        ({"u": [1e200]}, "u: got 1e+200"),
        ({"u": [0.5 + 1j]}, "u: got [(0.5+1j)]"),
        ({"u": np.zeros((2, 3))}, "u: got 'shape (2, 3)'"),
        ({"roughness_nm": [1.0, 2.0, 3.0]}, "roughness_nm: got 'shape (3,)'"),
        ({"roughness_model": "nevot"}, "roughness_model: got 'nevot'"),
    ],
)
def test_values_out_of_range_are_named(change: dict[str, Any], words: str) -> None:
    """Every bad input is refused with its field and value."""
    good: dict[str, Any] = {
        "index": [2.5, 2.0, 1.0], "thickness_nm": [50.0], "roughness_nm": 0.0, "wavelength_nm": [445.0], "u": [0.5],
    }  # fmt: skip
    with pytest.raises(InputError) as refused:
        solve(**{**good, **change})
    assert words in str(refused.value)
    assert refused.value.allowed
    assert refused.value.mend
