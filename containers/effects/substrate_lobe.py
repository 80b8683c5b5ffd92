"""The substrate scatters a part of the light into all directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from containers.bsdf import Lambertian, Mixture
from containers.effect import SceneEffect, parameter
from containers.scene import Scene


class SubstrateLobe(SceneEffect):
    """The substrate scatters a part of the light by Lambert's law instead of into its lobe."""

    name = "substrate_lobe"
    stage = "surface"
    by_chance = True
    formula = "bsdf -> (1 - m) bsdf + m rho/pi, rho its reflectance"
    reference = "the two ends are those of the paper's bottom types, Gaussian lobe and Lambertian"
    conserves = ("energy",)

    lambertian_share: float = parameter("m of the formula", unit="", lower=0.0, upper=1.0, off=0.0, one_sided=True)

    def scene(self, scene: Scene) -> Scene:
        """The substrate scatters more; a Lambertian one stays what it is."""
        share, base = self.lambertian_share, scene.substrate
        if not share or isinstance(base, Lambertian):
            return scene
        reflectance = float(base.albedo(np.array([0.0]))[0])
        return replace(scene, substrate=Mixture((base, Lambertian(reflectance)), (1.0 - share, share)))
