"""Ways of exits that are remembered: they only save time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from containers.bsdf import GaussianLobe, Lambertian, Mirror, Mixture
from containers.ray_tracing.exit_source import BATCH
from containers.ray_tracing.exits import Births, Exits, make_exits
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.packing import emission_arrays
from containers.ray_tracing.tally import GROUPS, Box
from containers.ray_tracing.twin import ways as ways_module
from containers.ray_tracing.twin.direct import direct_light, open_way
from containers.ray_tracing.twin.module import Lights, ModuleTwin
from containers.ray_tracing.twin.ways import Ways
from containers.scene import Array, Cell, Face, Receiver, Scene
from tests.containers.test_predictor import ask, request, shot, worker
from tests.ray_scenes import scene

SIGMA = np.radians(5.0)


@pytest.fixture(scope="module")
def dim() -> tuple[Scene, Exits]:
    """A chip that absorbs, with notes, so that walks are short."""
    case = scene({"absorption_per_um": 2e-2})
    return case, make_exits(case, 1, 4 * BLOCK, notes=True)


def test_ways_that_are_remembered_change_no_bit(dim: tuple[Scene, Exits]) -> None:
    """Chips that absorb, reflect, shine otherwise share them, or leak; what stands or scatters otherwise does not."""
    case, exits = dim
    near = Array.regular(2, 2, 150.0)  # many meet a chip
    lit = replace(case, layout=near, substrate=GaussianLobe(0.9, SIGMA))
    dull = Face((Mirror(0.5),), (Mirror(0.5),))
    heavier = replace(exits, weights=np.linspace(0.5, 2.0, len(exits.rays), dtype=np.float32))
    corner = np.array([[0.2, 1.0], [1.0, 1.8]])
    born = replace(exits, births=Births(corner, lit.chip.width_um, (make_exits(case, 3, 4 * BLOCK, notes=True),)))
    uneven = replace(lit, emission=lit.emission.by_place(corner))
    by_angle = replace(lit.receiver, response=np.linspace(0.7, 1.0, 9))
    same = [
        (lit, exits), (lit, heavier), (replace(lit, receiver=by_angle), exits),
        (replace(lit, substrate=GaussianLobe(0.4, SIGMA)), exits),
        (replace(lit, chip=replace(lit.chip, absorption_per_um=0.5, sides=dull)), exits),
        (replace(lit, leak_share=0.3, leak_um=200.0), exits), (uneven, born),
    ]  # fmt: skip
    others = [
        (replace(lit, distance_um=lit.distance_um + 1.0), exits),
        (replace(lit, layout=Array.regular(2, 2, 160.0)), exits),
        (replace(lit, substrate=Mirror(0.9)), exits),
        (lit, make_exits(case, 2, BLOCK, notes=True)),
    ]  # fmt: skip
    x, known, seen = np.linspace(-300.0, 300.0, 9), Lights(), []
    for one, its in same + others:
        remembered, alone = (ModuleTwin(one, its, blocks=1, known=by).mean(x, x) for by in (known, None))
        np.testing.assert_array_equal(remembered, alone)
        seen.append(len(known.ways))
    assert seen == [1, 1, 1, 1, 1, 1, 2, 3, 4, 5, 6]  # of unevenness a second set of exits tells
    mirrored = replace(lit, receiver=Receiver(Mixture((Lambertian(0.3), Mirror(1.0)), (0.8, 0.2))))
    ModuleTwin(mirrored, exits, blocks=1, known=known)
    assert len(known.ways) == seen[-1]


@pytest.mark.parametrize("wall", [None, Mirror(0.5)])
@pytest.mark.parametrize("leak", [0.0, 0.3])
def test_direct_light_is_the_same_by_any_way(dim: tuple[Scene, Exits], wall: Mirror | None, leak: float) -> None:
    """Between walls, through the substrate, from another chip, of other blocks, in the cell that repeats."""
    case, exits = dim
    module = replace(case, layout=Array.regular(2, 2, 300.0, wall=wall), leak_share=leak, leak_um=300.0)
    way, known = open_way(module, Box.of(module)), Ways()
    powers = [np.eye(2), np.fliplr(np.eye(2))]
    lights = [emission_arrays(replace(module, layout=replace(module.layout, power=one))) for one in powers]
    middle = emission_arrays(replace(module, layout=Cell(300.0)))
    later = replace(exits, ends=exits.ends[:, 1:])
    tried = [
        (way, lights[0], exits, 1), (way, lights[1], exits, 1), (way, middle, exits, 1), (way, middle, exits, 2),
        (way, middle, later, 1), (way.endless(), middle, exits, 1),
    ]  # fmt: skip
    for along, emission, its, blocks in tried:
        how = {"blocks": blocks, "groups": 2}
        found, alone = (direct_light(along, emission, its, 1, known=by, **how).bins for by in (known, None))
        np.testing.assert_array_equal(found, alone)
    assert len(known) == 5


@pytest.mark.parametrize("batches", [1, 2])
def test_a_request_with_another_receiver_walks_no_way_again(batches: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many batches of exits it is of: what a worker knows of a set, it knows in the next request, too."""
    of, walk, walked = worker(), ways_module.walk_ways, []

    def counted(*args: Any) -> None:
        walked.append(len(args))
        walk(*args)

    monkeypatch.setattr(ways_module, "walk_ways", counted)
    histories = batches * BATCH * BLOCK * GROUPS
    for reflectance in (0.35, 0.30):
        receiver = {"scatter": "lambertian", "reflectance": reflectance}
        ask(request(shot(environment__receiver=receiver), exit_histories=histories), of)
        assert len(walked) == GROUPS
