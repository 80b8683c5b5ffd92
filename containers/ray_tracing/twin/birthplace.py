"""Stored exits of chips that shine evenly made to stand for those of one that does not: birthplaces are weighed.

    light of an uneven chip = that of an even one + sum over exits (w - 1) exit,   w: weight of the birthplace, mean 1

Where light is born changes no walk, only how much there is of it. A chip among its neighbours has the symmetries of
the square, or of a rectangle, so each exit stands for its images, born at as many places, each with its own weight.
So no chip that shines unevenly has a walk of its own, and what is added has as little noise as many exits leave it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from containers.ray_tracing.exits import Births, Exits
from containers.scene import Scene

EVENLY = np.ones((1, 1))


def evenly_lit(scene: Scene) -> Scene:
    """The scene with light born alike all over the chip."""
    if scene.emission.from_top or scene.emission.position.shape == EVENLY.shape:
        return scene
    return replace(scene, emission=replace(scene.emission, position=EVENLY))


def is_even(scene: Scene) -> bool:
    """Whether light is born alike all over the chip."""
    return scene.emission.from_top or bool(np.ptp(scene.emission.position) == 0.0)


def born_as_in(scene: Scene, sets: Sequence[Exits]) -> Exits:
    """Sets of exits of `evenly_lit(scene)`, made with notes, as those of the scene."""
    first, *others = sets
    if is_even(scene):
        return first
    weights = scene.emission.position / scene.emission.position.mean()
    return replace(first, births=Births(weights, scene.chip.width_um, tuple(others)))
