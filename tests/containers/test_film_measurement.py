"""What a spectrometer and an ellipsometer would read: identities, closed forms, and an independent program (tmm)."""

from __future__ import annotations

import numpy as np
import pytest
import tmm
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from containers.mixing import bruggeman
from containers.stack import dbr_of, dbr_stack, resolve
from containers.thin_film.ellipsometry import (
    delta_residual_deg,
    depolarisation,
    ncs_of_psi_delta,
    psi_delta_deg,
)
from containers.thin_film.film_measurement import interlayer, measure, measure_ncs
from containers.thin_film.lossless import stack_reflectance
from luxloop.errors import InputError
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack

AIR, GLASS, SAPPHIRE, GAN, ALN = (Medium(n=n) for n in (1.0, 1.52, 1.78, 2.4869, 2.1793))
SILICON = Medium(n=4.0, k=0.03)
AOI = np.array([0.0, 20.0, 45.0, 60.0, 75.0, 88.0])


def slab(medium: Medium, thickness_nm: float, inside: Medium = AIR, outside: Medium = AIR) -> Stack:
    """A thick plate between two media."""
    plate = Layer(medium=medium, thickness_nm=thickness_nm, coherent=False)
    return Stack(inside=inside, layers=(plate,), outside=outside)


def thick_layers(draw_from: np.random.Generator, count: int, absorbing: bool) -> tuple[Layer, ...]:
    """Random layers, about a third of them thick and incoherent, at least one."""
    layers = []
    for j in range(count):
        thick = j == 0 or draw_from.random() < 0.35
        k = draw_from.random() * (1e-6 if thick else 0.4) if absorbing else 0.0
        medium = Medium(n=1.2 + 1.8 * draw_from.random(), k=k)
        thickness = 3e5 * draw_from.random() + 5e4 if thick else 300.0 * draw_from.random()
        layers.append(Layer(medium=medium, thickness_nm=thickness, coherent=not thick))
    draw_from.shuffle(layers)
    return tuple(layers)


def tmm_powers(stack: Stack, polarisation: str, wavelength_nm: float, aoi_deg: float) -> tuple[float, float]:
    """R and T of the independent program, light from the outside."""
    rows = resolve(stack, [wavelength_nm])
    flags = ["i", *("c" if c else "i" for c in rows.coherent), "i"][::-1]
    depths = [np.inf, *rows.thickness_nm, np.inf][::-1]
    out = tmm.inc_tmm(polarisation, list(rows.index[0, ::-1]), depths, flags, np.radians(aoi_deg), wavelength_nm)
    return out["R"], out["T"]


def fresnel(n_i: float, n_t: float, aoi_deg: NDArray[np.float64]) -> dict[str, NDArray[np.complex128]]:
    """r_s, r_p in the angle form sin(i - t) / sin(i + t), tan(i - t) / tan(i + t), off normal incidence."""
    i = np.radians(aoi_deg)
    t = np.arcsin(n_i * np.sin(i) / n_t + 0j)
    return {"s": -np.sin(i - t) / np.sin(i + t), "p": np.tan(i - t) / np.tan(i + t)}


@pytest.mark.parametrize("polarisation", ["s", "p"])
def test_glass_slab_is_the_closed_sum_of_its_echoes(polarisation: str) -> None:
    """A clear plate gives R = 2r / (1 + r), T = (1 - r) / (1 + r), r the reflectance of one face."""
    angles = AOI[1:]
    r = np.abs(fresnel(1.0, 1.52, angles)[polarisation]) ** 2
    plate = slab(GLASS, 1e6)
    np.testing.assert_allclose(measure(plate, "R", [500.0], angles, polarisation)[0], 2 * r / (1 + r), rtol=1e-13)  # type: ignore[arg-type]  # parametrised
    np.testing.assert_allclose(measure(plate, "T", [500.0], angles, polarisation)[0], (1 - r) / (1 + r), rtol=1e-13)  # type: ignore[arg-type]  # parametrised


def test_absorbing_slab_is_the_closed_sum_of_its_echoes() -> None:
    """With transmittance P of one pass, R = r + (1-r)^2 P^2 r / (1 - r^2 P^2) and T = (1-r)^2 P / (1 - r^2 P^2)."""
    k, d, lam = 2e-5, 1e6, 500.0
    r = abs((1 - (1.52 + 1j * k)) / (1 + 1.52 + 1j * k)) ** 2
    P = np.exp(-4 * np.pi * k * d / lam)
    plate = slab(Medium(n=1.52, k=k), d)
    measured = [measure(plate, q, [lam], [0.0])[0, 0] for q in ("R", "T")]
    expected = [r + (1 - r) ** 2 * P**2 * r / (1 - r**2 * P**2), (1 - r) ** 2 * P / (1 - r**2 * P**2)]
    np.testing.assert_allclose(measured, expected, rtol=1e-8)  # T T' = (1-r)^2 holds to order k


@pytest.mark.parametrize("absorbing", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_partly_coherent_stacks_equal_the_independent_program(seed: int, absorbing: bool) -> None:
    """R and T of random stacks of thick and thin layers are those of tmm.inc_tmm to 1e-10."""
    rng = np.random.default_rng([seed, absorbing])
    stack = Stack(inside=SAPPHIRE, layers=thick_layers(rng, 2 + seed % 5, absorbing), outside=Medium(n=1.0))
    wavelength, angle = 380.0 + 300.0 * rng.random(), 85.0 * rng.random()
    for p in ("s", "p"):
        ours = [measure(stack, q, [wavelength], [angle], p)[0, 0] for q in ("R", "T")]
        np.testing.assert_allclose(ours, tmm_powers(stack, p, wavelength, angle), rtol=0, atol=1e-10)


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    n_out=st.floats(1.3, 3.5),
    aoi=st.floats(0.0, 89.9),
    count=st.integers(1, 6),
    absorbing=st.booleans(),
)
def test_no_power_appears_beyond_total_reflection(
    seed: int, n_out: float, aoi: float, count: int, absorbing: bool
) -> None:
    """Out of a dense medium, thick layers included, R, T and R + T stay within 0 and 1."""
    layers = thick_layers(np.random.default_rng(seed), count, absorbing)
    stack = Stack(inside=AIR, layers=layers, outside=Medium(n=n_out))
    for p in ("s", "p"):
        R, T = (float(measure(stack, q, [450.0], [aoi], p)[0, 0]) for q in ("R", "T"))
        assert -1e-12 <= T <= 1 + 1e-9
        assert -1e-12 <= R <= 1 + 1e-9
        assert R + T <= 1 + 1e-9
        if not absorbing:
            assert abs(R + T - 1.0) < 1e-9


def test_gan_beyond_the_critical_angle_of_a_thick_glass_reflects_all() -> None:
    """GaN | glass 1 mm | air from inside beyond 37.7 deg: the thick layer is evanescent, R = 1, T = 0 exactly."""
    stack = slab(GLASS, 1e6, inside=GAN)
    angles = np.array([38.0, 45.0, 60.0, 85.0])
    np.testing.assert_allclose(measure(stack, "R", [445.0], angles, from_side="inside"), 1.0, atol=1e-14)
    np.testing.assert_array_equal(measure(stack, "T", [445.0], angles, from_side="inside"), 0.0)


def test_evanescent_incoherent_layer_is_opaque_however_thin() -> None:
    """GaN | glass 50 nm, powers added | GaN beyond total reflection: R = 1, T = 0, not 1.97."""
    gap = slab(GLASS, 50.0, inside=GAN, outside=GAN)
    angles = np.array([37.8, 45.0, 60.0, 85.0])
    for p in ("s", "p"):
        np.testing.assert_allclose(measure(gap, "R", [445.0], angles, p), 1.0, atol=1e-14)
        np.testing.assert_array_equal(measure(gap, "T", [445.0], angles, p), 0.0)


def test_rough_face_of_a_thick_plate_reflects_by_the_debye_waller_factor() -> None:
    """An opaque incoherent plate with a 20 nm rough face: R = r exp(-(4 pi s / lambda)^2) at normal incidence."""
    plate = Layer(medium=Medium(n=1.5, k=0.01), thickness_nm=1e6, roughness_nm=20.0, coherent=False)
    stack = Stack(inside=GAN, layers=(plate,), outside=AIR)
    r = abs((0.5 + 0.01j) / (2.5 + 0.01j)) ** 2
    assert measure(stack, "R", [500.0], [0.0])[0, 0] == pytest.approx(
        r * np.exp(-((4 * np.pi * 20 / 500) ** 2)), rel=1e-9
    )


def test_transmission_of_a_clear_partly_coherent_stack_is_the_same_both_ways() -> None:
    """T(outside to inside) = T(inside to outside) at the same k_parallel, with a thick layer in between."""
    rng = np.random.default_rng(5)
    stack = Stack(inside=GAN, layers=thick_layers(rng, 5, absorbing=False), outside=AIR)
    aoi = np.array([0.0, 30.0, 60.0, 80.0])
    aoi_inside = np.degrees(np.arcsin(np.sin(np.radians(aoi)) / 2.4869))
    for p in ("s", "p"):
        forth = measure(stack, "T", [445.0], aoi, p)
        back = measure(stack, "T", [445.0], aoi_inside, p, from_side="inside")
        np.testing.assert_allclose(forth, back, rtol=1e-11)


def test_thick_layer_is_the_mean_over_one_fringe_of_the_thin_one() -> None:
    """Averaging a clear coherent layer over one period of its phase gives what the incoherent layer gives at once."""
    top = Layer(medium=ALN, thickness_nm=51.6)
    lam, periods = 445.0, 64
    mean = np.zeros(2)
    for j in range(periods):
        plate = Layer(medium=SAPPHIRE, thickness_nm=5000.0 + lam / (2 * 1.78) * j / periods)
        stack = Stack(inside=GLASS, layers=(plate, top), outside=AIR)
        mean += [measure(stack, q, [lam], [0.0])[0, 0] / periods for q in ("R", "T")]
    thick = Layer(medium=SAPPHIRE, thickness_nm=5000.0, coherent=False)
    stack = Stack(inside=GLASS, layers=(thick, top), outside=AIR)
    np.testing.assert_allclose([measure(stack, q, [lam], [0.0])[0, 0] for q in ("R", "T")], mean, atol=1e-12)


def test_psi_delta_of_the_independent_program() -> None:
    """psi is that of tmm.ellips; its Delta counts from -r_p / r_s with the other time factor: ours is 180 - Delta."""
    rng = np.random.default_rng(2)
    for _ in range(8):
        media = [Medium(n=1.2 + 2 * rng.random(), k=rng.random() * 0.3) for _ in range(4)]
        layers = tuple(Layer(medium=m, thickness_nm=200 * rng.random()) for m in media[1:])
        stack = Stack(inside=media[0], layers=layers, outside=AIR)
        aoi = 5.0 + 80.0 * rng.random()
        rows = resolve(stack, [500.0])
        peer = tmm.ellips(rows.index[0, ::-1], [np.inf, *rows.thickness_nm[::-1], np.inf], np.radians(aoi), 500.0)
        psi, delta = (measure(stack, q, [500.0], [aoi])[0, 0] for q in ("psi", "delta"))
        assert psi == pytest.approx(np.degrees(peer["psi"]), abs=1e-9)
        assert abs(delta_residual_deg(delta, 180.0 - np.degrees(peer["Delta"]))) < 1e-9


def test_psi_delta_of_the_published_stack() -> None:
    """1 | 2+4i 2 nm | 3+0.3i 3 nm | 1+0.1i, 0.1 rad, 100 nm: the values of an independent Mathematica program."""
    layers = (
        Layer(medium=Medium(n=3.0, k=0.3), thickness_nm=3.0),
        Layer(medium=Medium(n=2.0, k=4.0), thickness_nm=2.0),
    )
    stack = Stack(inside=Medium(n=1.0, k=0.1), layers=layers, outside=AIR)
    psi, delta = (np.radians(measure(stack, q, [100.0], [np.degrees(0.1)])[0, 0]) for q in ("psi", "delta"))
    assert psi == pytest.approx(0.78366777347038352, abs=1e-13)
    assert np.pi - delta == pytest.approx(0.0021460774404193292, abs=1e-13)


def test_delta_of_bare_silicon_falls_from_180_to_0_through_brewster() -> None:
    """The sign of instruments: near 180 deg at small angles, 90 deg at the principal angle, near 0 at grazing."""
    bare = Stack(inside=SILICON, layers=(), outside=AIR)
    delta = measure(bare, "delta", [633.0], [0.0, 40.0, np.degrees(np.arctan(4.0)), 89.0])[0]
    assert delta[0] == pytest.approx(180.0, abs=1e-9)
    assert 175.0 < delta[1] < 180.0
    assert 60.0 < delta[2] < 120.0
    assert 0.0 < delta[3] < 5.0


def test_a_clear_film_on_silicon_lowers_delta_below_180() -> None:
    """2 nm of oxide lower delta at 70 deg, as every instrument shows; the other time factor would raise it."""
    bare = Stack(inside=SILICON, layers=(), outside=AIR)
    oxide = Stack(inside=SILICON, layers=(Layer(medium=Medium(n=1.46), thickness_nm=2.0),), outside=AIR)
    drop = measure(oxide, "delta", [633.0], [70.0]) - measure(bare, "delta", [633.0], [70.0])
    assert -12.0 < drop[0, 0] < -3.0


def test_total_internal_reflection_has_the_closed_phase() -> None:
    """At a bare glass-air face psi = 45 deg, tan(delta / 2) = cos(aoi) sqrt(sin^2(aoi) - 1/n^2) / sin^2(aoi)."""
    glass_air = Stack(inside=GLASS, layers=(), outside=AIR)
    aoi = np.radians([45.0, 50.0, 55.0, 70.0])
    turn = 2 * np.arctan(np.cos(aoi) * np.sqrt(np.sin(aoi) ** 2 - 1.52**-2) / np.sin(aoi) ** 2)
    psi, delta = psi_delta_deg(measure_ncs(glass_air, [500.0], np.degrees(aoi), from_side="inside"))
    np.testing.assert_allclose(psi[0], 45.0, atol=1e-9)
    np.testing.assert_allclose(delta[0], np.degrees(turn), atol=1e-9)


@settings(derandomize=True, max_examples=100, deadline=None)
@given(psi=st.floats(0.01, 89.99), delta=st.floats(0.0, 359.999))
def test_psi_delta_and_ncs_are_inverse(psi: float, delta: float) -> None:
    """psi, delta -> N, C, S -> psi, delta is the identity, delta within [0, 360)."""
    back_psi, back_delta = psi_delta_deg(ncs_of_psi_delta(psi, delta))
    assert back_psi == pytest.approx(psi, abs=1e-9)
    assert 0.0 <= back_delta < 360.0
    assert abs(delta_residual_deg(back_delta, delta)) < 1e-6


def test_delta_residual_is_wrapped() -> None:
    """359 and 1 deg are 2 deg apart, not 358; half a turn is -180."""
    np.testing.assert_allclose(
        delta_residual_deg([359.0, 1.0, 180.0, 10.0], [1.0, 359.0, 0.0, 4.0]), [-2, 2, -180, 6]
    )


def test_a_single_beam_is_not_depolarised_and_a_transparent_plate_is() -> None:
    """Coherent films keep N^2 + C^2 + S^2 = 1; the back of a glass plate adds light of another polarisation state."""
    film = Stack(inside=SILICON, layers=(Layer(medium=SAPPHIRE, thickness_nm=90.0),), outside=AIR)
    np.testing.assert_allclose(depolarisation(measure_ncs(film, [500.0], AOI)), 0.0, atol=1e-14)
    coated = Layer(medium=Medium(n=2.0), thickness_nm=60.0)
    plate = Stack(inside=AIR, layers=(Layer(medium=GLASS, thickness_nm=1e6, coherent=False), coated), outside=AIR)
    lost = depolarisation(measure_ncs(plate, [500.0], [60.0]))[0, 0]
    assert 0.001 < lost < 0.9


def test_back_side_of_a_plate_adds_to_ncs_order_by_order() -> None:
    """N, C, S of a coated plate equal the sum over echoes of intensities, each echo's amplitudes taken from tmm."""
    n, d, lam, aoi = [1.0, 2.0 + 0.1j, 1.52], 60.0, 500.0, np.radians(60.0)
    inner = np.arcsin(np.sin(aoi) / 1.52)
    front = {p: tmm.coh_tmm(p, n, [np.inf, d, np.inf], aoi, lam) for p in "sp"}
    rear = {p: tmm.coh_tmm(p, n[::-1], [np.inf, d, np.inf], inner, lam) for p in "sp"}
    back = {p: tmm.coh_tmm(p, [1.52, 1.0], [np.inf, np.inf], inner, lam)["r"] for p in "sp"}
    echoes = [{p: front[p]["r"] for p in "sp"}]
    echoes += [
        {p: front[p]["t"] * rear[p]["t"] * back[p] ** (j + 1) * rear[p]["r"] ** j for p in "sp"} for j in range(40)
    ]
    ss, pp = (sum(abs(e[p]) ** 2 for e in echoes) for p in "sp")
    ps = sum(e["p"] * np.conj(e["s"]) for e in echoes)
    layers = (
        Layer(medium=GLASS, thickness_nm=1e6, coherent=False),
        Layer(medium=Medium(n=2.0, k=0.1), thickness_nm=d),
    )
    ours = measure_ncs(Stack(inside=AIR, layers=layers, outside=AIR), [lam], [60.0])[:, 0, 0]
    np.testing.assert_allclose(ours, np.array([ss - pp, 2 * ps.real, -2 * ps.imag]) / (ss + pp), atol=1e-12)


@pytest.mark.parametrize("thickness_nm", [300.0, 5000.0, 40000.0])
def test_bandwidth_is_the_gaussian_mean_of_monochromatic_readings(thickness_nm: float) -> None:
    """R, T, N, C, S with a 4 nm line equal a dense Gauss-weighted mean of monochromatic intensities to 2e-6."""
    stack = Stack(inside=SILICON, layers=(Layer(medium=ALN, thickness_nm=thickness_nm),), outside=AIR)
    sigma = 4.0 / (2 * np.sqrt(2 * np.log(2)))
    x = np.linspace(-7, 7, 6001)
    g = np.exp(-(x**2) / 2) / np.exp(-(x**2) / 2).sum()
    dense = measure(stack, "R", 500.0 + sigma * x, [50.0], "s"), measure(stack, "R", 500.0 + sigma * x, [50.0], "p")
    ss, pp = (g @ power[:, 0] for power in dense)
    ncs = measure_ncs(stack, 500.0 + sigma * x, [50.0])[:, :, 0]
    both = dense[0][:, 0] + dense[1][:, 0]
    expected = np.array([ss - pp, g @ (ncs[1] * both), g @ (ncs[2] * both)]) / (ss + pp)
    assert measure(stack, "R", [500.0], [50.0], "s", bandwidth_nm=4.0)[0, 0] == pytest.approx(ss, abs=2e-6)
    np.testing.assert_allclose(measure_ncs(stack, [500.0], [50.0], bandwidth_nm=4.0)[:, 0, 0], expected, atol=2e-6)


def test_broad_line_makes_a_thick_coherent_film_incoherent() -> None:
    """60 um of clear film read with a 10 nm line is the same film with powers added, to 1e-4 at normal incidence."""
    film = Layer(medium=SAPPHIRE, thickness_nm=60000.0)
    thick = film.model_copy(update={"coherent": False})
    readings = [
        measure(Stack(inside=GLASS, layers=(layer,), outside=AIR), "R", [600.0], [0.0], bandwidth_nm=10.0)[0, 0]
        for layer in (film, thick)
    ]
    assert readings[0] == pytest.approx(readings[1], abs=1e-4)


def test_zero_bandwidth_is_the_limit_of_a_narrow_line() -> None:
    """A line of 0.001 nm reads what monochromatic light reads."""
    stack = Stack(inside=SILICON, layers=(Layer(medium=ALN, thickness_nm=800.0),), outside=AIR)
    for quantity in ("R", "psi", "delta"):
        narrow = measure(stack, quantity, [450.0, 500.0], AOI, bandwidth_nm=0.001)
        np.testing.assert_allclose(narrow, measure(stack, quantity, [450.0, 500.0], AOI), atol=1e-5)


def test_bruggeman_of_gan_and_air_and_its_ends() -> None:
    """Half GaN, half air has n = 1.6949 (published table); shares 0 and 1 are the media, metals included."""
    assert bruggeman(2.4869, 1.0).real == pytest.approx(1.6949, abs=5e-5)
    pair = np.array([2.4869, 0.04 + 2.6j]), np.array([1.0, 1.5 + 0.0j])
    np.testing.assert_allclose(bruggeman(*pair, share_b=0.0), pair[0], rtol=1e-12)
    np.testing.assert_allclose(bruggeman(*pair, share_b=1.0), pair[1], rtol=1e-12)


def test_bruggeman_solves_its_own_condition_and_is_symmetric() -> None:
    """The mixed index makes the sum of polarisabilities vanish, has k >= 0, whichever medium is named first."""
    a, b, f = 0.04 + 2.6j, 1.78 + 0.0j, np.linspace(0.0, 1.0, 21)
    n = bruggeman(a, b, 0.3)
    e, e_a, e_b = n**2, a**2, b**2
    assert abs(0.7 * (e_a - e) / (e_a + 2 * e) + 0.3 * (e_b - e) / (e_b + 2 * e)) < 1e-12
    mixed = np.array([complex(bruggeman(a, b, share)) for share in f])
    swapped = np.array([complex(bruggeman(b, a, 1 - share)) for share in f])
    np.testing.assert_allclose(mixed, swapped, atol=1e-12)
    assert np.all(mixed.imag >= 0.0)


def test_interlayer_gives_the_published_reflectance_of_the_dbr() -> None:
    """5.5 pairs, GaN-first: mixing the outermost face moves R(0) 0.6384 to 0.6375 (5 nm), 0.6330 (10 nm)."""
    dbr = dbr_stack(5.5, gan=GAN, aln=ALN, gan_layer_nm=45.2, aln_layer_nm=51.6)
    line = np.linspace(400.0, 490.0, 61)
    g = np.exp(-((line - 445.0) ** 2) / 2 / (18 / 2.354820045) ** 2)
    read = [
        float(g @ measure(interlayer(dbr, 11, nm) if nm else dbr, "R", line, [0.0])[:, 0] / g.sum())
        for nm in (0.0, 5.0, 10.0)
    ]
    np.testing.assert_allclose(read, [0.638402, 0.6375, 0.6330], atol=6e-5)


@pytest.mark.parametrize("face", [0, 1, 2])
@pytest.mark.parametrize("share_outer", [0.0, 1.0])
def test_an_interlayer_that_is_all_one_neighbour_changes_nothing(face: int, share_outer: float) -> None:
    """Of share 0 it is the inner neighbour, taken from it; of share 1 the outer one: the stack is what it was."""
    layers = (Layer(medium=ALN, thickness_nm=50.0), Layer(medium=GLASS, thickness_nm=80.0))
    stack = Stack(inside=SILICON, layers=layers, outside=AIR)
    wave = np.array([445.0])
    mixed = measure(interlayer(stack, face, 7.0, share_outer), "R", wave, AOI)
    np.testing.assert_allclose(mixed, measure(stack, "R", wave, AOI), atol=1e-13)


def test_an_interlayer_of_little_outer_material_is_nearly_the_inner_one() -> None:
    """GaN with a fifth of glass: an index between theirs, nearer to GaN; a fifth of it is taken from the glass."""
    stack = Stack(inside=GAN, layers=(Layer(medium=GLASS, thickness_nm=50.0),), outside=AIR)
    rows = interlayer(stack, 0, 10.0, 0.2)(np.array([445.0]))
    linear = 0.8 * 2.4869 + 0.2 * 1.52
    assert rows.index[0, 1].real == pytest.approx(linear, abs=0.05)
    np.testing.assert_allclose(rows.thickness_nm, [10.0, 48.0])


def test_interlayers_can_be_added_one_after_the_other_and_zero_thickness_changes_nothing() -> None:
    """An interlayer of 0 nm is no interlayer; two at two faces make a stack of two layers more."""
    stack = Stack(inside=GAN, layers=(Layer(medium=ALN, thickness_nm=50.0),), outside=AIR)
    wave = np.array([445.0, 460.0])
    plain = measure(stack, "R", wave, AOI)
    np.testing.assert_allclose(measure(interlayer(stack, 1, 0.0), "R", wave, AOI), plain, atol=1e-14)
    twice = interlayer(interlayer(stack, 1, 3.0), 0, 2.0)(wave)
    np.testing.assert_array_equal(twice.thickness_nm, [2.0, 47.5, 3.0])
    assert twice.index.shape == (2, 5)


def test_roughness_lowers_the_specular_reading() -> None:
    """Rough faces scatter: specular R + T of a clear stack falls below 1, the more the rougher."""
    sums = []
    for nm in (0.0, 2.0, 5.0):
        layer = Layer(medium=ALN, thickness_nm=51.6, roughness_nm=nm)
        stack = Stack(inside=GAN, layers=(layer,), outside=AIR, inside_roughness_nm=nm)
        sums.append(sum(float(measure(stack, q, [445.0], [0.0])[0, 0]) for q in ("R", "T")))
    assert sums[0] == pytest.approx(1.0, abs=1e-12)
    assert sums[0] > sums[1] > sums[2]


def test_unpolarised_is_the_mean_and_an_array_is_its_single_readings() -> None:
    """u = (s + p) / 2; a grid of wavelengths and angles equals reading each point alone, bit for bit."""
    stack = Stack(inside=GAN, layers=(Layer(medium=ALN, thickness_nm=51.6),), outside=AIR)
    wave = [440.0, 450.0]
    whole = {p: measure(stack, "R", wave, AOI, p) for p in ("s", "p", "u")}
    np.testing.assert_allclose(whole["u"], (whole["s"] + whole["p"]) / 2, rtol=1e-15)
    single = [[measure(stack, "R", [w], [a], "s")[0, 0] for a in AOI] for w in wave]
    np.testing.assert_array_equal(whole["s"], single)


BARE = Stack(inside=SILICON, layers=(), outside=AIR)
LOSSY_OUT = Stack(inside=AIR, layers=(), outside=Medium(n=2.49, k=0.01))


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("aoi_deg", (BARE, "R", [500.0], [90.0])),
        ("aoi_deg", (BARE, "R", [500.0], [-1.0])),
        ("aoi_deg", (BARE, "R", [500.0], [np.nan])),
        ("aoi_deg", (BARE, "R", [500.0], [])),
        ("aoi_deg", (BARE, "R", [500.0], [30.0 + 1j])),
        ("aoi_deg", (BARE, "R", [500.0], ["steep"])),
        ("wavelength_nm", (BARE, "R", [500.0 + 1j], [0.0])),
        ("wavelength_nm", (BARE, "R", [np.nan], [0.0])),
        ("wavelength_nm", (BARE, "R", [0.0], [0.0])),
        ("quantity", (BARE, "rho", [500.0], [0.0])),
        ("polarisation", (BARE, "R", [500.0], [0.0], "x")),
        ("polarisation", (BARE, "psi", [500.0], [0.0], "s")),
        ("bandwidth_nm", (BARE, "R", [500.0], [0.0], "u", -1.0)),
        ("bandwidth_nm", (BARE, "R", [500.0], [0.0], "u", np.nan)),
        ("bandwidth_nm", (BARE, "R", [500.0], [0.0], "u", 400.0)),
        ("from_side", (BARE, "R", [500.0], [0.0], "u", 0.0, "above")),
        ("outside", (LOSSY_OUT, "delta", [500.0], [0.0])),
        ("inside", (BARE, "psi", [500.0], [0.0], "u", 0.0, "inside")),
    ],
)
def test_bad_input_is_named(field: str, arguments: tuple[object, ...]) -> None:
    """A value out of range is refused with its field, the value and what is allowed."""
    with pytest.raises(InputError) as refusal:
        measure(*arguments)  # type: ignore[arg-type]  # wrong on purpose
    assert refusal.value.field == field
    assert refusal.value.allowed
    assert refusal.value.mend


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("share_b", (1.5, 1.0, 2.0)),
        ("share_b", (1.5, 1.0, -0.1)),
        ("share_b", (1.5, 1.0, np.nan)),
        ("index_a", (np.nan, 1.0)),
        ("index_b", (1.5, 0.5 - 1j)),
    ],
)
def test_bruggeman_refuses_shares_and_indices_that_do_not_exist(field: str, arguments: tuple[complex, ...]) -> None:
    """A share of 2 gave an index of 0.68 without a word."""
    with pytest.raises(InputError) as refusal:
        bruggeman(*arguments)  # type: ignore[arg-type]  # wrong on purpose
    assert refusal.value.field == field


def test_bandwidth_on_a_substrate_called_coherent_names_the_mend() -> None:
    """5 mm of coherent sapphire under a 20 nm line asks for coherent = false instead of hours of fringes."""
    wafer = Stack(inside=AIR, layers=(Layer(medium=SAPPHIRE, thickness_nm=5e6),), outside=AIR)
    with pytest.raises(InputError, match="coherent = false"):
        measure(wafer, "T", [500.0], [0.0], bandwidth_nm=20.0)


@pytest.mark.parametrize(
    ("face", "nm", "share"), [(2, 1.0, 0.5), (-1, 1.0, 0.5), (0, -1.0, 0.5), (0, 1.0, 1.5), (0, 120.0, 0.5)]
)
def test_interlayer_refuses_what_the_stack_does_not_have(face: int, nm: float, share: float) -> None:
    """A face beyond the stack, a negative thickness, a share above 1, more material than the layer has: refused."""
    stack = Stack(inside=GAN, layers=(Layer(medium=ALN, thickness_nm=50.0),), outside=AIR)
    with pytest.raises(InputError):
        interlayer(stack, face, nm, share)(np.array([445.0]))


@pytest.mark.parametrize("pairs", [9.5, 30.5, 60.0])
def test_the_line_average_resolves_the_resonances_of_many_pairs(pairs: float) -> None:
    """Resonances far narrower than a fringe: the average is that of 20,001 wavelengths, to 2e-6."""
    stack, angles = dbr_of(Environment(), pairs), [0.0, 15.0, 18.0, 21.0]
    line = np.linspace(445.0 - 40.0, 445.0 + 40.0, 20_001)
    weight = np.exp(-4.0 * np.log(2.0) * ((line - 445.0) / 18.0) ** 2)
    u = 2.4869 * np.sin(np.radians(angles))
    exact = sum(
        weight[part] @ stack_reflectance(resolve(stack, line[part]), u).mean(axis=1)
        for part in np.array_split(np.arange(line.size), 10)
    )
    found = measure(stack, "R", [445.0], angles, "u", 18.0, "inside")[0]
    np.testing.assert_allclose(found, exact / weight.sum(), atol=2e-6)
