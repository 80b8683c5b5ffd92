"""The film's index changes more, or less, with the wavelength."""

from __future__ import annotations

import numpy as np

from containers.effect import StackEffect, parameter
from containers.stack import StackRows, with_index_added

FIXED_NM, BLUE_NM, RED_NM = 550.0, 400.0, 800.0


class FilmDispersion(StackEffect):
    """The film's index rises more towards short wavelengths than it was said to; at 550 nm it stays."""

    name = "film_dispersion"
    rank = -1  # before what adds to its indices
    of = ("film",)
    formula = "n -> n + s (1/l^2 - 1/l0^2) / (1/l1^2 - 1/l2^2), l0 = 550, l1 = 400, l2 = 800 nm"
    reference = "Cauchy's formula; polymers and oxides: n(400) - n(800) of 0.01 to 0.05"
    scope = "per_sample"
    conserves = ("energy", "reciprocity")

    rise: float = parameter("s, added to n(400 nm) - n(800 nm)", unit="", lower=-0.1, upper=0.1, off=0.0)

    def rows(self, rows: StackRows) -> StackRows:
        """The film's index with the slope."""
        if not self.rise:
            return rows
        slope = (rows.wavelength_nm**-2 - FIXED_NM**-2) / (BLUE_NM**-2 - RED_NM**-2)
        return with_index_added(rows, self.rise * np.asarray(slope))
