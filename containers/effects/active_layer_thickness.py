"""The active layer of the chip reaches down from its height."""

from __future__ import annotations

from dataclasses import replace

from containers.effect import SceneEffect, parameter, with_emission
from containers.scene import Emission, Scene
from luxloop.errors import InputError


class ActiveLayerThickness(SceneEffect):
    """Light is born in a layer that reaches down from where a thin one lies, evenly over its height."""

    name = "active_layer_thickness"
    stage = "emission"
    formula = "z uniform in (1 - d) h T to h T, h the height of the thin layer over the chip's bottom"
    reference = "which of many wells shine: Han, Shim, Shin, arXiv:1705.09559 (2018); evenly is engineering judgement"
    walks = True
    rank = 1

    reach: float = parameter(
        "d of the formula, as a share of the thin layer's height over the chip's bottom",
        unit="", lower=0.0, upper=0.75, off=0.0, one_sided=True,
    )  # fmt: skip

    def scene(self, scene: Scene) -> Scene:
        """The chips shine from a thick layer; a Lambertian top has no inside."""
        return with_emission(scene, self._reaching) if self.reach else scene

    def _reaching(self, emission: Emission) -> Emission:
        if emission.from_top:
            return emission
        if emission.layer_depth is None:
            mend = "give environment.active_layer_depth, or the effect active_layer_depth, first"
            raise InputError("active_layer_depth", "none", "a thin layer to reach down from", mend)
        return replace(emission, layer_reach=self.reach)
