"""The DBR begins with the other material."""

from __future__ import annotations

from typing import Literal

from containers.effect import StackEffect, parameter
from containers.stack import ALN, GAN, kind_of
from luxloop.errors import InputError
from luxloop.stack import Stack

FIRST = {"gan_first": GAN, "aln_first": ALN}


class DbrLayerOrder(StackEffect):
    """The DBR begins, and with half a pair ends, with the other one of its two materials."""

    name = "dbr_layer_order"
    of = ("dbr",)
    formula = "the two kinds of layers change places where the first one is not the named one: R of p pairs with GaN "
    formula += "first is that of p - 1/2 with AlN first, for a layer of GaN on the bulk of GaN is part of it"
    reference = (
        "Abeles' matrices (tmm): 2.5 pairs of the paper's layers, R(0) from the chip, mean over its line of 445 nm, "
        "18 nm FWHM: 0.378 with GaN first and outermost, 0.009 with AlN; at 445 nm alone 0.380 and 0.005"
    )
    discrete = True
    conserves = ("energy", "reciprocity")

    order: Literal["as_modelled", "gan_first", "aln_first"] = parameter(
        "which comes first on the chip",
        unit="", choices=("as_modelled", "gan_first", "aln_first"), off="as_modelled",
    )  # fmt: skip

    def stack(self, stack: Stack) -> Stack:
        """The stack in the named order. Raises InputError for half a pair, which does not say what the other is."""
        if not stack.layers or FIRST.get(self.order) in (None, kind_of(stack.layers[0], stack)):
            return stack
        if len(stack.layers) == 1:
            raise InputError("order", self.order, "1 pair or more", "say layer_order in the environment instead")
        first, second = stack.layers[:2]
        return stack.model_copy(
            update={"layers": tuple(first if j % 2 else second for j in range(len(stack.layers)))}
        )
