"""Surfaces: what sampling, evaluating and integrating must agree on, whatever the kind."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import chi2

from containers.bsdf import (
    Bsdf,
    Coated,
    Fresnel,
    GaussianLobe,
    Lambertian,
    Mirror,
    Mixture,
    SpecularTable,
    Tabulated,
    check_energy,
    direction_of,
    reciprocity_defect,
    symmetrised,
    tabulate,
    transmission_defect,
)
from luxloop.errors import InputError

Real = NDArray[np.float64]
DEG = np.pi / 180.0
ANGLES_DEG = (0.0, 10.0, 33.3, 60.0, 80.0, 87.5, 90.0)
LOBE = GaussianLobe(0.97, 5.0 * DEG)


def edges_about(centre_deg: float, finest_deg: float, end_deg: float) -> Real:
    """Edges from 0 to `end_deg` in rad: cells of the finest width near the centre, each further one 15 % wider."""
    steps = [0.0]
    while steps[-1] < end_deg:
        steps.append(steps[-1] + max(finest_deg, 0.15 * (steps[-1] - 6.0)))
    both = np.concatenate([centre_deg - np.array(steps), centre_deg + np.array(steps)])
    inner = np.unique(both[(both > finest_deg / 2) & (both < end_deg - finest_deg / 2)])
    return np.concatenate([[0.0], inner, [end_deg]]) * DEG


def narrow_table() -> Tabulated:
    """A lobe of 1 degree, reflectance 0.97, tabulated at five angles of incidence."""
    nodes = np.array([0.0, 29.0, 30.0, 31.0, 70.0])
    theta = np.linspace(0.0, 90.0, 361) * DEG
    return tabulate(GaussianLobe(0.97, 1.0 * DEG), nodes * DEG, theta, edges_about(0.0, 0.4, 180.0), order=4)


def wide_table() -> Tabulated:
    """A mixture of everything, reflected and transmitted, as a table over both half spaces."""
    mixture = Mixture((GaussianLobe(0.9, 20.0 * DEG), Lambertian(0.3, 0.5), Fresnel(1.0, 1.5)), (0.5, 0.3, 0.2))
    theta = np.concatenate([np.linspace(0, 90, 46), np.linspace(90, 180, 19)[1:]]) * DEG
    return tabulate(mixture, np.linspace(0, 88, 12) * DEG, theta, np.linspace(0, 360, 73) * DEG)


KINDS: dict[str, Bsdf] = {
    "Lambertian": Lambertian(0.35),
    "Lambertian with transmission": Lambertian(0.3, 0.5),
    "lobe 1 deg": GaussianLobe(0.97, 1.0 * DEG),
    "lobe 5 deg": LOBE,
    "lobe 40 deg": GaussianLobe(0.8, 40.0 * DEG),
    "mirror": Mirror(0.9),
    "Fresnel from GaN": Fresnel(2.4869, 1.0),
    "specular table": SpecularTable(np.array([0.0, 0.5, 1.5]), np.array([0.2, 0.4, 0.9]), np.array([0.7, 0.5, 0.0])),
    "coat": Coated(Fresnel(1.0, 1.5), LOBE),
    "mixture": Mixture((LOBE, Lambertian(1.0), Mirror(0.5)), (0.5, 0.3, 0.1)),
    "table of 1 deg lobe": narrow_table(),
    "table of a mixture": wide_table(),
}


def uniforms(n: int, seed: int = 7) -> Real:
    """(n, 3) random numbers of a fixed seed."""
    return np.random.default_rng(seed).random((n, 3))


def integral(bsdf: Bsdf, theta_in: float, side: int, centre_deg: float) -> float:
    """bsdf x |cos| over one half space, in spherical coordinates about an axis in the plane of incidence.

    Rings about the axis are cut by the surface; the midpoint rule is nothing like how the kinds are normalised.
    """
    ring = np.linspace(0.0, np.pi, 481)
    theta, width = (ring[1:] + ring[:-1]) / 2, np.diff(ring)
    phi = (np.arange(360) + 0.5) * np.pi / 180
    local = direction_of(theta[:, None], phi)
    s, c = np.sin(centre_deg * DEG), np.cos(centre_deg * DEG)
    x, y, z = np.moveaxis(local, -1, 0)
    w = np.stack([z * s - x * c, y, z * c + x * s], axis=-1)
    value = bsdf.evaluate(theta_in, w) * np.abs(w[..., 2]) * np.where(w[..., 2] * side > 0.0, 1.0, 0.0)
    return float((value.mean(axis=1) * 2 * np.pi * np.sin(theta) * width).sum())


@pytest.mark.parametrize("name", KINDS)
def test_mean_sampled_weight_is_the_albedo_at_every_angle(name: str) -> None:
    """Nothing is lost or made by sampling, at nodes, between them and at grazing incidence, also for 1 degree."""
    for angle in (*ANGLES_DEG, 29.5, 30.77):
        weight = KINDS[name].sample(uniforms(200), angle * DEG).weight
        assert weight.mean() == pytest.approx(float(KINDS[name].albedo(angle * DEG)), abs=1e-12)


@pytest.mark.parametrize("name", KINDS)
def test_samples_are_unit_vectors_and_reproducible(name: str) -> None:
    """The same random numbers give the same directions, of length 1."""
    first, second = (KINDS[name].sample(uniforms(500), 0.9).direction for _ in range(2))
    assert np.array_equal(first, second)
    assert np.allclose(np.linalg.norm(first, axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("name", KINDS)
def test_loop_equals_batch(name: str) -> None:
    """Rays traced one by one, each with its own incidence, equal rays traced together."""
    u, theta = uniforms(40), np.linspace(0.0, np.pi / 2, 40)
    batch = KINDS[name].sample(u, theta)
    single = [KINDS[name].sample(u[[k]], theta[k]) for k in range(40)]
    assert np.allclose(batch.direction, np.concatenate([s.direction for s in single]), atol=1e-8)
    assert np.allclose(batch.weight, np.concatenate([s.weight for s in single]), atol=1e-15)


@pytest.mark.parametrize("name", ["Lambertian", "lobe 5 deg", "lobe 40 deg", "coat", "mixture", "table of a mixture"])
@pytest.mark.parametrize("angle_deg", [0.0, 33.3, 80.0])
def test_evaluate_integrates_to_the_albedo(name: str, angle_deg: float) -> None:
    """Reflected and transmitted bsdf x cos and the delta parts add up to the albedo, by another quadrature."""
    bsdf = KINDS[name]
    spread = sum(integral(bsdf, angle_deg * DEG, side, angle_deg) for side in (1, -1))
    assert spread + sum(bsdf.deltas(angle_deg * DEG)) == pytest.approx(float(bsdf.albedo(angle_deg * DEG)), abs=2e-3)


@pytest.mark.parametrize("sigma_deg", [1.0, 5.0, 30.0, 80.0])
@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 85.0, 89.9, 90.0])
def test_lobe_normalisation_is_accurate(sigma_deg: float, angle_deg: float) -> None:
    """The share of draws above the surface, against adaptive quadrature split at its kinks, to 1e-8."""
    sigma, incidence = sigma_deg * DEG, angle_deg * DEG

    def accepted(theta: float) -> float:
        """Rayleigh's density times the share of azimuths with cos(theta) cos(i) + sin(theta) sin(i) cos(phi) > 0."""
        edge = np.clip(np.cos(theta) * np.cos(incidence) / max(np.sin(theta) * np.sin(incidence), 1e-30), -1, 1)
        share = 0.5 + np.arcsin(edge) / np.pi
        return float(theta / sigma**2 * np.exp(-0.5 * (theta / sigma) ** 2) * share)

    top = min(np.pi / 2 + incidence, 9.5 * sigma)
    kinks = {round(x, 12) for x in (np.pi / 2 - incidence, np.pi / 2, sigma, 3 * sigma, 6 * sigma)}
    cuts = [0.0, *sorted(x for x in kinks if 0 < x < top), top]
    expected = sum(quad(accepted, a, b, epsabs=1e-9, limit=200)[0] for a, b in pairwise(cuts))
    assert float(GaussianLobe(1.0, sigma).share_above(np.array(incidence))) == pytest.approx(expected, abs=1e-8)


def drawn_again(sigma: float, theta_in: float, n: int, seed: int) -> tuple[Real, Real]:
    """Directions by the definition itself: (drawn again where below the surface, mirrored up instead)."""
    rng = np.random.default_rng(seed)
    theta, phi = sigma * np.sqrt(-2.0 * np.log(1.0 - rng.random(n))), 2 * np.pi * rng.random(n)
    s, c = np.sin(theta_in), np.cos(theta_in)
    x, y, z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    w = np.stack([z * s - x * c, y, z * c + x * s], axis=1)
    mirrored = w * np.where(w[:, 2:] < 0.0, [1.0, 1.0, -1.0], 1.0)
    return w[w[:, 2] >= 0.0], mirrored


@pytest.mark.parametrize("angle_deg", [0.0, 75.0, 84.0, 90.0])
def test_lobe_samples_are_those_drawn_again_below_the_surface(angle_deg: float) -> None:
    """Mean direction and its spread equal those of a plain rejection loop, within 4.5 standard errors."""
    sampled = LOBE.sample(uniforms(20_000), angle_deg * DEG).direction
    expected, _ = drawn_again(LOBE.sigma_rad, angle_deg * DEG, 60_000, 3)
    for moment in (1, 2):
        a, b = sampled**moment, expected**moment
        error = np.sqrt(a.var(axis=0) / len(a) + b.var(axis=0) / len(b))
        assert np.all(np.abs(a.mean(axis=0) - b.mean(axis=0)) < 4.5 * error + 1e-12)


def test_drawing_again_is_not_mirroring() -> None:
    """At 84 deg the two readings of the lobe differ in mean height by many standard errors, 0 at normal incidence."""
    sampled = LOBE.sample(uniforms(20_000), 84.0 * DEG).direction[:, 2]
    _, mirrored = drawn_again(LOBE.sigma_rad, 84.0 * DEG, 60_000, 3)
    error = np.hypot(sampled.std() / np.sqrt(20_000), mirrored[:, 2].std() / np.sqrt(60_000))
    assert sampled.mean() - mirrored[:, 2].mean() > 8.0 * error


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_lambert_forgets_the_incidence(angle_deg: float) -> None:
    """Lambert's mean direction is (0, 0, 2/3) from anywhere (a known tracer's leans with the incoming ray)."""
    mean = Lambertian(1.0).sample(uniforms(60_000), angle_deg * DEG).direction.mean(axis=0)
    assert np.allclose(mean, [0.0, 0.0, 2.0 / 3.0], atol=0.01)


@pytest.mark.parametrize("name", ["Lambertian", "lobe 5 deg", "lobe 40 deg", "mixture", "table of a mixture"])
@pytest.mark.parametrize("angle_deg", [20.0, 82.0])
def test_histogram_of_samples_matches_evaluate(name: str, angle_deg: float) -> None:
    """Chi-square of counts in cells about the mirror direction against the integrated bsdf x cos (fixed seed)."""
    bsdf, n = KINDS[name], 30_000
    w = bsdf.sample(uniforms(n, 11), angle_deg * DEG).direction
    mirror, refracted = bsdf.deltas(angle_deg * DEG)
    exact = np.isclose(w[:, 2], np.cos(angle_deg * DEG), atol=1e-12) & (np.abs(w[:, 1]) < 1e-12)
    w = w[~exact & ~((np.abs(w[:, 1]) < 1e-12) & (w[:, 2] < 0.0))]
    s, c = np.sin(angle_deg * DEG), np.cos(angle_deg * DEG)
    theta = np.arccos(np.clip(w[:, 0] * s + w[:, 2] * c, -1, 1))
    side = (w[:, 1] > 0.0).astype(int)
    edges = np.array([0, 2, 4, 6, 9, 13, 20, 35, 50, 70, 90, 120, 180]) * DEG
    counts = np.stack([np.histogram(theta[side == k], edges)[0] for k in (0, 1)], axis=1)

    fine = np.concatenate([np.linspace(a, b, 25)[:-1] for a, b in pairwise(edges)] + [edges[-1:]])
    middle, phi = (fine[1:] + fine[:-1]) / 2, (np.arange(720) + 0.5) * np.pi / 360
    x, y, z = np.moveaxis(direction_of(middle[:, None], phi), -1, 0)
    grid = np.stack([z * s - x * c, y, z * c + x * s], axis=-1)
    power = bsdf.intensity(angle_deg * DEG, grid) * (np.sin(middle) * np.diff(fine))[:, None] * 2 * np.pi / 720
    halves = np.stack([power[:, 360:].sum(axis=1), power[:, :360].sum(axis=1)], axis=1)
    expected = halves.reshape(edges.size - 1, 24, 2).sum(axis=1) * n / float(bsdf.albedo(angle_deg * DEG))

    used = expected > 8.0
    statistic = float(((counts - expected)[used] ** 2 / expected[used]).sum())
    assert statistic < chi2.ppf(0.9999, used.sum()), (counts, expected)
    share = 1.0 - float(mirror + refracted) / float(bsdf.albedo(angle_deg * DEG))
    assert counts.sum() == pytest.approx(n * share, abs=5 * np.sqrt(n))


def test_delta_directions_are_mirror_and_refracted() -> None:
    """From GaN at 15 deg: the mirror at 15 deg, the refracted ray by Snell's law, shares by Fresnel."""
    face = Fresnel(2.4869, 1.0)
    w = face.sample(uniforms(4000), 15.0 * DEG).direction
    up = w[:, 2] > 0.0
    assert np.allclose(w[up], direction_of(15.0 * DEG, 0.0))
    assert np.allclose(w[~up][:, 0], 2.4869 * np.sin(15.0 * DEG))
    assert up.mean() == pytest.approx(0.186887, abs=0.02)


def test_fresnel_meets_the_golden_table() -> None:
    """The bare GaN face of golden/thin_film.json: 0 and 15 deg from GaN, 60 deg from air, total reflection."""
    inner, outer = Fresnel(2.4869, 1.0), Fresnel(1.0, 2.4869)
    assert inner.deltas(np.array([0.0, 15.0, 24.0]) * DEG).mirror == pytest.approx(
        [0.181838, 0.186887, 1.0], abs=1e-6
    )
    assert float(outer.deltas(60.0 * DEG).mirror) == pytest.approx(0.219020, abs=1e-6)


def test_reciprocity_holds_for_lambert_fresnel_and_symmetrised_tables() -> None:
    """Exchanging the directions changes nothing for them."""
    angles = np.linspace(1.0, 89.0, 23) * DEG
    assert reciprocity_defect(Lambertian(0.5), angles) < 1e-12
    assert transmission_defect(Fresnel(2.4869, 1.0), Fresnel(1.0, 2.4869), angles) < 1e-12
    edges = np.linspace(0.0, 90.0, 31) * DEG
    nodes = (edges[1:] + edges[:-1]) / 2
    table = tabulate(GaussianLobe(0.3, 15.0 * DEG), nodes, edges, np.linspace(0, 180, 37) * DEG)
    assert reciprocity_defect(table, nodes) > 0.1
    assert reciprocity_defect(symmetrised(table), nodes) < 1e-12


def test_the_lobe_is_known_not_to_be_reciprocal() -> None:
    """The lobe conserves energy instead, so no adjoint may pass through it."""
    assert reciprocity_defect(GaussianLobe(0.97, 5.0 * DEG), np.linspace(60.0, 85.0, 11) * DEG) > 0.1


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 45.0, 70.0])
def test_a_table_of_a_flat_or_wide_lobe_evaluates_like_its_source(angle_deg: float) -> None:
    """At a node, a fine table's albedo is exact and its bsdf within 5 % of the peak of the lobe's."""
    lobe = GaussianLobe(0.8, 20.0 * DEG)
    table = tabulate(lobe, np.array([angle_deg]) * DEG, np.linspace(0, 90, 181) * DEG, np.linspace(0, 180, 181) * DEG)
    assert float(table.albedo(0.3)) == pytest.approx(0.8, abs=1e-12)
    w = direction_of(np.linspace(2, 80, 15)[:, None] * DEG, np.linspace(0.1, 3.0, 9))
    expected = lobe.intensity(angle_deg * DEG, w)
    assert np.abs(table.intensity(angle_deg * DEG, w) - expected).max() < 0.05 * expected.max()


def test_one_degree_table_keeps_its_lobe_narrow() -> None:
    """Samples of the tabulated 1 degree lobe have the angular spread of the lobe: rms angle sqrt(2) sigma."""
    w = KINDS["table of 1 deg lobe"].sample(uniforms(20_000), 30.0 * DEG).direction
    angle = np.arccos(np.clip(w @ direction_of(30.0 * DEG, 0.0), -1, 1))
    assert np.sqrt((angle**2).mean()) == pytest.approx(np.sqrt(2.0) * DEG, rel=0.04)


def test_channels_average_to_the_whole() -> None:
    """The albedo of a table of two wavelengths and s, p is the weighted mean of its channels' albedos."""
    values = np.random.default_rng(5).random((2, 2, 3, 4, 6)) * 0.25
    edges = np.linspace(0, np.pi / 2, 5), np.linspace(0, np.pi, 7)
    table = Tabulated(
        values, np.array([0.0, 0.7, 1.4]), *edges, mirror=np.full((2, 2, 3), 0.05),
        wavelength_nm=np.array([440.0, 450.0]), weight=np.array([0.3, 0.7]),
    )  # fmt: skip
    albedos = [[float(table.channel(w, p).albedo(0.4)) for p in (0, 1)] for w in (0, 1)]
    expected = 0.3 * np.mean(albedos[0]) + 0.7 * np.mean(albedos[1])
    assert float(table.albedo(0.4)) == pytest.approx(expected, abs=1e-12)
    assert float(table.sample(uniforms(10), 0.4).weight[0]) == pytest.approx(expected, abs=1e-12)


def test_a_table_has_its_last_ring_straight_down() -> None:
    """The bsdf there is that beside it; a table of reflection alone has nothing below the surface."""
    cells, phi = np.full((1, 1, 1, 2, 1), 0.5 / np.pi), np.array([0.0, np.pi])
    both = Tabulated(cells, np.zeros(1), np.array([0.0, 0.5, 1.0]) * np.pi, phi)
    ends = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-0.0, -0.0, -1.0]])
    assert both.evaluate(0.0, ends) == pytest.approx(0.5 / np.pi, rel=1e-12)
    assert both.intensity(0.0, ends) == pytest.approx(0.5 / np.pi, rel=1e-12)
    upper = Tabulated(cells, np.zeros(1), np.array([0.0, 0.25, 0.5]) * np.pi, phi)
    below = direction_of(np.array([90.0 + 1e-9, 91.0, 180.0]) * DEG, 0.0)
    assert np.all(upper.evaluate(0.0, below) == 0.0)
    assert upper.evaluate(0.0, direction_of((90.0 - 1e-9) * DEG, 0.0)) == pytest.approx(0.5 / np.pi)


def test_total_reflection_keeps_what_interpolation_calls_transmitted() -> None:
    """Between the last node with T > 0 and the critical angle's far side nothing is lost and nothing leaves."""
    table = SpecularTable(np.array([0.0, 0.40, 0.45]), np.array([0.2, 0.4, 1.0]), np.array([0.8, 0.6, 0.0]), 2.4869)
    beyond = np.arcsin(1 / 2.4869) + 0.01
    assert float(table.deltas(beyond).mirror) == pytest.approx(1.0, abs=1e-12)
    assert np.all(table.sample(uniforms(50), beyond).direction[:, 2] > 0.0)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    reflectance=st.floats(0.0, 1.0),
    sigma=st.floats(0.002, 1.5),
    theta=st.floats(0.0, np.pi / 2),
    share=st.floats(0.0, 1.0),
)
def test_any_mixture_conserves_energy(reflectance: float, sigma: float, theta: float, share: float) -> None:
    """Whatever lobe, angle and mixture: all samples above the surface, weight = albedo, at most 1."""
    mixture = Mixture((GaussianLobe(reflectance, sigma), Lambertian(1.0)), (share, 1.0 - share))
    sample = mixture.sample(uniforms(50), theta)
    assert np.all(sample.direction[:, 2] >= 0.0)
    assert np.allclose(sample.weight, share * reflectance + 1.0 - share)
    assert check_energy(mixture, theta) <= 1.0 + 1e-12


def test_tables_that_create_energy_are_refused_with_their_row() -> None:
    """A row with albedo above 1 names wavelength, polarisation, row and angle."""
    values = np.full((1, 1, 3, 2, 2), 0.9 / np.pi)
    values[0, 0, 1] = 1.1 / np.pi
    edges = np.array([0.0, 0.8, np.pi / 2]), np.array([0.0, 1.0, np.pi])
    with pytest.raises(InputError, match=r"row 1 \(28\.648 deg\): got 1\.1"):
        Tabulated(values, np.array([0.0, 0.5, 1.0]), *edges)
    with pytest.raises(InputError, match="row 0"):
        SpecularTable(np.array([0.1]), np.array([0.7]), np.array([0.4]))


def test_bad_input_names_field_value_and_range() -> None:
    """Angles beyond grazing, misshapen random numbers, negative or unfinished tables, too coarse cells."""
    good = np.array([0.0, np.pi / 2]), np.array([0.0, np.pi])
    with pytest.raises(InputError, match=r"theta_in_rad: got 1\.6"):
        LOBE.sample(uniforms(3), 1.6)
    with pytest.raises(InputError, match="theta_in_rad: got nan"):
        LOBE.albedo(np.nan)
    with pytest.raises(InputError, match="uniforms"):
        LOBE.sample(np.zeros((3, 2)), 0.1)
    with pytest.raises(InputError, match="sigma_rad"):
        GaussianLobe(0.9, 0.0)
    with pytest.raises(InputError, match="values"):
        Tabulated(np.full((1, 1, 1, 1, 1), -0.1), np.zeros(1), *good)
    with pytest.raises(InputError, match="values"):
        Tabulated(np.zeros((1, 1, 2, 1, 1)), np.zeros(1), *good)
    with pytest.raises(InputError, match="phi_out_edges_rad"):
        Tabulated(np.zeros((1, 1, 1, 1, 1)), np.zeros(1), good[0], np.array([0.0, 3.0]))
    with pytest.raises(InputError, match="finer theta_out"):
        tabulate(GaussianLobe(0.97, 0.5 * DEG), 0.7, np.linspace(0, np.pi / 2, 10), np.linspace(0, np.pi, 10))
    with pytest.raises(InputError, match="sum of shares"):
        Mixture((Lambertian(1.0), Mirror(1.0)), (0.7, 0.7))


@pytest.mark.parametrize("name", ["Lambertian", "lobe 5 deg", "mixture", "table of a mixture", "specular table"])
@pytest.mark.parametrize("wrong", [1.0, -1e-9, -1.0, np.nan, np.inf])
def test_random_numbers_outside_their_interval_are_refused(name: str, wrong: float) -> None:
    """1.0, what is negative and what is no number would give directions that are none, without a word."""
    u = uniforms(5)
    u[3, 1] = wrong
    with pytest.raises(InputError, match="uniforms: got"):
        KINDS[name].sample(u, 0.4)


@pytest.mark.parametrize("wrong", [[0.0, 0.0, 2.0], [0.6, 0.6, 0.6], [0.0, 0.0, 0.0], [np.nan, 0.0, 1.0], [0.0, 1.0]])
def test_directions_that_are_no_unit_vectors_are_refused(wrong: list[float]) -> None:
    """A direction of another length is no direction: the bsdf would be another."""
    for verb in (LOBE.evaluate, LOBE.intensity):
        with pytest.raises(InputError, match="direction: got"):
            verb(0.3, np.array([wrong, wrong]))
    single = direction_of(0.4, 0.3).astype(np.float32)  # six digits are enough
    assert LOBE.evaluate(0.4, single) == pytest.approx(LOBE.evaluate(0.4, direction_of(0.4, 0.3)), rel=1e-4)


@pytest.mark.parametrize(
    ("theta", "R", "T", "field"),
    [
        ([0.0, np.nan], [0.1, 0.1], [0.1, 0.1], "theta_in_rad"),
        ([0.0, 0.0], [0.1, 0.1], [0.1, 0.1], "theta_in_rad"),
        ([0.0, 1.6], [0.1, 0.1], [0.1, 0.1], "theta_in_rad"),
        ([0.0, 1.0], [0.1, np.nan], [0.1, 0.1], "R"),
        ([0.0, 1.0], [0.1, 0.1], [0.1, -0.1], "T"),
        ([0.0, 1.0], [0.1, 0.1], [0.1], "T"),
    ],
)
def test_specular_tables_with_holes_are_refused(
    theta: list[float], R: list[float], T: list[float], field: str
) -> None:
    """Nodes and powers that are not numbers in range, from lists too."""
    with pytest.raises(InputError) as refusal:
        SpecularTable(theta, R, T)  # type: ignore[arg-type]  # lists become arrays
    assert refusal.value.field == field


def test_tables_with_nodes_or_weights_that_are_no_numbers_are_refused() -> None:
    """nan compares as false: it passed for increasing, and for a sum of 1."""
    edges = np.array([0.0, np.pi / 2]), np.array([0.0, np.pi])
    with pytest.raises(InputError, match="theta_in_rad"):
        Tabulated(np.zeros((1, 1, 1, 1, 1)), np.array([np.nan]), *edges)
    with pytest.raises(InputError, match="weight"):
        Tabulated(np.zeros((1, 1, 1, 1, 1)), np.zeros(1), *edges, weight=np.array([np.nan]))
    with pytest.raises(InputError, match="index_ratio"):
        Tabulated(np.zeros((1, 1, 1, 1, 1)), np.zeros(1), *edges, index_ratio=np.nan)
