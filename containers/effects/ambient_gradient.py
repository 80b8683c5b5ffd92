"""Light that is not the module's rises over the image."""

from __future__ import annotations

import numpy as np

from containers.effect import DetectorEffect, Real, parameter
from luxloop.camera import Camera


class AmbientGradient(DetectorEffect):
    """Ambient light rises over the image like a plane, the same in all images whatever their exposure."""

    name = "ambient_gradient"
    formula = "y -> y + ymax (a x/x1 + b y/y1), x1, y1 from the image's centre to its last column, row"
    reference = "first terms of smooth stray light; its mean is the offset of an image; engineering judgement"

    rise_x: float = parameter("a, at the last column over full scale", unit="", lower=-0.05, upper=0.05, off=0.0)
    rise_y: float = parameter("b, at the last row over full scale", unit="", lower=-0.05, upper=0.05, off=0.0)

    def signal(self, signal_dn: Real, camera: Camera) -> Real:
        """The signal on a plane."""
        if not (self.rise_x or self.rise_y):
            return signal_dn
        y, x = (np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in (camera.rows, camera.columns))
        return signal_dn + camera.full_scale_dn * np.add.outer(self.rise_y * y, self.rise_x * x)
