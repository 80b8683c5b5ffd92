"""An electrode makes a corner of the chip dark."""

from __future__ import annotations

from typing import Literal

import numpy as np

from containers.effect import SceneEffect, parameter, with_emission
from containers.scene import Scene

CELLS = 32


class ElectrodeShadow(SceneEffect):
    """Below an electrode at a corner of the chip no light is born; the rest of the chip shines as much more."""

    name = "electrode_shadow"
    stage = "emission"
    formula = "emission 0 in a square of side W sqrt(f) at a corner, normalised"
    reference = "opaque pads of lateral chips cover some 5 to 30 % of them; engineering judgement"
    conserves = ("energy",)

    dark_share: float = parameter("f, of the chip's area", unit="", lower=0.0, upper=0.3, off=0.0, one_sided=True)
    corner: Literal["left_low", "right_low", "left_high", "right_high"] = parameter(
        "where it is: left at low x, low at low y",
        unit="",
        choices=("left_low", "right_low", "left_high", "right_high"),
    )

    def scene(self, scene: Scene) -> Scene:
        """A corner of each chip is dark."""
        if not self.dark_share:
            return scene
        side = float(np.sqrt(self.dark_share))
        covered = np.clip(side * CELLS - np.arange(CELLS), 0.0, 1.0)  # of cells along an axis
        x = covered[::-1] if self.corner.startswith("right") else covered
        y = covered[::-1] if self.corner.endswith("high") else covered
        return with_emission(scene, lambda emission: emission.by_place(1.0 - np.outer(y, x)))
