"""All layers of the DBR were grown too thick or too thin."""

from __future__ import annotations

from containers.effect import StackEffect, parameter
from luxloop.stack import Stack


class DbrThicknessError(StackEffect):
    """All layers of the DBR are thicker, or thinner, by the same share."""

    name = "dbr_thickness_error"
    of = ("dbr",)
    formula = "d -> d (1 + e), all layers alike: the stop band moves by about e of its wavelength"
    reference = "growth-rate drift of epitaxial AlN/GaN mirrors; engineering judgement for the range"

    error_ratio: float = parameter("share by which layers are too thick", unit="", lower=-0.05, upper=0.05, off=0.0)

    def stack(self, stack: Stack) -> Stack:
        """The stack with other thicknesses."""
        layers = (
            layer.model_copy(update={"thickness_nm": layer.thickness_nm * (1.0 + self.error_ratio)})
            for layer in stack.layers
        )
        return stack.model_copy(update={"layers": tuple(layers)})
