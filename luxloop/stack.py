"""The words for a thin-film stack: media, layers, and the sentence they form.

    inside | layer | layer | ... | outside

A stack is listed from the bulk outwards (for the chip: GaN, DBR layers, air). Every medium owns its outward face:
`Layer.roughness_nm` is the rms height of the face between that layer and the next medium outwards, and
`Stack.inside_roughness_nm` that of the bulk's. Optical constants are n + ik with time factor exp(-i omega t).
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from luxloop.errors import InputError
from luxloop.words import Words

MAX_LAYERS = 400
MAX_NAME = 64
MAX_THICKNESS_NM = 1e9
MAX_ROUGHNESS_NM = 100.0
MAX_N, MAX_K = 20.0, 50.0

Thickness = Annotated[float, Field(ge=0.0, le=MAX_THICKNESS_NM)]
Roughness = Annotated[float, Field(ge=0.0, le=MAX_ROUGHNESS_NM)]


class Medium(Words):
    """One optical medium: a named material with dispersion, a fixed n + ik, or Cauchy's n = a + b / lambda^2."""

    material: str | None = Field(None, max_length=MAX_NAME)
    n: float | None = Field(None, gt=0.0, le=MAX_N)
    k: float = Field(0.0, ge=0.0, le=MAX_K)
    cauchy: tuple[float, float] | None = Field(None, description="a, b in um^2.", exclude_if=lambda it: it is None)
    plus: tuple[float, float] | None = Field(None, description="Added to n, k.", exclude_if=lambda it: it is None)

    @model_validator(mode="after")
    def _one_way_to_say_it(self) -> Medium:
        if [self.material, self.n, self.cauchy].count(None) != 2:
            raise InputError("n", self.n, "either a material name, an index n or cauchy", "give exactly one of them")
        if self.n is None and self.k:
            raise InputError("k", self.k, "0 without an index n", "the material's own table gives k")
        return self

    def __str__(self) -> str:
        if self.plus is not None:
            return f"{self.model_copy(update={'plus': None})}{self.plus[0]:+g}{self.plus[1]:+g}i"
        if self.material is not None:
            return self.material
        if self.cauchy is not None:
            return f"{self.cauchy[0]:g}+{self.cauchy[1]:g}/um2"
        return f"{self.n:g}" + (f"+{self.k:g}i" if self.k else "")


class Layer(Words):
    """A medium with a thickness; `coherent = False` adds powers, not amplitudes, across it (a thick substrate)."""

    medium: Medium
    thickness_nm: Thickness
    roughness_nm: Roughness = 0.0
    coherent: bool = True

    def __str__(self) -> str:
        rough = f" ~{self.roughness_nm:g}" if self.roughness_nm else ""
        return f"{self.medium}({self.thickness_nm:g} nm{rough}{'' if self.coherent else ', incoherent'})"


class Stack(Words):
    """What light meets between two half spaces, from the bulk outwards."""

    inside: Medium
    layers: tuple[Layer, ...] = Field((), max_length=MAX_LAYERS)
    outside: Medium
    inside_roughness_nm: Roughness = 0.0

    def __str__(self) -> str:
        rough = f" ~{self.inside_roughness_nm:g}" if self.inside_roughness_nm else ""
        return " | ".join([f"{self.inside}{rough}", *map(str, self.layers), str(self.outside)])
