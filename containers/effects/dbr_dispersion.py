"""The layers of the DBR have the dispersion of the literature."""

from __future__ import annotations

from typing import Literal

from containers.effect import StackEffect, parameter
from containers.stack import ALN, kind_of, with_layers
from luxloop.stack import Layer, Medium, Stack


class DbrDispersion(StackEffect):
    """The layers of the DBR have the literature's indices at each wavelength, instead of one for all.

    The chip itself keeps its index: rays are refracted by it.
    """

    name = "dbr_dispersion"
    rank = -1  # before what changes the indices that it sets
    of = ("dbr",)
    formula = "n(lambda) of GaN and AlN in the layers"
    reference = (
        "Barker and Ilegems, Phys. Rev. B 7, 743 (1973); Pastrnak and Roskovcova, Phys. Stat. Sol. 14, K5 (1966)"
    )
    discrete = True
    conserves = ("energy", "reciprocity")

    indices: Literal["as_modelled", "literature"] = parameter(
        "of the layers", unit="", choices=("as_modelled", "literature"), off="as_modelled"
    )

    def stack(self, stack: Stack) -> Stack:
        """The stack of the named materials."""
        if self.indices == "as_modelled":
            return stack

        def named(layer: Layer) -> Layer:
            material = "AlN" if kind_of(layer, stack) == ALN else "GaN"
            if layer.medium.material == material:
                return layer
            return layer.model_copy(update={"medium": Medium(material=material)})

        return with_layers(stack, named)
