"""The film absorbs towards short wavelengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from containers.effect import StackEffect, parameter
from containers.stack import StackRows, film_layer

EDGE_NM = 350.0


class FilmAbsorptionTail(StackEffect):
    """The film absorbs at short wavelengths, with a tail that falls off towards long ones."""

    name = "film_absorption_tail"
    of = ("film",)
    formula = "k -> k + k0 exp(-max(l - 350 nm, 0) / w)"
    reference = "an absorption edge's exponential tail: Urbach, Phys. Rev. 92, 1324 (1953)"
    scope = "per_sample"
    conserves = ("reciprocity",)

    extinction: float = parameter("k0, at 350 nm and below", unit="", lower=0.0, upper=0.1, off=0.0, one_sided=True)
    tail_nm: float = parameter(
        "w, in which it falls to 1/e", unit="nm", lower=10.0, upper=400.0, shape_grid=(25.0, 50.0, 100.0, 200.0)
    )

    def rows(self, rows: StackRows) -> StackRows:
        """The film's index with the tail; the film is the thickest coherent layer."""
        film = film_layer(rows.thickness_nm, rows.coherent)
        if film is None or not self.extinction:
            return rows
        index = rows.index.copy()
        index[:, film + 1] += (
            1j * self.extinction * np.exp(-np.maximum(rows.wavelength_nm - EDGE_NM, 0.0) / self.tail_nm)
        )
        return replace(rows, index=index)
