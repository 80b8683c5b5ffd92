"""A thick substrate interferes after all."""

from __future__ import annotations

from containers.effect import StackEffect, parameter
from luxloop.stack import Layer, Stack


class FilmSubstrateFringes(StackEffect):
    """Light from the far side of a thick substrate keeps part of its coherence, and leaves narrow fringes.

    What a share c of the light does that interferes in all layers, the rest only in thin ones; c is the visibility of
    the first echo. Without a thick layer it says nothing; nor does it where the instrument's line is wider than the
    fringes, and there the request is refused once the fringes are too many to be averaged.
    """

    name = "film_substrate_fringes"
    of = ("film",)
    formula = "(1 - c) R(incoherent) + c R(coherent), period l^2 / (2 n d); the phase from the thickness d + e"
    reference = "partial coherence of thick layers: Prentice, J. Phys. D 33, 3139 (2000)"
    scope = "per_sample"
    conserves = ("energy", "reciprocity")

    coherent_share: float = parameter("c", unit="", lower=0.0, upper=1.0, off=0.0, one_sided=True)
    shift_nm: float = parameter(
        "e, added to the thickness that interferes: the fringes' phase",
        unit="nm", lower=0.0, upper=250.0, shape_grid=(0.0, 40.0, 80.0, 120.0, 160.0),
    )  # fmt: skip

    def stacks(self, stack: Stack) -> tuple[tuple[float, Stack], ...]:
        """The stack as it is, and with every layer coherent."""
        if not self.coherent_share or all(layer.coherent for layer in stack.layers):
            return ((1.0, stack),)
        interferes = stack.model_copy(update={"layers": tuple(map(self._coherent, stack.layers))})
        return (1.0 - self.coherent_share, stack), (self.coherent_share, interferes)

    def _coherent(self, layer: Layer) -> Layer:
        if layer.coherent:
            return layer
        return layer.model_copy(update={"coherent": True, "thickness_nm": layer.thickness_nm + self.shift_nm})
