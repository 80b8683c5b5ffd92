"""The image is larger or smaller than it was said to be."""

from __future__ import annotations

from containers.effect import DetectorEffect, parameter
from luxloop.camera import Camera


class Magnification(DetectorEffect):
    """The image is larger, or smaller, than the size of its pixels says."""

    name = "magnification"
    formula = (
        "r -> (1 + e) r about the module's centre in the image; a pixel shows the mean over the area that it sees, "
        "whose size is in the gain"
    )
    reference = "scale of a calibrated camera is known to some 1e-3; engineering judgement"

    scale_error: float = parameter("e of the formula", unit="", lower=-0.01, upper=0.01, off=0.0)

    def camera(self, camera: Camera) -> Camera:
        """Scales are multiplied."""
        if not self.scale_error:
            return camera
        scale = (1.0 + camera.magnification_error) * (1.0 + self.scale_error)
        return camera.model_copy(update={"magnification_error": scale - 1.0})
