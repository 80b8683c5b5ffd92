"""Stored exits of chips that shine evenly made to stand for those of one that does not: birthplaces are weighed.

    light of an uneven chip = that of an even one + sum over exits (w - 1) exit,   w: weight of the birthplace, mean 1

Where light is born changes no walk, only how much there is of it. A chip among its neighbours has the eight
symmetries of the square, so each exit stands for its eight images, born at eight places, each with its own weight. So
no chip that shines unevenly has a walk of its own, and what is added has as little noise as many exits leave it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.arrays import BORN_X, BORN_Y
from containers.ray_tracing.exits import Exits
from containers.scene import Scene

Real = NDArray[np.float64]
Single = NDArray[np.float32]

IMAGES = tuple((x, y, swapped) for swapped in (False, True) for x in (1.0, -1.0) for y in (1.0, -1.0))
"""The symmetries of the square, in the order of `Exits.turned`: signs of x and y, and whether they are exchanged."""


def is_even(scene: Scene) -> bool:
    """Whether light is born alike all over the chip."""
    return scene.emission.from_top or bool(np.ptp(scene.emission.position) == 0.0)


def evenly_lit(scene: Scene) -> Scene:
    """The scene with light born alike all over the chip."""
    return scene if is_even(scene) else replace(scene, emission=replace(scene.emission, position=np.ones((1, 1))))


def born_as_in(scene: Scene, sets: Sequence[Exits]) -> Exits:
    """The first of several sets of exits of `evenly_lit(scene)`, made with notes, and what all tell of unevenness."""
    first, symmetric = sets[0], scene.emission.symmetric
    if is_even(scene):
        return first
    images = IMAGES[:1] if symmetric else IMAGES  # else bins are folded
    added = [replace(one, turned=_weights(scene, one, images) - np.float32(1.0)) for one in sets]
    alike = np.ones((len(first.rays), len(images)), np.float32)
    return replace(first, turned=alike, uneven=tuple(added))


def _weights(scene: Scene, exits: Exits, images: Sequence[tuple[float, float, bool]]) -> Single:
    """(exit, image), of the places where the images of exits were born, whose mean over the chip is 1."""
    position = (scene.emission.position / scene.emission.position.mean()).astype(np.float32)
    rows, columns = position.shape
    u, v = (exits.notes[:, at] / np.float32(scene.chip.width_um) for at in (BORN_X, BORN_Y))
    found = np.empty((len(exits.rays), len(images)), np.float32)
    for number, (to_x, to_y, swapped) in enumerate(images):
        x, y = (v, u) if swapped else (u, v)
        column, row = (np.clip(((sign * at + 0.5) * n).astype(int), 0, n - 1) for sign, at, n in
                       ((to_x, x, columns), (to_y, y, rows)))  # fmt: skip
        found[:, number] = position[row, column]
    return found
