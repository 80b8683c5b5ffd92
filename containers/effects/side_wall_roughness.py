"""The side faces of the chips are rough."""

from __future__ import annotations

from dataclasses import replace

from containers.bsdf import Bsdf, Facets, Fresnel
from containers.effect import SceneEffect, parameter, with_chip
from containers.scene import Face, Scene
from luxloop.errors import InputError


class SideWallRoughness(SceneEffect):
    """The side faces of the chips are rough: facets with Gaussian slopes."""

    name = "side_wall_roughness"
    stage = "surface"
    formula = "each clear facet reflects and refracts by Fresnel's law; P(slopes) = exp(-(p^2 + q^2)/m^2)/(pi m^2)"
    reference = "Walter, Marschner, Li, Torrance, EGSR 2007, p. 195; Smith, IEEE TAP 15, 668 (1967), for masking"
    walks = True
    conserves = ("energy", "reciprocity")

    slope: float = parameter(
        "root mean square of the facets' slope (below an air gap the chip's bottom has it too)",
        unit="", lower=0.0, upper=0.5, off=0.0, one_sided=True,
    )  # fmt: skip

    def scene(self, scene: Scene) -> Scene:
        """The chips get rough sides."""
        if not self.slope:
            return scene
        sides = scene.chip.sides
        rough = Face(tuple(map(self._rough, sides.inside)), tuple(map(self._rough, sides.outside)))
        return with_chip(scene, lambda chip: replace(chip, sides=rough))

    def _rough(self, face: Bsdf) -> Bsdf:
        if not isinstance(face, Fresnel):
            raise InputError("chip.sides", type(face).__name__, "clear faces", "roughen a chip of clear sides")
        return Facets(face.n_in, face.n_out, self.slope)
