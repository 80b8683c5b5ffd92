"""The image is darker towards its corners."""

from __future__ import annotations

from typing import Literal

from containers.effect import DetectorEffect, parameter
from containers.lens import darkened
from luxloop.camera import Camera


class Vignetting(DetectorEffect):
    """The lens passes on less light towards the corners of the image."""

    name = "vignetting"
    formula = (
        "image x (1 - v r^2), or x cos^4 of the field angle that leaves 1 - v at r = 1, the image's corner, beside "
        "the camera's own loss; a veil of stray light is not dimmed"
    )
    reference = "the cos^4 law of illumination: Reiss, J. Opt. Soc. Am. 35, 283 (1945)"

    corner_loss: float = parameter("v, lost at the corner", unit="", lower=0.0, upper=0.3, off=0.0, one_sided=True)
    law: Literal["quadratic", "cos4"] = parameter("of the loss", unit="", choices=("quadratic", "cos4"))

    def camera(self, camera: Camera) -> Camera:
        """What the camera lets through is multiplied by this law."""
        return darkened(camera, self.law, self.corner_loss) if self.corner_loss else camera
