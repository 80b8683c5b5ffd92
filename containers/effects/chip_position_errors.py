"""Chips do not stand where they should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from containers.effect import SceneEffect, parameter
from containers.scene import Array, Scene


class ChipPositionErrors(SceneEffect):
    """Chips stand beside their places; lists as long as a module has chips act on it, on others they do not."""

    name = "chip_position_errors"
    stage = "geometry"
    scope = "per_sample"
    formula = "(x, y) of each chip -> (x + dx, y + dy); chips row by row from the lowest y"
    reference = "placement of mass-transferred micro-LEDs, some um rms; engineering judgement"

    shift_x_um: tuple[float, ...] = parameter(
        "dx of each chip", unit="um", lower=-30.0, upper=30.0, off=0.0, per_chip=True
    )
    shift_y_um: tuple[float, ...] = parameter(
        "dy of each chip", unit="um", lower=-30.0, upper=30.0, off=0.0, per_chip=True
    )

    def scene(self, scene: Scene) -> Scene:
        """The chips are moved."""
        layout = scene.layout
        if not isinstance(layout, Array):
            return scene
        offset = np.array(layout.offset_um)
        for axis, shifts in enumerate((self.shift_x_um, self.shift_y_um)):
            if len(shifts) == layout.power.size:
                offset[..., axis] += np.reshape(shifts, layout.power.shape)
        return (
            scene
            if np.array_equal(offset, layout.offset_um)
            else replace(scene, layout=replace(layout, offset_um=offset))
        )
