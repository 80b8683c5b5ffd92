"""The instrument's zero is not at zero."""

from __future__ import annotations

import numpy as np

from containers.effect import CurveEffect, Reading, Real, parameter


class FilmBaselineOffset(CurveEffect):
    """The instrument is out of adjustment: its zero, the azimuth of its polariser, a strained window in its beam.

    R and T may come out below 0 or above 1, as instruments of a false zero read them; psi stays in 0 to 90 deg.
    That of psi is for light that the sample leaves polarised; what the window does holds of axes along p and s.
    """

    name = "film_baseline_offset"
    formula = (
        "R, T -> R, T + b; tan psi -> tan psi tan(45 deg + p), a polariser p nearer to the plane of incidence than "
        "45 deg; delta -> delta + w, in 0 to 360 deg, a window that retards by w"
    )
    reference = (
        "base lines: ASTM E275; azimuths: Azzam and Bashara, Ellipsometry and Polarized Light (1977); "
        "windows: Jellison, Appl. Opt. 38, 4784 (1999); engineering judgement for the ranges"
    )

    offset_percent: float = parameter("b, of R and T", unit="%", lower=-5.0, upper=5.0, off=0.0)
    azimuth_deg: float = parameter("p, of the polariser: psi", unit="deg", lower=-2.0, upper=2.0, off=0.0)
    retardance_deg: float = parameter("w, of the window: delta", unit="deg", lower=-2.0, upper=2.0, off=0.0)

    def curve(self, value: Real, reading: Reading) -> Real:
        """What is read instead."""
        if reading.quantity == "psi":
            return self._psi_deg(value) if self.azimuth_deg else value
        if reading.quantity == "delta":
            return np.mod(value + self.retardance_deg, 360.0) if self.retardance_deg else value
        return value + self.offset_percent / 100.0 if self.offset_percent else value

    def _psi_deg(self, psi_deg: Real) -> Real:
        psi, more = np.radians(psi_deg), np.tan(np.radians(45.0 + self.azimuth_deg))
        return np.asarray(np.degrees(np.arctan2(more * np.sin(psi), np.cos(psi))))
