"""A dipole in a stack: boundless media, perfect mirrors, energy, reciprocity with the fields of tmm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import tmm
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad

from containers.stack import StackRows, dbr_stack, resolve
from containers.thin_film.dipole import (
    Emitter,
    Orientation,
    line_average,
    outward_power,
    radiant_intensity,
    total_power,
)
from containers.thin_film.transfer_matrix import solve
from luxloop.errors import InputError
from luxloop.stack import Layer, Medium, Stack

AIR, GAN, ALN = Medium(n=1.0), Medium(n=2.4869), Medium(n=2.1793)
SILVER = Medium(n=0.04, k=2.6)
N = 2.4869
LAM = 445.0
K = 2 * np.pi * N / LAM
ORIENTATIONS: tuple[Orientation, ...] = ("horizontal", "vertical", "isotropic")
Real = NDArray[np.float64]


def emitting(thickness_nm: float, below: Medium = GAN, above: Medium = AIR, n: float = N) -> Stack:
    """One emitting layer between two half spaces."""
    return Stack(inside=below, layers=(Layer(medium=Medium(n=n), thickness_nm=thickness_nm),), outside=above)


def mirrored(thickness_nm: float, both_sides: bool = False) -> Callable[[Real], StackRows]:
    """An emitting layer on a mirror so good (k = 1e11) that it is perfect; above it the same medium, or another."""

    def rows(wavelength_nm: Real) -> StackRows:
        mirror = 1e-9 + 1e11j
        media = np.array([[mirror, N, mirror if both_sides else N]]) + np.zeros((len(wavelength_nm), 1))
        coherent, film = np.array([True]), np.array([False])
        return StackRows(wavelength_nm, media.astype(complex), np.array([thickness_nm]), np.zeros(2), coherent, film)

    return rows


def gauss(low: float, high: float, count: int = 400) -> tuple[Real, Real]:
    """Nodes and weights on an interval."""
    x, w = np.polynomial.legendre.leggauss(count)
    return low + (high - low) * (x + 1) / 2, w * (high - low) / 2


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_boundless_medium_takes_power_one_half_each_way(orientation: Orientation) -> None:
    """Without faces the pattern integrates to 1, half up, half down, and the Purcell factor is 1."""
    free, dipole = emitting(300.0, GAN, GAN), Emitter(layer=1, depth_nm=100.0, orientation=orientation)
    theta, d_theta = gauss(0.0, np.pi / 2)
    pattern = radiant_intensity(free, dipole, [LAM], theta).sum(axis=1)[0]
    assert 2 * np.pi * np.sum(pattern * np.sin(theta) * d_theta) == pytest.approx(0.5, abs=1e-13)
    assert outward_power(free, dipole, [LAM], "inside")[0] == pytest.approx(0.5, abs=1e-12)
    assert total_power(free, dipole, [LAM])[0] == pytest.approx(1.0, abs=1e-14)


def test_in_plane_pattern_is_that_of_quantum_wells() -> None:
    """In-plane dipoles radiate (3 / 16 pi)(1 + cos^2), vertical ones (3 / 8 pi) sin^2, isotropic ones 1 / 4 pi."""
    free, theta = emitting(300.0, GAN, GAN), np.linspace(0.0, 1.5, 7)
    expected = {
        "horizontal": 3 / (16 * np.pi) * (1 + np.cos(theta) ** 2),
        "vertical": 3 / (8 * np.pi) * np.sin(theta) ** 2,
        "isotropic": np.full(7, 1 / (4 * np.pi)),
    }
    for orientation in ORIENTATIONS:
        dipole = Emitter(layer=1, depth_nm=100.0, orientation=orientation)
        pattern = radiant_intensity(free, dipole, [LAM], theta).sum(axis=1)[0]
        np.testing.assert_allclose(pattern, expected[orientation], atol=1e-15)


def test_escape_cones_of_the_published_fractions() -> None:
    """Top cone of GaN: 0.0607 in-plane against 0.0422 isotropic; one side-wall cone in-plane: 0.0330."""
    free, edge = emitting(300.0, GAN, GAN), np.arcsin(1 / N)
    theta, d_theta = gauss(0.0, edge)
    for orientation, fraction in (("horizontal", 0.0607), ("isotropic", 0.0422)):
        dipole = Emitter(layer=1, depth_nm=100.0, orientation=orientation)
        pattern = radiant_intensity(free, dipole, [LAM], theta).sum(axis=1)[0]
        assert 2 * np.pi * np.sum(pattern * np.sin(theta) * d_theta) == pytest.approx(fraction, abs=5e-5)
    azimuth = np.linspace(0.0, np.pi / 2, 65)
    from_z = np.arccos(
        np.sin(theta)[:, None] * np.cos(azimuth)
    )  # angle to the layer normal, about a side-wall normal
    pattern = radiant_intensity(free, Emitter(layer=1, depth_nm=100.0), [LAM], from_z.ravel()).sum(axis=1)
    around = np.trapezoid(pattern.reshape(from_z.shape), azimuth, axis=1) * 4
    assert np.sum(around * np.sin(theta) * d_theta) == pytest.approx(0.0330, abs=5e-5)


@pytest.mark.parametrize("depth_nm", [1.0, 10.0, 50.0, 137.0, 600.0])
def test_total_power_before_a_perfect_mirror_is_the_image_dipole(depth_nm: float) -> None:
    """With x = 2kz: F_v = 1 - 3(cos x / x^2 - sin x / x^3), F_h = 1 - 3/2 (sin x / x + cos x / x^2 - sin x / x^3)."""
    x = 2 * K * depth_nm
    vertical = 1 - 3 * (np.cos(x) / x**2 - np.sin(x) / x**3)
    horizontal = 1 - 1.5 * (np.sin(x) / x + np.cos(x) / x**2 - np.sin(x) / x**3)
    stack = mirrored(depth_nm + 300.0)
    for orientation, expected in (
        ("vertical", vertical),
        ("horizontal", horizontal),
        ("isotropic", vertical / 3 + 2 / 3 * horizontal),
    ):
        dipole = Emitter(layer=1, depth_nm=depth_nm, orientation=orientation)
        assert total_power(stack, dipole, [LAM])[0] == pytest.approx(expected, abs=1e-9)
        assert outward_power(stack, dipole, [LAM])[0] == pytest.approx(expected, abs=1e-9)


def test_dipole_on_a_perfect_mirror_is_quenched_or_doubled() -> None:
    """At 0.1 nm a horizontal dipole is cancelled by its image, a vertical one is doubled."""
    stack = mirrored(300.0)
    assert total_power(stack, Emitter(layer=1, depth_nm=0.1, orientation="horizontal"), [LAM])[0] < 1e-5
    doubled = total_power(stack, Emitter(layer=1, depth_nm=0.1, orientation="vertical"), [LAM])[0]
    assert doubled == pytest.approx(2.0, abs=1e-4)


@pytest.mark.parametrize("depth_nm", [40.0, 89.5])
def test_pattern_before_a_perfect_mirror_is_two_beam_interference(depth_nm: float) -> None:
    """s light of a horizontal dipole at height z goes as 4 sin^2(kz cos), p as that times cos^2."""
    theta = np.linspace(0.0, 1.4, 9)
    pattern = radiant_intensity(mirrored(300.0), Emitter(layer=1, depth_nm=depth_nm), [LAM], theta)[0]
    beat = 3 / (16 * np.pi) * 4 * np.sin(K * depth_nm * np.cos(theta)) ** 2
    np.testing.assert_allclose(pattern, [beat, beat * np.cos(theta) ** 2], atol=1e-9)


@pytest.mark.parametrize(("length_nm", "depth_nm"), [(60.0, 20.0), (200.0, 100.0), (200.0, 37.0), (700.0, 123.0)])
def test_total_power_between_perfect_mirrors_is_the_sum_of_modes(length_nm: float, depth_nm: float) -> None:
    """All is guided: F 4L / 3 lambda = 1 + 2 sum (1 - s^2) cos^2 vertical, sum (1 + s^2) sin^2 horizontal."""
    half_waves = np.arange(1, int(2 * length_nm * N / LAM) + 1)
    s = half_waves * LAM / (2 * N * length_nm)
    phase = half_waves * np.pi * depth_nm / length_nm
    per_mode = 0.75 * LAM / N / length_nm
    vertical = per_mode * (1 + 2 * np.sum((1 - s**2) * np.cos(phase) ** 2))
    horizontal = per_mode * np.sum((1 + s**2) * np.sin(phase) ** 2)
    for orientation, expected in (("vertical", vertical), ("horizontal", horizontal)):
        dipole = Emitter(layer=1, depth_nm=depth_nm, orientation=orientation)
        assert total_power(mirrored(length_nm, both_sides=True), dipole, [LAM])[0] == pytest.approx(
            expected, abs=1e-9
        )


@example(seed=6469, count=3, orientation="horizontal", place=0.5)  # a leaky resonance of width 1e-6
@settings(derandomize=True, max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(1, 4),
    orientation=st.sampled_from(ORIENTATIONS),
    place=st.floats(0.05, 0.95),
)
def test_without_guided_modes_all_power_leaves(seed: int, count: int, orientation: Orientation, place: float) -> None:
    """Clear films of lower index than the half spaces guide nothing: power up + power down = total power."""
    rng = np.random.default_rng(seed)
    layers = tuple(
        Layer(medium=Medium(n=1.1 + 0.8 * u), thickness_nm=20 + 300 * v) for u, v in rng.random((count, 2))
    )
    stack = Stack(inside=Medium(n=2.0 + rng.random()), layers=layers, outside=Medium(n=1.9))
    m = int(rng.integers(1, count + 1))
    dipole = Emitter(layer=m, depth_nm=place * layers[m - 1].thickness_nm, orientation=orientation)
    wave = [400.0, 520.0]
    leaves = outward_power(stack, dipole, wave) + outward_power(stack, dipole, wave, "inside")
    np.testing.assert_allclose(leaves, total_power(stack, dipole, wave), atol=1e-9)


def test_guided_and_absorbed_power_is_what_does_not_leave() -> None:
    """A GaN slab in air guides light, a silver mirror absorbs it: less leaves than is given off, never more."""
    slab, chip = emitting(200.0, AIR, AIR), emitting(150.0, SILVER, AIR)
    for orientation in ORIENTATIONS:
        dipole = Emitter(layer=1, depth_nm=60.0, orientation=orientation)
        leaves = outward_power(slab, dipole, [LAM]) + outward_power(slab, dipole, [LAM], "inside")
        assert 0.0 < leaves[0] < total_power(slab, dipole, [LAM])[0] - 0.05
        assert 0.0 < outward_power(chip, dipole, [LAM])[0] < total_power(chip, dipole, [LAM])[0] - 0.05


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_total_power_does_not_depend_on_the_path_of_integration(orientation: Orientation) -> None:
    """A guiding DBR on silver: paths at 8, 20 and 40 deg below the real axis give one result."""
    stack = dbr_stack(3.5, gan=GAN, aln=ALN, gan_layer_nm=45.2, aln_layer_nm=51.6, inside=SILVER)
    dipole = Emitter(layer=3, depth_nm=17.0, orientation=orientation)
    powers = [total_power(stack, dipole, [430.0, LAM], np.radians(angle)) for angle in (8.0, 20.0, 40.0)]
    np.testing.assert_allclose(powers[0], powers[1], rtol=1e-10)
    np.testing.assert_allclose(powers[2], powers[1], rtol=1e-10)


def test_total_power_is_the_integral_along_the_real_axis_where_there_are_no_poles() -> None:
    """Near silver (plasmon broadened by loss) the turned path equals the real axis, with amplitudes of `solve`."""
    depth, thickness = 30.0, 80.0
    stack = emitting(thickness, SILVER, AIR)
    rows = resolve(stack, [LAM])

    def integrand(u: float) -> float:
        c = np.sqrt(1 - (u / N) ** 2 + 0j)
        r_d = solve(rows.index[:, :2], [], [0.0], [LAM], [u]).r_outside[0, :, 0]
        r_u = solve(rows.index[:, 1:], [], [0.0], [LAM], [u]).r_inside[0, :, 0]
        A, B = r_u * np.exp(2j * K * c * (thickness - depth)), r_d * np.exp(2j * K * c * depth)
        s = (1 + A[0]) * (1 + B[0]) / (1 - A[0] * B[0])
        p = (1 - A[1]) * (1 - B[1]) / (1 - A[1] * B[1])
        return float((0.75 * u / N**2 / c * (s + c**2 * p)).real)

    # v = sin(a) and cosh(b) take the root at u = n out of the integrand
    inner = quad(
        lambda a: integrand(N * np.sin(a)) * N * np.cos(a), 0, np.pi / 2, limit=400, points=[np.arcsin(1 / N)]
    )
    outer = quad(lambda b: integrand(N * np.cosh(b)) * N * np.sinh(b), 0, 5.5, limit=400)
    dipole = Emitter(layer=1, depth_nm=depth, orientation="horizontal")
    assert total_power(stack, dipole, [LAM])[0] == pytest.approx(inner[0] + outer[0], abs=1e-7)


@pytest.mark.parametrize("n_out", [1.0, 1.5, 3.2])
def test_pattern_is_the_field_of_the_reciprocal_plane_wave(n_out: float) -> None:
    """dP / dOmega outside = 3/8pi n_o/n_e |E|^2 at the dipole of a plane wave sent in from there, fields from tmm."""
    layers = (
        Layer(medium=Medium(n=1.8, k=0.02), thickness_nm=70.0),
        Layer(medium=Medium(n=2.3), thickness_nm=210.0),
        Layer(medium=Medium(n=1.6), thickness_nm=90.0),
    )
    stack = Stack(inside=SILVER, layers=layers, outside=Medium(n=n_out))
    depth, theta = 66.0, np.array([0.0, 0.3, 0.7, 1.1, 1.4])
    rows = resolve(stack, [LAM])
    n_list, d_list = rows.index[0, ::-1], [np.inf, *rows.thickness_nm[::-1], np.inf]
    unit = 3 / (8 * np.pi) * n_out / 2.3
    for i, angle in enumerate(theta):
        at = {p: tmm.position_resolved(2, 210.0 - depth, tmm.coh_tmm(p, n_list, d_list, angle, LAM)) for p in "sp"}
        flat = unit * np.array([abs(at["s"]["Ey"]) ** 2, abs(at["p"]["Ex"]) ** 2]) / 2
        upright = unit * np.array([0.0, abs(at["p"]["Ez"]) ** 2])
        for orientation, expected in (
            ("horizontal", flat),
            ("vertical", upright),
            ("isotropic", (2 * flat + upright) / 3),
        ):
            dipole = Emitter(layer=2, depth_nm=depth, orientation=orientation)
            ours = radiant_intensity(stack, dipole, [LAM], theta[i], per="outer")[0, :, 0]
            np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-14)


def test_without_a_mirror_below_the_pattern_is_source_times_transmittance() -> None:
    """In a GaN half space under a DBR: what a ray tracer assumes, 3/16pi T_s and 3/16pi cos^2 T_p, T from tmm."""
    dbr = dbr_stack(5.5, gan=GAN, aln=ALN, gan_layer_nm=45.2, aln_layer_nm=51.6)
    buried = dbr.model_copy(update={"layers": (Layer(medium=GAN, thickness_nm=900.0), *dbr.layers)})
    rows = resolve(dbr, [LAM])
    theta = np.array([0.0, 0.15, 0.3, 0.4])
    ours = radiant_intensity(buried, Emitter(layer=1, depth_nm=333.0), [LAM], theta)[0]
    for i, angle in enumerate(theta):
        media, d = rows.index[0], [np.inf, *rows.thickness_nm, np.inf]
        T = [tmm.coh_tmm(p, media, d, angle, LAM)["T"] for p in "sp"]
        np.testing.assert_allclose(
            ours[:, i], 3 / (16 * np.pi) * np.array([T[0], np.cos(angle) ** 2 * T[1]]), atol=1e-13
        )


def test_nothing_leaves_beyond_the_critical_angle() -> None:
    """GaN to air: no power in s or p from 23.71 deg on."""
    theta = np.radians([23.72, 40.0, 80.0])
    for orientation in ORIENTATIONS:
        pattern = radiant_intensity(
            emitting(300.0), Emitter(layer=1, depth_nm=90.0, orientation=orientation), [LAM], theta
        )
        np.testing.assert_array_equal(pattern, 0.0)


def test_escape_fraction_of_bare_gan_equals_an_adaptive_integral_of_fresnel() -> None:
    """Isotropic light into the upper hemisphere escapes by 0.06570 of GaN bulk (Fresnel, scipy.quad)."""

    def escaping(theta: float) -> float:
        inner, outer = np.cos(theta), np.sqrt(max(0.0, 1 - (N * np.sin(theta)) ** 2))
        T_s = 4 * N * inner * outer / (N * inner + outer) ** 2
        T_p = 4 * N * inner * outer / (N * outer + inner) ** 2
        return float(np.sin(theta) * (T_s + T_p) / 2)

    expected = quad(escaping, 0, np.arcsin(1 / N), epsabs=1e-12, limit=200)[0]
    bare = emitting(500.0)
    ours = 2 * outward_power(bare, Emitter(layer=1, depth_nm=200.0, orientation="isotropic"), [LAM])[0]
    assert ours == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("order", "table"),
    [
        ("gan_first", {0: 0.06566, 2.5: 0.05238, 4.5: 0.04049, 5.5: 0.03572, 6.5: 0.03185, 9.5: 0.02534}),
        ("aln_first", {0: 0.06566, 2.5: 0.07636, 4.5: 0.06915, 5.5: 0.06318, 6.5: 0.05688, 9.5: 0.04059}),
    ],
)
def test_escape_fractions_of_the_golden_table(order: str, table: dict[float, float]) -> None:
    """Line-averaged escape fractions of the DBRs agree with the table within its own integration error (0.07 %)."""
    line = np.linspace(400.0, 490.0, 61)
    weights = np.exp(-((line - 445.0) ** 2) / 2 / (18 / 2.354820045) ** 2)
    for pairs, fraction in table.items():
        dbr = dbr_stack(pairs, gan=GAN, aln=ALN, gan_layer_nm=45.2, aln_layer_nm=51.6, layer_order=order)  # type: ignore[arg-type]  # parametrised
        stack = dbr.model_copy(update={"layers": (Layer(medium=GAN, thickness_nm=500.0), *dbr.layers)})
        power = outward_power(stack, Emitter(layer=1, depth_nm=200.0, orientation="isotropic"), line)
        assert 2 * line_average(power, weights) == pytest.approx(fraction, rel=7e-4)


def test_pattern_outside_integrates_to_the_power_that_leaves() -> None:
    """Per solid angle in air, with its Jacobian, the pattern integrates to `outward_power`; near silver and a DBR."""
    dbr = dbr_stack(2.5, gan=GAN, aln=ALN, gan_layer_nm=45.2, aln_layer_nm=51.6, inside=SILVER)
    stack = dbr.model_copy(update={"layers": (Layer(medium=GAN, thickness_nm=150.0), *dbr.layers)})
    theta, d_theta = gauss(0.0, np.pi / 2)
    for orientation in ORIENTATIONS:
        dipole = Emitter(layer=1, depth_nm=70.0, orientation=orientation)
        pattern = radiant_intensity(stack, dipole, [LAM, 460.0], theta, per="outer").sum(axis=1)
        total = 2 * np.pi * np.sum(pattern * np.sin(theta) * d_theta, axis=1)
        np.testing.assert_allclose(total, outward_power(stack, dipole, [LAM, 460.0]), atol=1e-9)


def test_turning_the_stack_over_swaps_the_sides() -> None:
    """Upside down, what went outside goes inside, and the total stays."""
    media = (GAN, Medium(n=1.7), ALN)
    layers = tuple(Layer(medium=m, thickness_nm=t) for m, t in zip(media, (120.0, 40.0, 85.0), strict=True))
    stack = Stack(inside=Medium(n=1.5), layers=layers, outside=AIR)
    turned = Stack(inside=AIR, layers=layers[::-1], outside=Medium(n=1.5))
    dipole, turned_dipole = Emitter(layer=1, depth_nm=30.0), Emitter(layer=3, depth_nm=90.0)
    for one, other in (("outside", "inside"), ("inside", "outside")):
        a = outward_power(stack, dipole, [LAM], one)  # type: ignore[arg-type]  # literals in a loop
        b = outward_power(turned, turned_dipole, [LAM], other)  # type: ignore[arg-type]  # literals in a loop
        np.testing.assert_allclose(a, b, rtol=1e-10)
    np.testing.assert_allclose(
        total_power(stack, dipole, [LAM]), total_power(turned, turned_dipole, [LAM]), rtol=1e-11
    )


def test_active_layer_is_the_mean_over_its_depth() -> None:
    """A 60 nm active layer equals the mean of dipoles spread evenly through it: pattern, outward and total power."""
    stack, theta = emitting(200.0, SILVER, AIR), np.array([0.0, 0.2, 0.35])
    depths, weights = gauss(50.0, 110.0, 24)
    single = [Emitter(layer=1, depth_nm=z, orientation="isotropic") for z in depths]
    spread = Emitter(layer=1, depth_nm=80.0, active_nm=60.0, orientation="isotropic")
    mean = sum(w / 60 * radiant_intensity(stack, e, [LAM], theta) for w, e in zip(weights, single, strict=True))
    np.testing.assert_allclose(radiant_intensity(stack, spread, [LAM], theta), mean, rtol=1e-9)
    total = sum(w / 60 * total_power(stack, e, [LAM]) for w, e in zip(weights, single, strict=True))
    np.testing.assert_allclose(total_power(stack, spread, [LAM]), total, rtol=1e-9)


def test_distant_mirror_washes_out_over_the_line() -> None:
    """Averaged over an 18 nm line a mirror 3 um away is incoherent, one at 0.2 um is not."""
    line = np.linspace(415.0, 475.0, 241)
    weights = np.exp(-((line - LAM) ** 2) / 2 / (18 / 2.354820045) ** 2)
    contrast = []
    for near, height in ((True, 200.0), (False, 3000.0)):
        heights = height + np.linspace(0.0, LAM / (2 * N), 9)
        up = [
            float(
                line_average(
                    radiant_intensity(mirrored(h + 50), Emitter(layer=1, depth_nm=h), line, 0.0)[:, 0, 0], weights
                )
            )
            for h in heights
        ]
        contrast.append((max(up) - min(up)) / (max(up) + min(up)))
        assert near == (contrast[-1] > 0.5)
    assert contrast[1] < 0.02


@pytest.mark.parametrize(
    ("field", "stack", "emitter"),
    [
        ("layer", emitting(100.0), Emitter(layer=2, depth_nm=50.0)),
        ("depth_nm", emitting(100.0), Emitter(layer=1, depth_nm=100.0)),
        ("depth_nm", emitting(100.0), Emitter(layer=1, depth_nm=90.0, active_nm=30.0)),
        ("k", Stack(inside=GAN, layers=(Layer(medium=Medium(n=2.4, k=0.01), thickness_nm=90.0),), outside=AIR),
         Emitter(layer=1, depth_nm=50.0)),
        ("coherent", Stack(inside=AIR, layers=(Layer(medium=GAN, thickness_nm=90.0),
                                               Layer(medium=GAN, thickness_nm=1e5, coherent=False)), outside=AIR),
         Emitter(layer=1, depth_nm=50.0)),
        ("roughness_nm", Stack(inside=GAN, outside=AIR,
                               layers=(Layer(medium=GAN, thickness_nm=90.0, roughness_nm=1.0),)),
         Emitter(layer=1, depth_nm=50.0)),
    ],
)  # fmt: skip
def test_bad_dipoles_are_named(field: str, stack: Stack, emitter: Emitter) -> None:
    """A dipole outside its layer, in an absorbing layer, near thick or rough layers is refused with its field."""
    with pytest.raises(InputError) as refusal:
        total_power(stack, emitter, [LAM])
    assert refusal.value.field == field


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("per", {"per": "air"}),
        ("side", {"side": "above"}),
        ("wavelength_nm", {"wavelength_nm": [0.0]}),
        ("wavelength_nm", {"wavelength_nm": [np.nan]}),
        ("theta_rad", {"theta_rad": [0.1 + 1j]}),
        ("theta_rad", {"theta_rad": [np.nan]}),
    ],
)
def test_words_and_numbers_that_mean_nothing_are_refused(field: str, arguments: dict[str, object]) -> None:
    """Any word but "emitter" was taken for "outer"."""
    asked = {"wavelength_nm": [LAM], "theta_rad": [0.1]} | arguments
    with pytest.raises(InputError) as refusal:
        radiant_intensity(emitting(100.0), Emitter(layer=1, depth_nm=50.0), **asked)  # type: ignore[arg-type]  # wrong
    assert refusal.value.field == field
    assert refusal.value.mend


def test_total_power_of_nothing_and_at_a_face_is_refused() -> None:
    """A wavelength of 0 gave nan; nearer to a face than 0.015 nm rounding decides."""
    with pytest.raises(InputError, match="wavelength_nm"):
        total_power(emitting(100.0), Emitter(layer=1, depth_nm=50.0), [0.0])
    with pytest.raises(InputError, match=r"0\.015 nm or further from the faces"):
        total_power(emitting(100.0), Emitter(layer=1, depth_nm=0.003), [LAM])
    with pytest.raises(InputError, match="ray_angle_rad"):
        total_power(emitting(100.0), Emitter(layer=1, depth_nm=50.0), [LAM], ray_angle_rad=2.0)


@pytest.mark.parametrize("depth_nm", [0.02, 0.1])
def test_power_next_to_a_metal_is_the_image_of_the_static_dipole(depth_nm: float) -> None:
    """F -> 3 Im[(e2 - e1) / (e2 + e1)] / (8 (k d)^3), vertical, at distances far below the wavelength (to 1 %)."""
    found = total_power(emitting(300.0, below=SILVER, above=GAN), Emitter(
        layer=1, depth_nm=depth_nm, orientation="vertical"), [LAM])  # fmt: skip
    e1, e2 = N**2, (0.04 + 2.6j) ** 2
    expected = 3.0 * ((e2 - e1) / (e2 + e1)).imag / (8.0 * (K * depth_nm) ** 3)
    assert found[0] == pytest.approx(expected, rel=0.01)


def test_bad_angles_and_weights_are_refused() -> None:
    """Degrees where radians belong, and a line without weight."""
    with pytest.raises(InputError, match="theta_rad"):
        radiant_intensity(emitting(100.0), Emitter(layer=1, depth_nm=50.0), [LAM], [45.0])
    with pytest.raises(InputError, match="weights"):
        line_average([1.0, 2.0], [0.0, 0.0])
    with pytest.raises(InputError, match="k = 0 where light is to arrive"):
        outward_power(emitting(100.0, SILVER), Emitter(layer=1, depth_nm=50.0), [LAM], "inside")
