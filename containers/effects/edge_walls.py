"""Walls at the module's edge send light back."""

from __future__ import annotations

from dataclasses import replace

from containers.bsdf import Mirror
from containers.effect import SceneEffect, parameter
from containers.scene import Array, Scene


class EdgeWalls(SceneEffect):
    """Specular walls stand at the module's edge, from the substrate to the receiver."""

    name = "edge_walls"
    stage = "geometry"
    twin = False
    formula = (
        "light that reaches an edge is reflected with r, also inside the receiver's plate; the rest leaves, as all "
        "does where the edge is open (r = 0)"
    )
    reference = "frame of the module; aluminium up to 0.9"

    reflectance: float = parameter("of the walls", unit="", lower=0.0, upper=0.9, off=0.0, one_sided=True)

    def scene(self, scene: Scene) -> Scene:
        """A finite module gets walls; endless chips have no edge."""
        if not isinstance(scene.layout, Array) or not self.reflectance:
            return scene
        return replace(scene, layout=replace(scene.layout, wall=Mirror(self.reflectance)))
