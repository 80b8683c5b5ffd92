"""Light is absorbed inside the chip."""

from __future__ import annotations

from dataclasses import replace

from containers.effect import SceneEffect, parameter, with_chip
from containers.scene import Scene

PER_CM_PER_UM = 1e-4


class ChipAbsorption(SceneEffect):
    """Light is absorbed inside the chip, beyond what the environment says."""

    name = "chip_absorption"
    stage = "volume"
    formula = "power along a path s in the chip: exp(-(a0 + a) s), Beer and Lambert"
    reference = "GaN at 465 nm: 23 +- 3 /cm (Semiconductors 42, 1342, 2008); mirrors and p-GaN bring it to hundreds"

    absorption_per_cm: float = parameter(
        "added to the absorption of the chip", unit="1/cm", lower=0.0, upper=500.0, off=0.0, one_sided=True
    )

    def scene(self, scene: Scene) -> Scene:
        """The chip absorbs more."""
        if not self.absorption_per_cm:
            return scene
        absorption = scene.chip.absorption_per_um + self.absorption_per_cm * PER_CM_PER_UM
        return with_chip(scene, lambda chip: replace(chip, absorption_per_um=absorption))
