"""Scenes that several tests trace, and ways to start rays where a test wants them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.bsdf import Bsdf, Fresnel, GaussianLobe, SpecularTable
from containers.ray_tracing.arrays import CONES, ENDS, SHUT, TRACE, UNFOLD, SceneArrays
from containers.ray_tracing.kernel import EVENT_OF_EXIT, EXIT, WEIGHT_OF_EXIT, exits_of_group, land_group, scratch
from containers.ray_tracing.packing import emission_arrays, scene_arrays
from containers.ray_tracing.sobol import DIRECTIONS
from containers.ray_tracing.tally import Tally
from containers.scene import Array, Cell, Chip, Emission, Face, Scene, lambertian_receiver
from containers.thin_film.surface import film_bsdf
from tests.films import film

Real = NDArray[np.float64]
Single = NDArray[np.float32]

N = 2.4869
ESCAPE = 6.0 * (1.0 - np.cos(np.radians(23.71))) / 2.0
"""Share of isotropic light inside an escape cone of a clear GaN cuboid, n = 2.4869."""
SUBSTRATE = GaussianLobe(0.97, np.radians(5.0))


def bare(n: float = N) -> Face:
    """A clear face between the chip and air."""
    return Face((Fresnel(n, 1.0),), (Fresnel(1.0, n),))


def taking(R: float, T: float, n: float = N, beyond: float = 1.0) -> Face:
    """A face with the same R and T at all angles up to the critical one, and R = `beyond` after it."""
    critical = np.arcsin(1.0 / n)
    inside = SpecularTable(
        np.array([0.0, critical, critical + 1e-9, np.pi / 2]), np.array([R, R, beyond, beyond]),
        np.array([T, T, 0.0, 0.0]), n,
    )  # fmt: skip
    return Face((inside,), (SpecularTable(np.array([0.0]), np.array([R]), np.array([T]), 1.0 / n),))


@cache
def film_face(pairs: float) -> Face:
    """The paper's DBR as a face."""
    return Face((film_bsdf(film(pairs), "inside"),), (film_bsdf(film(pairs), "outside"),))


def chip(**changes: Any) -> Chip:
    """The chip of the golden cases, W 28 T 35, with changes."""
    given: dict[str, Any] = {
        "width_um": 28.0,
        "thickness_um": 35.0,
        "index": np.array([N]),
        "top": bare(),
        "sides": bare(),
    }
    return Chip(**{**given, **changes})


def scene(chip_changes: dict[str, Any] | None = None, **changes: Any) -> Scene:
    """The cell of the golden cases, D 180 S 500, with changes."""
    given: dict[str, Any] = {
        "layout": Cell(500.0), "chip": chip(**(chip_changes or {})), "distance_um": 180.0, "emission": Emission(),
        "substrate": SUBSTRATE, "receiver": lambertian_receiver(0.35),
    }  # fmt: skip
    return Scene(**{**given, **changes})


def black(**changes: Any) -> Scene:
    """Nothing sends light back: substrate and receiver are black; only chips and what `changes` says."""
    return scene(**{"substrate": Absorber, "receiver": lambertian_receiver(0.0), **changes})


Absorber: Bsdf = SpecularTable(np.array([0.0]), np.array([0.0]), np.array([0.0]))


def forced(of: Scene, wanted: dict[int, bool | None]) -> SceneArrays:
    """The arrays of a scene with some flags as they are wanted; None: as they are."""
    arrays = scene_arrays(of)
    flags = arrays.flags.copy()
    for flag, value in wanted.items():
        flags[flag] = flags[flag] if value is None else value
    return arrays._replace(flags=flags)


def exits_of(
    of: Scene,
    *,
    unfold: bool | None = None,
    cones: bool | None = None,
    shut: bool | None = None,
    count: int = 16384,
    seed: int = 1,
    group: int = 0,
    sobol: bool = True,
) -> tuple[Single, Real, Single]:
    """What leaves a chip: exits (n, EXIT), the ledger per history, and what the walk noted (n, TRACE).

    `unfold`, `cones`, `shut` force or forbid the short cuts of the kernel.
    """
    arrays = forced(of, {UNFOLD: unfold, CONES: cones, SHUT: shut})
    rays, notes, ledger = (
        np.zeros((count, EXIT), np.float32),
        np.zeros((count, TRACE), np.float32),
        np.zeros(len(ENDS)),
    )
    found = exits_of_group(
        arrays, emission_arrays(of), np.uint64(seed), group, 1, 0, count, sobol, DIRECTIONS, rays, notes, ledger,
        scratch(),
    )  # fmt: skip
    return rays[:found], ledger / count, notes[:found]


def launched(
    of: Scene,
    position: ArrayLike,
    direction: ArrayLike,
    *,
    groups: int = 1,
    seed: int = 1,
    unfold: bool | None = None,
    fan: int = 1,
) -> Tally:
    """The tally of rays that start at positions (n, 3) relative to their chip, in directions (n, 3), n in all groups.

    Stored exits leave their chip, so upward rays in a cell may not begin beside it and go towards it.
    """
    at, way = np.broadcast_arrays(np.asarray(position, float), np.asarray(direction, float))
    rays = np.zeros((at.shape[0], EXIT), np.float32)
    rays[:, :3], rays[:, 3:EVENT_OF_EXIT] = at, way
    rays[:, WEIGHT_OF_EXIT] = 1.0
    tally = Tally.empty(of, groups)
    arrays, emission = forced(of, {UNFOLD: unfold}), emission_arrays(of)
    share = rays.shape[0] // groups
    for group in range(groups):
        part = rays[group * share : (group + 1) * share]
        part.flags.writeable = False  # as stored exits are: kernels are compiled once
        land_group(
            arrays, emission, np.uint64(seed), group, groups, np.arange(share, dtype=np.uint64), part,
            np.zeros(0, np.float32), 1.0, fan, tally.sinks(group), scratch(),
        )  # fmt: skip
    tally.ledger[:, ENDS.index("emitted")] = share
    tally.histories = share
    return tally


def lambert_up(count: int, seed: int = 0) -> Real:
    """Directions (count, 3) by Lambert's law about +z."""
    u, v = np.random.default_rng(seed).random((2, count))
    return np.column_stack([np.sqrt(u) * np.cos(2 * np.pi * v), np.sqrt(u) * np.sin(2 * np.pi * v), np.sqrt(1.0 - u)])


def within_edges(tally: Tally, of: Scene) -> Real:
    """(group, y, x), bins of a walled module without those of the pad beyond its walls, which stand between bins."""
    layout, step = of.layout, tally.box.step_um
    assert isinstance(layout, Array)
    bins = tally.cell_bins()
    rows, columns = (round(2.0 * half / step) for half in (layout.half_y_um, layout.half_x_um))
    row, column = (bins.shape[1] - rows) // 2, (bins.shape[2] - columns) // 2
    return bins[:, row : row + rows, column : column + columns]


def mean_and_error(of_groups: Real) -> tuple[Real, Real]:
    """Mean over groups (group, ...) and its standard error."""
    return of_groups.mean(axis=0), of_groups.std(axis=0, ddof=1) / np.sqrt(of_groups.shape[0])


def illuminance(tally: Tally) -> Real:
    """(group,), mean relative illuminance of a cell."""
    return np.asarray(tally.cell_bins().sum(axis=(1, 2)) / tally.histories)


def mode(tally: Tally, m: int, n: int) -> Real:
    """(group,), mean of cos(2 pi m x / S) cos(2 pi n y / S) of a cell's light, relative to what was emitted."""
    bins = tally.cell_bins()
    centre = (np.arange(bins.shape[1]) + 0.5) / bins.shape[1] - 0.5
    return np.asarray(
        np.einsum("gyx,y,x->g", bins, np.cos(2 * np.pi * n * centre), np.cos(2 * np.pi * m * centre))
        / tally.histories
    )


def with_chip(of: Scene, **changes: Any) -> Scene:
    """The same scene with another chip."""
    return replace(of, chip=replace(of.chip, **changes))
