"""What a diagnosis starts from: a fit, the structure that it leaves, and the null that judges all that is added."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from validation.contrasts.null import Null, Variances, null
from validation.contrasts.structure import Structure, doubts_of, fit_layout, judged
from validation.diagnose.explained import Loudest
from validation.fit import Fit

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Ground:
    """The fit that effects are added to, its structure, and the null that judges all that follow."""

    fit: Fit
    structure: Structure
    null: Null
    variances: Variances

    @classmethod
    def of(cls, fit: Fit, draws: int, seed: int, cache: Path | None = None) -> Ground:
        """About a fit; `cache`: a folder that keeps nulls."""
        layout, projection = fit_layout(fit), fit.basis
        variances = Variances.of(layout, projection)
        drawn = null(layout, projection, variances.weight, draws, seed, cache)
        fit = fit.doubted(doubts_of(fit, layout, variances, drawn))
        return cls(fit, judged(fit.residual, layout, projection, variances, drawn), drawn, variances)

    @property
    def loudest(self) -> Loudest:
        """Its largest family."""
        family, residual = self.structure.families[0], self.fit.residual / np.sqrt(self.structure.variance_scale)
        return Loudest(
            self.null.layout, self.variances.weight, family.name, family.expected, family.freedom, residual
        )

    def judged(self, residual: Real) -> Structure:
        """The structure in another residual, by the same contrasts and the same null."""
        return judged(residual, self.null.layout, self.fit.basis, self.variances, self.null)
