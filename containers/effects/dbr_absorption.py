"""The AlN layers absorb."""

from __future__ import annotations

from containers.effect import StackEffect, parameter
from containers.stack import ALN, added, kind_of, with_layers
from luxloop.stack import Layer, Stack


class DbrAbsorption(StackEffect):
    """The AlN layers of the DBR absorb."""

    name = "dbr_absorption"
    of = ("dbr",)
    formula = "n -> n + i k in the AlN layers"
    reference = "defects of AlN absorb in the blue; engineering judgement for the range"
    conserves = ("reciprocity",)

    extinction: float = parameter("added to the k of AlN", unit="", lower=0.0, upper=0.01, off=0.0, one_sided=True)

    def stack(self, stack: Stack) -> Stack:
        """The stack with the other AlN."""

        def other(layer: Layer) -> Layer:
            if kind_of(layer, stack) != ALN:
                return layer
            return layer.model_copy(update={"medium": added(layer.medium, k=self.extinction)})

        return with_layers(stack, other)
