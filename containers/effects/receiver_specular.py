"""The receiver's face reflects like a mirror."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from containers.bsdf import Mirror, Mixture
from containers.effect import SceneEffect, parameter, with_receiver
from containers.scene import Scene


class ReceiverSpecular(SceneEffect):
    """A part of what the receiver sends back is reflected as by a mirror, at its smooth face."""

    name = "receiver_specular"
    stage = "surface"
    formula = "bsdf -> (1 - s) bsdf + s rho x mirror, rho its reflectance"
    reference = "Fresnel: 4 % at each face of PMMA, n = 1.49, at normal incidence"
    conserves = ("energy", "reciprocity")

    specular_share: float = parameter(
        "s, of what is sent back", unit="", lower=0.0, upper=0.15, off=0.0, one_sided=True
    )

    def scene(self, scene: Scene) -> Scene:
        """The receiver shines back a little."""
        share, base = self.specular_share, scene.receiver.bsdf
        if not share:
            return scene
        mirror = Mirror(float(base.albedo(np.array([0.0]))[0]))
        mixed = Mixture((base, mirror), (1.0 - share, share))
        return with_receiver(scene, lambda receiver: replace(receiver, bsdf=mixed))
