"""The film is not everywhere as thick within the measured spot."""

from __future__ import annotations

import numpy as np

from containers.effect import StackEffect, parameter
from containers.stack import Film, with_layers
from luxloop.errors import InputError
from luxloop.stack import Layer, Stack

SIGMAS = 5.0
"""How far the distribution is followed, in standard deviations: 6e-7 of it lies beyond."""
ROOM = 6.0
"""The sum follows turns faster by so much, in rad per standard deviation, than those that count: exp(-18) is left."""
HARMONIC_NM = 2.0
"""By so much the film grows while the fastest harmonic of its fringes that counts turns by 1 rad: the fifth of
n = 2.5 at 300 nm, 4 pi n 5 / 300 nm = 0.5 rad/nm. Later ones err: 1e-4 of R on n = 5 + i below, 1e-3 on a metal."""
MOST = 661


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
        """The stack at thicknesses of the film, with their shares: 11 or more, odd.

        A trapezoid sum of step h, in standard deviations, errs by exp(-(2 pi / h - phase)^2 / 2) of a harmonic that
        turns by `phase` in one; h is such that 2 pi / h exceeds the phases that count by `ROOM`. Raises InputError
        for a film with more fringes than can be told apart.
        """
        film_nm = sum(layer.thickness_nm for layer in stack.layers if isinstance(layer, Film))
        if not film_nm or not self.spread_ratio:
            return ((1.0, stack),)
        spread_nm = self.spread_ratio * film_nm
        count = int(SIGMAS / np.pi * (ROOM + spread_nm / HARMONIC_NM)) | 1
        if count > MOST:
            most_nm = HARMONIC_NM * (np.pi / SIGMAS * MOST - ROOM)
            allowed = f"0 to {most_nm / film_nm:.2g} for this film: a spread of {most_nm:.0f} nm"
            mend = "say coherent = false for the film: its fringes are averaged away"
            raise InputError("spread_ratio", self.spread_ratio, allowed, mend)
        sigmas = np.linspace(-SIGMAS, SIGMAS, max(count, 11))
        weights = np.exp(-(sigmas**2) / 2.0)
        shares = zip(weights / weights.sum(), 1.0 + self.spread_ratio * sigmas, strict=True)
        return tuple((float(share), _scaled(stack, float(ratio))) for share, ratio in shares)


def _scaled(stack: Stack, ratio: float) -> Stack:
    """The stack with its film so many times as thick."""

    def other(layer: Layer) -> Layer:
        if not isinstance(layer, Film):
            return layer
        return layer.model_copy(update={"thickness_nm": layer.thickness_nm * ratio})

    return with_layers(stack, other)
