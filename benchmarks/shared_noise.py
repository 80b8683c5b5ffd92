"""How much noise two chips that differ a little have in common.

    python -m benchmarks.shared_noise [--blocks N]

Maps of a module of 3 x 3 by the twin, of a chip and of one that is a little other, each walked by itself from the
same random numbers: the rms of their difference, of that of two walks of one chip, which have no noise in common.
What the change itself does is in it. Before: what becomes of an exit on its way was drawn by its own number, which is
another one as soon as the chip loses light that the other one sends out. Now: by its history's (decision 82).
"""

from __future__ import annotations

import argparse
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.processes import table
from containers.effects.side_wall_roughness import SideWallRoughness
from containers.ray_tracing.build import scene_of
from containers.ray_tracing.exits import Exits, make_exits
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.twin.module import ModuleTwin
from containers.scene import Array, Scene
from containers.stack import dbr_of
from containers.thin_film.table import film_table
from luxloop.design import Design
from luxloop.film import Grid, Spectrum
from luxloop.model_file import find_model

Real = NDArray[np.float64]
DESIGN = Design(distance_um=180.0, width_um=40.0, spacing_um=500.0, thickness_um=20.0, dbr_pairs=2.5)
AT_UM = np.linspace(-720.0, 720.0, 61)
CHANGES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("layer at 0.989 T for 0.99 T", {"active_layer_depth": 0.989}),
    ("layer at 0.98 T", {"active_layer_depth": 0.98}),
    ("layer at 0.94 T", {"active_layer_depth": 0.94}),
    ("40.04 um wide for 40", {"width_um": 40.04}),
    ("40.4 um wide", {"width_um": 40.4}),
    ("20.02 um thick for 20", {"thickness_um": 20.02}),
    ("20.2 um thick", {"thickness_um": 20.2}),
    ("index of the chip + 0.0003", {"n_gan": 2.4872}),
    ("index of the chip + 0.003", {"n_gan": 2.4899}),
    ("index of the chip + 0.03", {"n_gan": 2.5169}),
    ("sides rough, slope 0.001 for 0.0001", {"slope": 1e-3}),
    ("sides rough, slope 0.01", {"slope": 1e-2}),
)


def scene_with(**changes: Any) -> Scene:
    """The module of model `paper`, with these fields of its design or environment, or this slope of its sides."""
    slope = changes.pop("slope", 0.0)
    design = DESIGN.model_copy(update={name: changes.pop(name) for name in {*changes} & {*Design.model_fields}})
    environment = find_model("paper").environment.model_copy(update=changes)
    line = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
    film = film_table(dbr_of(environment, design.dbr_pairs), line, Grid(wavelengths=11))
    return SideWallRoughness(slope=slope).scene(scene_of(environment, design, film, Array.regular(3, 3, 500.0)))


def seen(scene: Scene, blocks: int, seed: int = 1) -> Real:
    """Its map."""
    return ModuleTwin(scene, make_exits(scene, seed, blocks * BLOCK), shadow_rays=0).mean(AT_UM, AT_UM)


def by_row(exits: Exits, group: int, blocks: range) -> NDArray[np.uint64]:
    """The exits' own numbers, as they were used before."""
    first, last = exits.ends[group, [blocks.start, blocks.stop]] - exits.ends[group, 0]
    return np.arange(exits.first_block * BLOCK + first, exits.first_block * BLOCK + last, dtype=np.uint64)


def shared(blocks: int) -> list[float]:
    """For each change what its difference is of that of two walks."""
    found = []
    for _, change in CHANGES:
        start = scene_with(slope=1e-4) if "slope" in change else scene_with()
        base, other, moved = seen(start, blocks), seen(start, blocks, 2), seen(scene_with(**change), blocks)
        found.append(float((moved - base).std() / (other - base).std()))
    return found


def main() -> None:
    """Measure, print."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    asked.add_argument("--blocks", type=int, default=16, help="of 1024 histories, of each of 32 groups")
    blocks = asked.parse_args().blocks
    now = shared(blocks)
    with patch.object(Exits, "numbers", by_row):  # the peer is the code before
        before = shared(blocks)
    rows = [(name, f"{a:.3f}", f"{b:.3f}") for (name, _), a, b in zip(CHANGES, before, now, strict=True)]
    table("rms difference of two maps, of that of two walks", rows, ("change", "before", "now"))


if __name__ == "__main__":
    main()
