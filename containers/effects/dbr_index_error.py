"""The index of the AlN layers is another one."""

from __future__ import annotations

from containers.effect import StackEffect, parameter
from containers.stack import ALN, added, kind_of, with_layers
from luxloop.stack import Layer, Stack


class DbrIndexError(StackEffect):
    """The AlN layers of the DBR have another index than they were said to have."""

    name = "dbr_index_error"
    of = ("dbr",)
    formula = "n -> n + dn in the AlN layers, at all wavelengths"
    reference = "AlN at 450 nm: 2.09 (amorphous, sputtered) to 2.18 (Pastrnak and Roskovcova, 1966)"
    conserves = ("energy", "reciprocity")

    index_change: float = parameter("added to the index of AlN", unit="", lower=-0.1, upper=0.05, off=0.0)

    def stack(self, stack: Stack) -> Stack:
        """The stack with the other AlN."""

        def other(layer: Layer) -> Layer:
            if kind_of(layer, stack) != ALN:
                return layer
            return layer.model_copy(update={"medium": added(layer.medium, n=self.index_change)})

        return with_layers(stack, other)
