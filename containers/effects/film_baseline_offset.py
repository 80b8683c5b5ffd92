"""The instrument's zero is not at zero."""

from __future__ import annotations

import numpy as np

from containers.effect import CurveEffect, Reading, Real, parameter


class FilmBaselineOffset(CurveEffect):
    """What the instrument reads is off by the same amount everywhere: stray light, a tilted analyser."""

    name = "film_baseline_offset"
    formula = "R, T -> R, T + b; psi -> psi + p; delta -> delta + p, in 0 to 360 deg"
    reference = "a spectrometer's baseline (ASTM E275), an ellipsometer's azimuths; engineering judgement"

    offset_percent: float = parameter("b, of R and T", unit="%", lower=-5.0, upper=5.0, off=0.0)
    offset_deg: float = parameter("p, of psi and delta", unit="deg", lower=-2.0, upper=2.0, off=0.0)

    def curve(self, value: Real, reading: Reading) -> Real:
        """The shifted values."""
        if reading.quantity in ("R", "T"):
            return value + self.offset_percent / 100.0 if self.offset_percent else value
        if not self.offset_deg:
            return value
        return np.mod(value + self.offset_deg, 360.0) if reading.quantity == "delta" else value + self.offset_deg
