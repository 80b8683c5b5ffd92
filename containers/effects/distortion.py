"""The lens draws straight lines bent."""

from __future__ import annotations

from containers.effect import DetectorEffect, parameter
from luxloop.camera import Camera


class Distortion(DetectorEffect):
    """The lens moves points along the radius: barrel (k1 below 0) or pincushion."""

    name = "distortion"
    formula = (
        "r -> r + k1 r^3 about the image's centre, r = 1 at its corner; a pixel shows the mean over the area that it "
        "sees, as behind a flat field; without one that area is in the vignetting, 4 k1 at the corner to first order"
    )
    reference = (
        "first radial term: Brown, Photogrammetric Engineering 37, 855 (1971); flat field: EMVA 1288 release 4.0"
    )

    cubic: float = parameter("k1, the shift at the corner over its radius", unit="", lower=-0.02, upper=0.02, off=0.0)

    def camera(self, camera: Camera) -> Camera:
        """First terms add up."""
        if not self.cubic:
            return camera
        return camera.model_copy(update={"distortion": camera.distortion + self.cubic})
