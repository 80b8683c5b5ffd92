"""The camera blurs."""

from __future__ import annotations

from typing import Literal

from containers.effect import DetectorEffect, parameter
from containers.lens import blurred
from luxloop.camera import Camera


class CameraPsf(DetectorEffect):
    """The camera blurs the image, the same all over the field."""

    name = "camera_psf"
    formula = "image * PSF, beside the camera's own: Gaussian of variance w^2, or Moffat's profile of that variance"
    reference = "Moffat, A&A 3, 455 (1969)"
    conserves = ("energy",)

    psf_um: float = parameter(
        "standard deviation of the blur along an axis, on the receiver",
        unit="um", lower=0.0, upper=50.0, off=0.0, score="square", one_sided=True,
    )  # fmt: skip
    profile: Literal["gaussian", "moffat2.5"] = parameter("of the blur", unit="", choices=("gaussian", "moffat2.5"))

    def camera(self, camera: Camera) -> Camera:
        """What the camera shows is convolved."""
        return blurred(camera, self.profile, self.psf_um) if self.psf_um else camera
