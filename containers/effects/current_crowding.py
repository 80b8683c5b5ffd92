"""The current is not the same all over a chip."""

from __future__ import annotations

import numpy as np

from containers.effect import SceneEffect, parameter, with_emission
from containers.scene import Scene

CELLS = 32


class CurrentCrowding(SceneEffect):
    """The current through a chip rises towards one side, or towards its rim."""

    name = "current_crowding"
    stage = "emission"
    formula = "emission x (1 + c1 x/W + c2 (4 r^2/W^2 - 2/3)), whose mean is 1; x, r from the chip's centre"
    reference = "lateral spreading of current (Guo, Schubert, J. Appl. Phys. 90, 4191, 2001); judgement for the rim"
    conserves = ("energy",)

    rise: float = parameter("c1, the rise from one side to the other", unit="", lower=-0.6, upper=0.6, off=0.0)
    rim: float = parameter("c2, how much more there is at the rim", unit="", lower=-0.3, upper=0.3, off=0.0)

    def scene(self, scene: Scene) -> Scene:
        """The chips shine unevenly, as much as before."""
        if not (self.rise or self.rim):
            return scene
        place = (np.arange(CELLS) + 0.5) / CELLS - 0.5
        square = place**2 + 1.0 / (12.0 * CELLS**2)  # mean over a cell
        bowl = 4.0 * np.add.outer(square, square) - 2.0 / 3.0  # x^2 and y^2 have a mean of W^2 / 12 each
        weights = 1.0 + self.rise * place + self.rim * bowl
        return with_emission(scene, lambda emission: emission.by_place(weights))
