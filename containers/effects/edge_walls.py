"""Walls at the module's edge send light back."""

from __future__ import annotations

from dataclasses import replace

from containers.bsdf import Mirror
from containers.effect import SceneEffect, parameter
from containers.scene import Array, Scene
from luxloop.errors import InputError


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
        """A finite module gets walls, in front of its own (1 - (1 - r)(1 - r')); endless chips have no edge."""
        if not isinstance(scene.layout, Array) or not self.reflectance:
            return scene
        own = Mirror(0.0) if scene.layout.wall is None else scene.layout.wall
        if not isinstance(own, Mirror):
            raise InputError("layout.wall", type(own).__name__, "a mirror, or an open edge", "leave one of both out")
        both = own.reflectance + (1.0 - own.reflectance) * self.reflectance  # to the bit its own where this is off
        return replace(scene, layout=replace(scene.layout, wall=Mirror(both)))
