"""The layers of the DBR grow thicker along the module."""

from __future__ import annotations

from containers.effect import StackEffect, parameter
from containers.stack import with_layers
from luxloop.stack import Stack

UM_PER_MM = 1e3


class DbrThicknessGradient(StackEffect):
    """All layers of the DBR are thicker towards one side of a finite module, and thinner towards the other."""

    name = "dbr_thickness_gradient"
    of = ("dbr",)
    formula = (
        "d -> d (1 + g x), x of the chip from the module's centre; light that comes back to a chip meets the DBR of "
        "the chip that it came from (second order)"
    )
    reference = "a wafer's growth profile; engineering judgement for the range"
    scope = "per_sample"
    conserves = ("energy", "reciprocity")

    gradient_per_mm: float = parameter(
        "g, the share by which layers grow along x", unit="1/mm", lower=-0.05, upper=0.05, off=0.0
    )

    def beside(self, stack: Stack, x_um: float) -> Stack:
        """The stack of a chip at x."""
        ratio = 1.0 + self.gradient_per_mm * x_um / UM_PER_MM
        if ratio == 1.0:
            return stack
        return with_layers(stack, lambda one: one.model_copy(update={"thickness_nm": one.thickness_nm * ratio}))
