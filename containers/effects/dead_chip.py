"""One chip is dead, or weak."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from containers.effect import SceneEffect, parameter
from containers.scene import Array, Scene
from luxloop.errors import InputError


class DeadChip(SceneEffect):
    """One chip of a module of several is dead, or weak; modules that lack it stay as they are."""

    name = "dead_chip"
    stage = "emission"
    scope = "per_sample"
    formula = "power of one chip x p"
    reference = "failed chips after mass transfer; engineering judgement"
    excludes = ("chip_power_spread",)

    power_ratio: float = parameter("p, 0 for a dead chip", unit="", lower=0.0, upper=1.0, off=1.0, one_sided=True)
    chip: float = parameter(
        "its number, row by row from the lowest y, the first is 0",
        unit="", lower=0.0, upper=9999.0, shape_grid=(0.0, 4.0, 12.0, 20.0, 24.0),
    )  # fmt: skip

    def scene(self, scene: Scene) -> Scene:
        """The chip gets less power."""
        if self.chip != int(self.chip):
            raise InputError("chip", self.chip, "a whole number", "chips are counted")
        layout, number = scene.layout, int(self.chip)
        if not isinstance(layout, Array) or self.power_ratio == 1.0 or not number < layout.power.size > 1:
            return scene
        power = np.array(layout.power)
        power.flat[number] *= self.power_ratio
        return replace(scene, layout=replace(layout, power=power))
