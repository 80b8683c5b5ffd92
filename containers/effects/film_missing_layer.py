"""A thin layer that nobody spoke of lies at a face of the film."""

from __future__ import annotations

from typing import Literal

from containers.effect import StackEffect, parameter
from containers.stack import film_face, films_in
from luxloop.stack import Layer, Medium, Stack

ORGANIC = 1.5


class FilmMissingLayer(StackEffect):
    """A thin layer lies below the film, as a native oxide does, or upon it, as a contamination does."""

    name = "film_missing_layer"
    of = ("film",)
    rank = -1  # before what makes all faces rough
    formula = (
        "a layer of the named material is added at a face of the film; without a film, at the first or last face"
    )
    reference = "native oxide of silicon 1 to 2 nm: Morita et al., J. Appl. Phys. 68, 1272 (1990)"
    scope = "per_sample"
    conserves = ("energy", "reciprocity")

    thickness_nm: float = parameter("of the layer", unit="nm", lower=0.0, upper=10.0, off=0.0, one_sided=True)
    material: Literal["SiO2", "Al2O3", "organic"] = parameter(
        "that it is made of; organic matter has n = 1.5", unit="", choices=("SiO2", "Al2O3", "organic")
    )
    face: Literal["inner", "outer"] = parameter(
        "of the film: to the substrate, or to the light", unit="", choices=("inner", "outer")
    )

    def stack(self, stack: Stack) -> Stack:
        """The stack with the layer."""
        if not self.thickness_nm:
            return stack
        layers = list(stack.layers)
        medium = Medium(n=ORGANIC) if self.material == "organic" else Medium(material=self.material)
        layers.insert(film_face(films_in(stack), self.face), Layer(medium=medium, thickness_nm=self.thickness_nm))
        return stack.model_copy(update={"layers": tuple(layers)})
