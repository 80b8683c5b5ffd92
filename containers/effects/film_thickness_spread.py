"""The film is not everywhere as thick within the measured spot."""

from __future__ import annotations

import numpy as np

from containers.effect import StackEffect, parameter
from containers.stack import film_layer
from luxloop.errors import InputError
from luxloop.stack import Stack

SIGMAS = 6.0
"""How far the distribution is followed, in standard deviations."""
FRINGE_NM = 4.0
"""By so much a film of n = 2.5 at 300 nm grows while its fringe's harmonics turn by 2.4 rad; others turn slower."""
MOST = 401


class FilmThicknessSpread(StackEffect):
    """The film's thickness varies within the measured spot: fringes fade, light of all places is added."""

    name = "film_thickness_spread"
    of = ("film",)
    formula = "the mean of the intensities over a normal distribution of d, of standard deviation s d"
    reference = "as wafer mappers and ellipsometers model a non-uniform film; engineering judgement for the range"
    scope = "per_sample"

    spread_ratio: float = parameter(
        "s, of the thickness", unit="", lower=0.0, upper=0.1, off=0.0, score="square", one_sided=True
    )

    def stacks(self, stack: Stack) -> tuple[tuple[float, Stack], ...]:
        """The stack at thicknesses of the film, the thickest coherent layer, with their shares: 11 or more, odd.

        A trapezoid sum of step h, in standard deviations, errs by exp(-(2 pi / h - phase)^2 / 2) of a fringe that
        turns by `phase` in one. Raises InputError for a film with more fringes than can be told apart.
        """
        film = film_layer([one.thickness_nm for one in stack.layers], [one.coherent for one in stack.layers])
        if film is None or not self.spread_ratio:
            return ((1.0, stack),)
        spread_nm = self.spread_ratio * stack.layers[film].thickness_nm
        count = int(SIGMAS / np.pi * (6.0 + spread_nm / FRINGE_NM)) | 1
        if count > MOST:
            mend = "say coherent = false for the film: its fringes are averaged away"
            raise InputError("spread_ratio", self.spread_ratio, f"a spread of some um, here {spread_nm:.0f} nm", mend)
        sigmas = np.linspace(-SIGMAS, SIGMAS, max(count, 11))
        weights = np.exp(-(sigmas**2) / 2.0)
        shares = zip(weights / weights.sum(), 1.0 + self.spread_ratio * sigmas, strict=True)
        return tuple((float(share), self._scaled(stack, film, float(ratio))) for share, ratio in shares)

    def _scaled(self, stack: Stack, film: int, ratio: float) -> Stack:
        layers = list(stack.layers)
        layers[film] = layers[film].model_copy(update={"thickness_nm": layers[film].thickness_nm * ratio})
        return stack.model_copy(update={"layers": tuple(layers)})
