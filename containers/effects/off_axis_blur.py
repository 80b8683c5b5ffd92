"""The image blurs towards its corners."""

from __future__ import annotations

from typing import Literal

from containers.effect import DetectorEffect, parameter
from containers.lens import unevenly_blurred
from luxloop.camera import Camera


class OffAxisBlur(DetectorEffect):
    """The lens is sharp on its axis and blurs towards the corners: a curved focal surface, or astigmatism."""

    name = "off_axis_blur"
    formula = (
        "a pixel shows the Gaussian mean about its place, of standard deviation w r^2, r = 1 at the image's corner: "
        "round, or along the radius or across it alone; an even receiver stays even"
    )
    reference = "third-order field curvature and astigmatism: Born and Wolf, Principles of Optics, 5.3"

    corner_um: float = parameter(
        "w, the standard deviation along an axis at the corner, on the receiver",
        unit="um", lower=0.0, upper=100.0, off=0.0, score="square", one_sided=True,
    )  # fmt: skip
    shape: Literal["round", "radial", "tangential"] = parameter(
        "of the blur", unit="", choices=("round", "radial", "tangential")
    )

    def camera(self, camera: Camera) -> Camera:
        """Variances add to those of other blurs."""
        return unevenly_blurred(camera, self.shape, self.corner_um) if self.corner_um else camera
