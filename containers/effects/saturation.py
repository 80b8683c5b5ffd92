"""The sensor's signal bends before its full scale."""

from __future__ import annotations

import numpy as np

from containers.effect import DetectorEffect, Real, parameter
from luxloop.camera import Camera


class Saturation(DetectorEffect):
    """Bright pixels saturate softly, from a knee below full scale on."""

    name = "saturation"
    rank = 2  # the last of the sensor
    formula = (
        "above k ymax: y -> ymax (k + (1 - k) tanh((y/ymax - k)/(1 - k))); as k -> 1 that is y up to ymax, to "
        "0.24 (1 - k) ymax; what is brighter is cut at ymax, at k = 1 left to the mask"
    )
    reference = "EMVA 1288 release 4.0, saturation; the soft knee is engineering judgement"

    knee: float = parameter("k, a share of full scale", unit="", lower=0.8, upper=1.0, off=1.0, one_sided=True)

    def signal(self, signal_dn: Real, camera: Camera) -> Real:
        """The signal with a knee."""
        if self.knee == 1.0:
            return signal_dn
        room, full = 1.0 - self.knee, camera.full_scale_dn
        above = np.maximum(signal_dn / full - self.knee, 0.0)
        return np.where(above > 0.0, full * (self.knee + room * np.tanh(above / room)), signal_dn)
