"""Light is born in a thin layer of the chip."""

from __future__ import annotations

from dataclasses import replace

from containers.effect import SceneEffect, parameter, with_emission
from containers.scene import Scene


class ActiveLayerDepth(SceneEffect):
    """Light is born in a thin layer of the chip, instead of where the environment says."""

    name = "active_layer_depth"
    stage = "emission"
    formula = "z = h T for all light, h the height of the layer over the chip's bottom"
    reference = "quantum wells of some 0.1 um in an epitaxial layer; the height is engineering judgement"
    discrete = True

    depth: float = parameter(
        "height of the layer as a share of the chip's thickness, 1 at its top",
        unit="", lower=0.0, upper=1.0, shape_grid=(0.05, 0.25, 0.5, 0.75, 0.95),
    )  # fmt: skip

    def scene(self, scene: Scene) -> Scene:
        """The chips shine from a layer; a Lambertian top has no inside."""
        return with_emission(scene, lambda emission: replace(emission, layer_depth=self.depth))
