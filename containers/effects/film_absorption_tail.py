"""The film absorbs below its edge, less and less towards long wavelengths."""

from __future__ import annotations

import numpy as np

from containers.effect import StackEffect, parameter
from containers.stack import StackRows, with_index_added

EV_NM = 1239.841984
"""h c: photon energy in eV times wavelength in nm (CODATA 2018)."""
EDGE_NM = 350.0


class FilmAbsorptionTail(StackEffect):
    """The film absorbs at its edge and, exponentially less, at photon energies below it: Urbach's tail."""

    name = "film_absorption_tail"
    of = ("film",)
    formula = (
        "k -> k + a l / (4 pi), absorption coefficient a = a0 exp((E - E0) / Eu) for photon energies E = h c / l "
        "below E0 = h c / l0, l0 = 350 nm, and a0 = 4 pi k0 / l0 above; n stays, film_dispersion changes it"
    )
    reference = (
        "the exponential edge in photon energy: Urbach, Phys. Rev. 92, 1324 (1953); ranges: engineering judgement"
    )
    scope = "per_sample"
    conserves = ("reciprocity",)

    extinction: float = parameter("k0, at the edge", unit="", lower=0.0, upper=0.1, off=0.0, one_sided=True)
    urbach_ev: float = parameter(
        "Eu, in which a falls to 1/e", unit="eV", lower=0.02, upper=2.0, shape_grid=(0.1, 0.2, 0.4, 0.8)
    )

    def rows(self, rows: StackRows) -> StackRows:
        """The film's index with the tail."""
        if not self.extinction:
            return rows
        above_ev = EV_NM / rows.wavelength_nm - EV_NM / EDGE_NM
        k = self.extinction * rows.wavelength_nm / EDGE_NM * np.exp(np.minimum(above_ev, 0.0) / self.urbach_ev)
        return with_index_added(rows, np.asarray(1j * k, np.complex128))
