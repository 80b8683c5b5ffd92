"""Chips shine differently."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from containers.effect import SceneEffect, parameter
from containers.scene import Array, Scene


class ChipPowerSpread(SceneEffect):
    """Chips shine more or less than the nominal one; a list as long as a module has chips acts on it alone."""

    name = "chip_power_spread"
    stage = "emission"
    scope = "per_sample"
    formula = "power of each chip x (1 + g); chips row by row from the lowest y"
    reference = "binning of micro-LEDs, 1 to 10 % rms; engineering judgement"

    gain: tuple[float, ...] = parameter("g of each chip", unit="", lower=-0.5, upper=0.5, off=0.0, per_chip=True)

    def scene(self, scene: Scene) -> Scene:
        """The chips get other powers."""
        layout = scene.layout
        if not isinstance(layout, Array) or len(self.gain) != layout.power.size or not any(self.gain):
            return scene
        power = layout.power * (1.0 + np.reshape(self.gain, layout.power.shape))
        return replace(scene, layout=replace(layout, power=power))
