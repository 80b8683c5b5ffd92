"""The receiver stands nearer or farther than it was said to."""

from __future__ import annotations

from dataclasses import replace

from containers.effect import SceneEffect, parameter
from containers.scene import Scene


class DistanceError(SceneEffect):
    """The receiver stands nearer or farther than it was said to."""

    name = "distance_error"
    stage = "geometry"
    formula = "D -> D + d"
    reference = "a spacer's tolerance; engineering judgement"

    distance_um: float = parameter("added to the distance D", unit="um", lower=-15.0, upper=15.0, off=0.0)

    def scene(self, scene: Scene) -> Scene:
        """The receiver is moved."""
        if not self.distance_um:
            return scene
        return replace(scene, distance_um=scene.distance_um + self.distance_um)
