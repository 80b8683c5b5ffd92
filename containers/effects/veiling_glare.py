"""Stray light in the lens lays a veil over the image."""

from __future__ import annotations

import numpy as np

from containers.effect import DetectorEffect, parameter
from luxloop.camera import Camera


class VeilingGlare(DetectorEffect):
    """A part of all light is spread widely in the lens: a veil over the image."""

    name = "veiling_glare"
    formula = (
        "image -> (1 - a) image + a E * wide Gaussian, E all light of the receiver: vignetting does not dim the veil"
    )
    reference = "ISO 9358:1994 (glare spread function), ISO 18844:2017 (image flare): 0.5 to 10 %"
    conserves = ("energy",)

    glare_share: float = parameter("a, of the light", unit="", lower=0.0, upper=0.1, off=0.0, one_sided=True)
    glare_um: float = parameter(
        "standard deviation of the veil along an axis, on the receiver",
        unit="um", lower=200.0, upper=3200.0, shape_grid=(400.0, 800.0, 1600.0),
    )  # fmt: skip

    def camera(self, camera: Camera) -> Camera:
        """One veil for this and the camera's own, which spreads as much light as wide as both do one after the other.

        The light that two veils leave where it is is (1 - a) (1 - a'), its mean square shift a l^2 + a' l'^2.
        """
        share, own = self.glare_share, camera.glare
        if not share:
            return camera
        both = 1.0 - (1.0 - share) * (1.0 - own)
        square = (share * self.glare_um**2 + own * camera.glare_um**2) / both
        return camera.model_copy(update={"glare": both, "glare_um": float(np.sqrt(square))})
