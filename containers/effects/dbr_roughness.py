"""The faces of the DBR are rough."""

from __future__ import annotations

from containers.effect import StackEffect, parameter
from containers.stack import roughened
from luxloop.stack import Stack


class DbrRoughness(StackEffect):
    """All faces of the DBR are rough: it reflects less, and what is missing is scattered."""

    name = "dbr_roughness"
    of = ("dbr",)
    formula = (
        "r -> r exp(-2 kz^2 s^2), t -> t exp(-(kz1 - kz2)^2 s^2 / 2) at each face; what is scattered goes on about "
        "the mirrored and the refracted direction"
    )
    reference = "Debye-Waller factors: Mitsas and Siapkas, Appl. Opt. 34, 1678 (1995); lower contrast of AlN/GaN: "
    reference += "J. Appl. Phys. 113, 183106 (2013)"
    conserves = ("energy", "reciprocity")

    roughness_nm: float = parameter(
        "rms height added to each face", unit="nm", lower=0.0, upper=8.0, off=0.0, score="square", one_sided=True
    )

    def stack(self, stack: Stack) -> Stack:
        """The stack with rougher faces."""
        return roughened(stack, self.roughness_nm)
