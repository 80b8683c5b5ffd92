"""The camera is in focus along one line of the receiver only."""

from __future__ import annotations

from containers.effect import DetectorEffect, parameter
from containers.lens import unevenly_blurred
from luxloop.camera import Camera


class FocusTilt(DetectorEffect):
    """The focal plane stands aslant to the receiver: the image blurs to both sides of a line through its centre."""

    name = "focus_tilt"
    formula = (
        "a pixel shows the Gaussian mean about its place, of standard deviation w |r.n|, r = 1 at the image's corner "
        "and n the direction of the tilt; an even receiver stays even"
    )
    reference = (
        "defocus grows like the distance from the plane of focus: Born and Wolf, Principles of Optics, 4.4, 8.8"
    )

    edge_um: float = parameter(
        "w, the standard deviation along an axis as far from the line as the corner is from the centre",
        unit="um", lower=0.0, upper=100.0, off=0.0, score="square", one_sided=True,
    )  # fmt: skip
    direction_deg: float = parameter(
        "of n in the image, from x towards y; d and d + 180 are the same",
        unit="deg", lower=-150.0, upper=105.0, shape_grid=(-90.0, -45.0, 0.0, 45.0),
    )  # fmt: skip

    def camera(self, camera: Camera) -> Camera:
        """Variances add to those of other blurs."""
        return unevenly_blurred(camera, "tilted", self.edge_um, self.direction_deg) if self.edge_um else camera
