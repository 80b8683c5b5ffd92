"""The receiver passes on less of the light that comes aslant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from containers.effect import SceneEffect, parameter, with_receiver
from containers.scene import Receiver, Scene

STEPS = 257
"""Of the cosine; a parabola is then met to 4e-6."""


class ReceiverBtdf(SceneEffect):
    """What is recorded of the light depends on the angle at which it arrives."""

    name = "receiver_btdf"
    stage = "surface"
    formula = "recorded light x (1 - q sin^2 theta), theta the angle of incidence on the receiver"
    reference = "first even term of any angle-dependent transmittance; range by engineering judgement"

    slant_loss: float = parameter("q, missing at grazing incidence", unit="", lower=-0.4, upper=0.4, off=0.0)

    def scene(self, scene: Scene) -> Scene:
        """The receiver records by angle."""
        if not self.slant_loss:
            return scene
        return with_receiver(scene, self._slanting)

    def _slanting(self, receiver: Receiver) -> Receiver:
        cosine, known = np.linspace(0.0, 1.0, STEPS), np.linspace(0.0, 1.0, receiver.response.size)
        factor = 1.0 - self.slant_loss * (1.0 - cosine**2)
        return replace(receiver, response=np.interp(cosine, known, receiver.response) * factor)
