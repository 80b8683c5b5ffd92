"""The receiver is tilted."""

from __future__ import annotations

from dataclasses import replace

from containers.effect import SceneEffect, parameter
from containers.scene import Array, Scene

PER_UM = 1e-3


class ReceiverTilt(SceneEffect):
    """The receiver stands nearer at one side of the module than at the other."""

    name = "receiver_tilt"
    stage = "geometry"
    scope = "per_sample"
    twin = False
    formula = "D -> D (1 + t.r), r from the module's centre"
    reference = "wedge of a spacer; engineering judgement"

    tilt_x_per_mm: float = parameter("rise along x over D", unit="1/mm", lower=-0.05, upper=0.05, off=0.0)
    tilt_y_per_mm: float = parameter("rise along y over D", unit="1/mm", lower=-0.05, upper=0.05, off=0.0)

    def scene(self, scene: Scene) -> Scene:
        """The receiver of a finite module is tilted; one above endless chips cannot be."""
        if not isinstance(scene.layout, Array) or not (self.tilt_x_per_mm or self.tilt_y_per_mm):
            return scene
        (x, y), along = scene.tilt_per_um, (self.tilt_x_per_mm * PER_UM, self.tilt_y_per_mm * PER_UM)
        return replace(scene, tilt_per_um=(x + along[0], y + along[1]))
