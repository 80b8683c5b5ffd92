"""The sensor's signal bends with the light."""

from __future__ import annotations

from containers.effect import DetectorEffect, Real, parameter
from luxloop.camera import Camera


class Nonlinearity(DetectorEffect):
    """The signal falls behind the light as it grows, or runs ahead of it."""

    name = "nonlinearity"
    rank = 1  # of all light that arrives
    formula = "y -> y (1 - b y / ymax), ymax the full scale"
    reference = "EMVA 1288 release 4.0, linearity error; a power of 1.05 bends as 0.1 does"

    bend: float = parameter("b, the share missing at full scale", unit="", lower=-0.1, upper=0.1, off=0.0)

    def signal(self, signal_dn: Real, camera: Camera) -> Real:
        """The bent signal."""
        if not self.bend:
            return signal_dn
        return signal_dn * (1.0 - self.bend * signal_dn / camera.full_scale_dn)
