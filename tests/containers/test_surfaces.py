"""Every kind of surface drawn by the kernels, against the numpy Bsdf it was packed from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

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
    direction_of,
    tabulate,
)
from containers.ray_tracing import packing
from containers.ray_tracing.arrays import SUBSTRATE, TOP_IN, TOP_OUT, SceneArrays
from containers.ray_tracing.build import cell_of, film_faces, scene_of
from containers.ray_tracing.packing import scene_arrays
from containers.ray_tracing.philox import FACE, STREAM_WORDS, start
from containers.ray_tracing.surfaces import ABSORBED, REFLECTED, TRANSMITTED, albedo, node_of, scatter, share
from containers.scene import Face
from containers.thin_film.angles import powers_at, powers_of_both
from containers.thin_film.table import Side
from luxloop.design import Design
from luxloop.errors import InputError
from luxloop.model import Environment
from tests.films import film
from tests.ray_scenes import N, bare, scene

Real = NDArray[np.float64]
DRAWS = 6000
HALF_PI = np.pi / 2


def narrow_table(phi_end: float) -> Tabulated:
    """A lobe of 15 deg as a table; over pi it is its own image, over 2 pi it is not told so."""
    theta_out, phi_out = np.linspace(0.0, HALF_PI, 31), np.linspace(0.0, phi_end, 25 if phi_end < 4.0 else 49)
    return tabulate(GaussianLobe(0.9, np.radians(15.0)), np.linspace(0.0, 1.5, 13), theta_out, phi_out)


def lopsided() -> Tabulated:
    """Two rows of very unlike power and shape, both hemispheres, no mirror symmetry, delta parts besides."""
    theta_out, phi_out = np.array([0.0, 0.5, 1.1, HALF_PI, 2.2, np.pi]), np.array([0.0, 1.0, 2.5, 4.0, 2.0 * np.pi])
    values = np.random.default_rng(3).random((1, 1, 2, 5, 4)) ** 3 / 10.0
    table = Tabulated(values, np.array([0.0, 1.4]), theta_out, phi_out)
    kept = (values * table.projected_sr).sum(axis=(-2, -1))[..., None, None]
    powers = np.array([0.05, 0.8])[None, None, :, None, None]
    return Tabulated(
        values / kept * powers, np.array([0.0, 1.4]), theta_out, phi_out,
        mirror=np.array([[[0.1, 0.05]]]), refracted=np.array([[[0.0, 0.1]]]),
    )  # fmt: skip


OPAQUE: dict[str, Bsdf] = {
    "Lambertian": Lambertian(0.6),
    "Lambertian both ways": Lambertian(0.5, 0.3),
    "lobe 5 deg": GaussianLobe(0.97, np.radians(5.0)),
    "lobe 40 deg": GaussianLobe(0.8, np.radians(40.0)),
    "mirror": Mirror(0.7),
    "mixture": Mixture((GaussianLobe(0.9, np.radians(10.0)), Lambertian(0.8), Mirror(1.0)), (0.5, 0.3, 0.1)),
    "coat over Lambertian": Coated(Fresnel(1.0, 1.5), Lambertian(0.9)),
    "coat over a lobe": Coated(Fresnel(1.0, 1.5), GaussianLobe(0.9, np.radians(10.0))),
    "coat over a mixture": Coated(Mirror(0.3), Mixture((Lambertian(1.0), Mirror(0.5)), (0.5, 0.5))),
    "table with two images": narrow_table(np.pi),
    "table with one image": narrow_table(2.0 * np.pi),
    "lopsided table": lopsided(),
    "mixture with a table": Mixture((lopsided(), Lambertian(0.5)), (0.5, 0.5)),
    "black": Mirror(0.0),
}
ANGLES = [0.0, 0.6, 1.2, 1.55]


def packed(bsdf: Bsdf) -> SceneArrays:
    """A scene with the surface as its substrate."""
    return scene_arrays(scene(substrate=bsdf))


def drawn(
    arrays: SceneArrays, row: int, theta: float, n_in: float = 1.0, n_out: float = 1.0, count: int = DRAWS
) -> tuple[NDArray[np.int64], Real]:
    """What became of `count` rays and their directions, turned back so that the mirror direction has phi = 0."""
    turn = 2.3 if theta > 0.0 else 0.0  # at normal incidence there is no mirror direction's azimuth
    x, y, z = np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), -np.cos(theta)
    stream, fates, ways = np.zeros(STREAM_WORDS, np.uint64), np.zeros(count, np.int64), np.zeros((count, 3))
    for history in range(count):
        start(stream, np.uint64(11), np.uint64(history))
        fates[history], *ways[history] = scatter(arrays.surfaces, row, 0, n_in, n_out, x, y, z, stream, FACE)
    c, s = np.cos(turn), np.sin(turn)
    return fates, np.column_stack([c * ways[:, 0] + s * ways[:, 1], c * ways[:, 1] - s * ways[:, 0], ways[:, 2]])


def same_distribution(a: Real, b: Real) -> float:
    """p-value of the chi-square test that directions (n, 3) and (m, 3) are drawn alike."""
    codes = [np.zeros(len(a), int), np.zeros(len(b), int)]
    for axis in range(3):
        edges = np.unique(np.round(np.quantile(b[:, axis], np.linspace(0.0, 1.0, 6)[1:-1]), 9))
        for code, w in zip(codes, (a, b), strict=True):
            code *= 6
            code += np.searchsorted(edges, w[:, axis] + 1e-6)  # the step: delta parts lie on edges
    cells = np.stack([np.bincount(code, minlength=216) for code in codes])
    rare = cells.sum(axis=0) * min(len(a), len(b)) / (len(a) + len(b)) < 8.0
    cells = np.column_stack([cells[:, ~rare], cells[:, rare].sum(axis=1)])
    cells = cells[:, cells.sum(axis=0) > 0]
    return float(stats.chi2_contingency(cells).pvalue) if cells.shape[1] > 1 else 1.0


@pytest.mark.parametrize("name", OPAQUE)
def test_the_share_that_goes_on_is_the_albedo(name: str) -> None:
    """At every angle, for every kind: 1 - absorbed = albedo within four standard errors, as the kernel says."""
    bsdf, arrays = OPAQUE[name], packed(OPAQUE[name])
    for theta in ANGLES:
        fates, _ = drawn(arrays, SUBSTRATE, theta, count=2000)
        expected = float(bsdf.albedo(theta))
        error = np.sqrt(max(expected * (1.0 - expected), 1e-9) / fates.size)
        assert abs((fates != ABSORBED).mean() - expected) < 4.0 * error + 2e-4
        assert albedo(arrays.surfaces, SUBSTRATE, 0, np.cos(theta)) == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize("theta", ANGLES)
@pytest.mark.parametrize("name", [name for name in OPAQUE if name != "black"])
def test_directions_are_drawn_as_numpy_draws_them(name: str, theta: float) -> None:
    """Chi-square of the kernel's directions against those of the Bsdf, delta parts included."""
    bsdf = OPAQUE[name]
    fates, ways = drawn(packed(bsdf), SUBSTRATE, theta)
    ways, fates = ways[fates != ABSORBED], fates[fates != ABSORBED]
    reference = bsdf.sample(np.random.default_rng(5).random((4 * DRAWS, 3)), theta).direction
    assert np.all((ways[:, 2] > 0.0) == (fates == REFLECTED))
    assert np.linalg.norm(ways, axis=1) == pytest.approx(np.ones(len(ways)), abs=1e-9)
    assert same_distribution(ways, reference) > 1e-4


@pytest.mark.parametrize("name", ["Lambertian", "lobe 40 deg", "table with two images", "lopsided table"])
def test_directions_follow_the_intensity(name: str) -> None:
    """Chi-square against the integral of `intensity` over cells of direction, for incidence at 70 deg."""
    bsdf, theta = OPAQUE[name], np.radians(70.0)
    fates, ways = drawn(packed(bsdf), SUBSTRATE, theta)
    z_edges, phi_edges = np.linspace(-1.0, 1.0, 13), np.linspace(-np.pi, np.pi, 13)
    fine_z, fine_phi = (
        (e[:-1, None] + np.diff(e)[:, None] * (np.arange(24) + 0.5) / 24).ravel() for e in (z_edges, phi_edges)
    )
    power = bsdf.intensity(theta, direction_of(np.arccos(fine_z)[:, None], fine_phi))
    expected = power.reshape(12, 24, 12, 24).mean(axis=(1, 3)) * (4.0 * np.pi / 144) * fates.size
    mirror = np.abs(ways - direction_of(theta, 0.0)).max(axis=1) < 1e-9
    straight = np.abs(ways - direction_of(np.pi - theta, 0.0)).max(axis=1) < 1e-9
    spread = ways[(fates != ABSORBED) & ~mirror & ~straight]
    found = np.histogram2d(spread[:, 2], np.arctan2(spread[:, 1], spread[:, 0]), bins=[z_edges, phi_edges])[0]
    seen = expected > 8.0
    chi_square = ((found - expected)[seen] ** 2 / expected[seen]).sum()
    assert stats.chi2.sf(chi_square, seen.sum()) > 1e-4
    assert found[~seen].sum() == pytest.approx(expected[~seen].sum(), abs=4.0 * np.sqrt(expected[~seen].sum() + 1.0))


def test_lamberts_mean_direction_is_upright_at_any_incidence() -> None:
    """(0, 0, 2/3), also for grazing light."""
    for theta in ANGLES:
        fates, ways = drawn(packed(Lambertian(1.0)), SUBSTRATE, theta)
        assert np.all(fates == REFLECTED)
        assert ways.mean(axis=0) == pytest.approx([0.0, 0.0, 2 / 3], abs=4.0 * 0.5 / np.sqrt(DRAWS))


def test_the_lobe_at_grazing_incidence_keeps_its_light() -> None:
    """At 89.9 deg half of all first draws are below the surface; all light goes on, with the law drawn again."""
    fates, ways = drawn(packed(GaussianLobe(1.0, np.radians(5.0))), SUBSTRATE, np.radians(89.9))
    assert np.all(fates == REFLECTED)
    assert ways[:, 2].min() > 0.0
    theta = np.arccos(np.clip(ways @ direction_of(np.radians(89.9), 0.0), -1.0, 1.0))
    # drawn again until above: for a flat surface the polar angle keeps Rayleigh's law
    assert stats.kstest(theta, "rayleigh", args=(0.0, np.radians(5.0))).pvalue > 1e-3


@pytest.mark.parametrize(("row", "n_in", "n_out"), [(TOP_IN, N, 1.0), (TOP_OUT, 1.0, N)])
def test_a_clear_face_refracts_by_snells_law_and_reflects_by_fresnels(row: int, n_in: float, n_out: float) -> None:
    """R within four errors at many angles, exact directions, all reflected beyond the critical angle."""
    arrays, face = scene_arrays(scene()), Fresnel(n_in, n_out)
    for theta in (0.0, 0.2, 0.4, 0.413, 0.4139, 0.6, 1.2, 1.56):
        fates, ways = drawn(arrays, row, theta, n_in, n_out, count=1500)
        R = float(face.deltas(theta).mirror)
        assert abs((fates == REFLECTED).mean() - R) < 4.0 * np.sqrt(R * (1.0 - R) / fates.size) + 1e-3
        assert not np.any(fates == ABSORBED)
        if n_in * np.sin(theta) >= n_out:
            assert np.all(fates == REFLECTED)
        through, back = ways[fates == TRANSMITTED], ways[fates == REFLECTED]
        assert np.allclose(back, direction_of(theta, 0.0), atol=1e-12)
        if len(through):
            assert np.allclose(
                through, direction_of(np.pi - np.arcsin(n_in / n_out * np.sin(theta)), 0.0), atol=1e-12
            )


@pytest.mark.parametrize(("pairs", "worst"), [(0.5, 2e-5), (5.5, 2e-5), (9.5, 5e-5)])
def test_a_film_is_interpolated_to_what_is_stated(pairs: float, worst: float) -> None:
    """R and R + T of the packed face against the film's own powers, at angles between all nodes, from both sides."""
    table, environment, design = film(pairs), Environment(), Design.model_validate(
        {"distance_um": 180, "width_um": 28, "spacing_um": 500, "thickness_um": 35, "dbr_pairs": pairs}
    )  # fmt: skip
    surfaces = scene_arrays(scene_of(environment, design, table, cell_of(environment, design))).surfaces
    sides: tuple[tuple[Side, int, float], ...] = (("inside", TOP_IN, N), ("outside", TOP_OUT, 1.0))
    for side, row, n in sides:
        u = np.sort(np.random.default_rng(1).uniform(0.0, 1.0, 3000) ** 0.3) * (1.0 - 1e-9)
        powers = powers_at(table, side, np.arcsin(u / n))
        R = np.tensordot(table.weight, powers.R.mean(axis=1), axes=1)
        found = np.zeros((u.size, 2))
        for i, at_u in enumerate(u):
            at, above = node_of(surfaces, row, 0, at_u**2, n * n)
            found[i] = share(surfaces, row, at, above, 0), share(surfaces, row, at, above, 1)
        assert np.abs(found[:, 0] - R).max() < worst
        assert np.abs(found[:, 1] - 1.0).max() < 1e-9


def test_a_lossless_film_reflects_all_beyond_the_critical_angle() -> None:
    """R exactly 1 there, so that no light leaks out of trapped paths."""
    environment = Environment()
    design = Design(distance_um=180, width_um=28, spacing_um=500, thickness_um=35, dbr_pairs=5.5)
    surfaces = scene_arrays(scene_of(environment, design, film(5.5), cell_of(environment, design))).surfaces
    for u in np.linspace(1.0 + 1e-9, N, 200):
        at, above = node_of(surfaces, TOP_IN, 0, u * u, N * N)
        assert share(surfaces, TOP_IN, at, above, 0) > 1.0 - 1e-15  # the largest uniform is 1 - 2^-33


@pytest.mark.parametrize("roughness_nm", [0.0, 5.0])
@pytest.mark.parametrize("side", ["inside", "outside"])
def test_powers_from_both_sides_are_those_from_each(side: Side, roughness_nm: float) -> None:
    """At the angles of the same u; where no light can come from the other side, all of it is sent back."""
    table = film(2.5, roughness_nm)
    n_own, n_other = (N, 1.0) if side == "inside" else (1.0, N)
    theta = np.linspace(0.0, np.pi / 2.0, 91)
    here, there = powers_of_both(table, side, theta)
    sine = n_own / n_other * np.sin(theta)
    through = sine < 1.0
    assert np.array_equal(np.array(here), np.array(powers_at(table, side, theta)))
    other: Side = "outside" if side == "inside" else "inside"
    again = powers_at(table, other, np.arcsin(sine[through]))
    for one, alone in zip(there, again, strict=True):
        np.testing.assert_allclose(one[..., through], alone, atol=1e-12)
    np.testing.assert_allclose(there.R[..., sine > 1.0], 1.0, atol=1e-12)
    assert bool(here.S_T.any()) == bool(roughness_nm)


def test_a_rough_film_sends_on_as_much_from_either_side_and_loses_nothing() -> None:
    """T of the same u from GaN and from air, what is scattered onward included; R + T = 1 where nothing absorbs."""
    face = film_faces(Environment(), film(5.5, 5.0))
    (inside,), (outside,) = face.inside, face.outside
    assert isinstance(inside, SpecularTable)
    assert isinstance(outside, SpecularTable)
    u = np.linspace(0.0, 0.99, 500)
    from_inside = np.interp(np.arcsin(u / N), inside.theta_in_rad, inside.T)
    from_outside = np.interp(np.arcsin(u), outside.theta_in_rad, outside.T)
    assert float(np.abs(from_inside - from_outside).max()) < 2e-5
    for one in (inside, outside):
        np.testing.assert_allclose(one.R + one.T, 1.0, atol=1e-12)
    assert not inside.T[inside.theta_in_rad > np.arcsin(1.0 / N) + 1e-9].any()


def test_faces_of_a_film_are_made_once() -> None:
    """Whatever else is in the environment; another index or another film has its own."""
    environment, table = Environment(), film(2.5, 5.0)
    face = film_faces(environment, table)
    other = environment.model_copy(update={"chip_absorption_per_cm": 17.0})
    assert film_faces(other, replace(table)) is face
    assert film_faces(environment.model_copy(update={"spectrum": "sampled"}), table) is not face
    assert film_faces(environment, film(2.5, 4.0)) is not face
    assert film_faces(environment, replace(table, weight=np.roll(table.weight, 1))) is not face


def test_a_surface_that_creates_energy_is_refused() -> None:
    """R + T above 1 by more than rounding, in a face made by hand."""
    face = SpecularTable(np.array([0.0, 1.0]), np.array([0.5, 0.5]), np.array([0.5, 0.5]))
    object.__setattr__(face, "T", np.array([0.5, 0.6]))
    with pytest.raises(InputError, match="energy"):
        packed(face)


def test_two_tables_on_one_surface_are_refused() -> None:
    """Kernels hold one; the mend is said."""
    with pytest.raises(InputError, match="tabulate"):
        packed(Mixture((narrow_table(np.pi), lopsided()), (0.5, 0.5)))


def test_wavelengths_keep_their_own_powers() -> None:
    """Two mirrors on one face: the number of the wavelength chooses."""
    faces = Face((Mirror(0.2), Mirror(0.9)), (Mirror(0.2), Mirror(0.9)))
    of = scene(
        {"index": np.array([N, N]), "top": faces, "sides": Face(bare().inside * 2, bare().outside * 2)},
        wavelength_weight=np.array([0.5, 0.5]),
    )
    surfaces = scene_arrays(of).surfaces
    for wave, R in ((0, 0.2), (1, 0.9)):
        at, above = node_of(surfaces, TOP_IN, wave, 0.3, N * N)
        assert share(surfaces, TOP_IN, at, above, 0) == pytest.approx(R)


def test_a_face_that_is_black_in_one_wave_only_is_not_taken_for_black() -> None:
    """Parts are the same for all wavelengths, whichever comes first."""
    for faces in ((Lambertian(0.0), Lambertian(0.5)), (Lambertian(0.5), Lambertian(0.0))):
        top, sides = Face(bare().inside * 2, bare().outside * 2), Face(faces, faces)
        of = scene({"index": np.array([N, N]), "top": top, "sides": sides}, wavelength_weight=np.array([0.5, 0.5]))
        with pytest.raises(InputError, match="the same for all wavelengths"):
            scene_arrays(of)


def test_tables_that_are_kept_are_those_of_the_surface() -> None:
    """Whatever was packed before: equal numbers in other kinds, films made anew, 0 and -0."""
    theta = np.array([0.0, 1.0])
    films = [SpecularTable(theta, np.full(2, R), np.full(2, 0.9 - R)) for R in (0.5, 0.4, 0.5)]
    surfaces: list[Bsdf] = [
        Mirror(0.5), Lambertian(0.5), GaussianLobe(0.5, 0.1), GaussianLobe(0.5, 0.2), Mirror(0.0), Mirror(-0.0),
        Fresnel(1.0, 1.5), Fresnel(1.5, 1.0), *films,
    ]  # fmt: skip
    alone = []
    for one in surfaces:
        packing._kept.cache_clear()
        alone.append(packed(one))
    for _ in range(2):
        for one, before in zip(surfaces, alone, strict=True):
            for found, expected in zip(packed(one).parts, before.parts, strict=True):
                assert found.tobytes() == expected.tobytes()


def test_tables_of_cells_are_not_kept() -> None:
    """They may be of megabytes."""
    packed(Mirror(0.5))
    before = packing._kept.cache_info().currsize
    packed(narrow_table(np.pi))
    assert packing._kept.cache_info().currsize == before
