"""Rough clear faces: energy, reciprocity, the smooth limit, and the closed form of light that meets one facet."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from containers.acting import Effects
from containers.bsdf import Facets, Fresnel, direction_of
from containers.effects.side_wall_roughness import SideWallRoughness
from containers.ray_tracing.arrays import SIDE_IN, SIDE_OUT
from containers.ray_tracing.exits import make_exits
from containers.ray_tracing.facet_kernel import normal_quantile, seen_below, slope_at, unmasked
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.packing import scene_arrays
from containers.ray_tracing.philox import FACE, STREAM_WORDS, start
from containers.ray_tracing.surfaces import TRANSMITTED, scatter
from containers.ray_tracing.twin.reweighting import reweighted
from luxloop.errors import InputError
from tests.ray_scenes import N, exits_of, film_face, scene

Real = NDArray[np.float64]
RAYS = 50_000


def directions(face: Facets, theta: Real | float, seed: int = 1) -> Real:
    """Where many rays go."""
    return face.sample(
        np.random.default_rng(seed).random((np.size(theta) if np.ndim(theta) else RAYS, 3)), theta
    ).direction


@pytest.mark.parametrize("cosine", [0.9, 0.2, -0.3])
def test_slopes_are_those_of_the_area_seen(cosine: float) -> None:
    """The quantile inverts the share; at normal incidence it is that of the normal distribution."""
    sine = 0.3 * np.sqrt(1.0 - cosine**2)
    end = min(8.0, max(cosine / sine, -8.0))
    for u in (0.01, 0.3, 0.9):
        x = slope_at(u, cosine, sine)
        assert seen_below(x, cosine, sine) == pytest.approx(u * seen_below(end, cosine, sine), rel=1e-8)
        assert slope_at(u, 1.0, 0.0) == pytest.approx(norm.ppf(u), abs=1e-8)


def test_the_normal_quantile_is_scipy_s() -> None:
    """In the middle, at the sides and far out, and beyond all numbers at the ends."""
    for u in (1e-300, 1e-40, 1e-12, 0.01, 0.074, 0.076, 0.3, 0.5, 0.7, 0.926, 0.99, 1.0 - 1e-12):
        assert normal_quantile(u) == pytest.approx(norm.ppf(u), rel=1e-14, abs=1e-15)
    assert (normal_quantile(0.0), normal_quantile(1.0)) == (-np.inf, np.inf)


@pytest.mark.parametrize("slope", [0.1, 0.5])
def test_lambert_light_on_both_sides_stays_lambert_light(slope: float) -> None:
    """In equilibrium nothing changes, neither how much light is on a side nor how it is spread: what a reciprocal
    surface without loss does, and only such a one."""
    theta = np.arcsin(np.sqrt(np.random.default_rng(3).random(RAYS)))
    outside, inside = directions(Facets(1.0, N, slope), theta), directions(Facets(N, 1.0, slope), theta, 2)

    def shares(w: Real) -> Real:
        return np.histogram(w[:, 2] ** 2, bins=5, range=(0.0, 1.0))[0] / RAYS

    above = shares(outside[outside[:, 2] > 0.0]) + N**2 * shares(inside[inside[:, 2] < 0.0])
    below = shares(outside[outside[:, 2] < 0.0]) / N**2 + shares(inside[inside[:, 2] > 0.0])
    np.testing.assert_allclose(above, 0.2, atol=0.015)
    np.testing.assert_allclose(below, 0.2, atol=0.008)
    assert np.abs(outside[:, 1].mean()) < 0.01
    np.testing.assert_allclose(np.linalg.norm(outside, axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize(("n_in", "n_out"), [(1.0, N), (N, 1.0)])
@pytest.mark.parametrize("theta", [0.0, 0.3, 0.8])
def test_a_face_that_is_nearly_smooth_is_fresnel_s(n_in: float, n_out: float, theta: float) -> None:
    """Reflected share and mean directions tend to those of the smooth face."""
    w, smooth = directions(Facets(n_in, n_out, 0.01), theta), Fresnel(n_in, n_out)
    assert np.mean(w[:, 2] > 0.0) == pytest.approx(float(smooth.deltas(theta).mirror), abs=0.006)
    mirror = w[w[:, 2] > 0.0].mean(axis=0)
    np.testing.assert_allclose(mirror, [np.sin(theta), 0.0, np.cos(theta)], atol=0.003)


@pytest.mark.parametrize(("n_in", "n_out"), [(1.0, N), (N, 1.0)])
def test_light_that_meets_one_facet_is_walter_s_law(n_in: float, n_out: float) -> None:
    """At a slope of 0.2 and 0.3 rad all light but 0.2 % meets one facet: intensity integrates to 1, bins agree."""
    face, theta = Facets(n_in, n_out, 0.2), 0.3
    c, weight = np.polynomial.legendre.leggauss(120)
    phi = 2.0 * np.pi * (np.arange(180) + 0.5) / 180
    power = face.intensity(theta, direction_of(np.arccos(c)[:, None], phi)).mean(axis=1) * 2.0 * np.pi * weight
    w = directions(face, theta)
    assert power.sum() == pytest.approx(1.0, abs=4e-3)
    assert power[c > 0.0].sum() == pytest.approx(np.mean(w[:, 2] > 0.0), abs=9e-3)
    assert (power * c).sum() == pytest.approx(w[:, 2].mean(), abs=0.014)
    assert face.albedo(theta) == 1.0


def test_the_kernel_draws_what_the_surface_says() -> None:
    """The same face in a scene's arrays: reflected share and mean direction of both sides."""
    rough = Effects((SideWallRoughness(slope=0.4),)).scene(scene())
    arrays, stream = scene_arrays(rough), np.zeros(STREAM_WORDS, np.uint64)
    for row, n_in, n_out in ((SIDE_IN, N, 1.0), (SIDE_OUT, 1.0, N)):
        found = np.zeros((4_000, 4))
        for history in range(len(found)):
            start(stream, np.uint64(5), np.uint64(history))
            found[history] = scatter(
                arrays.surfaces, row, 0, n_in, n_out, np.sin(0.5), 0.0, -np.cos(0.5), stream, FACE
            )
        w = directions(Facets(n_in, n_out, 0.4), 0.5)
        assert np.mean(found[:, 0] == TRANSMITTED) == pytest.approx(np.mean(w[:, 2] < 0.0), abs=0.03)
        np.testing.assert_allclose(found[:, 1:].mean(axis=0), w.mean(axis=0), atol=0.035)


def test_a_rough_chip_keeps_its_light_and_sends_more_through_its_sides() -> None:
    """The ledger of the walk closes, and light that was trapped by the cuboid's symmetry finds a way out."""
    absorbing = {"absorption_per_um": 2e-2}
    smooth, rough = scene(absorbing), Effects((SideWallRoughness(slope=0.3),)).scene(scene(absorbing))
    plain, ledger, _ = exits_of(smooth)
    found, rough_ledger, _ = exits_of(rough)
    for rays, booked in ((plain, ledger), (found, rough_ledger)):
        out = rays[:, 8].astype(float).sum() / 16384
        # emitted and roulette stand last
        assert out + booked[:6].sum() == pytest.approx(booked[6] + booked[7], abs=1e-6)
    assert found[:, 8].sum() > 1.2 * plain[:, 8].sum()


def test_exits_of_a_rough_chip_can_stand_for_those_of_another_film() -> None:
    """What the walk notes at the top makes the ratio of the two films' reflections: the light that leaves by the top
    and by the sides is that of a walk with the other film."""
    rough, tops = SideWallRoughness(slope=0.3), (film_face(5.5), film_face(6.5))
    stored, wanted = (Effects((rough,)).scene(scene({"absorption_per_um": 5e-3, "top": top})) for top in tops)
    exits, other = (make_exits(of, 1, 2 * BLOCK, notes=True) for of in (stored, wanted))
    found = reweighted(exits, stored, wanted)
    for by_top in (True, False):
        sums = []
        for one, factor in ((other, 1.0), (exits, found.exits.weights), (exits, 1.0)):
            left = (one.rays[:, 2] >= np.float32(35.0)) == by_top
            sums.append(float((one.rays[:, 8].astype(float) * factor)[left].sum()) / exits.histories / 32)
        assert sums[1] == pytest.approx(sums[0], rel=0.015)
        assert abs(sums[1] - sums[0]) < 0.3 * abs(sums[2] - sums[0])


def test_masking_is_none_from_above_and_whole_at_grazing_angles() -> None:
    """Smith's G1 falls from 1 to 0."""
    assert unmasked(1.0, 0.3) == 1.0
    assert unmasked(0.01, 0.3) < 0.1
    assert unmasked(0.0, 0.3) == 0.0


def test_no_roughness_and_no_face_are_refused() -> None:
    """A slope of 0 is a Fresnel face; equal indices have no face."""
    with pytest.raises(InputError, match="slope"):
        Facets(1.0, N, 0.0)
    with pytest.raises(InputError, match="n_out"):
        Facets(1.0, 1.0, 0.1)


def test_what_leaves_a_rough_chip_grows_with_the_slope_not_with_its_square() -> None:
    """Of light that was trapped a band of angles is set free whose width goes with the slope: twice the slope sets
    about twice as much free (four times, were it the square), so the effect counts by its value."""
    absorbing = {"absorption_per_um": 2e-2}
    smooth = float(exits_of(scene(absorbing))[0][:, 8].sum())
    freed = [
        float(exits_of(Effects((SideWallRoughness(slope=slope),)).scene(scene(absorbing)))[0][:, 8].sum()) - smooth
        for slope in (0.1, 0.2)
    ]
    assert 1.5 < freed[1] / freed[0] < 2.6
    (parameter,) = SideWallRoughness.spec().parameters
    assert parameter.score_variable == "value"
