"""How a history begins: where, whereto, in which chip, at which wavelength; drawn from the tables of a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from containers.bsdf import Fresnel
from containers.ray_tracing.arrays import CHIP_X, CHIP_Y, DX, DY, DZ, ENDS, X, Y, Z
from containers.ray_tracing.kernel import emit, scramble_keys, scratch
from containers.ray_tracing.packing import emission_arrays, quantiles, scene_arrays
from containers.ray_tracing.philox import start
from containers.ray_tracing.sobol import DIRECTIONS
from containers.scene import Array, Emission, Face, Scene
from tests.ray_scenes import N, bare, scene

Real = NDArray[np.float64]
DRAWS = 8192


def born(of: Scene, sobol: bool = True, count: int = DRAWS) -> tuple[Real, NDArray[np.int64]]:
    """Rays (count, RAY) as they begin, position relative to their chip, and the numbers of their wavelengths."""
    arrays, emission, ledger = scene_arrays(of), emission_arrays(of), np.zeros(len(ENDS))
    stream, ray, _, keys, uniforms = scratch()
    scramble_keys(np.uint64(5), 0, keys)
    rays, waves = np.zeros((count, ray.size)), np.zeros(count, np.int64)
    for place in range(count):
        start(stream, np.uint64(5), np.uint64(place))
        waves[place] = emit(arrays, emission, stream, place, sobol, DIRECTIONS, keys, uniforms, ray, ledger)
        rays[place] = ray
    assert ledger[ENDS.index("emitted")] == count
    return rays, waves


@pytest.mark.parametrize("sobol", [True, False])
def test_volume_emission_is_uniform_and_isotropic(sobol: bool) -> None:
    """Places fill the cuboid, directions the sphere; none hangs on another."""
    rays, _ = born(scene(), sobol)
    uniform = [rays[:, X] / 28.0 + 0.5, rays[:, Y] / 28.0 + 0.5, rays[:, Z] / 35.0, (rays[:, DZ] + 1.0) / 2.0]
    uniform.append(np.arctan2(rays[:, DY], rays[:, DX]) / (2.0 * np.pi) + 0.5)
    for values in uniform:
        assert stats.kstest(values, "uniform").pvalue > 1e-3
    assert np.abs(np.corrcoef(uniform) - np.eye(5)).max() < 4.0 / np.sqrt(DRAWS)
    assert np.linalg.norm(rays[:, [DX, DY, DZ]], axis=1) == pytest.approx(np.ones(DRAWS), abs=1e-12)


def test_dipoles_in_the_plane_send_more_light_up() -> None:
    """1 + cos^2: the cumulative distribution (mu^3 + 3 mu + 4) / 8, within 1e-3 at all cosines."""
    cosine = np.linspace(-1.0, 1.0, 401)
    rays, _ = born(scene(emission=Emission(cosine=cosine, intensity=1.0 + cosine**2)))
    mu = np.sort(rays[:, DZ])
    assert (mu**3 + 3.0 * mu + 4.0) / 8.0 == pytest.approx((np.arange(DRAWS) + 0.5) / DRAWS, abs=1e-3)


def test_light_is_born_where_the_weights_are() -> None:
    """Cells of 2 x 3 weights, one of them dark; row 0 lowest, column 0 left."""
    weights = np.array([[1.0, 0.0, 3.0], [2.0, 2.0, 4.0]])
    rays, _ = born(scene(emission=Emission(position=weights, layer_depth=0.25)))
    found = np.histogram2d(rays[:, Y], rays[:, X], bins=[2, 3], range=[[-14.0, 14.0]] * 2)[0]
    assert found / DRAWS == pytest.approx(weights / 12.0, abs=3e-3)
    assert rays[:, Z] == pytest.approx(np.full(DRAWS, 0.25 * 35.0))


def test_weights_on_another_grid_multiply_those_that_are_there() -> None:
    """Halves times thirds: at each place the product of both, whatever their cells."""
    halves, thirds = np.array([[1.0, 3.0], [2.0, 5.0]]), np.array([[7.0, 1.0, 2.0], [4.0, 6.0, 0.0], [1.0, 9.0, 8.0]])
    weights = Emission(position=halves).by_place(thirds).position
    rows, columns = weights.shape
    for (row, column), weight in np.ndenumerate(weights):
        y, x = (row + 0.5) / rows, (column + 0.5) / columns
        assert weight == halves[int(2 * y), int(2 * x)] * thirds[int(3 * y), int(3 * x)]
    assert rows % 6 == columns % 6 == 0


def test_lamberts_light_begins_on_the_top() -> None:
    """z = T, cos^2 uniform."""
    rays, _ = born(scene(emission=Emission(from_top=True)))
    assert np.all(rays[:, Z] == 35.0)
    assert stats.kstest(rays[:, DZ] ** 2, "uniform").pvalue > 1e-3


def test_chips_and_wavelengths_come_in_proportion() -> None:
    """Powers 0, 1, 3 and weights 0.2, 0.8, and the two are independent."""
    layout = replace(Array.regular(1, 3, 300.0), power=np.array([[0.0, 1.0, 3.0]]))
    face = Face((Fresnel(N, 1.0),) * 2, bare().outside * 2)
    of = scene(
        {"index": np.array([N, N]), "top": face, "sides": face}, layout=layout, wavelength_weight=np.array([0.2, 0.8])
    )
    rays, waves = born(of)
    counts = np.array([[np.sum((rays[:, CHIP_X] == x) & (waves == w)) for w in (0, 1)] for x in (-300.0, 0.0, 300.0)])
    assert np.all(counts[0] == 0)
    assert stats.chisquare(counts[1:].ravel(), DRAWS * np.array([0.05, 0.2, 0.15, 0.6])).pvalue > 1e-3
    assert np.all(rays[:, CHIP_Y] == 0.0)


def test_each_chip_and_each_part_of_it_gets_its_share_of_the_light() -> None:
    """256 chips, quarters of each: exactly as many of a power of two of points in each; by chance, +- 2.8."""
    rays, _ = born(scene(layout=Array.regular(16, 16, 300.0)))
    chip = np.round(rays[:, CHIP_X] / 300.0 + 7.5) + 16 * np.round(rays[:, CHIP_Y] / 300.0 + 7.5)
    quarter = 2 * (rays[:, X] > 0.0) + (rays[:, Y] > 0.0)
    assert np.array_equal(np.bincount(chip.astype(int), minlength=256), np.full(256, DRAWS // 256))
    counts = np.bincount((4 * chip + quarter).astype(int), minlength=1024)
    assert counts.var() < 0.7 * DRAWS / 1024


def test_quantiles_are_those_of_a_density_that_is_linear_in_between() -> None:
    """A triangle from 0 to 2: F = x^2 / 4 exactly; a gap where the density is 0 is crossed."""
    steps = np.linspace(0.0, 1.0, quantiles(np.array([0.0, 2.0]), np.array([0.0, 1.0])).size)
    assert quantiles(np.array([0.0, 2.0]), np.array([0.0, 1.0])) == pytest.approx(2.0 * np.sqrt(steps), abs=1e-12)
    gap = quantiles(np.array([0.0, 1.0, 2.0, 3.0]), np.array([1.0, 0.0, 0.0, 1.0]))
    assert np.all(np.diff(gap) >= 0.0)
    assert np.sum((gap > 1.05) & (gap < 1.95)) == 0
