"""Light travels inside the white substrate."""

from __future__ import annotations

from dataclasses import replace

from containers.effect import SceneEffect, parameter
from containers.scene import Scene


class SubstrateLeak(SceneEffect):
    """A part of the light that reaches the substrate beside the chips travels inside it and comes out elsewhere."""

    name = "substrate_leak"
    stage = "module"
    formula = (
        "share a comes out without loss by Lambert's law, displaced with the density exp(-r/L)/(2 pi L^2), the rest "
        "meets the surface: of its reflectance R it makes (1 - a) R + a, at most 1"
    )
    reference = (
        "dot-spread of white reflectors (Yule, Nielsen, TAGA 1951); length and share are engineering judgement"
    )

    leak_share: float = parameter("a, of the light there", unit="", lower=0.0, upper=0.1, off=0.0, one_sided=True)
    length_um: float = parameter(
        "L of the density", unit="um", lower=200.0, upper=600.0, shape_grid=(200.0, 300.0, 400.0, 600.0)
    )

    def scene(self, scene: Scene) -> Scene:
        """The substrate leaks."""
        if not self.leak_share:
            return scene
        return replace(scene, leak_share=self.leak_share, leak_um=self.length_um)
