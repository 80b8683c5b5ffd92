"""The faces of a measured film are rough."""

from __future__ import annotations

from containers.effect import StackEffect, parameter
from containers.stack import roughened
from luxloop.stack import Stack


class FilmInterfaceRoughness(StackEffect):
    """All faces of a measured film are rough, and scatter what they take from the specular light."""

    name = "film_interface_roughness"
    of = ("film",)
    formula = "r -> r exp(-2 kz^2 s^2), t -> t exp(-(kz1 - kz2)^2 s^2 / 2) at each face"
    reference = "Debye-Waller factors: Mitsas and Siapkas, Appl. Opt. 34, 1678 (1995)"
    scope = "per_sample"
    excludes = ("film_interlayer",)

    roughness_nm: float = parameter(
        "rms height added to each face", unit="nm", lower=0.0, upper=20.0, off=0.0, score="square", one_sided=True
    )

    def stack(self, stack: Stack) -> Stack:
        """The stack with rougher faces."""
        return roughened(stack, self.roughness_nm)
