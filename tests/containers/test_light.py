"""Which modes of a tally are light: identities of the weights, and that folding a symmetric cell changes little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from containers.ray_tracing.build import scene_of
from containers.ray_tracing.field import Axis, CellField
from containers.ray_tracing.light import _around, _error_over_noise, _share_of_first, _weighed, light_of
from containers.ray_tracing.monte_carlo import MonteCarlo, blocks_of
from containers.ray_tracing.outcome import region_of
from containers.ray_tracing.uniformity import uniformity
from containers.scene import Array, Emission
from luxloop.design import Design
from luxloop.model import Environment
from tests.ray_scenes import scene

NOISE = np.random.default_rng(5)


def field_of(coefficients: np.ndarray[tuple[int, ...], np.dtype[np.float64]], kind: str) -> CellField:
    """A field with these coefficients (group, y, x) of six modes."""
    axis = Axis(0.0, 500.0, 6, kind)  # type: ignore[arg-type]  # one of its words
    return CellField(coefficients, axis, axis, 1000, 0.0, 1.0)


def test_a_sine_is_no_neighbour_of_the_last_cosine() -> None:
    """In a cell that is not symmetric the strong first sine says nothing of the highest cosine beside it."""
    power = np.zeros((13, 13))
    power[0, 7] = 1.0
    around = _around(field_of(np.zeros((2, 13, 13)), "periodic"), power)
    assert around[0, 6] == 0.0
    assert around[0, 8] == around[1, 7] == 1.0


def test_the_mean_is_no_neighbour() -> None:
    """The mean is always light: its power does not vouch for the modes beside it."""
    power = np.zeros((7, 7))
    power[0, 0] = 1.0
    assert not _around(field_of(np.zeros((2, 7, 7)), "even"), power).any()


@pytest.mark.parametrize(("kind", "functions"), [("even", 7), ("periodic", 13)])
def test_noise_counts_little_and_light_wholly(kind: str, functions: int) -> None:
    """Pure noise keeps a small share of its power; modes 20 errors high keep nearly all of theirs."""
    noise = NOISE.standard_normal((32, functions, functions))
    shares = _share_of_first(field_of(noise, kind))
    assert shares[0, 0] == 1.0
    assert shares.ravel()[1:].mean() < 0.2
    assert _share_of_first(field_of(noise + 20.0 / np.sqrt(32), kind)).min() > 0.99


@pytest.mark.parametrize("light", [0.0, 1.0, 3.0, 30.0])
@pytest.mark.parametrize("step", [1, 2], ids=["all modes", "mirror images"])
def test_weighed_modes_err_by_what_their_groups_say(light: float, step: int) -> None:
    """On average over draws, whatever light there is: none, about the noise, above it; every other mode empty or not.

    Light falls off with the mode; its signs and places are random. The root of the share would say too little.
    """
    modes = np.arange(40)
    lit = (modes[:, None] % step == 0) & (modes % step == 0)
    axis, draws, groups = Axis(0.0, 500.0, 39, "box"), 60, 32
    truth = light * NOISE.standard_normal((40, 40)) * np.exp(-np.hypot(modes[:, None], modes) / 10.0) * lit
    erred = told = by_share = 0.0
    for _ in range(draws):
        noise = np.sqrt(groups) * NOISE.standard_normal((groups, 40, 40)) * lit
        field = CellField(truth + noise, axis, axis, 1000, 0.0, 1.0)
        share = _share_of_first(field)
        found = [_weighed(field, share, error) for error in (_error_over_noise(field, share), share)]
        erred += float(np.sum((found[0].mean(axis=0) - truth) ** 2)) / draws
        one, other = (float(np.sum(np.var(each, axis=0, ddof=1))) / groups / draws for each in found)
        told, by_share = told + one, by_share + other
    upwards = 0.05 * lit.sum() if step == 1 else 0.0  # none is below 0: that shows where all modes have noise
    assert 0.9 * erred < told < 1.15 * erred + upwards
    assert by_share < told


def test_the_errors_of_a_module_are_as_its_runs_scatter() -> None:
    """Of uniformity and map of a chip by itself, over 24 seeds; by the root of the share half of it is told."""
    design = Design(distance_um=180.0, width_um=54.0, spacing_um=300.0, thickness_um=5.0, dbr_pairs=0.0)
    of = scene_of(Environment(), design, None, Array.regular(1, 1, 300.0, 400.0))
    x_um, values, told, maps, errors = np.linspace(-300.0, 300.0, 21), [], [], [], []
    for seed in range(24):
        found = light_of(MonteCarlo(of, seed).run_to(blocks_of(40_000)), of)
        u = uniformity(found, region_of(of))
        groups = found.grid(x_um, x_um)
        values.append(u.value)
        told.append(u.standard_error)
        maps.append(groups.mean(axis=0))
        errors.append(groups.var(axis=0, ddof=1) / len(groups))
    assert 0.7 < np.sqrt(np.mean(np.square(told))) / np.std(values, ddof=1) < 1.6
    assert 0.8 < np.sqrt(np.mean(errors) / np.mean(np.var(maps, axis=0, ddof=1))) < 1.5


def test_folding_changes_little_but_the_noise() -> None:
    """The same symmetric scene folded and not: mean equal within errors, and the folded field is not noisier."""
    of = scene()
    ramp = np.array([[1.0, 1.0 + 1e-9]])  # not symmetric by name, but in its light
    whole = replace(of, emission=Emission(position=ramp))
    assert of.symmetric
    assert not whole.symmetric
    one, other = (light_of(MonteCarlo(each, 3).run_to(8192), each) for each in (of, whole))
    assert abs(one.mean - other.mean) < 4.0 * np.hypot(one.mean_error, other.mean_error)
    x = np.linspace(-250.0, 250.0, 41)
    errors = [f.line(x).std(axis=0, ddof=1).mean() for f in (one, other)]
    assert errors[0] < errors[1]
