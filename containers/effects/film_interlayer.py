"""The film and its neighbour are mixed at a face."""

from __future__ import annotations

from typing import Literal

import numpy as np

from containers.effect import StackEffect, parameter
from containers.mixing import with_interlayer
from containers.stack import StackRows, film_face
from luxloop.errors import InputError


class FilmInterlayer(StackEffect):
    """A layer of film and neighbour, mixed, lies at a face of the film: roughness as ellipsometry has it."""

    name = "film_interlayer"
    rank = 1  # it mixes layers as all others have left them
    of = ("film",)
    formula = (
        "a layer of Bruggeman's mixture of both neighbours, half its thickness taken from each; of a thinner one "
        "all there is, the rest from the other, and the mixture has them in these shares"
    )
    reference = "Bruggeman, Ann. Phys. 416, 636 (1935); Aspnes, Theeten, Hottier, Phys. Rev. B 20, 3292 (1979)"
    scope = "per_sample"
    excludes = ("film_interface_roughness",)

    thickness_nm: float = parameter("of the mixed layer", unit="nm", lower=0.0, upper=20.0, off=0.0, one_sided=True)
    face: Literal["inner", "outer"] = parameter(
        "of the film: to the substrate, or to the light", unit="", choices=("inner", "outer")
    )

    def rows(self, rows: StackRows) -> StackRows:
        """The rows with the mixed layer. Raises InputError for one thicker than both of its neighbours together."""
        if not self.thickness_nm:
            return rows
        face = film_face(rows.film, self.face)
        inner_nm, outer_nm = [np.inf, *rows.thickness_nm, np.inf][face : face + 2]
        if self.thickness_nm > inner_nm + outer_nm:
            allowed = f"0 to {inner_nm + outer_nm:g} nm: what the layers at the {self.face} face have together"
            raise InputError("thickness_nm", self.thickness_nm, allowed, "a thinner mixed layer, or the other face")
        half_nm = self.thickness_nm / 2.0
        from_outer_nm = min(max(half_nm, self.thickness_nm - inner_nm), outer_nm)
        return with_interlayer(rows, face, self.thickness_nm, from_outer_nm / self.thickness_nm)
