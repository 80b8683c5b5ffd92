"""Light is absorbed inside the chip."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from containers.effect import SceneEffect, parameter, with_chip
from containers.scene import Scene

PER_CM_PER_UM = 1e-4
RISES = {"even": 0.0, "rising": 1.0, "falling": -1.0}
"""By how much of its mean a profile is more at the chip's top than on average."""


class ChipAbsorption(SceneEffect):
    """Light is absorbed inside the chip, beyond what the environment says."""

    name = "chip_absorption"
    stage = "volume"
    formula = (
        "power along a path s in the chip: exp(-int a0 + a f ds), Beer and Lambert; "
        "f = 1 (even), 2 z / T (rising), 2 - 2 z / T (falling)"
    )
    reference = "GaN at 465 nm: 23 +- 3 /cm (Semiconductors 42, 1342, 2008); mirrors and p-GaN bring it to hundreds"

    absorption_per_cm: float = parameter(
        "a, added to the absorption of the chip, mean over its height",
        unit="1/cm", lower=0.0, upper=500.0, off=0.0, one_sided=True,
    )  # fmt: skip
    profile: Literal["even", "rising", "falling"] = parameter(
        "f over the height: even, from nothing at the bottom (p-GaN above), or to nothing at the top (buffer below)",
        unit="", choices=("even", "rising", "falling"),
    )  # fmt: skip

    def scene(self, scene: Scene) -> Scene:
        """The chip absorbs more."""
        if not self.absorption_per_cm:
            return scene
        more = self.absorption_per_cm * PER_CM_PER_UM
        absorption = scene.chip.absorption_per_um + more
        rise = scene.chip.absorption_rise_per_um + RISES[self.profile] * more
        return with_chip(scene, lambda chip: replace(chip, absorption_per_um=absorption, absorption_rise_per_um=rise))
