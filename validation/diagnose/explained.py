"""How much of the structure an effect explains: of the family that spoke loudest before any effect was added.

    share = 1 - (Q_after - nu) / (Q_before - nu)

Q is the energy of that family's contrasts, nu what noise alone gives. Chi2 of all pixels is too blunt for this: an
effect of 20 sigma is 0.9 of its standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from validation.contrasts.families import Layout

Real = NDArray[np.float64]

DECIDES = 0.15
"""A share that is known no better than this decides nothing."""


@dataclass(frozen=True)
class Share:
    """Of the structure that is explained, and its standard error."""

    value: float
    error: float

    @property
    def decides(self) -> bool:
        """Whether it is known well enough to judge by."""
        return self.error <= DECIDES


@dataclass(frozen=True, eq=False)
class Loudest:
    """The family that was largest before any effect was added; it stays the judge."""

    layout: Layout
    weight: Real
    """Of each contrast, as it was then."""
    family: str
    expected: float
    freedom: float
    base: Real
    """The residual of the base model, over the root of its variance scale."""

    def energy(self, residual: Real, scale: float = 1.0) -> float:
        """Of a whitened residual."""
        cells = (self.layout.cells @ residual)[:, None]
        row = self.layout.families.index(self.family)
        return float((self.layout.family_sums @ self.layout.energies(cells, self.weight))[row, 0]) / scale

    def share(self, residual: Real, scale: float = 1.0, *, same_noise: bool) -> Share:
        """What a model explains that leaves this residual.

        Parameters
        ----------
        same_noise : as in the residual of the base model, about one anchor; else as if each had noise of its own.

        Notes
        -----
        A chi2 of `freedom` degrees and factor c = nu / freedom, not central by the structure q that is there, has the
        variance 2 nu^2 / freedom + 4 c q. With r of the structure left the share errs as Q_after - r Q_before does.
        Where one noise is in both, that is as the energy of (1 - r) of the noise does beside the structure of
        residual - r base: what explains little errs little.
        """
        structure = self.energy(self.base) - self.expected
        if structure <= 0.0:
            return Share(0.0, np.inf)
        left = self.energy(residual, scale) - self.expected
        ratio = left / structure
        if same_noise:
            noise = (1.0 - ratio) ** 2
            apart = self.energy(residual / np.sqrt(scale) - ratio * self.base) - noise * self.expected
            variance = self._variance(apart, noise)
        else:
            variance = self._variance(left) + ratio**2 * self._variance(structure)
        return Share(1.0 - ratio, float(np.sqrt(variance) / structure))

    def _variance(self, structure: float, noise: float = 1.0) -> float:
        factor = self.expected / self.freedom
        return 2.0 * noise * self.expected**2 / self.freedom + 4.0 * factor * max(structure, 0.0)
