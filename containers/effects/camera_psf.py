"""The camera blurs."""

from __future__ import annotations

from typing import Literal

import numpy as np

from containers.effect import DetectorEffect, parameter
from luxloop.camera import Camera


class CameraPsf(DetectorEffect):
    """The camera blurs the image, the same all over the field."""

    name = "camera_psf"
    formula = "image * PSF: Gaussian of variance w^2, or Moffat's profile of the same variance"
    reference = "Moffat, A&A 3, 455 (1969)"
    conserves = ("energy",)

    psf_um: float = parameter(
        "standard deviation of the blur along an axis, on the receiver",
        unit="um", lower=0.0, upper=50.0, off=0.0, score="square", one_sided=True,
    )  # fmt: skip
    profile: Literal["gaussian", "moffat2.5"] = parameter("of the blur", unit="", choices=("gaussian", "moffat2.5"))

    def camera(self, camera: Camera) -> Camera:
        """Variances of blurs add up."""
        if not self.psf_um:
            return camera
        width_um = float(np.hypot(camera.psf_um, self.psf_um))
        return camera.model_copy(update={"psf": self.profile, "psf_um": width_um})
